"""Stimuli as points: ratings against a metric with mapping and residuals, perceptual maps, confused pairs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.polynomial import Polynomial

from feel321.analysis.figures import estimates, style
from feel321.analysis.figures.style import Look
from feel321.analysis.table.items import format_recordings
from feel321.analysis.table.schema import HIGHEST, LOWEST
from feel321.analysis.words import (
    capitalise,
    format_axis,
    format_count,
    format_interval,
    format_level,
    format_method,
    format_name,
    format_number,
    format_span,
    join_words,
)

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, SubFigure
    from matplotlib.lines import Line2D
    from numpy.typing import NDArray
    from pandas import DataFrame

    from feel321.analysis.association.correlate import Association, Panel
    from feel321.analysis.mixed.model import MixedFit
    from feel321.analysis.standard import P1401

    Values = NDArray[np.float64]
    from feel321.analysis.contrasts.discrimination import Discrimination
    from feel321.analysis.space import Ellipses


# Ratings against a metric, all recordings in one.

CUT = -1.0
"""Metrics below this are drawn at the edge: one spectral match of -30 would squeeze all others together."""


SCATTER_CM, CELL_CM, KEYS_CM = 7.4, 3.9, 1.4
"""Height of a single scatter, of one among several, and of an axis's numbers with its label."""


def draw_scatter(
    panel: Panel,
    association: Association,
    *,
    looks: Mapping[str, Look],
    place: str = "0-0",
    level: str = "",
) -> Figure:
    """Draw the mean rating of each test stimulus against a metric; reducers are named at the height of their mean.

    place: what the names of marks in the SVG file hold after `KEPT`; level: named where there are several.
    """
    means = panel.stimuli.groupby("reducer", observed=True)["mean"].mean()
    with style.print_style():
        figure, axes = style.new_figure(height_cm=SCATTER_CM + KEYS_CM)
        shown = _draw_stimuli(axes, panel.stimuli, association, looks=looks, place=place)
        axes.set(
            xlabel=format_axis(association.metric),
            ylabel=style.label_scale(panel.scale, level=level),
        )
        heights = {str(name): float(mean) for name, mean in means.items()}
        if not style.label_ends(axes, heights, looks, height_cm=SCATTER_CM):
            style.add_legend(figure, shown)
        size = format_recordings(association.n_recordings, association.n_sources)
        people = format_count(association.n_participants, "participant")
        style.add_title(
            figure,
            f"{describe_relation(panel.scale, association, level)}\n{format_method(association.method)}, 95 % two-way "
            f"interval; {association.n_items} stimuli of {size}, {people}",
        )
    return figure


def draw_scatters(
    panels: Sequence[Panel], metrics: Sequence[str], method: str, *, looks: Mapping[str, Look]
) -> Figure:
    """Draw mean ratings against metrics: a row per scale and level, a column per metric."""
    several = len({panel.level for panel in panels}) > 1
    with style.print_style():
        figure = style.new_canvas(CELL_CM * len(panels) + KEYS_CM)
        grid = figure.subplots(len(panels), len(metrics), sharex="col", sharey=True, squeeze=False)
        shown: dict[str, Line2D] = {}
        for row, panel in enumerate(panels):
            level = panel.level if several else ""
            grid[row, 0].set_ylabel(style.label_scale(panel.scale, CELL_CM - 0.4, level=level))
            for one in (one for one in panel.associations if one.method == method):
                column = list(metrics).index(one.metric)
                axes, place = grid[row, column], f"{row}-{column}"
                shown |= _draw_stimuli(
                    axes, panel.stimuli, one, looks=looks, place=place, size=SIZE
                )
                value, interval = format_number(one.value), format_interval(one.low, one.high)
                axes.set_title(f"r = {value} ({interval})")
        for axes, metric in zip(grid[-1], metrics, strict=True):
            axes.set_xlabel(style.fit_text(format_axis(metric), style.WIDTH_CM / len(metrics) - 1))
        names = join_words([format_name(metric) for metric in metrics])
        r = f"r: {format_method(method)}, in brackets its 95 % two-way interval"
        style.add_title(figure, f"Mean ratings against {names}\n{r}")
        style.add_legend(figure, {name: shown[name] for name in looks if name in shown})
    return figure


