"""From `study.toml` and the stimulus set to a power analysis: design, planted truth, minutes per session."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from pandas import DataFrame

from feel321.analysis.power import design as records
from feel321.analysis.power import find
from feel321.analysis.power import plan as planning
from feel321.analysis.report import parts
from feel321.analysis.screening.rules import RULES
from feel321.analysis.table import reading
from feel321.doors import announce, check_name
from feel321.files import make_folder
from feel321.protocols import trial
from feel321.stimuli.sets import build, manifest
from feel321.study import minutes, provenance, ratings
from feel321.study.metrics import measure_declared
from feel321.study.observer import casting
from feel321.study.observer.participant import SPECTRAL
from feel321.study.power import assume, lengths, page, whole
from feel321.study.settings import read, schema

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from feel321.analysis.power.design import Power, PowerDesign, PowerPlan, Truth
    from feel321.analysis.report.parts import RatingsPart
    from feel321.analysis.table.metrics import Step
    from feel321.jobs import Workers
    from feel321.stimuli.sets.manifest import StimulusSet
    from feel321.study.folder import StudyFolder
    from feel321.study.settings.schema import Settings

    Progress = Callable[[int, int], None]

OWN, OBSERVERS = "study", "observers"
"""Pilots that are no file: the study's own ratings, and those of its simulated observers."""

SAMPLE = 48
"""Simulated observers from whose ratings their standard deviations are estimated."""

PEOPLE = 16
"""Raters of each attribute in the design around which others are compared."""

MOST_POINTS = 100
"""More than the whole scale per step of a metric is a slip."""

WHO, SCENE, REDUCER, ITEM = "participant", "recording", "reducer", "item"


@dataclass(frozen=True, slots=True)
class PowerTask:
    """What is planned.

    paper: the study itself, one participant of each group; share: one in so many participants rates each attribute;
    lengths: of sessions, by recordings, reducers and repeats, as far as they are known.
    """

    design: PowerDesign
    truth: Truth
    effects: assume.Effects
    paper: whole.PaperStudy
    share: int = 1
    pace: minutes.Pace = field(default_factory=minutes.Pace)
    notes: tuple[str, ...] = ()
    lengths: dict[tuple[int, int, int], minutes.Length] = field(default_factory=dict)

    def measure_length(self, design: PowerDesign) -> minutes.Length:
        """Measure how long a session of a design takes, whatever the number of participants."""
        key = design.recordings, design.reducers, design.repeats
        if key not in self.lengths:
            paper = self.paper
            self.lengths[key] = lengths.measure_sessions(
                read.make_design(paper.settings, paper.folder),
                paper.stimuli,
                design,
                groups=self.share,
                pace=self.pace,
            )
        return self.lengths[key]

    def find_minutes(self, design: PowerDesign) -> float:
        """Find the minutes of the longest group's session; NaN where no such session can be made."""
        try:
            return self.measure_length(design).high_min
        except ValueError:  # such as a page of more stimuli than MUSHRA allows
            return float("nan")


def set_up(
    study: StudyFolder,
    *,
    effects: Mapping[str, float] | None = None,
    pilot: str | Path | None = None,
    pilot_manifest: Path | None = None,
    screening: Sequence[str] = (),
    wanted: float = records.ENOUGH,
) -> PowerTask:
    """Set up the power analysis of a study.

    effects: metric, or attribute/metric -> points per step of the metric; others are as simulated observers plant them.
    pilot: a table of ratings, `study` or `observers`; the usual standard deviations if left out.
    """
    for name in screening:
        check_name(name, RULES, "screening")
    settings = read.read_settings(study.settings)
    if settings.session.recordings_per_participant:
        raise ValueError(
            f"{study.settings.name}: session.recordings_per_participant gives people different recordings, but power "
            "plans studies in which all rate the same ones; leave it out"
        )
    stimuli = _open_stimuli(study, settings)
    further = measure_declared(study, settings) if study.manifest.exists() else None
    choosing = {name: levels for name, levels in settings.between.items() if name in trial.CHOOSING}
    share = schema.count_groups(choosing)
    paper = whole.PaperStudy.draw(
        settings,
        study.path,
        stimuli,
        participants=share,
        further=further,
        screening=tuple(screening),
    )
    rated, found = _plant(paper, effects or {})
    own = _make_design(rated, found, paper)
    own = replace(own, wanted=wanted)
    truth, notes = _find_truth(study, paper, found, pilot=pilot, listed=pilot_manifest)
    pace = minutes.read_pace(study, stimuli)
    return PowerTask(own, truth, found, paper, share, pace, (*_note_levels(rated), *notes))


