"""The chart's figures: accuracy against cost, latency and rate; growth, blocks and ratings.

Conventions: one column wide; every reducer has the same colour and marker in all figures; a marker is the median over
scenes, a small dot one scene, so that no median hides its spread. Tables come with equal reducers merged.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from feel321.analysis.figures import style
from feel321.analysis.tradeoff.chart.cost import NS, RATE_HZ
from feel321.analysis.tradeoff.chart.points import (
    ACCURACY,
    GROUPS,
    PAPER,
    Record,
    Tables,
    find_front,
    find_latency,
    format_plainly,
    list_records,
    split,
)
from feel321.analysis.tradeoff.stress.measures import MEASURES
from feel321.analysis.words import capitalise, format_measure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure
    from pandas import DataFrame, Series

CUT = -1.0
"""Accuracies below this are drawn at the edge: spectral match has no lower bound."""

LIMIT = MEASURES["gain"].fails
"""Gain of sensor noise from which on a reducer fails."""

FEW_DECADES = 2.5
AT_ONCE_MS, OFFLINE_MS = 2.5, 800.0
"""Where, on the axis of latencies, those stand that have none, and those that need the whole signal."""

ROW_CM, WIDE_CM = 0.48, 15.0
"""Height of a reducer's row, and width, of the picture of accuracy, cost and stability."""

COST_AXIS, DASHED = "Cost of one sample (ns)", (0, (3, 2))


def choose_looks(tables: Tables) -> dict[str, style.Look]:
    """Give every reducer of a chart, as it is named there, its look."""
    members = {name: GROUPS.get(name, (name,)) for name in tables["points"]["reducer"].unique()}
    looks = style.assign_looks([member for own in members.values() for member in own])
    return {name: looks[own[0]] for name, own in members.items()}


def describe_measure(measure: str) -> str:
    """Label an axis by its measure.

    Examples
    --------
    >>> describe_measure("temporal_match_invariant")
    'Temporal match, invariant'
    """
    metric, _, kind = measure.partition("_match")
    kind = kind.strip("_").replace("_", "-")
    return capitalise(f"{metric} match") + (f", {kind}" if kind else "")


def limit_accuracy(values: Iterable[float]) -> tuple[float, float]:
    """Find the ends of an axis of accuracy.

    Examples
    --------
    >>> limit_accuracy([0.3, 0.9]), limit_accuracy([-283.0])
    ((-0.04, 1.04), (-1.08, 1.08))
    """
    lowest = max(CUT, min(0.0, *values, 0.0))
    return lowest - 0.04 * (1 - lowest), 1 + 0.04 * (1 - lowest)


def draw_tradeoff(tables: Tables) -> Figure:
    """Draw accuracy, cost and stability side by side, a row per reducer, the most accurate first."""
    points = _select(tables["points"], measure=ACCURACY).assign(
        shown=lambda own: -own["median"].round(2)
    )
    rows = list_records(points.sort_values(["shown", "ns_per_sample"], kind="stable"))
    gains, looks = tables["stability"], choose_looks(tables)
    with style.print_style():
        figure = style.new_canvas(ROW_CM * len(rows) + 2.2)
        figure.set_figwidth(WIDE_CM / style.CM_PER_INCH)
        panels = figure.subplots(1, 3, sharey=True)
        front = [
            (point["ns_per_sample"], row) for row, point in enumerate(rows) if point["on_front"]
        ]
        panels[1].plot(
            *zip(*front, strict=True), color=style.BLACK, linestyle=DASHED, linewidth=0.7
        )
        for row, point in enumerate(rows):
            own = gains[gains["reducer"] == point["reducer"]]["gain"]
            _draw_row(panels, row, point, gains=own, look=looks[point["reducer"]])
        names = panels[0].set_yticks(range(len(rows)), [point["reducer"] for point in rows])
        for label, point in zip(panels[0].get_yticklabels(), rows, strict=True):
            label.set_fontweight("bold" if point["on_front"] else "normal")
        _label_tradeoff(panels, len(names))
    return figure


def _draw_row(
    panels: Sequence[Axes], row: int, point: Record, *, gains: Series, look: style.Look
) -> None:
    """Draw a mark and its span in each panel; no gain is known where no scene has motion."""
    spans = [
        (point["lowest"], point["median"], point["highest"]),
        (point["low"], point["ns_per_sample"], point["high"]),
        *([(gains.median(), gains.median(), gains.max())] if len(gains) else []),
    ]
    for axes, (low, value, high) in zip(panels, spans, strict=False):
        axes.hlines(row, low, high, colors=look.colour, linewidths=1.2)
        _mark(axes, (value, row), look, size=5.5, clip_on=False)


