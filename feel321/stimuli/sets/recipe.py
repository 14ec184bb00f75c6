"""What is made of every recording: reducers, levels, anchors and further metrics, for which rig.

- `as_is`: one physical gain, so that energy which a reducer lost is felt as loss.
- `equal_intensity`: every stimulus at the same sensation level, that of its loudest 200 ms, so that a high rating
  cannot be one of strength. Silence around an event changes nothing.

A gain is m/s² played per m/s² recorded. Automatic gains let the loudest stimulus reach the headroom: of the whole set,
or, with a gain per recording, of each recording with its reductions and reference. Anchors never set a gain. One gain
for the set keeps the differences between recordings, but then the highest peak of any recording decides how strong all
others are.

Audio's anchors are low-passed at 3.5 and 7 kHz; below 1 kHz that is no change at all. Here the energy of the recording
is put where the recording has least of it: a hum of two just noticeable bands (22 %), nine tenths of it at the quietest
frequency of those that are easily felt, the rest at the quietest of all. The *low* anchor is steady: wrong frequency,
and nothing happens at a tap; the *mid* anchor follows the recording's envelope. What correlates with an axis by chance
is taken out, so the temporal match of both is 0. They are played at the sensation level of their recording: the
envelope of a mid anchor is flattened until its peaks are no higher than the recording's, and an anchor that still does
not fit the headroom is played as strong as fits. `check_stimuli` refuses a set in which an anchor does not score below
every test stimulus of its recording. Anchors change continuously with the recording: nothing is decided by a threshold,
a smallest value or a phase that rounding could change, and the random numbers depend on seed and names only, or the
same set would differ between processors.

References
----------
.. [1] ITU-R BS.1534-3, "Method for the subjective assessment of intermediate quality level of audio systems", 2015 (low
   and mid anchors).
.. [2] E. Muschter et al., "Perceptual quality assessment of compressed vibrotactile signals through comparative
   judgment", IEEE Transactions on Haptics 14(2), 2021 (hidden reference and anchors for vibrotactile signals).
   doi:10.1109/TOH.2021.3077191
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from functools import partial
from typing import Annotated, Any

import numpy as np
from annotated_types import Interval

from feel321.arguments import Registry, as_names, check_name, check_rate, describe
from feel321.extensions import Method, find_method, is_given
from feel321.stimuli.condition import Conditioning, Seconds, make_plain
from feel321.stimuli.match import (
    HIGHEST_HZ,
    LOWEST_HZ,
    NUMERICAL_FLOOR,
    WEBER_FRACTION,
    WeberSmoothing,
    energy_spectrum,
    log_grid,
)
from feel321.stimuli.recording import Recording, largest
from feel321.stimuli.reducers.registry import DEFAULT_REDUCERS, REDUCERS
from feel321.stimuli.sets.manifest import COLUMNS
from feel321.stimuli.thresholds import CONTACTOR, THRESHOLDS, acceleration_threshold, loudest_levels
from feel321.types import ANCHOR_NAMES, Samples


@dataclass(frozen=True, slots=True)
class Unread:
    """A recording that is not read yet: its name, and a function with its arguments, all of which can be pickled.

    size: number of its samples of all axes, once it is known.
    """

    name: str
    open: Callable[..., Recording]
    given: tuple[Any, ...] = ()
    size: int = 0

    def read(self) -> Recording:
        """Read the recording."""
        return replace(self.open(*self.given), name=self.name)


def read_given(given: Recording | Unread) -> Recording:
    """Read a recording that is not read yet."""
    return given.read() if isinstance(given, Unread) else given


EASILY_FELT = 2.0  # thresholds of acceleration up to this multiple of the lowest: up to 250 Hz
ENVELOPE_HZ = 50.0  # envelopes are followed so far: energy in less time is hard to tell apart
FAINT = 0.1  # of the energy in the quietest band of all: it may hardly be felt, and cost headroom
PRECEDENCE = 1000  # a band with 1 % more energy than the quietest gets exp(-10) of its share
LOWEST_SHARE = 1e-30  # bands with less of the energy are left out: 300 dB below the hum
DRIFTS, DRIFT_HZ = 8, (3.0, 12.0)  # sinusoids, of rates drawn from there, by which a hum drifts
# Axes that are parallel but for rounding are not told apart, without a threshold that rounding could cross.
RIDGE, PASSES = 1e-14, 3
MARGIN = 0.95  # of its recording's peaks, for those of a mid anchor: resampling adds to them


def make_anchor(
    recording: Recording, rng: np.random.Generator, *, follows: bool, threshold: str = CONTACTOR
) -> Samples:
    """Make a hum with the recording's energy, where the recording has least; follows: with its envelope.

    That is the root of the three axes' energy, smoothed over half a period of the highest envelope frequency; RMS 1.
    """
    from scipy.ndimage import gaussian_filter1d

    # Sinusoids at a constant amplitude whose frequency drifts: noise would have peaks, which cost level.
    frequencies, bands = weigh_bands(recording)
    time_s = np.arange(recording.n_samples) / recording.rate_hz
    phases = rng.uniform(0, 2 * np.pi, len(frequencies))
    # As wide as a uniform distribution over the band. What is drifted is time, so that all bands are as wide.
    drift = WEBER_FRACTION / np.sqrt(12) * np.sqrt(2 / DRIFTS)
    warped = time_s.copy()
    rates, starts = 2 * np.pi * rng.uniform(*DRIFT_HZ, DRIFTS), rng.uniform(0, 2 * np.pi, DRIFTS)
    for rate, phase in zip(rates, starts, strict=True):
        warped += drift / rate * np.sin(rate * time_s + phase)
    hum = np.zeros(recording.n_samples)
    for one in np.flatnonzero(bands > LOWEST_SHARE):
        hum += np.sqrt(bands[one]) * np.cos(2 * np.pi * frequencies[one] * warped + phases[one])
    axes = recording.acceleration
    if follows:
        width = recording.rate_hz / (2 * np.pi * ENVELOPE_HZ)
        energy = gaussian_filter1d(np.einsum("in,in->n", axes, axes), width, mode="nearest")
        smooth = np.maximum(energy, 0.0)
        envelope = np.asarray(np.sqrt(smooth / smooth.mean()))
        hum = hum * _flatten(envelope, hum, recording, threshold=threshold)
    # What correlates with an axis is removed, by the normal equations of three unknowns; the ridge leaves silent axes
    # alone, and further passes remove its error.
    norms = np.sqrt(np.einsum("in,in->i", axes, axes))[:, None]
    alike = axes / np.where(norms > 0, norms, 1.0)
    products = np.einsum("in,jn->ij", alike, alike) + RIDGE * np.eye(len(axes))
    for _ in range(PASSES):
        shares = np.linalg.solve(products, np.einsum("in,n->i", alike, hum))
        hum = hum - np.einsum("i,in->n", shares, alike)
    return np.asarray(hum * np.sqrt(np.sum(norms**2) / np.einsum("n,n->", hum, hum)))


ANCHORS: Registry[Callable[..., Samples]] = Registry(
    "anchor", {name: partial(make_anchor, follows=name == "anchor_mid") for name in ANCHOR_NAMES}
)
"""Name -> anchor, made from a conditioned recording; the names stand in the manifest's column `reducer`."""


