"""Advice: its figure, tables and page."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import count
from math import isfinite
from typing import TYPE_CHECKING, Any

from feel321 import __version__
from feel321.analysis.figures import style
from feel321.analysis.report.section import Picture
from feel321.analysis.tradeoff.advise.choice import SceneAdvice, advise_scene, find_common
from feel321.analysis.tradeoff.advise.measures import SEGMENT_S, TURNS
from feel321.analysis.tradeoff.advise.scene import ANY, Context, Rated, Verdict, split_recording
from feel321.analysis.tradeoff.results import PageParts, PageResult, as_recordings
from feel321.doors import announce
from feel321.jobs import ALONE, Workers, as_workers, gather_results
from feel321.records import to_json_value
from feel321.stimuli.reducers.registry import REDUCERS
from feel321.types import Reducer

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from pandas import DataFrame

    from feel321.analysis.tradeoff.advise.scene import AdviceScene
    from feel321.stimuli.recording import Recording

ROW_CM, LETTER_CM, REST_CM = 0.42, 0.15, 2.0
"""Height of a row, of a letter of an upright label, and of key and gaps."""

NAME_CM = 2.9
COLUMN_WIDE_CM = 0.36
"""Least width of a reducer's column: its upright name must not touch the next."""

CAPTION = (
    "Which reducers suffice for which scenes; reducers from the simplest on. Filled circle: the simplest sufficient "
    "one. Pale circle: sufficient too. Cross: not sufficient. Open diamond: the closest where none suffices. Dash: "
    "beyond the latency budget."
)

BEST, SUFFICIENT, FAILS = "simplest sufficient", "sufficient", "not sufficient"
CLOSEST, LATE = "closest, not sufficient", "beyond the latency budget"
_PALE = {"color": style.PALE, "markeredgecolor": style.BLACK, "markeredgewidth": 0.6}
_OPEN = {"color": "white", "markeredgecolor": style.BLACK, "markeredgewidth": 0.9}
MARKS: dict[str, dict[str, Any]] = {
    BEST: {"marker": "o", "markersize": 7, "color": style.BLACK},
    SUFFICIENT: {"marker": "o", "markersize": 7, **_PALE},
    FAILS: {"marker": "x", "markersize": 4, "color": style.GREY},
    CLOSEST: {"marker": "D", "markersize": 4.5, **_OPEN},
    LATE: {"marker": "_", "markersize": 5, "color": style.GREY},
}
"""What a reducer is to a scene -> how it is drawn."""


def draw_advice(advices: Sequence[SceneAdvice]) -> Figure:
    """Draw which reducers suffice for which scenes."""
    from matplotlib.lines import Line2D

    first = next((each.verdicts for each in advices if each.verdicts), ())
    names = [verdict.name for verdict in first]
    with style.print_style():
        head = LETTER_CM * max(map(len, names), default=0)
        figure, axes = style.new_figure(head + ROW_CM * len(advices) + REST_CM)
        wide = (COLUMN_WIDE_CM * len(names) + NAME_CM + 0.5) / style.CM_PER_INCH
        figure.set_figwidth(max(figure.get_figwidth(), wide))
        marks = {
            state: Line2D([], [], linestyle="none", label=state, **mark)
            for state, mark in MARKS.items()
        }
        states = set()
        for row, advice in enumerate(advices):
            for verdict in advice.verdicts:
                states.add(state := find_state(advice, verdict))
                axes.plot(names.index(verdict.name), row, linestyle="none", **MARKS[state])
        axes.set(xlim=(-0.6, max(len(names), 1) - 0.4), ylim=(len(advices) - 0.4, -0.6))
        axes.set_xticks(range(len(names)), names, rotation=90)
        labels = [style.fit_text(advice.scene.name, NAME_CM, lines=1) for advice in advices]
        axes.set_yticks(range(len(advices)), labels)
        axes.xaxis.tick_top()
        axes.tick_params(length=0)
        axes.spines[:].set_visible(False)
        figure.legend(
            handles=[mark for state, mark in marks.items() if state in states],
            loc="outside lower left", ncols=3, frameon=False, columnspacing=1.0, handletextpad=0.3,
        )  # fmt: skip
    return figure


def find_state(advice: SceneAdvice, verdict: Verdict) -> str:
    """Find what a reducer is to a scene, a key of `MARKS`."""
    if not verdict.in_budget:
        return LATE
    if verdict.is_sufficient:
        return BEST if verdict.name == advice.answer else SUFFICIENT
    return CLOSEST if verdict.name == advice.closest else FAILS


