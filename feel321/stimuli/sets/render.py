"""A recording rendered by a recipe: condition, reduce, match, resample, fade.

What is made of a recording is known before it is made: a draft has a key of everything that goes into it, under which
a build remembers what it measured.
"""

import hashlib
import json
import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import cache
from itertools import chain
from typing import Any

import numpy as np

from feel321 import __version__
from feel321.doors import check_name
from feel321.extensions import Method
from feel321.names import ANCHOR, METRIC_INFO
from feel321.stimuli.condition import condition, fade, resample
from feel321.stimuli.match import (
    OriginalSpectrum,
    axis_correlations,
    match_in_windows,
    mean_over_axes,
)
from feel321.stimuli.metrics import METRICS
from feel321.stimuli.own_methods import OwnMetric, OwnReducer
from feel321.stimuli.recording import Recording, digest_samples, largest
from feel321.stimuli.reducers.registry import REDUCERS
from feel321.stimuli.sets.recipe import (
    ANCHORS,
    GAIN_PER_RECORDING,
    NO_REFERENCE,
    ORIGINAL,
    Recipe,
    Unread,
    find_conditioning,
    read_given,
)
from feel321.stimuli.thresholds import THRESHOLDS, loudest_levels, to_db
from feel321.types import Metric, Reducer, Samples

# A stimulus below this share of its recording's level is what rounding left of axes that cancelled: silence.
ROUNDING = 1e-9


def find_reducer(recipe: Recipe, name: str) -> Reducer:
    """Find a reducer of a recipe, feel321's or the lab's own."""
    method = _find_method(recipe, "reducer", name)
    return OwnReducer(method) if method else REDUCERS[name]


def find_metric(recipe: Recipe, name: str) -> Metric:
    """Find a metric of a recipe, feel321's or the lab's own."""
    method = _find_method(recipe, "metric", name)
    if method and name in METRICS:
        why = f"the name {name!r} is taken by one of feel321's own"
        raise ValueError(f"metric {method.place!r}: {why}; rename it")
    return OwnMetric(method) if method else METRICS[check_name(name, METRICS, "metric")]


def _find_method(recipe: Recipe, kind: str, name: str) -> Method | None:
    return next((one for one in recipe.methods if (one.kind, one.name) == (kind, name)), None)


def list_methods(recipe: Recipe) -> dict[str, dict[str, dict[str, Any]]]:
    """List what `manifest.json` records of the lab's own methods, and of all further metrics; empty if none."""
    reducers = {one.name: one.to_json() for one in recipe.methods if one.kind == "reducer"}
    metrics: dict[str, dict[str, Any]] = {}
    for name in recipe.metrics:
        metric, source = find_metric(recipe, name), {"method": "feel321", "sha256": __version__}
        if isinstance(metric, OwnMetric):
            declared, source = asdict(metric.info), metric.method.to_json()
        else:
            declared = asdict(METRIC_INFO[name])
        ends = {key: None if value in {-math.inf, math.inf} else value for key, value in declared.items()}  # fmt: skip
        metrics[name] = ends | source
    found = {"reducers": reducers, "metrics": metrics}
    return {kind: entries for kind, entries in found.items() if entries}


@dataclass(frozen=True, slots=True)
class Draft:
    """A stimulus before its level: what is made of which recording, and the key it is remembered by."""

    recording: str
    reducer: str
    role: str
    key: str


@dataclass(frozen=True, slots=True)
class Measured:
    """Measurements of a rendered stimulus at unit gain.

    peak: largest magnitude in m/s²; levels: name of a threshold curve -> largest root mean square
    in any 200 ms, in multiples of the threshold; metrics: further ones, None where nothing can be compared.
    """

    peak: float
    levels: dict[str, float]
    spectral_match: float
    temporal_match: float
    spectral_match_bounded: float
    temporal_match_windowed: float
    metrics: dict[str, float | None] = field(default_factory=dict)


