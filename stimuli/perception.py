"""What the hand feels of a vibration: detection thresholds by frequency, and levels over them.

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

from __future__ import annotations

from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np

from stimuli.spectrum import HIGHEST_HZ, LOWEST_HZ

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from numpy.typing import ArrayLike, NDArray

MOST_SENSITIVE_HZ = 250.0
LEAST_DISPLACEMENT_M = 1e-7

STYLUS_HZ = (10.0, 20.0, 160.0, 320.0)
STYLUS_M = (26e-6, 8.5e-6, 26e-6 * 10 ** (-13 * 4 / 20), 0.06e-6)
"""Corners of the stylus's curve; the third is four octaves of the mean slope below the first."""

WINDOW_S = 0.2
"""Energy is summed over this time."""

EDGE_OCTAVES = 0.5
"""In short windows the felt range ends gradually, or a brief vibration at 20 Hz would lose half its energy."""


def _contactor(frequency_hz: NDArray[np.float64]) -> NDArray[np.float64]:
    ratio = frequency_hz / MOST_SENSITIVE_HZ
    return np.asarray(LEAST_DISPLACEMENT_M * (ratio**-2 + ratio**2) / 2)


def _grasped_stylus(frequency_hz: NDArray[np.float64]) -> NDArray[np.float64]:
    """Join the corners by straight lines in dB over octaves; -12 dB per octave below the first, +12 above the last."""
    ends = (STYLUS_HZ[0] / 1000, *STYLUS_HZ, STYLUS_HZ[-1] * 1000)
    levels = (STYLUS_M[0] * 1000**2, *STYLUS_M, STYLUS_M[-1] * 1000**2)
    return np.asarray(np.exp(np.interp(np.log(frequency_hz), np.log(ends), np.log(levels))))


THRESHOLDS: Mapping[str, Callable[[NDArray[np.float64]], NDArray[np.float64]]] = MappingProxyType(
    {"contactor": _contactor, "grasped_stylus": _grasped_stylus}
)
"""Name of a detection threshold curve -> peak displacement in m by frequency in Hz: the only list of names."""

CONTACTOR = "contactor"


def displacement_threshold(frequency_hz: ArrayLike, *, threshold: str = CONTACTOR) -> NDArray[np.float64]:
    """Smallest displacement felt, by frequency.

    Parameters
    ----------
    frequency_hz : array_like
        Frequencies in Hz, above 0.
    threshold : str
        Name of `THRESHOLDS`.

    Returns
    -------
    ndarray of float64
        Peak displacement in m.

    Examples
    --------
    >>> float(displacement_threshold(250.0))
    1e-07
    """
    return THRESHOLDS[check_threshold(threshold)](np.asarray(frequency_hz, dtype=np.float64))


