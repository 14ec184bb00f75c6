"""SIGNS: by what a real recording is recognised that comes near a scene of the battery."""

from __future__ import annotations

from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING, Literal

from analysis.tradeoff.stress import diagnosis
from analysis.tradeoff.stress.battery import BATTERY
from analysis.tradeoff.stress.limits import MEASURES

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from analysis.tradeoff.stress.cells import Cell
    from stimuli.recording import Recording

SAY = MappingProxyType({"share": (100.0, " %", 0.01), "number": (1.0, "", 0.001)})
"""Kind -> factor, unit, and the smallest figure that is written out."""


@dataclass(frozen=True, slots=True)
class Sign:
    """A figure of a recording, and from where on it foretells trouble.

    Parameters
    ----------
    name : str
        Key in `SIGNS`.
    title : str
        For tables.
    measure : callable
        One of `diagnosis`.
    of : {"sensor", "felt"}
        Of the recording as it came from the sensor, or as it is after conditioning.
    limit : float
        From where on the recording comes near; for `below`, under which.
    kind : {"share", "number"}
        How it is written.
    words : str
        The warning; {} stands for the figure.
    sensitive : tuple of str
        Reducers that suffer.
    below : bool
        Whether small figures are the trouble.
    """

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
        """Tell whether a figure foretells trouble.

        Parameters
        ----------
        value : float
            The figure.

        Returns
        -------
        bool
            Whether it is beyond the limit.
        """
        return value < self.limit if self.below else value > self.limit

    def tell(self, value: float) -> str:
        """Write a figure.

        Parameters
        ----------
        value : float
            The figure.

        Returns
        -------
        str
            Such as "32 %".

        Examples
        --------
        >>> [SIGNS["offset_share"].tell(value) for value in (0.32, 4e-8, 0.0)]
        ['32 %', '<0.01 %', '0 %']
        """
        factor, unit, smallest = SAY[self.kind]
        shown = factor * value
        return f"<{smallest:g}{unit}" if 0 < shown < smallest else f"{shown:.3g}{unit}"


_SINGLE = tuple(f"sa{axis}321{form}" for form in ("", "_matched", "_matched_running") for axis in "xyz")
_FOURIER = ("dft321", "dft321_windowed")
_PRINCIPAL = ("pca321", "pca321_adaptive", "pca321_matched", "pca321_matched_windowed")
_LEADING = (*_PRINCIPAL, "dft321_principal", "dft321_principal_windowed")
_IN_FRAMES = ("pca321_adaptive", "dft321_principal_windowed")
_SIGNS = (
    Sign("undetermined_share", "Energy of undetermined phase", diagnosis.undetermined_share, "felt", 0.02, "share",
         "{} of the energy sits where the phase is undetermined", _FOURIER),
    Sign("eigenvalue_ratio", "λ₂ / λ₁", diagnosis.eigenvalue_ratio, "felt", diagnosis.LEADING, "number",
         "the second principal axis holds {} times the energy of the first", _LEADING),
    Sign("ambiguous_windows", "Energy in windows without a leading axis", diagnosis.ambiguous_windows, "felt", 0.05,
         "share", "{} of the energy lies in windows in which no direction leads by 20 %", _IN_FRAMES),
    Sign("silent_axes", "Silent axes", diagnosis.silent_axes, "felt", 0.5, "number",
         "axes that are 40 dB below the strongest: {}", _SINGLE),
    Sign("offset_share", "Energy in the offset", diagnosis.offset_share, "sensor", 0.5, "share",
         "{} of what the sensor gave is offset; without conditioning it passes for signal", ("mag321", "pca321")),
    Sign("slow_share", "Energy below 20 Hz", diagnosis.slow_share, "sensor", 0.2, "share",
         "{} of the energy about the mean is slower than 20 Hz; high-pass before reducing", _PRINCIPAL),
    Sign("clipped_share", "Clipped samples", diagnosis.clipped_share, "sensor", 0.001, "share",
         "{} of an axis's samples are clipped; directions and spectra of the peaks are the sensor's", _SINGLE),
    Sign("step_over_rms", "Sensor step / RMS", diagnosis.step_over_rms, "sensor", 0.25, "number",
         "the sensor's step is {} times the RMS of an axis; its noise counts as signal", ("mag321",)),
    Sign("held_share", "Repeated samples", diagnosis.held_share, "sensor", 0.01, "share",
         "{} of the samples repeat the one before on all axes, as filled gaps do", _FOURIER),
    Sign("crest_factor", "Peak / RMS", diagnosis.crest_factor, "felt", 12.0, "number",
         "the peak is {} times the RMS; a few moments decide axes and spectra", (*_FOURIER, *_LEADING)),
    Sign("tonal_share", "Energy in one tone", diagnosis.tonal_share, "felt", 0.8, "share",
         "{} of the energy is one tone; other bands are nearly empty and spectral match rests on them", ()),
    Sign("n_windows", "Duration in windows", diagnosis.n_windows, "felt", 10.0, "number",
         "it is {} windows long; too short for spectra and axes to settle", (), below=True),
    Sign("silence_share", "Silent windows", diagnosis.silence_share, "felt", 0.3, "share",
         "{} of the windows are 40 dB below the loudest; there the axis is chance", _IN_FRAMES),
)  # fmt: skip

