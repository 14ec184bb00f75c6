"""The one door of every reducer: coerce, refuse, and bring extreme values into a safe range.

Reducers are homogeneous of degree one, so a recording whose squares would overflow or vanish is scaled by a
power of two (which is exact) and its output scaled back. Ordinary recordings pass unscaled.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from stimuli.recording import check_finite, check_rate, coerce_acceleration, coerce_real

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

# Fourth powers of anything between these stay far inside float64's range, for any length.
SAFE_PEAK = (1e-60, 1e60)


class Admitted(NamedTuple):
    """Samples in a safe range, and the way back.

    Parameters
    ----------
    samples : ndarray, shape (..., 3, n_samples)
        The caller's samples, each recording divided by a power of two where that is needed.
    energy : ndarray, shape (..., 1)
        Sum of the squares of these samples.
    exponents : ndarray of int, shape (..., 1), or None
        The powers; None where nothing was scaled.
    """

    samples: NDArray[np.float64]
    energy: NDArray[np.float64]
    exponents: NDArray[np.intc] | None = None

    def restore(self, reduced: NDArray[np.float64]) -> NDArray[np.float64]:
        """Give a reduced signal back in the caller's unit.

        Parameters
        ----------
        reduced : ndarray, shape (..., n_samples)
            What was made of `samples`.

        Returns
        -------
        ndarray of float64, shape (..., n_samples)
            The same in the caller's unit.
        """
        return reduced if self.exponents is None else np.ldexp(reduced, self.exponents)


def admit(acceleration: ArrayLike, rate_hz: float) -> Admitted:
    """Check a reducer's input, shape (..., 3, n_samples), and scale it only where squares would overflow or vanish.

    Parameters
    ----------
    acceleration : array_like, shape (..., 3, n_samples)
        Acceleration of the three axes, any unit.
    rate_hz : float
        Sampling rate in Hz.

    Returns
    -------
    Admitted
        The samples, float64 of the same shape, and the way back to the caller's unit.

    Raises
    ------
    ValueError
        If the input is not three axes of finite numbers, or the rate is not above 0.
    """
    check_rate(rate_hz)
    samples = coerce_acceleration(acceleration)
    energy = _energy(samples)
    # The root of the energy is at least the peak and at most so many times it; one pass tells that all is ordinary.
    if np.all(is_safe(np.sqrt(energy))) and (np.all(energy) or not samples.any()):
        return Admitted(samples, energy)
    check_finite(samples, "acceleration")
    peaks = np.abs(samples).max(axis=(-2, -1), initial=0.0)[..., None]
    exponents = np.where(is_safe(peaks), 0, np.frexp(peaks)[1])
    samples = np.ldexp(samples, -exponents[..., None])
    return Admitted(samples, _energy(samples), exponents)


def _energy(samples: NDArray[np.float64]) -> NDArray[np.float64]:
    with np.errstate(over="ignore", invalid="ignore"):
        return np.asarray(np.einsum("...in,...in->...", samples, samples))[..., None]


def is_safe(peaks: ArrayLike) -> NDArray[np.bool_]:
    """Tell which peaks need no scaling.

    Parameters
    ----------
    peaks : array_like
        Largest magnitudes.

    Returns
    -------
    ndarray of bool
        True where squares neither overflow nor vanish, and for silence.
    """
    peaks = np.asarray(peaks)
    return np.asarray((peaks == 0.0) | ((peaks >= SAFE_PEAK[0]) & (peaks <= SAFE_PEAK[1])))


def largest(samples: NDArray[np.float64]) -> float:
    """Return the largest magnitude, 0 for an empty array, without making a copy.

    Parameters
    ----------
    samples : ndarray
        Any shape; not finite if a value is not.

    Returns
    -------
    float
        max(abs(samples)).
    """
    return max(float(samples.max()), -float(samples.min())) if samples.size else 0.0


def check_reduced(reduced: ArrayLike, shape: tuple[int, ...]) -> NDArray[np.float64]:
    """Coerce a reduced signal to float64, or say why it does not go with its recording.

    Parameters
    ----------
    reduced : array_like, shape (n_samples,)
        The reduced signal.
    shape : tuple of int
        Shape of the recording's acceleration, to be (3, n_samples) with n_samples >= 1.

    Returns
    -------
    ndarray of float64, shape (n_samples,)
        The same values.

    Raises
    ------
    ValueError
        If the recording is a batch or empty, the lengths differ, or a value is not finite.
    """
    if len(shape) != 2 or shape[-1] == 0:  # noqa: PLR2004 - axes x samples
        raise ValueError(f"acceleration: got shape {shape}, allowed is (3, n) with n >= 1: one recording at a time")
    signal = coerce_real(reduced, "reduced")
    if signal.shape != shape[-1:]:
        raise ValueError(
            f"reduced: got shape {signal.shape}, allowed is {shape[-1:]}: as many samples as the recording, one axis"
        )
    check_finite(signal, "reduced")
    return signal