def split_expected(
    paper: whole.PaperStudy,
) -> tuple[list[RatingsPart], DataFrame, Mapping[str, Step]]:
    """Split mean ratings by attribute; also their slopes in points per step of each metric, and these steps."""
    table = paper.tabulate(paper.simulate(0, expected=True))
    rated = list(parts.split_parts(table))
    if not rated:
        names = ", ".join(paper.settings.session.protocols)
        raise ValueError(
            f"session.protocols ({names}) ask for no rating of a single stimulus, so there is no slope to plan for; "
            "add realism or similarity"
        )
    steps = parts.find_table_steps(table)
    return rated, whole.regress_expected(rated, steps).set_axis(_name_attributes(rated)), steps


def _open_stimuli(study: StudyFolder, settings: Settings) -> StimulusSet:
    """Read the stimulus set; where none is built, measure what it would hold and write nothing."""
    if study.manifest.exists():
        provenance.require_current_set(study, settings)
        return manifest.read_stimuli(study.stimuli)
    recordings = read.open_recordings(settings, study.path)
    recipe = read.make_recipe(settings, study.path)
    foreseen = build.foresee_stimuli(recordings, study.stimuli, recipe=recipe)
    crop_s = settings.stimuli.conditioning.crop_s
    lengths = {one.name: crop_s[1] - crop_s[0] if crop_s else one.duration_s for one in recordings}
    rows = tuple(_foresee(one, lengths[one.recording], recipe.rate_hz) for one in foreseen)
    return manifest.StimulusSet(study.stimuli, rows, whole.UNBUILT)


def _foresee(one: build.Foreseen, duration_s: float, rate_hz: float) -> manifest.Stimulus:
    """Describe a stimulus that is not built as the manifest would."""
    measured = one.measured
    return manifest.Stimulus(
        stimulus_id=one.stimulus_id, recording=one.recording, reducer=one.reducer, level=one.level, role=one.role,
        file=f"{one.stimulus_id}.wav", rate_hz=rate_hz, n_samples=round(duration_s * rate_hz), duration_s=duration_s,
        peak=one.peak_m_s2, rms_m_s2=1.0, gain=one.gain, spectral_match=measured.spectral_match,
        temporal_match=measured.temporal_match, clipped=0, sha256="", recording_sha256="",
        spectral_match_bounded=measured.spectral_match_bounded,
        temporal_match_windowed=measured.temporal_match_windowed,
        metrics={name: np.nan if value is None else value for name, value in measured.metrics.items()},
    )  # fmt: skip


def _name_attributes(rated: Sequence[RatingsPart]) -> list[str]:
    """Name attributes by their scale, and by the level where there are several."""
    several = len({part.level for part in rated}) > 1
    return [part.lead if several else part.scale for part in rated]


def _make_design(
    rated: Sequence[RatingsPart], effects: assume.Effects, paper: whole.PaperStudy
) -> PowerDesign:
    """Make the design of the study itself, with a usual number of people who rate each attribute."""
    metrics = tuple(effects.steps)
    items = rated[0].rows[[SCENE, REDUCER, ITEM, *metrics]].drop_duplicates(ITEM)
    origin = rated[0].rows.drop_duplicates(SCENE).set_index(SCENE)["source"]
    if not origin.is_unique:
        items = items.assign(source=items[SCENE].map(origin))
    return records.PowerDesign(
        items, metrics, tuple(effects.points.index), participants=PEOPLE,
        repeats=paper.settings.session.repeats, screening=paper.screening,
    )  # fmt: skip


def _note_levels(rated: Sequence[RatingsPart]) -> list[str]:
    levels = list(dict.fromkeys(part.level for part in rated))
    if len(levels) == 1:
        return []
    return [f"Metrics are those at level {levels[0]}; at {', '.join(levels[1:])} they are alike."]


# What is planted.


