"""What is shown for comparison with the literature: the tests' own numbers, under their names."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from feel321.analysis.report.parts import split_parts
from feel321.analysis.report.standard import compute
from feel321.analysis.resampling import Choices
from feel321.analysis.standard import compare_p1401, p1401
from feel321.analysis.table.items import make_items
from feel321.analysis.table.reading import Table

if TYPE_CHECKING:
    from collections.abc import Callable

    import pandas as pd

METRICS = ("spectral_match", "temporal_match")


@pytest.mark.parametrize("order", [1, 3])
def test_differences_are_those_of_p1401(tidy: Callable[..., pd.DataFrame], order: int) -> None:
    table = Table(tidy(1, recordings=6, participants=6), METRICS, ())
    section = compute(table, Choices(draws=2))
    (part,) = split_parts(table)
    items = make_items(part.rows, METRICS)
    wanted = compare_p1401(
        *(p1401(items.ratings.T, values, order=order) for values in items.metrics)
    )
    numbers = {number.name: number.value for number in section.numbers}
    lead = f"p1401_difference.realism.as_is.spectral_match.temporal_match.order_{order}.fitted"
    for name in (
        "plcc_z",
        "plcc_p",
        "outlier_z",
        "outlier_p",
        "rmse_f",
        "rmse_p",
        "rmse_star_f",
        "rmse_star_p",
    ):
        assert numbers[f"{lead}.{name}"] == pytest.approx(getattr(wanted, name), nan_ok=True), name
    (grid,) = [grid for grid in section.grids if "difference between two metrics" in grid.caption]
    assert len(grid.rows) == 4
    assert all(len(row) == len(grid.head) for row in grid.rows)
    assert grid.detail
    assert [str(cell) for cell in grid.rows[0]][:5] == [
        "realism, as is",
        "spectral match",
        "temporal match",
        "1",
        "fitted",
    ]


def test_one_metric_has_no_differences(tidy: Callable[..., pd.DataFrame]) -> None:
    rows = tidy(1, recordings=6, participants=6).drop(columns="temporal_match")
    section = compute(Table(rows, METRICS[:1], ()), Choices(draws=2))
    assert "p1401_differences" not in section.tables
    assert not any("difference between two metrics" in grid.caption for grid in section.grids)
