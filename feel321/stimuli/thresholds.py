"""Detection thresholds of vibration by frequency.

Two threshold curves, by how the vibration reaches the skin. Both are for sinusoids; neither is a digitised table.

`contactor`: a model of a small contactor on the fingertip or palm. The Pacinian channel's displacement threshold is
U-shaped, falling by 12 dB per octave up to about 250 Hz and rising as steeply above, with a minimum near 0.1 µm [1]_
[2]_. In acceleration that is flat below about 200 Hz and rises by 24 dB per octave above 300 Hz.

`grasped_stylus`: a stylus held like a pen and vibrating along its length [3]_. Published in the text of that paper
(peak displacement, means of 10 people): 26 µm at 10 Hz, 8.5 µm at 20 Hz, a mean slope of -13 dB per octave from 10 to
160 Hz, and a minimum of 0.06 µm at 320 Hz; straight lines in dB over octaves join these points. The values were taken
from a published account of the paper, not from the paper itself. Above 320 Hz no value is given in words: there the
curve rises by 12 dB per octave, as the contactor's does. That part is an assumption.

References
----------
.. [1] S. J. Bolanowski, G. A. Gescheider, R. T. Verrillo, C. M. Checkosky, "Four channels mediate the mechanical
   aspects of touch", JASA 84(5), 1988. doi:10.1121/1.397184
.. [2] R. T. Verrillo, "Effect of contactor area on the vibrotactile threshold", JASA 35(12), 1963.
   doi:10.1121/1.1918868
.. [3] A. Israr, S. Choi, H. Z. Tan, "Detection threshold and mechanical impedance of the hand in a pen-hold posture",
   IEEE/RSJ International Conference on Intelligent Robots and Systems, 2006, 472-477.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from feel321.doors import Registry
from feel321.types import Samples

MOST_SENSITIVE_HZ = 250.0
LEAST_DISPLACEMENT_M = 1e-7

STYLUS_HZ = (10.0, 20.0, 160.0, 320.0)
STYLUS_M = (26e-6, 8.5e-6, 26e-6 * 10 ** (-13 * 4 / 20), 0.06e-6)
"""Corners of the stylus's curve; the third is four octaves of the mean slope below the first."""


def _contactor(frequency_hz: Samples) -> Samples:
    ratio = frequency_hz / MOST_SENSITIVE_HZ
    return np.asarray(LEAST_DISPLACEMENT_M * (ratio**-2 + ratio**2) / 2)


def _grasped_stylus(frequency_hz: Samples) -> Samples:
    """Join the corners by straight lines in dB over octaves; -12 dB per octave below the first, +12 above the last."""
    ends = (STYLUS_HZ[0] / 1000, *STYLUS_HZ, STYLUS_HZ[-1] * 1000)
    levels = (STYLUS_M[0] * 1000**2, *STYLUS_M, STYLUS_M[-1] * 1000**2)
    return np.asarray(np.exp(np.interp(np.log(frequency_hz), np.log(ends), np.log(levels))))


CONTACTOR = "contactor"

THRESHOLDS: Registry[Callable[[Samples], Samples]] = Registry(
    "threshold", {CONTACTOR: _contactor, "grasped_stylus": _grasped_stylus}
)
"""Name of a detection threshold curve -> peak displacement in m by frequency in Hz: the only list of names."""


def displacement_threshold(frequency_hz: ArrayLike, *, threshold: str = CONTACTOR) -> Samples:
    """Smallest displacement felt, by frequency.

    Examples
    --------
    >>> float(displacement_threshold(250.0))
    1e-07
    """
    frequency = np.asarray(frequency_hz, dtype=np.float64)
    if not (frequency > 0).all():
        raise ValueError(f"frequency_hz must be above 0 Hz, got {frequency.min()}")
    return THRESHOLDS.find(threshold)(frequency)


def acceleration_threshold(frequency_hz: ArrayLike, *, threshold: str = CONTACTOR) -> Samples:
    """Smallest acceleration felt, by frequency.

    Parameters
    ----------
    frequency_hz : array_like
        Frequencies in Hz, above 0.
    threshold : str
        Name of `THRESHOLDS`: `"contactor"` or `"grasped_stylus"`.

    Returns
    -------
    ndarray of float64
        Peak acceleration in m/s².

    Examples
    --------
    >>> from feel321 import stimuli
    >>> stimuli.acceleration_threshold([50.0, 250.0, 1000.0]).round(2)
    array([ 0.12,  0.25, 31.71])
    """
    frequency = np.asarray(frequency_hz, dtype=np.float64)
    return (2 * np.pi * frequency) ** 2 * displacement_threshold(frequency, threshold=threshold)