def weigh_bands(recording: Recording) -> tuple[Samples, Samples]:
    """Find the bands in which a recording has least energy: of all that are felt, and of those that are easily felt.

    Returns frequencies in Hz, 24 per octave, and the share of each in the energy of a hum. A tenth of the energy
    is in the first choice, the rest in the second; either is nearly all in one band, and in none below the numerical
    floor. Shares change continuously with the recording: bands that are equally quiet share.
    """
    n, rate_hz, axes = recording.n_samples, recording.rate_hz, recording.acceleration
    frequencies = log_grid(n, rate_hz)
    smooth = WeberSmoothing(frequencies, rate_hz / n, n // 2 + 1)
    energy = smooth(np.sum([energy_spectrum(axis, smooth.bins) for axis in axes], axis=0))
    floor = NUMERICAL_FLOOR * float(np.einsum("in,in->", axes, axes))
    if not (energy > floor).any():
        why = "is silent between 20 and 1000 Hz and can have no anchors"
        raise ValueError(f"{recording.name!r} {why}; leave it out")
    # Least at ten times the floor, and higher again below it: no threshold, or a band could cross it by rounding.
    energy = np.maximum(energy, floor)
    energy = energy + 10 * floor * (10 * floor / energy)
    inside = frequencies >= LOWEST_HZ * (1 + WEBER_FRACTION)
    inside &= frequencies * (1 + WEBER_FRACTION) <= min(HIGHEST_HZ, rate_hz / 2)
    lowest = acceleration_threshold(LOWEST_HZ)
    easily_felt = acceleration_threshold(frequencies) <= EASILY_FELT * lowest
    shares: list[Samples] = []
    for felt in (inside, inside & easily_felt):
        allowed = felt if felt.any() else np.ones_like(felt)
        ratio = np.minimum(energy[allowed].min() / energy, 1.0)
        own = np.where(allowed, ratio**PRECEDENCE, 0.0)
        shares.append(own / own.sum())
    return frequencies, FAINT * shares[0] + (1 - FAINT) * shares[1]


def _flatten(envelope: Samples, hum: Samples, recording: Recording, *, threshold: str) -> Samples:
    """Flatten an envelope softly until the anchor has no higher peaks; at most its root mean square marks the knee."""
    from scipy.optimize import brentq

    def find_crest(samples: Samples) -> float:
        levels = loudest_levels(samples, recording.rate_hz, [threshold])
        return largest(samples) / levels[threshold]

    def flatten(much: float) -> Samples:
        return np.asarray(envelope / np.sqrt(1 + much * envelope**2))

    def exceed(much: float) -> float:
        return find_crest(hum * flatten(much)) - MARGIN * allowed

    allowed = find_crest(recording.acceleration)
    if exceed(0.0) <= 0:
        return envelope
    return flatten(1.0 if exceed(1.0) >= 0 else brentq(exceed, 0.0, 1.0, xtol=1e-15))


LEVELS = ("as_is", "equal_intensity")
"""Level arms: one physical gain, so that lost energy is felt as loss; or one sensation level for every stimulus."""

ORIGINAL, NO_REFERENCE = "original", "none"  # the recording itself, on three channels

ONE_GAIN, GAIN_PER_RECORDING = GAINS = ("set", "per_recording")

LOWEST_RATE_HZ, HIGHEST_RATE_HZ = (2000, 384_000)  # 1000 Hz can be played, and sound devices run
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,99}")


