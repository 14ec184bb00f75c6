"""The balance of high and low frequencies, by which noisy vibrations of equal intensity can be told apart."""

import math

import numpy as np
from numpy.typing import ArrayLike

from feel321.names import MOST_DB
from feel321.stimuli.match import HIGHEST_HZ, LOWEST_HZ
from feel321.stimuli.recording import Signal
from feel321.stimuli.rivals.pairs import Pair, level_db, make_pair
from feel321.types import Samples

SPLIT_HZ = math.sqrt(LOWEST_HZ * HIGHEST_HZ)
"""141 Hz, the middle of the felt range on a logarithmic scale."""


def balance_difference(
    acceleration: Signal, reduced: ArrayLike, rate_hz: float | None = None
) -> float:
    r"""Compute how far the ratio of high- to low-frequency energy is from the recording's.

    Notes
    -----
    Of noisy, stationary vibrations with equal intensity the balance of low and high frequencies was the most important
    cue of dissimilarity [1]_. With the energies of all axes, or of the reduced signal, above and below 141 Hz,

    .. math:: B = 10 \log_{10} \frac{\sum_{f \ge 141} E(f)}{\sum_{f < 141} E(f)}, \qquad D = |B_s - B|,

    at most 60 dB, which is also the value of a silent reduced signal. No gain changes it. NaN where the rate or the
    duration leaves no frequency on one side. Only the abstract was available: where to split is our own choice.

    References
    ----------
    .. [1] C. Bernard, E. Thoret, N. Huloux, S. Ystad, "The high/low frequency balance drives the perception of noisy
       vibrations", preprint, 2023.

    Examples
    --------
    >>> low, high = (np.sin(2 * np.pi * f * np.arange(1000) / 1000) for f in (50, 200))
    >>> round(balance_difference([low, high, 0 * low], low + 2 * high, 1000), 9)
    6.020599913
    """
    return float(measure_balance(make_pair(acceleration, reduced, rate_hz)))


def measure_balance(pair: Pair) -> Samples:
    """Measure `balance_difference` of pairs."""
    high = pair.frequencies_hz >= SPLIT_HZ
    if high.all() or not high.any():
        return np.full(pair.nothing.shape, np.nan)
    sides = [(e[..., pair.felt][..., ~high], e[..., pair.felt][..., high]) for e in pair.energies]
    own, kept = (level_db(low.sum(axis=-1), above.sum(axis=-1)) for low, above in sides)
    silent = ~sides[1][0].any(axis=-1) & ~sides[1][1].any(axis=-1)
    return pair.settle(np.where(silent, MOST_DB, np.minimum(np.abs(kept - own), MOST_DB)))