def _plant(
    paper: whole.PaperStudy, effects: Mapping[str, float]
) -> tuple[list[RatingsPart], assume.Effects]:
    """Plant the slopes that are asked for, those of one scale last, and those of the observers elsewhere."""
    rated, felt, steps = split_expected(_leave_percepts(paper))
    points = felt * np.nan
    for name in sorted(effects, key=lambda one: "/" in one):
        attribute, one_only, metric = name.rpartition("/")
        check_name(metric, steps, "effect, metric")
        if one_only:
            check_name(attribute, list(points.index), "effect, attribute")
        points.loc[attribute or points.index, metric] = _check_points(name, effects[name])
    if points.isna().any(axis=None):
        points = points.fillna(_find_felt(paper, points, steps))
    return rated, assume.Effects(points, steps, tuple(effects))


def _check_points(name: str, value: float) -> float:
    if not isinstance(value, int | float | np.integer) or not abs(value) <= MOST_POINTS:
        raise ValueError(
            f"effect {name} must be from -{MOST_POINTS} to {MOST_POINTS} points, got {value!r}"
        )
    return float(value)


def _leave_percepts(paper: whole.PaperStudy) -> whole.PaperStudy:
    """Let observers feel only what is known before the set is built."""
    plain = paper.settings.observer.model_copy(update=dict.fromkeys(whole.PERCEIVED, 0.0))
    return replace(paper, settings=paper.settings.model_copy(update={"observer": plain}))


def _find_felt(paper: whole.PaperStudy, points: DataFrame, steps: Mapping[str, Step]) -> DataFrame:
    """Find the slopes that observers feel, before the ends of the scale; 0 for metrics that they do not feel.

    Those of observers who feel more than the two matches are regressed on the ratings expected of them.
    """
    model = casting.make_model(paper.settings)
    if model.uses_percepts:
        return split_expected(paper)[1]
    felt = {model.spectral_metric: model.spectral, "temporal_match": model.temporal}
    found = {name: felt.get(name, 0.0) * step.size for name, step in steps.items()}
    return DataFrame(found, index=points.index)


def _find_truth(
    study: StudyFolder,
    paper: whole.PaperStudy,
    effects: assume.Effects,
    *,
    pilot: str | Path | None,
    listed: Path | None,
) -> tuple[Truth, list[str]]:
    """Put together slopes and standard deviations, and say where these come from."""
    own = paper.settings.observer
    shares = {name: getattr(own, name) for name in records.SHARES}
    known: dict[str, Any] = {"slopes": effects.to_slopes(), **shares}
    if pilot is None:
        return records.Truth(**known), []
    if str(pilot) == OBSERVERS:
        truth = assume.fit_truths(split_observers(paper, len(paper.plans)), known)
        source = f"{SAMPLE} simulated observers"
        return replace(truth, source=source), [
            "The standard deviations are those of simulated observers, who are not people: plan a real study with "
            "those of a pilot, or with the usual ones."
        ]
    rated, simulated = _split_pilot(study, paper, pilot, listed=listed)
    truth = assume.fit_truths(rated, known)
    people = len({who for part in rated for who in part.rows[WHO]})
    what = "this study" if str(pilot) == OWN else Path(pilot).name
    notes = [f"{what}: ratings come from simulated participants, not from people."] * simulated
    return replace(truth, source=f"the primary model of {people} people's ratings in {what}"), notes


def split_observers(paper: whole.PaperStudy, share: int) -> list[RatingsPart]:
    """Simulate a large study, with two repeats at least, which tell noise from taste."""
    settings = paper.settings
    session = settings.session.model_copy(update={"repeats": max(2, settings.session.repeats)})
    large = whole.PaperStudy.draw(
        settings.model_copy(update={"session": session}), paper.folder, paper.stimuli,
        participants=SAMPLE * share, further=paper.further,
    )  # fmt: skip
    return large.split(large.simulate(settings.study.seed))


def _split_pilot(
    study: StudyFolder, paper: whole.PaperStudy, pilot: str | Path, *, listed: Path | None
) -> tuple[list[RatingsPart], bool]:
    """Read pilot ratings, of the study's own stimuli or of others; and whether simulated participants gave them."""
    path = Path(pilot)
    if str(pilot) == OWN:
        path = study.ratings
        if study.journals:
            ratings.write_ratings(study, paper.stimuli)
        if not path.is_file():
            raise FileNotFoundError(
                f"{path}: no ratings yet; give a file with --pilot, or leave it out"
            )
    if not path.is_file():
        raise FileNotFoundError(
            f"{path}: no such table of ratings; --pilot takes a file, {OWN} or {OBSERVERS}"
        )
    table = reading.read_table(
        path,
        paper.stimuli.to_frame() if listed is None else listed,
        metrics=paper.settings.analysis.metrics,
        further=paper.further if listed is None else None,
    )
    rated = list(parts.split_parts(table))
    if not rated:
        raise ValueError(f"{path}: holds no rating of a single test stimulus; give other ratings")
    return rated, bool(table.rows["simulated"].any())


