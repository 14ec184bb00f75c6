r"""DFT321 along a leading axis: equation 3's magnitude, and the phase of the projection on one axis of the motion.

`dft321` takes its phase from the sum of the axes: from the projection on the sensor's own diagonal. Where the motion is
perpendicular to that diagonal (axes in anti-phase) the phase is left to noise, and turning the sensor changes the
output. Here the axis is found in the motion itself, so it turns with the sensor and the output stays.

Conventions as in `fourier`: acceleration (..., 3, n) in, reduced signal (..., n) out, same unit, float64. The windowed
form is in `tracking`.

Notes
-----
With :math:`A(f)` the spectrum of the three axes as a vector, *any* signal s of equation 3's magnitude,
:math:`|A_s| = \|A\|`, obeys for every unit vector u

.. math:: u \cdot \sum_f \mathrm{Re}(A \, \bar A_s) \le g(u) = \sum_f \|A\| \, |u \cdot A|,

with equality for the phase of :math:`u \cdot A`. The rotation-invariant temporal match of s (see `invariant`) is the
length of that sum of vectors, which is its component along its own direction, over :math:`\sum_f \|A\|^2`. Hence:

1. The best signal that keeps the spectrum has the phase of the projection on one fixed axis, the one that maximises g;
   no other phase, `dft321`'s included, gives a greater rotation-invariant temporal match.
2. The first principal axis maximises the like sum of squares :math:`\sum |u \cdot A|^2`, in one step and on a matrix of
   nine numbers. To climb from there (g is convex: the direction of :math:`\sum \mathrm{Re}(A \bar A_s)` is never worse
   than u [2]_) gained less than 0.005 of the match, cost a third of the time, and is left out.
3. Where :math:`u \cdot A(f) = 0` the phase is undetermined. But there g has a kink that points down: tilting u to
   either side raises it. So the best axis keeps away from such places, by as much as they have energy.
4. That is not enough for noise, which asks for distance from weak directions as well. Noise e turns the phase by
   :math:`|u \cdot e| / |u \cdot A|`, which changes the output by :math:`|u \cdot e|` times :math:`\|A\| / |u \cdot A|`:
   one over a cosine, however weak the tone. But a weak direction is also cheap to look at: a tilt of t towards a
   direction with a share r of the leading energy lowers the match by :math:`t^2 r / 2` or so. So u is tilted by
   :math:`t \propto C^{-1} o` (C the covariance, o the onset): about equally dear in all directions.

No choice is continuous everywhere: a phase that follows every shift in time (:math:`A \to e^{j\phi} A`) and is
continuous in the polarisation of A would be a section of the Hopf bundle, and there is none.

References
----------
.. [1] N. Landin, J. M. Romano, W. McMahan, K. J. Kuchenbecker, "Dimensional reduction of high-frequency accelerations
   for haptic rendering", EuroHaptics 2010, equations 3 and 4. doi:10.1007/978-3-642-14075-4_12
.. [2] N. Kwak, "Principal component analysis based on L1-norm maximization", IEEE Transactions on Pattern Analysis and
   Machine Intelligence 30(9), 2008. doi:10.1109/TPAMI.2008.114
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from stimuli.door import admit
from stimuli.fourier import ROUNDING, bin_energy, transform
from stimuli.principal import leading_axis

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import ArrayLike, NDArray

    Spectra = list[NDArray[np.complex128]]

PULL = 0.01
"""How far the start leans towards the onset's direction, as a share of the motion's energy: where the two leading
eigenvalues differ by less than this the onset decides, which noise cannot turn about. Measured at -60 dB of noise: on a
circle it takes the gain from hundreds to 1.3, for at most 0.002 of the rotation-invariant temporal match; isotropic
noise, whose eigenvalues differ by more than this by chance, keeps a gain of about 2, in rare takes of 5 to 20."""

TILT = 0.15
"""Point 4's tilt in units of the motion's standard deviation: takes the gain on two tones with 2 % of noise across both
from 26 to 2.5, on a drifting rotor from 6.7 to 1.6, on a chirp from 3.9 to 1.9, for at most 0.01 of the match."""

# No tilt beyond this: the axis stays a leading one, and what is known badly cannot turn it far.
_FARTHEST = 0.5
# Directions below this share of the energy (3 % of the amplitude) are left alone: what is there may be noise.
_WEAK = 1e-3

# So few that what is worked on stays in the processor's cache.
_AT_A_TIME = 8192
# A projection below this share of the motion has a phase that rounding (1e-15 or so) changes by more than 1e-9.
_ACROSS = 1e-7
# A root has a cut: laid where no tone of a plain phase (0, 45, 90 degrees, ...) comes to lie on it.
_CUT = np.exp(1j)
_ONSET = 0.5  # of the largest excursion: far from both the noise before it and the tie of many equal peaks
# A step at half would let noise choose where a peak just reaches it: the gain was above 20 for 1 noise in 50. So the
# chance that the motion has begun rises from 0 to 1 between these, in energy.
_MAYBE, _SURELY = 0.3, 0.7


def dft321_principal(acceleration: ArrayLike, rate_hz: float) -> NDArray[np.float64]:
    r"""Keep the energy of all axes at every frequency, with the phase of the projection on the leading axis.

    Parameters
    ----------
    acceleration : array_like, shape (..., 3, n_samples)
        Acceleration of the three axes, any unit.
    rate_hz : float
        Sampling rate in Hz (not used by this method).

    Returns
    -------
    ndarray of float64, shape (..., n_samples)
        The reduced signal; its energy is the sum of the axes' energies. Turning or mirroring the sensor does not change
        it, but for its sign in rare cases.

    Notes
    -----
    With :math:`A` the vector of the axes' discrete Fourier transforms, and u a unit vector,

    .. math:: A_s = \|A\| \; e^{j \angle (u \cdot A)}

    u starts as the first principal axis of the vibration (an offset does not count), leaning a little towards the
    *onset*: where the motion first comes near half of its largest excursion. The onset decides where two principal axes
    are equally strong, and gives u its sign: at the onset the motion goes along it. Then u is tilted a little, so that
    it sees weak directions too; the module's notes derive that.

    Where the motion is perpendicular to u, but for rounding, the phase is that of the long axis of the bin's own
    polarisation ellipse, half the angle of :math:`A \cdot A`, which no rotation changes either.

    References
    ----------
    .. [1] Landin et al. 2010, equation 3. doi:10.1007/978-3-642-14075-4_12

    Examples
    --------
    >>> u = np.array([1.0, -2.0, 0.5, 0.25])
    >>> np.round(dft321_principal([2 * u, -u, 2 * u], 1000) / 3, 12)
    array([ 1.  , -2.  ,  0.5 ,  0.25])
    """
    from scipy import fft

    admitted = admit(acceleration, rate_hz)
    n = admitted.samples.shape[-1]
    if n == 0:
        return np.zeros((*admitted.samples.shape[:-2], 0))
    onset, anchor = find_onset(admitted.samples)
    spectra = transform(admitted.samples)
    energy, covariance = measure(spectra)
    axis = start_axis(covariance, anchor, pull=PULL)
    axis = np.where(np.einsum("...i,...i->...", axis, onset)[..., None] < 0, -axis, axis)
    axis = tilt(axis, covariance, anchor)
    aligned = spectra[0]  # overwritten in place: memory of this size is slow to get
    for place in _places(spectra):
        aligned[..., place] = align([part[..., place] for part in spectra], energy[..., place], axis=axis)
    return admitted.restore(fft.irfft(aligned, n, overwrite_x=True))


def find_onset(samples: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Direction in which the motion begins: where it first comes near half of its largest excursion from the mean.

    Parameters
    ----------
    samples : ndarray, shape (..., 3, n_samples)
        The three axes, n_samples >= 1.

    Returns
    -------
    onset : ndarray of float64, shape (..., 3)
        Unit vectors, of the first sample that reaches half; the direction of the offset where there is nothing else,
        the sensor's diagonal for silence.
    anchor : ndarray of float64, shape (..., 3, 3)
        Mean product of such directions with themselves: a peak of about half the largest counts in part, so that
        noise, which lifts it above half or not, does not choose between it and the next.
    """
    mean = samples.mean(axis=-1, keepdims=True)
    size = _measure_excursion(samples, mean)
    largest = size.max(axis=-1, keepdims=True)
    first = np.argmax(size >= _ONSET**2 * largest, axis=-1)[..., None, None]
    onset = (np.take_along_axis(samples, first, axis=-1) - mean)[..., 0]
    offset = mean[..., 0]
    still = largest <= ROUNDING**2 * np.einsum("...i,...i->...", offset, offset)[..., None]
    onset = unit(np.where(still, offset, onset), np.full(offset.shape, 1 / np.sqrt(3)))
    maybe, surely = (np.argmax(size >= share**2 * largest, axis=-1) for share in (_MAYBE, _SURELY))
    there = slice(maybe.min(initial=size.shape[-1]), surely.max(initial=0) + 1)
    excursion, shares = samples[..., there] - mean, size[..., there] / np.where(still, 1.0, largest)
    excursion *= np.sqrt(_share_beginning(shares) / np.where(shares > 0, shares * largest, 1.0))[..., None, :]
    anchor = np.einsum("...in,...jn->...ij", excursion, excursion)
    return onset, np.where(still[..., None], onset[..., :, None] * onset[..., None, :], anchor)


