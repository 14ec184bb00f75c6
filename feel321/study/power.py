"""The power of a study: design and planted truth, from `study.toml` and the stimulus set; the answer and its page."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from itertools import product
from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from pandas import DataFrame, concat

from feel321 import __version__
from feel321.analysis.figures import style
from feel321.analysis.power import plan as planning
from feel321.analysis.power import truth as planted
from feel321.analysis.power.plan import PowerPlan
from feel321.analysis.power.truth import PowerDesign, Truth
from feel321.analysis.primary.model import fit_primary
from feel321.analysis.report import folder as results
from feel321.analysis.report.section import Picture, find_table_steps
from feel321.analysis.table import reading
from feel321.analysis.table.items import Part, Table, split_tests
from feel321.analysis.table.metrics import Step
from feel321.analysis.table.reading import Further
from feel321.analysis.words import ABSENT, format_count, format_name
from feel321.doors import check_name
from feel321.files import make_folder
from feel321.jobs import Workers
from feel321.protocols.tasks import find_other
from feel321.protocols.trial import CHOOSING
from feel321.stimuli.sets.manifest import StimulusSet, read_stimuli
from feel321.study import ratings, sessions
from feel321.study.folder import StudyFolder, UsageError
from feel321.study.observer.model import make_model
from feel321.study.session import plan as plans
from feel321.study.session.plan import list_by_code
from feel321.study.settings import read, schema
from feel321.study.settings.schema import Settings

Numbers = int | Sequence[int]

OWN = "study"  # A pilot that is no file: the study's own ratings
SIZES = planted.SIZES

KEPT = ".studies"
"""Folder, in that of the results, of simulated studies: an interrupted call is continued from there."""

PEOPLE, FEWEST = 16, 3
"""Raters of each attribute in the design around which others are compared; without so many there is no model."""

MOST_POINTS = 100  # more than the whole scale per step of a metric is a slip
GIVEN, OBSERVED = "given", "simulated observers"  # where a slope comes from
WHO, SCENE, REDUCER, ITEM, RATING = "participant", "recording", "reducer", "item", "rating"

HEIGHT_CM = 7.5
WALKS = ((0, (5, 1.2)), (0, (2, 1)), (0, (5, 1, 1, 1)), (0, (1, 1)), (0, (8, 1.5)))
"""Line styles, for curves besides that of the study's own number."""


@dataclass(frozen=True, slots=True)
class PowerTask:
    """What is planned.

    effects: a row per hypothesis: attribute, metric, points per step of the metric, the step, and its source; share:
    one in so many participants rates each attribute.
    """

    design: PowerDesign
    truth: Truth
    effects: DataFrame
    name: str
    share: int = 1
    notes: tuple[str, ...] = ()


def set_up(
    study: StudyFolder,
    *,
    effects: Mapping[str, float] | Sequence[str] = (),
    pilot: str | Path | None = None,
    wanted: float = planted.ENOUGH,
    further: Further | None = None,
) -> PowerTask:
    """Set up the power analysis of a study; other slopes than those of `effects` are the simulated observers'.

    further: the metrics that the analysis declares and the manifest lacks.
    """
    wanted_effects = effects if isinstance(effects, Mapping) else _read_effects(effects)
    settings = read.read_settings(study.settings)
    if settings.session.recordings_per_participant:
        raise ValueError(
            f"{study.settings.name}: session.recordings_per_participant gives people different recordings, but power "
            "plans studies in which all rate the same ones; leave it out"
        )
    stimuli = read_stimuli(study.stimuli)
    sessions.require_current_set(study, settings)
    choosing = {name: levels for name, levels in settings.between.items() if name in CHOOSING}
    share = schema.count_groups(choosing)
    table = _tabulate_plan(settings, stimuli, groups=share, further=further)
    if not (rated := list(split_tests(table))):
        raise ValueError(
            "session.protocols ask for no rating of a single stimulus, so there is no slope to plan for; add realism "
            "or similarity"
        )
    slopes = _plant(settings, rated, steps=find_table_steps(table), effects=wanted_effects)
    metrics, attributes = (tuple(slopes[name].unique()) for name in ("metric", "attribute"))
    items = rated[0].rows[[SCENE, REDUCER, ITEM, *metrics]].drop_duplicates(ITEM)
    origin = rated[0].rows.drop_duplicates(SCENE).set_index(SCENE)["source"]
    if not origin.is_unique:
        items = items.assign(source=items[SCENE].map(origin))
    repeats = settings.session.repeats
    design = planted.PowerDesign(
        items, metrics, attributes, participants=PEOPLE, repeats=repeats, wanted=wanted
    )
    named = slopes["attribute"] + "/" + slopes["metric"]
    known = dict(zip(named, slopes["points"] / slopes["size"], strict=True))
    usual = {"slopes": known, **{name: getattr(settings.observer, name) for name in planted.SHARES}}
    truth, notes = planted.Truth(**usual), _list_notes(rated, slopes, share)
    if pilot is not None:
        given = _read_pilot(study, stimuli, pilot, further=further)
        name = "this study" if str(pilot) == OWN else Path(pilot).name
        truth = _fit_pilot(given, usual, name)
        if given.rows["simulated"].any():
            notes.append(f"{name}: ratings come from simulated participants, not from people.")
    return PowerTask(design, truth, slopes, settings.study.name, share, tuple(notes))


