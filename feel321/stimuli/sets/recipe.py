"""The recipe of a stimulus set: everything that decides what the files will hold."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from feel321.stimuli.condition import Conditioning
from feel321.stimuli.recording import check_rate
from feel321.stimuli.reducers.registry import DEFAULT_REDUCERS, REDUCERS, get_reducer
from feel321.stimuli.sets.anchors import CONTACTOR, check_threshold

LEVELS = ("as_is", "equal_intensity")
"""Level arms: one physical gain, so that lost energy is felt as loss; or every stimulus brought to the same sensation
level, so that a rating cannot be one of strength."""

ORIGINAL = "original"
"""The reference that is the recording itself, on three channels."""

NO_REFERENCE = "none"

ONE_GAIN, GAIN_PER_RECORDING = GAINS = ("set", "per_recording")
"""Automatic gains: one for the whole set, so that recordings differ in strength as they did when recorded; or one for
each recording with its reference and anchors, so that no spike of one recording weakens the others."""

RIG_RATES_HZ = (2000, 384_000)
"""Rates at which 1000 Hz can be played and sound devices run."""


@dataclass(frozen=True, slots=True)
class Recipe:
    """How a stimulus set is made from recordings.

    Parameters
    ----------
    full_scale_m_s2 : float
        Acceleration that the rig gives for a file's full scale, m/s².
    conditioning : Conditioning
        Steps before reduction.
    reducers : tuple of str
        Names of `REDUCERS`.
    levels : tuple of str
        Names of `LEVELS`.
    anchors : bool
        Whether each recording gets a low and a mid anchor.
    reference : str
        The hidden reference: `"original"` (three channels), a reducer's name (for rigs with one axis), or `"none"`.
    rate_hz : float
        The rig's sampling rate in Hz, a whole number.
    headroom : float
        Largest magnitude in a file that an automatic gain gives, as a share of full scale.
    gain : float or {"set", "per_recording"}
        Physical gain of the `as_is` arm, in m/s² played per m/s² recorded; or what an automatic gain is common to, in
        both arms: the loudest stimulus of the whole set, or of each recording, reaches the headroom.
    fade_s : float
        Raised-cosine fade at both ends in s.
    threshold : str
        Detection threshold curve for sensation levels, a name of `THRESHOLDS`.

    Raises
    ------
    ValueError
        If a name is unknown or twice, or a number is out of range; the message says what is allowed.
    """

    full_scale_m_s2: float = 100.0
    conditioning: Conditioning = field(default_factory=Conditioning)
    reducers: tuple[str, ...] = DEFAULT_REDUCERS
    levels: tuple[str, ...] = ("as_is",)
    anchors: bool = True
    reference: str = ORIGINAL
    rate_hz: float = 48000.0
    headroom: float = 0.9
    gain: float | str = ONE_GAIN
    fade_s: float = 0.01
    threshold: str = CONTACTOR

    def __post_init__(self) -> None:
        """Refuse unknown names and numbers out of range."""
        for name in self.reducers:
            get_reducer(name)
        for name in self.levels:
            if name not in LEVELS:
                raise ValueError(f"level: got {name!r}, allowed is one of {', '.join(LEVELS)}")
        for what, names in (("reducers", self.reducers), ("levels", self.levels)):
            if not names or len(set(names)) < len(names):
                raise ValueError(f"{what}: got {names}, allowed is one or more names, each once")
        if self.reference not in {ORIGINAL, NO_REFERENCE, *REDUCERS}:
            allowed = ", ".join((ORIGINAL, NO_REFERENCE, *REDUCERS))
            raise ValueError(f"reference: got {self.reference!r}, allowed is one of {allowed}")
        low, high = RIG_RATES_HZ
        if check_rate(self.rate_hz) != int(self.rate_hz) or not low <= self.rate_hz <= high:
            raise ValueError(
                f"rate_hz: got {self.rate_hz}, allowed is a whole number of Hz from {low} to {high}"
            )
        self._check_levels()

    def _check_levels(self) -> None:
        if not 0 < self.headroom <= 1:
            raise ValueError(
                f"headroom: got {self.headroom}, allowed is above 0 and up to 1 (full scale)"
            )
        if not 0 < self.full_scale_m_s2 < float("inf"):
            raise ValueError(
                f"full_scale_m_s2: got {self.full_scale_m_s2}, allowed is a finite number above 0"
            )
        if self.gain not in GAINS and (
            isinstance(self.gain, str) or not 0 < self.gain < float("inf")
        ):
            allowed = " or ".join(f"{name!r}" for name in GAINS)
            raise ValueError(
                f"gain: got {self.gain!r}, allowed is a finite number above 0, {allowed}"
            )
        check_threshold(self.threshold)
        if not 0 <= self.fade_s < float("inf"):
            raise ValueError(f"fade_s: got {self.fade_s}, allowed is 0 s or more")

    def rendering(self) -> dict[str, Any]:
        """Give what decides a file besides its gain, for the key under which it is remembered.

        Returns
        -------
        dict
            Conditioning, rate, fade and full scale, ready for JSON.
        """
        steps = self.conditioning
        return {
            "crop_s": steps.crop_s,
            "remove_offset": steps.remove_offset,
            "high_pass_hz": steps.high_pass_hz,
            "low_pass_hz": steps.low_pass_hz,
            "rate_hz": self.rate_hz,
            "fade_s": self.fade_s,
            "full_scale_m_s2": self.full_scale_m_s2,
            "threshold": self.threshold,  # anchors are made as strong as their recording
        }
