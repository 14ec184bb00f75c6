"""Figures of a power analysis: power against participants for each number of recordings; the other factors."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from feel321.analysis.figures import style

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from pandas import DataFrame

HEIGHT_CM, SMALL_CM = 7.5, 5.0
END_CM = 0.42
"""Least distance between two names at the ends of curves."""

WALKS = ("-", (0, (5, 1.2)), (0, (2, 1)), (0, (5, 1, 1, 1)), (0, (1, 1)), (0, (8, 1.5)))
"""Line styles, for curves besides that of the study's own number."""

OTHERS = {"reducers": "Reducers", "repeats": "Ratings of each stimulus by one person"}


def draw_power(table: DataFrame, own: int, *, wanted: float) -> Figure:
    """Draw power against participants, a curve for each number of recordings; own: that of the study.

    table: participants, recordings, power, ceiling, simulated, simulated_low, simulated_high.
    """
    with style.print_style():
        figure, axes = style.new_figure(HEIGHT_CM)
        ends = {}
        numbers = sorted(table["recordings"].unique())
        for place, number in enumerate(numbers):
            rows = table[table["recordings"] == number].sort_values("participants")
            look = _choose_look(number == own, place)
            axes.plot(rows["participants"], rows["power"], **look, zorder=3)
            _draw_simulated(axes, rows, "participants", look["color"])
            ends[number] = float(rows["power"].iloc[-1])
            _draw_ceiling(axes, rows, look["color"])
        _finish(axes, wanted)
        axes.set_xlabel("Participants")
        axes.set_xticks(sorted(table["participants"].unique()))
        axes.set_ylabel("Power")
        _name_ends(axes, ends, own)
    return figure


def draw_others(table: DataFrame, *, wanted: float) -> Figure:
    """Draw power against the number of reducers and of repeats, all else as in the study."""
    varied = [name for name in OTHERS if table[name].nunique() > 1]
    with style.print_style():
        figure = style.new_canvas(SMALL_CM)
        panels = figure.subplots(1, len(varied), sharey=True, squeeze=False)[0]
        for axes, name in zip(panels, varied, strict=True):
            still = [other for other in OTHERS if other != name]
            rows = table[(table[still] == table[still].mode().iloc[0]).all(axis=1)]
            rows = rows.sort_values(name)
            axes.plot(rows[name], rows["power"], color=style.BLACK, marker="o", markersize=3)
            _draw_simulated(axes, rows, name, style.BLACK)
            axes.set_xlabel(OTHERS[name])
            axes.set_xticks(sorted(rows[name].unique()))
            _finish(axes, wanted)
        panels[0].set_ylabel("Power")
    return figure


def _choose_look(is_own: bool, place: int) -> dict[str, Any]:  # noqa: FBT001 - which of two looks
    if is_own:
        return {"color": style.BLACK, "linewidth": 1.6, "linestyle": "-"}
    return {"color": style.GREY, "linewidth": 1.0, "linestyle": WALKS[(place + 1) % len(WALKS)]}


def _draw_simulated(axes: Axes, rows: DataFrame, column: str, colour: str) -> None:
    """Draw what simulations found, with their Monte Carlo intervals."""
    shown = rows[rows["simulated"].notna()]
    if shown.empty:
        return
    axes.vlines(
        shown[column], shown["simulated_low"], shown["simulated_high"], colors=colour, linewidths=1.4, zorder=4
    )
    axes.plot(
        shown[column], shown["simulated"], linestyle="none", marker="o", markersize=5, color="white",
        markeredgecolor=colour, markeredgewidth=1.2, zorder=5,
    )  # fmt: skip


def _draw_ceiling(axes: Axes, rows: DataFrame, colour: str) -> None:
    """Draw what participants without end would reach, at the right end."""
    last = rows["participants"].max()
    length = 0.12 * (last - rows["participants"].min() or 1)
    axes.hlines(
        rows["ceiling"].iloc[-1], last - length, last, colors=colour, linestyles=(0, (2, 2)), linewidths=0.8
    )


def _finish(axes: Axes, wanted: float) -> None:
    axes.axhline(wanted, color=style.GREY, linewidth=style.THIN, zorder=1)
    axes.set_ylim(-0.02, 1.04)
    axes.set_yticks(np.arange(0, 1.01, 0.2))
    axes.grid(axis="y", color=style.PALE, linewidth=style.THIN)
    axes.set_axisbelow(True)


def _name_ends(axes: Axes, ends: dict[int, float], own: int) -> None:
    """Name curves at their right ends, each at its own height, from the highest down."""
    order: Sequence[int] = sorted(ends, key=lambda number: -ends[number])
    low, high = axes.get_ylim()
    places = style.spread([ends[n] for n in order], (high - low) * END_CM / HEIGHT_CM, low=low)
    of_axes = axes.get_yaxis_transform()
    for number, place in zip(order, places, strict=True):
        stroke: dict[str, Any] = {"transform": of_axes, "clip_on": False, "linewidth": style.THIN}
        axes.plot([1.0, 1.02], [ends[number], place], color=style.GREY, **stroke)
        weight = "bold" if number == own else "normal"
        axes.text(1.03, place, f"{number} recordings", transform=of_axes, va="center", fontweight=weight)
