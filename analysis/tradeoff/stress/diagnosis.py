"""What in a recording makes methods fail: shares and ratios that need no reducer.

Conventions: functions take a `Recording` and give one number. Shares are of energy unless they say otherwise, 0 to 1.
Windows are the paper's 35 ms, overlapping by half; where energy is compared between windows, it is about each window's
own mean.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from stimuli.frames import DEFAULT_WINDOW_S, window_samples

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from stimuli.recording import Recording

    Samples = NDArray[np.float64]

CANCELLED = 0.1
"""Where |sum of axes| is below this part of the root of the summed energies, noise meets a gain above 10."""

LEADING = 1 / 1.2
"""Ratio of the eigenvalues from which on the leading one stands less than 20 % above the second."""

SILENT_DB = -40.0
SLOW_HZ = 20.0
_CLIPPED_RUN = 3


def undetermined_share(recording: Recording, *, cancelled: float = CANCELLED) -> float:
    r"""Tell which share of the energy sits where the phase of the axes' sum is undetermined.

    Parameters
    ----------
    recording : Recording
        The recording.
    cancelled : float
        How nearly the axes have to cancel.

    Returns
    -------
    float
        The share, over all frequencies but 0.

    Notes
    -----
    .. math:: \sum_{f \in C} \sum_i |A_i|^2 \Big/ \sum_f \sum_i |A_i|^2, \qquad
        C = \{f : |\textstyle\sum_i A_i| < c \sqrt{\sum_i |A_i|^2}\}

    Noise of spectrum N on the axes turns the phase of the sum by up to \|N\| / \|sum\|, so that the gain of equation 4
    at that frequency is sqrt(sum of energies) / \|sum\| > 1 / c. Independent isotropic axes have a share of 0.7 % at
    c = 0.1.

    Examples
    --------
    >>> from stimuli.recording import Recording
    >>> t = np.arange(1000) / 1000
    >>> low, high = np.sin(2 * np.pi * 50 * t), np.sin(2 * np.pi * 120 * t)
    >>> round(undetermined_share(Recording([low + high, low - high, 0 * t], 1000, "half")), 9)
    0.5
    """
    spectra = np.fft.rfft(recording.acceleration)[:, 1:]
    energy = np.square(np.abs(spectra)).sum(axis=0)
    of_sum = np.square(np.abs(spectra.sum(axis=0)))
    return _share(energy[of_sum < cancelled**2 * energy].sum(), energy.sum())


def eigenvalue_ratio(recording: Recording) -> float:
    """Tell how near the second principal axis comes to the first: λ₂ / λ₁ of the covariance.

    Parameters
    ----------
    recording : Recording
        The recording.

    Returns
    -------
    float
        0 (motion along one line) to 1 (no direction leads).

    Examples
    --------
    >>> from stimuli.recording import Recording
    >>> round(eigenvalue_ratio(Recording([[2, -2, 0, 0], [0, 0, 1, -1], [0, 0, 0, 0]], 1000, "cross")), 9)
    0.25
    """
    return float(_ratios(_covariance(recording.acceleration)))


def ambiguous_windows(recording: Recording, *, leading: float = LEADING) -> float:
    """Tell which share of the energy lies in windows in which no direction leads clearly.

    Parameters
    ----------
    recording : Recording
        The recording.
    leading : float
        λ₂ / λ₁ from which on a window counts.

    Returns
    -------
    float
        The share.
    """
    covariances = _covariance(_windows(recording))
    energy = np.trace(covariances, axis1=-2, axis2=-1)
    return _share(energy[_ratios(covariances) > leading].sum(), energy.sum())


def silent_axes(recording: Recording) -> float:
    """Count the axes that are more than 40 dB weaker than the strongest.

    Parameters
    ----------
    recording : Recording
        The recording.

    Returns
    -------
    float
        0 to 2; 3 for silence.

    Examples
    --------
    >>> from stimuli.recording import Recording
    >>> silent_axes(Recording([[1, -1], [0, 0], [0.001, -0.001]], 1000, "x"))
    2.0
    """
    power = recording.acceleration.var(axis=-1)
    return float(np.count_nonzero(power <= 10 ** (SILENT_DB / 10) * power.max()))


def offset_share(recording: Recording) -> float:
    """Tell which share of the energy is the offset.

    Parameters
    ----------
    recording : Recording
        As it came from the sensor: conditioning removes the offset.

    Returns
    -------
    float
        The share.

    Examples
    --------
    >>> from stimuli.recording import Recording
    >>> offset_share(Recording([[2, 0, 2, 0], [0, 0, 0, 0], [0, 0, 0, 0]], 1000, "x"))
    0.5
    """
    samples = recording.acceleration
    return _share(np.square(samples.mean(axis=-1)).sum(), np.square(samples).mean(axis=-1).sum())


def slow_share(recording: Recording, *, below_hz: float = SLOW_HZ) -> float:
    """Tell which share of the energy about the mean is slower than vibration is felt.

    Parameters
    ----------
    recording : Recording
        As it came from the sensor: conditioning removes slow motion.
    below_hz : float
        The lowest frequency of vibration, in Hz.

    Returns
    -------
    float
        The share.
    """
    samples = recording.acceleration - recording.acceleration.mean(axis=-1, keepdims=True)
    energy = np.square(np.abs(np.fft.rfft(samples))).sum(axis=0)
    frequency = np.fft.rfftfreq(recording.n_samples, 1 / recording.rate_hz)
    return _share(energy[frequency < below_hz].sum(), energy.sum())


def clipped_share(recording: Recording) -> float:
    """Tell which share of the samples lies in flat runs at an axis's extreme.

    Parameters
    ----------
    recording : Recording
        As it came from the sensor: filters round clipped peaks.

    Returns
    -------
    float
        Largest share of the three axes; a run counts from 3 equal samples on, on axes that move.

    Examples
    --------
    >>> from stimuli.recording import Recording
    >>> clipped_share(Recording([[0, 1, 1, 1, 0, -1, 0, 1], [0] * 8, [0] * 8], 1000, "x"))
    0.375
    """
    return max(_clipped_of(axis) for axis in recording.acceleration)


def step_over_rms(recording: Recording) -> float:
    """Tell how coarse the samples are: the smallest step between values over the RMS of the vibration.

    Parameters
    ----------
    recording : Recording
        As it came from the sensor: conditioning fills the steps.

    Returns
    -------
    float
        Median over the axes that move; the RMS is of the difference to the mean. White quantisation noise is 0.29 times
        that strong.

    Examples
    --------
    >>> from stimuli.recording import Recording
    >>> step_over_rms(Recording([[1, -1, 1, -1], [0, 0, 0, 0], [0, 0, 0, 0]], 1000, "x"))
    2.0
    """
    steps = [_step_of(axis) / axis.std() for axis in recording.acceleration if np.ptp(axis) > 0]
    return float(np.median(steps)) if steps else 0.0


def held_share(recording: Recording) -> float:
    """Tell which share of the samples repeats the one before on all three axes, as gaps that were filled do.

    Parameters
    ----------
    recording : Recording
        As it came from the sensor.

    Returns
    -------
    float
        The share of samples.

    Examples
    --------
    >>> from stimuli.recording import Recording
    >>> held_share(Recording([[1, 0, 0, 0, 2], [1, 0, 0, 0, 2], [1, 0, 0, 0, 2]], 1000, "gap"))
    0.5
    """
    same = np.all(np.diff(recording.acceleration) == 0, axis=0)
    return float(same.mean()) if same.size else 0.0


def crest_factor(recording: Recording) -> float:
    """Tell how spiky the motion is: its largest length over its RMS.

    Parameters
    ----------
    recording : Recording
        The recording.

    Returns
    -------
    float
        1 for a steady turn, sqrt(2) for a tone, far above 4 for taps; 0 for silence.
    """
    lengths = np.linalg.norm(recording.acceleration, axis=0)
    rms = float(np.sqrt(np.square(lengths).mean()))
    return float(lengths.max()) / rms if rms else 0.0


def tonal_share(recording: Recording) -> float:
    """Tell which share of the energy lies within two frequency steps of the strongest frequency.

    Parameters
    ----------
    recording : Recording
        The recording.

    Returns
    -------
    float
        The share, without the offset.
    """
    energy = np.square(np.abs(np.fft.rfft(recording.acceleration))).sum(axis=0)[1:]
    if not energy.size:
        return 0.0
    peak = int(np.argmax(energy))
    return _share(energy[max(0, peak - 2) : peak + 3].sum(), energy.sum())


def n_windows(recording: Recording) -> float:
    """Tell how many windows long a recording is.

    Parameters
    ----------
    recording : Recording
        The recording.

    Returns
    -------
    float
        Its duration in windows.
    """
    return recording.duration_s / DEFAULT_WINDOW_S


def silence_share(recording: Recording) -> float:
    """Tell which share of the windows is more than 40 dB weaker than the strongest window.

    Parameters
    ----------
    recording : Recording
        The recording.

    Returns
    -------
    float
        The share of windows.
    """
    power = np.trace(_covariance(_windows(recording)), axis1=-2, axis2=-1)
    return float(np.mean(power <= 10 ** (SILENT_DB / 10) * power.max()))


def _windows(recording: Recording) -> Samples:
    """Overlapping windows, shape (m, 3, length); a recording shorter than one is one."""
    length = min(window_samples(DEFAULT_WINDOW_S, recording.rate_hz), recording.n_samples)
    views = np.lib.stride_tricks.sliding_window_view(recording.acceleration, length, axis=-1)
    return np.moveaxis(views[:, :: max(1, length // 2)], 0, 1)


def _covariance(samples: Samples) -> Samples:
    centred = samples - samples.mean(axis=-1, keepdims=True)
    return np.asarray(np.einsum("...in,...jn->...ij", centred, centred) / samples.shape[-1])


def _ratios(covariances: Samples) -> Samples:
    values = np.maximum(np.linalg.eigvalsh(covariances), 0.0)
    first, second = values[..., 2], values[..., 1]
    return np.asarray(np.divide(second, first, out=np.zeros_like(first), where=first > 0))


def _clipped_of(axis: Samples) -> float:
    if np.ptp(axis) == 0:
        return 0.0
    share = 0.0
    for extreme in (axis.min(), axis.max()):
        flat = np.concatenate([[0], (axis == extreme).astype(np.int8), [0]])
        starts, ends = np.flatnonzero(np.diff(flat) == 1), np.flatnonzero(np.diff(flat) == -1)
        runs = ends - starts
        share += float(runs[runs >= _CLIPPED_RUN].sum()) / len(axis)
    return share


def _step_of(axis: Samples) -> float:
    values = np.unique(axis)
    # Values that differ by rounding only, as after a change of unit, are the same count of the sensor.
    steps = np.diff(values)
    return float(steps[steps > 1e-9 * np.ptp(axis)].min())


def _share(part: float, whole: float) -> float:
    return float(part / whole) if whole > 0 else 0.0
