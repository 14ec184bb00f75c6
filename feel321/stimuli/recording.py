"""Recordings: three axes of acceleration at a sampling rate, and the checks that every reducer and metric begins with.

Units: acceleration in m/s², rate in Hz, time in s.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from feel321.arguments import check_finite, check_name, check_rate, coerce_real
from feel321.records import Result
from feel321.types import Samples

if TYPE_CHECKING:
    from pandas import DataFrame

Signal: TypeAlias = "Recording | Reduced | ArrayLike"
"""A recording, a reduced one, or plain samples, which come with their rate."""

STANDARD_GRAVITY = 9.80665  # m/s² per g, CGPM 1901

UNITS = {"m/s^2": 1.0, "g": STANDARD_GRAVITY, "mg": STANDARD_GRAVITY / 1000}
"""Accepted units of acceleration, each with its size in m/s²."""

AXES = 3

SAFE_PEAK = (1e-60, 1e60)
"""Fourth powers of anything between these stay far inside float64's range, for any length."""


@dataclass(frozen=True, slots=True, repr=False, eq=False)
class Recording(Result):
    """Three-axis acceleration measured on a hand-held tool.

    Parameters
    ----------
    acceleration : array_like, shape (3, n_samples)
        Acceleration, kept as m/s²: a read-only float64 copy.
    rate_hz : float
        Sampling rate in Hz, greater than 0.
    name : str
        What the recording is called in tables and file names.
    warnings : tuple of str
        What the reader noticed (saturated runs, silent axes, an assumed unit); never repaired.
    sha256 : str
        Digest of the source file; if left out, of the samples and the rate.
    unit : {"m/s^2", "g", "mg"}
        Unit of the given acceleration; that of the recording is always m/s².
    sha256_of : str
        Set by the class: the digest of source and of samples for which `sha256` was given. So a copy with other
        samples or another rate gets a digest of its own.

    Raises
    ------
    ValueError
        If the shape is not (3, n) with n >= 1, a value is not finite, or the rate is not above 0.

    Examples
    --------
    >>> from feel321 import stimuli
    >>> tap = stimuli.Recording([[0, 1, 0], [0, 2, 0], [0, 2, 0]], rate_hz=1000, name="tap")
    >>> tap
    Recording('tap', 3 samples at 1000 Hz, 0.003 s)
    >>> tap.times_s
    array([0.   , 0.001, 0.002])
    """

    acceleration: Samples
    rate_hz: float
    name: str = ""
    warnings: tuple[str, ...] = ()
    sha256: str = ""
    unit: str = field(default="m/s^2", kw_only=True)
    sha256_of: str = field(default="", kw_only=True)

    def __post_init__(self) -> None:
        """Check and convert once, when the recording is made."""
        given = coerce_acceleration(self.acceleration)
        if given.ndim != 2 or given.shape[1] == 0:  # noqa: PLR2004 - axes x samples
            must = f"recording {self.name!r} must have the shape (3, n) with n >= 1"
            raise ValueError(f"{must}, got {given.shape}")
        size = UNITS[check_name(self.unit, UNITS, "unit")]
        with np.errstate(over="ignore", invalid="ignore"):
            samples = np.multiply(given, size, order="C")
        check_finite(samples, "acceleration")
        samples.flags.writeable = False
        object.__setattr__(self, "unit", "m/s^2")
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

    @property
    def times_s(self) -> Samples:
        """Time of each sample in s, from 0."""
        return np.arange(self.n_samples) / self.rate_hz

    def __array__(
        self, dtype: DTypeLike = None, *, copy: bool | None = None
    ) -> NDArray[np.generic]:
        """Return the samples."""
        return np.array(self.acceleration, dtype, copy=copy)

    def crop(self, start_s: float, end_s: float) -> Recording:
        """Keep a part.

        Parameters
        ----------
        start_s, end_s : float
            Its start and end in s.

        Returns
        -------
        Recording
            The part, with a digest of its own.
        """
        if not 0 <= start_s < end_s <= self.duration_s * (1 + 1e-9):
            raise ValueError(
                f"crop_s must be (start, end) with 0 <= start < end <= {self.duration_s:.4f} s, the duration of "
                f"{self.name!r}; got ({start_s}, {end_s})"
            )
        start, end = (round(time * self.rate_hz) for time in (start_s, end_s))
        if end <= start:
            got = f"crop_s ({start_s}, {end_s}) holds no sample at {self.rate_hz:g} Hz"
            raise ValueError(f"{got}; keep a longer part")
        return replace(self, acceleration=self.acceleration[:, start:end])

    def to_frame(self) -> DataFrame:
        """Return the samples as a table.

        Returns
        -------
        DataFrame
            Columns x, y, z in m/s², indexed by time_s.
        """
        import pandas as pd

        index = pd.Index(self.times_s, name="time_s")
        return pd.DataFrame(self.acceleration.T, index, columns=["x", "y", "z"])

    def summary(self) -> str:
        """Describe the recording for reading.

        Returns
        -------
        str
            Name, length, strength per axis, and what the reader noticed.
        """
        strength = np.sqrt(np.mean(np.square(self.acceleration), axis=1))
        rms = ", ".join(f"{axis} {value:.3g}" for axis, value in zip("xyz", strength, strict=True))
        return "\n".join([repr(self), f"RMS in m/s^2: {rms}", *self.warnings])

    def __repr__(self) -> str:
        """Name, length and rate."""
        return f"Recording({self.name!r}, {_describe_length(self.n_samples, self.rate_hz)})"


