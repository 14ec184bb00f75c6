"""What the hand feels of a vibration: the threshold curve, and a level weighted by it.

The curve is a model, not a digitised table: the Pacinian channel's displacement threshold is U-shaped, falling by 12
dB per octave up to about 250 Hz and rising as steeply above, with a minimum near 0.1 µm [1]_ [2]_. In acceleration
that is flat below about 200 Hz and rises by 24 dB per octave above 300 Hz. Only the curve's shape matters for the
equal-intensity arm, not its height: the level of one stimulus is compared with that of another.

References
----------
.. [1] S. J. Bolanowski, G. A. Gescheider, R. T. Verrillo, C. M. Checkosky, "Four channels mediate the mechanical
   aspects of touch", JASA 84(5), 1988. doi:10.1121/1.397184
.. [2] R. T. Verrillo, "Effect of contactor area on the vibrotactile threshold", JASA 35(12), 1963.
   doi:10.1121/1.1918868
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from stimuli.spectrum import HIGHEST_HZ, LOWEST_HZ

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

MOST_SENSITIVE_HZ = 250.0
LEAST_DISPLACEMENT_M = 1e-7


def displacement_threshold(frequency_hz: ArrayLike) -> NDArray[np.float64]:
    """Smallest displacement felt, by frequency.

    Parameters
    ----------
    frequency_hz : array_like
        Frequencies in Hz, above 0.

    Returns
    -------
    ndarray of float64
        Peak displacement in m.

    Examples
    --------
    >>> float(displacement_threshold(250.0))
    1e-07
    """
    ratio = np.asarray(frequency_hz, dtype=np.float64) / MOST_SENSITIVE_HZ
    return LEAST_DISPLACEMENT_M * (ratio**-2 + ratio**2) / 2


def acceleration_threshold(frequency_hz: ArrayLike) -> NDArray[np.float64]:
    """Smallest acceleration felt, by frequency.

    Parameters
    ----------
    frequency_hz : array_like
        Frequencies in Hz, above 0.

    Returns
    -------
    ndarray of float64
        Peak acceleration in m/s².
    """
    frequency = np.asarray(frequency_hz, dtype=np.float64)
    return (2 * np.pi * frequency) ** 2 * displacement_threshold(frequency)


def felt_level(acceleration: NDArray[np.float64], rate_hz: float) -> float:
    """Root mean square over the felt range, 20 to 1000 Hz, in units of the threshold; axes add by energy.

    Parameters
    ----------
    acceleration : ndarray, shape (n_samples,) or (axes, n_samples)
        Acceleration in m/s².
    rate_hz : float
        Sampling rate in Hz.

    Returns
    -------
    float
        Level as a multiple of the threshold's root mean square; 0 for silence.
    """
    from scipy import fft

    n = acceleration.shape[-1]
    # Silence at the end adds no energy, and lengths with large prime factors cost ten times as much.
    padded = fft.next_fast_len(n, real=True)
    frequency = fft.rfftfreq(padded, 1 / rate_hz)
    felt = (frequency >= LOWEST_HZ) & (frequency <= HIGHEST_HZ)
    spectrum = fft.rfft(acceleration, padded)[..., felt]
    weighted = np.abs(spectrum) / (acceleration_threshold(frequency[felt]) / np.sqrt(2))
    # One-sided bins stand for two, but for one at the Nyquist frequency.
    shares = np.where(2 * frequency[felt] < rate_hz * (1 - 1e-12), 2.0, 1.0)
    return float(np.sqrt(np.sum(shares * weighted**2) / n / padded))
