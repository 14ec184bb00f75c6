"""Reducers compared: means, equivalence, and the joint test of a mixed model."""

import math
from collections.abc import Callable

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from feel321.analysis.contrasts.compare import (
    compare_terms,
    equivalence,
    fit_reducers,
    participant_means,
    profile_reducers,
    stimulus_means,
)


def test_means_by_hand() -> None:
    table = pd.DataFrame(
        {
            "scale": "realism", "level": "as_is", "role": "test", "reducer": "dft321",
            "participant": ["a", "a", "a", "b", "b"], "stimulus_id": ["s", "s", "t", "s", "t"],
            "recording": ["s", "s", "t", "s", "t"], "rating": [10.0, 20, 35, 60, 80],
        }
    )  # fmt: skip
    assert list(participant_means(table)["rating"]) == [25, 70]
    row = profile_reducers(table).iloc[0]
    assert (row["mean"], row["n_participants"], row["n_stimuli"], row["n_ratings"]) == (
        47.5,
        2,
        2,
        5,
    )
    assert list(stimulus_means(table)["mean"]) == [(15 + 60) / 2, (35 + 80) / 2]


def test_interval_is_the_t_interval_of_participant_means(tidy: Callable[..., pd.DataFrame]) -> None:
    table = tidy(participants=9)
    profile = profile_reducers(table)
    row = profile[profile["reducer"] == "pca321"].iloc[0]
    means = participant_means(table)
    values = means.loc[means["reducer"] == "pca321", "rating"]
    low, high = stats.t.interval(0.95, 8, values.mean(), stats.sem(values))
    assert (row["low"], row["high"]) == pytest.approx((low, high))


def test_lakens_2017_example() -> None:
    # Moery & Calin-Jageman's study 2 as analysed there (doi 10.1177/1948550617697177): t(182) = -2.69, p = .004
    pooled = math.sqrt((94 * 0.95**2 + 88 * 0.83**2) / 182)
    se = pooled * math.sqrt(1 / 95 + 1 / 89)
    result = equivalence(5.25 - 5.22, se, 182, low=-0.43 * pooled, high=0.43 * pooled)
    assert (round(result.t_high, 2), round(result.p, 3)) == (-2.69, 0.004)
    assert result.p == result.p_high


def test_statsmodels_agrees() -> None:
    from statsmodels.stats.weightstats import ttost_paired

    rng = np.random.default_rng(0)
    x, y = rng.normal(0, 1, 20), rng.normal(0.2, 1, 20)
    p, low, high = ttost_paired(x, y, -0.8, 0.8)
    difference = x - y
    result = equivalence(
        difference.mean(), difference.std(ddof=1) / math.sqrt(20), 19, low=-0.8, high=0.8
    )
    assert (result.p, result.t_low, result.t_high) == pytest.approx((p, low[0], high[0]))
    assert (result.p_low, result.p_high) == pytest.approx((low[1], high[1]))


@settings(deadline=None)  # the first call imports scipy.stats
@given(
    estimate=st.floats(-9, 9), se=st.floats(0.1, 5), df=st.floats(1, 500), low=st.floats(-8, -0.1)
)
def test_the_interval_says_what_p_says(estimate: float, se: float, df: float, low: float) -> None:
    result = equivalence(estimate, se, df, low=low, high=3)
    inside = min(result.low90 - low, 3 - result.high90)
    if abs(inside) > 1e-9:
        assert result.equivalent == (result.p < 0.05) == (inside > 0)
    mirrored = equivalence(-estimate, se, df, low=-3, high=-low)
    assert (mirrored.p_low, mirrored.t_low) == pytest.approx((result.p_high, -result.t_high))


def test_at_the_margin_it_errs_in_five_percent() -> None:
    rng = np.random.default_rng(1)
    samples = rng.normal(2.0, 1, (4000, 30))
    means, errors = samples.mean(axis=1), samples.std(axis=1, ddof=1) / math.sqrt(30)
    hits = [
        equivalence(m, s, 29, low=-2, high=2).equivalent for m, s in zip(means, errors, strict=True)
    ]
    assert 0.04 < np.mean(hits) < 0.06


def test_the_mixed_models_test_is_the_anovas_where_the_design_is_balanced() -> None:
    # One recording, no spread of stimuli: people, and people's own residual, are all that is random.
    rng = np.random.default_rng(5)
    means = 50 + rng.normal(0, 8, (12, 1)) + np.array([0, 2, 5, 3.0]) + rng.normal(0, 4, (12, 4))
    rows = pd.DataFrame(
        [(f"p{who}", f"r{one}", means[who, one]) for who, one in np.ndindex(means.shape)],
        columns=["participant", "reducer", "rating"],
    ).assign(recording="one")
    rows = rows.assign(item=rows["reducer"])
    fit, terms, _ = fit_reducers(rows, ["r0", "r1", "r2", "r3"])
    found = compare_terms(fit, list(terms.values()))
    reducers = means.mean(axis=0) - means.mean()
    left = means - means.mean(axis=1, keepdims=True) - reducers
    f = 12 * (reducers**2).sum() / 3 / ((left**2).sum() / 33)
    assert found.df_1 == 3
    assert found.statistic == pytest.approx(f, rel=1e-3)
    assert found.df_2 == pytest.approx(33, rel=1e-2)
