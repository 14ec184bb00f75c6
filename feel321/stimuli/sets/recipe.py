"""The recipe of a stimulus set: which reducers, levels, anchors and further metrics, for which rig.

- `as_is`: one physical gain, so that energy which a reducer lost is felt as loss.
- `equal_intensity`: every stimulus at the same sensation level, that of its loudest 200 ms, so that a high rating
  cannot be one of strength. Silence around an event changes nothing.

A gain is m/s² played per m/s² recorded. Automatic gains let the loudest stimulus reach the headroom: of the whole set,
or, with a gain per recording, of each recording with its reductions and reference. Anchors never set a gain. One gain
for the set keeps the differences between recordings, but then the highest peak of any recording decides how strong all
others are.
"""

import re
from collections.abc import Collection, Sequence
from dataclasses import asdict, dataclass, field, fields
from typing import Any

from feel321.doors import as_names, check_name, describe
from feel321.extensions import Method, find_method, is_given
from feel321.stimuli.condition import Conditioning, make_plain
from feel321.stimuli.recording import check_rate
from feel321.stimuli.reducers.registry import DEFAULT_REDUCERS, REDUCERS
from feel321.stimuli.sets.anchors import ANCHORS
from feel321.stimuli.sets.manifest import COLUMNS
from feel321.stimuli.thresholds import CONTACTOR, THRESHOLDS

LEVELS = ("as_is", "equal_intensity")
"""Level arms: one physical gain, so that lost energy is felt as loss; or every stimulus brought to the same sensation
level, so that a rating cannot be one of strength."""

ORIGINAL = "original"
"""The reference that is the recording itself, on three channels."""

NO_REFERENCE = "none"

ONE_GAIN, GAIN_PER_RECORDING = GAINS = ("set", "per_recording")
"""Automatic gains: one for the whole set, so that recordings differ in strength as they did when recorded; or one for
each recording with its reductions and reference, so that no spike of one recording weakens the others."""

RIG_RATES_HZ = (2000, 384_000)
"""Rates at which 1000 Hz can be played and sound devices run."""

_RESERVED = {
    "con",
    "prn",
    "aux",
    "nul",
    *(f"{port}{n}" for port in ("com", "lpt") for n in range(10)),
}
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
    reducers : sequence of str or callable
        Names of `REDUCERS`, or a lab's own, as "mylab.haptics:my321", "methods/my321.py:my321" or functions;
        their short names are kept.
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
    metrics : sequence of str or callable
        Further columns of the manifest: names of `METRICS`, or a lab's own; the three matches are always there.
    seed : int
        Random seed of the anchors, beside the names of recording and anchor.
    methods : sequence of Method
        The lab's own reducers and metrics, once they are found.

    Examples
    --------
    >>> from feel321 import stimuli
    >>> stimuli.Recipe(reducers=["dft321", "pca321"], levels=["equal_intensity"]).reducers
    ('dft321', 'pca321')
    """

    full_scale_m_s2: float = 100.0
    conditioning: Conditioning = field(default_factory=Conditioning)
    reducers: Sequence[Any] = DEFAULT_REDUCERS
    levels: Sequence[str] = ("as_is",)
    anchors: bool = True
    reference: str = ORIGINAL
    rate_hz: float = 48000.0
    headroom: float = 0.9
    gain: float | str = ONE_GAIN
    fade_s: float = 0.01
    threshold: str = CONTACTOR
    metrics: Sequence[Any] = ()
    seed: int = 0
    methods: Sequence[Method] = ()

    def __post_init__(self) -> None:
        """Find the lab's own methods; refuse unknown names and numbers out of range."""
        make_plain(self)
        self._find_methods()
        object.__setattr__(self, "levels", as_names(self.levels, "levels"))
        for name in self.levels:
            check_name(name, LEVELS, "level")
        for what in ("reducers", "levels", "metrics"):
            names = getattr(self, what)
            if (not names and what != "metrics") or len(set(names)) < len(names):
                raise ValueError(f"{what} must be one or more names, each once; got {names}")
        if always := [name for name in self.metrics if name in COLUMNS]:
            raise ValueError(
                f"metrics must name further ones, got {always[0]!r}, which every set has; leave it out"
            )
        if not isinstance(self.conditioning, Conditioning):
            raise TypeError(
                f"conditioning must be a Conditioning, got {describe(self.conditioning)}"
            )
        self._check_numbers()
        check_name(self.threshold, THRESHOLDS, "threshold")

    def _find_methods(self) -> None:
        """Put short names in the place of the lab's own methods, and keep the methods that are used."""
        known = {(one.kind, one.name): one for one in self.methods}
        used = {}

        def find(kind: str, given: object, taken: Collection[str]) -> str:
            own = known.get((kind, given)) if isinstance(given, str) else None
            method = own or find_method(kind, given, taken=taken)
            used[kind, method.name] = method
            return method.name

        def is_own(kind: str, given: object, ours: Collection[str]) -> bool:
            if not isinstance(given, str):
                return True
            return given not in ours and ((kind, given) in known or is_given(kind, given))

        references = (ORIGINAL, NO_REFERENCE, *REDUCERS)
        taken = (*references, *ANCHORS)
        reducers = [
            find("reducer", one, taken)
            if is_own("reducer", one, REDUCERS)
            else check_name(one, REDUCERS, "reducer")
            for one in as_names(self.reducers, "reducers")
        ]
        reference = self.reference
        if is_own("reducer", reference, references):
            reference = find("reducer", reference, taken)
        metrics = [
            find("metric", one, COLUMNS) if is_own("metric", one, COLUMNS) else one
            for one in as_names(self.metrics, "metrics")
        ]
        found = {"reducers": tuple(reducers), "reference": reference, "metrics": tuple(metrics)}
        for name, value in (found | {"methods": tuple(used.values())}).items():
            object.__setattr__(self, name, value)
        check_name(reference, references + tuple(one.name for one in used.values()), "reference")

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
            isinstance(self.gain, str | bool) or not 0 < self.gain < float("inf")
        ):
            raise ValueError(
                f"gain must be a finite number above 0, 'set' or 'per_recording'; got {self.gain!r}"
            )
        if not 0 <= self.fade_s < float("inf"):
            raise ValueError(f"fade_s must be 0 s or more, got {self.fade_s}")


def describe_recipe(recipe: Recipe) -> dict[str, Any]:
    """Return what `manifest.json` records of a recipe, but for the lab's own methods."""
    own = {one.name: getattr(recipe, one.name) for one in fields(recipe) if one.name != "methods"}
    if not recipe.metrics:  # as it was before there were any
        del own["metrics"]
    return own | {"conditioning": asdict(recipe.conditioning)}


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
        if name.partition(".")[0].casefold() in _RESERVED:
            raise ValueError(
                f"a recording's name must not be that of a device on Windows, got {name!r}; give it another name"
            )
        # Some file systems do not distinguish capitals from small letters.
        if name.casefold() in seen:
            raise ValueError(
                f"recording name {name!r} is there twice; give one of them another name"
            )
        seen.add(name.casefold())
