"""Draws of a simulated study: its stimuli, what people think of them, and what they do to the scale.

Every attribute is drawn by itself.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from feel321.analysis.power.truth import HIGH, LOW, SHARES, PowerDesign, Truth
from feel321.analysis.primary.plan import ITEM, RATING, REDUCER, SCENE, SOURCE, WHO

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray
    from pandas import DataFrame

    from feel321.types import Samples

    Codes = NDArray[np.intp]

STRAIGHT_SD = 1.0
"""Points by which a straight liner's ratings differ."""

STRAIGHT, CLICKER, REVERSER = 0, 1, 2
"""Kinds of careless people, in the order of their shares in a truth."""


@dataclass(frozen=True, slots=True, eq=False)
class Stimuli:
    """The stimuli of one study; scene, kind, source: codes, (n_items,); metrics: (n_items, n_metrics)."""

    scene: Codes
    kind: Codes
    source: Codes
    metrics: Samples

    @property
    def between(self) -> Samples:
        """Every metric's mean over its recording, (n_items, n_metrics)."""
        counts = np.bincount(self.scene).astype(np.float64)
        sums = np.zeros((len(counts), self.metrics.shape[1]))
        np.add.at(sums, self.scene, self.metrics)
        means: Samples = (sums / counts[:, None])[self.scene]
        return means

    @property
    def within(self) -> Samples:
        """Every metric minus that mean, (n_items, n_metrics)."""
        return self.metrics - self.between

    @property
    def has_sources(self) -> bool:
        """Whether several recordings come from one source."""
        return len(np.unique(self.source)) < len(np.unique(self.scene))


class PlantedSlopes(NamedTuple):
    """A truth for one design; slopes: (n_attributes, n_metrics); centre, slope_sds, recording_sds: (n_metrics,)."""

    slopes: Samples
    slope_sds: Samples
    recording_sds: Samples
    centre: Samples


@dataclass(frozen=True)
class Scenario:
    """A design and a truth, and what is worked out of them once for all studies."""

    design: PowerDesign
    truth: Truth

    @cached_property
    def planted(self) -> PlantedSlopes:
        """The truth in the units of the design's metrics."""
        metrics, truth = self.design.metrics, self.truth
        known = {*metrics, *map("/".join, self.design.hypotheses)}
        named = (*truth.slopes, *truth.slope_sds, *truth.recording_slope_sds)
        if strangers := [name for name in named if name not in known]:
            raise ValueError(
                f"slopes must name metrics of the design ({', '.join(metrics)}), got {strangers[0]!r}"
            )
        within = self.stimuli.within.std(axis=0, ddof=1)
        unit = np.where(within > 0, within, np.inf)

        def settle(given: Mapping[str, float], points: float) -> Samples:
            pairs = zip(metrics, points / unit, strict=True)
            return np.array([given.get(*pair) for pair in pairs], dtype=np.float64)

        slopes = [
            [truth.find_slope(one, name) for name in metrics] for one in self.design.attributes
        ]
        centre = self.stimuli.metrics.mean(axis=0)
        people = settle(truth.slope_sds, truth.slope_points)
        scenes = settle(truth.recording_slope_sds, truth.recording_slope_points)
        return PlantedSlopes(np.array(slopes), people, scenes, centre)

    @cached_property
    def stimuli(self) -> Stimuli:
        """The stimuli of the whole set."""
        items = self.design.items
        scene, kind = (items[name].factorize()[0] for name in (SCENE, REDUCER))
        source = (items[SOURCE] if SOURCE in items else items[SCENE]).factorize()[0]
        return Stimuli(scene, kind, source, items[list(self.design.metrics)].to_numpy(np.float64))

    def draw(self, rng: np.random.Generator) -> Stimuli:
        """Draw a study's recordings and reducers from the design's own; all of them if it has just these."""
        if self.design.is_own:
            return self.stimuli
        whole = self.stimuli
        place = np.full((whole.scene.max() + 1, whole.kind.max() + 1), -1)
        place[whole.scene, whole.kind] = np.arange(len(whole.scene))
        scenes, copies = _pick(len(place), self.design.recordings, rng)
        kinds, _ = _pick(place.shape[1], self.design.reducers, rng)
        chosen = place[np.ix_(scenes, kinds)]
        scene, kind = np.nonzero(chosen >= 0)
        item = chosen[scene, kind]
        source = np.unique(whole.source[item] + copies[scene] * len(place), return_inverse=True)[1]
        return Stimuli(scene, kind, source, whole.metrics[item])