SIGNS: Mapping[str, Sign] = MappingProxyType({sign.name: sign for sign in _SIGNS})
"""Name -> sign."""


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """What a recording has that makes methods fail.

    Parameters
    ----------
    recording : str
        Its name.
    figures : Mapping of str to float
        Figure of each of `SIGNS`.
    """

    recording: str
    figures: Mapping[str, float]

    @property
    def near_signs(self) -> tuple[Sign, ...]:
        """The signs that are beyond their limits."""
        return tuple(sign for sign in SIGNS.values() if sign.is_near(self.figures[sign.name]))

    @property
    def near_scenes(self) -> tuple[str, ...]:
        """The scenes of the battery that it comes near."""
        names = {sign.name for sign in self.near_signs}
        return tuple(scene.name for scene in BATTERY.values() if names.intersection(scene.signs))


def diagnose(recording: Recording, sensor: Recording | None = None) -> Diagnosis:
    """Examine a recording.

    Parameters
    ----------
    recording : Recording
        As it is felt: conditioned.
    sensor : Recording, optional
        As it came from the sensor; the conditioned one if left out, which hides offsets, clipping and steps.

    Returns
    -------
    Diagnosis
        One figure per sign.

    Examples
    --------
    >>> diagnose(BATTERY["anti_phase"].make(0)).near_scenes
    ('anti_phase', 'chirp')
    """
    sources = {"felt": recording, "sensor": sensor or recording}
    return Diagnosis(recording.name, {name: float(sign.measure(sources[sign.of])) for name, sign in SIGNS.items()})


def warn_of(diagnosis: Diagnosis, cells: Sequence[Cell]) -> tuple[str, ...]:
    """Write a warning per sign that is beyond its limit.

    Parameters
    ----------
    diagnosis : Diagnosis
        Of a recording.
    cells : sequence of Cell
        Its perturbation gains.

    Returns
    -------
    tuple of str
        Such as "32 % of the energy sits where the phase is undetermined: dft321 is sensitive here (gain 40)".
    """
    gains = {cell.reducer: cell.value for cell in cells if cell.recording == diagnosis.recording}
    lines, caution = [], MEASURES["gain"].caution
    for sign in diagnosis.near_signs:
        line = sign.words.format(sign.tell(diagnosis.figures[sign.name]))
        touched = [name for name in sign.sensitive if gains.get(name, 0.0) >= caution]
        told = ", ".join(f"{name} is sensitive here (gain {_tell_gain(gains[name])})" for name in touched)
        lines.append(f"{line}: {told}" if told else line)
    return tuple(lines)


def _tell_gain(gain: float) -> str:
    return f"{gain:.0f}" if gain >= 100 else f"{gain:.2g}"  # noqa: PLR2004 - from here on 2 digits want a power of ten