@dataclass(frozen=True, slots=True, repr=False, eq=False)
class Reduced(Result):
    """A recording reduced to one axis; NumPy takes it as its samples.

    Parameters
    ----------
    samples : ndarray, shape (n_samples,)
        The reduced signal, in the recording's unit.
    rate_hz : float
        Sampling rate in Hz.
    reducer : str
        Name of the reducer.
    recording : str
        Name of the recording.
    """

    samples: Samples
    rate_hz: float
    reducer: str
    recording: str = ""

    def __array__(
        self, dtype: DTypeLike = None, *, copy: bool | None = None
    ) -> NDArray[np.generic]:
        """Return the samples."""
        return np.array(self.samples, dtype, copy=copy)

    def __len__(self) -> int:
        """Count the samples."""
        return len(self.samples)

    def to_frame(self) -> DataFrame:
        """Return the samples as a table.

        Returns
        -------
        DataFrame
            One column, named after the reducer, indexed by time_s.
        """
        import pandas as pd

        index = pd.Index(np.arange(len(self)) / self.rate_hz, name="time_s")
        return pd.DataFrame({self.reducer: self.samples}, index)

    def __repr__(self) -> str:
        """Reducer and recording, length and rate."""
        of = f" of {self.recording!r}" if self.recording else ""
        return f"Reduced({self.reducer!r}{of}, {_describe_length(len(self), self.rate_hz)})"


def _describe_length(n_samples: int, rate_hz: float) -> str:
    return f"{n_samples} samples at {rate_hz:g} Hz, {n_samples / rate_hz:g} s"


def as_signal(
    signal: Signal, rate_hz: float | None = None, *, otherwise: float | None = None
) -> tuple[ArrayLike, float]:
    """Take samples and their rate, which is checked: of a Recording or a Reduced, or as given."""
    given_hz = None if rate_hz is None else check_rate(rate_hz)
    if not isinstance(signal, Recording | Reduced):
        rate = given_hz or otherwise
        if rate is None:
            raise TypeError("rate_hz must be given with plain samples; or pass a Recording")
        return signal, rate
    if given_hz not in {None, signal.rate_hz}:
        must = f"rate_hz must be left out or {signal.rate_hz:g}, that of the signal"
        raise ValueError(f"{must}; got {given_hz:g}")
    samples = signal.acceleration if isinstance(signal, Recording) else signal.samples
    return samples, signal.rate_hz


def as_samples(signal: Signal, rate_hz: float | None) -> tuple[Samples, float]:
    """Take finite samples, (n,) or (axes, n), and their rate."""
    given, rate = as_signal(signal, rate_hz)
    samples = coerce_real(given, "signal")
    if samples.ndim not in {1, 2} or not samples.size:
        got = f"got {samples.shape}"
        raise ValueError(f"signal must have the shape (n,) or (axes, n) with n >= 1, {got}")
    check_finite(samples, "signal")
    return samples, rate


def as_pair(
    acceleration: Signal, reduced: ArrayLike | None, rate_hz: float | None,
    *, otherwise: float | None = None,
) -> tuple[ArrayLike, float]:  # fmt: skip
    """Take a recording's samples and rate, which must be that of the reduced signal if this brings one."""
    own = reduced.rate_hz if isinstance(reduced, Reduced) else None
    given, rate = as_signal(acceleration, rate_hz, otherwise=own or otherwise)
    if own not in {None, rate}:
        raise ValueError(f"reduced must have the recording's rate, {rate:g} Hz; got {own:g} Hz")
    return given, rate


def digest_samples(recording: Recording) -> str:
    """Digest the samples and the rate: two readings of one file in different units differ."""
    digest = hashlib.sha256(np.float64(recording.rate_hz).tobytes())
    digest.update(recording.acceleration.tobytes())
    return digest.hexdigest()


