"""Steps of a study that need the analysis: the report, and the recordings for chart, stress and advise."""

import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import fields, replace
from itertools import chain, count
from pathlib import Path
from shlex import quote

import numpy as np
import pandas as pd

from feel321.analysis.report.front import About
from feel321.analysis.report.write import Results, write_report
from feel321.analysis.screening.rules import find_rules
from feel321.analysis.table.metrics import ROTATIONS, list_rivals, make_info
from feel321.analysis.table.reading import Further, Table, read_table
from feel321.names import MATCHES
from feel321.stimuli.condition import Conditioning, condition
from feel321.stimuli.formats.read import read_recording
from feel321.stimuli.recording import Recording
from feel321.stimuli.rotation import match_rotations, random_rotations
from feel321.stimuli.sets.manifest import Stimulus, StimulusSet, find_methods, read_stimuli
from feel321.stimuli.sets.recipe import Recipe
from feel321.stimuli.sets.render import find_reducer
from feel321.stimuli.synthesis import SCENES, make_scene
from feel321.study.answers import write_answers
from feel321.study.folder import StudyFolder, require_study
from feel321.study.ledger.progress import Progress as Participant
from feel321.study.ledger.progress import list_progress, note_estimates, write_roster
from feel321.study.matches import describe_matches, write_matches
from feel321.study.paper import make_paper
from feel321.study.provenance import find_changes
from feel321.study.ratings import write_ratings
from feel321.study.rivals import measure_rivals
from feel321.study.settings.read import list_origins, make_recipe, read_settings, try_recordings
from feel321.study.settings.schema import AnalysisTable, Settings
from feel321.types import MetricInfo

Progress = Callable[[int, int], None]

# The report: of a study's own ratings, or of tables from elsewhere.


def analyze_study(  # noqa: PLR0913 - one per choice
    study: StudyFolder,
    *,
    ratings: Path | None = None,
    manifest: Path | None = None,
    metrics: Sequence[str] | None = None,
    draws: int | None = None,
    rivals: bool = False,
    out: Path | None = None,
    progress: Progress | None = None,
) -> Results:
    """Derive the table of ratings, or take one from elsewhere, and write the report as the study declares it."""
    if ratings is None or manifest is None:
        require_study(study.path)
    settings = read_settings(study.settings) if study.settings.is_file() else None
    chosen = settings.analysis if settings else AnalysisTable()
    further, everybody = Further(pd.DataFrame(), ()), []
    if settings and ratings is None:
        everybody = list_progress(study)
        further = _derive_ratings(study, settings, metrics or chosen.metrics, everybody=everybody)
    if settings and metrics and set(metrics) != set(chosen.metrics):
        asked, declared = ", ".join(metrics), ", ".join(chosen.metrics)
        note = f"Metrics {asked} were asked for with this analysis; {study.settings.name} declares {declared}."
        further = replace(further, notes=(*further.notes, note))
    if rivals:
        listed = manifest or study.manifest
        further = add_rivals(study, None if manifest else settings, listed, further=further)
    return write_report(
        ratings or study.ratings,
        manifest or study.manifest,
        out or study.report,
        draws=draws or chosen.draws,
        margin=chosen.margin,
        metrics=metrics or chosen.metrics,
        sources=list_origins(settings) if settings else {},
        further=replace(further, labels=list_labels(settings)) if settings else further,
        info=list_info(settings) if settings else {},
        rules=find_rules(chosen.screening, study.path),
        paper=make_paper(settings, further.mountings) if settings else None,
        about=_describe(settings, everybody) if settings else None,
        seed=settings.study.seed if settings else 0,
        progress=progress,
    )


def _describe(settings: Settings, everybody: Iterable[Participant]) -> About:
    """Say which study it is and, of its own ratings, when the last one was given."""
    day = max((one.rated_utc[:10] for one in everybody), default="")
    return About(settings.study.name, day, tuple(settings.session.protocols))


def list_labels(settings: Settings) -> pd.DataFrame:
    """List what each recording is of, where that is said: columns interaction and sample, by recording."""
    said = {
        one.title: {"interaction": one.interaction, "sample": one.sample}
        for one in settings.recordings
    }
    return pd.DataFrame.from_dict(said, orient="index").dropna(axis=1, how="all")


