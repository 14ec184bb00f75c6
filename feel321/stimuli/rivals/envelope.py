r"""Envelopes up to 50 Hz: whether they rise and fall together, and how deeply they are modulated at each rate.

The envelope of a recording is the root of the energy of all its axes at each time, from 20 to 1000 Hz; that of a
reduced signal the magnitude of its analytic signal. An envelope at up to some 50 Hz is felt as such, and equal energy
in shorter segments is hard to tell apart (`segments`).

References
----------
.. [1] N. Cao, H. Nagano, M. Konyo, S. Okamoto, S. Tadokoro, "A pilot study: introduction of time-domain segment to
   intensity-based perception model of high-frequency vibration", EuroHaptics 2018. doi:10.1007/978-3-319-93445-7_28
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from feel321.stimuli.recording import Signal
from feel321.stimuli.rivals.pairs import Pair, follow_energy, make_pair
from feel321.types import Samples

FASTEST_HZ = 50.0
SLOWEST_HZ = 2.0
N_BANDS = 9
"""Half an octave each from 2 to 50 Hz."""

# An envelope that varies by less than this share of its mean is constant but for rounding.
_CONSTANT = 1e-6


def envelope_correlation(
    acceleration: Signal, reduced: ArrayLike, rate_hz: float | None = None
) -> float:
    r"""Compute the correlation of the envelopes, as far as they vary at up to 50 Hz.

    Notes
    -----
    Pearson's correlation, -1 to 1, of the envelopes (see the module) after everything faster than 50 Hz was removed;
    our own construction. No gain and no phase changes it. 0 if the reduced signal is silent or its envelope constant;
    NaN if the recording's is, or if it is shorter than a period of 50 Hz.

    Examples
    --------
    >>> t = np.arange(4000) / 4000
    >>> beat = 1 + np.cos(2 * np.pi * 10 * t)
    >>> low, high = np.sin(2 * np.pi * 100 * t), np.sin(2 * np.pi * 300 * t)
    >>> round(envelope_correlation([beat * low, 0 * t, 0 * t], beat * high, 4000), 6)
    1.0
    """
    return float(measure_correlation(make_pair(acceleration, reduced, rate_hz)))


def measure_correlation(pair: Pair) -> Samples:
    """Measure `envelope_correlation` of pairs."""
    *energies, rate_hz = follow_energy(pair)
    (mean, own, _), (mean_reduced, kept, _) = (_modulate(one, rate_hz) for one in energies)
    together = np.einsum("...k,...k->...", own, kept.conj()).real
    norms = [np.sqrt(np.einsum("...k,...k->...", one, one.conj()).real) for one in (own, kept)]
    steady = norms[0] <= _CONSTANT * mean
    flat = norms[1] <= _CONSTANT * mean_reduced
    scale = np.where(steady | flat, 1.0, norms[0] * norms[1])
    correlation = np.where(flat, 0.0, np.clip(together / scale, -1.0, 1.0))
    return pair.settle(np.where(steady, np.nan, correlation))


def modulation_distance(
    acceleration: Signal, reduced: ArrayLike, rate_hz: float | None = None
) -> float:
    r"""Compute how far the depths of modulation at 2 to 50 Hz are from the recording's.

    Notes
    -----
    In nine bands of half an octave, with :math:`\hat e(f)` the spectrum of an envelope (see the module),

    .. math:: m_k = \frac{2}{\hat e(0)} \sqrt{\sum_{f \in k} |\hat e(f)|^2}, \qquad
        D = \sqrt{\frac{1}{K} \sum_k (m^s_k - m_k)^2},

    so that 1 is the depth of a fully modulated vibration. Our own construction. No gain, shift in time or phase changes
    it. Bands that hold no frequency of a short recording are left out; NaN if all are, below 20 ms. A silent reduced
    signal has no envelope: it counts as unmodulated or fully modulated in all bands, whichever is further off.

    Examples
    --------
    >>> t = np.arange(4000) / 4000
    >>> tone = np.sin(2 * np.pi * 200 * t)
    >>> beat = 1 + 0.6 * np.cos(2 * np.pi * 10 * t)
    >>> round(modulation_distance([beat * tone, 0 * t, 0 * t], tone, 4000), 6)
    0.2
    """
    return float(measure_modulation(make_pair(acceleration, reduced, rate_hz)))


def measure_modulation(pair: Pair) -> Samples:
    """Measure `modulation_distance` of pairs."""
    *energies, rate_hz = follow_energy(pair)
    return pair.settle(compare_depths(*(find_depths(one, rate_hz) for one in energies)))


def find_depths(energy: Samples, rate_hz: float) -> Samples:
    """Find how deeply the envelope of an energy (..., m) is modulated in each band: (..., k), NaN for silence."""
    mean, spectrum, rates_hz = _modulate(energy, rate_hz)
    edges = np.geomspace(SLOWEST_HZ, FASTEST_HZ, N_BANDS + 1) * (1 - 1e-12)
    band = np.minimum(np.searchsorted(edges, rates_hz, side="right") - 1, N_BANDS - 1)
    shares = (band[:, None] == np.unique(band[band >= 0])).astype(float)
    depths = 2 * np.sqrt(np.abs(spectrum) ** 2 @ shares)
    mean = mean[..., None]
    unknown = np.full_like(depths, np.nan)
    return np.asarray(np.divide(depths, mean, out=unknown, where=mean > 0))


def compare_depths(recorded: Samples, reduced: Samples) -> Samples:
    """Compare depths (..., k) in root mean square over bands: `modulation_distance`, NaN without bands."""
    if not recorded.shape[-1]:
        return np.full(recorded.shape[:-1], np.nan)
    silent = np.isnan(reduced).any(axis=-1)
    apart = [
        np.sqrt(np.mean(np.square(recorded - other), axis=-1)) for other in (reduced, 0.0, 1.0)
    ]
    return np.where(silent, np.maximum(apart[1], apart[2]), apart[0])


def _modulate(energy: Samples, rate_hz: float) -> tuple[Samples, NDArray[np.complex128], Samples]:
    """Mean and spectrum of an envelope above 0 to 50 Hz, (...) and (..., k), and the rates of modulation in Hz."""
    from scipy import fft

    length = energy.shape[-1]
    rates_hz = np.arange(1, length // 2 + 1) * (rate_hz / length)
    slow = slice(1, 1 + int(np.searchsorted(rates_hz, FASTEST_HZ * (1 + 1e-12), side="right")))
    spectrum = fft.rfft(np.sqrt(energy))
    return spectrum[..., 0].real, spectrum[..., slow], rates_hz[: slow.stop - 1]