def _label_tradeoff(panels: Sequence[Axes], count: int) -> None:
    """Name the three panels' axes, and what their values mean."""
    accuracy, cost, gain = panels
    accuracy.set(xlim=(-0.04, 1.04), ylim=(count - 0.4, -0.6), title="Accuracy")
    accuracy.set_xlabel("Bounded spectral match\n(1 is best)")
    cost.set(xscale="log", title="Cost", xlabel="ns per sample\n(less is faster)")
    gain.set(xscale="log", title="Stability", xlabel="Gain of sensor noise\n(less is steadier)")
    gain.axvline(LIMIT, color=style.GREY, linestyle=DASHED, linewidth=0.7, zorder=0)
    for axes in panels:
        axes.tick_params(axis="y", length=0)
        axes.grid(axis="y", color=style.PALE, linewidth=style.THIN)
        axes.set_axisbelow(True)
    _write_ticks(cost.xaxis, gain.xaxis)


def draw_cost(tables: Tables, measures: Sequence[str] = PAPER) -> Figure:
    """Draw accuracy against cost, the front marked."""

    def draw(axes: Axes, measure: str, looks: dict[str, style.Look]) -> DataFrame:
        points = _select(tables["points"], measure=measure)
        scenes = _select(tables["accuracies"], sweep="reducer", measure=measure)
        front = points[find_front(np.c_[points["ns_per_sample"], -points["median"]])]
        front = front.sort_values("ns_per_sample")
        axes.plot(
            front["ns_per_sample"], front["median"].clip(CUT), drawstyle="steps-post", color=style.BLACK,
            linestyle=DASHED, linewidth=0.7, zorder=1,
        )  # fmt: skip
        for point in list_records(points):
            look, x, y = looks[point["reducer"]], point["ns_per_sample"], max(point["median"], CUT)
            own = _select(scenes, method=point["method"])["mean"].clip(CUT)
            _draw_span(axes, x, own, look=look)
            for mean in own:
                _mark(axes, (x, mean), look, size=2.2, marker=".", alpha=0.6, markeredgewidth=0)
            axes.hlines(y, point["low"], point["high"], colors=look.colour, linewidths=1, zorder=3)
            edge = {"markeredgecolor": style.BLACK, "markeredgewidth": 1.5 * style.THIN}
            _mark(axes, (x, y), look, size=5, zorder=4, **(edge if point["on_front"] else {}))
        return scenes

    figure = _draw_panels(tables, measures, draw)
    figure.axes[-1].set(xscale="log", xlabel=COST_AXIS)
    return _finish(figure, choose_looks(tables), figure.axes[-1].xaxis)


def draw_latency(tables: Tables) -> Figure:
    """Draw accuracy against algorithmic latency, windowed reducers with every window."""

    def draw(axes: Axes, measure: str, looks: dict[str, style.Look]) -> DataFrame:
        rows = tables["accuracies"]
        rows = rows[(rows["measure"] == measure) & rows["sweep"].isin(["reducer", "window"])]
        for border in (5.0, 400.0):
            axes.axvline(
                border, color=style.GREY, linewidth=style.THIN, linestyle=(0, (1, 2)), zorder=0
            )
        swept = _select(rows, sweep="window")
        points = list_records(_select(tables["points"], measure=measure))
        alone = [point for point in points if point["reducer"] not in set(swept["reducer"])]
        for spot, offline in ((AT_ONCE_MS, False), (OFFLINE_MS, True)):
            here = [point for point in alone if math.isinf(find_latency(point)) == offline]
            for number, point in enumerate(here):
                x, look = spot * _offset(number, len(here), 0.09), looks[point["reducer"]]
                means = _select(rows, method=point["method"])["mean"].clip(CUT)
                _draw_span(axes, x, means, look=look, zorder=1)
                _mark(axes, (x, means.median()), look, size=4)
        swept = swept.assign(
            window=swept["method"].str.extract(r", ([\d.]+) ms$")[0].astype(float),
            mean=swept["mean"].clip(CUT),
        )
        for number, (reducer, own) in enumerate(split(swept, "reducer")):
            shift, look = _offset(number, swept["reducer"].nunique(), 0.06), looks[reducer]
            medians = own.groupby("window")["mean"].median()
            axes.plot(shift * medians.index, medians, color=look.colour, linewidth=0.8)
            for window, rest in split(own, "window"):
                _draw_span(axes, shift * window, rest["mean"], look=look, zorder=1)
                _mark(axes, (shift * window, rest["mean"].median()), look, size=4)
        return rows

    figure = _draw_panels(tables, PAPER, draw)
    axes = figure.axes[-1]
    limits = (AT_ONCE_MS / 2, 2 * OFFLINE_MS)
    axes.set(xscale="log", xlabel="Algorithmic latency, window (ms)", xlim=limits)
    axes.minorticks_off()
    ticks = (AT_ONCE_MS, 10, 20, 50, 100, 200, OFFLINE_MS)
    axes.set_xticks(ticks, ["none", "10", "20", "50", "100", "200", "whole\nsignal"])
    return _finish(figure, choose_looks(tables))


