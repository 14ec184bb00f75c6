"""Level alone: the simplest thing to compare two vibrations by, and the baseline that any other metric has to beat."""

import numpy as np
from numpy.typing import ArrayLike

from feel321.stimuli.recording import Signal
from feel321.stimuli.rivals.pairs import Pair, level_db, make_pair
from feel321.types import Samples


def level_difference(
    acceleration: Signal, reduced: ArrayLike, rate_hz: float | None = None
) -> float:
    r"""Compute how far the level of a reduced signal is from its recording's, whatever the spectra.

    Notes
    -----
    With the energies of the axes and of the reduced signal summed over all frequencies from 20 to 1000 Hz,

    .. math:: D = \left| 10 \log_{10} \frac{\sum_f S(f)}{\sum_f \sum_i E_i(f)} \right| \mathrm{dB},

    at most 60 dB, which is also the value of a silent reduced signal. Half the amplitude is 6.02 dB, and so is twice.

    Examples
    --------
    >>> u = np.sin(np.arange(1000))
    >>> round(level_difference([u, u, u], u, 1000), 9)  # 10 log10(3)
    4.771212547
    """
    return float(measure_level(make_pair(acceleration, reduced, rate_hz)))


def measure_level(pair: Pair) -> Samples:
    """Measure `level_difference` of pairs."""
    original, reduced = (energy[..., pair.felt].sum(axis=-1) for energy in pair.energies)
    return pair.settle(np.abs(level_db(original, reduced)))
