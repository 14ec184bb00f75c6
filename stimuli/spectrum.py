"""Energy spectra smoothed as coarsely as people tell frequencies apart.

Conventions: spectra are one-sided energy spectral densities on the DFT's grid, shape (..., n_bins), bin k at
k * rate_hz / n_samples; frequencies in Hz.

The kernel is a rectangle (Daniell smoothing) of full width 0.22 f around f: the Weber fraction of vibration frequency.
The paper used MATLAB's `spafdr`, which averages the product of the transforms "over local frequency regions" of a
chosen, frequency-dependent width (its *resolution*); the width here is that resolution, 0.22 f, edge to edge. MATLAB
does not document its kernel's shape; the match metrics depend on it little, because both spectra are smoothed alike.

References
----------
.. [1] N. Landin, J. M. Romano, W. McMahan, K. J. Kuchenbecker, "Dimensional reduction of high-frequency accelerations
   for haptic rendering", EuroHaptics 2010, section 3. doi:10.1007/978-3-642-14075-4_12
.. [2] P. J. Daniell, discussion, Journal of the Royal Statistical Society (Supplement) 8, 1946, 88-90.
"""

from __future__ import annotations

from types import MappingProxyType
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from numpy.typing import NDArray

    Grid = Literal["linear", "log"]

WEBER_FRACTION = 0.22
"""Smallest relative change of vibration frequency that people notice; full width of the smoothing over its centre."""

LOWEST_HZ = 20.0
HIGHEST_HZ = 1000.0
"""Range in which Pacinian corpuscles, and so the metrics, are sensitive."""

NUMERICAL_FLOOR = 1e-12
"""Frequencies whose smoothed energy is below this share of the recording's mean energy per bin are left out: there the
spectrum is the rounding error of the transforms, not a vibration."""


def energy_spectrum(samples: NDArray[np.float64], bins: slice = slice(None)) -> NDArray[np.float64]:
    """Compute the energy of a signal at every DFT frequency, or at some of them.

    Parameters
    ----------
    samples : ndarray, shape (..., n_samples)
        Real signals.
    bins : slice
        Which of the n_samples // 2 + 1 bins of the one-sided spectrum.

    Returns
    -------
    ndarray of float64, shape (..., n_bins)
        Squared magnitude of the one-sided spectrum.
    """
    from scipy import fft

    spectrum = fft.rfft(samples)[..., bins]
    energy = np.square(spectrum.real)
    energy += np.square(spectrum.imag)
    return energy


def linear_grid(n_samples: int, rate_hz: float) -> NDArray[np.float64]:
    """DFT frequencies from 20 Hz to 1000 Hz, or to the Nyquist frequency if that is lower.

    Parameters
    ----------
    n_samples : int
        Length of the signal.
    rate_hz : float
        Sampling rate in Hz.

    Returns
    -------
    ndarray of float64, shape (n_frequencies,)
        Frequencies in Hz, possibly none.

    Examples
    --------
    >>> linear_grid(10, 300.0)
    array([ 30.,  60.,  90., 120., 150.])
    """
    spacing = rate_hz / n_samples
    # The tolerance keeps a frequency that is 20 Hz or 1000 Hz but for the rounding of the rate.
    first = int(np.ceil(LOWEST_HZ / spacing * (1 - 1e-12)))
    last = int(np.floor(min(HIGHEST_HZ / spacing * (1 + 1e-12), n_samples / 2)))
    return np.arange(first, last + 1, dtype=np.float64) * spacing


def log_grid(n_samples: int, rate_hz: float, *, points_per_octave: int = 24) -> NDArray[np.float64]:
    """Logarithmically spaced frequencies from 20 Hz to 1000 Hz, or to the Nyquist frequency if that is lower.

    Parameters
    ----------
    n_samples : int
        Length of the signal (too short a signal for 20 Hz gets no frequencies below its spacing).
    rate_hz : float
        Sampling rate in Hz.
    points_per_octave : int
        Density of the grid.

    Returns
    -------
    ndarray of float64, shape (n_frequencies,)
        Frequencies in Hz, possibly none.
    """
    lowest, highest = max(LOWEST_HZ, rate_hz / n_samples), min(HIGHEST_HZ, rate_hz / 2)
    if lowest > highest:
        return np.zeros(0)
    n_points = int(np.log2(highest / lowest) * points_per_octave) + 1
    return lowest * 2.0 ** (np.arange(n_points) / points_per_octave)