def draw_growth(tables: Tables) -> Figure:
    """Draw time and memory of one call against the signal's length."""
    looks, sizes = choose_looks(tables), _select(tables["costs"], sweep="size")
    with style.print_style():
        figure = style.new_canvas(9.5)
        above, below = figure.subplots(2, sharex=True, height_ratios=(2, 1))
        for reducer, look in looks.items():
            own, memory = (_select(one, reducer=reducer) for one in (sizes, tables["memory"]))
            _draw_line(above, own["n_samples"], own, look=look, factor=own["n_samples"] / 1e6)
            below.plot(memory["n_samples"], memory["relative"], **_line(look))
        lengths = np.unique(sizes["n_samples"])
        above.plot(lengths, 1000 * lengths / RATE_HZ, color=style.GREY, linestyle=DASHED, zorder=1)
        label = f"  real time at {RATE_HZ / 1000:g} kHz"
        above.text(lengths[2], 1000 * lengths[2] / RATE_HZ, label, color=style.GREY, va="top")
        above.set(yscale="log", ylabel="Time of one call (ms)")
        below.set(xscale="log", yscale="log", xlabel="Length (samples per axis)")
        below.set(ylabel="Peak memory\n(× input)")
    return _finish(figure, looks, above.yaxis, below.xaxis, below.yaxis)


def draw_blocks(tables: Tables) -> Figure:
    """Draw the cost of streaming against the size of a block."""
    blocks, looks = _select(tables["costs"], sweep="block"), choose_looks(tables)
    looks = {name: look for name, look in looks.items() if name in set(blocks["reducer"])}
    with style.print_style():
        figure = style.new_canvas(6.0)
        axes = figure.subplots()
        for reducer, look in looks.items():
            own = _select(blocks, reducer=reducer)
            _draw_line(axes, own["block"], own, look=look)
        label, sizes = f"real time at {RATE_HZ / 1000:g} kHz", np.unique(blocks["block"])
        axes.axhline(NS / RATE_HZ, color=style.GREY, linestyle=DASHED, zorder=1)
        axes.text(sizes[-1], NS / RATE_HZ, label, color=style.GREY, ha="right", va="bottom")
        axes.set(xscale="log", yscale="log", xlabel="Block (samples per call)", ylabel=COST_AXIS)
        axes.minorticks_off()
        axes.set_xticks(sizes, [str(size) for size in sizes])
    return _finish(figure, looks, axes.yaxis)


def draw_rates(tables: Tables, measures: Sequence[str] = PAPER) -> Figure:
    """Draw accuracy and speed against the sampling rate."""
    looks = choose_looks(tables)
    rates, costs = (_select(tables[name], sweep="rate") for name in ("accuracies", "costs"))
    with style.print_style():
        figure = style.new_canvas(4.2 * (len(measures) + 1))
        *panels, last = figure.subplots(len(measures) + 1, sharex=True)
        for axes, measure in zip(panels, measures, strict=True):
            rows = _select(rates, measure=measure)
            medians = rows.groupby(["reducer", "rate_hz"])["mean"].median().clip(CUT)
            for reducer, look in looks.items():
                axes.plot(medians[reducer].index / 1000, medians[reducer], **_line(look))
            axes.set(ylabel=describe_measure(measure), ylim=limit_accuracy(medians))
        for reducer, look in looks.items():
            own = _select(costs, reducer=reducer)
            last.plot(own["rate_hz"] / 1000, own["real_time"], **_line(look))
        last.set(xscale="log", yscale="log", xlabel="Sampling rate (kHz)")
        last.set(ylabel="Speed (× real time)")
        last.minorticks_off()
        ticks = np.unique(costs["rate_hz"]) / 1000
        last.set_xticks(ticks, [f"{rate:g}" for rate in ticks])
    return _finish(figure, looks, last.yaxis)


