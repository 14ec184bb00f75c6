"""Signals that are stressed: what the battery's scenes are made of, and the strongest part of a recording."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from stimuli.frames import DEFAULT_WINDOW_S, window_samples
from stimuli.recording import Recording

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Samples = NDArray[np.float64]

RATE_HZ = 4000.0
N_SAMPLES = 4000
"""One second; a length that is fast to transform."""

WINDOW = window_samples(DEFAULT_WINDOW_S, RATE_HZ)
TIME_S = np.arange(N_SAMPLES) / RATE_HZ


def make_texture(rng: np.random.Generator, axes: int = 1, *, low_hz: float = 40.0, high_hz: float = 400.0) -> Samples:
    """Make independent noise of standard deviation 1, as a rough surface makes it.

    Parameters
    ----------
    rng : numpy.random.Generator
        Source of randomness.
    axes : int
        How many.
    low_hz, high_hz : float
        Where the band begins and ends, smoothly, in Hz.

    Returns
    -------
    ndarray of float64, shape (axes, 4000)
        One second at 4 kHz.

    Examples
    --------
    >>> make_texture(np.random.default_rng(0), 2).std(axis=-1).round(9)
    array([1., 1.])
    """
    frequency = np.fft.rfftfreq(N_SAMPLES, 1 / RATE_HZ)
    shape = frequency**2 / (frequency**2 + low_hz**2) / (1 + (frequency / high_hz) ** 4)
    noise = np.fft.irfft(np.fft.rfft(rng.standard_normal((axes, N_SAMPLES))) * shape, N_SAMPLES)
    return np.asarray(noise / noise.std(axis=-1, keepdims=True))


def make_tap(start: int, *, frequency_hz: float = 210.0, decay_s: float = 0.004) -> Samples:
    """Make a tap: nothing, then a decaying sinusoid.

    Parameters
    ----------
    start : int
        Sample at which it begins.
    frequency_hz : float
        Of the tool's mode, in Hz.
    decay_s : float
        In which it falls to 1/e.

    Returns
    -------
    ndarray of float64, shape (4000,)
        One second at 4 kHz.
    """
    lag = np.maximum(np.arange(N_SAMPLES) - start, 0) / RATE_HZ
    return np.asarray(np.sin(2 * np.pi * frequency_hz * lag) * np.exp(-lag / decay_s))


def whiten(axes: Samples) -> Samples:
    """Make the axes' covariance exactly the identity.

    Parameters
    ----------
    axes : ndarray, shape (3, n)
        Any signals that are not copies of each other.

    Returns
    -------
    ndarray of float64, shape (3, n)
        No offset, standard deviation 1, no correlation.

    Examples
    --------
    >>> white = whiten(np.random.default_rng(0).standard_normal((3, 100)))
    >>> bool(np.allclose(white @ white.T / 100, np.eye(3)))
    True
    """
    centred = axes - axes.mean(axis=-1, keepdims=True)
    factor = np.linalg.cholesky(centred @ centred.T / axes.shape[-1])
    return np.asarray(np.linalg.solve(factor, centred))


def take_excerpt(recording: Recording, *, duration_s: float) -> Recording:
    """Take the strongest part of a recording.

    Parameters
    ----------
    recording : Recording
        The recording.
    duration_s : float
        How long, in s.

    Returns
    -------
    Recording
        The part with most energy, of a length that is fast to transform; the whole one if it is shorter.

    Examples
    --------
    >>> from analysis.tradeoff.stress.battery import BATTERY
    >>> take_excerpt(BATTERY["circular"].make(0), duration_s=0.1).n_samples
    400
    """
    from scipy.fft import prev_fast_len

    length = prev_fast_len(max(1, round(duration_s * recording.rate_hz)))
    if recording.n_samples <= length:
        return recording
    energy = np.cumsum(np.square(recording.acceleration).sum(axis=0))
    start = int(np.argmax(energy[length - 1 :] - np.concatenate([[0.0], energy[:-length]])))
    return Recording(recording.acceleration[:, start : start + length], recording.rate_hz, recording.name)
