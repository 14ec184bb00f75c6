"""From `study.toml` and the stimulus set to a power analysis: design, planted truth, minutes per session."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from feel321.analysis.power import design as records
from feel321.analysis.primary import model as primary
from feel321.analysis.report import parts
from feel321.analysis.screening.rules import RULES
from feel321.analysis.table import reading
from feel321.doors import check_name
from feel321.protocols import trial
from feel321.stimuli.sets import build, manifest
from feel321.study import minutes, ratings, sessions
from feel321.study.metrics import measure_declared
from feel321.study.power import whole
from feel321.study.session import plan
from feel321.study.settings import read, schema

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from pandas import DataFrame

    from feel321.analysis.power.design import PowerDesign, Truth
    from feel321.analysis.report.parts import RatingsPart
    from feel321.analysis.table.metrics import Step
    from feel321.stimuli.sets.manifest import StimulusSet
    from feel321.study.folder import StudyFolder
    from feel321.study.settings.schema import Settings

OWN, OBSERVERS = "study", "observers"
"""Pilots that are no file: the study's own ratings, and those of its simulated observers."""

SAMPLE = 48
"""Simulated observers from whose ratings their standard deviations are estimated."""

MOST_POINTS = 100
"""More than the whole scale per step of a metric is a slip."""

WHO, SCENE, REDUCER, ITEM, RATING = "participant", "recording", "reducer", "item", "rating"


@dataclass(frozen=True, slots=True)
class Effects:
    """What is planted and where it comes from.

    points: per step of each metric, by attribute; given: whether a user said so; steps: by metric.
    """

    points: DataFrame
    steps: Mapping[str, Step]
    given: tuple[str, ...] = ()

    def to_slopes(self) -> dict[str, float]:
        """Return the slopes of a Truth: points per unit of the metric, by attribute/metric."""
        return {
            f"{attribute}/{metric}": float(self.points.loc[attribute, metric]) / step.size
            for attribute in self.points.index
            for metric, step in self.steps.items()
        }


@dataclass(frozen=True, slots=True)
class PowerTask:
    """What is planned.

    paper: the study itself, one participant of each group; share: one in so many participants rates each attribute;
    lengths: of sessions, by recordings, reducers and repeats, as far as they are known.
    """

    design: PowerDesign
    truth: Truth
    effects: Effects
    paper: whole.PaperStudy
    share: int = 1
    pace: minutes.Pace = field(default_factory=minutes.Pace)
    notes: tuple[str, ...] = ()
    lengths: dict[tuple[int, int, int], minutes.Length] = field(default_factory=dict)

    def measure_length(self, design: PowerDesign) -> minutes.Length:
        """Measure how long a session of a design takes, whatever the number of participants."""
        key = design.recordings, design.reducers, design.repeats
        if key not in self.lengths:
            self.lengths[key] = _measure_length(self, design)
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
    participants: int = 16,
) -> PowerTask:
    """Set up the power analysis of a study.

    effects: metric, or attribute/metric -> points per step of the metric; others are as simulated observers plant them.
    pilot: a table of ratings, `study` or `observers`; the usual standard deviations if left out.
    """
    for name in screening:
        check_name(name, RULES, "screening")
    settings = read.read_settings(study.settings)
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
    own = _make_design(
        rated, found, settings, participants=participants // share, screening=paper.screening
    )
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
        sessions.require_current_set(study, settings)
        return manifest.read_stimuli(study.stimuli)
    recordings = read.open_recordings(settings, study.path)
    recipe = read.make_recipe(settings, study.path)
    foreseen = build.foresee_stimuli(recordings, study.stimuli, recipe=recipe)
    crop_s = settings.stimuli.conditioning.crop_s
    lengths = {one.name: crop_s[1] - crop_s[0] if crop_s else one.duration_s for one in recordings}
    rows = tuple(_foresee(one, lengths[one.recording], recipe.rate_hz) for one in foreseen)
    return manifest.StimulusSet(study.stimuli, rows, "0" * 64)


def _foresee(one: build.Foreseen, duration_s: float, rate_hz: float) -> manifest.Stimulus:
    """Describe a stimulus that is not built as the manifest would."""
    measured = one.measured
    return manifest.Stimulus(
        stimulus_id=one.stimulus_id, recording=one.recording, reducer=one.reducer, level=one.level, role=one.role,
        file=f"{one.stimulus_id}.wav", rate_hz=rate_hz, n_samples=round(duration_s * rate_hz), duration_s=duration_s,
        peak=one.peak_m_s2, rms_m_s2=1.0, gain=one.gain, spectral_match=measured.spectral_match,
        temporal_match=measured.temporal_match, clipped=0, sha256="", recording_sha256="",
        spectral_match_bounded=measured.spectral_match_bounded,
        metrics={name: np.nan if value is None else value for name, value in measured.metrics.items()},
    )  # fmt: skip


def _name_attributes(rated: Sequence[RatingsPart]) -> list[str]:
    """Name attributes by their scale, and by the level where there are several."""
    several = len({part.level for part in rated}) > 1
    return [part.lead if several else part.scale for part in rated]


def _make_design(
    rated: Sequence[RatingsPart],
    effects: Effects,
    settings: Settings,
    *,
    participants: int,
    screening: tuple[str, ...],
) -> PowerDesign:
    metrics = list(effects.steps)
    columns = [SCENE, REDUCER, ITEM, *metrics]
    items = rated[0].rows[columns].drop_duplicates(ITEM)
    origin = rated[0].rows.drop_duplicates(SCENE).set_index(SCENE)["source"]
    if not origin.is_unique:
        items = items.assign(source=items[SCENE].map(origin))
    return records.PowerDesign(
        items, tuple(metrics), tuple(effects.points.index), participants=participants,
        repeats=settings.session.repeats, screening=screening,
    )  # fmt: skip


