"""PCA321: project on the axis that holds most energy, once for the whole signal or anew in short segments.

Conventions: acceleration (..., 3, n) in, reduced signal (..., n) out, same unit, float64; the input is never
modified. An axis has no sign of its own: it is chosen so that the output does not correlate negatively with the sum of
the components, and kept from segment to segment.

References
----------
.. [1] N. Landin, J. M. Romano, W. McMahan, K. J. Kuchenbecker, "Dimensional reduction of high-frequency accelerations
   for haptic rendering", EuroHaptics 2010, section 4. doi:10.1007/978-3-642-14075-4_12
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from stimuli.door import admit
from stimuli.frames import DEFAULT_WINDOW_S, run_offline, sqrt_hann, window_samples

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

# Below this the sum of an axis's components is rounding, and cannot choose its sign.
NO_SIGN = 1e-9
# A segment whose variation is below this share of its second moment is constant but for rounding.
_CONSTANT = 1e-20


def pca321(acceleration: ArrayLike, rate_hz: float) -> NDArray[np.float64]:
    """Project on the principal axis of the whole signal, its mean removed.

    Parameters
    ----------
    acceleration : array_like, shape (..., 3, n_samples)
        Acceleration of the three axes, any unit.
    rate_hz : float
        Sampling rate in Hz (not used by this method).

    Returns
    -------
    ndarray of float64, shape (..., n_samples)
        The projection; its mean is 0 and its energy is the largest that any fixed axis keeps.

    Notes
    -----
    The sign is the one whose correlation with x + y + z is not negative. Where it is 0 (an axis perpendicular to the
    sensor's diagonal, as for anti-phase axes), the axis's largest component is positive, the first among equals.

    Examples
    --------
    >>> np.round(pca321([[3, -3, 3, -3], [4, -4, 4, -4], [0, 0, 0, 0]], 1000), 12)
    array([ 5., -5.,  5., -5.])
    """
    admitted = admit(acceleration, rate_hz)
    samples = admitted.samples
    if samples.shape[-1] == 0:
        return np.zeros((*samples.shape[:-2], 0))
    centred = samples - samples.mean(axis=-1, keepdims=True)
    # einsum, not matmul: its result does not depend on how many threads a BLAS library happens to use.
    axes = with_sign(leading_axis(np.einsum("...in,...jn->...ij", centred, centred)))
    return admitted.restore(np.einsum("...i,...in->...n", axes, centred))


def pca321_adaptive(
    acceleration: ArrayLike, rate_hz: float, *, window_s: float = DEFAULT_WINDOW_S
) -> NDArray[np.float64]:
    """Project on a principal axis that is estimated anew in short overlapping segments and turns smoothly.

    Parameters
    ----------
    acceleration : array_like, shape (..., 3, n_samples)
        Acceleration of the three axes, any unit.
    rate_hz : float
        Sampling rate in Hz.
    window_s : float
        Length of a segment in s; the nearest even number of samples, at least 2, is used.

    Returns
    -------
    ndarray of float64, shape (..., n_samples)
        The projection. An offset of the recording is projected with it: remove it first.

    Notes
    -----
    Segments overlap by half. Each has the leading eigenvector of its Hann-weighted covariance, with the sign that
    points along the segment before (the first: along the sensor's diagonal, which makes it correlate non-negatively
    with the sum of the components). At every sample the axes of its two segments are mixed with their weights and
    brought to unit length. A constant segment keeps the axis before it. Only the past is used, so the method streams.
    """
    admitted = admit(acceleration, rate_hz)
    hop = window_samples(window_s, rate_hz) // 2
    return admitted.restore(run_offline(PrincipalFrames, admitted.samples, hop))


def leading_axis(covariance: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the unit eigenvector of the largest eigenvalue, its sign left open.

    Parameters
    ----------
    covariance : ndarray, shape (..., 3, 3)
        Symmetric matrices.

    Returns
    -------
    ndarray of float64, shape (..., 3)
        Unit vectors.
    """
    return np.asarray(np.linalg.eigh(covariance)[1][..., -1])


def with_sign(axes: NDArray[np.float64]) -> NDArray[np.float64]:
    """Turn axes so that they point along the sensor's diagonal, or by their largest component where they cannot.

    Parameters
    ----------
    axes : ndarray, shape (..., 3)
        Unit vectors.

    Returns
    -------
    ndarray of float64, shape (..., 3)
        The same axes, each possibly turned about.
    """
    along = axes.sum(axis=-1, keepdims=True)
    strength = np.abs(axes)
    first = np.argmax(strength >= (1 - NO_SIGN) * strength.max(axis=-1, keepdims=True), axis=-1)
    largest = np.take_along_axis(axes, first[..., None], axis=-1)
    return np.asarray(axes * np.where(np.where(np.abs(along) > NO_SIGN, along, largest) < 0, -1.0, 1.0))


class PrincipalFrames:
    """The block processor of `pca321_adaptive`: see `frames.BlockProcessor`.

    Parameters
    ----------
    batch : tuple of int
        Leading axes of the signal.
    hop : int
        Half a segment, in samples.
    """

    def __init__(self, batch: tuple[int, ...], hop: int) -> None:
        self.hop = hop
        window = sqrt_hann(2 * hop) ** 2
        self._rise, self._fall = np.split(window, 2)
        self._previous = np.zeros((*batch, 3, 1, hop))
        self._valid = np.zeros((1, hop), dtype=bool)
        self._axis = np.full((*batch, 1, 3), 1 / np.sqrt(3))

    def push(self, blocks: NDArray[np.float64], valid: NDArray[np.bool_]) -> NDArray[np.float64]:
        """Take blocks (..., 3, m, hop), give as many finished ones (..., m, hop), one hop late.

        Parameters
        ----------
        blocks : ndarray, shape (..., 3, m, hop)
            The next blocks of the signal.
        valid : ndarray of bool, shape (m, hop)
            False where a block holds no signal; such samples do not count in the covariance.

        Returns
        -------
        ndarray of float64, shape (..., m, hop)
            Finished blocks.
        """
        blocks = np.concatenate([self._previous, blocks], axis=-2)
        valid = np.concatenate([self._valid, valid])
        frames = np.concatenate([blocks[..., :-1, :], blocks[..., 1:, :]], axis=-1)
        weights = np.concatenate([valid[:-1] * self._rise, valid[1:] * self._fall], axis=-1)
        axes = np.concatenate([self._axis, self._turned(*_segment_axes(frames, weights))], axis=-2)
        self._previous, self._valid, self._axis = blocks[..., -1:, :].copy(), valid[-1:], axes[..., -1:, :]
        mixed = axes[..., :-1, :, None] * self._fall + axes[..., 1:, :, None] * self._rise
        mixed /= np.linalg.norm(mixed, axis=-2, keepdims=True)
        return np.asarray(np.einsum("...mih,...imh->...mh", mixed, blocks[..., :-1, :]))

    def _turned(self, axes: NDArray[np.float64], constant: NDArray[np.bool_]) -> NDArray[np.float64]:
        """Let constant segments keep the axis before them, and turn each axis to point along the one before."""
        axes = np.concatenate([self._axis, with_sign(axes)], axis=-2)
        own = np.where(constant, 0, np.arange(1, axes.shape[-2]))
        own = np.concatenate([np.zeros_like(own[..., :1]), np.maximum.accumulate(own, axis=-1)], axis=-1)
        axes = np.take_along_axis(axes, own[..., None], axis=-2)
        along = np.einsum("...mi,...mi->...m", axes[..., 1:, :], axes[..., :-1, :])
        # An axis across the one before it keeps the sign that it has by itself: rounding must not choose.
        signs = np.cumprod(np.where(along < -NO_SIGN, -1.0, 1.0), axis=-1)
        return np.asarray(axes[..., 1:, :] * signs[..., None])


def _segment_axes(
    frames: NDArray[np.float64], weights: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Leading axes (..., m, 3) of frames (..., 3, m, length), and which frames are constant (..., m)."""
    total = np.maximum(weights.sum(axis=-1), np.finfo(np.float64).tiny)
    mean = np.einsum("...imt,mt->...im", frames, weights) / total
    centred = (frames - mean[..., None]) * np.sqrt(weights)
    covariance = np.einsum("...imt,...jmt->...mij", centred, centred)
    variation = np.trace(covariance, axis1=-2, axis2=-1)
    constant = variation <= _CONSTANT * np.einsum("...im,m->...m", mean**2, total)
    return leading_axis(covariance), np.asarray(constant)