def _read_effects(texts: Sequence[str]) -> dict[str, float]:
    effects: dict[str, float] = {}
    for text in texts:
        name, _, points = text.rpartition("=")
        try:
            value = float(points)
        except ValueError:
            name, value = "", 0.0
        if not name or name in effects:
            fault = f"got {name!r} twice; give it once" if name else f"got {text!r}"
            raise UsageError(
                f"--effect must be METRIC=POINTS, such as temporal_match=1.5, once for each; {fault}"
            )
        effects[name] = value
    return effects


def _tabulate_plan(
    settings: Settings, stimuli: StimulusSet, *, groups: int, further: Further | None = None
) -> Table:
    """Tabulate what participants are asked to judge, one of each group; all ratings are 0."""
    design = read.make_design(settings)
    rows = []
    for number in range(1, groups + 1):
        who = f"sim{number:03d}"
        plan = plans.make_plan(design, stimuli, who, number=number, simulated=True)
        by_code = list_by_code(stimuli, seed=plan.seed)
        judged = [
            (one, two) for one in plan.trials if one.phase == "main" for two in one.judgements
        ]
        for one, judgement in judged:
            if (stimulus := by_code.get(judgement.stimulus_id)) is None:
                continue
            others = {
                "reference_id": judgement.reference_id,
                "other_id": find_other(one, judgement),
            }
            rows.append({
                WHO: who, "session": 1, "protocol": one.protocol, "block": one.block, "trial": one.number,
                "repeat": one.repeat, "stimulus_id": stimulus.stimulus_id, "recording": stimulus.recording,
                "reducer": stimulus.reducer, "level": stimulus.level, "scale": judgement.scale or one.scale,
                "rating": 0.0, "rejected": "false", "simulated": "true",
                **{k: by_code[v].stimulus_id if v in by_code else v or "" for k, v in others.items()},
            })  # fmt: skip
    return reading.read_table(
        DataFrame(rows), stimuli.to_frame(), metrics=settings.analysis.metrics,
        sources=read.list_origins(settings), further=further,
    )  # fmt: skip


def _list_notes(rated: Sequence[Part], slopes: DataFrame, share: int) -> list[str]:
    first, *others = dict.fromkeys(part.level for part in rated)
    said = {
        f"Metrics are those at level {first}; at {', '.join(others)} they are alike.": others,
        f"Each attribute is rated by one in {share} participants, as [between] says.": share > 1,
        "Slopes without --effect are those of the simulated observers in study.toml: better give the smallest "
        "slope that would matter to you.": (slopes["source"] != GIVEN).any(),
        "Before the first session, feel321 freeze writes down the hypotheses and the analysis, so that results can be "
        "told apart into confirmatory and exploratory ones.": True,
    }
    return [note for note, holds in said.items() if holds]


