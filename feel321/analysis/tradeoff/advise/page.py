"""Advice: its table, figure and page."""

from __future__ import annotations

import json
import tempfile
from dataclasses import asdict, dataclass
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any

from feel321.analysis.figures.style import (
    BLUE,
    CM_PER_INCH,
    COLUMN_CM,
    GREY,
    PALE,
    RED,
    add_title,
    fit_text,
    new_figure,
    print_style,
)
from feel321.analysis.report.folder import RESULTS, list_files, replace_report
from feel321.analysis.report.page import TEMPLATES, inline_svg
from feel321.analysis.report.section import Picture
from feel321.analysis.tradeoff.advise.draws import SEGMENT_S, TURNS
from feel321.analysis.tradeoff.advise.scene import ANY, split_recording
from feel321.analysis.words import keep_together

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from feel321.analysis.tradeoff.advise.choice import Advice
    from feel321.analysis.tradeoff.advise.scene import Context, Rated, Scene, Verdict
    from feel321.stimuli.recording import Recording

    Row = dict[str, Any]

# The figure: scenes against reducers, and which are sufficient.

ROW_CM, LETTER_CM, REST_CM = 0.42, 0.15, 2.0
"""Height of a row, of a letter of an upright label, and of key and gaps."""

NAME_CM = 2.9
COLUMN_WIDE_CM = 0.36
"""Least width of a reducer's column: its upright name must not touch the next."""

TITLE = "Least sufficient reducer of every scene: the simplest (from left to right) that is as good as the best."
CLOSEST = "closest, not sufficient"
KEYS = ("simplest sufficient", "sufficient", "not sufficient", CLOSEST, "beyond the latency budget")


def draw_advice(advices: Sequence[Advice]) -> Figure:
    """Draw which reducers suffice for which scenes."""
    names = [
        verdict.name for verdict in next((each.verdicts for each in advices if each.verdicts), ())
    ]
    with print_style():
        head = LETTER_CM * max(map(len, names), default=0)
        figure, axes = new_figure(head + ROW_CM * len(advices) + REST_CM)
        figure.set_figwidth(
            max(figure.get_figwidth(), (COLUMN_WIDE_CM * len(names) + NAME_CM + 0.5) / CM_PER_INCH)
        )
        states = set()
        for row, advice in enumerate(advices):
            for verdict in advice.verdicts:
                states.add(state := tell_state(advice, verdict))
                axes.plot(names.index(verdict.name), row, linestyle="none", **_MARKS[state])
        axes.set(xlim=(-0.6, max(len(names), 1) - 0.4), ylim=(len(advices) - 0.4, -0.6))
        axes.set_xticks(range(len(names)), names, rotation=90)
        axes.set_yticks(
            range(len(advices)),
            [fit_text(advice.scene.name, NAME_CM, lines=1) for advice in advices],
        )
        axes.xaxis.tick_top()
        axes.tick_params(length=0)
        axes.spines[:].set_visible(False)
        _add_key(
            axes,
            [key for key in KEYS if key in states],
            wide=figure.get_figwidth() * CM_PER_INCH / COLUMN_CM,
        )
        add_title(figure, TITLE)
    return figure


def tell_state(advice: Advice, verdict: Verdict) -> str:
    """Say what a reducer is to a scene."""
    if not verdict.in_budget:
        return "beyond the latency budget"
    if verdict.name == advice.answer:
        return "simplest sufficient"
    if verdict.is_sufficient:
        return "sufficient"
    return CLOSEST if verdict.name == advice.closest else "not sufficient"


_MARKS: dict[str, Any] = {
    "simplest sufficient": {"marker": "o", "markersize": 7, "color": BLUE},
    "sufficient": {
        "marker": "o",
        "markersize": 7,
        "color": PALE,
        "markeredgecolor": BLUE,
        "markeredgewidth": 0.6,
    },
    "not sufficient": {"marker": "x", "markersize": 4, "color": GREY},
    CLOSEST: {
        "marker": "D",
        "markersize": 4.5,
        "color": "white",
        "markeredgecolor": RED,
        "markeredgewidth": 0.9,
    },
    "beyond the latency budget": {"marker": "_", "markersize": 5, "color": GREY},
}


def _add_key(axes: Axes, keys: Sequence[str], *, wide: float) -> None:
    from matplotlib.lines import Line2D

    handles = [Line2D([], [], linestyle="none", label=key, **_MARKS[key]) for key in keys]
    axes.legend(
        handles=handles,
        loc="upper left",
        bbox_to_anchor=(-0.45 / wide, 0.0),
        ncols=2,
        frameon=False,
        columnspacing=1.0,
        handletextpad=0.3,
    )


# The page: what each scene needs, why, and the record behind the order.

CAPTION = (
    "Which reducers suffice for which scenes; reducers from the simplest on. Filled circle: the simplest sufficient "
    "one. Pale circle: sufficient too. Cross: not sufficient. Open diamond: the closest where none suffices. Dash: "
    "beyond the latency budget."
)