@dataclass(frozen=True)
class RigSettings:
    """What stimuli are rendered for; `[rig]` of study.toml. `settings/meanings.toml` says what each is."""

    rate_hz: Annotated[float, Interval(ge=LOWEST_RATE_HZ, le=HIGHEST_RATE_HZ)] = 48000.0
    full_scale_m_s2: Annotated[float, Interval(gt=0, le=1e6)] = 100.0
    headroom: Annotated[float, Interval(gt=0, le=1)] = 0.9


@dataclass(frozen=True)
class StimulusSettings:
    """What is made of every recording; `[stimuli]` of study.toml, which takes names only."""

    reducers: Sequence[Any] = DEFAULT_REDUCERS
    levels: Sequence[str] = ("as_is",)
    anchors: bool = True
    reference: Any = ORIGINAL
    gain: float | str = ONE_GAIN
    fade_s: Seconds = 0.01
    threshold: str = CONTACTOR
    metrics: Sequence[Any] = ()
    conditioning: Conditioning = field(default_factory=Conditioning)


@dataclass(frozen=True)
class Recipe(StimulusSettings, RigSettings):
    """Settings by which a stimulus set is made from recordings.

    Parameters
    ----------
    rate_hz : float
        The rig's sampling rate in Hz, a whole number.
    full_scale_m_s2 : float
        Acceleration that the rig gives for a file's full scale, m/s².
    headroom : float
        Largest magnitude in a file that an automatic gain gives, as a share of full scale.
    reducers : sequence of str or callable
        Names of `REDUCERS`, or a lab's own, as "mylab.haptics:my321", "methods/my321.py:my321" or functions;
        their short names are kept.
    levels : sequence of str
        Names of `LEVELS`.
    anchors : bool
        Whether each recording gets a low and a mid anchor.
    reference : str
        The hidden reference: `"original"` (three channels), a reducer's name (for rigs with one axis), or `"none"`.
    gain : float or {"set", "per_recording"}
        Physical gain of the `as_is` arm, in m/s² played per m/s² recorded; or what an automatic gain is common to, in
        both arms: the loudest stimulus of the whole set, or of each recording, reaches the headroom.
    fade_s : float
        Raised-cosine fade at both ends in s.
    threshold : str
        Detection threshold curve for sensation levels, a name of `THRESHOLDS`.
    metrics : sequence of str or callable
        Further columns of the manifest: names of `METRICS`, or a lab's own; the three matches are always there.
    conditioning : Conditioning
        Steps before reduction.
    seed : int
        Random seed of the anchors, beside the names of recording and anchor.
    methods : sequence of Method
        The lab's own reducers and metrics, once they are found.
    exceptions : mapping of str to mapping
        Name of a recording -> its own `crop_s`, `high_pass_hz` or `gain` (a number, of the `as_is` arm).

    Examples
    --------
    >>> from feel321 import stimuli
    >>> stimuli.Recipe(reducers=["dft321", "pca321"], levels=["equal_intensity"]).reducers
    ('dft321', 'pca321')
    """

    seed: int = 0
    methods: Sequence[Method] = ()
    exceptions: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)

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
            got = f"got {always[0]!r}, which every set has; leave it out"
            raise ValueError(f"metrics must name further ones, {got}")
        if not isinstance(self.conditioning, Conditioning):
            raise TypeError(
                f"conditioning must be a Conditioning, got {describe(self.conditioning)}"
            )
        check_name(self.threshold, THRESHOLDS, "threshold")
        self._check_numbers()

    def _find_methods(self) -> None:
        """Put short names in the place of the lab's own methods, and keep the methods that are used."""
        known = {(one.kind, one.name): one for one in self.methods}
        used: dict[tuple[str, str], Method] = {}

        def settle(kind: str, given: Any, ours: Collection[str], *, taken: Collection[str]) -> str:  # noqa: ANN401 - a name or a function
            own = None
            if isinstance(given, str):
                own = known.get((kind, given))
                if given in ours or not (own or is_given(kind, given)):
                    return given
            method = own or find_method(kind, given, taken=taken)
            used[kind, method.name] = method
            return method.name

        references = (ORIGINAL, NO_REFERENCE, *REDUCERS)
        taken = (*references, *ANCHORS)
        wanted, further = as_names(self.reducers, "reducers"), as_names(self.metrics, "metrics")
        reducers = tuple(settle("reducer", one, REDUCERS, taken=taken) for one in wanted)
        reference = settle("reducer", self.reference, references, taken=taken)
        metrics = tuple(settle("metric", one, COLUMNS, taken=COLUMNS) for one in further)
        own = tuple(name for kind, name in used if kind == "reducer")
        for name in reducers:
            check_name(name, own if name in own else REDUCERS, "reducer")
        check_name(reference, (*references, *own), "reference")
        found = {"reducers": reducers, "reference": reference, "metrics": metrics}
        for name, value in (found | {"methods": tuple(used.values())}).items():
            object.__setattr__(self, name, value)

    def _check_numbers(self) -> None:
        check_rate(self.full_scale_m_s2, "full_scale_m_s2", " of m/s^2")
        low, high = LOWEST_RATE_HZ, HIGHEST_RATE_HZ
        is_rate = check_rate(self.rate_hz) == int(self.rate_hz) and low <= self.rate_hz <= high
        is_number = not isinstance(self.gain, str | bool) and 0 < self.gain < float("inf")
        rules = {
            "rate_hz": (is_rate, f"a whole number of Hz from {low} to {high}"),
            "headroom": (0 < self.headroom <= 1, "above 0 and at most 1 (full scale)"),
            "gain": (
                is_number or self.gain in GAINS,
                "a finite number above 0, 'set' or 'per_recording'",
            ),
            "fade_s": (0 <= self.fade_s < float("inf"), "0 s or more"),
        }
        for name, (is_right, must) in rules.items():
            if not is_right:
                raise ValueError(f"{name} must be {must}, got {getattr(self, name)!r}")
        for recording, own in self.exceptions.items():
            try:
                find_conditioning(self, recording)
            except ValueError as error:
                raise ValueError(f"recording {recording!r}: {error}") from None
            if not 0 < own.get("gain", 1.0) < float("inf"):
                got = f"got {own['gain']}"
                raise ValueError(f"gain of {recording} must be a finite number above 0, {got}")


