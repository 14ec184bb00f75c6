"""The chart's figures: accuracy against time, and cost.

Conventions: one column wide; every reducer has the same colour and marker in all figures; a marker is the median
over scenes, a small dot one scene, so that no median hides its spread.
"""

from __future__ import annotations

import math
from statistics import median
from typing import TYPE_CHECKING

from feel321.analysis.figures.style import (
    BLACK,
    GREY,
    THIN,
    Look,
    add_legend,
    make_handles,
    new_canvas,
    print_style,
)
from feel321.analysis.table.sheet import tell_measure
from feel321.analysis.tradeoff.chart.axes import (
    CUT,
    find_size,
    limit_accuracy,
    look_up,
    merge_equal,
    tell_axis,
    write_plainly,
)
from feel321.analysis.tradeoff.chart.records import MEASURES, find_front

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from feel321.analysis.tradeoff.chart.records import Accuracy, Chart, Point, Rated

AT_ONCE_MS, OFFLINE_MS = 2.5, 800.0
"""Where, on the axis of latencies, those stand that have none, and those that need the whole signal."""

COST_AXIS = "Cost of one sample (ns)"


def draw_cost(chart: Chart, measures: Sequence[str] = MEASURES[:2]) -> Figure:
    """Draw accuracy against cost, the front marked."""
    chart = merge_equal(chart)
    looks = look_up(chart)
    with print_style():
        figure = new_canvas(5.2 * len(measures))
        panels = figure.subplots(len(measures), sharex=True, squeeze=False)[:, 0]
        for axes, measure in zip(panels, measures, strict=True):
            points = [point for point in chart.points if point.measure == measure]
            scenes = [
                row for row in chart.accuracies if row.sweep == "reducer" and row.measure == measure
            ]
            _draw_front(axes, points)
            for point in points:
                own = [row for row in scenes if row.method == point.method]
                _draw_point(axes, point, scenes=own, look=looks[point.reducer])
            axes.set(ylabel=tell_axis(measure), ylim=limit_accuracy(row.mean for row in scenes))
        panels[-1].set(xscale="log", xlabel=COST_AXIS)
        write_plainly(panels[-1].xaxis)
        add_legend(figure, make_handles(looks))
    return figure


def draw_latency(chart: Chart, measures: Sequence[str] = MEASURES[:2]) -> Figure:
    """Draw accuracy against algorithmic latency, windowed reducers with every window."""
    chart = merge_equal(chart)
    looks = look_up(chart)
    with print_style():
        figure = new_canvas(5.2 * len(measures))
        panels = figure.subplots(len(measures), sharex=True, squeeze=False)[:, 0]
        for axes, measure in zip(panels, measures, strict=True):
            shown = [
                row
                for row in chart.accuracies
                if row.measure == measure and row.sweep in {"reducer", "window"}
            ]
            _draw_latencies(
                axes,
                [point for point in chart.points if point.measure == measure],
                rows=shown,
                looks=looks,
            )
            axes.set(ylabel=tell_axis(measure), ylim=limit_accuracy(row.mean for row in shown))
        panels[-1].set(
            xscale="log",
            xlabel="Algorithmic latency, window (ms)",
            xlim=(AT_ONCE_MS / 2, 2 * OFFLINE_MS),
        )
        panels[-1].minorticks_off()
        ticks = (AT_ONCE_MS, 10, 20, 50, 100, 200, OFFLINE_MS)
        panels[-1].set_xticks(ticks, ["none", "10", "20", "50", "100", "200", "whole\nsignal"])
        add_legend(figure, make_handles(looks))
    return figure


def draw_rated(chart: Chart, scale: str, level: str) -> Figure:
    """Draw mean ratings against cost."""
    looks = look_up(chart)
    costs = {point.reducer: point.ns_per_sample for point in chart.points}
    rated = [
        row
        for row in chart.rated
        if (row.scale, row.level) == (scale, level) and row.reducer in costs
    ]
    with print_style():
        figure = new_canvas(6.0)
        axes = figure.subplots()
        for row in rated:
            _draw_rating(axes, row, cost=costs[row.reducer], look=looks[row.reducer])
        axes.set(xscale="log", xlabel=COST_AXIS, ylabel=f"Mean {tell_measure(scale)} (0 to 100)")
        write_plainly(axes.xaxis)
        add_legend(figure, make_handles({row.reducer: looks[row.reducer] for row in rated}))
    return figure


