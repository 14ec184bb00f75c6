"""How the metrics of a study's stimuli depend on the way the sensor was mounted, for the report to explore.

The manifest tells what a reducer made of a recording as it is. Another orientation of the sensor would have given
another signal and other metrics, though people would have felt the same tool: their mean and spread over orientations
(Park & Kuchenbecker 2019, doi:10.1109/WHC.2019.8816148) belong to the recording and the reducer alone.
"""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from analysis.table.further import Further
from study.provenance import find_changes
from study.settings.sources import make_recipe, try_recordings

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from stimuli.condition import Conditioning
    from stimuli.manifest import StimulusSet
    from stimuli.recording import Recording
    from study.folder import StudyFolder
    from study.settings.tables import Settings

MOST, LEAST = 64, 16
"""Orientations: the mean is then known to 1/8 of their spread, or to 1/4 where there is so much to reduce."""

AFFORDABLE = 400_000_000
"""Samples, of all orientations, reducers and axes, that are reduced: about five seconds on two cores."""

DIGITS = 9
"""Behind the point: what is left of a spread that is none is rounding error, and no metric."""


def measure_rotations(study: StudyFolder, settings: Settings, stimuli: StimulusSet) -> Further:
    """Compute mean and spread of both metrics over sensor orientations for every test stimulus.

    Parameters
    ----------
    study : StudyFolder
        The study.
    settings : Settings
        Its settings, which name recordings, conditioning and seed.
    stimuli : StimulusSet
        What was built.

    Returns
    -------
    Further
        A row per test stimulus, and how it came about; no row, and the reason, where the recordings or settings are
        not those that the set was built from.
    """
    recordings, mistakes = try_recordings(settings, study.path)
    recipe = make_recipe(settings)
    try:
        digests = {recording.name: recording.sha256 for recording in recordings}
        problems = mistakes or find_changes(study.stimuli, recipe, digests)
    except (OSError, ValueError) as error:
        problems = [str(error)]
    if problems:
        return _make_nothing(problems[0])
    return compute_rotations(recordings, stimuli, steps=recipe.conditioning, seed=settings.study.seed)


def compute_rotations(
    recordings: Sequence[Recording], stimuli: StimulusSet, *, steps: Conditioning, seed: int
) -> Further:
    """Condition recordings, turn them, reduce them, and describe their metrics.

    Parameters
    ----------
    recordings : sequence of Recording
        What the stimuli were made from, as it was read.
    stimuli : StimulusSet
        What was built.
    steps : Conditioning
        The steps before reduction.
    seed : int
        Of the orientations, the same ones for every recording and reducer.

    Returns
    -------
    Further
        A row per test stimulus: mean and standard deviation (ddof 1) of both metrics.
    """
    import pandas as pd

    from stimuli.rotation import random_rotations

    tests = [stimulus for stimulus in stimuli.stimuli if stimulus.role == "test"]
    reducers = list(dict.fromkeys(stimulus.reducer for stimulus in tests))
    count = _afford(recordings, len(reducers))
    turns = random_rotations(count, np.random.default_rng(seed))
    describe = partial(_describe_recording, reducers=reducers, steps=steps, turns=turns)
    # Threads: nearly all of the work is done by libraries that let go of the interpreter.
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        found = dict(zip((recording.name for recording in recordings), pool.map(describe, recordings), strict=True))
    rows = [found[stimulus.recording][reducers.index(stimulus.reducer)] for stimulus in tests]
    ids = pd.Index([stimulus.stimulus_id for stimulus in tests], name="stimulus_id")
    return Further(pd.DataFrame(rows, index=ids, columns=_list_columns()), (_tell_how(count, seed),))


def _make_nothing(problem: str) -> Further:
    import pandas as pd

    told = problem.splitlines()[0].rstrip(".")
    return Further(pd.DataFrame(), (f"Rotation statistics of the metrics are left out: {told}.",))


def _afford(recordings: Sequence[Recording], n_reducers: int) -> int:
    size = sum(recording.acceleration.size for recording in recordings) * n_reducers
    return min(MOST, max(LEAST, AFFORDABLE // size))


def _describe_recording(
    recording: Recording, *, reducers: Sequence[str], steps: Conditioning, turns: NDArray[np.float64]
) -> NDArray[np.float64]:
    from stimuli.condition import condition
    from stimuli.rotation import match_rotations

    conditioned = condition(recording, steps)
    matches = match_rotations(conditioned.acceleration, conditioned.rate_hz, reducers=reducers, turns=turns)
    both = np.stack([matches.mean(axis=-1), matches.std(axis=-1, ddof=1)], axis=-1)
    return both.reshape(len(reducers), -1).round(DIGITS)


def _list_columns() -> list[str]:
    from stimuli.match import METRICS

    return [f"{metric}_{kind}" for metric in METRICS for kind in ("rotation_mean", "rotation_sd")]


def _tell_how(count: int, seed: int) -> str:
    return (
        f"Rotation statistics: each recording, conditioned as for its stimuli, was turned into {count} random "
        f"orientations of the sensor (seed {seed}, the same ones for all), reduced and matched with itself; level, "
        "resampling and fades, which stimuli go through afterwards, have no part in it."
    )
