"""Ratings against a metric, all recordings in one."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from analysis.figures.legend import add_legend
from analysis.figures.style import GREY, PRINT, THIN, Look, new_figure, print_style
from analysis.figures.text import tell_scale
from analysis.table.reading import HIGHEST, LOWEST
from analysis.table.sources import tell_recordings
from analysis.words import tell_axis, tell_number, tell_range

if TYPE_CHECKING:
    from collections.abc import Mapping

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D
    from numpy.typing import NDArray
    from pandas import DataFrame

    from analysis.association.correlate import Association
    from analysis.findings import Panel

CUT = -1.0
"""Metrics below this are drawn at the edge: one spectral match of -30 would squeeze all others together."""


def draw_scatter(panel: Panel, association: Association, *, looks: Mapping[str, Look]) -> Figure:
    """Draw the mean rating of each test stimulus against a metric.

    Parameters
    ----------
    panel : Panel
        One scale and level.
    association : Association
        The metric and its correlation, told above the axes.
    looks : Mapping of str to Look
        Look per reducer.

    Returns
    -------
    Figure
        One column wide, as high as its legend needs; thin bars are 95 % intervals over participants. Stimuli
        with a metric below `CUT` stand, hollow, at the left edge and are counted.
    """
    parts = dict(tuple(panel.stimuli.groupby("reducer", observed=True)))
    with print_style():
        figure, axes = new_figure(height_cm=8.2)
        shown = {
            name: scatter_reducer(axes, parts[name], metric=association.metric, look=look)
            for name, look in looks.items()
            if name in parts
        }
        _mark_clipped(axes, panel.stimuli[association.metric].to_numpy(np.float64), falling=association.value < 0)
        limits = LOWEST - 3, HIGHEST + 3
        axes.set(xlabel=tell_axis(association.metric), ylabel=tell_scale(panel.scale), ylim=limits)
        axes.locator_params(axis="x", nbins=5)
        axes.set_title(_tell_association(association))
        add_legend(figure, shown)
    return figure


def scatter_reducer(
    axes: Axes, stimuli: DataFrame, *, metric: str, look: Look, size: float = PRINT["lines.markersize"]
) -> Line2D:
    """Draw the stimuli of one reducer.

    Parameters
    ----------
    axes : Axes
        Where to.
    stimuli : DataFrame
        One row each: mean, low, high and the metric.
    metric : str
        Name of the metric.
    look : Look
        Of the reducer.
    size : float
        Of the marker, in points.

    Returns
    -------
    Line2D
        What stands for it in a legend.
    """
    true = stimuli[metric].to_numpy(np.float64)
    mean, low, high = stimuli[["mean", "low", "high"]].to_numpy(np.float64).T
    shown, inside = np.maximum(true, CUT), true >= CUT
    axes.vlines(shown, low, high, colors=GREY, linewidths=0.35, alpha=0.6, zorder=1)
    style: dict[str, Any] = {"marker": look.marker, "markersize": size, "color": look.colour}
    style |= {"linestyle": "none", "zorder": 3}
    axes.plot(shown[~inside], mean[~inside], markerfacecolor="white", markeredgewidth=THIN, **style)
    return axes.plot(shown[inside], mean[inside], markeredgecolor="white", markeredgewidth=THIN, **style)[0]


def count_clipped(metric: NDArray[np.float64]) -> int:
    """Count the stimuli that a scatter cannot show in their place.

    Parameters
    ----------
    metric : ndarray
        Values of the metric.

    Returns
    -------
    int
        How many lie below `CUT`.
    """
    return int((metric < CUT).sum())


def _mark_clipped(axes: Axes, metric: NDArray[np.float64], *, falling: bool) -> None:
    # The corner that a rising (or falling) cloud of points leaves free.
    height, side = (0.01, "bottom") if falling else (0.99, "top")
    number = count_clipped(metric)
    if number:
        edge, lowest = tell_number(CUT, kind="count"), tell_number(float(metric.min()))
        count = f"{number} of {len(metric)} stimuli"
        text = f"← hollow: {count} below {edge}\n    (lowest {lowest}), drawn at {edge}"
        axes.text(0.02, height, text, transform=axes.transAxes, va=side)


def _tell_association(result: Association) -> str:
    size = f"{result.n_items} stimuli, {tell_recordings(result.n_recordings, result.n_sources)}"
    narrow = tell_range(result.participants_low, result.participants_high)
    return (
        f"{result.method.capitalize()} r = {tell_number(result.value)}, {size}\n"
        f"95 % two-way interval {tell_range(result.low, result.high)}\n"
        f"over {result.n_participants} participants only {narrow}"
    )
