"""The recipe of a stimulus set: all settings that determine the files."""

from __future__ import annotations

import re
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Any

from feel321.doors import as_names, check_name
from feel321.stimuli.condition import Conditioning
from feel321.stimuli.recording import check_rate
from feel321.stimuli.reducers.registry import DEFAULT_REDUCERS, REDUCERS
from feel321.stimuli.sets.anchors import CONTACTOR, THRESHOLDS

if TYPE_CHECKING:
    from collections.abc import Sequence

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

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,99}")


@dataclass(frozen=True, slots=True)
class Recipe:
    """Settings by which a stimulus set is made from recordings.

    Parameters
    ----------
    full_scale_m_s2 : float
        Acceleration that the rig gives for a file's full scale, m/s².
    conditioning : Conditioning
        Steps before reduction.
    reducers : sequence of str
        Names of `REDUCERS`.
    levels : sequence of str
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

    Examples
    --------
    >>> from feel321 import stimuli
    >>> stimuli.Recipe(reducers=["dft321", "pca321"], levels=["equal_intensity"]).reducers
    ('dft321', 'pca321')
    """

    full_scale_m_s2: float = 100.0
    conditioning: Conditioning = field(default_factory=Conditioning)
    reducers: Sequence[str] = DEFAULT_REDUCERS
    levels: Sequence[str] = ("as_is",)
    anchors: bool = True
    reference: str = ORIGINAL
    rate_hz: float = 48000.0
    headroom: float = 0.9
    gain: float | str = ONE_GAIN
    fade_s: float = 0.01
    threshold: str = CONTACTOR

    def __post_init__(self) -> None:
        """Refuse unknown names and numbers out of range."""
        for what, known in (("reducers", REDUCERS), ("levels", LEVELS)):
            names = as_names(getattr(self, what), what)
            object.__setattr__(self, what, names)
            for name in names:
                check_name(name, known, what.removesuffix("s"))
            if not names or len(set(names)) < len(names):
                raise ValueError(f"{what} must be one or more names, each once; got {names}")
        self._check_numbers()
        check_name(self.reference, (ORIGINAL, NO_REFERENCE, *REDUCERS), "reference")
        check_name(self.threshold, THRESHOLDS, "threshold")

    def _check_numbers(self) -> None:
        low, high = RIG_RATES_HZ
        if check_rate(self.rate_hz) != int(self.rate_hz) or not low <= self.rate_hz <= high:
            raise ValueError(
                f"rate_hz must be a whole number of Hz from {low} to {high}, got {self.rate_hz}"
            )
        if not 0 < self.headroom <= 1:
            raise ValueError(
                f"headroom must be above 0 and at most 1 (full scale), got {self.headroom}"
            )
        check_rate(self.full_scale_m_s2, "full_scale_m_s2", " of m/s^2")
        if self.gain not in GAINS and (
            isinstance(self.gain, str) or not 0 < self.gain < float("inf")
        ):
            raise ValueError(
                f"gain must be a finite number above 0, 'set' or 'per_recording'; got {self.gain!r}"
            )
        if not 0 <= self.fade_s < float("inf"):
            raise ValueError(f"fade_s must be 0 s or more, got {self.fade_s}")

    def rendering(self) -> dict[str, Any]:
        """Return the settings that determine a file besides its gain, for the key under which it is cached.

        Returns
        -------
        dict
            Conditioning, rate, fade and full scale, ready for JSON.
        """
        # Anchors are made as strong as their recording, by the threshold.
        own = ("rate_hz", "fade_s", "full_scale_m_s2", "threshold")
        return asdict(self.conditioning) | {name: getattr(self, name) for name in own}


def check_names(names: Sequence[str]) -> None:
    """Refuse names of recordings that are there twice, or cannot be part of a file name on every system."""
    if not names:
        raise ValueError("recordings must be one or more, got none; name them in study.toml")
    seen: set[str] = set()
    for name in names:
        if not _NAME.fullmatch(name):
            raise ValueError(
                "a recording's name must be up to 100 letters (A-Z), digits, '.', '_' and '-', beginning with a letter "
                f"or digit; got {name!r}, give it another name"
            )
        # Some file systems do not distinguish capitals from small letters.
        if name.casefold() in seen:
            raise ValueError(
                f"recording name {name!r} is there twice; give one of them another name"
            )
        seen.add(name.casefold())