def describe_relation(scale: str, one: Association, level: str = "") -> str:
    """Say what is drawn and its correlation: whether a metric predicts, and how, the verdicts say."""
    over = "within recordings" if one.method.startswith("within") else "over all stimuli"
    lead = f"{capitalise(format_name(scale))}{format_level(level)} against {format_name(one.metric)}, {over}"
    if np.isnan(one.value):
        return f"{lead}: r not estimable"
    interval = (
        "no interval" if np.isnan([one.low, one.high]).any() else format_interval(one.low, one.high)
    )
    return f"{lead}: r = {format_number(one.value)} ({interval})"


def _draw_stimuli(
    axes: Axes,
    stimuli: DataFrame,
    association: Association,
    *,
    looks: Mapping[str, Look],
    place: str,
    size: float = 4.5,
) -> dict[str, Line2D]:
    metric = association.metric
    shown = scatter_reducers(axes, stimuli, metric=metric, looks=looks, size=size, place=place)
    _mark_clipped(axes, stimuli, metric, falling=association.value < 0)
    axes.set(ylim=(LOWEST - 3, HIGHEST + 3), yticks=np.linspace(LOWEST, HIGHEST, 5))
    axes.locator_params(axis="x", nbins=5)
    return shown


@dataclass(frozen=True, slots=True)
class MarkGroup:
    """Marks of a reducer that are drawn together: in their place, or hollow at the edge."""

    reducer: str
    hollow: bool
    rows: DataFrame
    name: str


def group_marks(stimuli: DataFrame, metric: str, place: str = "") -> Iterator[MarkGroup]:
    """Group a scatter's marks as they are drawn; the name of a group leads a page's script to its marks."""
    cut = find_cut(metric)
    for number, (reducer, rows) in enumerate(stimuli.groupby("reducer", observed=True)):
        inside = rows[metric] >= cut
        for hollow, chosen in ((True, ~inside), (False, inside)):
            if chosen.any():
                name = f"{style.KEPT}{place}-{number}{'h' * hollow}"
                yield MarkGroup(str(reducer), hollow, rows[chosen], name)


def scatter_reducers(
    axes: Axes,
    stimuli: DataFrame,
    *,
    metric: str,
    looks: Mapping[str, Look],
    size: float,
    place: str = "",
) -> dict[str, Line2D]:
    """Draw stimuli, with bars and with markers of so many points."""
    at = stimuli[metric].clip(lower=find_cut(metric))
    bars: dict[str, Any] = {"colors": style.GREY, "linewidths": 0.35, "alpha": 0.6, "zorder": 1}
    axes.vlines(at, stimuli["low"], stimuli["high"], **bars)
    shown = {}
    for group in group_marks(stimuli, metric, place):
        look, x = looks[group.reducer], at[group.rows.index]
        more: dict[str, Any] = {"gid": group.name} if place else {}
        more |= {"markeredgewidth": style.THIN} if group.hollow else {}
        line = style.plot_marks(
            axes, x, group.rows["mean"], look=look, size=size, filled=not group.hollow, **more
        )
        if not (group.hollow and group.reducer in shown):
            shown[group.reducer] = line
    return shown


def count_clipped(stimuli: DataFrame, metric: str) -> int:
    """Count the stimuli that a scatter cannot show in their place."""
    return int((stimuli[metric] < find_cut(metric)).sum())


def find_cut(metric: str) -> float:
    """Find below what values of a metric are drawn at the edge: those of eq. 1, which has no lower bound, only."""
    is_raw = metric.startswith("spectral_match") and "bounded" not in metric
    return CUT if is_raw else -np.inf


def _mark_clipped(axes: Axes, stimuli: DataFrame, metric: str, *, falling: bool) -> None:
    # The corner that a rising (or falling) cloud of points leaves free.
    height, side = (0.01, "bottom") if falling else (0.99, "top")
    number = count_clipped(stimuli, metric)
    if number:
        edge, lowest = format_number(CUT, kind="count"), format_number(float(stimuli[metric].min()))
        count = f"{number} of {len(stimuli)} stimuli"
        text = f"← hollow: {count} below {edge}\n    (lowest {lowest}), drawn at {edge}"
        axes.text(0.02, height, text, transform=axes.transAxes, va=side)


# Ratings against a metric, recording by recording, with the P.1401 mapping and the noise ceiling.

COLUMNS = 3
ROW_CM, LABELS_CM, STRIP_CM = 2.8, 2.3, 1.9
SIZE = 3.0
"""Of markers, in points."""

PAD = 3.0
"""Points of the scale beside the outermost bars."""

CURVE_POINTS = 200
MAPPINGS = {0: "the metric as it is", 1: "straight line", 3: "monotone cubic"}
"""Order of the mapping -> its name."""


