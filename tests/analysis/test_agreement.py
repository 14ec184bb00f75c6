from __future__ import annotations

import math

import numpy as np
import pytest

from feel321.analysis.agreement import LEVELS, krippendorff_alpha


def make_table(
    seed: int = 0, *, missing: float = 0.2, targets: int = 14, raters: int = 5
) -> np.ndarray:
    rng = np.random.default_rng(seed)
    table = np.clip(
        np.round(rng.uniform(0, 6, (targets, 1)) + rng.normal(0, 1, (targets, raters))), 0, 7
    )
    table[rng.uniform(size=table.shape) < missing] = np.nan
    table[0, 0] = table[0, 1] = 3
    return table


def brute_alpha(table: np.ndarray, level: str) -> float:
    """Sum over all pairs, as the definition says."""
    rows = [row[np.isfinite(row)] for row in table]
    rows = [row for row in rows if len(row) > 1]
    pool = np.concatenate(rows)

    def distance(v: float, w: float) -> float:
        if level == "nominal":
            return float(v != w)
        if level == "ordinal":
            between = ((pool >= min(v, w)) & (pool <= max(v, w))).sum()
            return (
                0.0 if v == w else float(between - ((pool == v).sum() + (pool == w).sum()) / 2) ** 2
            )
        return (v - w) ** 2 if level == "interval" else ((v - w) / (v + w)) ** 2 if v + w else 0.0

    def pairs(values: np.ndarray) -> float:
        return sum(
            distance(v, w) for i, v in enumerate(values) for j, w in enumerate(values) if i != j
        )

    observed = sum(pairs(row) / (len(row) - 1) for row in rows) / len(pool)
    return 1 - observed / (pairs(pool) / (len(pool) * (len(pool) - 1)))


@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize("missing", [0.0, 0.35])
def test_alpha_by_its_definition(level: str, missing: float) -> None:
    for seed in range(4):
        table = make_table(seed, missing=missing)
        assert krippendorff_alpha(table, level=level) == pytest.approx(
            brute_alpha(table, level), abs=1e-12
        )


@pytest.mark.parametrize("level", LEVELS)
def test_perfect_agreement_is_one_and_noise_is_none(level: str) -> None:
    rng = np.random.default_rng(3)
    assert krippendorff_alpha(
        np.repeat(np.arange(8.0)[:, None], 4, axis=1), level=level
    ) == pytest.approx(1)
    assert krippendorff_alpha(rng.integers(1, 6, (400, 4)), level=level) == pytest.approx(
        0, abs=0.06
    )


@pytest.mark.parametrize("level", LEVELS)
def test_equal_ratings_have_no_alpha(level: str) -> None:
    table = np.full((5, 3), 33.3)
    assert math.isnan(krippendorff_alpha(table, level=level))


def test_names_agree_as_numbers_do() -> None:
    table = make_table(2)
    names = [[None if np.isnan(one) else f"scene {one:.0f}" for one in row] for row in table]
    assert krippendorff_alpha(names, level="nominal") == krippendorff_alpha(table, level="nominal")
    with pytest.raises(ValueError, match="table must hold numbers: could not convert string"):
        krippendorff_alpha(names, level="ordinal")


def test_a_slider_of_many_values_needs_little_memory() -> None:
    # targets x values x values, as the textbook table has it, would be 500 x 20 000 x 20 000 cells.
    rng = np.random.default_rng(0)
    table = rng.uniform(0, 100, (500, 1)) + rng.normal(0, 10, (500, 40))
    alpha = krippendorff_alpha(table)
    assert krippendorff_alpha(table, level="ordinal") == pytest.approx(alpha, abs=0.03)
    assert math.isfinite(krippendorff_alpha(np.abs(table[:, :6]), level="ratio"))


@pytest.mark.parametrize(
    ("table", "level", "message"),
    [
        ([[1, 2]], "cardinal", "level must be one of nominal, ordinal, interval, ratio"),
        ([1, 2], "interval", "table must have shape .targets, raters., got shape .2,."),
        (
            [[1, math.inf]],
            "interval",
            "table must be finite, got 1 infinite values, first in row 0",
        ),
        ([[1, -2]], "ratio", "table must not be negative on a ratio scale, got -2.0"),
        (
            [[1, math.nan], [math.nan, 2]],
            "interval",
            "table must have a target with two ratings, got 2 without",
        ),
    ],
)
def test_bad_input_is_refused_in_words(table: list[object], level: str, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        krippendorff_alpha(table, level=level)
