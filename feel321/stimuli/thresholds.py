"""Detection thresholds of vibration by frequency, and how strong a vibration is felt.

Two threshold curves, by how the vibration reaches the skin. Both are for sinusoids; neither is a digitised table.

`contactor`: a model of a small contactor on the fingertip or palm. The Pacinian channel's displacement threshold is
U-shaped, falling by 12 dB per octave up to about 250 Hz and rising as steeply above, with a minimum near 0.1 µm [1]_
[2]_. In acceleration that is flat below about 200 Hz and rises by 24 dB per octave above 300 Hz.

`grasped_stylus`: a stylus held like a pen and vibrating along its length [3]_. Published in the text of that paper
(peak displacement, means of 10 people): 26 µm at 10 Hz, 8.5 µm at 20 Hz, a mean slope of -13 dB per octave from 10 to
160 Hz, and a minimum of 0.06 µm at 320 Hz; straight lines in dB over octaves join these points. The values were taken
from a published account of the paper, not from the paper itself. Above 320 Hz no value is given in words: there the
curve rises by 12 dB per octave, as the contactor's does. That part is an assumption.

Detection of brief vibration sums energy over about 200 ms [4]_, so the level of a stimulus is that of its loudest
200 ms: silence before and after changes nothing.

References
----------
.. [1] S. J. Bolanowski, G. A. Gescheider, R. T. Verrillo, C. M. Checkosky, "Four channels mediate the mechanical
   aspects of touch", JASA 84(5), 1988. doi:10.1121/1.397184
.. [2] R. T. Verrillo, "Effect of contactor area on the vibrotactile threshold", JASA 35(12), 1963.
   doi:10.1121/1.1918868
.. [3] A. Israr, S. Choi, H. Z. Tan, "Detection threshold and mechanical impedance of the hand in a pen-hold posture",
   IEEE/RSJ International Conference on Intelligent Robots and Systems, 2006, 472-477.
.. [4] R. T. Verrillo, "Temporal summation in vibrotactile sensitivity", JASA 37(5), 1965. doi:10.1121/1.1909458
"""

from collections.abc import Callable, Iterable

import numpy as np
from numpy.typing import ArrayLike

from feel321.arguments import Registry
from feel321.stimuli.match import HIGHEST_HZ, LOWEST_HZ
from feel321.stimuli.recording import Signal, as_samples
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


WINDOW_S = 0.2  # Energy is summed over this time

EDGE_OCTAVES = 0.5
"""In short windows the felt range ends gradually, or a brief vibration at 20 Hz would lose half its energy."""


def felt_level(
    signal: Signal, rate_hz: float | None = None, *, threshold: str = CONTACTOR
) -> float:
    """Compute the root mean square over the felt range, 20 to 1000 Hz, in units of the threshold; axes add by energy.

    Parameters
    ----------
    signal : Recording, Reduced, or array_like of shape (n_samples,) or (axes, n_samples)
        Acceleration in m/s²; plain samples need `rate_hz`.
    rate_hz : float, optional
        Sampling rate of plain samples in Hz.
    threshold : str
        Name of `THRESHOLDS`.

    Returns
    -------
    float
        Level of the whole signal as a multiple of the threshold's root mean square; 0 for silence. It is no dB:
        20 log10 of it is, and `sensation_level_db` gives that of the loudest 200 ms.

    Examples
    --------
    >>> from feel321 import stimuli
    >>> round(stimuli.felt_level(stimuli.make_scene("circular_motion")), 1)
    61.6
    """
    from scipy import fft

    acceleration, rate_hz = as_samples(signal, rate_hz)
    n = acceleration.shape[-1]
    # Silence at the end adds no energy, and lengths with large prime factors cost ten times as much.
    padded = fft.next_fast_len(n, real=True)
    frequency = fft.rfftfreq(padded, 1 / rate_hz)
    weighted = np.abs(fft.rfft(acceleration, padded)) * _weigh(frequency, threshold=threshold)
    # One-sided bins stand for two, but for one at the Nyquist frequency.
    shares = np.where(2 * frequency < rate_hz * (1 - 1e-12), 2.0, 1.0)
    return float(np.sqrt(np.sum(shares * weighted**2) / n / padded))