def draw_mapping(
    stimuli: DataFrame,
    judged: P1401,
    association: Association,
    *,
    scale: str,
    looks: Mapping[str, Look],
    level: str = "",
) -> Figure:
    """Draw mean ratings against a metric in one panel per recording; bars: 95 % t intervals over participants."""
    recordings = list(dict.fromkeys(stimuli["recording"]))
    rows = -(-len(recordings) // COLUMNS)
    with style.print_style():
        heights = [ROW_CM * rows + LABELS_CM, STRIP_CM]
        figure = style.new_canvas(sum(heights))
        upper, lower = figure.subfigures(2, 1, height_ratios=heights, squeeze=False)[:, 0]
        shown = _draw_panels(upper, stimuli, judged, metric=association.metric, looks=looks)
        upper.supxlabel(format_axis(association.metric))
        upper.supylabel(style.label_scale(scale, ROW_CM * rows + 1, level=level))
        _draw_strip(lower.add_subplot(), association)
        style.add_title(figure, _describe_mapping(stimuli, judged, association))
        style.add_legend(figure, {name: shown[name] for name in looks if name in shown})
    return figure


def _draw_panels(
    place: SubFigure, stimuli: DataFrame, judged: P1401, *, metric: str, looks: Mapping[str, Look]
) -> dict[str, Line2D]:
    parts = list(stimuli.groupby("recording", sort=False, observed=True))
    columns = min(COLUMNS, len(parts))
    grid = place.subplots(
        -(-len(parts) // columns), columns, sharex=True, sharey=True, squeeze=False
    )
    values = stimuli[metric].to_numpy(np.float64)
    x = np.linspace(max(values.min(), find_cut(metric)), values.max(), CURVE_POINTS)
    width = (style.WIDTH_CM - 1.6) / columns
    shown: dict[str, Line2D] = {}
    for axes, (name, part) in zip(grid.flat, parts, strict=False):
        axes.plot(x, Polynomial(judged.coefficients)(x), color=style.BLACK, linewidth=1.0, zorder=2)
        shown |= scatter_reducers(axes, part, metric=metric, looks=looks, size=SIZE)
        axes.set_title(style.fit_text(str(name), width - 2 * style.MARGIN_CM, lines=2))
        axes.locator_params(nbins=3)
    grid.flat[0].set_ylim(_find_range(stimuli))
    for number, axes in enumerate(grid.flat):
        if number >= len(parts):
            axes.remove()
        elif number + columns >= len(parts):
            axes.tick_params(labelbottom=True)
    return shown


def _find_range(stimuli: DataFrame) -> tuple[float, float]:
    """Find the part of the scale that holds all bars, a third of it at least: panels are small."""
    seen = stimuli[["mean", "low", "high"]].to_numpy(np.float64)
    low, high = float(np.nanmin(seen)), float(np.nanmax(seen))
    missing = max(0.0, (HIGHEST - LOWEST) / 3 - (high - low)) / 2
    return max(LOWEST, low - missing) - PAD, min(HIGHEST, high + missing) + PAD


def _draw_strip(axes: Axes, association: Association) -> None:
    """Draw the correlation on its own axis, with the highest that noise allows."""
    value, ceiling, falling = association.value, association.ceiling, association.value < 0
    ends = [association.low, association.high]
    axes.plot(ends, [0, 0], linewidth=1.2, color=style.BLACK, clip_on=False, zorder=3)
    style.plot_marks(axes, value, 0, look=Look(style.BLACK, "o"), size=4.5, clip_on=False)
    for limit in (ceiling, *([-ceiling] if falling else [])):
        axes.axvline(limit, color=style.BLACK, linestyle="--", linewidth=1.0, zorder=2)
    axes.axvline(0, color=style.GREY, linewidth=0.6, zorder=1)
    low = float(np.nanmin([0.0, association.low, value, -ceiling if falling else 0.0]))
    axes.set(xlim=(low - 0.02, 1.02), ylim=(-1, 1), yticks=[])
    axes.spines["left"].set_visible(False)
    method = association.method.capitalize()
    axes.set_xlabel(f"{method} correlation over all stimuli; broken: ceiling")


def _describe_mapping(stimuli: DataFrame, judged: P1401, association: Association) -> str:
    ceiling = format_number(association.ceiling)
    clipped = count_clipped(stimuli, association.metric)
    edge = format_number(CUT, kind="count")
    there = f" Hollow: below {edge}, drawn there ({clipped} of {len(stimuli)}), the curve fitted where they are."
    hollow = there if clipped else ""
    return (
        f"r = {format_number(association.value)}, 95 % two-way interval "
        f"{format_interval(association.low, association.high)}, noise ceiling {ceiling}. Curve: P.1401 mapping "
        f"({MAPPINGS[judged.order]}), fitted to all n = {len(stimuli)} stimuli of "
        f"{format_recordings(association.n_recordings, association.n_sources)}; bars: 95 % t "
        f"intervals over {format_span(stimuli['n_participants'])} participants.{hollow}"
    )


# Residuals of a mixed model: whether they are normal, and as spread at every height of the scale.

HEIGHT_CM = 4.6
MOST = 2000
"""Points that an eye can use; of more rows this many are drawn, evenly through their order."""

BINS, BINNED = 10, 20
"""Parts of the fitted range for which a median is drawn, and rows that such a part needs."""

POINTS: dict[str, Any] = {"marker": "o", "linestyle": "none", "markersize": 2, "markeredgewidth": 0}


def draw_residuals(*fits: MixedFit, names: Sequence[str] = ()) -> Figure:
    """Draw a normal quantile plot of the residuals, and the residuals against the fitted values: a row per fit.

    The k-th of n normal values in order lies between the quantiles of Beta(k, n - k + 1), turned into normal ones;
    the band is pointwise: one point in twenty lies outside by chance, and neighbours leave it together.
    """
    with style.print_style():
        figure = style.new_canvas(HEIGHT_CM * len(fits))
        grid = figure.subplots(len(fits), 2, squeeze=False)
        for number, ((left, right), fit) in enumerate(zip(grid, fits, strict=True)):
            _draw_quantiles(left, fit.residuals)
            _draw_spread(right, fit.fitted, fit.residuals)
            left.set(xlabel="Normal quantile (SD)", ylabel="Residual (SD)")
            right.set(xlabel="Fitted (points)", ylabel="Residual (points)")
            if names:
                left.set_title(style.fit_text(names[number], style.WIDTH_CM / 2 - 1.5))
        sizes = [len(fit.residuals) for fit in fits]
        drawn = f", {MOST} of them drawn" if max(sizes) > MOST else ""
        style.add_title(
            figure,
            f"Residuals of the mixed model, n = {format_span(sizes)} rows{drawn}. Left: band, 95 % pointwise for "
            "normal residuals. Right: line and band, median and quartiles, row after row in parts of equal size.",
        )
    return figure


def _draw_quantiles(axes: Axes, residuals: Values) -> None:
    from scipy.special import betaincinv, ndtri  # scipy.stats takes half a second to load

    n = len(residuals)
    spread = residuals.std(ddof=1) if n > 1 else 1.0
    ordered = np.sort(residuals) / (spread or 1.0)
    chosen = _choose(n)
    rank = chosen + 1
    expected = ndtri((rank - 0.5) / n)
    low, high = (ndtri(betaincinv(rank, n - rank + 1, share)) for share in (0.025, 0.975))
    axes.locator_params(nbins=4)
    axes.fill_between(expected, low, high, color=style.PALE, linewidth=0, zorder=0)
    axes.axline((0, 0), slope=1, color=style.GREY, linewidth=0.6, zorder=1)
    axes.plot(expected, ordered[chosen], color=style.GREY, zorder=2, **POINTS)


def _draw_spread(axes: Axes, fitted: Values, residuals: Values) -> None:
    order = np.argsort(fitted, kind="stable")
    chosen = order[_choose(len(order))]
    axes.locator_params(nbins=4)
    axes.axhline(0, color=style.GREY, linewidth=0.6, zorder=1)
    axes.plot(fitted[chosen], residuals[chosen], color=style.GREY, alpha=0.4, zorder=2, **POINTS)
    parts = np.array_split(order, min(BINS, len(order) // BINNED)) if len(order) >= BINNED else []
    if len(parts) > 1:
        middles = [np.median(fitted[part]) for part in parts]
        low, half, high = np.array([
            np.quantile(residuals[part], (0.25, 0.5, 0.75)) for part in parts
        ]).T
        axes.fill_between(middles, low, high, color=style.BLACK, alpha=0.2, linewidth=0, zorder=3)
        axes.plot(middles, half, color=style.BLACK, linewidth=1.0, zorder=4)


def _choose(n: int) -> NDArray[np.intp]:
    """Choose places evenly, both ends among them."""
    return np.unique(np.linspace(0, n - 1, min(n, MOST)).round().astype(np.intp))


# Map of stimuli: what people tell apart, how sure each place is, and how many dimensions are enough.

MAP_CM, STRESS_CM, MAP_AXIS_CM = 6.2, 2.2, 1.2
ORIGINAL, STAR = "original", Look(style.BLACK, "*")
"""The hidden reference, and how it is drawn."""

LARGE = 9


def draw_space(ellipses: Ellipses, names: Sequence[str], *, stress: Sequence[float] = ()) -> Figure:
    """Draw the group's map with an ellipse per stimulus."""
    n = len(ellipses.space.positions)
    if len(names) != n or len(set(names)) != n:
        raise ValueError(
            f"names must be one for each of {n} stimuli, got {len(set(names))} different ones"
        )
    looks = style.assign_looks([name for name in names if name != ORIGINAL]) | {ORIGINAL: STAR}
    with style.print_style():
        heights = [MAP_CM, STRESS_CM] if len(stress) else [MAP_CM]
        figure = style.new_canvas(sum(heights) + MAP_AXIS_CM * len(heights))
        panels = figure.subplots(len(heights), 1, height_ratios=heights, squeeze=False)[:, 0]
        _draw_map(panels[0], ellipses, looks=[looks[name] for name in names])
        if len(stress):
            _draw_stress(panels[1], stress)
        star = " Star: original." if ORIGINAL in names else ""
        style.add_title(
            figure,
            f"Group map of dissimilarity, stress-1 = {ellipses.space.stress:.2f}. Ellipses: 95 % bootstrap regions "
            f"over n = {ellipses.n_participants} participants ({ellipses.draws} draws).{star}",
        )
        style.add_legend(figure, style.make_handles({name: looks[name] for name in names}))
    return figure


def _draw_map(axes: Axes, ellipses: Ellipses, *, looks: Sequence[Look]) -> None:
    from matplotlib.patches import Ellipse

    places = zip(ellipses.space.positions, ellipses.half_axes, ellipses.angle, looks, strict=True)
    for place, half, angle, look in places:
        strokes: dict[str, Any] = {
            "facecolor": look.colour,
            "alpha": 0.15,
            "linewidth": 0,
            "zorder": 1,
        }
        axes.add_patch(Ellipse(tuple(place), *(2 * half), angle=float(angle), **strokes))
        size = LARGE if look == STAR else 4.5
        style.plot_marks(axes, place[0], place[1], look=look, size=size, markeredgewidth=0.4)
    unit = "rank order only" if ellipses.space.ordinal else "unit of dissimilarity"
    axes.set(xlabel=f"Dimension 1 ({unit})", ylabel=f"Dimension 2 ({unit})")
    axes.autoscale_view()
    axes.set_aspect("equal", adjustable="datalim")
    axes.locator_params(nbins=6)


def _draw_stress(axes: Axes, stress: Sequence[float]) -> None:
    numbers = list(range(1, len(stress) + 1))
    axes.plot(numbers, stress, marker="o", color=style.BLACK, markersize=3.5, clip_on=False)
    axes.set(xlabel="Number of dimensions", ylabel="Stress-1")
    axes.set(xticks=numbers, ylim=(0, 1.1 * max(*stress, 0.1)))
    axes.locator_params(axis="y", nbins=4)


# Paired judgements: d' of ABX trials.

ENDS = ("", "_low", "_high")


def draw_discrimination(results: Mapping[str, Discrimination]) -> Figure:
    """Draw the d' of each pair of stimuli that was compared in ABX trials, by the pair's name."""
    if not results:
        raise ValueError("results must hold one pair or more, got none")
    rows = []
    for name, found in results.items():
        value, low, high = (float(getattr(found, f"d_independent{end}")) for end in ENDS)
        mark = estimates.Mark(value, low, high, Look(style.BLACK, "o"))
        rows.append(estimates.ForestRow(f"{name} ({found.n_correct}/{found.n_trials})", (mark,)))
    rows = estimates.fit_rows(rows)
    with style.print_style():
        figure, axes = style.new_figure(estimates.find_height(rows) + estimates.AXIS_CM)
        estimates.draw_rows(axes, rows, limits=estimates.find_limits(rows, 0), zero=True)
        # A label of the figure, not the axes: long names may leave the axes less room than the words need.
        figure.supxlabel("d′")
        trials = format_span(found.n_trials for found in results.values())
        style.add_title(
            figure,
            "ABX, observer's model: independent observations. Bars: 95 % Wilson intervals of the share correct, as "
            f"d′. n = {trials} trials per pair (correct/trials in brackets). Line: guessing.",
        )
    return figure
