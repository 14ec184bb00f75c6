"""A recording: three-axis acceleration that never travels without its rate.

Units: acceleration in m/s², rate in Hz, time in s.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

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
            raise ValueError(f"recording {self.name!r}: got shape {samples.shape}, allowed is (3, n) with n >= 1")
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
    """Digest what a recording holds, however it was stored: two readings of one file in different units differ.

    Parameters
    ----------
    recording : Recording
        The recording.

    Returns
    -------
    str
        SHA-256 of rate and samples, in hexadecimal digits.
    """
    digest = hashlib.sha256(np.float64(recording.rate_hz).tobytes())
    digest.update(recording.acceleration.tobytes())
    return digest.hexdigest()


def check_acceleration(acceleration: ArrayLike) -> NDArray[np.float64]:
    """Coerce to float64 of shape (..., 3, n), or say what is wrong.

    Parameters
    ----------
    acceleration : array_like, shape (..., 3, n_samples)
        Acceleration of the three axes, any unit.

    Returns
    -------
    ndarray of float64, shape (..., 3, n_samples)
        The same values, not copied if they already were float64.

    Raises
    ------
    ValueError
        If the values are not numbers, not finite, or not three axes.
    """
    samples = coerce_acceleration(acceleration)
    check_finite(samples, "acceleration")
    return samples


def coerce_acceleration(acceleration: ArrayLike) -> NDArray[np.float64]:
    """Coerce to float64 of shape (..., 3, n); whether the values are finite is left to the caller.

    Parameters
    ----------
    acceleration : array_like, shape (..., 3, n_samples)
        Acceleration of the three axes, any unit.

    Returns
    -------
    ndarray of float64, shape (..., 3, n_samples)
        The same values, not copied if they already were float64.

    Raises
    ------
    ValueError
        If the values are not numbers, or not three axes.
    """
    samples = coerce_real(acceleration, "acceleration")
    if samples.ndim < 2 or samples.shape[-2] != AXES:  # noqa: PLR2004 - axes x samples
        raise ValueError(f"acceleration: got shape {samples.shape}, allowed is (..., 3, n): three axes, then samples")
    return samples


def coerce_real(values: ArrayLike, what: str) -> NDArray[np.float64]:
    """Coerce real numbers to float64, or say what they are instead.

    Parameters
    ----------
    values : array_like
        Any shape.
    what : str
        What the values are, for the message.

    Returns
    -------
    ndarray of float64
        The same values, not copied if they already were float64.

    Raises
    ------
    ValueError
        If they are text, complex, times, masked or of unequal lengths.
    """
    try:
        given = np.asarray(values)
    except ValueError as error:
        raise ValueError(f"{what}: got rows of unequal lengths ({error}); allowed is one array") from None
    if given.dtype.kind not in "biuf":
        raise ValueError(f"{what}: got values of type {given.dtype}, allowed are real numbers")
    if np.ma.is_masked(values):
        raise ValueError(f"{what}: got masked values; fill or cut them out first")
    return given.astype(np.float64, copy=False)


def check_finite(samples: NDArray[np.float64], what: str) -> None:
    """Raise ValueError that counts and places the values that are not finite.

    Parameters
    ----------
    samples : ndarray
        Any shape.
    what : str
        What the samples are, for the message.

    Raises
    ------
    ValueError
        If any value is NaN or infinite.
    """
    # A finite sum proves that all are finite, in one pass; an infinite one may only be an overflow.
    with np.errstate(over="ignore", invalid="ignore"):
        if np.isfinite(samples.sum()):
            return
    bad = np.argwhere(~np.isfinite(samples))
    if len(bad):
        place = ", ".join(str(i) for i in bad[0])
        raise ValueError(f"{what}: got {len(bad)} values that are not finite (first at {place}); remove or mend them")


def check_rate(rate_hz: float) -> float:
    """Return the rate as float, or say what is wrong.

    Parameters
    ----------
    rate_hz : float
        Sampling rate in Hz.

    Returns
    -------
    float
        The same rate.

    Raises
    ------
    ValueError
        If it is not a finite number above 0.
    """
    try:
        rate = float(rate_hz)
    except (TypeError, ValueError):
        rate = float("nan")
    if not (np.isfinite(rate) and rate > 0):
        raise ValueError(f"rate_hz: got {rate_hz!r}, allowed is a finite number of Hz above 0")
    return rate
