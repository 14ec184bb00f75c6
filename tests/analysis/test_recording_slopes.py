"""Recordings differ in their slopes, and in level: the model is that of its covariance, and null studies stay null."""

import numpy as np
import pandas as pd
import pytest

from feel321.analysis.primary.model import fit_primary, fit_slopes, tabulate_slopes
from feel321.analysis.primary.plan import make_cells
from feel321.analysis.primary.sensitivity import judge_level

METRICS = ["sm", "tm"]


def make_null(
    seed: int, *, recordings: int = 11, reducers: int = 9, slope_sd: float = 40.0
) -> pd.DataFrame:
    """12 people's mean ratings, which depend on no metric on average over recordings."""
    rng = np.random.default_rng(seed)
    scene, kind = (axis.ravel() for axis in np.indices((recordings, reducers)))
    metrics = 0.6 + rng.normal(0, 0.2, (reducers, 2))[kind] + rng.normal(0, 0.15, (len(scene), 2))
    slopes = rng.normal(0, slope_sd, (recordings, 2))
    mean = 50 + rng.normal(0, 3, len(scene)) + ((metrics - 0.6) * slopes[scene]).sum(axis=1)
    rating = mean + rng.normal(0, 6, (12, 1)) + rng.normal(0, 8, (12, len(scene)))
    who, item = (axis.ravel() for axis in np.indices(rating.shape))
    return pd.DataFrame({
        "participant": who, "recording": scene[item], "reducer": kind[item], "item": item,
        "sm": metrics[item, 0], "tm": metrics[item, 1], "rating": rating.ravel(),
    })  # fmt: skip


def find_deviance(rows: pd.DataFrame, spreads: pd.DataFrame, residual: float) -> float:
    """-2 log restricted likelihood of the whole covariance matrix, one term after the other."""
    y, n = rows["rating"].to_numpy(), len(rows)
    fixed = rows[["sm_w", "tm_w", "sm_b", "tm_b"]].assign(one=1.0).to_numpy(float)
    covariance = residual**2 * np.eye(n)
    for group, term, sd in spreads[["group", "term", "sd"]].itertuples(index=False):
        codes = rows[group.split(":")].astype(str).agg(":".join, axis=1).factorize()[0]
        column = np.ones(n) if term == "(Intercept)" else rows[term].to_numpy()
        levels = np.eye(codes.max() + 1)[codes] * column[:, None]
        covariance += sd**2 * levels @ levels.T
    weighted = np.linalg.solve(covariance, np.column_stack([fixed, y]))
    inner = fixed.T @ weighted[:, :-1]
    rest = y - fixed @ np.linalg.solve(inner, fixed.T @ weighted[:, -1])
    logs = np.linalg.slogdet(covariance)[1] + np.linalg.slogdet(inner)[1]
    return float(logs + rest @ np.linalg.solve(covariance, rest) + (n - 5) * np.log(2 * np.pi))


def test_the_fit_is_the_best_of_the_whole_covariance_matrix() -> None:
    rows = make_null(1, recordings=5, reducers=8, slope_sd=30.0).query("participant < 5")
    primary = fit_primary(rows, METRICS, explain=False)
    spreads, sigma = primary.fit.variances, primary.fit.residual_sd
    assert primary.penalty == ()
    assert "(1 + sm_w + tm_w || recording)" in primary.formula
    at = find_deviance(primary.model_frame, spreads, sigma)
    assert at == pytest.approx(primary.fit.criterion, abs=1e-6)
    for place in range(len(spreads)):
        for step in (-0.05, 0.05):
            moved = spreads.assign(
                sd=(spreads["sd"] + step * (np.arange(len(spreads)) == place)).abs()
            )
            assert find_deviance(primary.model_frame, moved, sigma) > at - 1e-9


def test_null_studies_whose_recordings_differ_in_their_slopes_find_nothing() -> None:
    """Of 32 tests, 9 were wrong without recordings' slopes; with them as many as chance gives."""
    found = [fit_slopes(make_cells(make_null(seed), METRICS)).table["p"] for seed in range(16)]
    assert (np.array(found) < 0.05).sum() <= 3


def add_level(rows: pd.DataFrame, slope: float = 2.0) -> pd.DataFrame:
    """Levels that go with the first metric, as they do where energy is lost, and ratings that follow them alone."""
    items = rows.drop_duplicates("item").set_index("item")
    noise = np.random.default_rng(7).normal(0, 3, len(items))
    level = rows["item"].map(20 * items["sm"] + noise)
    return rows.assign(sensation_level_db=level, rating=rows["rating"] + slope * level)


@pytest.fixture(scope="module")
def louder() -> pd.DataFrame:
    return add_level(make_null(5, slope_sd=0.0))


def test_ratings_that_follow_level_alone_follow_no_metric(louder: pd.DataFrame) -> None:
    primary = fit_primary(louder, METRICS)
    table = tabulate_slopes({"realism": primary}).set_index("metric")
    assert primary.level == "in_model"
    assert primary.slopes.index.tolist() == METRICS
    assert (table["p_holm"] > 0.05).all()
    reasons = [
        judge_level(primary.level, *row) for row in table[["p_holm", "plain_p_holm"]].to_numpy()
    ]
    assert reasons == ["lost", ""]
    without = fit_primary(louder.drop(columns="sensation_level_db"), METRICS, explain=False)
    assert without.slopes["estimate"].tolist() == pytest.approx(
        primary.slopes["plain"].tolist(), rel=1e-4
    )
    assert without.level == "unknown"
    assert any(note.startswith("Level was not known") for note in without.notes)


def test_a_slope_beside_level_survives_it(louder: pd.DataFrame) -> None:
    planted = louder.assign(rating=louder["rating"] + 40 * louder["tm"])
    primary = fit_primary(planted, METRICS)
    table = tabulate_slopes({"realism": primary}).set_index("metric")
    assert table.loc["tm", "estimate"] == pytest.approx(40, abs=6)
    assert judge_level("in_model", *table.loc["tm", ["p_holm", "plain_p_holm"]]) == "survives"
