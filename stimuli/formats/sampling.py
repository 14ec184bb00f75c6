"""One rate for all samples: agreed by file and caller, checked on the time stamps, or made on request."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from stimuli.recording import check_rate

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from stimuli.formats.decoded import Decoded, Request

AGREEMENT = 0.01
"""How far, relatively, two statements of one rate may differ."""

JITTER_LIMIT = 0.01
"""How far, in sampling periods, an interval may differ from the median interval."""

SPLINE_POINTS = 4
"""A cubic spline needs as many samples."""


@dataclass(frozen=True, slots=True, eq=False)
class Sampled:
    """Samples at one rate.

    Parameters
    ----------
    acceleration : ndarray of float64, shape (3, n_samples)
        In the unit of the file.
    rate_hz : float
        Sampling rate in Hz.
    notes : tuple of str
        What was done or noticed.
    """

    acceleration: NDArray[np.float64]
    rate_hz: float
    notes: tuple[str, ...] = ()


def settle_sampling(decoded: Decoded, request: Request) -> Sampled:
    """Settle the rate, and check that the samples are regular.

    Parameters
    ----------
    decoded : Decoded
        What the file says.
    request : Request
        What the caller says.

    Returns
    -------
    Sampled
        The same samples, or on request resampled ones, at one rate.

    Raises
    ------
    ValueError
        If no rate is known, two contradict each other, or the time stamps do not increase evenly.
    """
    requested = None if request.rate_hz is None else check_rate(request.rate_hz)
    stated = _agree(requested, decoded.rate_hz, who="the file")
    if decoded.time_s is None:
        if stated is None:
            raise ValueError("got no sampling rate and no time column, one is needed; give rate_hz=...")
        return Sampled(decoded.acceleration, stated)
    time_s = _check_stamps(decoded)
    measured_hz = (time_s.size - 1) / float(time_s[-1] - time_s[0])
    irregular = _irregular(time_s, decoded.time_step_s)
    if irregular.size == 0:
        rate_hz = _agree(stated, measured_hz, who="the time stamps") or measured_hz
        return Sampled(decoded.acceleration, rate_hz, _coarse_stamps(decoded, rate_hz))
    finding = _describe(time_s, irregular)
    if not request.resample:
        raise ValueError(
            f"got irregular sampling: {finding}; allowed is {JITTER_LIMIT:.0%} of the period; "
            "resample=True (command line: --resample) interpolates to an even rate"
        )
    resampled = _resample(decoded.acceleration, time_s, finding=finding)
    _agree(stated, resampled.rate_hz, who="the time stamps")
    return resampled


def _agree(stated: float | None, own: float | None, *, who: str) -> float | None:
    if stated is None or own is None:
        return stated or own
    if abs(stated / check_rate(own) - 1) > AGREEMENT:
        raise ValueError(f"got {stated:g} Hz, but {own:g} Hz by {who}; allowed is a difference of {AGREEMENT:.0%}")
    return stated


def _check_stamps(decoded: Decoded) -> NDArray[np.float64]:
    time_s, n_samples = decoded.time_s, decoded.acceleration.shape[1]
    if time_s is None or time_s.shape != (n_samples,):
        count = 0 if time_s is None else time_s.size
        raise ValueError(f"got {count} time stamps for {n_samples} samples, allowed is one stamp per sample")
    if n_samples < 2:  # noqa: PLR2004 - an interval has two ends
        raise ValueError(f"got {n_samples} sample with a time stamp, allowed is 2 or more: they give the rate")
    rising = np.diff(time_s) > 0  # false for NaN too
    if not rising.all():
        i = int(np.argmin(rising)) + 1
        place = f"sample {i}" if decoded.first_line is None else f"line {decoded.first_line + i}"
        raise ValueError(
            f"got time stamps that do not increase: {time_s[i]:.9g} after {time_s[i - 1]:.9g} s at {place}; "
            "mend the stamps, or leave the time column out and give rate_hz"
        )
    return time_s


def _irregular(time_s: NDArray[np.float64], step_s: float) -> NDArray[np.intp]:
    """Return the intervals off the median by more than the limit and the rounding of the stamps."""
    intervals = np.diff(time_s)
    period = float(np.median(intervals))
    # A rounded stamp is off by half a printed place, an interval by a whole one.
    rounding = max(step_s, 2 * float(np.spacing(np.abs(time_s).max())))
    return np.flatnonzero(np.abs(intervals - period) > JITTER_LIMIT * period + 1.001 * rounding)


def _describe(time_s: NDArray[np.float64], irregular: NDArray[np.intp]) -> str:
    intervals = np.diff(time_s)
    period = float(np.median(intervals))
    jitter = float(np.abs(intervals - period).max()) / period
    return (
        f"jitter up to {jitter:.1%} of the {period * 1e3:.6g} ms period, "
        f"{irregular.size} of {intervals.size} intervals off, the first at {time_s[irregular[0]]:.6f} s, "
        f"the longest {intervals.max() * 1e3:.6g} ms"
    )


def _coarse_stamps(decoded: Decoded, rate_hz: float) -> tuple[str, ...]:
    step_s = decoded.time_step_s
    if step_s * rate_hz <= JITTER_LIMIT:
        return ()
    share = step_s * rate_hz
    return (f"time stamps show steps of {step_s:g} s, {share:.0%} of the period: finer jitter cannot be seen",)


def _resample(acceleration: NDArray[np.float64], time_s: NDArray[np.float64], *, finding: str) -> Sampled:
    from scipy.interpolate import make_interp_spline

    if time_s.size < SPLINE_POINTS:
        raise ValueError(f"got {time_s.size} samples to resample, allowed is at least {SPLINE_POINTS}")
    elapsed = time_s - time_s[0]
    period = float(np.median(np.diff(time_s)))
    grid = np.arange(int(elapsed[-1] / period * (1 + 1e-12)) + 1) * period
    even = make_interp_spline(elapsed, acceleration, k=3, axis=1)(np.minimum(grid, elapsed[-1]))
    note = f"resampled on request to {grid.size} samples at {1 / period:.6g} Hz by cubic spline: {finding}"
    return Sampled(np.asarray(even, dtype=np.float64), 1 / period, (note,))
