"""METRICS: how well a reduced signal matches the recording, in spectrum and in time.

Conventions: acceleration (3, n_samples) and reduced (n_samples,), both finite, in any common unit; every metric is
called alike, `METRICS[name](acceleration, reduced, rate_hz)`, and 1 is a perfect match. Each has a `..._details` form
that says what the figure rests on.

- `spectral_match` (eq. 1): 1 minus the mean relative deviation of the smoothed energy spectra. At most 1; it may be
  negative, and very much so where the reduced signal has energy in bands in which the recording has almost none.
- `spectral_match_bounded`: the same with each deviation taken relative to the stronger of the two spectra, so that no
  frequency can count for more than 1. 0 to 1, equal to eq. 1 wherever the reduced signal is the weaker one.
- `temporal_match` (eq. 2): mean absolute correlation, at zero lag, of the reduced signal with each axis. 0 to 1. No
  mean is removed: an offset counts as signal, as in the paper.

Where there is nothing to match (no frequency from 20 to 1000 Hz with energy, a silent recording) a match is NaN, never
1 or 0, and the details hold the reason. A silent reduced signal of a recording that is not silent scores 0.

References
----------
.. [1] N. Landin, J. M. Romano, W. McMahan, K. J. Kuchenbecker, "Dimensional reduction of high-frequency accelerations
   for haptic rendering", EuroHaptics 2010, section 3. doi:10.1007/978-3-642-14075-4_12
"""

from __future__ import annotations

from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING, Protocol

import numpy as np

from stimuli.door import SAFE_PEAK, admit, check_reduced, is_safe, largest
from stimuli.recording import check_rate
from stimuli.spectrum import GRIDS, OriginalSpectrum

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import ArrayLike, NDArray

    from stimuli.spectrum import Grid

_SILENT = 1e-12
_BEYOND_COMPARISON = 1e80


@dataclass(frozen=True, slots=True)
class SpectralMatch:
    """A spectral match and what it rests on.

    Parameters
    ----------
    value : float
        The match; NaN if no frequency could be compared.
    lowest_hz, highest_hz : float
        Lowest and highest frequency compared in Hz; NaN if none could be.
    n_frequencies : int
        Number of frequencies compared.
    n_left_out : int
        Number of frequencies left out below the numerical floor.
    bounded : float
        `spectral_match_bounded` of the same signals.
    reason : str
        Why the match is NaN; empty otherwise.
    """

    value: float
    lowest_hz: float
    highest_hz: float
    n_frequencies: int
    n_left_out: int
    bounded: float
    reason: str = ""


@dataclass(frozen=True, slots=True)
class TemporalMatch:
    """A temporal match and what it rests on.

    Parameters
    ----------
    value : float
        The match; NaN if all three axes are silent.
    correlations : tuple of float
        Absolute correlation with x, y and z; NaN for a silent axis.
    silent_axes : tuple of int
        Axes left out: 0, 1, 2 for x, y, z.
    silent_reduced : bool
        Whether the reduced signal is silent.
    reason : str
        Why the match is NaN; empty otherwise.
    """

    value: float
    correlations: tuple[float, float, float]
    silent_axes: tuple[int, ...]
    silent_reduced: bool
    reason: str = ""


def spectral_match(
    acceleration: ArrayLike, reduced: ArrayLike, rate_hz: float, *, grid: Grid = "linear"
) -> float:
    r"""Tell how well a reduced signal keeps the energy of all three axes at every frequency (eq. 1).

    Parameters
    ----------
    acceleration : array_like, shape (3, n_samples)
        The recording, any unit.
    reduced : array_like, shape (n_samples,)
        The reduced signal, same unit.
    rate_hz : float
        Sampling rate in Hz.
    grid : {"linear", "log"}
        Frequencies averaged over: the DFT's own from 20 Hz to min(1000 Hz, Nyquist), as in the paper, or 24 per octave.

    Returns
    -------
    float
        1 if the smoothed spectra agree, 0 for silence, negative for more than twice the energy on average; NaN for a
        recording without energy, or without any frequency, from 20 to 1000 Hz (`spectral_match_details` says which).

    Raises
    ------
    ValueError
        If shapes or values are wrong.

    Notes
    -----
    With :math:`\tilde E` the energy spectral density smoothed over 22 % of the frequency (see `spectrum`),

    .. math:: M_{sm} = 1 - \frac{1}{n_f} \sum_{f = 20\,\mathrm{Hz}}^{1000\,\mathrm{Hz}}
        \frac{|\tilde E_x + \tilde E_y + \tilde E_z - \tilde E_s|}{\tilde E_x + \tilde E_y + \tilde E_z}

    References
    ----------
    .. [1] Landin et al. 2010, equation 1. doi:10.1007/978-3-642-14075-4_12

    Examples
    --------
    >>> u = np.sin(np.arange(1000))
    >>> round(spectral_match([u, u, u], u, 1000), 9)
    0.333333333
    >>> round(spectral_match([u, u, u], u + u + u, 1000), 9)
    -1.0
    """
    original, signal = _compare(acceleration, reduced, rate_hz, grid=grid)
    return float(original.match(signal))