def _plant(
    settings: Settings,
    rated: Sequence[Part],
    *,
    steps: Mapping[str, Step],
    effects: Mapping[str, float],
) -> DataFrame:
    """Plant the slopes that are asked for, those of one scale last, and those of the observers elsewhere."""
    several = len({part.level for part in rated}) > 1
    attributes = [part.lead if several else part.scale for part in rated]
    chosen: dict[tuple[str, str], float] = {}
    for name in sorted(effects, key=lambda one: "/" in one):
        attribute, one_only, metric = name.rpartition("/")
        check_name(metric, steps, "effect, metric")
        if one_only:
            check_name(attribute, attributes, "effect, attribute")
        value = effects[name]
        if not isinstance(value, int | float | np.integer) or not abs(value) <= MOST_POINTS:
            raise ValueError(
                f"effect {name} must be from -{MOST_POINTS} to {MOST_POINTS} points, got {value!r}"
            )
        chosen |= {(one, metric): float(value) for one in ([attribute] if one_only else attributes)}
    asked, model = list(product(attributes, steps)), make_model(settings)
    felt = {model.spectral_metric: model.spectral, "temporal_match": model.temporal}
    return DataFrame([
        {
            "attribute": attribute, "metric": metric,
            "points": chosen.get((attribute, metric), felt.get(metric, 0.0) * steps[metric].size),
            "per": steps[metric].per, "size": steps[metric].size,
            "source": GIVEN if (attribute, metric) in chosen else OBSERVED,
        }
        for attribute, metric in asked
    ])  # fmt: skip


def _read_pilot(
    study: StudyFolder, stimuli: StimulusSet, pilot: str | Path, *, further: Further | None
) -> Table:
    """Read pilot ratings of the study's stimuli."""
    is_own = str(pilot) == OWN
    path = study.ratings if is_own else Path(pilot)
    if is_own and study.journals:
        ratings.write_ratings(study, stimuli)
    if not path.is_file():
        why = "no ratings yet" if is_own else "no such table of ratings"
        raise FileNotFoundError(f"{path}: {why}; --pilot takes a file, or {OWN}")
    metrics = read.read_settings(study.settings).analysis.metrics
    return reading.read_table(path, stimuli.to_frame(), metrics=metrics, further=further)


def _fit_pilot(table: Table, known: Mapping[str, Any], name: str) -> Truth:
    """Take the standard deviations of a pilot: the root mean square of those of all attributes."""
    rated = list(split_tests(table))
    if not rated:
        raise ValueError(f"{name}: holds no rating of a single test stimulus; give other ratings")
    metrics = list(dict.fromkeys(slope.split("/")[-1] for slope in known["slopes"]))
    found = []
    for part in rated:
        rows, changes = part.rows, dict(known)
        cells = rows.groupby([WHO, ITEM], observed=True)[RATING]
        if spare := len(rows) - cells.ngroups:
            squares = ((rows[RATING] - cells.transform("mean")) ** 2).sum()
            changes["rating_sd"] = float(np.sqrt(squares / spare))
        fit = fit_primary(rows, metrics, explain=False)
        repeats = round(len(rows) / cells.ngroups)
        found.append(planted.Truth.from_fit(fit, repeats=repeats, **changes))

    def pool(sds: Iterable[float]) -> float:
        return float(np.sqrt(np.mean(np.square(list(sds)))))

    pooled: dict[str, Any] = {
        field: pool(getattr(one, field) for one in found) for field in planted.SPREADS
    }
    for kind in ("slope_sds", "recording_slope_sds"):
        sds = [getattr(one, kind) for one in found]
        shared = sorted(set.intersection(*(set(one) for one in sds)))
        pooled[kind] = {metric: pool(one[metric] for one in sds) for metric in shared}
    people = len({who for part in rated for who in part.rows[WHO]})
    pooled["source"] = f"the primary model of {people} people's ratings in {name}"
    return replace(found[0], mean=float(np.mean([one.mean for one in found])), **pooled)