def draw_rated(tables: Tables, scale: str, level: str) -> Figure:
    """Draw mean ratings against cost; of single axes each, as they were mounted."""
    looks = choose_looks(tables)
    costs = tables["points"].groupby("reducer")["ns_per_sample"].first()
    rows = list_records(_select(tables["rated"], scale=scale, level=level))
    rated = [row for row in rows if row["reducer"] in costs.index]
    with style.print_style():
        figure = style.new_canvas(6.0)
        axes = figure.subplots()
        for row in rated:
            x, look = costs[row["reducer"]], looks[row["reducer"]]
            ends = row["two_way_low"], row["two_way_high"]
            axes.vlines(x, *ends, colors=style.GREY, linewidths=0.5, zorder=1)
            if not math.isnan(row["low"]):
                thick: dict[str, Any] = {"linewidths": 1.5, "alpha": 0.5, "zorder": 2}
                axes.vlines(x, row["low"], row["high"], colors=look.colour, **thick)
            _mark(axes, (x, row["mean"]), look, size=5)
        axes.set(xscale="log", xlabel=COST_AXIS, ylabel=f"Mean {format_measure(scale)} (0 to 100)")
    return _finish(figure, {row["reducer"]: looks[row["reducer"]] for row in rated}, axes.xaxis)


def _select(frame: DataFrame, **wanted: str) -> DataFrame:
    for name, value in wanted.items():
        frame = frame[frame[name] == value]
    return frame


def _draw_panels(
    tables: Tables,
    measures: Sequence[str],
    draw: Callable[[Axes, str, dict[str, style.Look]], DataFrame],
) -> Figure:
    """Draw one panel of accuracy per measure; `draw` returns the rows that it shows."""
    looks = choose_looks(tables)
    with style.print_style():
        figure = style.new_canvas(5.2 * len(measures))
        panels = figure.subplots(len(measures), sharex=True, squeeze=False)[:, 0]
        for axes, measure in zip(panels, measures, strict=True):
            shown = draw(axes, measure, looks)
            axes.set(ylabel=describe_measure(measure), ylim=limit_accuracy(shown["mean"]))
    return figure


def _finish(figure: Figure, looks: dict[str, style.Look], *logarithmic: Axis) -> Figure:
    """Write the ticks of logarithmic axes as plain numbers, and the legend."""
    with style.print_style():
        _write_ticks(*logarithmic)
        style.add_legend(figure, style.make_handles(looks))
    return figure


def _write_ticks(*logarithmic: Axis) -> None:
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    for axis in logarithmic:
        low, high = axis.get_view_interval()
        # Whole decades; where there are too few, the halves between too.
        parts = (1.0,) if math.log10(high / low) > FEW_DECADES else (1.0, 2.0, 5.0)
        axis.set_major_locator(LogLocator(subs=parts))
        axis.set_major_formatter(FuncFormatter(lambda value, _: format_plainly(value)))
        axis.set_minor_formatter(NullFormatter())


def _find_size(look: style.Look, points: float) -> float:
    """Find the size at which a marker looks as large as others."""
    return 1.6 * points if look.marker == "*" else points


def _mark(
    axes: Axes, place: tuple[float, float], look: style.Look, *, size: float, **more: object
) -> None:
    usual: dict[str, Any] = {
        "marker": look.marker, "color": look.colour, "linestyle": "none", "zorder": 3,
        "markersize": _find_size(look, size), "markeredgecolor": "white", "markeredgewidth": style.THIN,
    }  # fmt: skip
    axes.plot(*place, **{**usual, **more})


def _draw_span(axes: Axes, x: float, values: Series, *, look: style.Look, zorder: int = 2) -> None:
    thin: dict[str, Any] = {"linewidths": 0.5, "alpha": 0.5, "zorder": zorder}
    axes.vlines(x, values.min(), values.max(), colors=look.colour, **thin)


def _line(look: style.Look) -> dict[str, Any]:
    return {
        "color": look.colour, "marker": look.marker, "markersize": _find_size(look, 3.2),
        "markeredgecolor": "white", "markeredgewidth": style.THIN, "linewidth": 0.7,
    }  # fmt: skip


def _draw_line(
    axes: Axes, x: Series, costs: DataFrame, *, look: style.Look, factor: Series | float = 1.0
) -> None:
    """Draw median costs and shade their quartiles."""
    low, high = costs["low"] * factor, costs["high"] * factor
    axes.fill_between(x, low, high, color=look.colour, alpha=0.2, linewidth=0)
    axes.plot(x, costs["ns_per_sample"] * factor, **_line(look))


def _offset(number: int, of: int, step: float) -> float:
    """Find the factor that parts markers which would overlap on a logarithmic axis."""
    return math.exp(2.3 * step * (number - (of - 1) / 2))