def list_info(settings: Settings) -> dict[str, MetricInfo]:
    """List what `[metrics.NAME]` declares; a table that only says where a metric's code is declares nothing."""
    facts = {name: table.to_facts() for name, table in settings.metrics.items()}
    declared = {field.name for field in fields(MetricInfo)}
    return {name: make_info(name, one) for name, one in facts.items() if declared & set(one)}


def add_rivals(
    study: StudyFolder, settings: Settings | None, manifest: Path, *, further: Further
) -> Further:
    """Let all metrics of a manifest be compared, and in a study those too that the manifest lacks."""
    names, measured, note = list_rivals(manifest), pd.DataFrame(), ""
    if settings:
        recordings, recipe, reason = _read_unchanged(study, settings)
        try:
            measured = (
                pd.DataFrame()
                if reason
                else measure_rivals(recordings, read_stimuli(study.stimuli), recipe)
            )
        except ValueError as error:
            reason = str(error)
        note = f"Metrics that the manifest lacks are not compared: {reason}." if reason else ""
    metrics = further.metrics.join(measured, how="outer") if len(measured) else further.metrics
    notes = (*further.notes, note) if note else further.notes
    return replace(
        further,
        metrics=metrics,
        notes=notes,
        rivals=tuple(dict.fromkeys([*names, *map(str, measured)])),
    )


def _read_unchanged(study: StudyFolder, settings: Settings) -> tuple[list[Recording], Recipe, str]:
    """Read a study's recordings, if the stimuli are still those of them; else give the reason."""
    recordings, mistakes = try_recordings(settings, study.path)
    recipe = make_recipe(settings, study.path)
    try:
        digests = {recording.name: recording.sha256 for recording in recordings}
        problems = mistakes or find_changes(study.stimuli, recipe, digests)
    except (OSError, ValueError) as error:
        problems = [str(error)]
    reason = problems[0].splitlines()[0].rstrip(".") if problems else ""
    return recordings, recipe, reason


def _derive_ratings(
    study: StudyFolder,
    settings: Settings,
    metrics: Sequence[str],
    *,
    everybody: Sequence[Participant],
) -> Further:
    write_roster(study, everybody)
    stimuli = read_stimuli(study.stimuli)
    if not write_ratings(study, stimuli):
        simulate = f"feel321 simulate {quote(str(study.path))}"
        raise ValueError(f"{study.path}: no ratings yet; run sessions first, or {simulate}")
    write_answers(study)
    further = measure_rotations(study, settings, stimuli, metrics=metrics)
    matched = describe_matches(write_matches(study, stimuli))
    notes = (*further.notes, *matched, *note_estimates(everybody), *_note_methods(study))
    return replace(further, notes=notes)


def _note_methods(study: StudyFolder) -> Iterator[str]:
    """Name the lab's own methods that the stimuli were made with."""
    if own := [f"{name} {digest}" for name, digest in find_methods(study.stimuli).items()]:
        yield f"Reducers and metrics of the lab's own, with the SHA-256 of their code: {', '.join(own)}."


# How the metrics of a study's stimuli depend on the way the sensor was mounted: explored, or declared as predictors.
# The manifest has the metrics of each recording as it is. Another orientation of the sensor would have given another
# signal and other metrics, though people would have felt the same tool: mean and spread over orientations (Park &
# Kuchenbecker 2019, doi:10.1109/WHC.2019.8816148) belong to the recording and the reducer alone.

MOST, LEAST = 64, 16
"""Orientations: the mean is then known to 1/8 of their spread, or to 1/4 where there is so much to reduce."""

AFFORDABLE = 400_000_000
"""Samples, of all orientations, reducers and axes, that are reduced: about five seconds on two cores."""

DECLARED = 4
"""Times as many orientations, and as much work, for statistics that the analysis declares as predictors: an
association is weakened by what a predictor is uncertain."""

DIGITS = 9
"""Decimals: below, a spread that should be zero is rounding error."""


