"""Sensation levels of stimuli for one participant, over thresholds of their own.

The sensation level of a stimulus for one participant is that of the manifest (`stimuli.sensation_level_db`: the loudest
200 ms, each frequency as a multiple of its threshold) with the threshold curve of the set shifted to the participant:
at each measured frequency by the difference between own threshold and curve, between them along a straight line over
the logarithm of frequency, beyond them by the nearest one. One frequency alone shifts the whole curve.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from functools import lru_cache
from typing import TYPE_CHECKING

from feel321.stimuli.sets.manifest import read_details
from feel321.stimuli.thresholds import acceleration_threshold, loudest_levels, to_db
from feel321.study.thresholds import PLACES, is_usable, read_thresholds

if TYPE_CHECKING:
    from pathlib import Path

    from feel321.protocols.threshold import ThresholdEstimate
    from feel321.stimuli.sets.manifest import StimulusSet
    from feel321.study.session.journal import Records
    from feel321.study.session.plan import Plan
    from feel321.types import Samples

LOW_RATE_HZ = 8000.0
"""Rate at which sensation levels are computed again for each participant: nothing is felt beyond 1000 Hz."""


def find_shift(
    thresholds: Mapping[float, ThresholdEstimate], *, curve: str
) -> Callable[[Samples], Samples] | None:
    """Find how far a participant's threshold lies above a curve, in dB by frequency in Hz; None if it is unknown."""
    import numpy as np

    usable = {f: found.threshold_db for f, found in thresholds.items() if is_usable(found)}
    if not usable:
        return None
    frequencies = np.array(sorted(usable))
    rms = acceleration_threshold(frequencies, threshold=curve) / math.sqrt(2)
    shifts = np.array([usable[f] for f in frequencies]) - 20 * np.log10(rms)
    return lambda hz: np.interp(np.log(hz), np.log(frequencies), shifts)


def find_own_levels(plan: Plan, records: Records, stimuli: StimulusSet) -> dict[str, float]:
    """Compute the sensation level of every stimulus for one participant, in dB; empty where no threshold is usable.

    Silence has none.
    """
    thresholds = read_thresholds(plan, records)
    if not thresholds:
        return {}
    recipe = read_details(stimuli.folder).recipe
    curve, full_scale = str(recipe["threshold"]), float(recipe["full_scale_m_s2"])
    shift = find_shift(thresholds, curve=curve)
    if shift is None:
        return {}
    levels = {}
    for row in stimuli.stimuli:
        samples, rate_hz = _read_slowed(stimuli.folder / row.file, row.sha256)
        level = loudest_levels(full_scale * samples, rate_hz, [curve], shift_db=shift)[curve]
        if level:
            levels[row.stimulus_id] = round(to_db(level), PLACES)
    return levels


@lru_cache(maxsize=512)
def _read_slowed(path: Path, sha256: str) -> tuple[Samples, float]:  # noqa: ARG001 - files of one name may change
    """Read a stimulus, shape (axes, n_samples), as fractions of full scale, at a rate that is enough for the skin."""
    import numpy as np
    from scipy.signal import resample

    from feel321.stimuli.wav import read_wav

    samples, rate_hz = read_wav(path)
    n = max(samples.shape[-1], 1)
    fewer = math.ceil(n * LOW_RATE_HZ / rate_hz)
    if fewer >= n:
        return np.atleast_2d(samples), float(rate_hz)
    return np.atleast_2d(resample(samples, fewer, axis=-1)), rate_hz * fewer / n
