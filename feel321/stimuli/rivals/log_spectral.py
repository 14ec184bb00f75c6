r"""Distances between spectra in bands 22 % wide: the log-spectral distance, and that of Itakura and Saito.

Both come from speech coding. Here the spectra are the energies E of the recording (the sum of its axes) and S of the
reduced signal in bands that are as wide as the smallest change of frequency that people notice, from 20 to 1000 Hz:
18 of them where the rate allows, at equal steps of the logarithm. A spectral match averages over Hz instead, where half
of all frequencies lie above 500 Hz. Bands in which neither signal has energy are left out; levels further apart than 60
dB count as 60 dB.

References
----------
.. [1] A. H. Gray, J. D. Markel, "Distance measures for speech processing", IEEE Transactions on Acoustics, Speech, and
   Signal Processing 24(5), 1976, 380-391. doi:10.1109/TASSP.1976.1162849
.. [2] F. Itakura, S. Saito, "Analysis synthesis telephony based on the maximum likelihood method", 6th International
   Congress on Acoustics, Tokyo, 1968, C17-C20.
"""

import math

import numpy as np
from numpy.typing import ArrayLike

from feel321.stimuli.match import NUMERICAL_FLOOR
from feel321.stimuli.recording import Signal
from feel321.stimuli.rivals.pairs import Pair, level_db, make_pair, smooth_bands
from feel321.types import Samples


def log_spectral_distance(
    acceleration: Signal, reduced: ArrayLike, rate_hz: float | None = None
) -> float:
    r"""Compute the root mean square over bands of the difference in level.

    Notes
    -----
    With K bands,

    .. math:: D = \sqrt{\frac{1}{K} \sum_k \left( 10 \log_{10} \frac{S_k}{E_k} \right)^2} \mathrm{dB}

    0 to 60. One factor on the reduced signal changes every band's level alike: a gain g of the amplitude alone is
    :math:`|20 \log_{10} g|` dB, as for `level_difference`, and D is never less than the mean difference.

    Examples
    --------
    >>> u = np.random.default_rng(0).normal(size=2000)
    >>> round(log_spectral_distance([u, u, u], 3 * np.sqrt(3) * u, 2000), 9)  # 20 log10(3)
    9.542425094
    """
    return float(measure_log_spectral(make_pair(acceleration, reduced, rate_hz)))


def measure_log_spectral(pair: Pair) -> Samples:
    """Measure `log_spectral_distance` of pairs."""
    return np.sqrt(_average(pair, np.square(band_levels(pair))))


def itakura_saito_distance(
    acceleration: Signal, reduced: ArrayLike, rate_hz: float | None = None
) -> float:
    r"""Compute the mean over bands of Itakura and Saito's distance of the reduced signal from the recording.

    Notes
    -----
    .. math:: D = \frac{1}{K} \sum_k \left( \frac{E_k}{S_k} - \ln \frac{E_k}{S_k} - 1 \right)

    0 where the spectra agree; it is not symmetric: energy that is missing costs far more (a tenth of it 6.7, all of it
    a million) than energy that was added (ten times 1.4). One missing band decides the mean, so read its rank
    correlation.

    Examples
    --------
    >>> u = np.random.default_rng(0).normal(size=2000)
    >>> round(itakura_saito_distance([u, u, u], np.sqrt(0.3) * u, 2000), 9)  # 10 - ln(10) - 1
    6.697414907
    """
    return float(measure_itakura_saito(make_pair(acceleration, reduced, rate_hz)))


def measure_itakura_saito(pair: Pair) -> Samples:
    """Measure `itakura_saito_distance` of pairs."""
    log_ratio = -band_levels(pair) * (math.log(10) / 10)
    return _average(pair, np.expm1(log_ratio) - log_ratio)


def band_levels(pair: Pair) -> Samples:
    """Level of the reduced signal over the recording in dB, (..., n_bands); NaN in a band without energy in either."""
    _, original, reduced = smooth_bands(pair)
    total = sum(energy[..., pair.felt].max(axis=-1, initial=0.0) for energy in pair.energies)
    empty = np.maximum(original, reduced) <= NUMERICAL_FLOOR * np.asarray(total)[..., None]
    return np.where(empty, np.nan, level_db(original, reduced))


def _average(pair: Pair, values: Samples) -> Samples:
    """Mean over the bands that have energy; NaN where there is nothing to compare."""
    there = ~np.isnan(values)
    count = there.sum(axis=-1)
    mean = np.where(there, values, 0.0).sum(axis=-1) / np.maximum(count, 1)
    return pair.settle(np.where(count > 0, mean, np.nan))