def measure_rotations(
    study: StudyFolder,
    settings: Settings,
    stimuli: StimulusSet,
    *,
    metrics: Sequence[str] | None = None,
) -> Further:
    """Compute mean and spread of the metrics over sensor orientations for every test stimulus.

    metrics: those that the analysis is about; left out, as the study declares them.
    """
    recordings, recipe, reason = _read_unchanged(study, settings)
    if reason:
        note = f"Rotation statistics of the metrics are left out: {reason}."
        return Further(pd.DataFrame(), (note,))
    wanted = settings.analysis.metrics if metrics is None else metrics
    effort = DECLARED if set(wanted) & set(ROTATIONS) else 1
    copies, seed = _list_copies(settings), settings.study.seed
    return compute_rotations(
        recordings, stimuli, recipe=recipe, seed=seed, effort=effort, copies=copies
    )


def _list_copies(settings: Settings) -> dict[str, str]:
    """List the recordings with the first entry that differs from each in nothing but how the sensor was mounted."""
    first: dict[str, str] = {}
    own = {"name", "sample", "interaction", "picture", "rotation"}
    return {
        entry.title: first.setdefault(repr(entry.model_dump(exclude=own)), entry.title)
        for entry in settings.recordings
    }


def measure_declared(study: StudyFolder, settings: Settings) -> Further | None:
    """Compute the rotation statistics of a study whose analysis declares any."""
    if not set(settings.analysis.metrics) & set(ROTATIONS):
        return None
    return measure_rotations(study, settings, read_stimuli(study.stimuli))


