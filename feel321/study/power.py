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
from feel321.analysis import figures
from feel321.analysis.power import plan as planning
from feel321.analysis.power.design import ENOUGH, GROUPS, PowerDesign, Truth
from feel321.analysis.primary.model import fit_primary
from feel321.analysis.primary.plan import ITEM, RATING, REDUCER, SCENE, SOURCE, WHO
from feel321.analysis.report import folder as results
from feel321.analysis.report.section import Picture, find_table_steps
from feel321.analysis.table.items import Table, split_tests
from feel321.analysis.table.reading import Further, read_table
from feel321.analysis.words import format_name, render_words
from feel321.arguments import check_name
from feel321.jobs import Workers
from feel321.protocols.tasks import find_other
from feel321.protocols.trial import CHOOSING
from feel321.stimuli.sets.manifest import StimulusSet, read_stimuli
from feel321.study import ratings
from feel321.study.folder import StudyFolder, UsageError
from feel321.study.observer import make_model
from feel321.study.session.plan import list_by_code, make_plan
from feel321.study.settings import read, schema
from feel321.study.settings.read import list_origins
from feel321.study.settings.schema import Settings

Numbers = int | Sequence[int]
Row = dict[Any, Any]

OWN = "study"  # A pilot that is no file: the study's own ratings
PEOPLE = 16  # Raters of each attribute in the design around which others are compared
FEWEST = 3  # Raters of each attribute below which there is no model
MOST_POINTS = 100  # more than the whole scale per step of a metric is a slip
GIVEN, OBSERVED = "given", "simulated observers"  # where a slope comes from
HEIGHT_CM = 7.5
# Line styles, for curves besides that of the study's own number.
WALKS = ((0, (5, 1.2)), (0, (2, 1)), (0, (5, 1, 1, 1)), (0, (1, 1)), (0, (8, 1.5)))


@dataclass(frozen=True, slots=True)
class PowerTask:
    """What is planned; effects: a row per hypothesis; share: one in so many participants rates each attribute."""

    design: PowerDesign
    effects: DataFrame
    name: str
    share: int = 1
    notes: tuple[str, ...] = ()


def set_up(
    study: StudyFolder,
    *,
    effects: Mapping[str, float] | Sequence[str] = (),
    pilot: str | Path | None = None,
    wanted: float = ENOUGH,
    further: Further | None = None,
) -> PowerTask:
    """Set up the power analysis of a study; further: the metrics that the analysis declares and the manifest lacks."""
    settings = read.read_settings(study.settings)
    if settings.session.recordings_per_participant:
        raise ValueError(
            f"{study.settings.name}: session.recordings_per_participant gives people different recordings, but power "
            "plans studies in which all rate the same ones; leave it out"
        )
    stimuli = read_stimuli(study.stimuli)
    read.require_current_set(study, settings)
    choosing = {name: levels for name, levels in settings.between.items() if name in CHOOSING}
    share = schema.count_groups(choosing)
    table = _tabulate_plan(settings, stimuli, groups=share, further=further)
    asked = effects if isinstance(effects, Mapping) else _read_effects(effects)
    slopes = _plant(settings, table, asked)
    metrics, attributes = (tuple(slopes[name].unique()) for name in ("metric", "attribute"))
    rated = list(split_tests(table))
    rows = rated[0].rows
    shared = [] if rows.drop_duplicates(SCENE)[SOURCE].is_unique else [SOURCE]
    items = rows.drop_duplicates(ITEM)[[SCENE, REDUCER, ITEM, *shared, *metrics]]
    named = slopes["attribute"] + "/" + slopes["metric"]
    truth = Truth(dict(zip(named, slopes["points"] / slopes["size"], strict=True)))
    first, *others = dict.fromkeys(part.level for part in rated)
    said = {
        f"Metrics are those at level {first}; at {', '.join(others)} they are alike.": others,
        f"Each attribute is rated by one in {share} participants, as [between] says.": share > 1,
        "Slopes without --effect are those of the simulated observers in study.toml: better give the smallest "
        "slope that would matter to you.": (slopes["source"] != GIVEN).any(),
        "Before the first session, feel321 freeze writes down the hypotheses and the analysis, so that results can be "
        "told apart into confirmatory and exploratory ones.": True,
    }
    notes = [note for note, holds in said.items() if holds]
    if pilot is not None:
        is_own = str(pilot) == OWN
        path = study.ratings if is_own else Path(pilot)
        if is_own and study.journals:
            ratings.write_ratings(study, stimuli)
        if not path.is_file():
            why = "no ratings yet" if is_own else "no such table of ratings"
            raise FileNotFoundError(f"{path}: {why}; --pilot takes a file, or {OWN}")
        listed, declared = stimuli.to_frame(), settings.analysis.metrics
        given = read_table(path, listed, metrics=declared, further=further)
        name = "this study" if is_own else path.name
        truth = _fit_pilot(given, metrics, name=name, known=truth)
        if given.rows["simulated"].any():
            notes.append(f"{name}: ratings come from simulated participants, not from people.")
    design = PowerDesign(
        items.reset_index(drop=True), metrics, truth, attributes, PEOPLE, settings.session.repeats, wanted=wanted
    )  # fmt: skip
    return PowerTask(design, slopes, settings.study.name, share, tuple(notes))