def _measure_excursion(samples: NDArray[np.float64], mean: NDArray[np.float64]) -> NDArray[np.float64]:
    """Squared distance from the mean, sample by sample."""
    size = np.empty((*samples.shape[:-2], samples.shape[-1]))
    for start in range(0, samples.shape[-1], _AT_A_TIME):
        place = slice(start, start + _AT_A_TIME)
        excursion = samples[..., place] - mean
        np.square(excursion, out=excursion)
        np.sum(excursion, axis=-2, out=size[..., place])
    return size


def _share_beginning(shares: NDArray[np.float64]) -> NDArray[np.float64]:
    """Tell how much each sample is the beginning, from its share of the largest energy; they add up to 1."""
    chance = np.clip((shares - _MAYBE**2) / (_SURELY**2 - _MAYBE**2), 0.0, 1.0)
    not_yet = np.cumprod(1 - chance, axis=-1)
    chance[..., 1:] *= not_yet[..., :-1]
    return np.asarray(chance)


def measure(spectra: Spectra) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Sum the energies of the axes bin by bin, and tell their covariance by Parseval's theorem.

    Parameters
    ----------
    spectra : list of three ndarrays of complex128, shape (..., n_bins)
        One-sided spectra of the axes.

    Returns
    -------
    energy : ndarray of float64, shape (..., n_bins)
        Equation 3, squared.
    covariance : ndarray of float64, shape (..., 3, 3)
        Covariance up to a factor, the offset left out; 0 if only an offset's rounding is left.
    """
    energy = np.empty(spectra[0].shape)
    covariance = np.zeros((*energy.shape[:-1], 3, 3))
    for place in _places(spectra):
        parts = [spectrum[..., place] for spectrum in spectra]
        own = [bin_energy(part) for part in parts]
        vibration = slice(0 if place.start else 1, None)
        real = [part[..., vibration].view(np.float64) for part in parts]
        for i in range(3):
            covariance[..., i, i] += own[i][..., vibration].sum(axis=-1)
            covariance[..., i, i - 1] += np.einsum("...k,...k->...", real[i], real[i - 1])
        own[0] += own[1]
        np.add(own[0], own[2], out=energy[..., place])
    for i in range(3):
        covariance[..., i - 1, i] = covariance[..., i, i - 1]
    vibrates = np.trace(covariance, axis1=-2, axis2=-1) > ROUNDING**2 * energy[..., 0]
    return energy, covariance * vibrates[..., None, None]


def start_axis(covariance: NDArray[np.float64], anchor: NDArray[np.float64], *, pull: float) -> NDArray[np.float64]:
    """First principal axis, leaning a little towards the onset; its sign is left open.

    Parameters
    ----------
    covariance : ndarray, shape (..., 3, 3)
        Covariance of the axes, in any unit.
    anchor : ndarray, shape (..., 3, 3)
        Product of the onset with itself, or a mean of such products.
    pull : float
        Weight of the anchor, as a share of the motion's energy.

    Returns
    -------
    ndarray of float64, shape (..., 3)
        Unit vectors.
    """
    return leading_axis(_shares(covariance) + pull * anchor)


def tilt(
    axis: NDArray[np.float64], covariance: NDArray[np.float64], anchor: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Tilt axes so that they see weak directions too, by point 4 of the module's notes.

    Parameters
    ----------
    axis : ndarray, shape (..., 3)
        Unit vectors.
    covariance : ndarray, shape (..., 3, 3)
        Covariance of the axes, in any unit.
    anchor : ndarray, shape (..., 3, 3)
        As in `start_axis`.

    Returns
    -------
    ndarray of float64, shape (..., 3)
        Unit vectors.
    """
    onset = np.einsum("...ij,...j->...i", anchor, axis)
    aside = np.linalg.solve(_shares(covariance) + _WEAK * np.eye(3), onset[..., None])[..., 0]
    deviations = np.sqrt(np.einsum("...i,...i->...", aside, onset))[..., None]
    aside *= TILT / np.where(deviations > 0, deviations, 1.0)
    aside *= _FARTHEST / np.maximum(np.linalg.norm(aside, axis=-1, keepdims=True), _FARTHEST)
    return unit(axis + aside, axis)