def acceleration_threshold(frequency_hz: ArrayLike, *, threshold: str = CONTACTOR) -> NDArray[np.float64]:
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

    Raises
    ------
    ValueError
        If there is no such curve.
    """
    frequency = np.asarray(frequency_hz, dtype=np.float64)
    return (2 * np.pi * frequency) ** 2 * displacement_threshold(frequency, threshold=threshold)


def check_threshold(name: str) -> str:
    """Refuse a name that is not one of `THRESHOLDS`.

    Parameters
    ----------
    name : str
        The name.

    Returns
    -------
    str
        The same.
    """
    if name not in THRESHOLDS:
        raise ValueError(f"threshold: got {name!r}, allowed is one of {', '.join(THRESHOLDS)}")
    return name


def felt_level(acceleration: NDArray[np.float64], rate_hz: float, *, threshold: str = CONTACTOR) -> float:
    """Root mean square over the felt range, 20 to 1000 Hz, in units of the threshold; axes add by energy.

    Parameters
    ----------
    acceleration : ndarray, shape (n_samples,) or (axes, n_samples)
        Acceleration in m/s².
    rate_hz : float
        Sampling rate in Hz.
    threshold : str
        Name of `THRESHOLDS`.

    Returns
    -------
    float
        Level of the whole signal as a multiple of the threshold's root mean square; 0 for silence.
    """
    from scipy import fft

    n = acceleration.shape[-1]
    # Silence at the end adds no energy, and lengths with large prime factors cost ten times as much.
    padded = fft.next_fast_len(n, real=True)
    frequency = fft.rfftfreq(padded, 1 / rate_hz)
    weighted = np.abs(fft.rfft(acceleration, padded)) * _weigh(frequency, threshold=threshold)
    # One-sided bins stand for two, but for one at the Nyquist frequency.
    shares = np.where(2 * frequency < rate_hz * (1 - 1e-12), 2.0, 1.0)
    return float(np.sqrt(np.sum(shares * weighted**2) / n / padded))


def loudest_level(acceleration: NDArray[np.float64], rate_hz: float, *, threshold: str = CONTACTOR) -> float:
    """Largest root mean square in any 200 ms, 20 to 1000 Hz, as a multiple of the threshold's; axes add by energy.

    Before and after the signal is silence, so that appending some changes nothing, and a signal shorter than 200 ms
    has the level that its energy gives over 200 ms.

    Parameters
    ----------
    acceleration : ndarray, shape (n_samples,) or (axes, n_samples)
        Acceleration in m/s².
    rate_hz : float
        Sampling rate in Hz.
    threshold : str
        Name of `THRESHOLDS`.

    Returns
    -------
    float
        Multiple of the threshold; 0 for silence.
    """
    from scipy import fft

    window = max(round(WINDOW_S * rate_hz), 1)
    padded = fft.next_fast_len(acceleration.shape[-1] + window, real=True)
    frequency = fft.rfftfreq(padded, 1 / rate_hz)
    weighted = fft.rfft(acceleration, padded)
    weighted *= _weigh(frequency, threshold=threshold, edge_octaves=EDGE_OCTAVES)
    energy = np.square(np.atleast_2d(fft.irfft(weighted, padded))).sum(axis=0)
    summed = np.concatenate([[0.0], np.cumsum(energy)])
    return float(np.sqrt(max((summed[window:] - summed[:-window]).max(), 0.0) / window))


def sensation_level_db(acceleration: NDArray[np.float64], rate_hz: float, *, threshold: str = CONTACTOR) -> float:
    """Level over the detection threshold, as it is felt where it is loudest.

    Parameters
    ----------
    acceleration : ndarray, shape (n_samples,) or (axes, n_samples)
        Acceleration at the hand in m/s², as it is played.
    rate_hz : float
        Sampling rate in Hz.
    threshold : str
        Name of `THRESHOLDS`: `"contactor"` or `"grasped_stylus"`.

    Returns
    -------
    float
        dB over the threshold: of the 200 ms with the largest root mean square over the threshold, between 20 and 1000
        Hz; axes add by energy. 0 for a lasting sinusoid at its threshold, minus infinity for silence.

    Raises
    ------
    ValueError
        If there is no such curve.

    Notes
    -----
    Energy is summed over about 200 ms [1]_, and over frequencies as multiples of each frequency's threshold.

    References
    ----------
    .. [1] R. T. Verrillo, "Temporal summation in vibrotactile sensitivity", JASA 37(5), 1965. doi:10.1121/1.1909458

    Examples
    --------
    >>> time_s = np.arange(8000) / 8000
    >>> tone = 10 * acceleration_threshold(250.0) * np.sin(2 * np.pi * 250 * time_s)
    >>> round(sensation_level_db(tone, 8000.0))
    20
    """
    return to_db(loudest_level(acceleration, rate_hz, threshold=threshold))


def to_db(level: float) -> float:
    """Give a ratio of amplitudes in dB; minus infinity for 0.

    Parameters
    ----------
    level : float
        The ratio.

    Returns
    -------
    float
        20 log10 of it.
    """
    return 20 * float(np.log10(level)) if level > 0 else -np.inf


def _weigh(
    frequency_hz: NDArray[np.float64], *, threshold: str, edge_octaves: float = 0.0
) -> NDArray[np.float64]:
    """Weight of each frequency: the threshold's RMS inverted from 20 to 1000 Hz, falling to 0 over the edges beyond."""
    weights = np.zeros_like(frequency_hz)
    beyond = np.full_like(frequency_hz, np.inf)
    above = frequency_hz > 0
    beyond[above] = np.maximum(np.log2(LOWEST_HZ / frequency_hz[above]), np.log2(frequency_hz[above] / HIGHEST_HZ))
    felt = beyond <= edge_octaves * (1 - 1e-12)
    weights[felt] = np.sqrt(2) / acceleration_threshold(frequency_hz[felt], threshold=threshold)
    if edge_octaves:
        weights[felt] *= np.cos(np.pi / 2 * np.maximum(beyond[felt], 0.0) / edge_octaves)
    return weights
