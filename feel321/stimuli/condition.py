"""Conditioning: what is done to a recording before it is reduced, and to a stimulus before it is played.

Each step is named, optional, and recorded in the stimulus set's manifest. Filters are Butterworth, fourth order,
applied forwards and backwards (no phase shift, magnitude squared): at the corner frequency the gain is -6 dB.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from feel321.stimuli.recording import Recording

FILTER_ORDER = 4


@dataclass(frozen=True, slots=True)
class Conditioning:
    """Which steps a recording goes through, in this order; frequencies in Hz, times in s.

    Parameters
    ----------
    crop_s : tuple of float, optional
        Start and end of the part that is kept.
    remove_offset : bool
        Subtract each axis's mean.
    high_pass_hz : float, optional
        Corner below which motion is not felt as vibration.
    low_pass_hz : float, optional
        Corner above which vibration is not felt; left out where it is not below the Nyquist frequency.

    Raises
    ------
    ValueError
        If a corner is not above 0, the corners are in the wrong order, or the crop is not a forward interval.
    """

    crop_s: tuple[float, float] | None = None
    remove_offset: bool = True
    high_pass_hz: float | None = 20.0
    low_pass_hz: float | None = 1000.0

    def __post_init__(self) -> None:
        """Refuse corners and crops that make no sense."""
        for name in ("high_pass_hz", "low_pass_hz"):
            corner = getattr(self, name)
            if corner is not None and not 0 < corner < np.inf:
                raise ValueError(
                    f"{name}: got {corner}, allowed is a frequency above 0 Hz, or nothing for no filter"
                )
        if self.high_pass_hz and self.low_pass_hz and self.high_pass_hz >= self.low_pass_hz:
            raise ValueError(
                f"high_pass_hz: got {self.high_pass_hz}, allowed is below low_pass_hz, {self.low_pass_hz}"
            )
        crop = (0.0, 1.0) if self.crop_s is None else self.crop_s
        if len(crop) != len(("start", "end")) or not 0 <= crop[0] < crop[1] < np.inf:
            raise ValueError(
                f"crop_s: got {self.crop_s}, allowed is (start, end) in s with 0 <= start < end"
            )


def condition(recording: Recording, steps: Conditioning) -> Recording:
    """Put a recording through the named steps.

    Parameters
    ----------
    recording : Recording
        Acceleration in m/s².
    steps : Conditioning
        Which steps.

    Returns
    -------
    Recording
        The conditioned recording, same rate and name, with a digest of its own.

    Raises
    ------
    ValueError
        If the crop reaches beyond the recording, a corner is above the Nyquist frequency, or the recording is too
        short to be filtered.
    """
    samples = _cropped(recording, steps.crop_s)
    if steps.remove_offset:
        samples = samples - samples.mean(axis=-1, keepdims=True)
    if steps.high_pass_hz is not None:
        samples = filter_zero_phase(
            samples, recording.rate_hz, corner_hz=steps.high_pass_hz, kind="highpass"
        )
    if steps.low_pass_hz is not None and _has_low_pass(steps, recording.rate_hz):
        samples = filter_zero_phase(
            samples, recording.rate_hz, corner_hz=steps.low_pass_hz, kind="lowpass"
        )
    return replace(recording, acceleration=samples, sha256="")


def list_steps(steps: Conditioning, rate_hz: float) -> list[str]:
    """Name the steps that a recording of a given rate really goes through, for the manifest.

    Examples
    --------
    >>> list_steps(Conditioning(), 1600.0)
    ['offset removed', 'high-pass 20 Hz', 'low-pass 1000 Hz left out: not below the Nyquist frequency of 800 Hz']
    """
    done = (
        [] if steps.crop_s is None else [f"cropped to {steps.crop_s[0]:g}..{steps.crop_s[1]:g} s"]
    )
    if steps.remove_offset:
        done.append("offset removed")
    if steps.high_pass_hz is not None:
        done.append(f"high-pass {steps.high_pass_hz:g} Hz")
    if steps.low_pass_hz is not None:
        void = f" left out: not below the Nyquist frequency of {rate_hz / 2:g} Hz"
        done.append(
            f"low-pass {steps.low_pass_hz:g} Hz" + ("" if _has_low_pass(steps, rate_hz) else void)
        )
    return done


def _has_low_pass(steps: Conditioning, rate_hz: float) -> bool:
    """Whether there is anything to remove: a sensor whose Nyquist frequency is below the corner has nothing there."""
    return steps.low_pass_hz is not None and steps.low_pass_hz < rate_hz / 2


def filter_zero_phase(
    samples: NDArray[np.float64],
    rate_hz: float,
    *,
    corner_hz: float,
    kind: Literal["highpass", "lowpass"],
) -> NDArray[np.float64]:
    """Filter forwards and backwards with a Butterworth filter of fourth order.

    samples: (..., n_samples); returns (..., n_samples).
    """
    from scipy import signal

    if corner_hz >= rate_hz / 2:
        raise ValueError(
            f"{kind}: got {corner_hz} Hz, allowed is below the Nyquist frequency of {rate_hz / 2:g} Hz"
        )
    sections = signal.butter(FILTER_ORDER, corner_hz, btype=kind, fs=rate_hz, output="sos")
    # The filter's start-up dies out in about a period of its corner; padding by that much keeps it out of the signal.
    padding = min(max(int(rate_hz / corner_hz), 3 * (2 * len(sections) + 1)), samples.shape[-1] - 1)
    if padding < 1:
        raise ValueError(
            f"{kind}: got {samples.shape[-1]} samples, allowed is 2 or more; switch the filter off"
        )
    return np.asarray(signal.sosfiltfilt(sections, samples, padlen=padding), dtype=np.float64)


def fade(samples: NDArray[np.float64], rate_hz: float, *, fade_s: float) -> NDArray[np.float64]:
    """Fade a signal in and out with raised cosines, so that it starts and ends in silence.

    Parameters
    ----------
    samples : ndarray, shape (..., n_samples)
        Signals.
    rate_hz : float
        Sampling rate in Hz.
    fade_s : float
        Duration of each fade in s, at most half the signal; 0 for none.

    Returns
    -------
    ndarray of float64, shape (..., n_samples)
        Faded signals.

    Raises
    ------
    ValueError
        If the fades are negative or longer than the signal.
    """
    n = samples.shape[-1]
    if not 0 <= 2 * fade_s * rate_hz <= n:
        raise ValueError(
            f"fade_s: got {fade_s}, allowed is 0 to {n / rate_hz / 2:.6g} s, half the signal"
        )
    length = int(fade_s * rate_hz)
    ramp = 0.5 - 0.5 * np.cos(np.pi * (np.arange(length) + 0.5) / max(length, 1))
    faded = samples.copy()
    faded[..., :length] *= ramp
    faded[..., n - length :] *= ramp[::-1]
    return faded


def resample(samples: NDArray[np.float64], rate_hz: float, *, to_hz: float) -> NDArray[np.float64]:
    """Resample with the SoX resampler (linear phase, band-limited).

    Parameters
    ----------
    samples : ndarray, shape (..., n_samples)
        Signals.
    rate_hz : float
        Their sampling rate in Hz; fractions of a Hz are honoured.
    to_hz : float
        Wanted rate in Hz.

    Returns
    -------
    ndarray of float64, shape (..., m_samples)
        Resampled signals.
    """
    import soxr

    if rate_hz == to_hz:
        return samples
    channels = [
        soxr.resample(one, rate_hz, to_hz, quality="VHQ")
        for one in samples.reshape(-1, samples.shape[-1])
    ]
    return np.asarray(channels, dtype=np.float64).reshape(*samples.shape[:-1], -1)


def _cropped(recording: Recording, crop_s: tuple[float, float] | None) -> NDArray[np.float64]:
    if crop_s is None:
        return recording.acceleration
    if crop_s[1] > recording.duration_s * (1 + 1e-9):
        raise ValueError(
            f"crop_s: got {crop_s}, allowed for {recording.name!r} is up to {recording.duration_s:.4f} s, its duration"
        )
    start, end = (round(time * recording.rate_hz) for time in crop_s)
    if end <= start:
        raise ValueError(
            f"crop_s: got {crop_s}, which holds no sample at {recording.rate_hz:g} Hz; keep a longer part"
        )
    return recording.acceleration[:, start:end]