class WeberSmoothing:
    """Running mean over 0.22 f around f, for one grid: O(n), without loops or matrices over frequencies.

    Parameters
    ----------
    frequencies_hz : ndarray, shape (n_frequencies,)
        Where the smoothed spectrum is wanted.
    spacing_hz : float
        Distance of the DFT's frequencies.
    n_bins : int
        Number of bins of the one-sided spectrum.

    Attributes
    ----------
    bins : slice
        The bins that the smoothing reads; it is to be called with these.

    Notes
    -----
    Each bin's energy is spread evenly over one spacing, so the window's edges may cut bins. A window narrower than one
    spacing gives the bin itself; one that reaches beyond the last bin is cut off there and averaged over what is left.
    Bins far below the lowest frequency, the offset among them, never enter the running sum, and the sum is kept in
    extended precision where the platform has it: a strong tone costs its weak neighbours no accuracy.
    """

    def __init__(self, frequencies_hz: NDArray[np.float64], spacing_hz: float, n_bins: int) -> None:
        centre = frequencies_hz / spacing_hz + 0.5
        half = np.maximum(WEBER_FRACTION / 2 * frequencies_hz / spacing_hz, 0.5)
        low, high = np.maximum(centre - half, 0.0), np.minimum(centre + half, float(n_bins))
        first = int(low[0]) if len(low) else 0
        last = min(int(np.ceil(high[-1])) + 1, n_bins) if len(high) else 0
        self.bins = slice(first, last)
        self._low, self._high = (_Edges.at(edge - first, last - first) for edge in (low, high))
        self._width = high - low

    def __call__(self, spectrum: NDArray[np.float64]) -> NDArray[np.float64]:
        """Smooth spectra.

        Parameters
        ----------
        spectrum : ndarray, shape (..., number of `bins`)
            Energy per bin (or any difference of energies), at `bins`.

        Returns
        -------
        ndarray of float64, shape (..., n_frequencies)
            Mean energy per bin around each frequency.
        """
        running = np.zeros((*spectrum.shape[:-1], spectrum.shape[-1] + 1), dtype=np.longdouble)
        np.cumsum(spectrum, axis=-1, out=running[..., 1:])
        low, high = self._low, self._high
        whole = (running[..., high.bin] - running[..., low.bin]).astype(np.float64)
        cut = high.share * spectrum[..., high.bin] - low.share * spectrum[..., low.bin]
        return np.asarray((whole + cut) / self._width)


class _Edges(NamedTuple):
    """Where the windows' edges cut the running sum: after so many whole bins, and a share of the next."""

    bin: NDArray[np.intp]
    share: NDArray[np.float64]

    @classmethod
    def at(cls, position: NDArray[np.float64], n_bins: int) -> _Edges:
        whole = np.clip(position.astype(np.intp), 0, max(n_bins - 1, 0))
        return cls(whole, position - whole)


GRIDS: Mapping[str, Callable[[int, float], NDArray[np.float64]]] = MappingProxyType(
    {"linear": linear_grid, "log": log_grid}
)
"""Name -> frequencies that the spectral match averages over."""


