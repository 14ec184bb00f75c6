"""Recordings: three axes of acceleration at a sampling rate, checked at the door.

Units: acceleration in m/s², rate in Hz, time in s.

Reducers are homogeneous of degree one, so a recording whose squares would overflow or vanish is scaled by a
power of two (which is exact) and its output scaled back. Ordinary recordings pass unscaled.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

# A recording: three-axis acceleration that never travels without its rate.

STANDARD_GRAVITY = 9.80665
"""m/s² per g, CGPM 1901."""

UNITS = {"m/s^2": 1.0, "g": STANDARD_GRAVITY, "mg": STANDARD_GRAVITY / 1000}
"""Accepted units of acceleration, each with its size in m/s²."""

AXES = 3


@dataclass(frozen=True, slots=True, eq=False)
class Recording:
    """Three-axis acceleration measured on a hand-held tool.

    Parameters
    ----------
    acceleration : array_like, shape (3, n_samples)
        Acceleration in m/s². Copied to float64 and made read-only.
    rate_hz : float
        Sampling rate in Hz, greater than 0.
    name : str
        What the recording is called in tables and file names.
    warnings : tuple of str
        What the reader noticed (saturated runs, silent axes, an assumed unit); never repaired.
    sha256 : str
        Digest of the source file; if left out, of the samples and the rate.
    sha256_of : str
        Set by the class: the digest of source and of samples for which `sha256` was given. So a copy made by
        `dataclasses.replace` with other samples or another rate gets a digest of its own.

    Raises
    ------
    ValueError
        If the shape is not (3, n) with n >= 1, a value is not finite, or the rate is not above 0.

    Examples
    --------
    >>> tap = Recording([[0, 1, 0], [0, 2, 0], [0, 2, 0]], rate_hz=1000, name="tap")
    >>> tap.n_samples, tap.duration_s
    (3, 0.003)
    """

    acceleration: NDArray[np.float64]
    rate_hz: float
    name: str
    warnings: tuple[str, ...] = ()
    sha256: str = ""
    sha256_of: str = field(default="", repr=False, kw_only=True)

    def __post_init__(self) -> None:
        """Coerce once, at the door."""
        samples = check_acceleration(self.acceleration).copy()
        if samples.ndim != 2 or samples.shape[1] == 0:  # noqa: PLR2004 - axes x samples
            raise ValueError(
                f"recording {self.name!r}: got shape {samples.shape}, allowed is (3, n) with n >= 1"
            )
        samples.flags.writeable = False
        object.__setattr__(self, "acceleration", samples)
        object.__setattr__(self, "rate_hz", check_rate(self.rate_hz))
        own = digest_samples(self)
        source, _, of_samples = self.sha256_of.rpartition(" ")
        stale = source == self.sha256 and of_samples != own
        object.__setattr__(self, "sha256", own if stale else self.sha256 or own)
        object.__setattr__(self, "sha256_of", f"{self.sha256} {own}")

    @property
    def n_samples(self) -> int:
        """Number of samples per axis."""
        return int(self.acceleration.shape[1])

    @property
    def duration_s(self) -> float:
        """Duration in s."""
        return self.n_samples / self.rate_hz


def digest_samples(recording: Recording) -> str:
    """Digest what a recording holds, however it was stored: two readings of one file in different units differ."""
    digest = hashlib.sha256(np.float64(recording.rate_hz).tobytes())
    digest.update(recording.acceleration.tobytes())
    return digest.hexdigest()


def check_acceleration(acceleration: ArrayLike) -> NDArray[np.float64]:
    """Coerce to float64 of shape (..., 3, n), or say what is wrong.

    acceleration: (..., 3, n_samples); returns (..., 3, n_samples).
    """
    samples = coerce_acceleration(acceleration)
    check_finite(samples, "acceleration")
    return samples


def coerce_acceleration(acceleration: ArrayLike) -> NDArray[np.float64]:
    """Coerce to float64 of shape (..., 3, n); whether the values are finite is left to the caller.

    acceleration: (..., 3, n_samples); returns (..., 3, n_samples).
    """
    samples = coerce_real(acceleration, "acceleration")
    if samples.ndim < 2 or samples.shape[-2] != AXES:  # noqa: PLR2004 - axes x samples
        raise ValueError(
            f"acceleration: got shape {samples.shape}, allowed is (..., 3, n): three axes, then samples"
        )
    return samples


def coerce_real(values: ArrayLike, what: str) -> NDArray[np.float64]:
    """Coerce real numbers to float64, or say what they are instead."""
    try:
        given = np.asarray(values)
    except ValueError as error:
        raise ValueError(
            f"{what}: got rows of unequal lengths ({error}); allowed is one array"
        ) from None
    if given.dtype.kind not in "biuf":
        raise ValueError(f"{what}: got values of type {given.dtype}, allowed are real numbers")
    if np.ma.is_masked(values):
        raise ValueError(f"{what}: got masked values; fill or cut them out first")
    return given.astype(np.float64, copy=False)


def check_finite(samples: NDArray[np.float64], what: str) -> None:
    """Raise ValueError that counts and places the values that are not finite."""
    # A finite sum proves that all are finite, in one pass; an infinite one may only be an overflow.
    with np.errstate(over="ignore", invalid="ignore"):
        if np.isfinite(samples.sum()):
            return
    bad = np.argwhere(~np.isfinite(samples))
    if len(bad):
        place = ", ".join(str(i) for i in bad[0])
        raise ValueError(
            f"{what}: got {len(bad)} values that are not finite (first at {place}); remove or mend them"
        )


def check_rate(rate_hz: float) -> float:
    """Return the rate as float, or say what is wrong."""
    try:
        rate = float(rate_hz)
    except (TypeError, ValueError):
        rate = float("nan")
    if not (np.isfinite(rate) and rate > 0):
        raise ValueError(f"rate_hz: got {rate_hz!r}, allowed is a finite number of Hz above 0")
    return rate


# The one door of every reducer: coerce, refuse, and bring extreme values into a safe range.

# Fourth powers of anything between these stay far inside float64's range, for any length.
SAFE_PEAK = (1e-60, 1e60)


class Admitted(NamedTuple):
    """Samples in a safe range, and the way back.

    samples: (..., 3, n_samples); energy: (..., 1); exponents: (..., 1).
    """

    samples: NDArray[np.float64]
    energy: NDArray[np.float64]
    exponents: NDArray[np.intc] | None = None

    def restore(self, reduced: NDArray[np.float64]) -> NDArray[np.float64]:
        """Give a reduced signal back in the caller's unit.

        reduced: (..., n_samples); returns (..., n_samples).
        """
        return reduced if self.exponents is None else np.ldexp(reduced, self.exponents)


def admit(acceleration: ArrayLike, rate_hz: float) -> Admitted:
    """Check a reducer's input, shape (..., 3, n_samples), and scale it only where squares would overflow or vanish.

    acceleration: (..., 3, n_samples).
    """
    check_rate(rate_hz)
    samples = coerce_acceleration(acceleration)
    energy = _energy(samples)
    # The root of the energy is at least the peak and at most so many times it; one pass tells that all is ordinary.
    if np.all(is_safe(np.sqrt(energy))) and (np.all(energy) or not samples.any()):
        return Admitted(samples, energy)
    check_finite(samples, "acceleration")
    peaks = np.abs(samples).max(axis=(-2, -1), initial=0.0)[..., None]
    exponents = np.where(is_safe(peaks), 0, np.frexp(peaks)[1])
    samples = np.ldexp(samples, -exponents[..., None])
    return Admitted(samples, _energy(samples), exponents)


def _energy(samples: NDArray[np.float64]) -> NDArray[np.float64]:
    with np.errstate(over="ignore", invalid="ignore"):
        return np.asarray(np.einsum("...in,...in->...", samples, samples))[..., None]


def is_safe(peaks: ArrayLike) -> NDArray[np.bool_]:
    """Tell which peaks need no scaling."""
    peaks = np.asarray(peaks)
    return np.asarray((peaks == 0.0) | ((peaks >= SAFE_PEAK[0]) & (peaks <= SAFE_PEAK[1])))


def largest(samples: NDArray[np.float64]) -> float:
    """Return the largest magnitude, 0 for an empty array, without making a copy."""
    return max(float(samples.max()), -float(samples.min())) if samples.size else 0.0


def check_reduced(reduced: ArrayLike, shape: tuple[int, ...]) -> NDArray[np.float64]:
    """Coerce a reduced signal to float64, or say why it does not go with its recording.

    reduced: (n_samples,); shape: shape of the recording's acceleration, to be (3, n_samples) with
    n_samples >= 1; returns (n_samples,).
    """
    if len(shape) != 2 or shape[-1] == 0:  # noqa: PLR2004 - axes x samples
        raise ValueError(
            f"acceleration: got shape {shape}, allowed is (3, n) with n >= 1: one recording at a time"
        )
    signal = coerce_real(reduced, "reduced")
    if signal.shape != shape[-1:]:
        raise ValueError(
            f"reduced: got shape {signal.shape}, allowed is {shape[-1:]}: as many samples as the recording, one axis"
        )
    check_finite(signal, "reduced")
    return signal
