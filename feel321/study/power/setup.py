"""From `study.toml` and the stimulus set to a power analysis: design and planted truth."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from pandas import DataFrame

from feel321.analysis.power import plan as planning
from feel321.analysis.power import truth as planted
from feel321.analysis.power.simulate import find_power
from feel321.analysis.primary.model import fit_primary
from feel321.analysis.report import section as parts
from feel321.analysis.screening.rules import RULES
from feel321.analysis.table import reading
from feel321.analysis.table.items import split_tests
from feel321.doors import check_name
from feel321.files import make_folder
from feel321.protocols import trial
from feel321.protocols.tasks import find_other
from feel321.stimuli.sets import build, manifest
from feel321.study import provenance, ratings
from feel321.study.metrics import measure_declared
from feel321.study.observer.model import make_model
from feel321.study.power.page import StudyPower
from feel321.study.session import codes
from feel321.study.session import plan as plans
from feel321.study.settings import read, schema

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from feel321.analysis.power.truth import PowerDesign, Truth
    from feel321.analysis.table.items import Part, Table
    from feel321.analysis.table.metrics import Step
    from feel321.analysis.table.reading import Further
    from feel321.jobs import Workers
    from feel321.stimuli.sets.manifest import StimulusSet
    from feel321.study.folder import StudyFolder
    from feel321.study.settings.schema import Settings

    Progress = Callable[[int, int], None]

OWN = "study"
"""A pilot that is no file: the study's own ratings."""

KEPT = ".studies"
"""Folder, in that of the results, of simulated studies: an interrupted call is continued from there."""

UNBUILT = "0" * 64
"""Digest of a stimulus set that is not built."""

PEOPLE, FEWEST = 16, 3
"""Raters of each attribute in the design around which others are compared; without so many there is no model."""

MOST_POINTS = 100
"""More than the whole scale per step of a metric is a slip."""

GIVEN, OBSERVED = "given", "simulated observers"
"""Where a slope comes from."""

