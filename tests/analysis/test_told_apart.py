"""One axis against three: dissimilarities from the original beside those of identical pairs."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from feel321.analysis.contrasts.told_apart import EVERY, compare_with_original

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
