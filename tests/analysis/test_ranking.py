"""Metrics ranked: planted ones are named, none where nothing is planted; the numbers are those of plain loops."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from feel321.analysis.association.rivals import Folds, rank_metrics
from feel321.analysis.table.items import Items, make_items
from feel321.types import MetricInfo

PEOPLE, RECORDINGS, REDUCERS = 12, 8, 6
REDUCER = np.tile(np.arange(REDUCERS), RECORDINGS)
RECORDING = np.repeat(np.arange(RECORDINGS), REDUCERS)
NAMES = [*(f"m{number:02d}" for number in range(11)), "level_difference"]


def make_study(
    seed: int, *, planted: float = 0.0, reducer_sd: float = 0.0
) -> tuple[pd.DataFrame, np.ndarray]:
    """Make ratings, and metrics that resemble each other as those of reducers do; m03 says something if planted."""
    rng = np.random.default_rng([321, seed])
    size = len(REDUCER)
    common = rng.normal(size=size)
    metrics = {
        name: 0.4 * common + 0.6 * rng.normal(size=REDUCERS)[REDUCER] + 0.5 * rng.normal(size=size)
        for name in NAMES
    }
    felt = 50 + planted * metrics["m03"] + rng.normal(0, 6, RECORDINGS)[RECORDING]
    felt += rng.normal(0, 8, size) + rng.normal(0, reducer_sd, REDUCERS)[REDUCER]
    rows = pd.DataFrame({
        "participant": np.repeat(np.arange(PEOPLE), size),
        "recording": np.tile(RECORDING, PEOPLE),
        "reducer": np.tile(REDUCER, PEOPLE),
        **{name: np.tile(values, PEOPLE) for name, values in metrics.items()},
    })
    noise = np.repeat(rng.normal(0, 8, PEOPLE), size) + rng.normal(0, 10, len(rows))
    return rows.assign(rating=np.tile(felt, PEOPLE) + noise), felt


def correlate_plainly(rows: pd.DataFrame, metric: str) -> float:
    """Correlate out of fold, recording by recording."""
    items = rows.groupby(["recording", "reducer"])[[metric, "rating"]].mean()
    items -= items.groupby("recording").transform("mean")
    predicted = []
    for recording, own in items.groupby("recording"):
        rest = items.drop(recording, level="recording")
        slope = max(0.0, (rest[metric] * rest["rating"]).sum() / (rest[metric] ** 2).sum())
        predicted.append(slope * own[metric])
    found = pd.concat(predicted)
    both = np.sqrt((found**2).sum() * (items["rating"] ** 2).sum())
    return float((found * items["rating"]).sum() / both) if both else 0.0


def test_values_are_those_of_plain_loops() -> None:
    rows, _ = make_study(1, planted=6.0)
    ranking = rank_metrics(rows, NAMES)
    expected = {name: correlate_plainly(rows, name) for name in NAMES}
    assert ranking.table["value"].to_dict() == pytest.approx(expected)
    assert ranking.best == max(expected, key=lambda name: expected[name])
    # Votes that are missing weigh stimuli by who is left; a duplicate changes nothing.
    thin = rows.drop(rows.index[::7])
    assert rank_metrics(thin, NAMES).table.loc["m03", "value"] == pytest.approx(
        correlate_plainly(thin.groupby(["recording", "reducer"]).mean().reset_index(), "m03")
    )


def count_claims(seeds: range, *, reducer_sd: float) -> dict[str, int]:
    """Count the studies without any effect in which something is claimed."""
    found = dict.fromkeys(("better", "predicts", "alone"), 0)
    for seed in seeds:
        ranking = rank_metrics(make_study(seed, reducer_sd=reducer_sd)[0], NAMES, rng=seed)
        table = ranking.table
        found["better"] += bool(ranking.better)
        found["predicts"] += bool(((table["p"] < 0.05) & (table["value"] > 0)).any())
        found["alone"] += ranking.alone
    return found


def test_where_nothing_is_planted_nothing_is_said() -> None:
    # Reducers far apart for reasons that no metric knows: of 20 at 5 %, more than 5 in 3 of 10 000 runs.
    assert max(count_claims(range(1000, 1020), reducer_sd=25.0).values()) <= 5


@pytest.mark.soak
@pytest.mark.parametrize("reducer_sd", [0.0, 3.0, 8.0])
def test_false_claims_keep_to_five_percent(reducer_sd: float) -> None:
    # Of 120 at 5 %: more than 14 in 2 of 1000 runs.
    assert max(count_claims(range(5000, 5120), reducer_sd=reducer_sd).values()) <= 14


def find_weighted_z(items: Items, counts: dict[str, np.ndarray]) -> np.ndarray:
    """Correlate out of fold with people, recordings and reducers counted as often as they say."""
    seen = np.isfinite(items.ratings)
    votes = counts["people"] @ seen
    means = counts["people"] @ np.where(seen, items.ratings, 0) / votes
    weights, scenes = counts["reducers"][items.reducers], counts["scenes"]
    found = []
    for metric in items.metrics:
        sums = []
        for number in range(items.n_recordings):
            own = items.recordings == number
            w, x, y = weights[own], metric[own], means[own]
            x, y = x - np.average(x, weights=w), y - np.average(y, weights=w)
            sums.append(scenes[number] * np.array([w @ (x * y), w @ x**2, w @ y**2]))
        xy, xx, yy = np.array(sums).T
        apart = items.of_source[:, None] != items.of_source
        slope = np.maximum(apart @ xy / (apart @ xx), 0)
        found.append((slope @ xy) / np.sqrt((slope**2 @ xx) * yy.sum()))
    return np.arctanh(found)


def test_influences_are_the_derivatives_by_how_often_each_is_drawn() -> None:
    rows = make_study(1, planted=6.0)[0]
    rows = rows.drop(rows.index[::7]).assign(source=lambda table: table["recording"] // 2 * 2)
    items = make_items(rows, NAMES)
    influences, step = Folds(items).find_influences(), 1e-5
    sizes = {"people": items.n_participants, "scenes": items.n_recordings}
    sizes["reducers"] = items.n_reducers
    members = {
        "people": np.arange(items.n_participants)[:, None] * np.ones((1, items.n_items)),
        "scenes": items.recordings[None, :] * np.ones((items.n_participants, 1)),
        "reducers": items.reducers[None, :] * np.ones((items.n_participants, 1)),
    }
    for factor, number in ((one, each) for one in sizes for each in (0, 3)):
        ends = []
        for change in (-step, step):
            counts = {name: np.ones(size) for name, size in sizes.items()}
            counts[factor][number] += change
            ends.append(find_weighted_z(items, counts))
        own = (influences * (members[factor] == number)).sum(axis=(1, 2))
        assert own == pytest.approx((ends[1] - ends[0]) / (2 * step), abs=1e-7)
        assert np.abs(own).max() > 0.01


def test_what_holds_for_other_reducers_takes_five_of_them() -> None:
    rows = make_study(2, planted=25.0)[0]
    few = rank_metrics(rows[rows["reducer"] < 4], NAMES)
    assert few.table[["p", "low", "high", "over_p"]].isna().all(axis=None)
    assert (few.better, few.alone, len(few.candidates)) == ((), False, len(NAMES))
    assert "4 reducers, where 5 are needed for an interval." in few.notes
    enough = rank_metrics(rows[rows["reducer"] < 5], NAMES)
    assert enough.table["p"].notna().all()
    assert enough.table.loc["m03", "p"] < 0.05
    # Stimuli of which nothing says how they were made: other participants and recordings only.
    unknown = rank_metrics(
        rows.assign(stimulus=rows["reducer"] + 6 * rows["recording"]).drop(columns="reducer"), NAMES
    )
    assert unknown.n_reducers == 0
    assert unknown.notes[-1].startswith("No reducer made stimuli of several recordings")
    assert unknown.table.loc["m03", "p"] < 0.05


def test_a_planted_metric_is_named_and_stays_in_the_set_of_the_best() -> None:
    found = [
        rank_metrics(make_study(2000 + seed, planted=25.0)[0], NAMES, rng=seed)
        for seed in range(12)
    ]
    assert all(one.best == "m03" and "m03" in one.candidates for one in found)
    assert sum("m03" in one.better for one in found) >= 5
    assert sum(one.alone for one in found) >= 2


def test_direction_is_that_which_is_declared() -> None:
    rows, _ = make_study(4, planted=25.0)
    worse = rows.assign(distance=100 - 7 * rows["m03"]).drop(columns="m03")
    names = ["distance", *(name for name in NAMES if name != "m03")]
    info = {"distance": MetricInfo("distance", higher="worse")}
    ranking = rank_metrics(worse, names, info=info)
    plain = rank_metrics(rows, NAMES)
    assert ranking.best == "distance"
    assert ranking.table.loc["distance", "value"] == pytest.approx(plain.table.loc["m03", "value"])
    # Undeclared, higher is taken for better, and it predicts nothing that way.
    assert rank_metrics(worse, names).table.loc["distance", "value"] == 0


# In the report.