WHO, SCENE, REDUCER, ITEM, RATING = "participant", "recording", "reducer", "item", "rating"


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
    effects: Mapping[str, float] | None = None,
    pilot: str | Path | None = None,
    pilot_manifest: Path | None = None,
    screening: Sequence[str] = (),
    wanted: float = planted.ENOUGH,
) -> PowerTask:
    """Set up the power analysis of a study.

    effects: metric, or attribute/metric -> points per step of the metric; others are as simulated observers plant them.
    pilot: a table of ratings, or `study`; the usual standard deviations if left out.
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
    table = tabulate_plan(study, settings, stimuli, groups=share, further=further)
    rated = list(split_tests(table))
    if not rated:
        names = ", ".join(settings.session.protocols)
        raise ValueError(
            f"session.protocols ({names}) ask for no rating of a single stimulus, so there is no slope to plan for; "
            "add realism or similarity"
        )
    slopes = _plant(settings, rated, steps=parts.find_table_steps(table), effects=effects or {})
    design = replace(
        _make_design(rated, slopes, settings), wanted=wanted, screening=tuple(screening)
    )
    named = slopes["attribute"] + "/" + slopes["metric"]
    known = dict(zip(named, slopes["points"] / slopes["size"], strict=True))
    usual = {"slopes": known, **{name: getattr(settings.observer, name) for name in planted.SHARES}}
    truth, notes = planted.Truth(**usual), _list_notes(rated, slopes, share)
    if pilot is not None:
        given = _read_pilot(study, settings, stimuli, pilot, pilot_manifest, further)
        name = "this study" if str(pilot) == OWN else Path(pilot).name
        truth, simulated = _fit_pilot(given, usual, name)
        notes += simulated
    return PowerTask(design, truth, slopes, settings.study.name, share, tuple(notes))


def tabulate_plan(
    study: StudyFolder,
    settings: Settings,
    stimuli: StimulusSet,
    *,
    groups: int,
    further: Further | None = None,
) -> Table:
    """Tabulate what participants are asked to judge, one of each group, with the metrics that are declared.

    All ratings are 0: nobody has rated yet.
    """
    design = read.make_design(settings, study.path)
    rows = []
    for number in range(1, groups + 1):
        who = f"sim{number:03d}"
        plan = plans.make_plan(design, stimuli, who, number=number, simulated=True)
        by_code = codes.list_by_code(stimuli, seed=plan.seed)
        rows += [
            _list_row(one, judgement, by_code) | {WHO: who}
            for one in plan.trials if one.phase == "main"
            for judgement in one.judgements if judgement.stimulus_id in by_code
        ]  # fmt: skip
    return reading.read_table(
        DataFrame(rows), stimuli.to_frame(), metrics=settings.analysis.metrics,
        sources=read.list_origins(settings), further=further,
    )  # fmt: skip


def _list_row(
    one: trial.Trial, judgement: trial.Judgement, by_code: Mapping[str, manifest.Stimulus]
) -> dict[str, Any]:
    stimulus = by_code[judgement.stimulus_id]
    others = {
        "reference_id": judgement.reference_id or "",
        "other_id": find_other(one, judgement) or "",
    }
    return {
        "session": 1, "protocol": one.protocol, "block": one.block, "trial": one.number, "repeat": one.repeat,
        "stimulus_id": stimulus.stimulus_id, "recording": stimulus.recording, "reducer": stimulus.reducer,
        "level": stimulus.level, "scale": judgement.scale or one.scale, "rating": 0.0, "rejected": "false",
        "simulated": "true",
        **{k: by_code[code].stimulus_id if code in by_code else code for k, code in others.items()},
    }  # fmt: skip


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
    return manifest.StimulusSet(study.stimuli, rows, UNBUILT)


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


def _make_design(rated: Sequence[Part], slopes: DataFrame, settings: Settings) -> PowerDesign:
    """Make the design of the study itself, with a usual number of people who rate each attribute."""
    metrics, attributes = (tuple(slopes[name].unique()) for name in ("metric", "attribute"))
    items = rated[0].rows[[SCENE, REDUCER, ITEM, *metrics]].drop_duplicates(ITEM)
    origin = rated[0].rows.drop_duplicates(SCENE).set_index(SCENE)["source"]
    if not origin.is_unique:
        items = items.assign(source=items[SCENE].map(origin))
    repeats = settings.session.repeats
    return planted.PowerDesign(items, metrics, attributes, participants=PEOPLE, repeats=repeats)


def _list_notes(rated: Sequence[Part], slopes: DataFrame, share: int) -> list[str]:
    levels, notes = list(dict.fromkeys(part.level for part in rated)), list[str]()
    if len(levels) > 1:
        others = ", ".join(levels[1:])
        notes.append(f"Metrics are those at level {levels[0]}; at {others} they are alike.")
    if share > 1:
        notes.append(f"Each attribute is rated by one in {share} participants, as [between] says.")
    if (slopes["source"] != GIVEN).any():
        notes.append(
            "Slopes without --effect are those of the simulated observers in study.toml: better give the smallest "
            "slope that would matter to you."
        )
    notes.append(
        "Before the first rating, feel321 freeze writes down the hypotheses and the analysis, so that results can be "
        "told apart into confirmatory and exploratory ones."
    )
    return notes


def _plant(
    settings: Settings,
    rated: Sequence[Part],
    *,
    steps: Mapping[str, Step],
    effects: Mapping[str, float],
) -> DataFrame:
    """Plant the slopes that are asked for, those of one scale last, and those of the observers elsewhere.

    Attributes are named by their scale, and by the level where there are several.
    """
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
    asked = list(product(attributes, steps))
    felt = _find_felt(settings, steps) if len(chosen) < len(asked) else {}
    return DataFrame([
        {
            "attribute": attribute, "metric": metric, "points": chosen.get((attribute, metric), felt.get(metric)),
            "per": steps[metric].per, "size": steps[metric].size,
            "source": GIVEN if (attribute, metric) in chosen else OBSERVED,
        }
        for attribute, metric in asked
    ])  # fmt: skip


def _find_felt(settings: Settings, steps: Mapping[str, Step]) -> dict[str, float]:
    """Find the slopes that observers feel, before the ends of the scale; 0 for metrics that they do not feel."""
    model = make_model(settings)
    if model.uses_percepts:
        raise ValueError(
            "simulated observers of [observer] feel more than the two matches, so their slopes are not known; give "
            "one of every metric: --effect METRIC=POINTS"
        )
    felt = {model.spectral_metric: model.spectral, "temporal_match": model.temporal}
    return {name: felt.get(name, 0.0) * step.size for name, step in steps.items()}


def _fit_pilot(table: Table, known: Mapping[str, Any], name: str) -> tuple[Truth, list[str]]:
    """Take the standard deviations of a pilot: the root mean square of those of all attributes."""
    rated = list(split_tests(table))
    if not rated:
        raise ValueError(f"{name}: holds no rating of a single test stimulus; give other ratings")
    people = len({who for part in rated for who in part.rows[WHO]})
    found = [_fit_truth(part.rows, known) for part in rated]
    pooled: dict[str, Any] = {
        name: _pool([getattr(one, name) for one in found]) for name in planted.SPREADS
    }
    for kind in ("slope_sds", "recording_slope_sds"):
        sds = [getattr(one, kind) for one in found]
        shared = sorted(set.intersection(*(set(one) for one in sds)))
        pooled[kind] = {metric: _pool([one[metric] for one in sds]) for metric in shared}
    pooled["mean"] = float(np.mean([one.mean for one in found]))
    pooled["source"] = f"the primary model of {people} people's ratings in {name}"
    simulated = bool(table.rows["simulated"].any())
    notes = [f"{name}: ratings come from simulated participants, not from people."] * simulated
    return replace(found[0], **pooled), notes


def _pool(sds: Sequence[float]) -> float:
    return float(np.sqrt(np.mean(np.square(sds))))


def _fit_truth(rows: DataFrame, known: Mapping[str, Any]) -> Truth:
    """Take the spreads of one attribute; what repeats differ by is told from taste where there are repeats."""
    changes = dict(known)
    metrics = list(dict.fromkeys(name.split("/")[-1] for name in known["slopes"]))
    cells = rows.groupby([WHO, ITEM], observed=True)[RATING]
    if spare := len(rows) - cells.ngroups:
        squares = ((rows[RATING] - cells.transform("mean")) ** 2).sum()
        changes["rating_sd"] = float(np.sqrt(squares / spare))
    fit = fit_primary(rows, metrics, explain=False)
    return planted.Truth.from_fit(fit, repeats=round(len(rows) / cells.ngroups), **changes)


def _read_pilot(  # noqa: PLR0917 - what is given, and what it is read with
    study: StudyFolder,
    settings: Settings,
    stimuli: StimulusSet,
    pilot: str | Path,
    listed: Path | None,
    further: Further | None,
) -> Table:
    """Read pilot ratings, of the study's own stimuli or of others."""
    path = Path(pilot)
    if str(pilot) == OWN:
        path = study.ratings
        if study.journals:
            ratings.write_ratings(study, stimuli)
        if not path.is_file():
            raise FileNotFoundError(
                f"{path}: no ratings yet; give a file with --pilot, or leave it out"
            )
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such table of ratings; --pilot takes a file, or {OWN}")
    return reading.read_table(
        path,
        stimuli.to_frame() if listed is None else listed,
        metrics=settings.analysis.metrics,
        further=further if listed is None else None,
    )


