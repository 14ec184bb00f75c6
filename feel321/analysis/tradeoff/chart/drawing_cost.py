"""The figures of cost alone: growth with length, memory, block size, sampling rate."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from feel321.analysis.figures.style import (
    GREY,
    THIN,
    add_legend,
    make_handles,
    new_canvas,
    print_style,
)
from feel321.analysis.tradeoff.chart.axes import (
    CUT,
    find_size,
    limit_accuracy,
    look_up,
    merge_equal,
    tell_axis,
    write_plainly,
)
from feel321.analysis.tradeoff.chart.cost import RATE_HZ
from feel321.analysis.tradeoff.chart.records import MEASURES

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from feel321.analysis.figures.style import Look
    from feel321.analysis.tradeoff.chart.records import Accuracy, Chart, Cost

    Series = Sequence[float] | np.ndarray

NS, NS_PER_MS = 1e9, 1e6


def draw_growth(chart: Chart) -> Figure:
    """Draw time and memory of one call against the signal's length."""
    chart = merge_equal(chart)
    looks = look_up(chart)
    with print_style():
        figure = new_canvas(9.5)
        above, below = figure.subplots(2, sharex=True, height_ratios=(2, 1))
        for reducer, look in looks.items():
            sizes = [
                cost for cost in chart.costs if cost.sweep == "size" and cost.reducer == reducer
            ]
            _draw_times(above, sizes, look)
            memory = [row for row in chart.memory if row.reducer == reducer]
            _draw_line(
                below,
                [row.n_samples for row in memory],
                [row.relative for row in memory],
                look=look,
            )
        lengths = np.array(sorted({cost.n_samples for cost in chart.costs if cost.sweep == "size"}))
        above.plot(lengths, 1000 * lengths / RATE_HZ, color=GREY, linestyle=(0, (3, 2)), zorder=1)
        above.text(
            lengths[2],
            1000 * lengths[2] / RATE_HZ,
            f"  real time at {RATE_HZ / 1000:g} kHz",
            color=GREY,
            va="top",
        )
        above.set(yscale="log", ylabel="Time of one call (ms)")
        below.set(
            xscale="log",
            yscale="log",
            xlabel="Length (samples per axis)",
            ylabel="Peak memory\n(× input)",
        )
        for axis in (above.yaxis, below.xaxis, below.yaxis):
            write_plainly(axis)
        add_legend(figure, make_handles(looks))
    return figure


def draw_blocks(chart: Chart) -> Figure:
    """Draw the cost of streaming against the size of a block."""
    chart = merge_equal(chart)
    looks = look_up(chart)
    blocks = [cost for cost in chart.costs if cost.sweep == "block"]
    shown = {
        name: look for name, look in looks.items() if any(cost.reducer == name for cost in blocks)
    }
    with print_style():
        figure = new_canvas(6.0)
        axes = figure.subplots()
        for reducer, look in shown.items():
            _draw_per_sample(axes, [cost for cost in blocks if cost.reducer == reducer], look)
        axes.axhline(NS / RATE_HZ, color=GREY, linestyle=(0, (3, 2)), zorder=1)
        axes.text(
            max(cost.block for cost in blocks),
            NS / RATE_HZ,
            f"real time at {RATE_HZ / 1000:g} kHz",
            color=GREY,
            ha="right",
            va="bottom",
        )
        axes.set(
            xscale="log",
            yscale="log",
            xlabel="Block (samples per call)",
            ylabel="Cost of one sample (ns)",
        )
        axes.minorticks_off()
        sizes = sorted({cost.block for cost in blocks})
        axes.set_xticks(sizes, [str(size) for size in sizes])
        write_plainly(axes.yaxis)
        add_legend(figure, make_handles(shown))
    return figure


def draw_rates(chart: Chart, measures: Sequence[str] = MEASURES[:2]) -> Figure:
    """Draw accuracy and speed against the sampling rate."""
    chart = merge_equal(chart)
    looks = look_up(chart)
    with print_style():
        figure = new_canvas(4.2 * (len(measures) + 1))
        panels = figure.subplots(len(measures) + 1, sharex=True)
        for axes, measure in zip(panels, measures, strict=False):
            rows = [
                row for row in chart.accuracies if row.sweep == "rate" and row.measure == measure
            ]
            lines = {
                reducer: _find_medians(row for row in rows if row.reducer == reducer)
                for reducer in looks
            }
            for reducer, (rates, medians) in lines.items():
                _draw_line(axes, rates, medians, look=looks[reducer])
            shown = (median for _, medians in lines.values() for median in medians)
            axes.set(ylabel=tell_axis(measure), ylim=limit_accuracy(shown))
        costs = [cost for cost in chart.costs if cost.sweep == "rate"]
        for reducer, look in looks.items():
            own = [cost for cost in costs if cost.reducer == reducer]
            _draw_line(
                panels[-1],
                [cost.rate_hz / 1000 for cost in own],
                [cost.real_time for cost in own],
                look=look,
            )
        panels[-1].set(
            xscale="log", yscale="log", xlabel="Sampling rate (kHz)", ylabel="Speed (× real time)"
        )
        panels[-1].minorticks_off()
        rates = sorted({cost.rate_hz / 1000 for cost in costs})
        panels[-1].set_xticks(rates, [f"{rate:g}" for rate in rates])
        write_plainly(panels[-1].yaxis)
        add_legend(figure, make_handles(looks))
    return figure


def _draw_times(axes: Axes, costs: Sequence[Cost], look: Look) -> None:
    n = np.array([cost.n_samples for cost in costs])
    low, median, high = (
        np.array([getattr(cost, name) for cost in costs]) * n / NS_PER_MS
        for name in ("low", "ns_per_sample", "high")
    )
    axes.fill_between(n, low, high, color=look.colour, alpha=0.2, linewidth=0)
    _draw_line(axes, n, median, look=look)


def _draw_per_sample(axes: Axes, costs: Sequence[Cost], look: Look) -> None:
    x = [cost.block for cost in costs]
    axes.fill_between(
        x,
        [cost.low for cost in costs],
        [cost.high for cost in costs],
        color=look.colour,
        alpha=0.2,
        linewidth=0,
    )
    _draw_line(axes, x, [cost.ns_per_sample for cost in costs], look=look)


def _draw_line(axes: Axes, x: Series, y: Series, *, look: Look) -> None:
    axes.plot(
        x,
        y,
        color=look.colour,
        marker=look.marker,
        markersize=find_size(look, 3.2),
        markeredgecolor="white",
        markeredgewidth=THIN,
        linewidth=0.7,
    )


def _find_medians(rows: Iterable[Accuracy]) -> tuple[list[float], list[float]]:
    by_rate: dict[float, list[float]] = {}
    for row in rows:
        by_rate.setdefault(row.rate_hz / 1000, []).append(row.mean)
    return list(by_rate), [max(float(np.median(means)), CUT) for means in by_rate.values()]
