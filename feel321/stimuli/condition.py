"""Conditioning: steps applied to a recording before it is reduced, and to a stimulus before it is played.

Each step is named, optional, and recorded in the stimulus set's manifest. Filters are Butterworth, fourth order,
applied forwards and backwards (no phase shift, magnitude squared): at the corner frequency the gain is -6 dB.
"""

from dataclasses import dataclass, fields, replace
from typing import Annotated, Any, Literal

import numpy as np
from annotated_types import Interval

from feel321.stimuli.recording import Recording
from feel321.types import Samples

FILTER_ORDER = 4

Seconds = Annotated[float, Interval(ge=0, le=86400)]
Corner = Annotated[float, Interval(gt=0, le=1e9)]


@dataclass(frozen=True, slots=True)
class Conditioning:
    """Conditioning steps, applied in this order; frequencies in Hz, times in s; `[stimuli.conditioning]` of study.toml.

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

    Examples
    --------
    >>> from feel321 import stimuli
    >>> stimuli.Conditioning(crop_s=(0.5, 2.5), low_pass_hz=None).high_pass_hz
    20.0
    """

    crop_s: tuple[Seconds, Seconds] | None = None
    remove_offset: bool = True
    high_pass_hz: Corner | None = 20.0
    low_pass_hz: Corner | None = 1000.0

    def __post_init__(self) -> None:
        """Refuse corners and crops that make no sense."""
        make_plain(self)
        for name in ("high_pass_hz", "low_pass_hz"):
            corner = getattr(self, name)
            if corner is not None and not 0 < corner < np.inf:
                must = f"{name} must be a frequency above 0 Hz, or nothing for no filter"
                raise ValueError(f"{must}; got {corner}")
        if self.high_pass_hz and self.low_pass_hz and self.high_pass_hz >= self.low_pass_hz:
            got = f"got {self.high_pass_hz}"
            raise ValueError(f"high_pass_hz must be below low_pass_hz, {self.low_pass_hz}; {got}")
        crop = (0.0, 1.0) if self.crop_s is None else self.crop_s
        if np.shape(crop) != (2,) or not 0 <= crop[0] < crop[1] < np.inf:
            got = f"got {self.crop_s}"
            raise ValueError(f"crop_s must be (start, end) in s with 0 <= start < end, {got}")


def make_plain(settings: object) -> None:
    """Make Python's numbers of NumPy's in a frozen record of settings: JSON knows no others."""
    for entry in fields(settings):  # type: ignore[arg-type]  # any dataclass
        value = getattr(settings, entry.name)
        if isinstance(value, np.generic):
            object.__setattr__(settings, entry.name, value.item())


def condition(
    recording: Recording,
    steps: Conditioning | None = None,
    **changes: Any,  # noqa: ANN401 - Conditioning's fields
) -> Recording:
    """Condition a recording: crop, remove the offset, filter.

    Parameters
    ----------
    recording : Recording
        Acceleration in m/s².
    steps : Conditioning, optional
        Which steps; `Conditioning()` if left out.
    **changes
        Fields of the steps to change, as in ``crop_s=(0.2, 1.2)``.

    Returns
    -------
    Recording
        The conditioned recording, same rate and name, with a digest of its own.

    Raises
    ------
    ValueError
        If the crop reaches beyond the recording, a corner is above the Nyquist frequency, or the recording is too
        short to be filtered.

    Examples
    --------
    >>> from feel321 import stimuli
    >>> stimuli.condition(stimuli.make_scene("bumps"), crop_s=(0, 1))
    Recording('bumps', 10000 samples at 10000 Hz, 1 s)
    """
    steps, rate = replace(steps or Conditioning(), **changes), recording.rate_hz
    samples = (recording.crop(*steps.crop_s) if steps.crop_s else recording).acceleration
    if steps.remove_offset:
        samples = samples - samples.mean(axis=-1, keepdims=True)
    if (corner_hz := steps.high_pass_hz) is not None:
        samples = filter_zero_phase(samples, rate, corner_hz=corner_hz, kind="highpass")
    # A sensor whose Nyquist frequency is below the low-pass's corner has no signal there.
    if (corner_hz := steps.low_pass_hz) is not None and corner_hz < rate / 2:
        samples = filter_zero_phase(samples, rate, corner_hz=corner_hz, kind="lowpass")
    return replace(recording, acceleration=samples, sha256="")