@dataclass(frozen=True, slots=True)
class Sizes:
    """The numbers that are compared, those of `plan_power` where nothing is said, and how well.

    hypothesis: attribute/metric.
    """

    participants: int | Sequence[int] = ()
    recordings: int | Sequence[int] = ()
    reducers: int | Sequence[int] = ()
    repeats: int | Sequence[int] = ()
    hypothesis: str = ""
    studies: int = 1000
    seed: int = 0

    def __post_init__(self) -> None:
        """Refuse what is no number of anything."""
        for name in planted.SIZES:
            _as_numbers(getattr(self, name), name)
        if self.studies < 0:
            raise ValueError(f"studies must be 0 or more, got {self.studies}")

    def list_factors(self, share: int) -> dict[str, tuple[int, ...]]:
        """List the numbers of each factor; participants become those who rate each attribute."""
        numbers = {name: _as_numbers(getattr(self, name), name) for name in planted.SIZES}
        people = numbers["participants"]
        if odd := [number for number in people if number % share]:
            raise ValueError(
                f"participants must be multiples of {share}, the groups of [between] that rate different things; got "
                f"{odd[0]}"
            )
        if few := [number for number in people if number < FEWEST * share]:
            raise ValueError(f"participants must be {FEWEST * share} or more, got {few[0]}")
        return numbers | {"participants": tuple(one // share for one in people)}


def _as_numbers(numbers: int | Sequence[int], what: str) -> tuple[int, ...]:
    """List numbers, or the only one."""
    listed = tuple(numbers) if isinstance(numbers, Iterable) else (numbers,)
    for one in listed:
        if not isinstance(one, int | np.integer) or one < 1:
            raise ValueError(f"{what} must be whole numbers of 1 or more, got {one!r}")
    return tuple(int(one) for one in listed)


def plan_study(
    task: PowerTask, sizes: Sizes, *, keep: Path, workers: Workers, progress: Progress
) -> StudyPower:
    """Compute the power of all designs."""
    factors = sizes.list_factors(task.share)
    near = min(factors["participants"] or (PEOPLE,), key=lambda number: abs(number - PEOPLE))
    make_folder(keep)
    design = task.design.change(participants=near)
    plan = planning.plan_power(
        design, task.truth, **factors, hypothesis=_find_hypothesis(task, design, sizes.hypothesis),
        studies=sizes.studies, seed=sizes.seed, workers=workers, keep=keep, progress=progress,
    )  # fmt: skip
    return StudyPower(plan, task.name, task.effects, task.share, task.notes)


def _find_hypothesis(task: PowerTask, design: PowerDesign, name: str) -> tuple[str, str] | None:
    """Find the hypothesis of a name, or the one with the least power among those whose slope was given.

    None, for the one with the least power of all, where no slope was given.
    """
    known = {"/".join(one): one for one in design.hypotheses}
    if name:
        return known[check_name(name, known, "hypothesis")]
    if not any(task.truth.slopes.values()):
        return design.hypotheses[0]
    power = find_power(design, task.truth, studies=0).table["power"]
    asked = task.effects[(task.effects["source"] == GIVEN) & (task.effects["points"] != 0)]
    if asked.empty:
        return None
    place = power.loc[asked.index].sort_values(kind="stable").index[0]
    return design.hypotheses[place]
