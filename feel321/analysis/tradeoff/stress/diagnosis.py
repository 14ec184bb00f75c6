"""Why reducers fail: the reason of every failure; signs of it in a recording, and the scenes that it comes near.

Each sign is a function of a `Recording` that returns one number. Shares are of energy unless they say otherwise, 0 to
1. Windows are the paper's 35 ms, overlapping by half; where energy is compared between windows, it is about each
window's own mean.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING, Literal

import numpy as np

from feel321.analysis.tradeoff.stress.battery import BATTERY
from feel321.analysis.tradeoff.stress.measures import MEASURES, StressCell
from feel321.stimuli.reducers.axes import DEFAULT_WINDOW_S, window_samples
from feel321.types import Samples

if TYPE_CHECKING:
    from feel321.stimuli.recording import Recording

CANCELLED = 0.1
"""Where |sum of axes| is below this part of the root of the summed energies, noise meets a gain above 10."""

LEADING = 1 / 1.2
"""Ratio of the eigenvalues from which on the leading one stands less than 20 % above the second."""

SILENT_DB = -40.0
SLOW_HZ = 20.0
_CLIPPED_RUN = 3

NO_DECIMALS = 100
"""A gain from here on is written without decimals; two digits would need a power of ten."""


def undetermined_share(recording: Recording) -> float:
    r"""Share of the energy at which the phase of the axes' sum is undetermined.

    Notes
    -----
    .. math:: \sum_{f \in C} \sum_i |A_i|^2 \Big/ \sum_f \sum_i |A_i|^2, \qquad
        C = \{f : |\textstyle\sum_i A_i| < c \sqrt{\sum_i |A_i|^2}\}

    Noise of spectrum N on the axes turns the phase of the sum by up to \|N\| / \|sum\|, so that the gain of equation 4
    at that frequency is sqrt(sum of energies) / \|sum\| > 1 / c. Independent isotropic axes have a share of 0.7 % at
    c = 0.1.
    """
    spectra = np.fft.rfft(recording.acceleration)[:, 1:]
    energy = np.square(np.abs(spectra)).sum(axis=0)
    of_sum = np.square(np.abs(spectra.sum(axis=0)))
    return _share(energy[of_sum < CANCELLED**2 * energy].sum(), energy.sum())


def eigenvalue_ratio(recording: Recording) -> float:
    """Ratio of the second to the first eigenvalue of the covariance, λ₂ / λ₁."""
    return float(_ratios(_covariance(recording.acceleration)))


def ambiguous_windows(recording: Recording) -> float:
    """Share of the energy that lies in windows in which no direction leads clearly."""
    covariances = _covariance(_windows(recording))
    energy = np.trace(covariances, axis1=-2, axis2=-1)
    return _share(energy[_ratios(covariances) > LEADING].sum(), energy.sum())


def silent_axes(recording: Recording) -> float:
    """Count the axes that are at least 40 dB weaker than the strongest."""
    power = recording.acceleration.var(axis=-1)
    return float(np.count_nonzero(power <= 10 ** (SILENT_DB / 10) * power.max()))


def offset_share(recording: Recording) -> float:
    """Share of the energy that is offset."""
    samples = recording.acceleration
    return _share(np.square(samples.mean(axis=-1)).sum(), np.square(samples).mean(axis=-1).sum())


def slow_share(recording: Recording) -> float:
    """Share of the energy about the mean that is too slow to be felt as vibration."""
    samples = recording.acceleration - recording.acceleration.mean(axis=-1, keepdims=True)
    energy = np.square(np.abs(np.fft.rfft(samples))).sum(axis=0)
    frequency = np.fft.rfftfreq(recording.n_samples, 1 / recording.rate_hz)
    return _share(energy[frequency < SLOW_HZ].sum(), energy.sum())


def clipped_share(recording: Recording) -> float:
    """Share of the samples of the worst axis that lie in flat runs at its extremes."""
    shares = [0.0]
    for axis in recording.acceleration:
        extremes = (axis.min(), axis.max()) if np.ptp(axis) > 0 else ()
        flat = [np.r_[0, axis == extreme, 0] for extreme in extremes]
        runs = [np.flatnonzero(np.diff(one) < 0) - np.flatnonzero(np.diff(one) > 0) for one in flat]
        shares.append(sum(float(run[run >= _CLIPPED_RUN].sum()) / len(axis) for run in runs))
    return max(shares)


def step_over_rms(recording: Recording) -> float:
    """Smallest step between sample values over the RMS of the vibration, median over axes: how coarse they are."""
    steps = []
    for axis in recording.acceleration:
        if np.ptp(axis) > 0:
            # Values that differ by rounding only, as after a change of unit, are the same count of the sensor.
            apart = np.diff(np.unique(axis))
            steps.append(float(apart[apart > 1e-9 * np.ptp(axis)].min()) / axis.std())
    return float(np.median(steps)) if steps else 0.0


def held_share(recording: Recording) -> float:
    """Share of the samples that repeat the one before on all three axes, as filled gaps do."""
    same = np.all(np.diff(recording.acceleration) == 0, axis=0)
    return float(same.mean()) if same.size else 0.0


def crest_factor(recording: Recording) -> float:
    """Largest length of the acceleration over its RMS."""
    lengths = np.linalg.norm(recording.acceleration, axis=0)
    rms = float(np.sqrt(np.square(lengths).mean()))
    return float(lengths.max()) / rms if rms else 0.0


def tonal_share(recording: Recording) -> float:
    """Share of the energy within two frequency steps of the strongest frequency."""
    energy = np.square(np.abs(np.fft.rfft(recording.acceleration))).sum(axis=0)[1:]
    if not energy.size:
        return 0.0
    peak = int(np.argmax(energy))
    return _share(energy[max(0, peak - 2) : peak + 3].sum(), energy.sum())


def n_windows(recording: Recording) -> float:
    """Duration in windows."""
    return recording.duration_s / DEFAULT_WINDOW_S


def silence_share(recording: Recording) -> float:
    """Share of the windows that are at least 40 dB weaker than the strongest one."""
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


def _share(part: float, whole: float) -> float:
    return float(part / whole) if whole > 0 else 0.0


@dataclass(frozen=True, slots=True)
class Sign:
    """A number that is computed from a recording, and the limit beyond which reducers are at risk."""

    name: str
    title: str
    measure: Callable[[Recording], float]
    of: Literal["sensor", "felt"]
    limit: float
    kind: Literal["share", "number"]
    words: str
    sensitive: tuple[str, ...]
    below: bool = False

    def is_near(self, value: float) -> bool:
        """Whether a value is beyond the limit."""
        return value < self.limit if self.below else value > self.limit

    def format(self, value: float) -> str:
        """Write a value, such as "32 %"; below the smallest that is written out, "<0.01 %"."""
        factor, unit, smallest = (100.0, " %", 0.01) if self.kind == "share" else (1.0, "", 0.001)
        shown = factor * value
        return f"<{smallest:g}{unit}" if 0 < shown < smallest else f"{shown:.3g}{unit}"


SINGLE_AXES = tuple(
    f"sa{axis}321{form}" for form in ("", "_matched", "_matched_running") for axis in "xyz"
)
_FOURIER = ("dft321", "dft321_windowed")
_BY_SUM = (*_FOURIER, "dft321_filtered")
_PRINCIPAL = ("pca321", "pca321_adaptive", "pca321_matched", "pca321_matched_windowed")
_LEADING = (*_PRINCIPAL, "dft321_principal", "dft321_principal_windowed", "dft321_bands")
_IN_FRAMES = ("pca321_adaptive", "dft321_principal_windowed")
_SIGNS = (
    Sign("undetermined_share", "Energy of undetermined phase", undetermined_share, "felt", 0.02, "share",
         "{} of the energy sits where the phase is undetermined", _FOURIER),
    Sign("eigenvalue_ratio", "λ₂ / λ₁", eigenvalue_ratio, "felt", LEADING, "number",
         "the second principal axis holds {} times the energy of the first", _LEADING),
    Sign("ambiguous_windows", "Energy in windows without a leading axis", ambiguous_windows, "felt", 0.05,
         "share", "{} of the energy lies in windows in which no direction leads by 20 %", _IN_FRAMES),
    Sign("silent_axes", "Silent axes", silent_axes, "felt", 0.5, "number",
         "axes that are 40 dB below the strongest: {}", SINGLE_AXES),
    Sign("offset_share", "Energy in the offset", offset_share, "sensor", 0.5, "share",
         "{} of the sensor's energy is offset; without conditioning it passes for signal", ("mag321", "pca321")),
    Sign("slow_share", "Energy below 20 Hz", slow_share, "sensor", 0.2, "share",
         "{} of the energy about the mean is slower than 20 Hz; high-pass before reducing", _PRINCIPAL),
    Sign("clipped_share", "Clipped samples", clipped_share, "sensor", 0.001, "share",
         "{} of an axis's samples are clipped; directions and spectra of the peaks are artefacts", SINGLE_AXES),
    Sign("step_over_rms", "Sensor step / RMS", step_over_rms, "sensor", 0.25, "number",
         "the sensor's step is {} times the RMS of an axis; its noise counts as signal", ("mag321",)),
    Sign("held_share", "Repeated samples", held_share, "sensor", 0.01, "share",
         "{} of the samples repeat the one before on all axes, as filled gaps do", _FOURIER),
    Sign("crest_factor", "Peak / RMS", crest_factor, "felt", 12.0, "number",
         "the peak is {} times the RMS; a few moments determine axes and spectra", (*_FOURIER, *_LEADING)),
    Sign("tonal_share", "Energy in one tone", tonal_share, "felt", 0.8, "share",
         "{} of the energy is one tone; other bands are nearly empty and spectral match depends on them", ()),
    Sign("n_windows", "Duration in windows", n_windows, "felt", 10.0, "number",
         "it is only {} windows long, too short for spectra and axes to settle", (), below=True),
    Sign("silence_share", "Silent windows", silence_share, "felt", 0.3, "share",
         "{} of the windows are 40 dB below the loudest; there the axis is arbitrary", _IN_FRAMES),
)  # fmt: skip

SIGNS: Mapping[str, Sign] = MappingProxyType({sign.name: sign for sign in _SIGNS})
"""Name -> sign."""


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """The signs of a recording: name -> value."""

    recording: str
    figures: Mapping[str, float]

    @property
    def near_signs(self) -> tuple[Sign, ...]:
        """The signs that are beyond their limits."""
        return tuple(sign for sign in SIGNS.values() if sign.is_near(self.figures[sign.name]))

    @property
    def near_scenes(self) -> tuple[str, ...]:
        """The scenes of the battery that the recording comes near."""
        names = {sign.name for sign in self.near_signs}
        return tuple(scene.name for scene in BATTERY.values() if names.intersection(scene.signs))


def diagnose(recording: Recording, sensor: Recording | None = None) -> Diagnosis:
    """Compute the signs of a recording, conditioned, and of the same as it came from the sensor."""
    sources = {"felt": recording, "sensor": sensor or recording}
    values = {name: float(sign.measure(sources[sign.of])) for name, sign in SIGNS.items()}
    return Diagnosis(recording.name, values)


def list_warnings(diagnosis: Diagnosis, gains: Sequence[StressCell]) -> tuple[str, ...]:
    """Write a warning per sign that is beyond its limit, with the reducers that suffer from it."""
    own = {cell.reducer: cell.value for cell in gains if cell.recording == diagnosis.recording}
    lines = []
    for sign in diagnosis.near_signs:
        line = sign.words.format(sign.format(diagnosis.figures[sign.name]))
        touched = [name for name in sign.sensitive if own.get(name, 0) >= MEASURES["gain"].caution]
        shown = [
            f"{own[name]:.0f}" if own[name] >= NO_DECIMALS else f"{own[name]:.2g}"
            for name in touched
        ]
        named = zip(touched, shown, strict=True)
        suffering = ", ".join(f"{name} is sensitive here (gain {gain})" for name, gain in named)
        lines.append(": ".join(filter(None, (line, suffering))))
    return tuple(lines)


_AXES, _GAINED = SINGLE_AXES[:3], SINGLE_AXES[3:]
_PCA = ("pca321", "pca321_adaptive")
_PCA_MATCHED = ("pca321_matched", "pca321_matched_windowed")
_DFT_ALONG = ("dft321_principal", "dft321_principal_windowed")
_FRAMES = ("dft321_windowed", "dft321_principal_windowed")
_REASONS: Mapping[str, Mapping[str, tuple[str, ...]]] = MappingProxyType({
    "gain": {
        "it keeps one sensor axis; where that is (nearly) silent, the output is nothing but noise.": SINGLE_AXES,
        "the sum cancels; what is left of it is noise.": ("soc321",),
        "no direction leads, so the noise of the moment determines the axis, and with it a different motion.":
            (*_PCA, *_PCA_MATCHED),
        "the phase is that of x + y + z; where the axes cancel, noise sets it.": _FOURIER,
        "the waveform is that of x + y + z; where the axes cancel, noise sets it.": ("dft321_filtered",),
        "bands in which no direction leads take theirs from noise.": ("dft321_bands",),
        "the phase is that along the leading axis; where none leads, or little moves along it, noise sets it.":
            _DFT_ALONG,
        "the output depends on something that noise determines.": (),
    },
    "rotation": {
        "what it keeps depends on where the sensor's own axes point.": SINGLE_AXES,
        "x + y + z is the projection on the sensor's diagonal, whose direction is the mounting's.": ("soc321",),
        "equal eigenvalues: rounding chooses among equally good axes.": ("pca321", "pca321_matched"),
        "the spectrum stays, but the phase of x + y + z follows the sensor's diagonal.": _FOURIER,
        "the intensity stays, but x + y + z follows the sensor's diagonal.": ("dft321_filtered",),
        "the output depends on the sensor's axes.": (),
    },
    "flip": {
        "another sign of one axis is another sum: what added up now cancels.": ("soc321", *_BY_SUM),
        "the output depends on the signs of the sensor's axes.": (),
    },
    "shift": {
        "equal eigenvalues: rounding chooses among equally good axes.": ("pca321",),
        "frames cut the motion elsewhere, and each frame chooses anew.": ("pca321_adaptive", *_FRAMES),
        "where none leads the axis depends on what came first, and is held there.": ("pca321_matched_windowed",),
        "the output depends on where frames begin.": (),
    },
    "edge": {
        "rectifying turns an offset and a vibration into another envelope.": ("mag321",),
        "frames cut slow motion into steps; these leak into all frames.": _FRAMES,
        "the envelope of what it keeps is not that of the motion.": (),
    },
    "energy": {
        "it keeps one direction and drops the energy of the two others.": (*_AXES, *_PCA),
        "axes in phase add up to too much, axes in anti-phase cancel.": ("soc321",),
        "the length of the vector is mostly offset, which is not felt; its ripple is what remains.":
            ("mag321",),
        "within a frame slow motion is an offset, whose axes are merged like a vibration's.": _FRAMES,
        "the gain is at most 10: an axis with less than a hundredth of the energy stays weak.":
            (*_GAINED, "dft321_filtered"),
        "it does not keep the energy of all axes.": (),
    },
    "fault": {
        "the fault changes the phase of x + y + z at frequencies whose energy it spares.": _FOURIER,
        "it turns a fault of some samples into another output elsewhere too.": (),
    },
    "spread": {
        "the metrics of what it keeps change with the mounting; the paper's temporal match does so by itself.": (),
    },
})  # fmt: skip
"""Measure -> reason -> the reducers that fail for it; the last one is the reason of all others."""


def find_reason(measure: str, reducer: str) -> str:
    """Find why a reducer fails by a measure."""
    reasons = _REASONS[measure]
    return next((why for why, names in reasons.items() if reducer in names), [*reasons][-1])
