from __future__ import annotations

import numpy as np
import pytest

from feel321.analysis.tradeoff.chart.points import dominates, find_front


def is_beaten(point: list[float], others: list[list[float]]) -> bool:
    return any(
        all(b <= a for a, b in zip(point, other, strict=True))
        and any(b < a for a, b in zip(point, other, strict=True))
        for other in others
    )


@pytest.mark.parametrize("objectives", [1, 2, 4])
@pytest.mark.parametrize("seed", range(5))
def test_the_front_is_what_brute_force_finds(objectives: int, seed: int) -> None:
    points = (
        np.random.default_rng(seed).integers(0, 6, size=(40, objectives)).astype(float).tolist()
    )
    assert find_front(points).tolist() == [not is_beaten(point, points) for point in points]


def test_equal_points_stand_together_and_the_infinite_one_is_worst() -> None:
    assert find_front([[1, 2], [1, 2], [np.inf, 2], [np.inf, 1]]).tolist() == [
        True,
        True,
        False,
        True,
    ]
    assert dominates([[1, 1], [2, 2]]).tolist() == [[False, True], [False, False]]


def test_what_cannot_be_compared_is_refused() -> None:
    with pytest.raises(ValueError, match="costs must be numbers, got NaN"):
        find_front([[1, np.nan]])
