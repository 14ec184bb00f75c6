from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
import pytest

from feel321.analysis.figures.choices import draw_multiverse
from feel321.analysis.primary.multiverse import Multiverse, run_multiverse

if TYPE_CHECKING:
    from collections.abc import Callable

    from matplotlib.figure import Figure


def draw(result: Multiverse) -> Figure:
    counts = (result.n_combinations, len(result.table) - len(result.curve))
    rules = result.screening.rules
    return draw_multiverse(result.curve, rules=rules, counts=counts)


def estimate(rows: pd.DataFrame) -> tuple[float, float, float]:
    means = rows.groupby("participant")["rating"].mean()
    if len(means) < 6:
        raise ValueError("too few")
    return (
        means.mean() - 50,
        means.mean() - 50 - 2 * means.std(),
        means.mean() - 50 + 2 * means.std(),
    )


@pytest.fixture
def result(tidy: Callable[..., pd.DataFrame]) -> Multiverse:
    table = tidy(participants=8, recordings=2)
    table.loc[table["participant"] == "p03", "rating"] = 50.0
    return run_multiverse(table, estimate, rules=["straight_lining", "test_retest", "outliers"])


def test_universes_stand_in_order_over_their_rules(
    result: Multiverse, said: Callable[[Figure], str]
) -> None:
    figure = draw(result)
    upper, lower = figure.axes
    curve = result.curve
    drawn = np.concatenate([
        line.get_xydata() for line in upper.lines if line.get_marker() in {"o", "D"}
    ])
    drawn = drawn[np.argsort(drawn[:, 0])]
    np.testing.assert_array_equal(
        drawn, np.column_stack([np.arange(1, len(curve) + 1), curve["value"]])
    )
    bars = sorted(tuple(bar.ravel()) for part in upper.collections for bar in part.get_segments())
    place = range(1, len(curve) + 1)
    assert bars == sorted(zip(place, curve["low"], place, curve["high"], strict=True))
    for rule, line in zip(result.screening.rules, lower.lines, strict=True):
        assert list(line.get_xdata() - 1) == list(np.flatnonzero(curve[rule]))
    for part in (
        "95 % intervals",
        "participants",
        f"{len(curve)} distinct",
        "Points per +0.1",
        "test retest",
    ):
        assert part in said(figure)


def test_nobody_excluded_is_the_diamond(result: Multiverse, said: Callable[[Figure], str]) -> None:
    figure = draw(result)
    assert " Diamond, dashed line: nobody excluded." in said(figure)
    upper = figure.axes[0]
    (diamond,) = (line for line in upper.lines if line.get_marker() == "D")
    assert list(diamond.get_ydata()) == [result.table["value"].iloc[0]]


def test_universes_without_an_estimate_are_counted(
    result: Multiverse, said: Callable[[Figure], str]
) -> None:
    table = result.table.copy()
    table.loc[1, ["value", "low", "high"]] = np.nan
    assert "1 without an estimate" in said(draw(replace(result, table=table)))
    table[["value", "low", "high"]] = np.nan
    with pytest.raises(ValueError, match="result must have a universe with an estimate"):
        draw(replace(result, table=table))


def test_no_intervals_are_said(result: Multiverse, said: Callable[[Figure], str]) -> None:
    table = result.table.assign(low=np.nan, high=np.nan)
    assert "No intervals." in said(draw(replace(result, table=table)))


def test_words_stay_inside_and_apart(
    result: Multiverse, faults: Callable[[Figure], list[str]]
) -> None:
    table = pd.concat([result.table] * 40, ignore_index=True)
    assert faults(draw(replace(result, table=table))) == []