def plan_study(  # noqa: PLR0913 - the numbers that are compared; how many studies, who does them, who watches
    task: PowerTask,
    sizes: Mapping[str, Numbers],
    *,
    studies: int = 1000,
    seed: int = 0,
    keep: Path,
    workers: Workers,
    progress: Callable[[int, int], None],
) -> "StudyPower":
    """Compute the power of all designs, for the slope with the least power; sizes: by the names of `SIZES`."""
    factors = {name: _list_numbers(numbers, name) for name, numbers in sizes.items()}
    people, share = factors.get("participants", ()), task.share
    if odd := [one for one in people if one % share or one < FEWEST * share]:
        raise ValueError(
            f"participants must be {FEWEST * share} or more and multiples of {share}, the groups of [between] that "
            f"rate different things; got {odd[0]}"
        )
    factors["participants"] = tuple(one // share for one in people)
    near = min(factors["participants"] or (PEOPLE,), key=lambda number: abs(number - PEOPLE))
    design = replace(task.design, participants=near)
    aim = design.hypotheses[0] if not any(task.truth.slopes.values()) else None
    asked = task.effects[(task.effects["source"] == GIVEN) & (task.effects["points"] != 0)]
    if aim is None and not asked.empty:
        power = planning.find_power(design, task.truth, studies=0).table["power"]
        aim = design.hypotheses[power.loc[asked.index].sort_values(kind="stable").index[0]]
    make_folder(keep)
    plan = planning.plan_power(
        design, task.truth, **factors, hypothesis=aim, studies=studies, seed=seed, workers=workers, keep=keep,
        progress=progress,
    )  # fmt: skip
    return StudyPower(plan, task)


def _list_numbers(numbers: Numbers, what: str) -> tuple[int, ...]:
    listed = tuple(numbers) if isinstance(numbers, Iterable) else (numbers,)
    for one in listed:
        if not isinstance(one, int | np.integer) or one < 1:
            raise ValueError(f"{what} must be whole numbers of 1 or more, got {one!r}")
    return tuple(int(one) for one in listed)


@dataclass(frozen=True, slots=True, repr=False, eq=False)
class StudyPower(results.PageResult):
    """The power of a study, planned from its own settings and stimuli; its answer, tables and page."""

    plan: PowerPlan
    task: PowerTask
    path: Path = Path()

    @property
    def answer(self) -> str:
        """Which design is enough, its power and interval, in one sentence; or why none is."""
        row = self._find_row(self.plan.hypothesis)
        share = self.task.share
        return planning.describe_plan(self.plan, share=share, size=row["size"], per=row["per"])

    def to_frame(self) -> DataFrame:
        """Return the power of all designs: `PowerPlan.table`, and people: all who take part."""
        return self.plan.table.assign(people=self.plan.table["participants"] * self.task.share)

    def to_frames(self) -> dict[str, DataFrame]:
        """Return `designs`: the grid; `hypotheses`: of every simulated design; `planted`: the slopes."""
        tables = [one.table.assign(**one.design.sizes) for one in self.plan.powers]
        hypotheses = concat(tables, ignore_index=True)
        return {"designs": self.to_frame(), "planted": self.task.effects, "hypotheses": hypotheses}

    def summary(self) -> str:
        """Write the answer, a line per hypothesis, and the notes."""
        rows = self._list_hypotheses()
        lines = ["; ".join(f"{name}: {value}" for name, value in row.items()) for row in rows]
        return "\n".join([self.answer, *lines, *self.task.notes])

    def _find_row(self, hypothesis: tuple[str, str]) -> dict[str, Any]:
        """Find what is known of a hypothesis in the design that is shown, and what was planted."""
        place = self.plan.shown.design.hypotheses.index(hypothesis)
        effect = self.task.effects.iloc[place].to_dict().items()
        return planning.find_row(self.plan, hypothesis) | {str(name): one for name, one in effect}

    def _list_hypotheses(self) -> list[dict[str, str]]:
        """List what is said of each hypothesis in the design that is shown."""
        rows = []
        for row in map(self._find_row, self.plan.shown.design.hypotheses):
            size, unit = row["size"], f" points per {row['per']}"
            rows.append({
                "Hypothesis": f"{format_name(row['metric'])} on {format_name(row['attribute'])}",
                "Planted": f"{row['points']:.2g}{unit} ({row['source']})",
                "Power": planning.format_power(row["power"]), "Simulated": _format_simulated(row),
                "Detectable": _format(row["detectable"] * size, unit),
                "Interval": "± " + _format(row["width"] * size / 2, unit),
            })  # fmt: skip
        return rows

    def _list_designs(self) -> list[dict[str, str]]:
        step = self._find_row(self.plan.hypothesis)
        return [
            {
                **{name.capitalize(): str(row[name]) for name in ("people", *SIZES[1:], "trials")},
                "Power": planning.format_power(row["power"]), "Simulated": _format_simulated(row),
                "At most": planning.format_power(row["ceiling"]),
                f"Detectable, points per {step['per']}": _format(step["size"] * row["detectable"]),
                "Enough": "recommended" if row["recommended"] else "yes" if row["enough"] else "no",
            }
            for row in self.to_frame().to_dict("records")
        ]  # fmt: skip

    def _make_page(self, tables: Mapping[str, DataFrame]) -> results.PageParts:
        plan, shown, own = self.plan, self.plan.shown, self.plan.powers[0].design
        powers = [
            one.design.sizes | {"studies": one.studies, "hypotheses": one.table.to_dict("records")}
            for one in plan.powers
        ]
        content = {
            "version": __version__, "study": self.task.name, "answer": self.answer, "verdict": plan.verdict,
            "wanted": plan.wanted, "hypothesis": list(plan.hypothesis), "share": self.task.share,
            "recommended": plan.recommended and plan.recommended.sizes,
            "designs": tables["designs"].to_dict("records"), "powers": powers,
            "planted": self.task.effects.to_dict("records"), "truth": asdict(shown.truth), "seed": shown.seed,
            "notes": list(dict.fromkeys([*self.task.notes, *plan.notes])),
        }  # fmt: skip
        # Of the smallest designs that are enough, which may need hundreds of people, only the recommended one is drawn.
        grid = tables["designs"]
        grid = grid[(grid["kind"] != "smallest") | grid["recommended"].astype(bool)]
        grid = grid[(grid["reducers"] == own.reducers) & (grid["repeats"] == own.repeats)]
        grid = grid.drop_duplicates(["participants", "recordings"])
        assumed = [
            {"In the truth": format_name(name), "Points or share": f"{value:.3g}"}
            for name, value in asdict(shown.truth).items()
            if isinstance(value, int | float)
        ]
        grids = {
            "hypotheses": self._list_hypotheses(), "designs": self._list_designs(), "assumed": assumed,
        }  # fmt: skip
        people = format_count(shown.design.participants * self.task.share, "participant")
        units = planning.describe_units(shown.design.recordings, shown.design.reducers)
        values = {
            "result": self, "content": content, "own": own.recordings, "shown": f"{people}, {units}",
            "grids": {
                name: {"head": [*rows[0]], "rows": [[*row.values()] for row in rows]}
                for name, rows in grids.items()
            },
        }  # fmt: skip
        drawing = partial(draw_power, grid, own.recordings, wanted=plan.wanted)
        picture = Picture("power", "Power against participants", drawing)
        return results.PageParts("power.html", content, [picture], values)


def _format_simulated(row: Mapping[Any, Any]) -> str:
    return planning.format_simulated(row) if isfinite(row["simulated"]) else ABSENT


def _format(value: float, unit: str = "") -> str:
    return f"{value:.2g}{unit}" if isfinite(value) else ABSENT


def draw_power(table: DataFrame, own: int, *, wanted: float) -> Figure:
    """Draw power against participants, a curve for each number of recordings; own: that of the study."""
    people = sorted(table["people"].unique())
    endless = people[-1] + 0.1 * max(people[-1] - people[0], 1)
    with style.print_style():
        figure, axes = style.new_figure(HEIGHT_CM)
        for place, number in enumerate(sorted(table["recordings"].unique())):
            rows = table[table["recordings"] == number].sort_values("people")
            is_own = bool(number == own)
            colour = style.BLACK if is_own else style.GREY
            walk = "-" if is_own else WALKS[place % len(WALKS)]
            name = f"{number} recordings{' (this study)' * is_own}"
            axes.plot(rows["people"], rows["power"], color=colour, linestyle=walk, label=name)
            seen = rows[rows["simulated"].notna()]
            axes.vlines(seen["people"], seen["simulated_low"], seen["simulated_high"], color=colour)
            dots = axes.plot(seen["people"], seen["simulated"], "o", color="white", zorder=5)
            dots[0].set_markeredgecolor(colour)
            end = rows.iloc[-1]
            limit = [end["people"], endless], [end["power"], end["ceiling"]]
            axes.plot(*limit, color=colour, linestyle=(0, (2, 2)), linewidth=style.THIN)
        axes.axhline(wanted, color=style.GREY, linewidth=style.THIN, zorder=1)
        axes.set(xlabel="Participants", ylabel="Power", ylim=(-0.02, 1.04))
        axes.set_yticks(np.arange(0, 1.01, 0.2))
        axes.set_xlim(right=endless)
        axes.grid(axis="y", color=style.PALE, linewidth=style.THIN)
        axes.set_axisbelow(True)
        ticks = people[:: max(1, len(people) // 8)]
        axes.set_xticks([*ticks, endless], [*map(str, ticks), "\N{INFINITY}"])
        axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
    return figure
