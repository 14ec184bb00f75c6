"""Steps of a study that need the analysis: the report, further metrics, and the recordings for the trade-off."""

import os
import warnings
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext
from dataclasses import replace
from functools import partial
from itertools import chain, count
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from feel321.analysis.report.standing import About
from feel321.analysis.report.write import Results, write_report
from feel321.analysis.table.columns import DICTIONARY, ROTATIONS, make_dictionary
from feel321.analysis.table.items import Table
from feel321.analysis.table.reading import ROSTER_FILE, Further, read_table
from feel321.files import write_text
from feel321.stimuli.condition import condition
from feel321.stimuli.formats.read import read_recording
from feel321.stimuli.recording import Recording
from feel321.stimuli.rotation import match_rotations, random_rotations
from feel321.stimuli.sets.manifest import StimulusSet, find_methods, read_stimuli
from feel321.stimuli.sets.recipe import Recipe, Unread, find_conditioning, read_given
from feel321.stimuli.sets.render import find_reducer
from feel321.stimuli.synthesis import SCENES, make_scene
from feel321.study.evidence.checkpoints import declaring
from feel321.study.evidence.freeze import list_info, make_standing
from feel321.study.folder import StudyFolder, require_study
from feel321.study.participants.answers import ANSWERS_FILE, write_answers
from feel321.study.participants.roster import list_progress, list_remarks, write_roster
from feel321.study.participants.traces import closing_results
from feel321.study.ratings import MATCHES_FILE, describe_matches, write_matches, write_ratings
from feel321.study.settings.read import (
    find_changes,
    list_origins,
    make_recipe,
    open_recordings,
    read_settings,
    try_recordings,
)
from feel321.study.settings.schema import AnalysisTable, Settings
from feel321.types import MATCHES

if TYPE_CHECKING:
    from feel321.analysis.replication import Paper

Progress = Callable[[int, int], None]


def analyze_study(  # noqa: PLR0913 - one per choice
    study: StudyFolder,
    *,
    ratings: Path | None = None,
    manifest: Path | None = None,
    metrics: Sequence[str] | None = None,
    draws: int | None = None,
    out: Path | None = None,
    progress: Progress | None = None,
    finish: Callable[[Path], None] | None = None,
) -> Results:
    """Derive or take the table of ratings, and write the report; finish: writes what else belongs into its folder."""
    if None in {ratings, manifest}:  # only where both come from elsewhere may there be no study
        require_study(study.path)
    settings = read_settings(study.settings) if study.settings.is_file() else None
    chosen = settings.analysis if settings else AnalysisTable()
    further, about = Further(pd.DataFrame(), ()), About()
    if settings:
        day = ""
        if ratings is None:
            further, day = _derive_tables(study, settings, metrics or chosen.metrics)
        if metrics and set(metrics) != set(chosen.metrics):
            said = f"{study.settings.name} declares {', '.join(chosen.metrics)}."
            note = f"Metrics {', '.join(metrics)} were asked for with this analysis; {said}"
            further = replace(further, notes=(*further.notes, note))
        own = not (ratings or manifest)
        standing = make_standing(study, settings, metrics=metrics or (), draws=draws, own=own)
        protocols = tuple(settings.session.protocols)
        about = About(settings.study.name, day, protocols, standing=standing)
    listed, folder = manifest or study.manifest, out or study.report
    declared = declaring(study, "analyze") if out is None else nullcontext()
    with closing_results(study, folder), declared:
        results = write_report(
            ratings or study.ratings,
            listed,
            folder,
            draws=draws or chosen.draws,
            margin=chosen.margin,
            metrics=metrics or chosen.metrics,
            further=further,
            about=about,
            sources=list_origins(settings) if settings else {},
            info=list_info(settings) if settings else {},
            paper=make_paper(settings, further.mountings) if settings else None,
            rng=settings.study.seed if settings else 0,
            progress=progress,
        )
        if finish:
            finish(folder)
    return results


def read_study_table(study: StudyFolder) -> Table:
    """Read the ratings that a report would be about."""
    settings = read_settings(require_study(study.path).settings)
    _require_ratings(study)
    return read_table(
        study.ratings,
        study.manifest,
        metrics=settings.analysis.metrics,
        sources=list_origins(settings),
        further=measure_declared(study, settings),
        info=list_info(settings),
    )


def _require_ratings(study: StudyFolder) -> None:
    if not write_ratings(study, read_stimuli(study.stimuli)):
        simulate = f"feel321 simulate {quote(str(study.path))}"
        raise ValueError(f"{study.path}: no ratings yet; run sessions first, or {simulate}")


