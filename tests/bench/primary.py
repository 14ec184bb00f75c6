"""How often the primary model is wrong, and how well it knows a slope: `python tests/bench/primary.py [studies]`.

Simulated studies of 12 people, 2 repeats, 6 or 9 reducers on 6 or 12 recordings of the bundled scenes (a second take of
each for 12), with the metrics that these reducers really have there. Ratings depend on no metric; reducers feel
different for other reasons by 0, 3 or 8 points (SD). Adding a slope to such ratings changes no standard error, so the
share of false positives is also that of intervals that miss a planted slope, and power follows for any slope.

First the power of studies planned for 80 %; then whole studies through `fit_primary`, half of them with planted slopes
and ratings cut at the ends of the scale, and their agreement with the same models on one design; then many
more by these directly. Each condition and study has its own seed.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, replace
from functools import cache
from itertools import product
from typing import Any

import numpy as np
import pandas as pd
from scipy.stats import t as student

from feel321.analysis.mixed.design import build_design
from feel321.analysis.mixed.model import Solved, list_spreads, solve_design
from feel321.analysis.mixed.optimum import find_sigma
from feel321.analysis.primary.model import fit_primary
from feel321.analysis.primary.plan import Terms, centre_twice, make_cells, plan_terms
from feel321.analysis.primary.precision import SlopePrecision, find_own, find_variances
from feel321.stimuli.condition import Conditioning, condition
from feel321.stimuli.metrics import METRICS
from feel321.stimuli.reducers.registry import DEFAULT_REDUCERS, REDUCERS
from feel321.stimuli.synthesis import SCENES, make_scene

USED = ["spectral_match_bounded", "temporal_match"]
SIX = ("sax321", "soc321", "mag321", "pca321", "pca321_adaptive", "dft321")
PEOPLE, REPEATS, ALPHA = 12, 2, 0.05
PLANT = {"spectral_match_bounded": 20.0, "temporal_match": 15.0}
"""Points per unit of the metric: 2 and 1.5 per +0.1. With slopes as steep as 4.5 the ends of the scale cut ratings off
and flatten the slopes themselves."""


@dataclass(frozen=True)
class Truth:
    """Standard deviations in points; of slopes, in points per unit of the metric."""

    reducer: float = 0.0
    person_reducer: float = 0.0
    person: float = 8.0
    slope: float = 10.0
    recording: float = 5.0
    item: float = 3.0
    person_recording: float = 3.0
    rating: float = 10.0


SPREADS = {0: Truth(), 3: Truth(3, 2), 8: Truth(8, 4)}


@cache
def measure(scene: str, take: int, reducer: str) -> tuple[float, ...]:
    """The two metrics of a reduced scene."""
    recording = condition(make_scene(scene, rng=take, duration_s=2.0), Conditioning())
    reduced = REDUCERS[reducer](recording.acceleration, recording.rate_hz)
    return tuple(
        float(METRICS[name](recording.acceleration, reduced, recording.rate_hz)) for name in USED
    )


def list_items(n_recordings: int, n_reducers: int) -> pd.DataFrame:
    """One row per stimulus: recording, reducer and both metrics."""
    takes = [(scene, take) for take in range(n_recordings // len(SCENES) + 1) for scene in SCENES][
        :n_recordings
    ]
    names = SIX if n_reducers == len(SIX) else DEFAULT_REDUCERS[:n_reducers]
    rows = [
        {
            "recording": f"{scene}-{take}",
            "reducer": name,
            **dict(zip(USED, measure(scene, take, name), strict=True)),
        }
        for (scene, take), name in product(takes, names)
    ]
    return pd.DataFrame(rows).assign(item=lambda table: table["recording"] + "/" + table["reducer"])


def simulate(
    items: pd.DataFrame, truth: Truth, rng: np.random.Generator, *, people: int = PEOPLE
) -> np.ndarray:
    """Ratings without any slope, shape (people, items, repeats)."""
    scene, kind = (items[name].factorize()[0] for name in ("recording", "reducer"))
    within = items[USED] - items.groupby("recording")[USED].transform("mean")
    n, scenes, kinds = len(items), scene.max() + 1, kind.max() + 1
    everybody = rng.normal(0, truth.item, n) + rng.normal(0, truth.recording, scenes)[scene]
    everybody += rng.normal(0, truth.reducer, kinds)[kind]
    own = (
        rng.normal(0, truth.person, (people, 1))
        + rng.normal(0, truth.slope, (people, 2)) @ within.to_numpy().T
    )
    own = own + rng.normal(0, truth.person_recording, (people, scenes))[:, scene]
    own += rng.normal(0, truth.person_reducer, (people, kinds))[:, kind]
    return 50 + (everybody + own)[:, :, None] + rng.normal(0, truth.rating, (people, n, REPEATS))


def tabulate(items: pd.DataFrame, ratings: np.ndarray) -> pd.DataFrame:
    """One row per rating."""
    who, item, repeat = (axis.ravel() for axis in np.indices(ratings.shape))
    table = items.iloc[item].reset_index(drop=True)
    return table.assign(participant=who, repeat=repeat, rating=ratings.ravel())


class Quick:
    """One of the models, fitted again and again to other ratings of the same design."""

    def __init__(self, items: pd.DataFrame, model: str, *, people: int = PEOPLE) -> None:
        blank = np.random.default_rng(0).normal(size=(people, len(items), 1))
        self.cells = make_cells(tabulate(items, blank), USED)
        plan = plan_terms(self.cells, correlated=False, reducers=model != "without reducers")
        table, within = self.cells.table, [f"{name}_w" for name in USED]
        if model == "reducers fixed":
            random = tuple(term for term in plan.random if term != "(1 | reducer)")
            plan, table = Terms((*plan.fixed, "reducer"), random, ()), centre_twice(table, within)
        self.penalty = () if model == "without penalty" else plan.penalty
        self.design = build_design(plan.formula, table)
        pairs = table[["participant", "item"]].itertuples(index=False, name=None)
        place = {pair: row for row, pair in enumerate(pairs)}
        self.rows = np.array([
            [place[who, item] for item in items["item"]] for who in range(people)
        ])
        self.terms = [self.design.names.index(name) for name in within]

    def fit(self, ratings: np.ndarray) -> list[Any]:
        response = np.empty(ratings[..., 0].size)
        response[self.rows] = ratings.mean(axis=-1)
        solved = solve_design(replace(self.design, response=response), penalty=self.penalty)
        self.spreads = self._read_spreads(solved)
        return [solved.estimate({self.design.names[term]: 1.0}) for term in self.terms]

    def _read_spreads(self, solved: Solved) -> dict[str, float]:
        found = {"reducer": 0.0, "participant:reducer": 0.0}
        found["residual"] = find_sigma(solved.profile, solved.best)
        for group, names, covariance in list_spreads(solved.profile, solved.best):
            for name, sd in zip(names, np.sqrt(np.diag(covariance)), strict=True):
                found[group if name == "(Intercept)" else name] = float(sd)
        return found


def run_quick(model: str, shape: tuple[int, int], spread: int, studies: int) -> np.ndarray:
    """Estimate, standard error and df of both slopes, shape (studies, 2, 3)."""
    items = list_items(*shape)
    quick = Quick(items, model)
    found = []
    for study in range(studies):
        rng = np.random.default_rng([321, *shape, spread, study])
        slopes = quick.fit(simulate(items, SPREADS[spread], rng))
        found.append([(slope.estimate, slope.se, slope.df) for slope in slopes])
    return np.array(found)


def find_power(found: np.ndarray, slope: float) -> float:
    estimate, se, df = np.moveaxis(found, -1, 0)
    return float(np.mean(np.abs(estimate + slope) > student.ppf(1 - ALPHA / 2, df) * se))


def show_quick(models: dict[str, int]) -> None:
    print(
        "recordings reducers SD  model               studies  false: bounded temporal  power at 20, 40 per unit"
    )
    for shape, spread in product(product((6, 12), (6, 9)), SPREADS):
        for model, studies in models.items():
            found = run_quick(model, shape, spread, studies)
            wrong = [find_power(found[:, place : place + 1], 0) for place in (0, 1)]
            power = [find_power(found, slope) for slope in (20.0, 40.0)]
            print(
                f"{shape[0]:10} {shape[1]:8} {spread:2}  {model:18} {studies:8} {wrong[0]:15.3f} {wrong[1]:8.3f} "
                f"{power[0]:10.2f} {power[1]:4.2f}",
                flush=True,
            )


def show_whole(studies: int) -> None:
    """Whole studies, bounded slope planted in every second one; the first of each condition also the quick way."""
    rows, apart = [], []
    for shape, spread in product(product((6, 12), (6, 9)), SPREADS):
        items = list_items(*shape)
        quick = Quick(items, "with reducers")
        slope = sum(PLANT[name] * items[name] for name in USED).to_numpy()
        for study in range(studies):
            planted = study % 2
            ratings = simulate(
                items, SPREADS[spread], np.random.default_rng([322, *shape, spread, study])
            )
            ratings = ratings + planted * (slope - slope.mean())[:, None]
            seen = ratings.clip(0, 100) if planted else ratings
            slopes = fit_primary(tabulate(items, seen), USED, explain=False).slopes
            truth = np.array([PLANT[name] * planted for name in USED])
            missed = (slopes["low"] > truth) | (slopes["high"] < truth)
            rows += [(shape, spread, planted, bool(one)) for one in missed]
            if study < 2:
                other = pd.DataFrame(quick.fit(seen))
                apart.append(
                    np.abs(
                        slopes[["se", "df"]].to_numpy() / other[["se", "df"]].to_numpy() - 1
                    ).max(axis=0)
                )
    table = pd.DataFrame(rows, columns=["shape", "spread", "planted", "missed"])
    print(
        "through fit_primary: share of intervals that miss the slope (planted 0: false positives)"
    )
    print(table.groupby(["planted", "spread"])["missed"].agg(["mean", "size"]).round(3))
    print(table.groupby(["planted", "shape"])["missed"].agg(["mean", "size"]).round(3))
    print(table.groupby("planted")["missed"].agg(["mean", "size"]).round(3))
    print("largest difference of se and df from the quick way:", np.max(apart, axis=0), flush=True)


def plan_study(
    items: pd.DataFrame, spreads: dict[str, float], place: int, *, people: int
) -> SlopePrecision:
    """What estimated spreads say of a study."""
    within = (items[USED] - items.groupby("recording")[USED].transform("mean")).to_numpy()
    kinds = items["reducer"].nunique()
    study = SlopePrecision(
        spreads[f"{USED[place]}_w"],
        spreads["item"],
        spreads["residual"],
        1.0,
        n_participants=people,
        n_recordings=items["recording"].nunique(),
        n_items=len(items),
        n_slopes=len(USED),
        reducer_sd=spreads["reducer"],
        rater_reducer_sd=spreads["participant:reducer"],
        n_reducers=kinds,
        n_alike=len(items) / kinds,
        level=ALPHA / len(USED),
    )
    own, alike = find_own(
        within, place, items["reducer"].factorize()[0], variances=find_variances(study)
    )
    return replace(study, square=float((own**2).sum()), reducer_square=float((alike**2).sum()))


def find_share(slope: float, slopes: list[Any], level: float) -> float:
    """Share of studies that find a slope."""
    return float(
        np.mean([
            abs(one.estimate + slope) > student.ppf(1 - level / 2, one.df) * one.se
            for one in slopes
        ])
    )


def show_plans(studies: int) -> None:
    """Power at Holm's first step for the slope that a study's own spreads call detectable with 80 %, in other studies.

    Beside it what this was for plans without reducers and without Holm.
    """
    print(
        "recordings reducers SD people metric    detectable  found  found for plans without reducers and Holm"
    )
    for shape, spread, people in product(((6, 6), (12, 9)), SPREADS, (12, 24)):
        items = list_items(*shape)
        quick = Quick(items, "with reducers", people=people)
        found, spreads = [], []
        for study in range(studies):
            rng = np.random.default_rng([323, *shape, spread, people, study])
            found.append(quick.fit(simulate(items, SPREADS[spread], rng, people=people)))
            spreads.append(quick.spreads)
        for place, metric in enumerate(USED):
            slopes, level = [one[place] for one in found], ALPHA / len(USED)
            plans = [plan_study(items, one, place, people=people) for one in spreads]
            careless = [
                replace(one, reducer_sd=0, rater_reducer_sd=0, level=ALPHA) for one in plans
            ]
            wanted = np.mean([one.find_slope() for one in plans])
            shares = [
                np.mean([find_share(one.find_slope(), slopes, level) for one in kind])
                for kind in (plans, careless)
            ]
            print(
                f"{shape[0]:10} {shape[1]:8} {spread:2} {people:6} {metric[:8]} {wanted:11.1f} {shares[0]:6.2f} "
                f"{shares[1]:6.2f}",
                flush=True,
            )


if __name__ == "__main__":
    most = int(sys.argv[1]) if len(sys.argv) > 1 else 1000
    show_plans(most // 5)
    show_whole(max(2, 30 * most // 1000))
    show_quick({"with reducers": most, "without reducers": most // 4, "reducers fixed": most // 4})