def render_page(content: Mapping[str, Any], drawing: Path) -> str:
    """Render the page."""
    from jinja2 import Environment, FileSystemLoader, StrictUndefined
    from matplotlib.figure import Figure

    environment = Environment(
        loader=FileSystemLoader(TEMPLATES),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        finalize=keep_together,
    )
    style = (TEMPLATES / "report.css").read_text(encoding="utf-8")
    picture = inline_svg(Picture("advice", CAPTION, Figure()), drawing)
    first = content["measures"][0]["scene"] if content["measures"] else None
    records = [row for row in content["measures"] if row["scene"] == first]
    return environment.get_template("advise.html").render(
        content=content, picture=picture, caption=CAPTION, records=records, style=style
    )


# The folder of results: tables and ``results.json`` first, then figure and page, in the place of the former ones.

FIGURE, TABLES = "advice", ("advice", "measures")
FIGURES, SHEETS = "figures", "tables"


@dataclass(frozen=True, slots=True)
class Study:
    """The advice for all scenes of a study."""

    advices: tuple[Advice, ...]
    context: Context
    seed: int
    segment_s: float | None
    rated: tuple[str, ...]
    note: str

    @property
    def common(self) -> tuple[str, ...]:
        """Reducers that suffice everywhere, the simplest first."""
        from feel321.analysis.tradeoff.advise.choice import find_common

        return find_common(self.advices)

    @property
    def summary(self) -> str:
        """What one reducer for all scenes would be, in one line."""
        count = len([advice for advice in self.advices if advice.verdicts])
        if not self.common:
            return f"No one reducer suffices for all {count} scenes."
        others = ", ".join(self.common[1:])
        return f"One for all {count} scenes: {self.common[0]}{f' (or {others})' if others else ''}."


def advise_recordings(
    recordings: Sequence[Recording],
    context: Context,
    *,
    seed: int = 0,
    segment_s: float | None = None,
    ratings: Mapping[str, Mapping[str, Rated]] | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Study:
    """Find the simplest sufficient reducer of every recording, or of every segment.

    Parameters
    ----------
    recordings : sequence of Recording
        Conditioned, each with a name of its own.
    context : Context
        Where the reducer is to run, and what is good enough.
    seed : int
        Of the sensor noise that steadiness is tried with.
    segment_s : float, optional
        Length of the segments; every recording is one scene if left out.
    ratings : Mapping, optional
        Recording -> reducer -> what people said. Not heard for segments, nor for actuators of several axes: people
        rated whole recordings, on one axis. None where nobody rated anything.
    progress : callable, optional
        Called with the numbers of scenes done and to do.

    Returns
    -------
    Study
        The advice.

    Raises
    ------
    ValueError
        If there is no recording, or segments are too short.

    Examples
    --------
    >>> from feel321.analysis.tradeoff.advise.scene import Context
    >>> from feel321.stimuli.synthesis import make_scene
    >>> scenes = [make_scene(name, duration_s=0.5) for name in ("constrained_drag", "circular_motion")]
    >>> advise_recordings(scenes, Context()).common[0]
    'pca321_matched'
    """
    from threadpoolctl import threadpool_limits

    from feel321.analysis.tradeoff.advise.choice import advise_scene

    if not recordings:
        raise ValueError(
            "recordings: got none, allowed is one or more; name a study, --scenes or --recordings"
        )
    scenes = [scene for recording in recordings for scene in split_recording(recording, segment_s)]
    note = "" if ratings is None else _refuse_ratings(ratings, context, segment_s)
    heard = {} if ratings is None or note else ratings
    advices = []
    # The work is in transforms: threads of the linear algebra only wait for each other.
    with threadpool_limits(limits=1, user_api="blas"):
        for done, scene in enumerate(scenes, start=1):
            advices.append(advise_scene(scene, context, seed=seed, ratings=heard.get(scene.source)))
            if progress is not None:
                progress(done, len(scenes))
    rated = tuple(dict.fromkeys(scene.source for scene in scenes if scene.source in heard))
    return Study(tuple(advices), context, seed, segment_s, rated, note or _tell_unrated(advices))


def write_advice(study: Study, folder: Path) -> Row:
    """Write tables, figure and page; the former ones, and nothing else, are replaced.

    Parameters
    ----------
    study : Study
        The advice.
    folder : Path
        Where to; made if it is missing.

    Returns
    -------
    dict
        What ``results.json`` holds.

    Raises
    ------
    OSError
        If a file cannot be written, or would replace one that is not of former results.
    """
    import pandas as pd

    from feel321.analysis.figures.style import save_figure

    content = lay_out(study)
    folder.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=folder.parent, prefix=f".{folder.name}-") as name:
        place = Path(name)
        for part in (FIGURES, SHEETS):
            (place / part).mkdir()
        rows = {"advice": content["scenes"], "measures": content["measures"]}
        for table in TABLES:
            text = pd.DataFrame(rows[table]).to_csv(
                index=False, float_format="%.10g", lineterminator="\n"
            )
            (place / SHEETS / f"{table}.csv").write_text(text, encoding="utf-8", newline="")
        save_figure(draw_advice(study.advices), place / FIGURES / FIGURE)
        drawing = place / FIGURES / f"{FIGURE}.svg"
        (place / "index.html").write_text(
            render_page(content, drawing), encoding="utf-8", newline=""
        )
        text = json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False)
        (place / RESULTS).write_text(text + "\n", encoding="utf-8", newline="")
        replace_report(place, folder, files=content["files"])
    return content


