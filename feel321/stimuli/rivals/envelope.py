r"""Rivals in time: envelopes up to 50 Hz, how deeply they are modulated, and intensity in short segments.

The envelope of a recording is the root of the energy of all its axes at each time, from 20 to 1000 Hz; that of a
reduced signal the magnitude of its analytic signal. An envelope at up to some 50 Hz is felt as such, and equal energy
in shorter segments is hard to tell apart [1]_.

References
----------
.. [1] N. Cao, H. Nagano, M. Konyo, S. Okamoto, S. Tadokoro, "A pilot study: introduction of time-domain segment to
   intensity-based perception model of high-frequency vibration", EuroHaptics 2018. doi:10.1007/978-3-319-93445-7_28
"""

import numpy as np
from numpy.typing import NDArray

from feel321.stimuli.rivals.pairs import Pair, follow_energy, level_db
from feel321.stimuli.thresholds import acceleration_threshold
from feel321.types import Samples

FASTEST_HZ = 50.0
SLOWEST_HZ = 2.0
N_BANDS = 9
"""Half an octave each from 2 to 50 Hz."""

SEGMENT_S = 0.01
"""A third of a period of 33 Hz: envelopes of 15 to 45 Hz felt alike in segments of a sixth to a third of a period."""

FLOOR_DB = 40.0
"""Segments further below the loudest are raised to it: nobody feels them beside it."""

# An envelope that varies by less than this share of its mean is constant but for rounding.
_CONSTANT = 1e-6


def envelope_correlation(pair: Pair) -> Samples:
    """Measure the correlation of the envelopes, as far as they vary at up to 50 Hz.

    Pearson's correlation, -1 to 1, after everything faster than 50 Hz was removed; our own construction. No gain and no
    phase changes it. 0 if the reduced signal is silent or its envelope constant; NaN if the recording's is, or if it is
    shorter than a period of 50 Hz.
    """
    *energies, rate_hz = follow_energy(pair)
    (mean, own, _), (mean_reduced, kept, _) = (_modulate(one, rate_hz) for one in energies)
    together = np.einsum("...k,...k->...", own, kept.conj()).real
    norms = [np.sqrt(np.einsum("...k,...k->...", one, one.conj()).real) for one in (own, kept)]
    steady = norms[0] <= _CONSTANT * mean
    flat = norms[1] <= _CONSTANT * mean_reduced
    scale = np.where(steady | flat, 1.0, norms[0] * norms[1])
    correlation = np.where(flat, 0.0, np.clip(together / scale, -1.0, 1.0))
    return pair.settle(np.where(steady, np.nan, correlation))


def modulation_distance(pair: Pair) -> Samples:
    r"""Measure how far the depths of modulation at 2 to 50 Hz are from the recording's.

    In nine bands of half an octave, with :math:`\hat e(f)` the spectrum of an envelope,

    .. math:: m_k = \frac{2}{\hat e(0)} \sqrt{\sum_{f \in k} |\hat e(f)|^2}, \qquad
        D = \sqrt{\frac{1}{K} \sum_k (m^s_k - m_k)^2},

    so that 1 is the depth of a fully modulated vibration. Our own construction. No gain, shift in time or phase changes
    it. Bands that hold no frequency of a short recording are left out; NaN if all are, below 20 ms. A silent reduced
    signal has no envelope: it counts as unmodulated or fully modulated in all bands, whichever is further off.
    """
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


def segment_intensity_difference(pair: Pair) -> Samples:
    r"""Measure how far the intensity of short segments is from the recording's, in root mean square over segments.

    Vibrations whose short segments were replaced by others of the same energy were hard to tell apart [1]_, as long as
    a segment was no longer than a third of the period of the envelope. With the intensity I of a segment of 10 ms its
    energy from 20 to 1000 Hz over the detection threshold (`acceleration_threshold`), that of the recording the sum of
    its axes', and :math:`\epsilon` 40 dB below the recording's loudest segment,

    .. math:: D = \sqrt{\frac{1}{K} \sum_k
        \left( 10 \log_{10} \frac{I^s_k + \epsilon}{I_k + \epsilon} \right)^2} \mathrm{dB}

    The paper tested whether segments are told apart; to measure the distance in dB, the floor, and the length are ours.
    """
    *energies, rate_hz = follow_energy(pair, 1 / acceleration_threshold(pair.frequencies_hz))
    length = energies[0].shape[-1]
    starts = np.unique(np.floor(np.arange(0, length, SEGMENT_S * rate_hz)).astype(np.intp))
    counts = np.diff(starts, append=length)
    original, reduced = (np.add.reduceat(one, starts, axis=-1) / counts for one in energies)
    floor = original.max(axis=-1, keepdims=True) * 10 ** (-FLOOR_DB / 10)
    levels = level_db(original + floor, reduced + floor)
    return pair.settle(np.sqrt(np.mean(np.square(levels), axis=-1)))
