"""Simulated studies: stimuli and ratings are drawn with the planted truth, and the primary model is fitted.

Every study has its own seed, of the seed given, the design and its place. Results of a chunk of studies are text that
holds all its numbers exactly; in a folder it has the name of what it was computed from (design, truth, seed, places and
code), so that an interrupted call is continued from there, and any number of workers gives the same numbers.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cached_property
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from feel321 import jobs
from feel321.analysis.mixed.optimum import hold_threads
from feel321.analysis.power.truth import CARELESS, HIGH, LOW, PowerDesign, Truth
from feel321.analysis.primary.model import fit_slopes
from feel321.analysis.primary.plan import ITEM, RATING, REDUCER, SCENE, SOURCE, WHO, make_cells
from feel321.files import make_folder, write_text

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from numpy.typing import NDArray
    from pandas import DataFrame

    from feel321.types import Samples

    Codes = NDArray[np.intp]

STRAIGHT_SD = 1.0
"""Points by which a straight liner's ratings differ."""

STRAIGHT, CLICKER, REVERSER = range(3)
"""Kinds of careless people, in the order of `CARELESS`."""

CHUNK = 50
"""Studies of one job."""


@dataclass(frozen=True, slots=True, eq=False)
class Stimuli:
    """The stimuli of one study; scene, kind, source: codes, (n_items,); metrics: (n_items, n_metrics)."""

    scene: Codes
    kind: Codes
    source: Codes
    metrics: Samples

    @property
    def within(self) -> Samples:
        """Every metric minus its mean over the recording, (n_items, n_metrics)."""
        counts = np.bincount(self.scene).astype(np.float64)
        sums = np.zeros((len(counts), self.metrics.shape[1]))
        np.add.at(sums, self.scene, self.metrics)
        within: Samples = self.metrics - (sums / counts[:, None])[self.scene]
        return within


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
            usual = dict(zip(metrics, points / unit, strict=True))
            return np.array([given.get(name, usual[name]) for name in metrics], dtype=np.float64)

        attributes = self.design.attributes
        return PlantedSlopes(
            np.array([[truth.find_slope(one, name) for name in metrics] for one in attributes]),
            settle(truth.slope_sds, truth.slope_points),
            settle(truth.recording_slope_sds, truth.recording_slope_points),
            self.stimuli.metrics.mean(axis=0),
        )

    @cached_property
    def stimuli(self) -> Stimuli:
        """The stimuli of the whole set."""
        items = self.design.items
        scene, kind = (items[name].factorize()[0] for name in (SCENE, REDUCER))
        source = items[SOURCE if SOURCE in items else SCENE].factorize()[0]
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
    """Draw ratings with the planted slopes and spreads, (n_attributes, people, n_items, repeats)."""
    design, truth, planted = scenario.design, scenario.truth, scenario.planted
    people, scene, kind, n = design.participants, stimuli.scene, stimuli.kind, len(stimuli.scene)
    scenes, kinds, metrics = scene.max() + 1, kind.max() + 1, stimuli.metrics.shape[1]

    def draw(spread: float, *shape: int) -> Samples:
        return rng.normal(0, spread, (len(design.attributes), *shape))

    everybody = truth.mean + draw(truth.item_sd, 1, n)
    everybody += draw(truth.recording_sd, 1, scenes)[..., scene]
    everybody += draw(truth.reducer_sd, 1, kinds)[..., kind]
    own = draw(truth.person_sd, people, 1) + draw(truth.person_item_sd, people, n)
    own += draw(truth.person_recording_sd, people, scenes)[..., scene]
    own += draw(truth.person_reducer_sd, people, kinds)[..., kind]
    own += (draw(1.0, people, metrics) * planted.slope_sds) @ stimuli.within.T
    theirs = (draw(1.0, scenes, metrics) * planted.recording_sds)[:, scene]
    everybody += (theirs * stimuli.within).sum(axis=-1)[:, None]
    points = (everybody + own)[..., None] + draw(truth.rating_sd, people, n, design.repeats)
    points += (planted.slopes @ (stimuli.metrics - planted.centre).T)[:, None, :, None]
    # From percepts to the slider: careful people, with lapses, and careless ones.
    shares, shape = np.cumsum([getattr(truth, name) for name in CARELESS]), points.shape
    if shares[-1] or truth.lapse_rate:
        who = np.searchsorted(shares, rng.random((people, 1, 1)), side="right")
        line = 100 * rng.uniform(0.2, 0.8, (people, 1, 1)) + rng.normal(0, STRAIGHT_SD, shape)
        guess, lapsed = rng.uniform(LOW, HIGH, shape), rng.random(shape) < truth.lapse_rate
        points = np.where(who == REVERSER, LOW + HIGH - points, points)
        points = np.where(lapsed | (who == CLICKER), guess, points)
        points = np.where(who == STRAIGHT, line, points)
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
    several = len(np.unique(stimuli.source)) < len(np.unique(stimuli.scene))
    return table.assign(**{SOURCE: stimuli.source[item]}) if several else table


