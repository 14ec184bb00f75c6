"""Residuals of a mixed model: whether they are normal, and as spread at every height of the scale."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from analysis.figures.style import BLUE, GREY, PALE, RED, new_canvas, print_style
from analysis.figures.text import add_title, fit_text

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    from analysis.mixed.model import MixedFit

    Values = NDArray[np.float64]

HEIGHT_CM, LABEL_CM = 4.6, 2.6
MOST = 2000
"""Points that an eye can use; of more rows this many are drawn, evenly through their order."""

BINS, BINNED = 10, 20
"""Parts of the fitted range for which a median is drawn, and rows that such a part needs."""

POINTS: dict[str, Any] = {"marker": "o", "linestyle": "none", "markersize": 2, "markeredgewidth": 0}


def draw_residuals(fit: MixedFit, *, unit: str = "points") -> Figure:
    """Draw a normal quantile plot of the residuals, and the residuals against the fitted values.

    Parameters
    ----------
    fit : MixedFit
        The model, such as ``primary.fit``.
    unit : str
        Of the response.

    Returns
    -------
    Figure
        Left: residuals over their standard deviation against normal quantiles, with the 95 % band in which each
        of n normal values in order lies. Right: residuals against fitted values, with median and quartiles
        of up to ten parts of equal size.

    Notes
    -----
    The k-th of n normal values in order lies between the quantiles of Beta(k, n - k + 1), turned into normal ones;
    the band is pointwise: one point in twenty lies outside by chance, and neighbours leave it together.
    """
    with print_style():
        figure = new_canvas(HEIGHT_CM)
        left, right = figure.subplots(1, 2)
        _draw_quantiles(left, fit.residuals)
        _draw_spread(right, fit.fitted, fit.residuals)
        left.set(xlabel="Normal quantile (SD)", ylabel="Residual (SD)")
        across, up = (fit_text(f"{what} ({unit})", LABEL_CM) for what in ("Fitted", "Residual"))
        right.set(xlabel=across, ylabel=up)
        for axes in (left, right):
            axes.locator_params(nbins=4)
        n = len(fit.residuals)
        drawn = f", {MOST} of them drawn" if n > MOST else ""
        add_title(
            figure,
            f"Residuals of the mixed model, n = {n} rows{drawn}. Left: band, 95 % pointwise for normal residuals. "
            f"Right: line and band, median and quartiles, row after row in parts of equal size.",
        )
    return figure


def _draw_quantiles(axes: Axes, residuals: Values) -> None:
    from scipy.stats import beta, norm

    n = len(residuals)
    spread = residuals.std(ddof=1) if n > 1 else 1.0
    ordered = np.sort(residuals) / (spread or 1.0)
    chosen = _choose(n)
    rank = chosen + 1
    expected = norm.ppf((rank - 0.5) / n)
    low, high = (norm.ppf(beta.ppf(share, rank, n - rank + 1)) for share in (0.025, 0.975))
    axes.fill_between(expected, low, high, color=PALE, linewidth=0, zorder=0)
    axes.axline((0, 0), slope=1, color=GREY, linewidth=0.6, zorder=1)
    axes.plot(expected, ordered[chosen], color=BLUE, zorder=2, **POINTS)


def _draw_spread(axes: Axes, fitted: Values, residuals: Values) -> None:
    order = np.argsort(fitted, kind="stable")
    chosen = order[_choose(len(order))]
    axes.axhline(0, color=GREY, linewidth=0.6, zorder=1)
    axes.plot(fitted[chosen], residuals[chosen], color=BLUE, alpha=0.4, zorder=2, **POINTS)
    parts = np.array_split(order, min(BINS, len(order) // BINNED)) if len(order) >= BINNED else []
    if len(parts) > 1:
        middles = [np.median(fitted[part]) for part in parts]
        low, half, high = np.array([np.quantile(residuals[part], (0.25, 0.5, 0.75)) for part in parts]).T
        axes.fill_between(middles, low, high, color=RED, alpha=0.25, linewidth=0, zorder=3)
        axes.plot(middles, half, color=RED, linewidth=1.0, zorder=4)


def _choose(n: int) -> NDArray[np.intp]:
    """Choose places evenly, both ends among them."""
    return np.unique(np.linspace(0, n - 1, min(n, MOST)).round().astype(np.intp))
