"""What a reader notices and never mends: saturated runs, silent axes, axes that stand still."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

SATURATED_SAMPLES = 3
"""So many equal samples in a row at an axis's extreme count as saturated."""

STILL_S = 0.05
"""So long a run of equal samples counts as standing still."""


@dataclass(frozen=True, slots=True, eq=False)
class Runs:
    """Runs of equal samples on one axis.

    Parameters
    ----------
    start : ndarray of int, shape (n_runs,)
        Where each begins.
    length : ndarray of int, shape (n_runs,)
        How many samples it has.
    value : ndarray of float64, shape (n_runs,)
        What they are, in m/s².
    """

    start: NDArray[np.intp]
    length: NDArray[np.intp]
    value: NDArray[np.float64]


def inspect_samples(acceleration: NDArray[np.float64], rate_hz: float) -> tuple[str, ...]:
    """Report saturated runs, constant axes and axes that stand still, with counts and positions.

    Parameters
    ----------
    acceleration : ndarray of float64, shape (3, n_samples)
        Samples in m/s², as recorded (not resampled).
    rate_hz : float
        Sampling rate in Hz, for the positions.

    Returns
    -------
    tuple of str
        One line per finding.

    Notes
    -----
    A run is *saturated* if three or more equal samples stand at the axis's minimum or maximum and the
    signal came or went by more than twice the smallest difference between its values: the smooth crest of a
    slow, quantised signal is entered and left one step at a time and is not reported.
    An axis *stands still* if it holds one value for 50 ms while another axis moves; where none moves it is
    silence.

    Examples
    --------
    >>> import numpy as np
    >>> wave = np.sin(np.arange(1000) / 9)
    >>> inspect_samples(np.stack([wave, np.minimum(wave, 0.5), 0 * wave]), 1000.0)[0]
    'axis y: saturated at 0.5 m/s^2 in 18 runs (339 samples), the first at 0.005 s'
    """
    runs = [find_runs(axis) for axis in acceleration]
    held = [_held(axis_runs, rate_hz) for axis_runs in runs]
    silence = np.logical_and.reduce(held)
    findings: list[str] = []
    for name, axis_runs, still in zip("xyz", runs, held, strict=True):
        if axis_runs.start.size == 1:
            findings += _constant(name, axis_runs)
        else:
            findings += _saturated(name, axis_runs, rate_hz=rate_hz)
            findings += _stands_still(name, still & ~silence, rate_hz=rate_hz)
    return tuple(findings)


def find_runs(axis: NDArray[np.float64]) -> Runs:
    """Find the runs of equal samples.

    Parameters
    ----------
    axis : ndarray of float64, shape (n_samples,)
        One axis.

    Returns
    -------
    Runs
        All runs, those of one sample too, in order.
    """
    start = np.concatenate([[0], np.flatnonzero(np.diff(axis)) + 1])
    return Runs(start, np.diff(np.append(start, axis.size)), axis[start])


def _constant(name: str, runs: Runs) -> Iterator[str]:
    if runs.length[0] > 1:
        yield f"axis {name}: flat, {runs.value[0]:.6g} m/s^2 in all {runs.length[0]} samples"


def _saturated(name: str, runs: Runs, *, rate_hz: float) -> Iterator[str]:
    jumps = np.abs(np.diff(runs.value))
    jump = np.maximum(np.append(0.0, jumps), np.append(jumps, 0.0))
    for extreme in (runs.value.min(), runs.value.max()):
        hit = (runs.value == extreme) & (runs.length >= SATURATED_SAMPLES)
        if hit.any() and (hit := hit & (jump > 2 * _smallest_step(runs))).any():
            yield (
                f"axis {name}: saturated at {extreme:.6g} m/s^2 in {hit.sum()} runs "
                f"({runs.length[hit].sum()} samples), the first at {runs.start[hit][0] / rate_hz:.6g} s"
            )


def _smallest_step(runs: Runs) -> float:
    return float(np.diff(np.unique(runs.value)).min())


def _held(runs: Runs, rate_hz: float) -> NDArray[np.bool_]:
    """Return which samples belong to a long run of equal ones, shape (n_samples,)."""
    long = runs.length >= max(SATURATED_SAMPLES, STILL_S * rate_hz)
    return np.repeat(long, runs.length)


def _stands_still(name: str, still: NDArray[np.bool_], *, rate_hz: float) -> Iterator[str]:
    runs = find_runs(still.astype(np.float64))
    long = (runs.value > 0) & (runs.length >= STILL_S * rate_hz)
    if long.any():
        yield (
            f"axis {name}: stands still while another moves, "
            f"{long.sum()} times for {STILL_S * 1000:g} ms or longer "
            f"({runs.length[long].sum()} samples), the first at {runs.start[long][0] / rate_hz:.6g} s"
        )