def spectral_match_details(
    acceleration: ArrayLike, reduced: ArrayLike, rate_hz: float, *, grid: Grid = "linear"
) -> SpectralMatch:
    """Compute `spectral_match` and say which frequencies it rests on.

    Parameters
    ----------
    acceleration : array_like, shape (3, n_samples)
        The recording, any unit.
    reduced : array_like, shape (n_samples,)
        The reduced signal, same unit.
    rate_hz : float
        Sampling rate in Hz.
    grid : {"linear", "log"}
        Frequencies averaged over.

    Returns
    -------
    SpectralMatch
        The match, the range covered, the number of frequencies, and how many were left out below the numerical floor.

    Raises
    ------
    ValueError
        If shapes or values are wrong.
    """
    original, signal = _compare(acceleration, reduced, rate_hz, grid=grid)
    used = original.frequencies_hz
    value, bounded = map(float, original.match_both(signal))
    lowest, highest = (float(used[0]), float(used[-1])) if len(used) else (float("nan"), float("nan"))
    return SpectralMatch(value, lowest, highest, len(used), original.n_left_out, bounded, original.reason)


def spectral_match_bounded(
    acceleration: ArrayLike, reduced: ArrayLike, rate_hz: float, *, grid: Grid = "linear"
) -> float:
    r"""Compute the spectral match with deviations relative to the stronger spectrum: eq. 1, bounded by 0 and 1.

    Parameters
    ----------
    acceleration : array_like, shape (3, n_samples)
        The recording, any unit.
    reduced : array_like, shape (n_samples,)
        The reduced signal, same unit.
    rate_hz : float
        Sampling rate in Hz.
    grid : {"linear", "log"}
        Frequencies averaged over, as for `spectral_match`.

    Returns
    -------
    float
        0 to 1: 1 if the smoothed spectra agree, 0 if one signal is silent wherever the other is not; NaN if there is no
        frequency from 20 to 1000 Hz at which either has energy.

    Raises
    ------
    ValueError
        If shapes or values are wrong.

    Notes
    -----
    With E the sum of the axes' smoothed energy spectral densities and S that of the reduced signal, both as in
    `spectral_match`, and the mean over the same frequencies,

    .. math:: M_{sb} = 1 - \frac{1}{n_f} \sum_{f = 20\,\mathrm{Hz}}^{1000\,\mathrm{Hz}} \frac{|E - S|}{\max(E, S)}
        = \frac{1}{n_f} \sum_f \frac{\min(E, S)}{\max(E, S)}

    - Where S <= E everywhere it is the paper's eq. 1. Twice the energy scores 1/2, where eq. 1 gives 0; ten times the
      energy scores 1/10, where eq. 1 gives -8: eq. 1 has no lower bound, so that a few frequencies of a few stimuli
      decide a mean or a slope.
    - It is symmetric in E and S, and one factor on both signals does not change it. Like eq. 1 it depends on the
      recording through the sum of the axes' energies, which turning the sensor does not change.
    - Eq. 1 leaves out frequencies at which the recording has no energy (below 1e-12 of its mean energy per bin). Here
      they are left out only where the reduced signal has none either (below 1e-12 of the stronger signal's mean energy
      per bin): energy that the reduced signal adds to empty bands counts as a deviation of 1.

    Examples
    --------
    >>> u = np.sin(np.arange(1000))
    >>> round(spectral_match_bounded([u, u, u], u, 1000), 9)
    0.333333333
    >>> round(spectral_match_bounded([u, u, u], u + u + u, 1000), 9)
    0.333333333
    """
    original, signal = _compare(acceleration, reduced, rate_hz, grid=grid)
    return float(original.match_both(signal)[1])


def temporal_match(acceleration: ArrayLike, reduced: ArrayLike, rate_hz: float | None = None) -> float:
    r"""Tell how well peaks and sudden changes of the reduced signal coincide with those of the axes (eq. 2).

    Parameters
    ----------
    acceleration : array_like, shape (3, n_samples)
        The recording, any unit.
    reduced : array_like, shape (n_samples,)
        The reduced signal, any unit.
    rate_hz : float, optional
        Not used by this metric; every metric takes it so that all are called alike.

    Returns
    -------
    float
        0 to 1: mean of the absolute correlations with the axes that are not silent; 0 for a silent reduced signal; NaN
        for a silent recording, in which there is nothing to match.

    Raises
    ------
    ValueError
        If shapes or values are wrong.

    Notes
    -----
    .. math:: M_{tm} = \frac{1}{3} \sum_{i \in x,y,z} \frac{|a_i \cdot a_s|}{\|a_i\| \, \|a_s\|}

    References
    ----------
    .. [1] Landin et al. 2010, equation 2. doi:10.1007/978-3-642-14075-4_12

    Examples
    --------
    >>> temporal_match([[1, 0], [0, 1], [0, 0]], [1, 0])
    0.5
    """
    return temporal_match_details(acceleration, reduced, rate_hz).value


