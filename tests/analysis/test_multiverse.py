from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from feel321.analysis.association.correlate import Association, correlate
from feel321.analysis.primary.multiverse import run_multiverse

if TYPE_CHECKING:
    from collections.abc import Callable

    import pandas as pd

RULES = ["hidden_reference", "low_anchor", "straight_lining"]


@pytest.fixture
def ratings(tidy: Callable[..., pd.DataFrame]) -> pd.DataFrame:
    """Ten raters: p01 breaks the first rule, p02 the first and the second, nobody the third."""
    table = tidy(participants=10, noise=4).assign(protocol="mushra")
    table.loc[table["role"] == "reference", "rating"] = 99.0
    table.loc[table["role"] == "anchor", "rating"] = 20.0
    table.loc[
        table["participant"].isin(["p01", "p02"]) & (table["role"] == "reference"), "rating"
    ] = 60.0
    table.loc[(table["participant"] == "p02") & (table["reducer"] == "anchor_low"), "rating"] = 90.0
    return table


def mean_rating(table: pd.DataFrame) -> float:
    return float(table["rating"].mean())


def test_a_universe_is_a_set_of_raters(ratings: pd.DataFrame) -> None:
    found = run_multiverse(ratings, mean_rating, rules=RULES, together=1)
    table = found.table
    assert table["universe"].tolist() == ["none", *RULES[:2]]
    every = " + ".join(RULES)
    combined = ["none; straight_lining", f"hidden_reference; {every}", "low_anchor"]
    assert table["combinations"].tolist() == combined
    assert table["n_combinations"].tolist() == [2, 2, 1]
    assert table["excluded"].tolist() == [(), ("p01", "p02"), ("p02",)]
    assert table["n_participants"].tolist() == [10, 8, 9]
    assert table[RULES].to_numpy().tolist() == [
        [False] * 3,
        [True, False, False],
        [False, True, False],
    ]


@pytest.mark.parametrize(
    ("together", "combinations"), [(1, 1 + 3 + 1), (2, 1 + 3 + 3 + 1), (9, 2**3)]
)
def test_none_each_combinations_and_all_are_counted(
    ratings: pd.DataFrame, together: int, combinations: int
) -> None:
    found = run_multiverse(ratings, mean_rating, rules=RULES, together=together)
    assert (found.n_combinations, found.n_distinct, len(found.table)) == (combinations, 3, 3)


def test_rules_that_flag_nobody_do_not_weigh(ratings: pd.DataFrame) -> None:
    few = run_multiverse(ratings, mean_rating, rules=["hidden_reference", "low_anchor"])
    more = run_multiverse(
        ratings, mean_rating, rules=[*RULES, "too_fast", "reversed_scale"], together=5
    )
    assert more.n_combinations == 2**5 > few.n_combinations
    for name in ("n_distinct", "median", "smallest", "largest", "same_sign"):
        assert getattr(more, name) == getattr(few, name)


def test_values_are_those_of_the_raters_left(ratings: pd.DataFrame) -> None:
    asked = []

    def estimator(table: pd.DataFrame) -> float:
        asked.append(table["participant"].nunique())
        return mean_rating(table)

    found = run_multiverse(ratings, estimator, rules=RULES)
    for _, row in found.table.iterrows():
        left = ratings[~ratings["participant"].isin(row["excluded"])]
        assert row["value"] == pytest.approx(mean_rating(left))
    assert sorted(asked) == [8, 9, 10]  # once per set of raters
    assert found.n_distinct == 3
    values = found.table["value"]
    assert (found.smallest, found.median, found.largest) == (
        values.min(),
        values.median(),
        values.max(),
    )
    assert found.same_sign == 1
    assert math.isnan(found.beyond_zero)
    assert found.curve["value"].is_monotonic_increasing
    assert "Rules that flagged nobody, and so change nothing: straight_lining." in found.notes


def test_a_result_brings_its_interval(ratings: pd.DataFrame) -> None:
    def estimator(table: pd.DataFrame) -> Association:
        return correlate(table, "spectral_match", draws=50, rng=np.random.default_rng(1))

    found = run_multiverse(ratings, estimator, rules=RULES)
    whole = estimator(ratings)
    assert found.table.loc[0, ["value", "low", "high"]].tolist() == [
        whole.value,
        whole.low,
        whole.high,
    ]
    assert found.beyond_zero == ((found.table["low"] > 0) | (found.table["high"] < 0)).mean()


@pytest.mark.parametrize(
    ("result", "beyond"), [((1.0, -1.0, 2.0), 0.0), ((-2.0, -3.0, -1.0), 1.0), ([3, 1, 4], 1.0)]
)
def test_three_numbers_are_an_interval(ratings: pd.DataFrame, result: Any, beyond: float) -> None:
    found = run_multiverse(ratings, lambda _: result, rules=RULES)
    assert found.table.loc[0, ["value", "low", "high"]].tolist() == list(result)
    assert found.beyond_zero == beyond


def test_a_sign_that_turns_is_counted(ratings: pd.DataFrame) -> None:
    found = run_multiverse(
        ratings, lambda table: table["participant"].nunique() - 8.5, rules=RULES, together=1
    )
    assert found.same_sign == 2 / 3
    # The sign of the first universe is what counts, also where it is below zero.
    turned = run_multiverse(
        ratings, lambda table: 8.5 - table["participant"].nunique(), rules=RULES, together=1
    )
    assert turned.same_sign == 2 / 3


def test_what_cannot_be_estimated_says_why(ratings: pd.DataFrame) -> None:
    def estimator(table: pd.DataFrame) -> float:
        if table["participant"].nunique() == 8:
            raise ValueError("eight are too few")
        return math.nan if table["participant"].nunique() == 9 else 1.0

    found = run_multiverse(ratings, estimator, rules=RULES, together=1)
    assert found.table["note"].tolist() == ["", "eight are too few", "the estimator gave NaN"]
    assert "Universe 'hidden_reference' has no value: eight are too few." in found.notes
    assert len(found.curve) == 1


def test_nobody_left(ratings: pd.DataFrame) -> None:
    few = ratings[ratings["participant"].isin(["p01", "p02"])]
    found = run_multiverse(few, lambda _: math.nan, rules=["hidden_reference"])
    assert found.table["note"].tolist() == [
        "the estimator gave NaN",
        "every participant is excluded",
    ]
    assert found.curve.empty
    assert all(
        math.isnan(value)
        for value in (found.median, found.smallest, found.largest, found.same_sign)
    )


def test_faults_of_the_estimator_are_passed_on(ratings: pd.DataFrame) -> None:
    with pytest.raises(ZeroDivisionError):
        run_multiverse(ratings, lambda _: 1 / 0, rules=RULES)


@pytest.mark.parametrize("result", ["much", None, (1, 2, 3, 4, 5), {}])
def test_other_results_are_refused(ratings: pd.DataFrame, result: object) -> None:
    with pytest.raises(TypeError, match=r"estimator must give a number"):
        run_multiverse(ratings, lambda _: result, rules=RULES)


def test_together_is_one_or_more(ratings: pd.DataFrame) -> None:
    with pytest.raises(ValueError, match="together must be 1 or more rules"):
        run_multiverse(ratings, mean_rating, together=0)
