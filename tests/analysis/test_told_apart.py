"""ABX trials, and one axis against three: dissimilarities from the original beside those of identical pairs."""

import math

import numpy as np
import pandas as pd
import pytest
from scipy import stats
from scipy.stats import beta, binom, norm

from feel321.analysis.choices import EVERY, abx_d_prime, compare_with_original, discriminate


def simulate(d_prime: float, model: str, *, n: int = 200_000) -> float:
    """Share correct of an observer who decides as the model says, without its formula."""
    rng = np.random.default_rng(1)
    a, b, x = rng.normal(0, 1, n), rng.normal(d_prime, 1, n), rng.normal(0, 1, n)  # X is A
    if model == "differencing":
        return float(np.mean(np.abs(x - a) < np.abs(x - b)))
    # Likelihoods of <A, B, A> plus <B, A, B> against <A, B, B> plus <B, A, A>, positions not known to be ordered
    first, third = (a - b) / math.sqrt(2), x - d_prime / 2
    return float(np.mean((first < 0) == (third < 0)))


@pytest.mark.parametrize("model", ["independent", "differencing"])
@pytest.mark.parametrize("d_prime", [0.5, 1.5, 3.0])
def test_the_model_is_what_an_observer_does(model: str, d_prime: float) -> None:
    assert abx_d_prime(simulate(d_prime, model), model=model) == pytest.approx(d_prime, abs=0.04)


@pytest.mark.parametrize("share", [0.51, 0.6, 0.75, 0.9, 0.99])
def test_the_formulas_of_macmillan_and_creelman(share: float) -> None:
    d = abx_d_prime(share)
    assert norm.cdf(d / math.sqrt(2)) * norm.cdf(d / 2) + norm.cdf(-d / math.sqrt(2)) * norm.cdf(
        -d / 2
    ) == (pytest.approx(share, abs=1e-9))
    d = abx_d_prime(share, model="differencing")
    assert norm.cdf(d / math.sqrt(2)) * norm.cdf(d / math.sqrt(6)) + norm.cdf(
        -d / math.sqrt(2)
    ) * norm.cdf(-d / math.sqrt(6)) == pytest.approx(share, abs=1e-9)
    assert d > abx_d_prime(share)


def test_share_and_intervals_by_their_definitions() -> None:
    k, n, z = 18, 24, norm.ppf(0.975)
    result = discriminate(k, n)
    middle, half = (
        (k + z**2 / 2) / (n + z**2),
        z / (n + z**2) * math.sqrt(k * (n - k) / n + z**2 / 4),
    )
    assert (result.wilson_low, result.wilson_high) == pytest.approx((middle - half, middle + half))
    assert result.exact_low == pytest.approx(beta.ppf(0.025, k, n - k + 1))
    assert result.exact_high == pytest.approx(beta.ppf(0.975, k + 1, n - k))
    assert result.p == pytest.approx(binom.sf(k - 1, n, 0.5))
    assert result.d_independent_low == pytest.approx(abx_d_prime(result.wilson_low))
    assert result.d_differencing_high == pytest.approx(
        abx_d_prime(result.wilson_high, model="differencing")
    )


@pytest.mark.parametrize("truth", [0.5, 0.6, 0.8])
def test_the_intervals_cover(truth: float) -> None:
    weights = binom.pmf(np.arange(41), 40, truth)
    results = [discriminate(k, 40) for k in range(41)]
    assert 0.92 < weights @ [r.wilson_low <= truth <= r.wilson_high for r in results] < 0.97
    assert 0.95 <= weights @ [r.exact_low <= truth <= r.exact_high for r in results] < 0.99


APART = {"saz321": 20.0, "dft321": 0.0}
"""Planted: points by which a reducer feels farther from the original than the original itself does."""


def plant(
    people: int = 40, recordings: int = 12, *, sd: float = 10.0, seed: int = 0
) -> pd.DataFrame:
    rng = np.random.default_rng(seed)
    kinds = {"original": (0.0, "reference"), **{name: (far, "test") for name, far in APART.items()}}
    rows = [
        (f"p{who}", name, "original", role, 40 + far + rng.normal(0, sd))
        for who in range(people)
        for _ in range(recordings)
        for name, (far, role) in kinds.items()
    ]
    columns = ["participant", "reducer", "reference_reducer", "role", "rating"]
    return pd.DataFrame(rows, columns=columns).assign(scale="dissimilarity", level="as_is")


def test_a_planted_distance_is_recovered_and_none_is_not_claimed() -> None:
    held = []
    for seed in range(8):
        found = compare_with_original(plant(seed=seed)).set_index("reducer")
        far, same = found.loc["saz321"], found.loc["dft321"]
        mean = (far["difference"] + same["difference"]) / 2
        assert found.loc[EVERY, "difference"] == pytest.approx(mean)
        assert far["p_holm"] < 1e-6
        held += [
            far["low"] < APART["saz321"] < far["high"],
            far["d_prime_low"] < 2.0 < far["d_prime_high"],
            same["low"] < 0 < same["high"],
            same["area_low"] < 0.5 < same["area_high"],
        ]
    assert sum(held) >= 27  # of 32, at 95 % each


def test_the_contrast_is_a_paired_t_test_over_participants() -> None:
    rows = plant(people=6, recordings=3)
    own = rows.pivot_table("rating", "participant", "reducer")
    expected = stats.ttest_rel(own["saz321"], own["original"])
    found = compare_with_original(rows).set_index("reducer").loc["saz321"]
    assert found["t"] == pytest.approx(expected.statistic)
    assert found["p"] == pytest.approx(expected.pvalue)
    ends = expected.confidence_interval()
    assert (found["low"], found["high"]) == pytest.approx((ends.low, ends.high))
