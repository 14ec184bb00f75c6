"""The participants' own detection thresholds, read from the journals, and the sensation levels of stimuli over them.

A threshold counts once its block is over. It is usable where it lies within the levels that were played and its 95 %
interval is at most `WIDEST_DB` wide; what is not usable is reported, and nothing is computed from it.

The sensation level of a stimulus for one participant is that of the manifest (`stimuli.sensation_level_db`: the loudest
200 ms, each frequency as a multiple of its threshold) with the threshold curve of the set shifted to the participant:
at each measured frequency by the difference between own threshold and curve, between them along a straight line over
the logarithm of frequency, beyond them by the nearest one. One frequency alone shifts the whole curve.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from functools import lru_cache
from typing import TYPE_CHECKING

from feel321.protocols.threshold import UNLIKELY, ThresholdEstimate, estimate_threshold, find_tail
from feel321.stimuli.sets.manifest import read_details
from feel321.study.session.events import PageRead
from feel321.study.session.plan import Plan, recall_detection

if TYPE_CHECKING:
    from pathlib import Path

    from feel321.stimuli.sets.manifest import StimulusSet
    from feel321.study.session.journal import Records
    from feel321.types import Samples

    Thresholds = Mapping[float, ThresholdEstimate]

WIDEST_DB = 12.0  # widest usable 95 % interval: a factor of two in amplitude to either side
PLACES = 3  # decimal places in tables: the last bits of a sum may differ between processors
LOW_RATE_HZ = 8000.0  # for the sensation levels of each participant: nothing is felt beyond 1000 Hz


def read_thresholds(plan: Plan, records: Records) -> dict[float, ThresholdEstimate]:
    """Read the thresholds of a participant by frequency in Hz; empty without a block, or before its end."""
    is_over = any(page.key == "threshold_done" for page in records.find(PageRead))
    detection = recall_detection(plan, records) if is_over else None
    procedures = detection.list_procedures() if detection else {}
    return {frequency: estimate_threshold(procedure) for frequency, procedure in procedures.items()}


def is_usable(estimate: ThresholdEstimate) -> bool:
    """Check whether anything may be computed from a threshold."""
    return not _is_wide(estimate) and not estimate.is_beyond


def _is_wide(estimate: ThresholdEstimate) -> bool:
    width = estimate.threshold_high_db - estimate.threshold_low_db
    return math.isnan(estimate.threshold_db) or not width <= WIDEST_DB


def list_columns(thresholds: Thresholds) -> dict[str, float | str]:
    """List the columns of `participants.csv`: threshold, slope and their intervals by frequency, catch trials."""
    columns: dict[str, float | str] = {}
    measured = ("threshold_db", "threshold_low_db", "threshold_high_db")
    slopes = ("slope", "slope_low", "slope_high")
    for frequency, found in thresholds.items():
        at = f"{frequency:g}hz".replace(".", "_")
        names = {f"{name}_{at}": name for name in measured}
        names |= {f"threshold_{name}_{at}": name for name in slopes}
        for column, name in names.items():
            value = getattr(found, name)
            columns[column] = "" if math.isnan(value) else round(value, PLACES)
        columns[f"threshold_catch_correct_{at}"] = found.catch_correct
        columns[f"threshold_catch_trials_{at}"] = found.catch_trials
    return columns


def find_warnings(thresholds: Thresholds) -> Iterator[str]:
    """List what speaks against the thresholds of a participant."""
    for frequency, found in thresholds.items():
        at = f"threshold at {frequency:g} Hz"
        if _is_wide(found):
            yield (
                f"{at}: {found.threshold_db:.1f} dB, 95 % interval {found.threshold_low_db:.1f} to "
                f"{found.threshold_high_db:.1f} dB, too wide to be used"
            )
        yield from (f"{at}: {note}" for note in found.notes if "catch trials" not in note)
    caught = sum(found.catch_correct for found in thresholds.values())
    silent = sum(found.catch_trials for found in thresholds.values())
    if find_tail(caught, silent) < UNLIKELY:
        yield (
            f"threshold: {caught} of {silent} silent catch trials correct: the participant may be using another cue "
            "than the vibration, such as sound"
        )


def find_shift(thresholds: Thresholds, *, curve: str) -> Callable[[Samples], Samples] | None:
    """Find how far a participant's threshold lies above a curve, in dB by frequency in Hz; None if it is unknown."""
    import numpy as np

    from feel321.stimuli.thresholds import acceleration_threshold

    usable = {f: found.threshold_db for f, found in thresholds.items() if is_usable(found)}
    if not usable:
        return None
    frequencies = np.array(sorted(usable))
    rms = acceleration_threshold(frequencies, threshold=curve) / math.sqrt(2)
    shifts = np.array([usable[f] for f in frequencies]) - 20 * np.log10(rms)
    return lambda hz: np.interp(np.log(hz), np.log(frequencies), shifts)


def find_own_levels(plan: Plan, records: Records, stimuli: StimulusSet) -> dict[str, float]:
    """Compute each stimulus's sensation level for one participant in dB, where a threshold is usable."""
    from feel321.stimuli.thresholds import loudest_levels, to_db

    if not (thresholds := read_thresholds(plan, records)):
        return {}
    recipe = read_details(stimuli.folder).recipe
    curve, full_scale = str(recipe["threshold"]), float(recipe["full_scale_m_s2"])
    if (shift := find_shift(thresholds, curve=curve)) is None:
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