def _note_levels(rated: Sequence[RatingsPart]) -> list[str]:
    levels = list(dict.fromkeys(part.level for part in rated))
    if len(levels) == 1:
        return []
    return [f"Metrics are those at level {levels[0]}; at {', '.join(levels[1:])} they are alike."]


# What is planted.


def _plant(
    paper: whole.PaperStudy, effects: Mapping[str, float]
) -> tuple[list[RatingsPart], Effects]:
    """Plant the slopes that are asked for, and those of the observers elsewhere."""
    rated, points, steps = split_expected(paper)
    for name, value in effects.items():
        attribute, _, metric = name.rpartition("/")
        check_name(metric, steps, "effect, metric")
        if attribute:
            check_name(attribute, list(points.index), "effect, attribute")
        if not abs(value) <= MOST_POINTS:
            raise ValueError(
                f"effect {name} must be from -{MOST_POINTS} to {MOST_POINTS} points, got {value:g}"
            )
        points.loc[attribute or points.index, metric] = value
    return rated, Effects(points, steps, tuple(effects))


def _find_truth(
    study: StudyFolder,
    paper: whole.PaperStudy,
    effects: Effects,
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
        truth = fit_truths(split_observers(paper, len(paper.plans)), known)
        source = f"{SAMPLE} simulated observers"
        return replace(truth, source=source), [
            "The standard deviations are those of simulated observers, who are not people: plan a real study with "
            "those of a pilot, or with the usual ones."
        ]
    rated, simulated = _split_pilot(study, paper, pilot, listed=listed)
    truth = fit_truths(rated, known)
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


def fit_truths(rated: Sequence[RatingsPart], known: Mapping[str, Any]) -> Truth:
    """Fit the primary model of every attribute and pool the standard deviations, as their root mean square."""
    found = [_fit_truth(part, known) for part in rated]
    pooled: dict[str, Any] = {
        name: _pool([getattr(one, name) for one in found]) for name in records.SPREADS
    }
    metrics = set.intersection(*(set(one.slope_sds) for one in found))
    sds = {name: _pool([one.slope_sds[name] for one in found]) for name in sorted(metrics)}
    mean = float(np.mean([one.mean for one in found]))
    return replace(found[0], slope_sds=sds, mean=mean, **pooled)


def _pool(sds: Sequence[float]) -> float:
    return float(np.sqrt(np.mean(np.square(sds))))


def _fit_truth(part: RatingsPart, known: Mapping[str, Any]) -> Truth:
    """Take the spreads of one attribute; what repeats differ by is told from taste where there are repeats."""
    rows = part.rows
    metrics = list(dict.fromkeys(name.split("/")[-1] for name in known["slopes"]))
    fit = primary.fit_primary(rows, metrics, explain=False)
    cells = rows.groupby([WHO, ITEM], observed=True)[RATING]
    spare, noise = len(rows) - cells.ngroups, {}
    if spare:
        squares = ((rows[RATING] - cells.transform("mean")) ** 2).sum()
        noise["rating_sd"] = float(np.sqrt(squares / spare))
    return records.Truth.from_fit(fit, **known, **noise)


# How long a session takes.


def _measure_length(task: PowerTask, sizes: PowerDesign) -> minutes.Length:
    """Work through sessions with other numbers of recordings and reducers: the study's own, and copies of them."""
    paper = task.paper
    design = read.make_design(paper.settings, paper.folder)
    choosing = {name: own for name, own in design.between.items() if name in trial.CHOOSING}
    design = replace(design, repeats=sizes.repeats, between=choosing)
    items, durations = _resize(paper.stimuli, sizes.recordings, sizes.reducers)
    numbers = range(1, schema.count_groups(choosing) + 1)
    courses = [plan.make_trials(design, items, number=number) for number in numbers]
    sittings = [minutes.Sitting.plan(course, design.flow, durations) for course in courses]
    return minutes.measure_length(sittings, task.pace)


def _resize(
    stimuli: StimulusSet, recordings: int, reducers: int
) -> tuple[list[trial.Item], dict[str, float]]:
    """List the stimuli of so many recordings and reducers, the set's own first and then copies of them."""
    known, durations = minutes.find_durations(stimuli), {}
    own = list(dict.fromkeys(one.reducer for one in stimuli if one.role == "test"))
    kept = _number_copies(own, reducers)
    items = []
    for name, scene in _number_copies(list(known), recordings):
        durations[name] = known[scene]
        for one in (one for one in stimuli if one.recording == scene):
            made = (
                [new for new, of in kept if of == one.reducer]
                if one.role == "test"
                else [one.reducer]
            )
            items += [
                trial.Item(f"{name}__{reducer}__{one.level}", name, reducer, one.level, one.role)
                for reducer in made
            ]
    return items, durations


def _number_copies(names: Sequence[str], wanted: int) -> list[tuple[str, str]]:
    """List so many names, each with the one it is a copy of.

    Examples
    --------
    >>> _number_copies(["a", "b"], 3)
    [('a', 'a'), ('b', 'b'), ('a (2)', 'a')]
    """
    found = [(name, turn) for turn in range(1, wanted // len(names) + 2) for name in names][:wanted]
    return [(name if turn == 1 else f"{name} ({turn})", name) for name, turn in found]
