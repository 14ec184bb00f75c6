from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
import pytest
from scipy.stats import norm

from feel321.analysis.figures.scatter import draw_residuals
from feel321.analysis.mixed.model import MixedFit, fit_mixed

if TYPE_CHECKING:
    from collections.abc import Callable

    from matplotlib.figure import Figure


@pytest.fixture(scope="module")
def fit() -> MixedFit:
    rng = np.random.default_rng(0)
    who = np.repeat(np.arange(12), 20)
    x = rng.uniform(size=240)
    return fit_mixed(
        "y ~ x + (1 | who)",
        pd.DataFrame({"who": who, "x": x, "y": 40 + 20 * x + who + rng.normal(0, 5, 240)}),
    )


def test_every_residual_is_drawn_twice(fit: MixedFit, said: Callable[[Figure], str]) -> None:
    figure = draw_residuals(fit)
    left, right = figure.axes
    (quantiles,) = (line for line in left.lines if line.get_marker() == "o")
    np.testing.assert_allclose(quantiles.get_xdata(), norm.ppf((np.arange(240) + 0.5) / 240))
    np.testing.assert_allclose(
        quantiles.get_ydata(), np.sort(fit.residuals) / fit.residuals.std(ddof=1)
    )
    (points,) = (line for line in right.lines if line.get_marker() == "o")
    drawn = sorted(map(tuple, points.get_xydata()))
    assert drawn == sorted(zip(fit.fitted, fit.residuals, strict=True))
    for part in (
        "n = 240 rows.",
        "95 % pointwise",
        "Normal quantile (SD)",
        "Fitted (points)",
        "Residual (points)",
    ):
        assert part in said(figure)


def test_the_band_holds_normal_residuals_and_not_others(fit: MixedFit) -> None:
    rng = np.random.default_rng(1)

    def share_outside(residuals: np.ndarray) -> float:
        left = draw_residuals(replace(fit, residuals=residuals)).axes[0]
        band = left.collections[0].get_paths()[0]
        (quantiles,) = (line for line in left.lines if line.get_marker() == "o")
        return 1 - band.contains_points(quantiles.get_xydata()[5:-5]).mean()

    assert share_outside(rng.normal(size=240)) < 0.1
    assert share_outside(rng.standard_cauchy(240)) > 0.5


def test_of_many_rows_some_are_drawn_and_that_is_said(
    fit: MixedFit, said: Callable[[Figure], str]
) -> None:
    rng = np.random.default_rng(2)
    many = replace(fit, fitted=rng.uniform(0, 100, 50_000), residuals=rng.normal(size=50_000))
    figure = draw_residuals(many)
    (quantiles,) = (line for line in figure.axes[0].lines if line.get_marker() == "o")
    assert len(quantiles.get_xdata()) == 2000
    assert quantiles.get_ydata()[-1] == many.residuals.max() / many.residuals.std(ddof=1)
    assert "n = 50000 rows, 2000 of them drawn" in said(figure)


def test_medians_need_rows(fit: MixedFit) -> None:
    few = replace(fit, fitted=fit.fitted[:15], residuals=fit.residuals[:15])
    assert not draw_residuals(few).axes[1].collections
    medians = draw_residuals(fit).axes[1].lines[-1]
    assert len(medians.get_xdata()) == 10


def test_residuals_that_are_all_zero_are_drawn(fit: MixedFit) -> None:
    assert draw_residuals(replace(fit, residuals=np.zeros(240)))


def test_words_stay_inside_and_apart(fit: MixedFit, faults: Callable[[Figure], list[str]]) -> None:
    assert faults(draw_residuals(fit)) == []
    assert faults(draw_residuals(replace(fit, residuals=fit.residuals * 1e5))) == []