def _tabulate_plan(
    settings: Settings, stimuli: StimulusSet, *, groups: int, further: Further | None = None
) -> Table:
    """Tabulate what participants are asked to judge, one of each group; all ratings are 0."""
    design = read.make_design(settings)
    rows = []
    for number in range(1, groups + 1):
        who = f"sim{number:03d}"
        plan = make_plan(design, stimuli, who, number=number, simulated=True)
        by_code = list_by_code(stimuli, seed=plan.seed)
        main = (trial for trial in plan.trials if trial.phase == "main")
        for trial, judgement in ((one, judged) for one in main for judged in one.judgements):
            if (stimulus := by_code.get(judgement.stimulus_id)) is None:
                continue
            compared = judgement.reference_id, find_other(trial, judgement)
            others = [by_code[one].stimulus_id if one in by_code else one or "" for one in compared]
            rows.append({
                WHO: who, "session": 1, "protocol": trial.protocol, "block": trial.block, "trial": trial.number,
                "repeat": trial.repeat, "stimulus_id": stimulus.stimulus_id, SCENE: stimulus.recording,
                REDUCER: stimulus.reducer, "level": stimulus.level, "scale": judgement.scale or trial.scale,
                RATING: 0.0, "rejected": "false", "simulated": "true",
                "reference_id": others[0], "other_id": others[1],
            })  # fmt: skip
    return read_table(
        DataFrame(rows), stimuli.to_frame(), metrics=settings.analysis.metrics,
        sources=list_origins(settings), further=further,
    )  # fmt: skip


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
            must = "METRIC=POINTS, such as temporal_match=1.5, once for each"
            raise UsageError(f"--effect must be {must}; {fault}")
        effects[name] = value
    return effects


def _plant(settings: Settings, table: Table, effects: Mapping[str, float]) -> DataFrame:
    """Plant the slopes that are asked for, those of one scale last, and those of the observers elsewhere."""
    if not (rated := list(split_tests(table))):
        raise ValueError(
            "session.protocols ask for no rating of a single stimulus, so there is no slope to plan for; add realism "
            "or similarity"
        )
    steps, several = find_table_steps(table), len({part.level for part in rated}) > 1
    attributes = [part.lead if several else part.scale for part in rated]
    chosen: dict[tuple[str, str], float] = {}
    for name in sorted(effects, key=lambda one: "/" in one):
        attribute, one_only, metric = name.rpartition("/")
        check_name(metric, steps, "effect, metric")
        if one_only:
            check_name(attribute, attributes, "effect, attribute")
        value = effects[name]
        if not isinstance(value, int | float | np.integer) or not abs(value) <= MOST_POINTS:
            must = f"from -{MOST_POINTS} to {MOST_POINTS} points"
            raise ValueError(f"effect {name} must be {must}, got {value!r}")
        chosen |= {(one, metric): float(value) for one in ([attribute] if one_only else attributes)}
    model = make_model(settings)
    felt = {model.spectral_metric: model.spectral, "temporal_match": model.temporal}
    return DataFrame([
        {
            "attribute": attribute, "metric": metric,
            "points": chosen.get((attribute, metric), felt.get(metric, 0.0) * steps[metric].size),
            "per": steps[metric].per, "size": steps[metric].size,
            "source": GIVEN if (attribute, metric) in chosen else OBSERVED,
        }
        for attribute, metric in product(attributes, steps)
    ])  # fmt: skip