def _derive_tables(
    study: StudyFolder, settings: Settings, metrics: Sequence[str]
) -> tuple[Further, str]:
    """Derive all tables of the study's own journals; returns what else is known of its stimuli, and the last day."""
    everybody = list_progress(study)
    write_roster(study, everybody)
    _require_ratings(study)
    write_answers(study)
    stimuli = read_stimuli(study.stimuli)
    matched = write_matches(study, stimuli)
    own = [study.path / name for name in (ROSTER_FILE, ANSWERS_FILE, MATCHES_FILE)]
    paths = (path for path in (study.ratings, *own, study.manifest) if path.is_file())
    rows = make_dictionary({path.name: pd.read_csv(path) for path in paths}, list_info(settings))
    groups = rows["column"].isin(settings.between) & (rows["meaning"] == "")
    rows.loc[groups, "meaning"] = "group of the participant, a factor of [between]"
    write_text(study.path / DICTIONARY, rows.to_csv(index=False, lineterminator="\n"))
    further = measure_rotations(study, settings, stimuli, metrics=metrics)
    methods = [f"{name} {digest}" for name, digest in find_methods(study.stimuli).items()]
    said = "Reducers and metrics of the lab's own, with the SHA-256 of their code"
    notes = (
        *further.notes,
        *describe_matches(matched),
        *list_remarks(everybody),
        *([f"{said}: {', '.join(methods)}."] if methods else []),
    )
    last = max((one.last_rated[:10] for one in everybody), default="")
    return replace(further, notes=notes), last


def make_paper(settings: Settings, mountings: pd.DataFrame | None = None) -> "Paper | None":
    """Make the paper that the report answers; mountings: metrics over orientations of the sensor."""
    if (paper := settings.paper) is None:
        return None
    from feel321.analysis.replication import Paper

    published = [
        {**one.model_dump(exclude={"numbers"}), "reducer": reducer, "paper": value}
        for one in paper.published
        for reducer, value in one.numbers.items()
    ]
    frame = pd.DataFrame(published) if published else None
    return Paper(paper.citation, paper.doi, paper.seen, paper.claims, frame, mountings)


# How the metrics depend on the way the sensor was mounted. Another orientation would have given another signal and
# other metrics, though people would have felt the same tool: mean and spread over orientations (Park & Kuchenbecker
# 2019, doi:10.1109/WHC.2019.8816148) belong to the recording and the reducer alone.

MOST, LEAST = 64, 16
"""Orientations: the mean is then known to 1/8 of their spread, or to 1/4 where there is so much to reduce."""

AFFORDABLE = 400_000_000
"""Samples, of all orientations, reducers and axes, that are reduced: about two seconds on two cores."""

DECLARED = 4
"""Times as many orientations for declared predictors: an association is weakened by what a predictor is uncertain."""

DIGITS = 9  # decimals: below, a spread that should be zero is rounding error


def measure_rotations(
    study: StudyFolder,
    settings: Settings,
    stimuli: StimulusSet,
    *,
    metrics: Sequence[str] | None = None,
) -> Further:
    """Describe the metrics over sensor orientations for every test stimulus; metrics: that the analysis is about."""
    recordings, problems, digests = list[Unread](), list[str](), dict[str, str | None]()
    recipe = make_recipe(settings, study.path)
    lead = "The recordings cannot be read as they were when the set was built"
    for source, read in try_recordings(settings, study.path):
        if isinstance(read, str):
            problems.append(read)
        else:
            digests[source.name] = read.sha256
            recordings.append(replace(source, size=read.acceleration.size))
    try:
        if not problems and (problems := find_changes(study.stimuli, recipe, digests)):
            lead = "The settings differ from those of the built set, which this analysis is about"
    except (OSError, ValueError) as error:
        problems = [str(error)]
    if problems:
        reason = f"{lead} ({problems[0].splitlines()[0].rstrip('.')})"
        note = f"{reason}. Rotation statistics of the metrics are left out."
        warnings.warn(note, stacklevel=2)
        return Further(pd.DataFrame(), (note,))
    wanted = settings.analysis.metrics if metrics is None else metrics
    # The first entry that differs from each in nothing but how the sensor was mounted.
    first: dict[str, str] = {}
    own = {"name", "sample", "picture", "rotation"}
    copies = {
        entry.title: first.setdefault(repr(entry.model_dump(exclude=own)), entry.title)
        for entry in settings.recordings
    }
    effort = DECLARED if set(wanted) & set(ROTATIONS) else 1
    return compute_rotations(
        recordings, stimuli, recipe=recipe, seed=settings.study.seed, effort=effort, copies=copies
    )


def measure_declared(study: StudyFolder, settings: Settings) -> Further | None:
    """Compute the rotation statistics of a study whose analysis declares any."""
    if not set(settings.analysis.metrics) & set(ROTATIONS):
        return None
    return measure_rotations(study, settings, read_stimuli(study.stimuli))