def loudest_levels(
    acceleration: Samples, rate_hz: float, thresholds: Iterable[str] = (CONTACTOR,),
    *, shift_db: Callable[[Samples], Samples] | None = None,
) -> dict[str, float]:  # fmt: skip
    """Largest root mean square in any 200 ms, 20 to 1000 Hz, as a multiple of each threshold; axes add by energy.

    shift_db: how far a person's own threshold lies above each of these, by frequency in Hz.

    Before and after the signal is silence, so that appending some changes nothing, and a signal shorter than 200 ms
    has the level that its energy gives over 200 ms.
    """
    from scipy import fft

    window = max(round(WINDOW_S * rate_hz), 1)
    padded = fft.next_fast_len(acceleration.shape[-1] + window, real=True)
    frequency = fft.rfftfreq(padded, 1 / rate_hz)
    # Far above the edge there is nothing to weigh; most bins of a rig's rate are there.
    felt = slice(np.searchsorted(frequency, 2 * HIGHEST_HZ))
    spectrum = fft.rfft(acceleration, padded)[..., felt]
    levels, summed = {}, np.zeros(padded + 1)
    for name in thresholds:
        weights = _weigh(frequency[felt], threshold=name, edge_octaves=EDGE_OCTAVES)
        if shift_db is not None:
            weights[1:] *= 10 ** (-shift_db(frequency[felt][1:]) / 20)  # nothing is felt at 0 Hz
        # In place: fresh memory of this size takes as long as the arithmetic.
        weighted = np.atleast_2d(fft.irfft(spectrum * weights, padded))
        np.square(weighted, out=weighted)
        energy = weighted[0] if len(weighted) == 1 else weighted.sum(axis=0)
        np.cumsum(energy, out=summed[1:])
        inside = np.subtract(summed[window:], summed[:-window], out=energy[window - 1 :])
        most = max(inside.max(), 0.0)
        levels[name] = float(np.sqrt(most / window))
    return levels


def sensation_level_db(
    signal: Signal, rate_hz: float | None = None, *, threshold: str = CONTACTOR
) -> float:
    """Compute the sensation level: the level over the detection threshold of the loudest 200 ms.

    Parameters
    ----------
    signal : Recording, Reduced, or array_like of shape (n_samples,) or (axes, n_samples)
        Acceleration at the hand in m/s², as it is played; plain samples need `rate_hz`.
    rate_hz : float, optional
        Sampling rate of plain samples in Hz.
    threshold : str
        Name of `THRESHOLDS`: `"contactor"` or `"grasped_stylus"`.

    Returns
    -------
    float
        dB over the threshold: of the 200 ms with the largest root mean square over the threshold, between 20 and 1000
        Hz; axes add by energy. 0 for a lasting sinusoid at its threshold, minus infinity for silence.

    Notes
    -----
    Energy is summed over about 200 ms [1]_, and over frequencies as multiples of each frequency's threshold.

    References
    ----------
    .. [1] R. T. Verrillo, "Temporal summation in vibrotactile sensitivity", JASA 37(5), 1965. doi:10.1121/1.1909458

    Examples
    --------
    >>> import numpy as np
    >>> from feel321 import stimuli
    >>> time_s = np.arange(8000) / 8000
    >>> tone = 10 * stimuli.acceleration_threshold(250.0) * np.sin(2 * np.pi * 250 * time_s)
    >>> round(stimuli.sensation_level_db(tone, 8000.0))
    20
    """
    samples, rate = as_samples(signal, rate_hz)
    return to_db(loudest_levels(samples, rate, [threshold])[threshold])


def to_db(level: float) -> float:
    """Ratio of amplitudes in dB; minus infinity for 0."""
    return 20 * float(np.log10(level)) if level > 0 else -np.inf


def _weigh(frequency_hz: Samples, *, threshold: str, edge_octaves: float = 0.0) -> Samples:
    """Weight of each frequency: the threshold's RMS inverted from 20 to 1000 Hz, falling to 0 over the edges beyond."""
    weights = np.zeros_like(frequency_hz)
    beyond = np.full_like(frequency_hz, np.inf)
    above = frequency_hz > 0
    own = frequency_hz[above]
    beyond[above] = np.maximum(np.log2(LOWEST_HZ / own), np.log2(own / HIGHEST_HZ))
    felt = beyond <= edge_octaves * (1 - 1e-12)
    weights[felt] = np.sqrt(2) / acceleration_threshold(frequency_hz[felt], threshold=threshold)
    if edge_octaves:
        weights[felt] *= np.cos(np.pi / 2 * np.maximum(beyond[felt], 0.0) / edge_octaves)
    return weights