class OriginalSpectrum:
    """The smoothed spectrum of one recording, ready to be compared with many reduced signals.

    The sum of the axes' energies does not change when the sensor is turned, so one such spectrum serves every
    orientation.

    Parameters
    ----------
    samples : ndarray, shape (3, n_samples)
        The recording, n_samples >= 1.
    rate_hz : float
        Sampling rate in Hz.
    grid : {"linear", "log"}
        Frequencies averaged over.
    """

    def __init__(self, samples: NDArray[np.float64], rate_hz: float, *, grid: Grid = "linear") -> None:
        n = samples.shape[-1]
        frequencies = GRIDS[grid](n, rate_hz)
        self._smooth = WeberSmoothing(frequencies, rate_hz / n, n // 2 + 1)
        # Axis by axis: three spectra at once cost more in fresh memory than they save in calls.
        self._spectrum = energy_spectrum(samples[0], self._smooth.bins)
        for axis in samples[1:]:
            self._spectrum += energy_spectrum(axis, self._smooth.bins)
        # By Parseval's theorem the mean energy per bin of the two-sided spectrum is the energy in time.
        self._energy = float(np.einsum("in,in->", samples, samples))
        self._smoothed = self._smooth(self._spectrum)
        self._used = self._smoothed > NUMERICAL_FLOOR * self._energy
        self.smoothed = self._smoothed[self._used]
        self.frequencies_hz = frequencies[self._used]
        self.n_left_out = int(np.count_nonzero(~self._used))

    @property
    def reason(self) -> str:
        """Why `match` is NaN; empty where it is not.

        Returns
        -------
        str
            A clause that says what is wrong with the recording.
        """
        if len(self.smoothed):
            return ""
        if len(self._smoothed):
            return (
                "the recording has no energy from 20 to 1000 Hz: it is silent there, or its offset, a million times as "
                "large, must be removed first"
            )
        return "the recording is too short, or its rate too low, for any frequency from 20 to 1000 Hz"

    def match(self, reduced: NDArray[np.float64]) -> NDArray[np.float64]:
        """Spectral match of one or many reduced signals.

        Parameters
        ----------
        reduced : ndarray, shape (..., n_samples)
            Reduced signals.

        Returns
        -------
        ndarray of float64, shape (...)
            Their matches; NaN where no frequency can be compared.
        """
        return self._relate(self._subtract(reduced))

    def match_both(self, reduced: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Spectral match and bounded spectral match, from one spectrum of each reduced signal.

        Parameters
        ----------
        reduced : ndarray, shape (..., n_samples)
            Reduced signals.

        Returns
        -------
        tuple of ndarray of float64, each of shape (...)
            `spectral_match` and `spectral_match_bounded`; NaN where no frequency can be compared.
        """
        difference = self._subtract(reduced)
        return self._relate(difference), self._relate_bounded(reduced, difference)

    def _subtract(self, reduced: NDArray[np.float64]) -> NDArray[np.float64]:
        """Smoothed energy of the recording minus that of the reduced signals, shape (..., n_frequencies)."""
        # The difference is taken before it is smoothed: what two equal spectra share cancels without rounding.
        difference = energy_spectrum(reduced, self._smooth.bins)
        np.subtract(self._spectrum, difference, out=difference)
        return self._smooth(difference)

    def _relate(self, difference: NDArray[np.float64]) -> NDArray[np.float64]:
        if not len(self.smoothed):
            return np.full(difference.shape[:-1], np.nan)
        deviation = np.abs(difference[..., self._used])
        return np.asarray(1.0 - (deviation / self.smoothed).mean(axis=-1))

    def _relate_bounded(self, reduced: NDArray[np.float64], difference: NDArray[np.float64]) -> NDArray[np.float64]:
        strongest = self._smoothed + np.maximum(-difference, 0.0)  # max(E, S) = E + max(S - E, 0)
        energy = np.maximum(np.einsum("...n,...n->...", reduced, reduced), self._energy)
        used = self._used | (strongest > NUMERICAL_FLOOR * energy[..., None])
        deviation = np.divide(np.abs(difference), strongest, out=np.zeros_like(strongest), where=used)
        count = used.sum(axis=-1)
        match = 1.0 - np.minimum(deviation, 1.0).sum(axis=-1) / np.maximum(count, 1)
        return np.where(count > 0, np.maximum(match, 0.0), np.nan)