def _fit_pilot(table: Table, metrics: Sequence[str], *, name: str, known: Truth) -> Truth:
    """Take the mean and standard deviations of a pilot: the root mean square of those of all attributes.

    The residual of a model of means holds what a person thinks of a stimulus, and what averaging leaves of repeats;
    where nothing was rated twice, all of it is taken for the first.
    """
    if not (rated := list(split_tests(table))):
        raise ValueError(f"{name}: holds no rating of a single test stimulus; give other ratings")
    # Slopes differ between sources, where several recordings come from one.
    groups = {"people": [WHO], "recordings": [SCENE, SOURCE]}
    means, found = [], []
    for rows in (part.rows for part in rated):
        cells = rows.groupby([WHO, ITEM], observed=True)[RATING]
        spare, repeats = len(rows) - cells.ngroups, round(len(rows) / cells.ngroups)
        squares = float(((rows[RATING] - cells.transform("mean")) ** 2).sum())
        rating_sd = np.sqrt(squares / spare) if spare else 0.0
        model = fit_primary(rows, metrics, explain=False)
        spreads = model.fit.variances.set_index(["group", "term"])["sd"].to_dict()
        own, residual = spreads.get((f"{WHO}:{ITEM}", "(Intercept)")), model.fit.residual_sd
        if own is None:
            own = np.sqrt(max(residual**2 - rating_sd**2 / repeats, 0.0))
        elif not spare:
            rating_sd = residual
        means.append(model.model_frame[RATING].mean())
        found.append({
            **{field: spreads.get((group, "(Intercept)"), 0.0) for field, group in GROUPS.items()},
            "person_item_sd": own, "rating_sd": rating_sd,
            **{
                f"{whose}/{one}": max(spreads.get((group, f"{one}_w"), 0.0) for group in own_groups)
                for whose, own_groups in groups.items() for one in model.slopes.index
            },
        })  # fmt: skip
    pooled: Row = np.sqrt((DataFrame(found).dropna(axis=1) ** 2).mean()).to_dict()
    people_sds, scene_sds = (
        {one: pooled.pop(f"{whose}/{one}") for one in metrics if f"{whose}/{one}" in pooled}
        for whose in groups
    )
    people = len({who for part in rated for who in part.rows[WHO]})
    return replace(
        known, mean=float(np.mean(means)), source=f"the primary model of {people} people's ratings in {name}",
        slope_sds=people_sds, recording_slope_sds=scene_sds, **pooled,
    )  # fmt: skip