def _shares(covariance: NDArray[np.float64]) -> NDArray[np.float64]:
    trace = np.trace(covariance, axis1=-2, axis2=-1)[..., None, None]
    return np.asarray(covariance / np.where(trace > 0, trace, 1.0))


def align(spectra: Spectra, energy: NDArray[np.float64], *, axis: NDArray[np.float64]) -> NDArray[np.complex128]:
    """Give bins the magnitude of equation 3 and the phase of the projection on an axis.

    Parameters
    ----------
    spectra : list of three ndarrays of complex128, shape (..., n_bins)
        Spectra of the axes.
    energy : ndarray, shape (..., n_bins)
        From `measure`.
    axis : ndarray, shape (..., 3)
        Unit vectors.

    Returns
    -------
    ndarray of complex128, shape (..., n_bins)
        The merged spectrum.
    """
    x, y, z = spectra
    aligned: NDArray[np.complex128] = x * axis[..., 0, None]
    aligned += y * axis[..., 1, None]
    aligned += z * axis[..., 2, None]
    projected = bin_energy(aligned)
    across = projected <= _ACROSS**2 * energy
    if across.any():
        polarised = np.sqrt((x[across] ** 2 + y[across] ** 2 + z[across] ** 2) * _CUT) / np.sqrt(_CUT)
        aligned[across] = np.where(polarised == 0, 1.0, polarised)
        projected[across] = bin_energy(aligned[across])
    np.divide(energy, projected, out=projected)
    np.sqrt(projected, out=projected)
    aligned *= projected
    return aligned


def _places(spectra: Spectra) -> Iterator[slice]:
    for start in range(0, spectra[0].shape[-1], _AT_A_TIME):
        yield slice(start, start + _AT_A_TIME)


def unit(vectors: NDArray[np.float64], otherwise: NDArray[np.float64]) -> NDArray[np.float64]:
    """Bring vectors to length 1, and take others where there is no direction.

    Parameters
    ----------
    vectors : ndarray, shape (..., 3)
        Any vectors.
    otherwise : ndarray, shape (..., 3)
        What stands in for those of length 0.

    Returns
    -------
    ndarray of float64, shape (..., 3)
        Unit vectors.
    """
    length = np.sqrt(np.einsum("...i,...i->...", vectors, vectors))[..., None]
    return np.asarray(np.where(length > 0, vectors / np.where(length > 0, length, 1.0), otherwise))
