"""Delivered against intended metrics of stimuli, and level errors of judgements."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from feel321.analysis.figures import style
from feel321.analysis.table.metrics import order_reducers
from feel321.analysis.words import capitalise, format_name

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D
    from numpy.typing import NDArray
    from pandas import DataFrame

CUT = -1.0
"""Metrics below this are drawn at the edge, as in the other figures."""

BINS = 24


def draw_delivered(
    items: DataFrame, metrics: Sequence[str], errors_db: NDArray[np.float64]
) -> Figure:
    """Draw each metric delivered against intended, and the level errors.

    items: a row per stimulus with `reducer`, the metrics, and those with the suffix `_delivered`.
    """
    n_panels = len(metrics) + bool(len(errors_db))
    n_rows = -(-n_panels // 2)
    with style.print_style():
        figure = style.new_canvas(height_cm=2.4 + 4.4 * n_rows)
        axes = figure.subplots(n_rows, 2, squeeze=False).ravel()
        looks = style.assign_looks(order_reducers(items["reducer"].unique()))
        shown: dict[str, Line2D] = {}
        for ax, metric in zip(axes, metrics, strict=False):
            shown |= _draw_metric(ax, items, metric, looks=looks)
        if len(errors_db):
            _draw_errors(axes[len(metrics)], errors_db)
        for ax in axes[n_panels:]:
            ax.remove()
        if shown:
            style.add_legend(figure, shown)
    return figure


def _draw_metric(
    ax: Axes, items: DataFrame, metric: str, *, looks: Mapping[str, style.Look]
) -> dict[str, Line2D]:
    values = items[[metric, f"{metric}_delivered"]].clip(lower=CUT)
    shown = {}
    for name, look in looks.items():
        own = values[items["reducer"] == name].to_numpy(np.float64)
        shown[name] = style.plot_marks(ax, own[:, 0], own[:, 1], look=look)
    low = min(0.0, float(values.to_numpy().min())) - 0.05
    ax.plot([low, 1.05], [low, 1.05], color="0.6", linewidth=0.8, zorder=1)
    ax.set(xlim=(low, 1.05), ylim=(low, 1.05), xlabel="Intended", ylabel="Delivered")
    ax.set_title(capitalise(format_name(metric)))
    return shown


def _draw_errors(ax: Axes, errors_db: NDArray[np.float64]) -> None:
    reach = max(float(np.abs(errors_db).max()), 0.5)
    ax.hist(errors_db, bins=np.linspace(-reach, reach, BINS + 1).tolist(), color="0.45")
    ax.axvline(0, color="0.6", linewidth=0.8, zorder=1)
    ax.set(xlabel="Level error in dB", ylabel="Judgements", title="Level")