def compute_rotations(
    recordings: Sequence[Recording | Unread],
    stimuli: StimulusSet,
    *,
    recipe: Recipe,
    seed: int,
    effort: int = 1,
    copies: Mapping[str, str] = {},
) -> Further:
    """Condition recordings, rotate them, reduce them, and describe their metrics; a command would take too long.

    effort: how many times the usual orientations; copies: recording -> the one that it is a turned copy of, or itself.
    Copies share their statistics: over all orientations these are the same, and only chance would tell them apart.
    """
    commands = {one.name for one in recipe.methods if not one.is_python}
    tests = [one for one in stimuli.stimuli if one.role == "test" and one.reducer not in commands]
    reducers = list(dict.fromkeys(stimulus.reducer for stimulus in tests))
    if not reducers:
        note = "Rotation statistics: all reducers are commands or files; left out."
        return Further(pd.DataFrame(), (note,))
    methods = [find_reducer(recipe, name) for name in reducers]
    first = {one.name: one for one in recordings if copies.get(one.name, one.name) == one.name}
    size = sum(
        one.size if isinstance(one, Unread) else one.acceleration.size for one in first.values()
    )
    affordable = effort * AFFORDABLE // (size * len(reducers))
    n_turns = min(effort * MOST, max(effort * LEAST, affordable))
    turns = random_rotations(n_turns, np.random.default_rng(seed))

    def match(given: Recording | Unread) -> np.ndarray:
        ready = condition(read_given(given), find_conditioning(recipe, given.name))
        return match_rotations(ready.acceleration, ready.rate_hz, reducers=methods, turns=turns)

    # Threads: nearly all of the work is done by libraries that release the interpreter. A lab's own code gets one.
    with ThreadPoolExecutor(1 if recipe.methods else os.cpu_count()) as pool:
        of_first = dict(zip(first, pool.map(match, first.values()), strict=True))
    found = {
        (one.name, reducer, metric): values
        for one in recordings
        for reducer, own in zip(reducers, of_first[copies.get(one.name, one.name)], strict=True)
        for metric, values in zip(MATCHES, own, strict=True)
    }
    note = (
        f"Rotation statistics: each recording, conditioned as for its stimuli, was turned into {n_turns} random "
        f"orientations of the sensor (seed {seed}, the same ones for all), reduced and matched with itself; level, "
        "resampling and fades, which stimuli go through afterwards, are not included."
        + (" Turned copies of a recording share theirs." if len(first) < len(recordings) else "")
        + (f" Left out, as commands or files: {', '.join(sorted(commands))}." if commands else "")
    )
    moments: dict[str, Callable[..., Any]] = {"mean": np.mean, "sd": partial(np.std, ddof=1)}
    table = pd.DataFrame(
        {
            f"{metric}_rotation_{kind}": [
                round(float(moment(found[one.recording, one.reducer, metric])), DIGITS)
                for one in tests
            ]
            for metric in MATCHES
            for kind, moment in moments.items()
        },
        index=pd.Index([one.stimulus_id for one in tests], name="stimulus_id"),
    )
    keys, ends = ("recording", "reducer", "metric"), {"q05": 0.05, "q50": 0.5, "q95": 0.95}
    mountings = pd.DataFrame([
        {**dict(zip(keys, place, strict=True)), "mounting_mean": float(values.mean())}
        | {name: float(np.quantile(values, share)) for name, share in ends.items()}
        for place, values in found.items()
    ])  # fmt: skip
    return Further(table, (note,), mountings=mountings)


def gather_recordings(
    folder: Path, *, scenes: bool = False, extra: Sequence[Path] = ()
) -> tuple[Recording, ...]:
    """Gather the recordings that methods are compared on: a study's, the bundled scenes, files from elsewhere.

    All are conditioned as the study's own, because that is what participants feel; its crop, which names times in the
    study's recordings, is done to those alone. Of equal recordings the first is kept; a name that is taken gets a
    number.
    """
    study = StudyFolder(folder) if scenes or extra else require_study(folder)
    found, recipe = list[Recording](), Recipe()
    if study.settings.is_file():
        settings = read_settings(study.settings)
        found, recipe = open_recordings(settings, folder), make_recipe(settings, folder)
    n_own = len(found)
    others = [make_scene(name) for name in SCENES] if scenes else []
    for one in (*others, *map(read_recording, extra)):
        if one.sha256 not in {former.sha256 for former in found}:
            numbered = (f"{one.name} ({number})" for number in count(2))
            taken = {each.name for each in found}
            name = next(name for name in chain([one.name], numbered) if name not in taken)
            found.append(replace(one, name=name))
    ready, mistakes = list[Recording](), list[str]()
    uncropped = replace(recipe.conditioning, crop_s=None)
    for place, recording in enumerate(found):
        try:
            own = find_conditioning(recipe, recording.name) if place < n_own else uncropped
            ready.append(condition(recording, own))
        except ValueError as error:
            mistakes.append(f"recording {recording.name!r}: {error}")
    if mistakes:
        raise ValueError("\n".join(mistakes))
    return tuple(ready)


def find_ratings(study: StudyFolder) -> Table | None:
    """Find the ratings of a study, as analyze does: derived from its journals, or a table that was put there."""
    if study.journals:
        rated = write_ratings(study, read_stimuli(study.stimuli)) > 0
    else:
        rated = study.ratings.is_file() and study.manifest.is_file()
    return read_table(study.ratings, study.manifest) if rated else None