def list_steps(steps: Conditioning, rate_hz: float) -> list[str]:
    """List the steps that a recording of a given rate really goes through, for the manifest.

    Examples
    --------
    >>> list_steps(Conditioning(), 1600.0)
    ['offset removed', 'high-pass 20 Hz', 'low-pass 1000 Hz left out: not below the Nyquist frequency of 800 Hz']
    """
    done = [f"cropped to {steps.crop_s[0]:g}..{steps.crop_s[1]:g} s"] if steps.crop_s else []
    if steps.remove_offset:
        done.append("offset removed")
    if steps.high_pass_hz is not None:
        done.append(f"high-pass {steps.high_pass_hz:g} Hz")
    if steps.low_pass_hz is not None:
        void = f" left out: not below the Nyquist frequency of {rate_hz / 2:g} Hz"
        in_vain = steps.low_pass_hz >= rate_hz / 2
        done.append(f"low-pass {steps.low_pass_hz:g} Hz" + (void if in_vain else ""))
    return done


def filter_zero_phase(
    samples: Samples, rate_hz: float, *, corner_hz: float, kind: Literal["highpass", "lowpass"]
) -> Samples:
    """Filter signals, (..., n_samples), forwards and backwards with a Butterworth filter of fourth order."""
    from scipy import signal

    if corner_hz >= rate_hz / 2:
        got = f"got {corner_hz} Hz"
        raise ValueError(f"{kind} must be below the Nyquist frequency of {rate_hz / 2:g} Hz, {got}")
    sections = signal.butter(FILTER_ORDER, corner_hz, btype=kind, fs=rate_hz, output="sos")
    # Padded by a period of the corner: the filter's start-up takes about that long to die out.
    padding = min(max(int(rate_hz / corner_hz), 3 * (2 * len(sections) + 1)), samples.shape[-1] - 1)
    if padding < 1:
        got = f"got {samples.shape[-1]}; switch the filter off"
        raise ValueError(f"{kind} needs 2 samples or more, {got}")
    return np.asarray(signal.sosfiltfilt(sections, samples, padlen=padding), dtype=np.float64)


def fade(samples: Samples, rate_hz: float, *, fade_s: float) -> Samples:
    """Fade signals, (..., n), in and out with raised cosines, so that they start and end in silence."""
    n = samples.shape[-1]
    if not 0 <= 2 * fade_s * rate_hz <= n:
        got = f"got {fade_s}"
        raise ValueError(f"fade_s must be 0 to {n / rate_hz / 2:.6g} s, half the signal; {got}")
    length = int(fade_s * rate_hz)
    ramp = 0.5 - 0.5 * np.cos(np.pi * (np.arange(length) + 0.5) / max(length, 1))
    faded = samples.copy()
    faded[..., :length] *= ramp
    faded[..., n - length :] *= ramp[::-1]
    return faded


def resample(samples: Samples, rate_hz: float, *, to_hz: float) -> Samples:
    """Resample signals, (..., n), with the SoX resampler (linear phase, band-limited; fractions of a Hz count)."""
    import soxr

    if rate_hz == to_hz:
        return samples
    rows = samples.reshape(-1, samples.shape[-1])
    channels = [soxr.resample(one, rate_hz, to_hz, quality="VHQ") for one in rows]
    return np.asarray(channels, dtype=np.float64).reshape(*samples.shape[:-1], -1)