def plan_study(
    task: PowerTask,
    sizes: Mapping[str, Numbers],
    *,
    studies: int = 1000,
    seed: int = 0,
    workers: Workers,
    progress: Callable[[int, int], None],
) -> "StudyPower":
    """Compute the power of all designs, for the slope with the least power; sizes: by the names of `SIZES`."""
    if studies < 0:
        raise ValueError(f"studies must be 0 or more, got {studies}; give 1000")
    factors: dict[str, tuple[int, ...]] = {}
    for name, given in sizes.items():
        factors[name] = tuple(given) if isinstance(given, Iterable) else (given,)
        for one in factors[name]:
            if not isinstance(one, int | np.integer) or one < 1:
                raise ValueError(f"{name} must be whole numbers of 1 or more, got {one!r}")
    people, share = factors.get("participants", ()), task.share
    if odd := [one for one in people if one % share or one < FEWEST * share]:
        raise ValueError(
            f"participants must be {FEWEST * share} or more and multiples of {share}, the groups of [between] that "
            f"rate different things; got {odd[0]}"
        )
    factors["participants"] = tuple(one // share for one in people)
    near = min(factors["participants"] or (PEOPLE,), key=lambda number: abs(number - PEOPLE))
    planted = task.effects.index[task.effects["points"] != 0]
    asked = [place for place in planted if task.effects.loc[place, "source"] == GIVEN]
    run, whole = 0, planning.TRIED + 1

    def simulate(design: PowerDesign) -> np.ndarray:
        nonlocal run
        done, run = min(run, planning.TRIED), run + 1
        return planning.simulate_studies(
            design, studies=studies, seed=seed, workers=workers,
            progress=lambda part, parts: progress(done * parts + part, whole * parts),
        )  # fmt: skip

    plan = planning.plan_power(
        replace(task.design, participants=near), factors, aims=asked or list(planted) or [0],
        simulate=simulate if studies else None,
    )  # fmt: skip
    return StudyPower(plan, task, seed)


@dataclass(frozen=True, slots=True, repr=False, eq=False)
class StudyPower(results.PageResult):
    """The power of a study, planned from its own settings and stimuli; its answer, tables and page."""

    plan: planning.PowerPlan
    task: PowerTask
    seed: int = 0
    path: Path = Path()

    @property
    def answer(self) -> str:
        """Which design is enough, its power and interval, in one sentence; or why none is."""
        plan, table, share = self.plan, self.plan.table, self.task.share
        design, row = plan.shown.design, self._find_row(plan.hypothesis)
        best = table.sort_values("ceiling", na_position="first").iloc[-1]
        tried = table[table["kind"] != "smallest"]
        refuted = table[table["enough"] & table["refuted"]]
        most = {planning.CEILING: best["ceiling"], planning.REFUTED: refuted["simulated"].max()}
        detectable = row["detectable"] * row["size"]
        return " ".join(render_words(
            "power", verdict=plan.verdict, lack=plan.lack,
            what=f"{format_name(row['metric'])} on {format_name(row['attribute'])}",
            slope=f"{row['slope'] * row['size']:.2g}", per=row["per"],
            power=planning.format_simulated(row, planning.format_power(row["power"])),
            most=planning.format_power(float(most.get(plan.verdict, tried["power"].max()))),
            people=design.participants * share, units=planning.describe_units(design.recordings, design.reducers),
            repeats=design.repeats, tried=len(refuted), largest=int(tried["participants"].max()) * share,
            needed=row["recordings_needed"] if isfinite(row["recordings_needed"]) else 0,
            detectable=f"{detectable:.2g}" if isfinite(detectable) else "",
            best_units=planning.describe_units(int(best["recordings"]), int(best["reducers"])),
        ))  # fmt: skip

    def to_frame(self) -> DataFrame:
        """Return the power of all designs: `PowerPlan.table`, and people: all who take part."""
        return self.plan.table.assign(people=self.plan.table["participants"] * self.task.share)

    def to_frames(self) -> dict[str, DataFrame]:
        """Return `designs`: the grid; `hypotheses`: of every simulated design; `planted`: the slopes."""
        tables = [one.table.assign(**one.design.sizes) for one in self.plan.powers]
        hypotheses = concat(tables, ignore_index=True)
        return {"designs": self.to_frame(), "planted": self.task.effects, "hypotheses": hypotheses}

    def summary(self) -> str:
        """Write the answer, and the notes on what was planted."""
        return "\n".join([self.answer, *self.task.notes])

    def _find_row(self, hypothesis: tuple[str, str]) -> Row:
        """Find what is known of a hypothesis in the design that is shown, and what was planted."""
        power = self.plan.shown
        place = power.design.hypotheses.index(hypothesis)
        return {**power.table.iloc[place].to_dict(), **self.task.effects.iloc[place].to_dict()}

    def _make_page(self, tables: Mapping[str, DataFrame]) -> results.PageParts:
        plan, task, own = self.plan, self.task, self.plan.powers[0].design
        content = {
            "version": __version__, "study": task.name, "answer": self.answer, "verdict": plan.verdict,
            "wanted": own.wanted, "hypothesis": list(plan.hypothesis), "share": task.share,
            "recommended": plan.recommended and plan.recommended.sizes,
            "designs": tables["designs"].to_dict("records"), "powers": [
                one.design.sizes | {"studies": one.studies, "hypotheses": one.table.to_dict("records")}
                for one in plan.powers
            ],
            "planted": task.effects.to_dict("records"), "truth": asdict(own.truth), "seed": self.seed,
            "notes": list(dict.fromkeys([*task.notes, *plan.notes])),
        }  # fmt: skip
        steps = task.effects.drop_duplicates("metric").set_index("metric")
        slope_sds = [
            (f"slopes of {whose} on {format_name(name)}, per {step.per}", sd * step.size)
            for whose, sds in zip(("people", "recordings"), own.slope_sds, strict=True)
            for name, sd in zip(own.metrics, sds, strict=True)
            for step in [steps.loc[name]]
        ]
        values = {
            "content": content, "slope_sds": slope_sds, "own": own.recordings, "shown": plan.shown.design,
            "step": self._find_row(plan.hypothesis),
            "hypotheses": [self._find_row(one) for one in plan.shown.design.hypotheses],
            "power": planning.format_power, "simulated": planning.format_simulated, "units": planning.describe_units,
        }  # fmt: skip
        # Of the smallest designs that are enough, which may need hundreds of people, only the recommended one is drawn.
        grid = tables["designs"]
        grid = grid[(grid["kind"] != "smallest") | grid["recommended"].astype(bool)]
        grid = grid[(grid["reducers"] == own.reducers) & (grid["repeats"] == own.repeats)]
        grid = grid.drop_duplicates(["participants", "recordings"])
        drawing = partial(draw_power, grid, own.recordings, wanted=own.wanted)
        picture = Picture("power", "Power against participants", drawing)
        return "power.html", content, [picture], values


def draw_power(table: DataFrame, own: int, *, wanted: float) -> Figure:
    """Draw power against participants, a curve for each number of recordings; own: that of the study."""
    people = sorted(table["people"].unique())
    endless = people[-1] + 0.1 * max(people[-1] - people[0], 1)
    with figures.print_style():
        figure, axes = figures.new_figure(HEIGHT_CM)
        for place, number in enumerate(sorted(table["recordings"].unique())):
            rows = table[table["recordings"] == number].sort_values("people")
            is_own = bool(number == own)
            colour = figures.BLACK if is_own else figures.GREY
            walk = "-" if is_own else WALKS[place % len(WALKS)]
            name = f"{number} recordings{' (this study)' * is_own}"
            axes.plot(rows["people"], rows["power"], color=colour, linestyle=walk, label=name)
            seen = rows[rows["simulated"].notna()]
            axes.vlines(seen["people"], seen["simulated_low"], seen["simulated_high"], color=colour)
            axes.plot(seen["people"], seen["simulated"], "o", color="white", mec=colour, zorder=5)
            end = rows.iloc[-1]
            limit = [end["people"], endless], [end["power"], end["ceiling"]]
            axes.plot(*limit, color=colour, linestyle=(0, (2, 2)), linewidth=figures.THIN)
        axes.axhline(wanted, color=figures.GREY, linewidth=figures.THIN, zorder=1)
        axes.set(xlabel="Participants", ylabel="Power", ylim=(-0.02, 1.04), xlim=(None, endless))
        axes.set_yticks(np.arange(0, 1.01, 0.2))
        axes.grid(axis="y", color=figures.PALE, linewidth=figures.THIN)
        axes.set_axisbelow(True)
        ticks = people[:: max(1, len(people) // 8)]
        axes.set_xticks([*ticks, endless], [*map(str, ticks), "\N{INFINITY}"])
        axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
    return figure