def check_acceleration(acceleration: ArrayLike) -> Samples:
    """Coerce to finite float64 of shape (..., 3, n), or say what is wrong."""
    samples = coerce_acceleration(acceleration)
    check_finite(samples, "acceleration")
    return samples


def suggest_transpose(samples: Samples) -> str:
    """Say what to do with samples by axes, (n, 3); nothing of other shapes."""
    is_turned = samples.ndim > 1 and samples.shape[-1] == AXES != samples.shape[-2]
    return "; transpose it: samples.T" if is_turned else ""


def coerce_acceleration(acceleration: ArrayLike) -> Samples:
    """Coerce to float64 of shape (..., 3, n); whether the values are finite is left to the caller."""
    samples = coerce_real(acceleration, "acceleration")
    if samples.ndim < 2 or samples.shape[-2] != AXES:  # noqa: PLR2004 - axes x samples
        must = "acceleration must have the shape (..., 3, n), three axes, then samples"
        raise ValueError(f"{must}; got {samples.shape}{suggest_transpose(samples)}")
    return samples


def admit(acceleration: ArrayLike, rate_hz: float) -> tuple[Samples, Samples]:
    """Check a reducer's input, (..., 3, n), whose squares must not overflow or vanish; and its energy, (..., 1)."""
    check_rate(rate_hz)
    samples = coerce_acceleration(acceleration)
    energy = _energy(samples)
    low, high = SAFE_PEAK
    # The root of the energy is at least the peak and at most so many times it; one pass tells that all is ordinary.
    if energy.size == 1 and low**2 <= energy.item() <= high**2:
        return samples, energy
    if not np.all((energy == 0) | ((energy >= low**2) & (energy <= high**2))) or (
        not np.all(energy) and np.abs(samples).max(initial=0.0, where=energy[..., None] == 0) > 0
    ):
        check_finite(samples, "acceleration")
        must = f"acceleration must have peaks from {low:g} to {high:g}, or none"
        raise ValueError(f"{must}, got {largest(samples):.3g}; is it in m/s^2?")
    return samples, energy


def _energy(samples: Samples) -> Samples:
    """Sum all squares of each signal: (..., 1)."""
    with np.errstate(over="ignore", invalid="ignore"):
        if samples.ndim > 2:  # noqa: PLR2004 - axes x samples
            return np.asarray(np.einsum("...in,...in->...", samples, samples))[..., None]
        flat = samples.reshape(-1)
        return np.array([np.dot(flat, flat)])


def each_by_itself(work: Callable[[Samples], Samples], signals: Samples, ndim: int = 2) -> Samples:
    """Apply what is done to one signal, of `ndim` dimensions, to each of a batch.

    The order in which einsum adds depends on the shape that it is given: sums over samples, and with them the last
    digit of a result, would depend on the batch.
    """
    if signals.ndim == ndim:
        return np.asarray(work(signals))
    batch, shape = signals.shape[:-ndim], signals.shape[-ndim:]
    found = [work(one) for one in signals.reshape(math.prod(batch), *shape)]
    return np.reshape(found, (*batch, *(found[0] if found else work(np.zeros(shape))).shape))


def add_squares(signals: Samples, ndim: int = 1) -> Samples:
    """Add the squares of signals of `ndim` dimensions, each by itself, (...)."""
    inside = "in"[-ndim:]
    return each_by_itself(
        lambda one: np.asarray(np.einsum(f"{inside},{inside}->", one, one)), signals, ndim
    )


def largest(samples: Samples) -> float:
    """Return the largest magnitude, 0 for an empty array, without making a copy."""
    return max(float(samples.max()), -float(samples.min())) if samples.size else 0.0


def check_reduced(reduced: ArrayLike, shape: tuple[int, ...]) -> Samples:
    """Coerce a reduced signal to float64, or say why it does not fit a recording of the given shape, (3, n)."""
    if len(shape) != 2 or shape[-1] == 0:  # noqa: PLR2004 - axes x samples
        must = "acceleration must have the shape (3, n) with n >= 1, one recording at a time"
        raise ValueError(f"{must}; got {shape}")
    signal = coerce_real(reduced, "reduced")
    if signal.shape != shape[-1:]:
        must = f"the shape {shape[-1:]}, one axis with as many samples as the recording"
        raise ValueError(f"reduced must have {must}; got {signal.shape}")
    check_finite(signal, "reduced")
    if largest(signal) > SAFE_PEAK[1]:
        got = f"got {largest(signal):.3g}; is it in m/s^2?"
        raise ValueError(f"reduced must have a peak of at most {SAFE_PEAK[1]:g}, {got}")
    return signal