def temporal_match_details(
    acceleration: ArrayLike, reduced: ArrayLike, rate_hz: float | None = None
) -> TemporalMatch:
    """Compute `temporal_match` and say which axes it rests on.

    Parameters
    ----------
    acceleration : array_like, shape (3, n_samples)
        The recording, any unit.
    reduced : array_like, shape (n_samples,)
        The reduced signal, any unit.
    rate_hz : float, optional
        Not used by this metric.

    Returns
    -------
    TemporalMatch
        The match, the absolute correlation with each axis (NaN for a silent one), the silent axes, and whether the
        reduced signal is silent. An axis is silent if its norm is below 1e-12 of the strongest axis's.

    Raises
    ------
    ValueError
        If shapes or values are wrong.
    """
    samples = admit(acceleration, 1.0 if rate_hz is None else rate_hz).samples
    signal = check_reduced(reduced, samples.shape)
    if not is_safe(largest(signal)):  # the reduced signal's strength does not matter, so it gets a scale of its own
        signal = np.ldexp(signal, -np.frexp(largest(signal))[1])
    correlations = axis_correlations(samples, signal)
    x, y, z = (float(r) for r in correlations)
    silent = tuple(int(axis) for axis in np.flatnonzero(np.isnan(correlations)))
    reason = "all three axes of the recording are silent" if len(silent) == len(correlations) else ""
    return TemporalMatch(float(mean_heard(correlations)), (x, y, z), silent, not signal.any(), reason)


def mean_heard(correlations: NDArray[np.float64]) -> NDArray[np.float64]:
    """Mean over the axes that are not silent.

    Parameters
    ----------
    correlations : ndarray, shape (..., 3)
        From `axis_correlations`.

    Returns
    -------
    ndarray of float64, shape (...)
        Temporal matches; NaN where all axes are silent.
    """
    heard = ~np.isnan(correlations)
    count = heard.sum(axis=-1)
    mean = np.where(heard, correlations, 0.0).sum(axis=-1) / np.maximum(count, 1)
    return np.where(count > 0, mean, np.nan)


def axis_correlations(samples: NDArray[np.float64], reduced: NDArray[np.float64]) -> NDArray[np.float64]:
    """Absolute correlation at zero lag of reduced signals with each axis, NaN for silent axes.

    Parameters
    ----------
    samples : ndarray, shape (..., 3, n_samples)
        Recordings.
    reduced : ndarray, shape (..., n_samples)
        Reduced signals.

    Returns
    -------
    ndarray of float64, shape (..., 3)
        Correlations; 0 for a silent reduced signal.
    """
    together = np.abs(np.einsum("...in,...n->...i", samples, reduced))
    norms = np.sqrt(np.einsum("...in,...in->...i", samples, samples))
    silent = norms <= _SILENT * norms.max(axis=-1, keepdims=True)
    norm = np.sqrt(np.einsum("...n,...n->...", reduced, reduced))[..., None]
    scale = norms * np.where(norm > 0, norm, 1.0)
    return np.where(silent, np.nan, np.minimum(together / np.where(silent, 1.0, scale), 1.0))


class Metric(Protocol):
    """A match metric: how well a reduced signal matches its recording."""

    def __call__(self, acceleration: ArrayLike, reduced: ArrayLike, rate_hz: float, /) -> float:
        """Match of one reduced signal."""


METRICS: Mapping[str, Metric] = MappingProxyType(
    {
        "spectral_match": spectral_match,
        "temporal_match": temporal_match,
        "spectral_match_bounded": spectral_match_bounded,
    }
)
"""Name -> metric."""


def _compare(
    acceleration: ArrayLike, reduced: ArrayLike, rate_hz: float, *, grid: Grid
) -> tuple[OriginalSpectrum, NDArray[np.float64]]:
    """Check a pair, and give the recording's spectrum and the reduced signal on its scale."""
    if grid not in GRIDS:
        raise ValueError(f"grid: got {grid!r}, allowed is one of {', '.join(GRIDS)}")
    samples, signal = _admit_pair(acceleration, reduced, rate_hz)
    if largest(signal) > _BEYOND_COMPARISON * SAFE_PEAK[1]:
        raise ValueError("reduced: is more than 1e80 times as strong as the recording; are they in the same unit?")
    return OriginalSpectrum(samples, check_rate(rate_hz), grid=grid), signal


def _admit_pair(
    acceleration: ArrayLike, reduced: ArrayLike, rate_hz: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Check both signals and scale them by one power of two into a safe range."""
    admitted = admit(acceleration, rate_hz)
    signal = check_reduced(reduced, admitted.samples.shape)
    return admitted.samples, signal if admitted.exponents is None else np.ldexp(signal, -admitted.exponents)