def _draw_front(axes: Axes, points: Sequence[Point]) -> None:
    strict = find_front([[point.ns_per_sample, -point.median] for point in points])
    front = sorted(
        (point for point, on in zip(points, strict, strict=True) if on),
        key=lambda point: point.ns_per_sample,
    )
    x, y = [point.ns_per_sample for point in front], [max(point.median, CUT) for point in front]
    axes.plot(
        x, y, drawstyle="steps-post", color=BLACK, linestyle=(0, (3, 2)), linewidth=0.7, zorder=1
    )


def _draw_point(axes: Axes, point: Point, *, scenes: Sequence[Accuracy], look: Look) -> None:
    x = point.ns_per_sample
    axes.vlines(
        x,
        max(point.lowest, CUT),
        max(point.highest, CUT),
        colors=look.colour,
        linewidths=0.5,
        alpha=0.5,
    )
    for row in scenes:
        axes.plot(
            x,
            max(row.mean, CUT),
            marker=".",
            markersize=2.2,
            color=look.colour,
            alpha=0.6,
            linestyle="none",
        )
    axes.hlines(
        max(point.median, CUT), point.low, point.high, colors=look.colour, linewidths=1.0, zorder=3
    )
    axes.plot(
        x,
        max(point.median, CUT),
        marker=look.marker,
        markersize=find_size(look, 5),
        color=look.colour,
        markeredgecolor=BLACK if point.on_front else "white",
        markeredgewidth=THIN * (1.5 if point.on_front else 1),
        linestyle="none",
        zorder=4,
    )


def _draw_latencies(
    axes: Axes, points: Sequence[Point], *, rows: Sequence[Accuracy], looks: Mapping[str, Look]
) -> None:
    for border in (5.0, 400.0):
        axes.axvline(border, color=GREY, linewidth=THIN, linestyle=(0, (1, 2)), zorder=0)
    windows = _group_windows(rows)
    alone = [point for point in points if point.reducer not in windows]
    for spot, offline in ((AT_ONCE_MS, False), (OFFLINE_MS, True)):
        own = [point for point in alone if (point.latency_s is None) == offline]
        for number, point in enumerate(own):
            x = spot * _step_aside(number, len(own), 0.09)
            means = [row.mean for row in rows if row.method == point.method]
            _draw_bar(axes, x, means, look=looks[point.reducer])
    for number, (reducer, by_window) in enumerate(windows.items()):
        shift = _step_aside(number, len(windows), 0.06)
        spots, look = [window * shift for window in by_window], looks[reducer]
        axes.plot(
            spots,
            [max(median(own), CUT) for own in by_window.values()],
            color=look.colour,
            linewidth=0.8,
        )
        for place, means in zip(spots, by_window.values(), strict=True):
            _draw_bar(axes, place, means, look=look)


def _group_windows(rows: Sequence[Accuracy]) -> dict[str, dict[float, list[float]]]:
    """Reducer -> window in ms -> means of the scenes."""
    found: dict[str, dict[float, list[float]]] = {}
    for row in rows:
        if row.sweep == "window":
            window = float(row.method.rpartition(", ")[2].removesuffix(" ms"))
            found.setdefault(row.reducer, {}).setdefault(window, []).append(row.mean)
    return found


def _step_aside(number: int, of: int, step: float) -> float:
    """Factor that parts markers which would stand on one place of a logarithmic axis."""
    return math.exp(2.3 * step * (number - (of - 1) / 2))


def _draw_bar(axes: Axes, x: float, means: Sequence[float], *, look: Look) -> None:
    axes.vlines(
        x,
        max(min(means), CUT),
        max(*means, CUT),
        colors=look.colour,
        linewidths=0.5,
        alpha=0.5,
        zorder=1,
    )
    axes.plot(
        x,
        max(median(means), CUT),
        marker=look.marker,
        color=look.colour,
        markeredgecolor="white",
        markersize=find_size(look, 4),
        markeredgewidth=THIN,
        linestyle="none",
        zorder=3,
    )


def _draw_rating(axes: Axes, row: Rated, *, cost: float, look: Look) -> None:
    axes.vlines(cost, row.two_way_low, row.two_way_high, colors=GREY, linewidths=0.5, zorder=1)
    if row.low is not None and row.high is not None:
        axes.vlines(
            cost, row.low, row.high, colors=look.colour, linewidths=1.5, alpha=0.5, zorder=2
        )
    axes.plot(
        cost,
        row.mean,
        marker=look.marker,
        color=look.colour,
        markeredgecolor="white",
        markersize=find_size(look, 5),
        markeredgewidth=THIN,
        linestyle="none",
        zorder=3,
    )
