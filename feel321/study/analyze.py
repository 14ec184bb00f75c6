"""Steps of a study that need the analysis: report, recordings for chart, stress and advise, rotations.

The manifest tells what a reducer made of a recording as it is. Another orientation of the sensor would have given
another signal and other metrics, though people would have felt the same tool: their mean and spread over orientations
(Park & Kuchenbecker 2019, doi:10.1109/WHC.2019.8816148) belong to the recording and the reducer alone.

All go through the same conditioning, the study's own, because that is what participants feel. Its crop, which names
times in the study's recordings, is done to those alone. Unconditioned they are as the sensor gave them: conditioning
hides offsets, clipping and the sensor's steps.
"""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from itertools import chain, count
from shlex import quote
from typing import TYPE_CHECKING

import numpy as np

from feel321.analysis.report.write import write_report
from feel321.analysis.table.reading import Further
from feel321.stimuli.condition import Conditioning, condition
from feel321.stimuli.formats.read import read_recording
from feel321.stimuli.sets.manifest import read_stimuli
from feel321.stimuli.synthesis import SCENES, make_scene
from feel321.study.folder import StudyFolder, require_study
from feel321.study.ledger.standing import write_roster
from feel321.study.provenance import find_changes
from feel321.study.ratings import write_ratings
from feel321.study.settings.read import list_origins, make_recipe, read_settings, try_recordings

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from feel321.analysis.table.reading import Table
    from feel321.stimuli.recording import Recording
    from feel321.stimuli.sets.manifest import StimulusSet
    from feel321.study.settings.schema import Settings

    Progress = Callable[[int, int], None]

# How the metrics of a study's stimuli depend on the way the sensor was mounted, for the report to explore.

MOST, LEAST = 64, 16
"""Orientations: the mean is then known to 1/8 of their spread, or to 1/4 where there is so much to reduce."""

AFFORDABLE = 400_000_000
"""Samples, of all orientations, reducers and axes, that are reduced: about five seconds on two cores."""

DIGITS = 9
"""Behind the point: what is left of a spread that is none is rounding error, and no metric."""


def measure_rotations(study: StudyFolder, settings: Settings, stimuli: StimulusSet) -> Further:
    """Compute mean and spread of both metrics over sensor orientations for every test stimulus."""
    recordings, mistakes = try_recordings(settings, study.path)
    recipe = make_recipe(settings)
    try:
        digests = {recording.name: recording.sha256 for recording in recordings}
        problems = mistakes or find_changes(study.stimuli, recipe, digests)
    except (OSError, ValueError) as error:
        problems = [str(error)]
    if problems:
        return _make_nothing(problems[0])
    return compute_rotations(
        recordings, stimuli, steps=recipe.conditioning, seed=settings.study.seed
    )


def compute_rotations(
    recordings: Sequence[Recording], stimuli: StimulusSet, *, steps: Conditioning, seed: int
) -> Further:
    """Condition recordings, turn them, reduce them, and describe their metrics."""
    import pandas as pd

    from feel321.stimuli.rotation import random_rotations

    tests = [stimulus for stimulus in stimuli.stimuli if stimulus.role == "test"]
    reducers = list(dict.fromkeys(stimulus.reducer for stimulus in tests))
    count = _afford(recordings, len(reducers))
    turns = random_rotations(count, np.random.default_rng(seed))
    describe = partial(_describe_recording, reducers=reducers, steps=steps, turns=turns)
    # Threads: nearly all of the work is done by libraries that let go of the interpreter.
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        found = dict(
            zip(
                (recording.name for recording in recordings),
                pool.map(describe, recordings),
                strict=True,
            )
        )
    rows = [found[stimulus.recording][reducers.index(stimulus.reducer)] for stimulus in tests]
    ids = pd.Index([stimulus.stimulus_id for stimulus in tests], name="stimulus_id")
    return Further(
        pd.DataFrame(rows, index=ids, columns=_list_columns()), (_tell_how(count, seed),)
    )


def _make_nothing(problem: str) -> Further:
    import pandas as pd

    told = problem.splitlines()[0].rstrip(".")
    return Further(pd.DataFrame(), (f"Rotation statistics of the metrics are left out: {told}.",))


