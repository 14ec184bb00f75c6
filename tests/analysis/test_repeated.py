from __future__ import annotations

import math

import numpy as np
import pytest

from feel321.analysis.standard import repeated_measures_correlation


def make_rows(
    seed: int = 0, n: int = 40, people: int = 5
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    participant = rng.permutation(np.arange(n) % people)
    x = rng.normal(size=n)
    return x, 0.8 * x + rng.normal(size=n) - 5 * participant, participant


def test_it_is_the_common_slope_of_an_analysis_of_covariance() -> None:
    import statsmodels.api as sm

    x, y, participant = make_rows()
    dummies = np.eye(5)[participant]
    fit = sm.OLS(y, np.column_stack([x, dummies])).fit()
    result = repeated_measures_correlation(x, y, participant)
    assert result.df == fit.df_resid
    assert result.p == pytest.approx(fit.pvalues[0])
    assert result.r == pytest.approx(fit.tvalues[0] / math.sqrt(fit.tvalues[0] ** 2 + fit.df_resid))


@pytest.mark.parametrize(("place", "name"), [(0, "x"), (1, "y")])
def test_no_variation_inside_is_said(place: int, name: str) -> None:
    rows = list(make_rows())
    rows[place] = 33.3 * rows[2]
    result = repeated_measures_correlation(*rows)
    assert math.isnan(result.r)
    assert math.isnan(result.p)
    assert result.notes == (f"No correlation: {name} does not vary within any participant.",)


def test_the_interval_has_two_degrees_of_freedom_less_than_cases() -> None:
    x, y = [0.1, 0.2, 0.4, 0.6, 0.7, 0.9], [60, 65, 75, 30, 38, 45]
    found = repeated_measures_correlation(x, y, list("aaabbb"))
    half = 1.959964 / math.sqrt(found.df - 1)
    ends = [math.tanh(math.atanh(found.r) + sign * half) for sign in (-1, 1)]
    assert [found.low, found.high] == pytest.approx(ends, rel=1e-6)