def list_drafts(recording: Recording, recipe: Recipe) -> tuple[Draft, ...]:
    """List the stimuli that a recipe makes of one recording: tests, the hidden reference, anchors."""
    wanted = [(name, "test") for name in recipe.reducers]
    if recipe.reference != NO_REFERENCE:
        wanted.append((recipe.reference, "reference"))
    if recipe.anchors:
        wanted += [(name, ANCHOR) for name in ANCHORS]
    # The samples, not the file: the same file read in another unit or at another rate is another recording.
    basis: dict[str, Any] = {"version": __version__, "recording": digest_samples(recording)}
    # What determines a file besides its gain; anchors are made as strong as their recording, by the threshold.
    settings = ("rate_hz", "fade_s", "full_scale_m_s2", "threshold")
    # The same file may be there twice, with two gains.
    exceptions = recipe.exceptions.get(recording.name, {})
    basis |= {**versions(), **asdict(find_conditioning(recipe, recording.name)), **exceptions}
    basis |= {name: getattr(recipe, name) for name in settings}
    methods = list_methods(recipe)
    own = {name: entry["sha256"] for name, entry in methods.get("reducers", {}).items()}
    if "metrics" in methods:
        basis["metrics"] = {name: one["sha256"] for name, one in methods["metrics"].items()}
    drafts = []
    for reducer, role in wanted:
        facts = {**basis, "reducer": reducer}
        if reducer in own:
            facts["method"] = own[reducer]
        if role == ANCHOR:
            facts |= {"seed": recipe.seed, "name": recording.name}
        key = hashlib.sha256(json.dumps(facts, sort_keys=True).encode()).hexdigest()
        drafts.append(Draft(recording.name, reducer, role, key))
    return tuple(drafts)


@cache
def versions() -> dict[str, str]:
    """Versions of the software whose arithmetic decides the samples."""
    from importlib.metadata import version

    return {name: version(name) for name in ("numpy", "scipy", "soxr")}


@dataclass(frozen=True, slots=True)
class _Scale:
    """The conditioned recording that its stimuli are measured against."""

    recording: Recording
    spectrum: OriginalSpectrum
    played: Samples
    levels: dict[str, float]


def render_drafts(
    given: Recording | Unread, wanted: Sequence[Draft], recipe: Recipe
) -> Iterator[tuple[Draft, Samples, Measured]]:
    """Make drafts one after the other: each with its samples for the rig in m/s², and what was measured."""
    if not wanted:  # nor is the recording read
        return
    try:
        scale = _make_scale(read_given(given), recipe)
        for draft in wanted:
            samples, played = _play(draft.reducer, scale, recipe)
            yield draft, played, _measure(samples, played, scale=scale, recipe=recipe)
    except ValueError as error:
        raise ValueError(f"recording {given.name!r}: {error}") from None


@dataclass(frozen=True, slots=True, eq=False)
class Reduction:
    """What a stimulus was made from, at the recording's rate, as its metrics saw it.

    acceleration: of the conditioned recording, shape (3, n); samples: its reduction, (n,), or itself, (3, n), in m/s²;
    factor: m/s² that are played at unit gain per m/s² of the samples.
    """

    acceleration: Samples
    rate_hz: float
    samples: Samples
    factor: float


def reduce_again(
    recording: Recording, reducers: Collection[str], recipe: Recipe
) -> dict[str, Reduction]:
    """Make again what stimuli of one recording were made from, by reducer; `original` and anchors are among them."""
    scale = _make_scale(recording, recipe)
    ready, found = scale.recording, {}
    for name in reducers:
        samples, played = _play(name, scale, recipe)
        factor = 1.0
        if name in ANCHORS:  # made as strong as its recording
            own = _for_the_rig(samples, ready.rate_hz, recipe)
            factor = float(np.linalg.norm(played) / np.linalg.norm(own))
        found[name] = Reduction(ready.acceleration, ready.rate_hz, samples, factor)
    return found


def _make_scale(recording: Recording, recipe: Recipe) -> _Scale:
    conditioned = condition(recording, find_conditioning(recipe, recording.name))
    spectrum = OriginalSpectrum(conditioned.acceleration, conditioned.rate_hz)
    if spectrum.reason:
        raise ValueError(f"{spectrum.reason}; nothing can be felt or matched, leave it out")
    played = _for_the_rig(conditioned.acceleration, conditioned.rate_hz, recipe)
    return _Scale(conditioned, spectrum, played, loudest_levels(played, recipe.rate_hz, THRESHOLDS))


def _play(reducer: str, scale: _Scale, recipe: Recipe) -> tuple[Samples, Samples]:
    """Make a stimulus, at its recording's rate and for the rig; there, anchors are as strong as the recording."""
    recording = scale.recording
    if reducer == ORIGINAL:
        return recording.acceleration, scale.played
    if reducer not in ANCHORS:
        samples = find_reducer(recipe, reducer)(recording.acceleration, recording.rate_hz)
        return samples, _for_the_rig(samples, recording.rate_hz, recipe)
    # By names, not by samples: a seed from those would differ with the last digit of anything before it.
    rng = np.random.default_rng([recipe.seed, *f"{recording.name}/{reducer}".encode()])
    samples = ANCHORS[reducer](recording, rng, threshold=recipe.threshold)
    played = _for_the_rig(samples, recording.rate_hz, recipe)
    own = loudest_levels(played, recipe.rate_hz, [recipe.threshold])[recipe.threshold]
    return samples, scale.levels[recipe.threshold] / own * played


