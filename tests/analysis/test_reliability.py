from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from analysis.reliability import intraclass, noise_ceiling


@given(seed=st.integers(0, 10_000), gain=st.floats(0.1, 50), shift=st.floats(-100, 100))
def test_consistency_ignores_unit_and_rater_levels(seed: int, gain: float, shift: float) -> None:
    rng = np.random.default_rng(seed)
    table = rng.normal(size=(7, 4)) + rng.normal(size=(7, 1))
    moved = gain * table + shift * np.arange(4)
    assert intraclass(moved).icc_c_k == pytest.approx(intraclass(table).icc_c_k, abs=1e-8)


def test_agreement_falls_when_raters_differ_in_level() -> None:
    table = np.arange(6.0)[:, None] + np.array([0.0, 5.0, 10.0])
    icc = intraclass(table)
    assert icc.icc_c_k == pytest.approx(1)
    assert icc.icc_a_k < 0.6


def test_ceiling_recovers_the_correlation_with_the_truth() -> None:
    rng = np.random.default_rng(5)
    truth = rng.normal(size=4000)
    table = truth[:, None] + rng.normal(0, 2, (4000, 8))
    reached = np.corrcoef(truth, table.mean(axis=1))[0, 1]
    assert noise_ceiling(table) == pytest.approx(reached, abs=0.01)
    assert reached == pytest.approx(math.sqrt(1 / (1 + 4 / 8)), abs=0.01)


def test_noise_alone_has_no_ceiling() -> None:
    # Raters who contradict each other: targets differ less than noise would let them.
    assert math.isnan(noise_ceiling([[0, 10], [10, 0.5], [0, 10]]))


@pytest.mark.parametrize("rating", [50.0, 33.3, 71.7, 99.9])
@pytest.mark.parametrize("offset", [0.0, -11.1])
def test_equal_ratings_are_undefined_not_perfect(rating: float, offset: float) -> None:
    for shape in ((3, 3), (36, 6), (48, 7)):
        table = np.full(shape, rating) + offset * np.arange(shape[1]) / 3
        assert math.isnan(intraclass(table).icc_c_k)
        assert math.isnan(noise_ceiling(table))


@pytest.mark.parametrize("table", [[[1, 2]], [[1], [2]], [1, 2, 3]])
def test_tables_too_small_are_refused(table: list[object]) -> None:
    with pytest.raises(ValueError, match=r"table: got shape .*allowed is \(targets, raters\), at least 2 by 2"):
        intraclass(table)


def test_holes_are_refused() -> None:
    with pytest.raises(ValueError, match="table: got 1 cells that are not finite"):
        noise_ceiling([[1, 2], [math.nan, 3]])