def _afford(recordings: Sequence[Recording], n_reducers: int) -> int:
    size = sum(recording.acceleration.size for recording in recordings) * n_reducers
    return min(MOST, max(LEAST, AFFORDABLE // size))


def _describe_recording(
    recording: Recording,
    *,
    reducers: Sequence[str],
    steps: Conditioning,
    turns: NDArray[np.float64],
) -> NDArray[np.float64]:
    from feel321.stimuli.condition import condition
    from feel321.stimuli.rotation import match_rotations

    conditioned = condition(recording, steps)
    matches = match_rotations(
        conditioned.acceleration, conditioned.rate_hz, reducers=reducers, turns=turns
    )
    both = np.stack([matches.mean(axis=-1), matches.std(axis=-1, ddof=1)], axis=-1)
    return both.reshape(len(reducers), -1).round(DIGITS)


def _list_columns() -> list[str]:
    from feel321.stimuli.match import METRICS

    return [f"{metric}_{kind}" for metric in METRICS for kind in ("rotation_mean", "rotation_sd")]


def _tell_how(count: int, seed: int) -> str:
    return (
        f"Rotation statistics: each recording, conditioned as for its stimuli, was turned into {count} random "
        f"orientations of the sensor (seed {seed}, the same ones for all), reduced and matched with itself; level, "
        "resampling and fades, which stimuli go through afterwards, have no part in it."
    )


def analyze_study(
    study: StudyFolder,
    *,
    metrics: Sequence[str] | None = None,
    out: Path | None = None,
    progress: Progress | None = None,
) -> Path:
    """Derive the table of ratings and write the report."""
    settings = read_settings(study.settings)
    write_roster(study)
    stimuli = read_stimuli(study.stimuli)
    if not write_ratings(study, stimuli):
        simulate = f"feel321 simulate {quote(str(study.path))}"
        raise ValueError(f"{study.path}: holds no ratings yet; run sessions first, or {simulate}")
    folder = out or study.report
    chosen, origins = settings.analysis, list_origins(settings)
    write_report(
        study.ratings,
        study.manifest,
        folder,
        draws=chosen.draws,
        margin=chosen.margin,
        metrics=metrics or chosen.metrics,
        sources=origins,
        further=measure_rotations(study, settings, stimuli),
        seed=settings.study.seed,
        progress=progress,
    )
    return folder


# What chart, stress and advise work on: a study's recordings, the bundled scenes, recordings from elsewhere.

SUFFIXES = frozenset({".wav", ".csv", ".tsv", ".txt", ".npz", ".npy", ".mat", ".xml", ".ide"})
"""What files in a folder are taken for recordings; a single file is read whatever it is called."""


def gather_recordings(
    folder: Path, *, scenes: bool = False, extra: Sequence[Path] = (), conditioned: bool = True
) -> tuple[Recording, ...]:
    """Gather the recordings that methods are compared on."""
    mistakes: list[str] = []
    own, steps = _open_study(folder, mistakes, needed=not (scenes or extra))
    others = [make_scene(name) for name in SCENES] if scenes else []
    for path in _list_files(extra):
        with _noted(mistakes):
            others.append(read_recording(path))
    recordings = _name_apart(own, others)
    if conditioned:
        crops = [steps.crop_s] * len(own) + [None] * (len(recordings) - len(own))
        recordings = list(
            _condition_all(recordings, [replace(steps, crop_s=crop) for crop in crops], mistakes)
        )
    if mistakes:
        raise ValueError("\n".join(mistakes))
    return tuple(recordings)


def find_ratings(study: StudyFolder) -> Table | None:
    """Find the ratings of a study, as analyze does: derived from its journals, or a table that was put there."""
    from feel321.analysis.table.reading import read_table

    if study.journals:
        rated = write_ratings(study, read_stimuli(study.stimuli)) > 0
    else:
        rated = study.ratings.is_file() and study.manifest.is_file()
    return read_table(study.ratings, study.manifest) if rated else None


def _open_study(
    folder: Path, mistakes: list[str], *, needed: bool
) -> tuple[list[Recording], Conditioning]:
    study = require_study(folder) if needed else StudyFolder(folder)
    if not study.settings.is_file():
        return [], Conditioning()
    settings = read_settings(study.settings)
    recordings, unreadable = try_recordings(settings, folder)
    mistakes += unreadable
    return recordings, make_recipe(settings).conditioning


def _condition_all(
    recordings: Iterable[Recording], steps: Iterable[Conditioning], mistakes: list[str]
) -> Iterator[Recording]:
    for recording, own in zip(recordings, steps, strict=True):
        with _noted(mistakes, f"recording {recording.name!r}: "):
            yield condition(recording, own)


@contextmanager
def _noted(mistakes: list[str], whose: str = "") -> Iterator[None]:
    """Note what goes wrong inside, so that everything that is wrong is told at once."""
    try:
        yield
    except (OSError, ValueError) as error:
        mistakes.append(f"{whose}{error}")


def _name_apart(own: Sequence[Recording], others: Iterable[Recording]) -> list[Recording]:
    """Leave out what is there twice, and number those others whose names are taken."""
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
        if not path.is_dir():
            files.append(path)
            continue
        found = sorted(
            entry
            for entry in path.glob("[!.]*")
            if entry.suffix.lower() in SUFFIXES and entry.is_file()
        )
        if not found:
            raise FileNotFoundError(
                f"{path}: got a folder without recordings, allowed are files ending in {' '.join(sorted(SUFFIXES))}; "
                "name another"
            )
        files += found
    return files
