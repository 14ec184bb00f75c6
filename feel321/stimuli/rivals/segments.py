"""Intensity in short segments: where it is equal, vibrations are hard to tell apart, whatever their waveform."""

import numpy as np
from numpy.typing import ArrayLike

from feel321.stimuli.recording import Signal
from feel321.stimuli.rivals.pairs import Pair, follow_energy, level_db, make_pair
from feel321.stimuli.thresholds import acceleration_threshold
from feel321.types import Samples

SEGMENT_S = 0.01
"""A third of a period of 33 Hz: envelopes of 15 to 45 Hz felt alike in segments of a sixth to a third of a period."""

FLOOR_DB = 40.0
"""Segments further below the loudest are raised to it: nobody feels them beside it."""


def segment_intensity_difference(
    acceleration: Signal, reduced: ArrayLike, rate_hz: float | None = None
) -> float:
    r"""Compute how far the intensity of short segments is from the recording's, in root mean square over segments.

    Notes
    -----
    Vibrations whose short segments were replaced by others of the same energy were hard to tell apart [1]_, as long as
    a segment was no longer than a third of the period of the envelope. With the intensity I of a segment of 10 ms its
    energy from 20 to 1000 Hz over the detection threshold (`acceleration_threshold`), that of the recording the sum of
    its axes', and :math:`\epsilon` 40 dB below the recording's loudest segment,

    .. math:: D = \sqrt{\frac{1}{K} \sum_k
        \left( 10 \log_{10} \frac{I^s_k + \epsilon}{I_k + \epsilon} \right)^2} \mathrm{dB}

    The paper tested whether segments are told apart; to measure the distance in dB, the floor, and the length are ours.

    References
    ----------
    .. [1] N. Cao, H. Nagano, M. Konyo, S. Okamoto, S. Tadokoro, "A pilot study: introduction of time-domain segment to
       intensity-based perception model of high-frequency vibration", EuroHaptics 2018.
       doi:10.1007/978-3-319-93445-7_28

    Examples
    --------
    >>> u = np.sin(np.arange(1000))
    >>> 5.9 < segment_intensity_difference([u, 0 * u, 0 * u], 2 * u, 1000) < 6.1
    True
    """
    return float(measure_segments(make_pair(acceleration, reduced, rate_hz)))


def measure_segments(pair: Pair) -> Samples:
    """Measure `segment_intensity_difference` of pairs."""
    *energies, rate_hz = follow_energy(pair, 1 / acceleration_threshold(pair.frequencies_hz))
    length = energies[0].shape[-1]
    starts = np.unique(np.floor(np.arange(0, length, SEGMENT_S * rate_hz)).astype(np.intp))
    counts = np.diff(starts, append=length)
    original, reduced = (np.add.reduceat(one, starts, axis=-1) / counts for one in energies)
    floor = original.max(axis=-1, keepdims=True) * 10 ** (-FLOOR_DB / 10)
    levels = level_db(original + floor, reduced + floor)
    return pair.settle(np.sqrt(np.mean(np.square(levels), axis=-1)))
