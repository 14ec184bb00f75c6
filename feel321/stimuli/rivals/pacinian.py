"""Vibrations as weighted by the Pacinian channel: power relative to the detection threshold, in total or by band.

References
----------
.. [1] S. J. Bensmaïa, M. Hollins, "The vibrations of texture", Somatosensory & Motor Research 20(1), 2003, 33-43.
   doi:10.1080/0899022031000083825
.. [2] S. J. Bensmaïa, M. Hollins, "Pacinian representations of fine surface texture", Perception & Psychophysics 67(5),
   2005, 842-854. doi:10.3758/BF03193537
"""

import numpy as np
from numpy.typing import ArrayLike

from feel321.stimuli.recording import Signal
from feel321.stimuli.rivals.pairs import Pair, level_db, make_pair, smooth_bands
from feel321.stimuli.thresholds import acceleration_threshold
from feel321.types import Samples


def pacinian_power_difference(
    acceleration: Signal, reduced: ArrayLike, rate_hz: float | None = None
) -> float:
    r"""Compute how far the Pacinian power of a reduced signal is from its recording's.

    Notes
    -----
    Perceived roughness of fine surfaces follows the power of the skin's vibration, weighted by the sensitivity of the
    Pacinian system [1]_. With T the detection threshold of acceleration (`acceleration_threshold`, that of a contactor)
    and sums over all frequencies from 20 to 1000 Hz,

    .. math:: D = \left| 10 \log_{10} \frac{\sum_f S(f) / T(f)^2}{\sum_f \sum_i E_i(f) / T(f)^2} \right| \mathrm{dB},

    at most 60 dB, which is also the value of a silent reduced signal. The paper's abstract states the weighted power;
    that three axes add by energy, and the difference in dB, are ours.

    Examples
    --------
    >>> u = np.sin(np.arange(1000))
    >>> round(pacinian_power_difference([u, 0 * u, 0 * u], 2 * u, 1000), 9)
    6.020599913
    """
    return float(measure_power(make_pair(acceleration, reduced, rate_hz)))


def measure_power(pair: Pair) -> Samples:
    """Measure `pacinian_power_difference` of pairs."""
    weights = acceleration_threshold(pair.frequencies_hz) ** -2
    original, reduced = (energy[..., pair.felt] @ weights for energy in pair.energies)
    return pair.settle(np.abs(level_db(original, reduced)))


def spectral_intensity_distance(
    acceleration: Signal, reduced: ArrayLike, rate_hz: float | None = None
) -> float:
    r"""Compute the share of the spectral intensity of both signals that they do not have in common.

    Notes
    -----
    Most of the dissimilarity of fine textures follows the difference between the Pacinian representations of the
    vibrations that they elicit: intensities by frequency [2]_. The abstract gives no formula, and the paper's model was
    not available; this is our own construction after its idea. In bands 22 % wide from 20 to 1000 Hz, with the
    intensity of a band its amplitude as a multiple of the threshold T at its middle,

    .. math:: D = \frac{\sum_k |\sqrt{S_k} - \sqrt{E_k}| / T_k}{\sum_k \max(\sqrt{S_k}, \sqrt{E_k}) / T_k}

    0 where the spectra agree, 1 where one signal is silent wherever the other is not. A gain g of the amplitude gives 1
    - g, or 1 - 1/g above 1.

    Examples
    --------
    >>> u = np.sin(np.arange(1000))
    >>> round(spectral_intensity_distance([u, 0 * u, 0 * u], u / 4, 1000), 9)
    0.75
    """
    return float(measure_intensity(make_pair(acceleration, reduced, rate_hz)))


def measure_intensity(pair: Pair) -> Samples:
    """Measure `spectral_intensity_distance` of pairs."""
    centres, original, reduced = smooth_bands(pair)
    # A band's energy is the mean per bin times its width, which grows with the frequency.
    weights = np.sqrt(centres) / acceleration_threshold(centres)
    first, second = np.sqrt(original), np.sqrt(reduced)
    most = np.maximum(first, second) @ weights
    apart = np.abs(second - first) @ weights
    return pair.settle(apart / np.where(most > 0, most, 1.0))