def lay_out(study: Study) -> Row:
    """Lay the advice out as what JSON can hold."""
    from feel321.stimuli.version import __version__

    context, tolerance = study.context, study.context.tolerance
    budget = context.budget_ms if context.online else None
    return {
        "summary": study.summary,
        "common": study.common,
        "context": {
            "online": context.online, "latency_ms": budget, "axes": context.axes, "mounting": context.mounting,
            "block_ms": context.block_ms if context.online else None,
            "device_ms": context.device_ms if context.online else None,
            "segment_s": SEGMENT_S, "mountings": 3 * TURNS if context.mounting == ANY else 1,
        },
        "tolerance": {
            "weber_fraction": tolerance.weber, "level_db": tolerance.level_db, "spectrum": tolerance.spectrum,
            "time": tolerance.time, "change": tolerance.change,
        },
        "seed": study.seed,
        "segment_s": study.segment_s,
        "rated": study.rated,
        "simulated": any(_is_simulated(advice) for advice in study.advices),
        "note": study.note,
        "scenes": [_lay_scene(advice, rated=advice.scene.source in study.rated) for advice in study.advices],
        "measures": [_lay_verdict(advice, place) for advice in study.advices for place in range(len(advice.verdicts))],
        "files": list_files([FIGURE], TABLES),
        "version": __version__,
    }  # fmt: skip


def _refuse_ratings(
    ratings: Mapping[str, Mapping[str, Rated]], context: Context, segment_s: float | None
) -> str:
    if segment_s is not None:
        return "Ratings are not heard: people rated whole recordings, not segments."
    if context.axes > 1:
        return "Ratings are not heard: people rated what one axis of an actuator plays."
    if not ratings:
        margin = "a margin, from stimuli rated twice or set under [analysis] in study.toml"
        return f"Ratings are not heard: equivalence needs two rated reducers and {margin}."
    return ""


def _tell_unrated(advices: Sequence[Advice]) -> str:
    verdicts = [verdict for advice in advices for verdict in advice.verdicts]
    unrated = dict.fromkeys(
        verdict.name for verdict in verdicts if verdict.needs_ratings and verdict.rated is None
    )
    if not unrated:
        return ""
    return f"Not rated everywhere, and not advised where others were rated: {', '.join(unrated)}."


def _lay_scene(advice: Advice, *, rated: bool) -> Row:
    scene: Scene = advice.scene
    return {
        "scene": scene.name, "recording": scene.source, "start_s": scene.start_s, "stop_s": scene.stop_s,
        "answer": advice.answer, "closest": advice.closest, "runner_up": advice.runner_up,
        "ties": " ".join(advice.ties), "margin": _tell(advice.margin), "close_call": advice.close,
        "reason": advice.reason, "basis": _tell_basis(advice, rated=rated), "line": advice.line,
    }  # fmt: skip


def _tell_basis(advice: Advice, *, rated: bool) -> str:
    if not rated:
        return "metrics"
    return f"metrics and {'simulated ' if _is_simulated(advice) else ''}ratings"


def _is_simulated(advice: Advice) -> bool:
    return any(verdict.rated.simulated for verdict in advice.verdicts if verdict.rated)


def _lay_verdict(advice: Advice, place: int) -> Row:
    verdict: Verdict = advice.verdicts[place]
    measures = {key: _tell(value) for key, value in asdict(verdict.measures).items()}
    shortfall = {
        f"shortfall_{key}": _tell(value) for key, value in asdict(verdict.shortfall).items()
    }
    cost = {key: _tell(value) for key, value in asdict(verdict.cost).items() if key != "name"}
    return {
        "scene": advice.scene.name, "reducer": verdict.name, "order": place + 1, **cost, **measures, **shortfall,
        "segments_within": verdict.suits, "segments": verdict.segments,
        "in_budget": verdict.in_budget, "fits": verdict.fits, "sufficient": verdict.is_sufficient,
        "rated_best": verdict.rated.best if verdict.rated else None,
        "p_equivalence": _tell(verdict.rated.p) if verdict.rated else None,
    }  # fmt: skip


def _tell(value: float) -> float | None:
    """Leave out what is infinite or not defined, in CSV and JSON alike."""
    return value if isfinite(value) else None