def _for_the_rig(samples: Samples, rate_hz: float, recipe: Recipe) -> Samples:
    # An offset (mag321 makes one) cannot be felt and only heats the coil; the metrics are taken before it is removed.
    vibration = samples - samples.mean(axis=-1, keepdims=True)
    played = resample(vibration, rate_hz, to_hz=recipe.rate_hz)
    return fade(played, recipe.rate_hz, fade_s=recipe.fade_s)


def _measure(samples: Samples, rendered: Samples, *, scale: _Scale, recipe: Recipe) -> Measured:
    # The level is that of what is played: fades and a removed offset change it. The metrics are those of the reduction.
    peak = largest(rendered)
    if not peak <= float(np.finfo(np.float32).max):
        raise ValueError(f"a peak of {peak:g} m/s^2 does not fit into float32; is its unit right?")
    levels = {
        name: level if level > ROUNDING * scale.levels[name] else 0.0
        for name, level in loudest_levels(rendered, recipe.rate_hz, THRESHOLDS).items()
    }
    acceleration, rate_hz = scale.recording.acceleration, scale.recording.rate_hz
    pairs = [(acceleration, samples)]
    if samples.ndim > 1:  # the original itself: each channel is compared with itself
        pairs = [(np.array([axis] * 3), axis) for axis in acceleration if axis.any()]
    further: dict[str, float | None] = {}
    for name in recipe.metrics:
        metric = find_metric(recipe, name)
        value = float(np.mean([metric(*pair, rate_hz) for pair in pairs]))
        further[name] = None if math.isnan(value) else value
    if samples.ndim > 1:
        return Measured(peak, levels, 1.0, 1.0, 1.0, 1.0, further)
    spectral, bounded = scale.spectrum.match_both(samples)
    temporal = mean_over_axes(axis_correlations(acceleration, samples))
    windowed = match_in_windows(acceleration, samples, rate_hz)
    matches = float(spectral), float(temporal), float(bounded), float(windowed)
    return Measured(peak, levels, *matches, further)


def choose_gains(
    measured: Mapping[str, Measured], recipe: Recipe, *, drafts: Mapping[str, Sequence[Draft]]
) -> dict[tuple[str, str], float]:
    """Choose gains, (level, key) -> gain, from what was measured; anchors never set one; drafts: of each recording."""
    room = recipe.headroom * recipe.full_scale_m_s2
    own = {name: one["gain"] for name, one in recipe.exceptions.items() if "gain" in one}
    gains: dict[tuple[str, str], float] = {}
    for level in recipe.levels:
        fixed = own if level == "as_is" else {}
        groups = [([*drafts[name]], gain) for name, gain in fixed.items() if name in drafts]
        shared = [[*one] for name, one in drafts.items() if name not in fixed]
        together = shared if recipe.gain == GAIN_PER_RECORDING else [[*chain(*shared)]]
        for group, gain in groups + [(one, recipe.gain) for one in together if one]:
            notes = {one.key: measured[one.key] for one in group}
            anchors = {one.key for one in group if one.role == ANCHOR}
            if level == "as_is":
                loudest = max(notes[key].peak for key in notes.keys() - anchors)
                automatic = room / loudest if loudest else 1.0
                chosen = dict.fromkeys(notes, automatic if isinstance(gain, str) else gain)
            else:
                chosen = _equalise_levels(notes, recipe, notes.keys() - anchors)
            for key, one in chosen.items():
                gains[level, key] = min(one, room / notes[key].peak) if key in anchors else one
    return gains


def _equalise_levels(
    notes: Mapping[str, Measured], recipe: Recipe, deciding: Collection[str]
) -> dict[str, float]:
    levels = {key: note.levels[recipe.threshold] for key, note in notes.items()}
    if silent := sum(level == 0.0 for level in levels.values()):
        why = f"{silent} stimuli are silent between 20 and 1000 Hz and cannot be made as strong"
        raise ValueError(f"equal_intensity: {why}; leave out this level, or what is silent")
    room = recipe.headroom * recipe.full_scale_m_s2
    common = room / max(notes[key].peak / levels[key] for key in deciding)
    return {key: common / level for key, level in levels.items()}


def find_headroom_cost(peaks: Mapping[str, float]) -> tuple[str, float]:
    """Find the recording with the highest peak, and by how many dB a common gain is lower for it."""
    first, *others = sorted(peaks, key=lambda name: -peaks[name])
    return first, to_db(peaks[first] / peaks[others[0]]) if others and peaks[others[0]] else 0.0
