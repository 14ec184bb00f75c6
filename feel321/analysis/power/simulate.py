"""Simulated studies: ratings are drawn with the planted truth, and the primary model is fitted.

Every study has its own seed, of the seed given, the design and its place: any number of workers gives the same numbers.
In a folder the results of a chunk of studies have the name of what they were computed from (design, truth, seed, places
and code), so that an interrupted call is continued from there: a study of 16 people and 72 stimuli takes half a second.
"""

from __future__ import annotations

import json
import math
from dataclasses import asdict
from hashlib import sha256
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from feel321 import jobs
from feel321.analysis.mixed.optimum import hold_threads
from feel321.analysis.power.design import LEVEL, PowerDesign, Stimuli
from feel321.analysis.primary.model import adjust_holm, fit_slopes
from feel321.analysis.primary.plan import ITEM, RATING, REDUCER, SCENE, SOURCE, WHO, make_cells
from feel321.files import make_folder, write_text

if TYPE_CHECKING:
    from collections.abc import Callable

    from pandas import DataFrame

    from feel321.types import Samples

CHUNK = 50  # Studies of one job
LOW, HIGH = 0.0, 100.0  # Ends of the scale

SIMULATED = ("simulated", "simulated_low", "simulated_high")


def draw_ratings(design: PowerDesign, stimuli: Stimuli, rng: np.random.Generator) -> Samples:
    """Draw ratings with the planted slopes and spreads, (n_attributes, people, n_items, repeats)."""
    truth = design.truth
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
    own += (draw(1.0, people, metrics) * design.slope_sds) @ stimuli.within.T
    theirs = (draw(1.0, scenes, metrics) * design.recording_slope_sds)[:, scene]
    everybody += (theirs * stimuli.within).sum(axis=-1)[:, None]
    points = (everybody + own)[..., None] + draw(truth.rating_sd, people, n, design.repeats)
    centred = stimuli.metrics - design.stimuli.metrics.mean(axis=0)
    found = [truth.find_slope(*hypothesis) for hypothesis in design.hypotheses]
    slopes = np.array(found, np.float64).reshape(len(design.attributes), -1)
    points += (slopes @ centred.T)[:, None, :, None]
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


def simulate_studies(
    design: PowerDesign,
    *,
    studies: int,
    seed: int = 0,
    workers: int | jobs.Workers = 1,
    keep: Path | None = None,
    progress: Callable[[int, int], None] = lambda _done, _all: None,
) -> Samples:
    """Simulate studies, or take those that an earlier call kept: p of every test, (studies, n_hypotheses)."""
    listed = [design.items.to_csv(index=False), design.metrics, design.attributes, design.sizes]
    key = int(sha256(repr(listed).encode()).hexdigest()[:16], 16)
    folders = [Path(__file__).parents[1] / name for name in ("mixed", "power", "primary")]
    code = b"\n".join(path.read_bytes() for each in folders for path in sorted(each.glob("*.py")))
    digest = sha256(f"{key} {asdict(design.truth)} {seed}".encode() + code).hexdigest()[:16]
    if keep is not None:
        make_folder(keep)
    todo: list[jobs.Job] = []
    for start in range(0, studies, CHUNK):
        places = range(start, min(start + CHUNK, studies))
        file = keep and keep / f"studies-{digest}-{places[0]:06d}-{places[-1]:06d}.json"
        todo.append((_simulate_chunk, (design, [seed, key], places, file), {}))
    steps = count(1)
    progress(0, len(todo))
    found = jobs.gather_results(
        todo, workers=workers, done=lambda: progress(next(steps), len(todo))
    )
    return np.concatenate([np.empty((0, len(design.hypotheses))), *found])


def _simulate_chunk(  # noqa: PLR0917 - a job, by place
    design: PowerDesign, seed: list[int], places: range, file: Path | None
) -> Samples:
    """Simulate some studies, unless their results are kept whole."""
    shape = len(places), len(design.hypotheses)
    if file and file.is_file():
        try:
            kept = np.array(json.loads(file.read_text("utf-8")), np.float64)
        except (TypeError, ValueError):  # damaged
            kept = np.empty(0)
        if kept.shape == shape:
            return kept
    with hold_threads(0):
        found = [_fit_study(design, np.random.default_rng([*seed, one])) for one in places]
    p = np.array(found, np.float64).reshape(shape)
    if file:
        write_text(file, json.dumps(p.tolist()))
    return p


def _fit_study(design: PowerDesign, rng: np.random.Generator) -> list[list[float]]:
    """Draw a study and fit every attribute: p of every metric, NaN without a test; (n_attributes, n_metrics)."""
    stimuli, metrics = design.draw(rng), design.metrics
    found = []
    for ratings in draw_ratings(design, stimuli, rng):
        try:
            cells = make_cells(tabulate_ratings(stimuli, ratings, metrics), metrics)
            slopes = fit_slopes(cells).table["p"].reindex(metrics).tolist()
        except (ValueError, np.linalg.LinAlgError):  # all ratings alike, or too few units
            slopes = [math.nan] * len(metrics)
        found.append(slopes)
    return found


def tabulate_shares(p: Samples) -> DataFrame:
    """Tabulate the share of studies that find each slope by Holm's method; p: (studies, n_hypotheses).

    ``simulated`` with its 95 % Wilson interval ``simulated_low simulated_high``, NaN without studies; ``tests``: the
    studies that gave a test.
    """
    import pandas as pd
    from scipy.stats import binomtest

    adjusted = np.array([adjust_holm(row) for row in p.tolist()]).reshape(p.shape)
    rows = []
    for column in adjusted.T:
        known = int(np.isfinite(column).sum())
        share = low = high = math.nan
        if known:
            found = binomtest(int((column < LEVEL).sum()), known)
            share, (low, high) = float(found.statistic), found.proportion_ci(method="wilson")
        rows.append((share, float(low), float(high), known))
    return pd.DataFrame(rows, columns=[*SIMULATED, "tests"])
