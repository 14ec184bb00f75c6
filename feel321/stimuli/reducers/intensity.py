"""Reducers that keep the intensity of the motion at each moment: possible reasons why vector magnitude feels good.

Conventions: acceleration (..., 3, n) in, reduced signal (..., n) out, same unit, float64; the input is never modified.
In a study the length of the vector (`mag321`) felt good despite its low matches [1]_. Two accounts of that can be
tried: that its rectified waveform does not matter (`mag321_signed` gives the length a sign), or that nothing but its
envelope does (`carrier321` plays that on a plain carrier: vibrations whose short segments had equal energy were hard to
tell apart [2]_). Both are our own constructions. An offset counts as motion: remove it first.

References
----------
.. [1] G. Park, K. J. Kuchenbecker, "Objective and subjective assessment of algorithms for reducing three-axis
   vibrations to one-axis vibrations", World Haptics 2019. doi:10.1109/WHC.2019.8816148
.. [2] N. Cao, H. Nagano, M. Konyo, S. Okamoto, S. Tadokoro, "A pilot study: introduction of time-domain segment to
   intensity-based perception model of high-frequency vibration", EuroHaptics 2018. doi:10.1007/978-3-319-93445-7_28
"""

import math

import numpy as np
from numpy.typing import ArrayLike

from feel321.stimuli.recording import admit
from feel321.types import Samples

CARRIER_HZ = 250.0
"""The frequency at which least vibration is felt; a quarter of the sampling rate where that is lower."""

SMOOTHING_S = 0.005
"""Time constant of the envelope: it follows up to 30 Hz or so."""


def mag321_signed(acceleration: ArrayLike, rate_hz: float) -> Samples:
    """Take the length of the acceleration vector, with the sign of the sum of its components.

    The energy is that of all axes at every sample. Motion along one line is kept as it is; where the vector crosses the
    plane in which its components cancel, the output jumps from one side to the other.

    Examples
    --------
    >>> mag321_signed([[1, -3], [2, 0], [2, -4]], 1000)
    array([ 3., -5.])
    """
    admitted = admit(acceleration, rate_hz)
    samples = admitted.samples
    length = np.sqrt(np.einsum("...in,...in->...n", samples, samples))
    return admitted.restore(np.where(samples.sum(axis=-2) < 0, -length, length))


def carrier321(acceleration: ArrayLike, rate_hz: float) -> Samples:
    r"""Play the intensity of all three axes on a carrier of 250 Hz.

    Notes
    -----
    With the mean energy per sample, e, of all axes in the recent past (time constant 5 ms), the output is
    :math:`\sqrt{2 e(t)} \sin(2 \pi \cdot 250 \, t)`: as strong as the recording, no matter how it moved. No
    orientation of the sensor changes it. All energy being at one frequency, its spectral match is as low as can be.
    """
    admitted = admit(acceleration, rate_hz)
    carrier = Carrier(admitted.samples.shape[:-2], rate_hz)
    return admitted.restore(carrier.push(admitted.samples))


class Carrier:
    """The sample by sample form of `carrier321`."""

    def __init__(self, batch: tuple[int, ...], rate_hz: float) -> None:
        self._memory = math.exp(-1 / (SMOOTHING_S * rate_hz))
        self._turn = 2 * math.pi * min(CARRIER_HZ / rate_hz, 0.25)
        self._energy = np.zeros((*batch, 1))
        self._n = 0

    def push(self, samples: Samples) -> Samples:
        """Reduce the next samples, (..., 3, k), to as many of the output, (..., k), without delay."""
        from scipy.signal import lfilter

        power = np.einsum("...in,...in->...n", samples, samples)
        if not power.size:
            return np.asarray(power)
        energy, self._energy = lfilter(
            np.array([1 - self._memory]), np.array([1.0, -self._memory]), power, zi=self._energy
        )
        place = np.arange(self._n, self._n + power.shape[-1])
        self._n += power.shape[-1]
        return np.asarray(np.sqrt(2 * energy) * np.sin(self._turn * place))