def simulate_studies(  # noqa: PLR0913 - what, how many, who does it, where it is kept, who watches
    design: PowerDesign,
    truth: Truth,
    *,
    studies: int,
    seed: int = 0,
    workers: jobs.Workers = jobs.ALONE,
    keep: Path | None = None,
    progress: Callable[[int, int], None] = lambda _done, _all: None,
) -> Samples:
    """Simulate studies, or take those that an earlier call kept: p of every test, (studies, n_hypotheses)."""
    listed = [design.items.to_csv(index=False), design.metrics, design.attributes, design.sizes]
    key = int(sha256(repr(listed).encode()).hexdigest()[:16], 16)
    values = {name: getattr(truth, name) for name in truth.__dataclass_fields__ if name != "source"}
    folders = [Path(__file__).parents[1] / name for name in ("mixed", "power", "primary")]
    code = b"\n".join(path.read_bytes() for each in folders for path in sorted(each.glob("*.py")))
    facts = f"{key} {json.dumps(values, sort_keys=True, default=dict)} {seed}".encode()
    digest = sha256(facts + code).hexdigest()[:16]
    if keep is not None:
        make_folder(keep)
    todo: list[jobs.Job] = []
    for start in range(0, studies, CHUNK):
        places = range(start, min(start + CHUNK, studies))
        file = keep and keep / f"studies-{digest}-{places[0]:06d}-{places[-1]:06d}.json"
        options = {"seed": [seed, key], "places": places, "file": file}
        todo.append((_simulate_chunk, (design, truth), options))
    chunks: dict[int, str] = {}
    progress(0, len(todo))
    for place, text in jobs.run_jobs(todo, workers=workers):
        chunks[place] = text
        progress(len(chunks), len(todo))
    found = [one for place in sorted(chunks) for one in json.loads(chunks[place])]
    return np.array(found, np.float64).reshape(studies, len(design.hypotheses))


def _simulate_chunk(
    design: PowerDesign, truth: Truth, *, seed: list[int], places: range, file: Path | None
) -> str:
    """Simulate some studies, and write their results as text, unless they are kept whole."""
    if file and file.is_file():
        text = file.read_text("utf-8")
        try:
            kept: Any = json.loads(text)
        except ValueError:  # damaged
            kept = None
        if isinstance(kept, list) and len(kept) == len(places):
            return text
    scenario = Scenario(design, truth)
    with hold_threads(0):
        found = [_fit_study(scenario, np.random.default_rng([*seed, one])) for one in places]
    text = json.dumps(found)
    if file:
        write_text(file, text)
    return text


def _fit_study(scenario: Scenario, rng: np.random.Generator) -> list[list[float]]:
    """Draw a study and fit every attribute: p of every metric, NaN without a test; (n_attributes, n_metrics)."""
    stimuli, metrics = scenario.draw(rng), scenario.design.metrics
    found = []
    for ratings in draw_ratings(scenario, stimuli, rng):
        try:
            cells = make_cells(tabulate_ratings(stimuli, ratings, metrics), metrics)
            slopes = fit_slopes(cells).table["p"].reindex(metrics).tolist()
        except (ValueError, np.linalg.LinAlgError):  # all ratings alike, or too few units
            slopes = [float("nan")] * len(metrics)
        found.append(slopes)
    return found
