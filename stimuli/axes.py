"""Reducers without memory: one axis, the sum of the axes, the vector's magnitude.

Conventions: acceleration (..., 3, n) in, reduced signal (..., n) out, same unit, float64; the input is never
modified. None of them needs the sampling rate; they take it so that every reducer is called alike.

References
----------
.. [1] N. Landin, J. M. Romano, W. McMahan, K. J. Kuchenbecker, "Dimensional reduction of high-frequency accelerations
   for haptic rendering", EuroHaptics 2010, section 4. doi:10.1007/978-3-642-14075-4_12
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from stimuli.door import admit

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray


def sax321(acceleration: ArrayLike, rate_hz: float) -> NDArray[np.float64]:
    """Keep the sensor's x axis.

    Parameters
    ----------
    acceleration : array_like, shape (..., 3, n_samples)
        Acceleration of the three axes, any unit.
    rate_hz : float
        Sampling rate in Hz (not used by this method).

    Returns
    -------
    ndarray of float64, shape (..., n_samples)
        The x axis.

    Examples
    --------
    >>> sax321([[1, 2], [3, 4], [5, 6]], 1000)
    array([1., 2.])
    """
    return _axis(acceleration, rate_hz, 0)


def say321(acceleration: ArrayLike, rate_hz: float) -> NDArray[np.float64]:
    """Keep the sensor's y axis.

    Parameters
    ----------
    acceleration : array_like, shape (..., 3, n_samples)
        Acceleration of the three axes, any unit.
    rate_hz : float
        Sampling rate in Hz (not used by this method).

    Returns
    -------
    ndarray of float64, shape (..., n_samples)
        The y axis.
    """
    return _axis(acceleration, rate_hz, 1)


def saz321(acceleration: ArrayLike, rate_hz: float) -> NDArray[np.float64]:
    """Keep the sensor's z axis.

    Parameters
    ----------
    acceleration : array_like, shape (..., 3, n_samples)
        Acceleration of the three axes, any unit.
    rate_hz : float
        Sampling rate in Hz (not used by this method).

    Returns
    -------
    ndarray of float64, shape (..., n_samples)
        The z axis.
    """
    return _axis(acceleration, rate_hz, 2)


def soc321(acceleration: ArrayLike, rate_hz: float) -> NDArray[np.float64]:
    """Add the three axes.

    Axes in phase interfere constructively (three equal axes: three times the energy), axes in anti-phase cancel.

    Parameters
    ----------
    acceleration : array_like, shape (..., 3, n_samples)
        Acceleration of the three axes, any unit.
    rate_hz : float
        Sampling rate in Hz (not used by this method).

    Returns
    -------
    ndarray of float64, shape (..., n_samples)
        x + y + z.

    Examples
    --------
    >>> soc321([[1, 2], [3, 4], [-4, 6]], 1000)
    array([ 0., 12.])
    """
    admitted = admit(acceleration, rate_hz)
    return admitted.restore(admitted.samples.sum(axis=-2))


def mag321(acceleration: ArrayLike, rate_hz: float) -> NDArray[np.float64]:
    """Take the length of the acceleration vector.

    Never negative, so it has an offset that the vibration did not have, and frequencies are doubled and mixed.

    Parameters
    ----------
    acceleration : array_like, shape (..., 3, n_samples)
        Acceleration of the three axes, any unit.
    rate_hz : float
        Sampling rate in Hz (not used by this method).

    Returns
    -------
    ndarray of float64, shape (..., n_samples)
        sqrt(x**2 + y**2 + z**2).

    Examples
    --------
    >>> mag321([[1, -3], [2, 0], [2, 4]], 1000)
    array([3., 5.])
    """
    admitted = admit(acceleration, rate_hz)
    return admitted.restore(np.sqrt(np.einsum("...in,...in->...n", admitted.samples, admitted.samples)))


def _axis(acceleration: ArrayLike, rate_hz: float, axis: int) -> NDArray[np.float64]:
    admitted = admit(acceleration, rate_hz)
    return admitted.restore(admitted.samples[..., axis, :].copy())
