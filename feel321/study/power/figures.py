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

    from feel321.analysis.power.design import PowerDesign

HEIGHT_CM, SMALL_CM = 7.5, 5.0
END_CM = 0.42
"""Least distance between two names at the ends of curves."""

TICK = 0.06
"""Least distance of two labelled numbers of participants, as a share of the axis."""

WALKS = ("-", (0, (5, 1.2)), (0, (2, 1)), (0, (5, 1, 1, 1)), (0, (1, 1)), (0, (8, 1.5)))
"""Line styles, for curves besides that of the study's own number."""

OTHERS = {"reducers": "Reducers", "repeats": "Ratings of each stimulus by one person"}


def draw_power(table: DataFrame, own: int, *, wanted: float) -> Figure:
    """Draw power against participants, a curve for each number of recordings; own: that of the study.

    table: participants, recordings, power, ceiling, simulated, simulated_low, simulated_high.
    """
    people = sorted(table["participants"].unique())
    endless = people[-1] + 0.1 * max(people[-1] - people[0], 1)
    with style.print_style():
        figure, axes = style.new_figure(HEIGHT_CM)
        ends = {}
        for place, number in enumerate(sorted(table["recordings"].unique())):
            rows = table[table["recordings"] == number].sort_values("participants")
            look = _choose_look(place, is_own=number == own)
            axes.plot(rows["participants"], rows["power"], **look, zorder=3)
            _draw_simulated(axes, rows, "participants", colour=look["color"])
            ends[number] = float(rows["ceiling"].iloc[-1])
            last = [people[-1], endless], [rows["power"].iloc[-1], ends[number]]
            axes.plot(*last, color=look["color"], linestyle=(0, (2, 2)), linewidth=0.8)
        _finish(axes, wanted)
        axes.set_xlim(right=endless)
        axes.set(xlabel="Participants", ylabel="Power")
        ticks = choose_ticks(people)
        axes.set_xticks([*ticks, endless], [*map(str, ticks), "\N{INFINITY}"])
        _name_ends(axes, ends, own)
    return figure


def choose_ticks(numbers: Sequence[int]) -> list[int]:
    """Choose the numbers whose labels do not touch, from the largest down.

    Examples
    --------
    >>> choose_ticks([8, 10, 12, 48])
    [8, 12, 48]
    """
    chosen: list[int] = []
    for number in reversed(numbers):
        if not chosen or chosen[-1] - number >= TICK * (numbers[-1] - numbers[0]):
            chosen.append(number)
    return chosen[::-1]


def list_varied(table: DataFrame) -> list[str]:
    """List which of reducers and repeats a plan varies."""
    return [name for name in OTHERS if len(set(table[name])) > 1]


def draw_others(table: DataFrame, own: PowerDesign, *, wanted: float) -> Figure:
    """Draw power against the number of reducers and of repeats, all else as in the study."""
    varied = list_varied(table)
    with style.print_style():
        figure = style.new_canvas(SMALL_CM)
        panels = figure.subplots(1, len(varied), sharey=True, squeeze=False)[0]
        for axes, name in zip(panels, varied, strict=True):
            still = next(other for other in OTHERS if other != name)
            rows = table[table[still] == getattr(own, still)].sort_values(name)
            axes.plot(rows[name], rows["power"], color=style.BLACK, marker="o", markersize=3)
            _draw_simulated(axes, rows, name, colour=style.BLACK)
            axes.set_xlabel(OTHERS[name])
            axes.set_xticks(sorted(rows[name].unique()))
            _finish(axes, wanted)
        panels[0].set_ylabel("Power")
    return figure


def _choose_look(place: int, *, is_own: bool) -> dict[str, Any]:
    if is_own:
        return {"color": style.BLACK, "linewidth": 1.6, "linestyle": "-"}
    return {"color": style.GREY, "linewidth": 1.0, "linestyle": WALKS[(place + 1) % len(WALKS)]}


def _draw_simulated(axes: Axes, rows: DataFrame, column: str, *, colour: str) -> None:
    """Draw what simulations found, with their Monte Carlo intervals."""
    shown = rows[rows["simulated"].notna()]
    if shown.empty:
        return
    axes.vlines(
        shown[column],
        shown["simulated_low"],
        shown["simulated_high"],
        colors=colour,
        linewidths=1.4,
        zorder=4,
    )
    axes.plot(
        shown[column], shown["simulated"], linestyle="none", marker="o", markersize=5, color="white",
        markeredgecolor=colour, markeredgewidth=1.2, zorder=5,
    )  # fmt: skip


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
        axes.text(
            1.03, place, f"{number} recordings", transform=of_axes, va="center", fontweight=weight
        )