@dataclass(frozen=True, slots=True, repr=False, eq=False)
class Advice(PageResult):
    """The simplest sufficient reducer for every scene.

    Parameters
    ----------
    advices : tuple of SceneAdvice
        One for every recording, or every segment.
    context : Context
        Where the reducer is to run, and what is good enough.
    seed : int
        Seed of the sensor noise and the mountings.
    segment_s : float or None
        Length of the segments; None: every recording is one scene.
    rated : tuple of str
        Recordings whose ratings were used.
    note : str
        Why ratings were not used, or which reducers have none; empty if there is nothing to say.
    """

    advices: tuple[SceneAdvice, ...]
    context: Context
    seed: int
    segment_s: float | None
    rated: tuple[str, ...]
    note: str

    @property
    def common(self) -> tuple[str, ...]:
        """Reducers that suffice everywhere, the simplest first."""
        return find_common(self.advices)

    @property
    def headline(self) -> str:
        """Which one reducer suffices for all scenes, and how many have no advice, in one sentence."""
        moving = [advice for advice in self.advices if advice.verdicts]
        count, of = len(moving), len(self.advices)
        scenes = {1: "the one scene", 2: "both scenes"}.get(count, f"all {count} scenes")
        left, mute = "", [advice.reason for advice in self.advices if not advice.verdicts]
        if mute:
            silent = all("silent" in reason for reason in mute)
            scenes += " with vibration" if silent else " that can be judged"
            why = "silent" if silent else "silent or too short"
            left = f"; {len(mute)} of {of} {'is' if len(mute) == 1 else 'are'} {why}"
        if not self.common:
            lacking = sum(advice.answer is None for advice in moving)
            more = f"; nothing suffices for {lacking} of them" if count > 1 and lacking else ""
            one = "No one" if count > 1 else "No"
            return f"{one} reducer suffices for {scenes}{more}{left}."
        simpler = sum(self.common[0] not in (one.answer, *one.ties) for one in moving)
        them = "each of them" if simpler == count else f"{simpler} of them"
        more = f"; for {them} a simpler one is enough" if simpler else ""
        return f"{self.common[0]} suffices for {scenes}{more}{left}."

    @property
    def simulated(self) -> bool:
        """Whether any rating that was used came from a simulated participant."""
        return any(map(_is_simulated, self.advices))

    def to_frames(self) -> dict[str, DataFrame]:
        """Return the advice as tables.

        Returns
        -------
        dict of str to DataFrame
            `advice`: one row per scene; `measures`: one row per scene and reducer, the simplest first.
        """
        import pandas as pd

        content = build_content(self)
        tables = {"advice": content["scenes"], "measures": content["measures"]}
        return {name: pd.DataFrame(rows) for name, rows in tables.items()}

    def summary(self) -> str:
        """Write the advice for reading.

        Returns
        -------
        str
            One line per scene, one for all, and one about ratings if they were not used.
        """
        lines = (*(advice.line for advice in self.advices), self.headline, self.note)
        return "\n".join(filter(None, lines))

    def _make_page(self, tables: Mapping[str, DataFrame]) -> PageParts:
        del tables
        content = build_content(self)
        first = content["measures"][0]["scene"] if content["measures"] else None
        records = [row for row in content["measures"] if row["scene"] == first]
        pictures = [Picture("advice", CAPTION, draw_advice(self.advices))]
        return PageParts("advise.html", content, pictures, {"content": content, "records": records})


def advise_recordings(  # noqa: PLR0913 - every choice that changes the advice has a name of its own
    recordings: Recording | Iterable[Recording],
    context: Context,
    *,
    seed: int = 0,
    segment_s: float | None = None,
    ratings: Mapping[str, Mapping[str, Rated]] | None = None,
    own: Mapping[str, Reducer] | None = None,
    workers: int | Workers = ALONE,
    progress: Callable[[int, int], None] | None = None,
) -> Advice:
    """Find the simplest sufficient reducer of every recording, or of every segment.

    ratings: recording -> reducer -> what the ratings show; not used for segments, nor for actuators of several axes:
    people rated whole recordings, on one axis. None where nobody rated anything. own: reducers of a lab.
    """
    recordings = as_recordings(recordings, fewest=1)
    scenes = [scene for recording in recordings for scene in split_recording(recording, segment_s)]
    note = "" if ratings is None else _refuse_ratings(ratings, context, segment_s)
    used = {} if ratings is None or note else ratings
    steps, tick = count(1), progress or (lambda _done, _total: None)
    how = {"context": context, "seed": seed, "own": own or {}}
    advices = gather_results(
        ((_advise, (scene, used.get(scene.source)), how) for scene in scenes),
        workers=as_workers(workers),
        done=lambda: tick(next(steps), len(scenes)),
    )
    if not any(advice.verdicts for advice in advices):
        why = "; ".join(f"{advice.scene.name}: {advice.reason}" for advice in advices)
        raise ValueError(
            f"recordings must have motion from 20 to 1000 Hz, got none that has ({why}); check files and units"
        )
    rated = tuple(dict.fromkeys(scene.source for scene in scenes if scene.source in used))
    note = note or _describe_unrated(advices)
    return Advice(tuple(advices), context, seed, segment_s, rated, note)