# The plan, and whole studies beside it.

KEPT = ".studies"
"""Folder, in that of the results, of simulated studies: an interrupted call is continued from there."""

FEWEST = 3
"""Raters of each attribute, without whom there is no model."""

FACTORS = ("participants", "recordings", "reducers", "repeats")


@dataclass(frozen=True, slots=True)
class Sizes:
    """The numbers that are compared, those of `plan_power` where nothing is said, and how well.

    hypothesis: attribute/metric; whole: number of whole studies.
    """

    participants: int | Sequence[int] = ()
    recordings: int | Sequence[int] = ()
    reducers: int | Sequence[int] = ()
    repeats: int | Sequence[int] = ()
    hypothesis: str = ""
    studies: int = 1000
    whole: int = 0
    seed: int = 0

    def __post_init__(self) -> None:
        """Refuse what is no number of anything."""
        for name in FACTORS:
            _as_numbers(getattr(self, name), name)
        for name in ("studies", "whole"):
            if getattr(self, name) < 0:
                raise ValueError(f"{name} must be 0 or more, got {getattr(self, name)}")

    def list_factors(self, share: int) -> dict[str, tuple[int, ...]]:
        """List the numbers of each factor; participants become those who rate each attribute."""
        numbers = {name: _as_numbers(getattr(self, name), name) for name in FACTORS}
        people = numbers["participants"]
        if odd := [number for number in people if number % share]:
            raise ValueError(
                f"participants must be multiples of {share}, the groups of [between] that rate different things; got "
                f"{odd[0]}"
            )
        if few := [number for number in people if number < FEWEST * share]:
            raise ValueError(f"participants must be {FEWEST * share} or more, got {few[0]}")
        return numbers | {"participants": tuple(one // share for one in people)}


NO_MODEL = "None of {studies} whole studies has a model: {screened} participants screened out, {failed} models fail."


def _as_numbers(numbers: int | Sequence[int], what: str) -> tuple[int, ...]:
    """List numbers, or the only one."""
    listed = tuple(numbers) if isinstance(numbers, Iterable) else (numbers,)
    for one in listed:
        if not isinstance(one, int | np.integer) or one < 1:
            raise ValueError(f"{what} must be whole numbers of 1 or more, got {one!r}")
    return tuple(int(one) for one in listed)


def plan_study(
    task: PowerTask, sizes: Sizes, *, keep: Path, workers: Workers, progress: Progress
) -> page.StudyPower:
    """Compute the power of all designs, and run whole studies where they are asked for."""
    factors = sizes.list_factors(task.share)
    near = min(factors["participants"] or (PEOPLE,), key=lambda number: abs(number - PEOPLE))
    make_folder(keep)
    how: dict[str, Any] = {"seed": sizes.seed, "workers": workers, "keep": keep}
    known: dict[str, Any] = {**factors, **how}
    plan = planning.plan_power(
        task.design.change(participants=near), task.truth, **known,
        hypothesis=_find_hypothesis(task, sizes.hypothesis, near), minutes=task.find_minutes, studies=sizes.studies,
        progress=progress,
    )  # fmt: skip
    if not plan.powers:
        plan = replace(plan, powers=_find_closed(task, plan, near))
    name, effects = task.paper.settings.study.name, tabulate_effects(task)
    found = page.StudyPower(plan, name, effects, task.share, DataFrame(), tuple(_list_notes(task)))
    if not sizes.whole:
        return found
    beside = check_whole(task, found.shown.design, sizes, how=how, progress=progress)
    lost = [] if beside["tests"].any() else [NO_MODEL.format(**beside.iloc[0])]
    return replace(found, whole=beside, notes=(*found.notes, *lost))


def _find_closed(task: PowerTask, plan: PowerPlan, participants: int) -> tuple[Power, ...]:
    """Find the closed form of the given design and of the recommended one."""
    given = task.design.change(participants=participants)
    return tuple(
        find.find_power(one, task.truth, studies=0) for one in (given, plan.recommended) if one
    )


def _find_hypothesis(task: PowerTask, name: str, participants: int) -> tuple[str, str] | None:
    """Find the hypothesis of a name, or the one with the least power among those whose slope was given.

    None, for the one with the least power of all, where no slope was given.
    """
    known = {"/".join(one): one for one in task.design.hypotheses}
    if name:
        return known[check_name(name, known, "hypothesis")]
    if not any(task.truth.slopes.values()):
        return task.design.hypotheses[0]
    table = find.find_power(
        task.design.change(participants=participants), task.truth, studies=0
    ).table
    given = np.array([task.effects.is_given(*one) for one in task.design.hypotheses])
    asked = table[given & (table["slope"] != 0)].sort_values("power", kind="stable")
    return None if asked.empty else (asked["attribute"].iloc[0], asked["metric"].iloc[0])


def tabulate_effects(task: PowerTask) -> DataFrame:
    """List what is planted, a row per hypothesis."""
    effects, rows = task.effects, []
    for (attribute, metric), slope in zip(
        task.design.hypotheses, effects.to_slopes().values(), strict=True
    ):
        step, said = effects.steps[metric], effects.is_given(attribute, metric)
        rows.append({
            "attribute": attribute, "metric": metric, "points": slope * step.size, "per": step.per, "size": step.size,
            "source": "given" if said else "simulated observers",
        })  # fmt: skip
    return DataFrame(rows)


def _list_notes(task: PowerTask) -> list[str]:
    notes = list(task.notes)
    if task.share > 1:
        notes.append(
            f"Each attribute is rated by one in {task.share} participants, as [between] says."
        )
    if not all(task.effects.is_given(*one) for one in task.design.hypotheses):
        notes.append(
            "Slopes without --effect are those of the simulated observers in study.toml: better give the smallest "
            "slope that would matter to you."
        )
        if casting.make_model(task.paper.settings).uses_percepts:
            notes.append(
                "They are taken from mean ratings, after the ends of the scale, and the simulation has these ends "
                "once more: power is a little too low."
            )
    pace = task.pace.participants
    who = f"{pace} participants so far" if pace else "simulated participants"
    return [*notes, f"Minutes are those of one session, at the pace of {who}."]


def check_whole(
    task: PowerTask, shown: PowerDesign, sizes: Sizes, *, how: dict[str, Any], progress: Progress
) -> DataFrame:
    """Compare whole studies with the fast simulation of the same observers: a row per hypothesis.

    The study has its own recordings and reducers, and as many participants and repeats as the design that is shown.
    """
    paper = _plant_observers(task, shown)
    announce(f"{sizes.whole} whole studies")
    wholes = whole.run_wholes(paper, sizes.whole, progress=progress, **how)
    rated, points, steps = split_expected(paper)
    truth = assume.fit_truths(
        split_observers(paper, task.share), {"slopes": assume.Effects(points, steps).to_slopes()}
    )
    fast = find.find_power(
        task.design.change(participants=shown.participants, repeats=shown.repeats),
        replace(truth, bounded=False, source=f"{SAMPLE} simulated observers"),
        studies=max(sizes.studies, 1), **how,
    )  # fmt: skip
    names = {part.lead: str(name) for part, name in zip(rated, points.index, strict=True)}
    return whole.compare(wholes, fast.table, names)


def _plant_observers(task: PowerTask, shown: PowerDesign) -> whole.PaperStudy:
    """Plan the study for observers who feel the planted slopes."""
    paper, effects = task.paper, task.effects
    settings = paper.settings
    spectral = next((name for name in effects.steps if name in SPECTRAL), SPECTRAL[0])
    felt = {spectral: "spectral", "temporal_match": "temporal"}
    if strange := [name for name in effects.given if name not in felt]:
        raise ValueError(
            f"--full plants slopes in simulated observers, who feel {' and '.join(felt)} on every scale alike; got "
            f"--effect {strange[0]}; leave out --full"
        )
    slopes = {
        felt[name]: float(effects.points[name].iloc[0]) / effects.steps[name].size
        for name in effects.given
    }
    settings = settings.model_copy(update={
        "observer": settings.observer.model_copy(update=slopes),
        "session": settings.session.model_copy(update={"repeats": shown.repeats}),
    })  # fmt: skip
    return whole.PaperStudy.draw(
        settings,
        paper.folder,
        paper.stimuli,
        participants=shown.participants * task.share,
        further=paper.further,
        screening=paper.screening,
    )
