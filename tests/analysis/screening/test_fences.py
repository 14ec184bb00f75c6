import math

import numpy as np
import pytest

from feel321.analysis.screening import multimodality, tukey_fences


@pytest.mark.parametrize(
    ("values", "hinges"),
    [  # what R's fivenum gives
        ([3], (3, 3)),
        ([1, 2], (1, 2)),
        ([1, 2, 3], (1.5, 2.5)),
        ([7, 1, 4, 2, 9, 5, 11], (3, 8)),
        ([0, 1, 2, 3, 4, 5, 6, 7, 8], (2, 6)),
        ([1, 2, 3, 4, 5, 6], (2, 5)),  # whose quartiles are 2.25 and 4.75
    ],
)
def test_hinges_and_fences(values: list[float], hinges: tuple[float, float]) -> None:
    low, high = hinges
    reach = 1.5 * (high - low)
    assert tukey_fences(values) == (low - reach, high + reach)


@pytest.mark.parametrize("values", [[], [1.0, np.nan]])
def test_hinges_refuse(values: list[float]) -> None:
    with pytest.raises(ValueError, match="must be one or more finite numbers"):
        tukey_fences(values)


def test_multimodality_of_known_shapes() -> None:
    grid = (np.arange(4000) + 0.5) / 4000
    assert multimodality(grid) == pytest.approx(5 / 9, abs=0.002)
    assert multimodality(np.repeat([0, 1], 2000)) == pytest.approx(1, abs=0.002)
    normal = np.random.default_rng(0).normal(size=20000)
    assert multimodality(normal) == pytest.approx(1 / 3, abs=0.01)


@pytest.mark.parametrize("values", [[1.0, 2, 3], [5.0] * 9, [0.1 + 0.2, 0.3, 0.3, 0.3, 0.3]])
def test_no_shape(values: list[float]) -> None:
    assert math.isnan(multimodality(values))


def test_gaps_are_refused() -> None:
    with pytest.raises(ValueError, match="finite, got 1 of 5 that are not; leave them out"):
        multimodality([1, 2, math.nan, 4, 5])
