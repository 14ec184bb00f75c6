r"""Rivals by energy and spectrum: level, distances in bands 22 % wide, balance, and the Pacinian channel's view.

E is the energy of the recording (the sum of its axes), S that of the reduced signal, from 20 to 1000 Hz. Bands are as
wide as the smallest change of frequency that people notice: 18 of them where the rate allows, at equal steps of the
logarithm; a spectral match averages over Hz instead, where half of all frequencies lie above 500 Hz. Bands in which
neither signal has energy are left out; levels further apart than 60 dB count as 60 dB. T is the detection threshold of
acceleration (`acceleration_threshold`, that of a contactor).

References
----------
.. [1] A. H. Gray, J. D. Markel, "Distance measures for speech processing", IEEE Transactions on Acoustics, Speech, and
   Signal Processing 24(5), 1976, 380-391. doi:10.1109/TASSP.1976.1162849
.. [2] F. Itakura, S. Saito, "Analysis synthesis telephony based on the maximum likelihood method", 6th International
   Congress on Acoustics, Tokyo, 1968, C17-C20.
.. [3] C. Bernard, E. Thoret, N. Huloux, S. Ystad, "The high/low frequency balance drives the perception of noisy
   vibrations", preprint, 2023.
.. [4] S. J. Bensmaïa, M. Hollins, "The vibrations of texture", Somatosensory & Motor Research 20(1), 2003, 33-43.
   doi:10.1080/0899022031000083825
.. [5] S. J. Bensmaïa, M. Hollins, "Pacinian representations of fine surface texture", Perception & Psychophysics 67(5),
   2005, 842-854. doi:10.3758/BF03193537
"""

import math

import numpy as np

from feel321.names import MOST_DB
from feel321.stimuli.match import HIGHEST_HZ, LOWEST_HZ, NUMERICAL_FLOOR
from feel321.stimuli.rivals.pairs import Pair, level_db, smooth_bands
from feel321.stimuli.thresholds import acceleration_threshold
from feel321.types import Samples

SPLIT_HZ = math.sqrt(LOWEST_HZ * HIGHEST_HZ)
"""141 Hz, the middle of the felt range on a logarithmic scale."""


def level_difference(pair: Pair) -> Samples:
    r"""Measure how far the level of a reduced signal is from its recording's, whatever the spectra.

    .. math:: D = \left| 10 \log_{10} \frac{\sum_f S(f)}{\sum_f E(f)} \right| \mathrm{dB},

    at most 60 dB, which is also the value of a silent reduced signal. Half the amplitude is 6.02 dB, and so is twice.
    """
    original, reduced = (energy[..., pair.felt].sum(axis=-1) for energy in pair.energies)
    return pair.settle(np.abs(level_db(original, reduced)))


def log_spectral_distance(pair: Pair) -> Samples:
    r"""Measure the root mean square over bands of the difference in level [1]_.

    .. math:: D = \sqrt{\frac{1}{K} \sum_k \left( 10 \log_{10} \frac{S_k}{E_k} \right)^2} \mathrm{dB}

    0 to 60. A gain g of the amplitude alone is :math:`|20 \log_{10} g|` dB, as for `level_difference`, and D is never
    less than the mean difference.
    """
    return np.sqrt(_average(pair, np.square(_band_levels(pair))))


def itakura_saito_distance(pair: Pair) -> Samples:
    r"""Measure the mean over bands of Itakura and Saito's distance of the reduced signal from the recording [2]_.

    .. math:: D = \frac{1}{K} \sum_k \left( \frac{E_k}{S_k} - \ln \frac{E_k}{S_k} - 1 \right)

    0 where the spectra agree; it is not symmetric: energy that is missing costs far more (a tenth of it 6.7, all of it
    a million) than energy that was added (ten times 1.4). One missing band decides the mean, so read its rank
    correlation.
    """
    log_ratio = -_band_levels(pair) * (math.log(10) / 10)
    return _average(pair, np.expm1(log_ratio) - log_ratio)


def _band_levels(pair: Pair) -> Samples:
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


def balance_difference(pair: Pair) -> Samples:
    r"""Measure how far the ratio of high- to low-frequency energy is from the recording's.

    Of noisy, stationary vibrations with equal intensity the balance of low and high frequencies was the most important
    cue of dissimilarity [3]_.

    .. math:: B = 10 \log_{10} \frac{\sum_{f \ge 141} E(f)}{\sum_{f < 141} E(f)}, \qquad D = |B_s - B|,

    at most 60 dB, which is also the value of a silent reduced signal. No gain changes it. NaN where the rate or the
    duration leaves no frequency on one side. Only the abstract was available: where to split is our own choice.
    """
    high = pair.frequencies_hz >= SPLIT_HZ
    if high.all() or not high.any():
        return np.full(pair.nothing.shape, np.nan)
    sides = [(e[..., pair.felt][..., ~high], e[..., pair.felt][..., high]) for e in pair.energies]
    own, kept = (level_db(low.sum(axis=-1), above.sum(axis=-1)) for low, above in sides)
    silent = ~sides[1][0].any(axis=-1) & ~sides[1][1].any(axis=-1)
    return pair.settle(np.where(silent, MOST_DB, np.minimum(np.abs(kept - own), MOST_DB)))


def pacinian_power_difference(pair: Pair) -> Samples:
    r"""Measure how far the Pacinian power of a reduced signal is from its recording's.

    Perceived roughness of fine surfaces follows the power of the skin's vibration, weighted by the sensitivity of the
    Pacinian system [4]_.

    .. math:: D = \left| 10 \log_{10} \frac{\sum_f S(f) / T(f)^2}{\sum_f E(f) / T(f)^2} \right| \mathrm{dB},

    at most 60 dB, which is also the value of a silent reduced signal. The paper's abstract states the weighted power;
    that three axes add by energy, and the difference in dB, are ours.
    """
    weights = acceleration_threshold(pair.frequencies_hz) ** -2
    original, reduced = (energy[..., pair.felt] @ weights for energy in pair.energies)
    return pair.settle(np.abs(level_db(original, reduced)))


def spectral_intensity_distance(pair: Pair) -> Samples:
    r"""Measure the share of the spectral intensity of both signals that they do not have in common.

    Most of the dissimilarity of fine textures follows the difference between the Pacinian representations of the
    vibrations that they elicit: intensities by frequency [5]_. The abstract gives no formula, and the paper's model was
    not available; this is our own construction after its idea, in bands.

    .. math:: D = \frac{\sum_k |\sqrt{S_k} - \sqrt{E_k}| / T_k}{\sum_k \max(\sqrt{S_k}, \sqrt{E_k}) / T_k}

    0 where the spectra agree, 1 where one signal is silent wherever the other is not. A gain g of the amplitude gives 1
    - g, or 1 - 1/g above 1.
    """
    centres, original, reduced = smooth_bands(pair)
    # A band's energy is the mean per bin times its width, which grows with the frequency.
    weights = np.sqrt(centres) / acceleration_threshold(centres)
    first, second = np.sqrt(original), np.sqrt(reduced)
    most = np.maximum(first, second) @ weights
    apart = np.abs(second - first) @ weights
    return pair.settle(apart / np.where(most > 0, most, 1.0))
