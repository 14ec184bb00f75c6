"""DFT321: keep the energy of all three axes at every frequency, with the phase of their sum.

Conventions: acceleration (..., 3, n) in, reduced signal (..., n) out, same unit, float64; the input is never
modified. `dft321` works on the whole signal at once (offline, stationary vibrations); `dft321_windowed` on short
overlapping frames (transients, streaming).

References
----------
.. [1] N. Landin, J. M. Romano, W. McMahan, K. J. Kuchenbecker, "Dimensional reduction of high-frequency accelerations
   for haptic rendering", EuroHaptics 2010, equations 3 and 4. doi:10.1007/978-3-642-14075-4_12
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from stimuli.door import admit
from stimuli.frames import DEFAULT_WINDOW_S, run_offline, sqrt_hann, window_samples

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

ROUNDING = 32 * np.finfo(np.float64).eps
"""A sum of three axes below this share of the spectrum's root mean square is the rounding error of the transforms."""

# So few that what is worked on stays in the processor's cache and no memory is asked from the system.
_BINS_AT_A_TIME = 16384
# Axes whose strengths differ by less than this are equally strong; the first of them counts.
_TIE = 1e-6


def dft321(acceleration: ArrayLike, rate_hz: float) -> NDArray[np.float64]:
    r"""Keep the energy of all axes at every frequency, with the phase of their sum, over the whole signal.

    Parameters
    ----------
    acceleration : array_like, shape (..., 3, n_samples)
        Acceleration of the three axes, any unit.
    rate_hz : float
        Sampling rate in Hz (not used by this method).

    Returns
    -------
    ndarray of float64, shape (..., n_samples)
        The reduced signal; its energy is the sum of the axes' energies.

    Notes
    -----
    With :math:`A_i` the discrete Fourier transform of axis i [1]_,

    .. math:: A_s = \sqrt{\textstyle\sum_i |A_i|^2}\; e^{j \angle \sum_i A_i}

    Where the sum of the axes vanishes its phase is undetermined. Below the rounding error of the transforms the
    strongest axis's phase is taken instead (the first, among equally strong ones), so that the phase is never set by
    rounding. Sensor noise above that still sets it: that is the method's own limit.

    References
    ----------
    .. [1] Landin et al. 2010, equations 3 and 4. doi:10.1007/978-3-642-14075-4_12

    Examples
    --------
    >>> u = np.array([1.0, -2.0, 0.5, 0.25])
    >>> np.round(dft321([u, u, u], 1000) / np.sqrt(3), 12)
    array([ 1.  , -2.  ,  0.5 ,  0.25])
    """
    from scipy import fft

    admitted = admit(acceleration, rate_hz)
    n = admitted.samples.shape[-1]
    if n == 0:
        return np.zeros((*admitted.samples.shape[:-2], 0))
    merged = merge_spectra(transform(admitted.samples), admitted.energy)
    return admitted.restore(fft.irfft(merged, n, overwrite_x=True))


def dft321_windowed(
    acceleration: ArrayLike, rate_hz: float, *, window_s: float = DEFAULT_WINDOW_S
) -> NDArray[np.float64]:
    """Apply the rule of `dft321` to short overlapping frames.

    Parameters
    ----------
    acceleration : array_like, shape (..., 3, n_samples)
        Acceleration of the three axes, any unit.
    rate_hz : float
        Sampling rate in Hz.
    window_s : float
        Length of a frame in s; the nearest even number of samples, at least 2, is used. The paper found 25 to 50 ms
        equally good.

    Returns
    -------
    ndarray of float64, shape (..., n_samples)
        The reduced signal, covered by two frames at every sample, the first and the last included.

    Notes
    -----
    Frames overlap by half, with the square root of a Hann window before the transform and after its inverse, so the
    windows' squares add up to 1 and need no division: three equal axes u give sqrt(3) u at every sample.

    References
    ----------
    .. [1] Landin et al. 2010, section 4. doi:10.1007/978-3-642-14075-4_12
    """
    admitted = admit(acceleration, rate_hz)
    hop = window_samples(window_s, rate_hz) // 2
    return admitted.restore(run_offline(FourierFrames, admitted.samples, hop))