def _pick(count: int, wanted: int, rng: np.random.Generator) -> tuple[Codes, Codes]:
    """Pick a number of things, each as often as every other but for one, and number the copies of each."""
    whole, rest = divmod(wanted, count)
    left = np.sort(rng.choice(count, rest, replace=False)) if rest else np.empty(0, np.intp)
    picked = np.concatenate([np.tile(np.arange(count), whole), left]).astype(np.intp)
    return picked, np.arange(wanted) // count


def draw_ratings(scenario: Scenario, stimuli: Stimuli, rng: np.random.Generator) -> Samples:
    """Draw ratings with the planted slopes, (n_attributes, people, n_items, repeats)."""
    planted, truth = scenario.planted, scenario.truth
    felt = _draw_percepts(scenario, stimuli, rng)
    shape = (*felt.shape, scenario.design.repeats)
    points = felt[..., None] + rng.normal(0, truth.rating_sd, shape)
    points += (planted.slopes @ (stimuli.metrics - planted.centre).T)[:, None, :, None]
    return _set_slider(points, truth, rng)


def _draw_percepts(scenario: Scenario, stimuli: Stimuli, rng: np.random.Generator) -> Samples:
    """Draw what people think of the stimuli besides slopes: (n_attributes, people, n_items)."""
    design, truth = scenario.design, scenario.truth
    rows, people = len(design.attributes), design.participants
    scene, kind, n = stimuli.scene, stimuli.kind, len(stimuli.scene)
    scenes, kinds = scene.max() + 1, kind.max() + 1

    def draw(spread: float, *shape: int) -> Samples:
        return rng.normal(0, spread, (rows, *shape))

    everybody = truth.mean + draw(truth.item_sd, 1, n)
    everybody += draw(truth.recording_sd, 1, scenes)[..., scene]
    everybody += draw(truth.reducer_sd, 1, kinds)[..., kind]
    own = draw(truth.person_sd, people, 1) + draw(truth.person_item_sd, people, n)
    own += draw(truth.person_recording_sd, people, scenes)[..., scene]
    own += draw(truth.person_reducer_sd, people, kinds)[..., kind]
    planted, count = scenario.planted, stimuli.metrics.shape[1]
    slopes = draw(1.0, people, count) * planted.slope_sds
    # The same draws of everything else as in a study whose recordings do not differ in their slopes.
    theirs = (draw(1.0, scenes, count) * planted.recording_sds)[:, scene]
    everybody += (theirs * stimuli.within).sum(axis=-1)[:, None]
    felt: Samples = everybody + own + slopes @ stimuli.within.T
    return felt


def _set_slider(points: Samples, truth: Truth, rng: np.random.Generator) -> Samples:
    """Turn percepts into ratings: by careful people, with lapses, and by careless ones."""
    shares = np.cumsum([getattr(truth, name) for name in SHARES[1:]])
    if shares[-1] or truth.lapse_rate:
        shape, people = points.shape, points.shape[1]
        chosen = rng.random((people, 1, 1))
        kind = np.searchsorted(shares, chosen, side="right")
        place = 100 * rng.uniform(0.2, 0.8, (people, 1, 1))
        line = place + rng.normal(0, STRAIGHT_SD, shape)
        guess, lapsed = rng.uniform(LOW, HIGH, shape), rng.random(shape) < truth.lapse_rate
        points = np.where(kind == REVERSER, LOW + HIGH - points, points)
        points = np.where(lapsed | (kind == CLICKER), guess, points)
        points = np.where(kind == STRAIGHT, line, points)
    if truth.step:
        points = np.round(points / truth.step) * truth.step
    return points.clip(LOW, HIGH) if truth.bounded else points


def tabulate_ratings(stimuli: Stimuli, ratings: Samples, metrics: tuple[str, ...]) -> DataFrame:
    """Make a table with a row per rating of one attribute; ratings: (people, n_items, repeats)."""
    import pandas as pd

    who, item, repeat = (axis.ravel() for axis in np.indices(ratings.shape))
    table = pd.DataFrame({
        WHO: who, SCENE: stimuli.scene[item], REDUCER: stimuli.kind[item], ITEM: item, "repeat": repeat + 1,
        RATING: ratings.ravel(), **dict(zip(metrics, stimuli.metrics[item].T, strict=True)),
    })  # fmt: skip
    return table.assign(**{SOURCE: stimuli.source[item]}) if stimuli.has_sources else table