def find_conditioning(recipe: Recipe, recording: str) -> Conditioning:
    """Find the steps of one recording: the recipe's, but for its own crop and corner."""
    own = recipe.exceptions.get(recording, {})
    return replace(recipe.conditioning, **{k: v for k, v in own.items() if k != "gain"})


def describe_recipe(recipe: Recipe) -> dict[str, Any]:
    """Return what `manifest.json` records of a recipe, but for the lab's own methods."""
    own = {one.name: getattr(recipe, one.name) for one in fields(recipe) if one.name != "methods"}
    empty = {name for name in ("metrics", "exceptions") if not own[name]}
    own["conditioning"] = asdict(recipe.conditioning)
    return {name: value for name, value in own.items() if name not in empty}


def check_names(names: Sequence[str]) -> None:
    """Refuse names of recordings that are there twice, or cannot be part of a file name on every system."""
    if not names:
        raise ValueError("recordings must be one or more, got none; name them in study.toml")
    seen: set[str] = set()
    for name in names:
        if not _NAME.fullmatch(name):
            must = "up to 100 letters (A-Z), digits, '.', '_' and '-', beginning with a letter or digit"
            raise ValueError(f"a recording's name must be {must}; got {name!r}, rename it")
        # Some file systems do not distinguish capitals from small letters.
        if name.casefold() in seen:
            raise ValueError(f"recording name {name!r} is there twice; rename one of them")
        seen.add(name.casefold())
