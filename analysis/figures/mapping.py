"""Ratings against a metric, recording by recording, with the P.1401 mapping and the noise ceiling."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.polynomial import Polynomial

from analysis.figures.legend import add_legend
from analysis.figures.scatter import CUT, count_clipped, scatter_reducer
from analysis.figures.style import BLACK, BLUE, COLUMN_CM, GREY, Look, new_canvas, print_style
from analysis.figures.text import MARGIN_CM, add_title, fit_text, tell_scale
from analysis.table.reading import HIGHEST, LOWEST
from analysis.table.sources import tell_recordings
from analysis.words import tell_axis, tell_number, tell_range, tell_span

if TYPE_CHECKING:
    from collections.abc import Mapping

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, SubFigure
    from matplotlib.lines import Line2D
    from pandas import DataFrame

    from analysis.association.correlate import Association
    from analysis.p1401.mapping import P1401

COLUMNS = 3
ROW_CM, LABELS_CM, STRIP_CM = 2.5, 1.6, 1.9
SIZE = 3.0
"""Of markers, in points."""

PAD = 3.0
"""Points of the scale beside the outermost bars."""

CURVE_POINTS = 200
MAPPINGS = {0: "the metric as it is", 1: "straight line", 3: "monotone cubic"}
"""Order of the mapping -> its name."""


def draw_mapping(
    stimuli: DataFrame, judged: P1401, association: Association, *, scale: str, looks: Mapping[str, Look]
) -> Figure:
    """Draw mean ratings against a metric in one panel per recording.

    Parameters
    ----------
    stimuli : DataFrame
        One row per test stimulus of one scale and level: recording, reducer, mean, low, high, n_participants and
        the metric.
    judged : P1401
        What P.1401 says of the metric: its mapping is drawn in every panel.
    association : Association
        The metric, its correlation and the noise ceiling: drawn in a strip below.
    scale : str
        What was rated.
    looks : Mapping of str to Look
        Look per reducer.

    Returns
    -------
    Figure
        Bars are 95 % t intervals over participants; in the strip the bar is the two-way interval, the broken line
        the ceiling. Stimuli with a metric below `CUT` stand, hollow, at the left edge and are counted.
    """
    recordings = list(dict.fromkeys(stimuli["recording"]))
    rows = -(-len(recordings) // COLUMNS)
    with print_style():
        heights = [ROW_CM * rows + LABELS_CM, STRIP_CM]
        figure = new_canvas(sum(heights))
        upper, lower = figure.subfigures(2, 1, height_ratios=heights, squeeze=False)[:, 0]
        shown = _draw_panels(upper, stimuli, judged, metric=association.metric, looks=looks)
        upper.supxlabel(tell_axis(association.metric))
        upper.supylabel(fit_text(tell_scale(scale).replace("\n", " "), ROW_CM * rows + 1, lines=3))
        _draw_strip(lower.add_subplot(), association)
        add_title(figure, _tell(stimuli, judged, association))
        add_legend(figure, {name: shown[name] for name in looks if name in shown})
    return figure


def _draw_panels(
    place: SubFigure, stimuli: DataFrame, judged: P1401, *, metric: str, looks: Mapping[str, Look]
) -> dict[str, Line2D]:
    parts = list(stimuli.groupby("recording", sort=False, observed=True))
    columns = min(COLUMNS, len(parts))
    grid = place.subplots(-(-len(parts) // columns), columns, sharex=True, sharey=True, squeeze=False)
    values = stimuli[metric].to_numpy(np.float64)
    x = np.linspace(max(values.min(), CUT), values.max(), CURVE_POINTS)
    width = (COLUMN_CM - 1.6) / columns
    shown: dict[str, Line2D] = {}
    for axes, (name, part) in zip(grid.flat, parts, strict=False):
        axes.plot(x, Polynomial(judged.coefficients)(x), color=BLACK, linewidth=1.0, zorder=2)
        for reducer, own in part.groupby("reducer", observed=True):
            shown[str(reducer)] = scatter_reducer(axes, own, metric=metric, look=looks[str(reducer)], size=SIZE)
        axes.set_title(fit_text(str(name), width - 2 * MARGIN_CM, lines=2))
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
    """Draw the correlation on its own axis, with how far it could come."""
    style: dict[str, Any] = {"color": BLUE, "clip_on": False, "zorder": 3}
    axes.plot([association.low, association.high], [0, 0], linewidth=1.2, **style)
    axes.plot(association.value, 0, marker="o", markersize=4.5, markeredgecolor="white", markeredgewidth=0.5, **style)
    axes.axvline(association.ceiling, color=BLACK, linestyle="--", linewidth=1.0, zorder=2)
    axes.axvline(0, color=GREY, linewidth=0.6, zorder=1)
    ends = [0.0, 1.0, association.low, association.value, -association.ceiling if association.value < 0 else 0.0]
    low = float(np.nanmin(ends))
    if association.value < 0:
        axes.axvline(-association.ceiling, color=BLACK, linestyle="--", linewidth=1.0, zorder=2)
    axes.set(xlim=(low - 0.02, 1.02), ylim=(-1, 1), yticks=[])
    axes.spines["left"].set_visible(False)
    axes.set_xlabel(f"{association.method.capitalize()} correlation over all stimuli; broken: ceiling")


def _tell(stimuli: DataFrame, judged: P1401, association: Association) -> str:
    ceiling = tell_number(association.ceiling)
    clipped = count_clipped(stimuli[association.metric].to_numpy(np.float64))
    edge = tell_number(CUT, kind="count")
    there = f" Hollow: below {edge}, drawn there ({clipped} of {len(stimuli)}), the curve fitted where they are."
    hollow = there if clipped else ""
    return (
        f"r = {tell_number(association.value)}, 95 % two-way interval "
        f"{tell_range(association.low, association.high)}, noise ceiling {ceiling}. Curve: P.1401 mapping "
        f"({MAPPINGS[judged.order]}), fitted to all n = {len(stimuli)} stimuli of "
        f"{tell_recordings(association.n_recordings, association.n_sources)}; bars: 95 % t "
        f"intervals over {tell_span(stimuli['n_participants'])} participants.{hollow}"
    )