def _advise(
    scene: AdviceScene,
    rated: Mapping[str, Rated] | None,
    *,
    context: Context,
    seed: int,
    own: Mapping[str, Reducer],
) -> SceneAdvice:
    from threadpoolctl import threadpool_limits

    announce(scene.name)
    reducers = {**REDUCERS, **own}
    # The work is in transforms: threads of the linear algebra only wait for each other.
    with threadpool_limits(limits=1, user_api="blas"):
        return advise_scene(scene, context, seed=seed, ratings=rated, reducers=reducers)


def _refuse_ratings(
    ratings: Mapping[str, Mapping[str, Rated]], context: Context, segment_s: float | None
) -> str:
    if segment_s is not None:
        return "Ratings were not used: people rated whole recordings, not segments."
    if context.axes > 1:
        return "Ratings were not used: people rated the output of one axis of an actuator."
    if not ratings:
        margin = "a margin set beforehand ([analysis] margin in study.toml)"
        return f"Ratings were not used: equivalence needs two rated reducers and {margin}."
    return ""


def _describe_unrated(advices: Sequence[SceneAdvice]) -> str:
    verdicts = [verdict for advice in advices for verdict in advice.verdicts]
    unrated = dict.fromkeys(one.name for one in verdicts if one.needs_ratings and not one.rated)
    if not unrated:
        return ""
    return f"Not rated everywhere, and not advised where others were rated: {', '.join(unrated)}."


def build_content(advice: Advice) -> dict[str, Any]:
    """Build what ``results.json`` holds."""
    context, tolerance = advice.context, advice.context.tolerance
    online = context.online
    return {
        "summary": advice.headline,
        "common": advice.common,
        "context": {
            "online": online, "latency_ms": context.budget_ms if online else None,
            "axes": context.axes, "mounting": context.mounting,
            "block_ms": context.block_ms if online else None, "device_ms": context.device_ms if online else None,
            "segment_s": SEGMENT_S, "mountings": 3 * TURNS if context.mounting == ANY else 1,
        },
        "tolerance": {
            "weber_fraction": tolerance.weber, "level_db": tolerance.level_db, "spectrum": tolerance.spectrum,
            "time": tolerance.time, "change": tolerance.change, "envelope": tolerance.envelope,
        },
        "seed": advice.seed,
        "segment_s": advice.segment_s,
        "rated": advice.rated,
        "simulated": advice.simulated,
        "note": advice.note,
        "scenes": [_tabulate_scene(one, rated=one.scene.source in advice.rated) for one in advice.advices],
        "measures": [
            _tabulate_verdict(one.scene.name, place, verdict)
            for one in advice.advices for place, verdict in enumerate(one.verdicts, start=1)
        ],
        "version": __version__,
    }  # fmt: skip


def _is_simulated(advice: SceneAdvice) -> bool:
    return any(verdict.rated.simulated for verdict in advice.verdicts if verdict.rated)


def _tabulate_scene(advice: SceneAdvice, *, rated: bool) -> dict[str, Any]:
    scene, basis = advice.scene, "metrics"
    if rated:
        basis = f"metrics and {'simulated ' if _is_simulated(advice) else ''}ratings"
    return {
        "scene": scene.name, "recording": scene.source, "start_s": scene.start_s, "stop_s": scene.stop_s,
        "answer": advice.answer, "closest": advice.closest, "runner_up": advice.runner_up,
        "ties": " ".join(advice.ties), "margin": advice.margin if isfinite(advice.margin) else None,
        "close_call": advice.close, "reason": advice.reason, "why": advice.why, "basis": basis, "line": advice.line,
    }  # fmt: skip


def _tabulate_verdict(scene: str, order: int, verdict: Verdict) -> dict[str, Any]:
    shortfall = {f"shortfall_{key}": value for key, value in asdict(verdict.shortfall).items()}
    cost = asdict(verdict.cost)
    reducer, rated = cost.pop("name"), verdict.rated
    row = {
        "scene": scene, "reducer": reducer, "order": order, **cost, **asdict(verdict.measures), **shortfall,
        "segments_within": verdict.suits, "segments": verdict.segments,
        "in_budget": verdict.in_budget, "fits": verdict.fits, "sufficient": verdict.is_sufficient,
        "rated_best": rated.best if rated else None, "p_equivalence": rated.p if rated else None,
    }  # fmt: skip
    return {**to_json_value(row)}
