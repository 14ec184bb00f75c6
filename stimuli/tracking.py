"""DFT321 along a leading axis, in short frames: the axis is remembered from frame to frame and never jumps.

Conventions as in `fourier`: acceleration (..., 3, n) in, reduced signal (..., n) out, same unit, float64. Only the past
is used, so the method streams. An offset of the recording leaks into all frames' first bins: remove it first.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from stimuli.door import admit
from stimuli.fourier import FourierFrames
from stimuli.frames import DEFAULT_WINDOW_S, run_offline, window_samples
from stimuli.leading import align, covary, find_onset, go_along, start_axis, sum_energy

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

MEMORY = 0.99
"""What a frame still counts one frame later: with frames of 35 ms, a time constant of 1.75 s."""


def dft321_principal_windowed(
    acceleration: ArrayLike, rate_hz: float, *, window_s: float = DEFAULT_WINDOW_S
) -> NDArray[np.float64]:
    """Apply the rule of `dft321_principal` to short overlapping frames, with an axis that turns slowly.

    Parameters
    ----------
    acceleration : array_like, shape (..., 3, n_samples)
        Acceleration of the three axes, any unit.
    rate_hz : float
        Sampling rate in Hz.
    window_s : float
        Length of a frame in s; the nearest even number of samples, at least 2, is used.

    Returns
    -------
    ndarray of float64, shape (..., n_samples)
        The reduced signal, covered by two frames at every sample, the first and the last included. Turning or mirroring
        the sensor does not change it, but for its sign in rare cases.

    Notes
    -----
    Frames, windows and overlap are those of `dft321_windowed`. A frame of 35 ms is too short to have an axis of its
    own: near-equal eigenvalues are common, and an axis that wanders smears what overlaps. So each frame gets the axis
    of its past: the covariance is remembered, its leading axis gives this frame's direction (`leading.go_along`),
    and the directions are remembered in turn, each with the sign that agrees with what is remembered. Neighbouring
    frames' axes therefore differ by less than a right angle, always. The first frame that is not silent gives the
    onset towards which every frame's axis leans a little.
    """
    admitted = admit(acceleration, rate_hz)
    hop = window_samples(window_s, rate_hz) // 2
    return admitted.restore(run_offline(TrackingFrames, admitted.samples, hop))


class TrackingFrames(FourierFrames):
    """The block processor of `dft321_principal_windowed`: see `frames.BlockProcessor`.

    Parameters
    ----------
    batch : tuple of int
        Leading axes of the signal.
    hop : int
        Half a frame, in samples.
    """

    def __init__(self, batch: tuple[int, ...], hop: int) -> None:
        super().__init__(batch, hop)
        self._onset = np.zeros((*batch, 3))
        self._covariance = np.zeros((*batch, 3, 3))
        self._along = np.zeros((*batch, 3))

    def merge(self, spectra: list[NDArray[np.complex128]], frames: NDArray[np.float64]) -> NDArray[np.complex128]:
        """Give every frame equation 3's magnitude and the phase of the projection on its axis.

        Parameters
        ----------
        spectra : list of three ndarrays of complex128, shape (..., m, n_bins)
            One-sided spectra of the axes in m frames.
        frames : ndarray, shape (..., 3, m, 2 * hop)
            The same frames in time.

        Returns
        -------
        ndarray of complex128, shape (..., m, n_bins)
            The merged spectra.
        """
        energy = sum_energy(spectra)
        self._listen(energy.any(axis=-1), frames)
        covariances = self._remember(covary(spectra, energy))
        first = start_axis(covariances, np.broadcast_to(self._onset[..., None, :], covariances.shape[:-1]))
        return align(spectra, energy, axis=self._agree(go_along(spectra, energy, axis=first), first))

    def _listen(self, loud: NDArray[np.bool_], frames: NDArray[np.float64]) -> None:
        """Note the onset in the first frame that is not silent."""
        new = loud.any(axis=-1) & ~self._onset.any(axis=-1)
        if new.any():
            first = np.argmax(loud, axis=-1)[..., None, None, None]
            onset = find_onset(np.take_along_axis(frames, first, axis=-2)[..., 0, :])
            self._onset = np.where(new[..., None], onset, self._onset)

    def _remember(self, covariances: NDArray[np.float64]) -> NDArray[np.float64]:
        for k in range(covariances.shape[-3]):
            covariances[..., k, :, :] += MEMORY * self._covariance
            self._covariance = covariances[..., k, :, :]
        return covariances

    def _agree(self, along: NDArray[np.float64], otherwise: NDArray[np.float64]) -> NDArray[np.float64]:
        """Remember directions, each turned about if it disagrees; give the axes (..., m, 3)."""
        for k in range(along.shape[-2]):
            here = along[..., k, :]
            agreement = np.einsum("...i,...i->...", here, self._along)[..., None]
            self._along = MEMORY * self._along + np.where(agreement < 0, -here, here)
            along[..., k, :] = self._along
        length = np.sqrt(np.einsum("...i,...i->...", along, along))[..., None]
        return np.asarray(np.where(length > 0, along / np.where(length > 0, length, 1.0), otherwise))