class FourierFrames:
    """The block processor of `dft321_windowed`: see `frames.BlockProcessor`.

    Parameters
    ----------
    batch : tuple of int
        Leading axes of the signal.
    hop : int
        Half a frame, in samples.
    """

    def __init__(self, batch: tuple[int, ...], hop: int) -> None:
        self.hop = hop
        self._rise, self._fall = np.split(sqrt_hann(2 * hop), 2)
        self._previous = np.zeros((*batch, 3, hop))
        self._tail = np.zeros((*batch, hop))

    def push(self, blocks: NDArray[np.float64], valid: NDArray[np.bool_]) -> NDArray[np.float64]:
        """Take blocks (..., 3, m, hop), give as many finished ones (..., m, hop), one hop late.

        Parameters
        ----------
        blocks : ndarray, shape (..., 3, m, hop)
            The next blocks of the signal.
        valid : ndarray of bool, shape (m, hop)
            Not used: silence around the signal is part of its first and last frame.

        Returns
        -------
        ndarray of float64, shape (..., m, hop)
            Finished blocks.
        """
        from scipy import fft

        del valid
        hop = self.hop
        frames = np.empty((*blocks.shape[:-1], 2 * hop))
        np.multiply(self._previous, self._rise, out=frames[..., 0, :hop])
        np.multiply(blocks[..., :-1, :], self._rise, out=frames[..., 1:, :hop])
        np.multiply(blocks, self._fall, out=frames[..., hop:])
        self._previous = blocks[..., -1, :].copy()
        merged = self.merge([*np.moveaxis(fft.rfft(frames), -3, 0)], frames)
        reduced = fft.irfft(merged, 2 * hop, overwrite_x=True)
        finished = reduced[..., :hop] * self._rise
        reduced[..., hop:] *= self._fall
        finished[..., 0, :] += self._tail
        finished[..., 1:, :] += reduced[..., :-1, hop:]
        self._tail = reduced[..., -1, hop:].copy()
        return finished

    def merge(
        self, spectra: list[NDArray[np.complex128]], frames: NDArray[np.float64]
    ) -> NDArray[np.complex128]:
        """Make one spectrum of the three axes', frame by frame; other rules override this.

        Parameters
        ----------
        spectra : list of three ndarrays of complex128, shape (..., m, n_bins)
            One-sided spectra of the axes in m frames; may be overwritten.
        frames : ndarray, shape (..., 3, m, 2 * hop)
            The same frames in time.

        Returns
        -------
        ndarray of complex128, shape (..., m, n_bins)
            The merged spectra.
        """
        return merge_spectra(spectra, np.einsum("...imt,...imt->...m", frames, frames)[..., None])


def transform(samples: NDArray[np.float64]) -> list[NDArray[np.complex128]]:
    """Give the spectra of the three axes.

    One after the other: at once they would ask for one large piece of fresh memory, and axes that lie a whole number of
    memory pages apart would fight for the same places in the processor's cache.

    Parameters
    ----------
    samples : ndarray, shape (..., 3, n_samples)
        The three axes.

    Returns
    -------
    list of three ndarrays of complex128, shape (..., n_samples // 2 + 1)
        One-sided spectra of the axes.
    """
    from scipy import fft

    return [fft.rfft(axis) for axis in np.moveaxis(samples, -2, 0)]


def merge_spectra(spectra: list[NDArray[np.complex128]], energy: NDArray[np.float64]) -> NDArray[np.complex128]:
    """Merge the spectra of the axes by equations 3 and 4.

    Parameters
    ----------
    spectra : list of three ndarrays of complex128, shape (..., n_bins)
        One-sided spectra of the axes; the first is overwritten.
    energy : ndarray, shape (..., 1)
        Energy of the three signals in time, by Parseval's theorem the mean energy per bin of their two-sided spectra.

    Returns
    -------
    ndarray of complex128, shape (..., n_bins)
        Magnitude: root of the summed energies. Phase: of the sum, or of the strongest axis where the sum vanishes.
    """
    floor = ROUNDING**2 * energy
    for start in range(0, spectra[0].shape[-1], _BINS_AT_A_TIME):
        parts = [spectrum[..., start : start + _BINS_AT_A_TIME] for spectrum in spectra]
        parts[0][...] = _merge(parts, floor)
    return spectra[0]


def _merge(spectra: list[NDArray[np.complex128]], floor: NDArray[np.float64]) -> NDArray[np.complex128]:
    x, y, z = spectra
    merged: NDArray[np.complex128] = x + y
    merged += z
    energy = bin_energy(x)
    energy += bin_energy(y)
    energy += bin_energy(z)
    of_sum = bin_energy(merged)
    vanishing = of_sum <= floor
    if vanishing.any():
        _take_strongest(merged, of_sum, spectra=spectra, vanishing=vanishing)
    np.divide(energy, of_sum, out=energy)
    np.sqrt(energy, out=energy)
    merged *= energy
    return merged


def _take_strongest(
    merged: NDArray[np.complex128],
    of_sum: NDArray[np.float64],
    *,
    spectra: list[NDArray[np.complex128]],
    vanishing: NDArray[np.bool_],
) -> None:
    """Put the strongest axis where the sum vanishes; silence stays silence."""
    there = np.array([spectrum[vanishing] for spectrum in spectra])
    strength = np.abs(there)
    first = np.argmax(strength >= (1 - _TIE) * strength.max(axis=0), axis=0)
    strongest = np.take_along_axis(there, first[None], axis=0)[0]
    merged[vanishing] = strongest
    of_strongest = bin_energy(strongest)
    of_sum[vanishing] = np.where(of_strongest > 0, of_strongest, 1.0)


def bin_energy(spectrum: NDArray[np.complex128]) -> NDArray[np.float64]:
    """Compute the energy of every bin.

    Parameters
    ----------
    spectrum : ndarray of complex128
        Any shape.

    Returns
    -------
    ndarray of float64
        Squared magnitudes, same shape.
    """
    energy: NDArray[np.float64] = np.square(spectrum.real)
    energy += np.square(spectrum.imag)
    return energy
