"""Specification curve: one estimate under every choice of screening rules."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from analysis.figures.style import BLACK, BLUE, GREY, RED, THIN, new_canvas, print_style
from analysis.figures.text import add_title, fit_text
from analysis.words import tell_name, tell_span

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import NDArray
    from pandas import DataFrame

    from analysis.primary.multiverse import Multiverse

CURVE_CM, ROW_CM, AXIS_CM = 4.0, 0.36, 1.2
LABEL_CM = 2.9


def draw_multiverse(result: Multiverse, *, estimate: str, interval: str = "95 % intervals") -> Figure:
    """Draw the estimate for every distinct set of raters, from the smallest up, and the rules that leave it.

    Parameters
    ----------
    result : Multiverse
        What `run_multiverse` returns.
    estimate : str
        What was estimated, with its unit; it labels the axis.
    interval : str
        What the bars are.

    Returns
    -------
    Figure
        Above the curve, with everybody's estimate as a red diamond and a dashed line; below a square for every rule of
        the smallest combination that leaves these raters.

    Raises
    ------
    ValueError
        If no universe has an estimate.
    """
    curve = result.curve
    if not len(curve):
        raise ValueError("result: got no universe with an estimate, allowed is one or more; its notes say why")
    rules = list(result.screening.rules)
    with print_style():
        figure = new_canvas(CURVE_CM + ROW_CM * len(rules) + AXIS_CM)
        upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=[CURVE_CM, ROW_CM * len(rules)])
        _draw_curve(upper, curve, alone=~curve[rules].any(axis=1).to_numpy(bool))
        _draw_rules(lower, curve[rules].to_numpy(bool).T, names=rules)
        upper.set_ylabel(fit_text(estimate, CURVE_CM, lines=3))
        lower.set_xlabel("Sets of raters, from the smallest estimate up")
        add_title(figure, _tell(result, curve, interval))
    return figure


def _draw_curve(axes: Axes, curve: DataFrame, *, alone: NDArray[np.bool_]) -> None:
    place = np.arange(1, len(curve) + 1)
    value, low, high = curve[["value", "low", "high"]].to_numpy(np.float64).T
    style: dict[str, Any] = {"linestyle": "none", "markeredgecolor": "white", "markeredgewidth": THIN}
    for chosen, colour, marker, size in ((~alone, BLUE, "o", 3.5), (alone, RED, "D", 5)):
        axes.vlines(place[chosen], low[chosen], high[chosen], color=colour, linewidth=0.8, alpha=0.6, zorder=2)
        axes.plot(place[chosen], value[chosen], marker=marker, markersize=size, color=colour, zorder=3, **style)
    for everybody in value[alone]:
        axes.axhline(everybody, color=RED, linewidth=0.6, linestyle="--", zorder=1)
    axes.axhline(0, color=GREY, linewidth=0.6, zorder=1)
    axes.locator_params(axis="y", nbins=5)
    axes.tick_params(axis="x", length=0, labelbottom=False)


def _draw_rules(axes: Axes, applied: NDArray[np.bool_], *, names: list[str]) -> None:
    for row, chosen in enumerate(applied):
        place = np.flatnonzero(chosen) + 1
        axes.plot(place, np.full(len(place), -row), "s", markersize=2.2, color=BLACK, markeredgewidth=0)
    axes.set_yticks(-np.arange(len(names)), [fit_text(tell_name(name), LABEL_CM, lines=1) for name in names])
    axes.set(ylim=(0.6 - len(names), 0.6), xlim=(0.2, applied.shape[1] + 0.8))
    axes.tick_params(axis="y", length=0)
    axes.locator_params(axis="x", integer=True)


def _tell(result: Multiverse, curve: DataFrame, interval: str) -> str:
    lost = len(result.table) - len(curve)
    without = f" {lost} without an estimate are left out." if lost else ""
    bars = f"Bars: {interval}. " if curve["low"].notna().any() else "No intervals. "
    sets = "set" if len(curve) == 1 else "sets"
    return (
        f"{len(curve)} distinct {sets} of raters from {result.n_combinations} combinations of screening rules; "
        f"n = {tell_span(curve['n_participants'])} participants. {bars}"
        f"Diamond, dashed line: nobody excluded. Below: the fewest rules that leave a set.{without}"
    )
