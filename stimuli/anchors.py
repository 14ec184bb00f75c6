"""Haptic anchors: stimuli that are meant to be rated badly, made for 20 to 1000 Hz.

Audio's anchors are low-passed at 3.5 and 7 kHz; below 1 kHz that is no change at all. Here the energy of the recording
is put where the recording has least of it: a hum of two just noticeable bands (22 %), one at the quietest frequency of
all, one at the quietest of those that are easily felt, half the energy in each:

- the *low* anchor is steady: wrong frequency, and nothing happens when the tool touches something;
- the *mid* anchor follows the recording's envelope: wrong frequency, but at the right times.

What correlates with an axis by chance is taken out, so the temporal match of both is 0. In a stimulus set they are
played at the sensation level of their recording, so that strength does not mark them. `inspection.check_stimuli`
refuses a set in which an anchor does not score below every test stimulus of its recording on both metrics.

References
----------
.. [1] ITU-R BS.1534-3, "Method for the subjective assessment of intermediate quality level of audio systems", 2015 (low
   and mid anchors).
.. [2] E. Muschter et al., "Perceptual quality assessment of compressed vibrotactile signals through comparative
   judgment", IEEE Transactions on Haptics 14(2), 2021 (hidden reference and anchors for vibrotactile signals).
   doi:10.1109/TOH.2021.3077191
"""

from __future__ import annotations

from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np

from stimuli.perception import acceleration_threshold
from stimuli.spectrum import LOWEST_HZ, WEBER_FRACTION, OriginalSpectrum

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from numpy.typing import NDArray

    from stimuli.recording import Recording

    Samples = NDArray[np.float64]

EASILY_FELT = 2.0
"""Acceleration thresholds up to this multiple of the lowest count as easily felt: up to 250 Hz."""

ENVELOPE_HZ = 50.0
"""Envelopes are followed up to this frequency: equal energy in shorter segments is hard to tell apart."""


def low_anchor(recording: Recording, rng: np.random.Generator) -> Samples:
    """Make a steady hum with the recording's energy, where the recording has least.

    Parameters
    ----------
    recording : Recording
        Conditioned recording.
    rng : numpy.random.Generator
        Source of the hum's noise.

    Returns
    -------
    ndarray of float64, shape (n_samples,)
        Acceleration in m/s².

    Raises
    ------
    ValueError
        If the recording is silent between 20 and 1000 Hz.
    """
    return _with_energy_of(recording, _hum(recording, rng))


def mid_anchor(recording: Recording, rng: np.random.Generator) -> Samples:
    """Make a hum as `low_anchor` does, with the recording's envelope.

    Parameters
    ----------
    recording : Recording
        Conditioned recording.
    rng : numpy.random.Generator
        Source of the hum's noise.

    Returns
    -------
    ndarray of float64, shape (n_samples,)
        Acceleration in m/s².

    Raises
    ------
    ValueError
        If the recording is silent between 20 and 1000 Hz.
    """
    return _with_energy_of(recording, _hum(recording, rng) * _envelope(recording))


ANCHORS: Mapping[str, Callable[[Recording, np.random.Generator], Samples]] = MappingProxyType(
    {"anchor_low": low_anchor, "anchor_mid": mid_anchor}
)
"""Name -> anchor; the names stand in the manifest's column `reducer`."""


def quietest_hz(recording: Recording) -> tuple[float, float]:
    """Frequencies at which a recording has least energy: of all that are felt, and of those that are easily felt.

    Parameters
    ----------
    recording : Recording
        Conditioned recording.

    Returns
    -------
    tuple of float
        Two frequencies in Hz, neither below the numerical floor; at the second the acceleration threshold is at most
        twice its minimum.

    Raises
    ------
    ValueError
        If the recording is silent between 20 and 1000 Hz.
    """
    original = OriginalSpectrum(recording.acceleration, recording.rate_hz)
    frequencies = original.frequencies_hz
    if not len(frequencies):
        raise ValueError(f"{recording.name!r} is silent between 20 and 1000 Hz: it can have no anchors; leave it out")
    inside = (frequencies >= LOWEST_HZ * (1 + WEBER_FRACTION)) & (frequencies * (1 + WEBER_FRACTION) <= frequencies[-1])
    easily_felt = acceleration_threshold(frequencies) <= EASILY_FELT * acceleration_threshold(LOWEST_HZ)
    return _quietest(original, inside), _quietest(original, inside & easily_felt)


def _quietest(original: OriginalSpectrum, allowed: NDArray[np.bool_]) -> float:
    allowed = allowed if allowed.any() else np.ones_like(allowed)
    return float(original.frequencies_hz[allowed][np.argmin(original.smoothed[allowed])])


def _hum(recording: Recording, rng: np.random.Generator) -> Samples:
    from scipy import fft

    n = recording.n_samples
    frequency = fft.rfftfreq(n, 1 / recording.rate_hz)
    hum = np.zeros(n)
    for centre in quietest_hz(recording):
        band = np.abs(frequency - centre) <= max(WEBER_FRACTION / 2 * centre, 0.5 * recording.rate_hz / n)
        # The phase of noise in the band, at a constant amplitude: peaks of noise would cost all stimuli their headroom.
        analytic = fft.ifft(np.pad(fft.rfft(rng.standard_normal(n)) * band, (0, n - len(frequency))))
        hum += analytic.real / np.abs(analytic)
    return hum


def _envelope(recording: Recording) -> Samples:
    """Root of the three axes' energy, smoothed over half a period of the highest envelope frequency."""
    from scipy.ndimage import gaussian_filter1d

    energy = np.einsum("in,in->n", recording.acceleration, recording.acceleration)
    smooth = gaussian_filter1d(energy, recording.rate_hz / (2 * np.pi * ENVELOPE_HZ), mode="nearest")
    return np.asarray(np.sqrt(np.maximum(smooth, 0.0)))


def _with_energy_of(recording: Recording, hum: Samples) -> Samples:
    """Take out what correlates with an axis, and give the hum the recording's energy."""
    axes = recording.acceleration
    # The normal equations of three unknowns; lstsq leaves silent axes alone, and the second pass removes the rounding.
    products = np.einsum("in,jn->ij", axes, axes)
    for _ in range(2):
        shares = np.linalg.lstsq(products, np.einsum("in,n->i", axes, hum), rcond=None)[0]
        hum = hum - np.einsum("i,in->n", shares, axes)
    return np.asarray(hum * np.sqrt(np.trace(products) / np.einsum("n,n->", hum, hum)))
