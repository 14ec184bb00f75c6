"""Draws of a simulated study: its stimuli, what people think of them, and what they do to the scale.

Every attribute is drawn by itself. The same draws give the ratings with the planted slopes and those without any, so
that power and false positives are about the same people and stimuli.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from feel321.analysis.power.design import HIGH, LOW, SHARES, SPREADS, PowerDesign, Truth
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


def draw_ratings(
    scenario: Scenario, stimuli: Stimuli, rng: np.random.Generator
) -> tuple[Samples, Samples]:
    """Draw ratings with the planted slopes and without any, each (n_attributes, people, n_items, repeats)."""
    planted, truth = scenario.planted, scenario.truth
    felt = _draw_percepts(scenario, stimuli, rng)
    shape = (*felt.shape, scenario.design.repeats)
    points = felt[..., None] + rng.normal(0, truth.rating_sd, shape)
    shift = planted.slopes @ (stimuli.metrics - planted.centre).T
    habit = _draw_habits(truth, shape, rng)
    slopes = shift[:, None, :, None]
    return _set_slider(points + slopes, truth, habit), _set_slider(points, truth, habit)


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


class Habits(NamedTuple):
    """How people use the scale; kind: (people,), -1 for careful; guess, lapsed, line: ratings' shape."""

    kind: Codes
    guess: Samples
    lapsed: NDArray[np.bool_]
    line: Samples


def _draw_habits(truth: Truth, shape: tuple[int, ...], rng: np.random.Generator) -> Habits | None:
    shares = np.cumsum([getattr(truth, name) for name in SHARES[1:]])
    if not shares[-1] and not truth.lapse_rate:
        return None
    people = shape[1]
    kind = np.searchsorted(shares, rng.random(people), side="right")
    line = 100 * rng.uniform(0.2, 0.8, people)[:, None, None] + rng.normal(0, STRAIGHT_SD, shape)
    guess, lapsed = rng.uniform(LOW, HIGH, shape), rng.random(shape)
    return Habits(np.where(kind < len(shares), kind, -1), guess, lapsed < truth.lapse_rate, line)


def _set_slider(points: Samples, truth: Truth, habits: Habits | None) -> Samples:
    """Turn percepts into ratings."""
    if habits is not None:
        kind = habits.kind[:, None, None]
        points = np.where(kind == REVERSER, LOW + HIGH - points, points)
        points = np.where(habits.lapsed | (kind == CLICKER), habits.guess, points)
        points = np.where(kind == STRAIGHT, habits.line, points)
    if truth.step:
        points = np.round(points / truth.step) * truth.step
    return points.clip(LOW, HIGH) if truth.bounded else points


def keep_slopes(scenario: Scenario, stimuli: Stimuli) -> Samples:
    """Compute what the ends of the scale and lapses leave of the planted slopes, (n_attributes, n_metrics).

    Notes
    -----
    A careful person's expected rating of a stimulus is the mean of a normal variable that is cut at the ends of the
    scale. What remains of the slopes is the generalised least squares fit of these means with the true spreads, which
    is what the primary model estimates.
    """
    planted, truth = scenario.planted, scenario.truth
    means = truth.mean + planted.slopes @ (stimuli.metrics - planted.centre).T
    if not truth.bounded and not truth.lapse_rate:
        return planted.slopes
    spread = np.sqrt(_add_variances(truth, stimuli, planted))
    seen = _cut_means(means, spread) if truth.bounded else means
    seen = seen + truth.lapse_rate * ((LOW + HIGH) / 2 - seen)
    columns = np.column_stack([np.ones(len(spread)), stimuli.within, stimuli.between])
    root = np.linalg.cholesky(find_covariance(scenario, stimuli))
    whole = np.linalg.solve(root, np.column_stack([columns, seen.T]))
    width = columns.shape[1]
    solved = np.linalg.lstsq(whole[:, :width], whole[:, width:], rcond=None)[0]
    kept: Samples = solved[1 : 1 + planted.slopes.shape[1]].T
    return kept


def _cut_means(means: Samples, spread: Samples) -> Samples:
    from scipy.stats import norm

    spread = spread + 1e-12
    below, above = (LOW - means) / spread, (HIGH - means) / spread
    cut = LOW * norm.cdf(below) + HIGH * norm.sf(above)
    cut += means * (norm.cdf(above) - norm.cdf(below))
    found: Samples = cut + spread * (norm.pdf(below) - norm.pdf(above))
    return found


def _add_variances(truth: Truth, stimuli: Stimuli, planted: PlantedSlopes) -> Samples:
    """Add up how far single ratings of every stimulus lie from its mean, (n_items,)."""
    whole = sum(getattr(truth, name) ** 2 for name in SPREADS)
    slopes = planted.slope_sds**2 + planted.recording_sds**2
    added: Samples = whole + stimuli.within**2 @ slopes
    return added


def find_covariance(scenario: Scenario, stimuli: Stimuli) -> Samples:
    """Compute the covariance of the stimuli's mean ratings over people and repeats, (n_items, n_items)."""
    design, truth, people = scenario.design, scenario.truth, scenario.design.participants
    alike = [np.eye(codes.max() + 1)[codes] for codes in (stimuli.scene, stimuli.kind)]
    noise = truth.person_item_sd**2 + truth.rating_sd**2 / design.repeats
    own = stimuli.within * scenario.planted.slope_sds
    found = (truth.item_sd**2 + noise / people + 1e-9) * np.eye(len(own))
    found += truth.person_sd**2 / people + own @ own.T / people
    for marks, shared, personal in zip(
        alike, (truth.recording_sd, truth.reducer_sd),
        (truth.person_recording_sd, truth.person_reducer_sd), strict=True,
    ):  # fmt: skip
        found += (shared**2 + personal**2 / people) * (marks @ marks.T)
    theirs = stimuli.within * scenario.planted.recording_sds
    covariance: Samples = found + (theirs @ theirs.T) * (alike[0] @ alike[0].T)
    return covariance


def tabulate_ratings(stimuli: Stimuli, ratings: Samples, metrics: tuple[str, ...]) -> DataFrame:
    """Make a table with a row per rating of one attribute; ratings: (people, n_items, repeats)."""
    import pandas as pd

    who, item, repeat = (axis.ravel() for axis in np.indices(ratings.shape))
    table = pd.DataFrame({
        WHO: who, SCENE: stimuli.scene[item], REDUCER: stimuli.kind[item], ITEM: item, "repeat": repeat + 1,
        RATING: ratings.ravel(), **dict(zip(metrics, stimuli.metrics[item].T, strict=True)),
    })  # fmt: skip
    return table.assign(**{SOURCE: stimuli.source[item]}) if stimuli.has_sources else table
