"""Power spectral densities and spectrograms, for looking at recordings and reduced signals."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from feel321.records import Result
from feel321.stimuli.recording import AXES, Signal, as_samples, suggest_transpose
from feel321.stimuli.reducers.axes import DEFAULT_WINDOW_S, window_samples
from feel321.types import Samples

if TYPE_CHECKING:
    from pandas import DataFrame


@dataclass(frozen=True, slots=True, repr=False, eq=False)
class Spectrum(Result):
    """A power spectral density.

    Parameters
    ----------
    frequencies_hz : ndarray, shape (n_frequencies,)
        Frequencies in Hz.
    density : ndarray, shape (n_frequencies,)
        One-sided density in (m/s²)²/Hz; of a recording, the sum over its axes, which turning the sensor cannot change.
    window_s : float
        Length of the averaged windows in s.
    """

    frequencies_hz: Samples
    density: Samples
    window_s: float

    def to_frame(self) -> DataFrame:
        """Return the spectrum as a table.

        Returns
        -------
        DataFrame
            Column density, indexed by frequency_hz.
        """
        import pandas as pd

        index = pd.Index(self.frequencies_hz, name="frequency_hz")
        return pd.DataFrame({"density": self.density}, index)


@dataclass(frozen=True, slots=True, repr=False, eq=False)
class Spectrogram(Result):
    """Power spectral densities of short windows.

    Parameters
    ----------
    times_s : ndarray, shape (n_windows,)
        Middle of each window in s.
    frequencies_hz : ndarray, shape (n_frequencies,)
        Frequencies in Hz.
    density : ndarray, shape (n_frequencies, n_windows)
        One-sided density in (m/s²)²/Hz, as of a `Spectrum`.
    window_s : float
        Length of a window in s.
    """

    times_s: Samples
    frequencies_hz: Samples
    density: Samples
    window_s: float

    def to_frame(self) -> DataFrame:
        """Return the spectrogram as a table.

        Returns
        -------
        DataFrame
            A row per frequency_hz, a column per time_s.
        """
        import pandas as pd

        index = pd.Index(self.frequencies_hz, name="frequency_hz")
        return pd.DataFrame(self.density, index, pd.Index(self.times_s, name="time_s"))


def psd(signal: Signal, *, rate_hz: float | None = None, window_s: float = 0.25) -> Spectrum:
    """Estimate the power spectral density by Welch's method (Hann windows that overlap by half).

    Parameters
    ----------
    signal : Recording, Reduced, or array_like of shape (n_samples,) or (3, n_samples)
        Acceleration in m/s²; plain samples need `rate_hz`.
    rate_hz : float, optional
        Sampling rate of plain samples in Hz.
    window_s : float
        Length of a window in s, rounded to an even number of samples and at most that of the signal (the result holds
        what it came to); frequencies are one over it apart.

    Returns
    -------
    Spectrum
        Frequencies and density; the mean is not removed.

    Examples
    --------
    >>> from feel321 import stimuli
    >>> found = stimuli.psd(stimuli.make_scene("circular_motion"), window_s=0.02)
    >>> float(found.frequencies_hz[found.density.argmax()])
    150.0
    """
    density, frequencies, _, length = _estimate(signal, rate_hz, window_s)
    return Spectrum(frequencies, density.mean(axis=-1), length)


def spectrogram(
    signal: Signal, *, rate_hz: float | None = None, window_s: float = DEFAULT_WINDOW_S
) -> Spectrogram:
    """Estimate the power spectral density in short Hann windows that overlap by half.

    Parameters
    ----------
    signal : Recording, Reduced, or array_like of shape (n_samples,) or (3, n_samples)
        Acceleration in m/s²; plain samples need `rate_hz`.
    rate_hz : float, optional
        Sampling rate of plain samples in Hz.
    window_s : float
        Length of a window in s: 35 ms is that of the windowed reducers.

    Returns
    -------
    Spectrogram
        Times, frequencies and density; the mean is not removed.

    Examples
    --------
    >>> from feel321 import stimuli
    >>> found = stimuli.spectrogram(stimuli.make_scene("hard_taps", duration_s=1))
    >>> found.density.shape == (len(found.frequencies_hz), len(found.times_s))
    True
    """
    density, frequencies, times, length = _estimate(signal, rate_hz, window_s)
    return Spectrogram(times, frequencies, density, length)


def _estimate(
    signal: Signal, rate_hz: float | None, window_s: float
) -> tuple[Samples, Samples, Samples, float]:
    """Densities, (n_frequencies, n_windows), frequencies, times, and the length of a window in s."""
    from scipy.signal import spectrogram as by_scipy

    samples, rate = as_samples(signal, rate_hz)
    if samples.shape[:-1] not in {(), (AXES,)}:
        got = f"got the shape {samples.shape}{suggest_transpose(samples)}"
        raise ValueError(f"signal must have one axis or three, {got}")
    length = min(window_samples(window_s, rate), samples.shape[-1])
    windows: dict[str, Any] = {"window": "hann", "nperseg": length, "noverlap": length // 2}
    both = np.atleast_2d(samples)
    frequencies, times, density = by_scipy(both, rate, detrend=False, **windows)
    return density.sum(axis=0), frequencies, times, length / rate