def compute_rotations(
    recordings: Sequence[Recording],
    stimuli: StimulusSet,
    *,
    recipe: Recipe,
    seed: int,
    effort: int = 1,
    copies: Mapping[str, str] | None = None,
) -> Further:
    """Condition recordings, rotate them, reduce them, and describe their metrics; a command would take too long.

    effort: how many times the usual orientations; copies: recording -> the one that it is a turned copy of, or itself.
    Copies share their statistics: over all orientations these are the same, and only chance would tell them apart.
    """
    copies = copies or {}
    commands = {one.name for one in recipe.methods if not one.is_python}
    tests = [one for one in stimuli.stimuli if one.role == "test" and one.reducer not in commands]
    reducers = list(dict.fromkeys(stimulus.reducer for stimulus in tests))
    if not reducers:
        return Further(
            pd.DataFrame(), ("Rotation statistics: all reducers are commands or files; left out.",)
        )
    own = [find_reducer(recipe, name) for name in reducers]
    first = {one.name: one for one in recordings if copies.get(one.name, one.name) == one.name}
    size = sum(recording.acceleration.size for recording in first.values()) * len(reducers)
    n_turns = min(effort * MOST, max(effort * LEAST, effort * AFFORDABLE // size))
    turns = random_rotations(n_turns, np.random.default_rng(seed))

    def match(recording: Recording) -> np.ndarray:
        ready = condition(recording, recipe.conditioning)
        return match_rotations(ready.acceleration, ready.rate_hz, reducers=own, turns=turns)

    # Threads: nearly all of the work is done by libraries that release the interpreter. A lab's own code gets one.
    with ThreadPoolExecutor(1 if recipe.methods else os.cpu_count()) as pool:
        of_first = dict(zip(first, pool.map(match, first.values()), strict=True))
    matches = {one.name: of_first[copies.get(one.name, one.name)] for one in recordings}
    turned = f"{n_turns} random orientations of the sensor (seed {seed}, the same ones for all)"
    note = _describe_turns(turned, sorted(commands), shared=len(first) < len(recordings))
    table = _tabulate_rotations(tests, matches, reducers)
    return Further(table, (note,), mountings=_tabulate_mountings(matches, reducers))


def _describe_turns(turned: str, commands: Sequence[str], *, shared: bool) -> str:
    return (
        f"Rotation statistics: each recording, conditioned as for its stimuli, was turned into {turned}, reduced and "
        "matched with itself; level, resampling and fades, which stimuli go through afterwards, are not included."
        + (" Turned copies of a recording share theirs." if shared else "")
        + (f" Left out, as commands or files: {', '.join(commands)}." if commands else "")
    )


def _tabulate_rotations(
    tests: Sequence[Stimulus], matches: Mapping[str, np.ndarray], reducers: Sequence[str]
) -> pd.DataFrame:
    """Tabulate mean and spread of every match over orientations, by test stimulus."""
    found = {
        name: np.stack([one.mean(axis=-1), one.std(axis=-1, ddof=1)], axis=-1).round(DIGITS)
        for name, one in matches.items()
    }
    return pd.DataFrame(
        [found[one.recording][reducers.index(one.reducer)].ravel() for one in tests],
        index=pd.Index([one.stimulus_id for one in tests], name="stimulus_id"),
        columns=[f"{metric}_rotation_{kind}" for metric in MATCHES for kind in ("mean", "sd")],
    )


def _tabulate_mountings(matches: Mapping[str, np.ndarray], reducers: Sequence[str]) -> pd.DataFrame:
    """Tabulate mean and quantiles of every metric over orientations; matches: (reducers, metrics, turns) each."""
    shares = {"q05": 0.05, "q50": 0.5, "q95": 0.95}
    rows = []
    for recording, found in matches.items():
        for reducer, of_reducer in zip(reducers, found, strict=True):
            for metric, values in zip(MATCHES, of_reducer, strict=True):
                ends = {key: float(np.quantile(values, share)) for key, share in shares.items()}
                names = {"recording": recording, "reducer": reducer, "metric": metric}
                rows.append(names | {"mounting_mean": float(values.mean()), **ends})
    return pd.DataFrame(rows)


# What chart, stress and advise work on: a study's recordings, the bundled scenes, recordings from elsewhere.

SUFFIXES = frozenset({".wav", ".csv", ".tsv", ".txt", ".npz", ".npy", ".mat", ".xml", ".ide"})
"""Files in a folder that are taken for recordings; a single file is read whatever it is called."""


def gather_recordings(
    folder: Path, *, scenes: bool = False, extra: Sequence[Path] = (), conditioned: bool = True
) -> tuple[Recording, ...]:
    """Gather the recordings that methods are compared on.

    All are conditioned as the study's own, because that is what participants feel; its crop, which names times in the
    study's recordings, is done to those alone. Unconditioned they are as the sensor gave them: conditioning hides
    offsets, clipping and the sensor's steps.
    """
    study = StudyFolder(folder) if scenes or extra else require_study(folder)
    own: list[Recording] = []
    mistakes: list[str] = []
    steps = Conditioning()
    if study.settings.is_file():
        settings = read_settings(study.settings)
        own, mistakes = try_recordings(settings, folder)
        steps = make_recipe(settings, folder).conditioning
    others = [make_scene(name) for name in SCENES] if scenes else []
    for path in _list_files(extra):
        try:
            others.append(read_recording(path))
        except (OSError, ValueError) as error:
            mistakes.append(str(error))
    recordings = _name_apart(own, others)
    for place, recording in enumerate(recordings if conditioned else ()):
        try:
            crop = steps.crop_s if place < len(own) else None
            recordings[place] = condition(recording, replace(steps, crop_s=crop))
        except ValueError as error:
            mistakes.append(f"recording {recording.name!r}: {error}")
    if mistakes:
        raise ValueError("\n".join(mistakes))
    return tuple(recordings)


def find_ratings(study: StudyFolder) -> Table | None:
    """Find the ratings of a study, as analyze does: derived from its journals, or a table that was put there."""
    if study.journals:
        rated = write_ratings(study, read_stimuli(study.stimuli)) > 0
    else:
        rated = study.ratings.is_file() and study.manifest.is_file()
    return read_table(study.ratings, study.manifest) if rated else None


def _name_apart(own: Sequence[Recording], others: Iterable[Recording]) -> list[Recording]:
    """Leave out duplicates, and number those others whose names are taken."""
    named = list(own)
    for recording in others:
        if any(recording.sha256 == former.sha256 for former in named):
            continue
        taken = {former.name for former in named}
        names = chain([recording.name], (f"{recording.name} ({number})" for number in count(2)))
        named.append(replace(recording, name=next(name for name in names if name not in taken)))
    return named


def _list_files(paths: Iterable[Path]) -> list[Path]:
    files: list[Path] = []
    for path in paths:
        found = [path]
        if path.is_dir():
            found = sorted(
                entry
                for entry in path.glob("[!.]*")
                if entry.suffix.lower() in SUFFIXES and entry.is_file()
            )
        if not found:
            raise FileNotFoundError(
                f"{path}: no recordings in this folder; name another, or files ending in {' '.join(sorted(SUFFIXES))}"
            )
        files += found
    return files
