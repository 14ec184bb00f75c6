"""A recording rendered by a recipe: condition, reduce, match, resample, fade.

What is made of a recording is known before it is made: a draft has a key of everything that goes into it, under which
a build remembers what it measured.
"""

import hashlib
import json
import math
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field
from functools import cache
from typing import Any

import numpy as np

from feel321 import __version__
from feel321.arguments import check_name
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
from feel321.stimuli.sets import recipe as recipes
from feel321.stimuli.sets.recipe import ANCHORS, ORIGINAL, Recipe, Unread
from feel321.stimuli.thresholds import THRESHOLDS, loudest_levels
from feel321.types import ANCHOR, METRIC_INFO, Metric, Reducer, Samples

# A stimulus below this share of its recording's level is what rounding left of axes that cancelled: silence.
ROUNDING = 1e-9


def find_reducer(recipe: Recipe, name: str) -> Reducer:
    """Find a reducer of a recipe, feel321's or the lab's own."""
    own = {one.name: one for one in recipe.methods if one.kind == "reducer"}
    return OwnReducer(own[name]) if name in own else REDUCERS[name]


def find_metric(recipe: Recipe, name: str) -> Metric:
    """Find a metric of a recipe, feel321's or the lab's own."""
    own = {one.name: one for one in recipe.methods if one.kind == "metric"}
    if name in own and name in METRICS:
        why = f"the name {name!r} is taken by one of feel321's own"
        raise ValueError(f"metric {own[name].place!r}: {why}; rename it")
    return OwnMetric(own[name]) if name in own else METRICS[check_name(name, METRICS, "metric")]


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
    wanted += [(recipe.reference, "reference")] * (recipe.reference != recipes.NO_REFERENCE)
    wanted += [(name, ANCHOR) for name in ANCHORS] * recipe.anchors
    # The samples, not the file: the same file read in another unit or at another rate is another recording.
    basis: dict[str, Any] = {"version": __version__, "recording": digest_samples(recording)}
    # The same file may be there twice, with two gains.
    exceptions = recipe.exceptions.get(recording.name, {})
    basis |= {
        **versions(),
        **asdict(recipes.find_conditioning(recipe, recording.name)),
        **exceptions,
    }
    # What determines a file besides its gain; anchors are made as strong as their recording, by the threshold.
    settings = ("rate_hz", "fade_s", "full_scale_m_s2", "threshold")
    basis |= {name: getattr(recipe, name) for name in settings}
    methods = {
        kind: {name: one["sha256"] for name, one in entries.items()}
        for kind, entries in list_methods(recipe).items()
    }
    own = methods.pop("reducers", {})
    drafts = []
    for reducer, role in wanted:
        facts = {**basis, **methods, "reducer": reducer}
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


def render_drafts(
    given: Recording | Unread, wanted: Sequence[Draft], recipe: Recipe
) -> Iterator[tuple[Draft, Samples, Measured]]:
    """Make drafts one after the other: each with its samples for the rig in m/s², and what was measured."""
    if not wanted:  # nor is the recording read
        return
    try:
        made = Rendering(recipes.read_given(given), recipe)
        for draft in wanted:
            samples, played, _ = made.play(draft.reducer)
            yield draft, played, made.measure(samples, played)
    except ValueError as error:
        raise ValueError(f"recording {given.name!r}: {error}") from None


class Rendering:
    """The conditioned recording, and its stimuli, which are measured against it."""

    def __init__(self, recording: Recording, recipe: Recipe) -> None:
        self.recipe = recipe
        self.recording = condition(recording, recipes.find_conditioning(recipe, recording.name))
        self.spectrum = OriginalSpectrum(self.recording.acceleration, self.recording.rate_hz)
        if self.spectrum.reason:
            raise ValueError(
                f"{self.spectrum.reason}; nothing can be felt or matched, leave it out"
            )
        self.played = self.for_the_rig(self.recording.acceleration)
        self.levels = loudest_levels(self.played, recipe.rate_hz, THRESHOLDS)

    def for_the_rig(self, samples: Samples) -> Samples:
        """Remove the offset, which cannot be felt and only heats the coil; mag321 makes one. Resample, fade."""
        vibration = samples - samples.mean(axis=-1, keepdims=True)
        played = resample(vibration, self.recording.rate_hz, to_hz=self.recipe.rate_hz)
        return fade(played, self.recipe.rate_hz, fade_s=self.recipe.fade_s)

    def play(self, reducer: str) -> tuple[Samples, Samples, float]:
        """Make a stimulus, at its recording's rate and for the rig, where anchors are as strong as the recording.

        Also gives what that took: m/s² that are played at unit gain per m/s² of the samples.
        """
        recording, recipe = self.recording, self.recipe
        if reducer == ORIGINAL:
            return recording.acceleration, self.played, 1.0
        if reducer not in ANCHORS:
            samples = find_reducer(recipe, reducer)(recording.acceleration, recording.rate_hz)
            return samples, self.for_the_rig(samples), 1.0
        # By names, not by samples: a seed from those would differ with the last digit of anything before it.
        rng = np.random.default_rng([recipe.seed, *f"{recording.name}/{reducer}".encode()])
        samples = ANCHORS[reducer](recording, rng, threshold=recipe.threshold)
        played = self.for_the_rig(samples)
        own = loudest_levels(played, recipe.rate_hz, [recipe.threshold])[recipe.threshold]
        factor = self.levels[recipe.threshold] / own
        return samples, factor * played, factor

    def measure(self, samples: Samples, played: Samples) -> Measured:
        """Measure a stimulus: the level of what is played, which fades change too, and the metrics of its samples."""
        peak = largest(played)
        if not peak <= float(np.finfo(np.float32).max):
            raise ValueError(
                f"a peak of {peak:g} m/s^2 does not fit into float32; is its unit right?"
            )
        levels = {
            name: level if level > ROUNDING * self.levels[name] else 0.0
            for name, level in loudest_levels(played, self.recipe.rate_hz, THRESHOLDS).items()
        }
        acceleration, rate_hz = self.recording.acceleration, self.recording.rate_hz
        is_original = samples.ndim > 1  # each of its channels is compared with itself
        alike = [(np.array([axis] * 3), axis) for axis in acceleration if axis.any()]
        pairs: list[tuple[Samples, Samples]] = alike if is_original else [(acceleration, samples)]
        further: dict[str, float | None] = {}
        for name in self.recipe.metrics:
            metric = find_metric(self.recipe, name)
            value = float(np.mean([metric(*pair, rate_hz) for pair in pairs]))
            further[name] = None if math.isnan(value) else value
        if is_original:
            return Measured(peak, levels, 1.0, 1.0, 1.0, 1.0, further)
        spectral, bounded = self.spectrum.match_both(samples)
        temporal = mean_over_axes(axis_correlations(acceleration, samples))
        windowed = match_in_windows(acceleration, samples, rate_hz)
        matches = float(spectral), float(temporal), float(bounded), float(windowed)
        return Measured(peak, levels, *matches, further)
