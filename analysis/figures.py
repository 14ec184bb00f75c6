"""The report's figures: ratings against a metric, ratings per reducer. Every one names its interval and n."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from analysis.reliability import SMALLEST
from analysis.scales import tell_measure
from analysis.style import GREY, THIN, Look, new_figure, print_style
from analysis.table import HIGHEST, LOWEST, ROLES
from analysis.words import tell_axis, tell_name, tell_number, tell_range, tell_span, wrap_name

if TYPE_CHECKING:
    from collections.abc import Hashable, Mapping, Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D
    from numpy.typing import NDArray
    from pandas import DataFrame, Series

    from analysis.association import Association
    from analysis.findings import Panel

CUT = -1.0
"""Metrics below this are drawn at the edge: one spectral match of -30 would squeeze all others together."""

LEGEND_COLUMNS, LEGEND_LETTERS = 3, 30
LABEL_LETTERS, AXIS_LETTERS, SCALE_LETTERS = 20, 30, 60
"""Letters per line of a row's and an axis's label, and of a scale's name within it."""

ROW_CM = 0.55
TWO_LINES, APART = 1.4, 0.8
"""Rows that a label of two lines takes, and that part references and anchors from tests."""


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
            name: _scatter_reducer(axes, parts[name], metric=association.metric, look=look)
            for name, look in looks.items()
            if name in parts
        }
        _mark_clipped(axes, panel.stimuli[association.metric].to_numpy(np.float64), falling=association.value < 0)
        limits = LOWEST - 3, HIGHEST + 3
        axes.set(xlabel=tell_axis(association.metric), ylabel=_tell_scale(panel.scale), ylim=limits)
        axes.locator_params(axis="x", nbins=5)
        axes.set_title(_tell_association(association))
        _add_legend(figure, shown)
    return figure


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


def draw_profile(profile: DataFrame, participants: DataFrame, *, looks: Mapping[str, Look]) -> Figure:
    """Draw ratings per reducer: every participant, the mean, and its interval.

    Parameters
    ----------
    profile : DataFrame
        Rows of `profile_reducers` of one scale and level.
    participants : DataFrame
        Rows of `participant_means` of the same.
    looks : Mapping of str to Look
        Look per reducer; their order is the order of the rows.

    Returns
    -------
    Figure
        One column wide; hidden reference and anchors stand apart below a line.
    """
    labels = _label_rows(profile, list(looks))
    places = _place_rows(labels)
    with print_style():
        figure, axes = new_figure(height_cm=3.0 - ROW_CM * min(places.values()))
        _draw_people(axes, participants, places=places)
        for row in profile.to_dict("records"):
            _draw_mean(axes, row, height=places[row["role"], row["reducer"]], look=looks[row["reducer"]])
        _mark_rows(axes, places, labels=list(labels.values()))
        axes.set(xlim=(LOWEST - 2, HIGHEST + 2))
        # Told of the figure, not the axes: long names may leave the axes less room than the words need.
        figure.supxlabel(_tell_scale(profile["scale"].iloc[0]))
        figure.suptitle(_tell_profile(profile["n_participants"]), x=0.02, ha="left")
    return figure


def _tell_scale(scale: str) -> str:
    name = wrap_name(tell_name(scale), SCALE_LETTERS, lines=1)
    return wrap_name(f"Mean {tell_measure(name)} ({LOWEST:.0f}–{HIGHEST:.0f})", AXIS_LETTERS, lines=3)


def _tell_profile(n_participants: Series) -> str:
    people = "\ngrey: each participant's mean"
    if n_participants.max() < SMALLEST:
        return f"Mean of 1 participant, no interval;{people}"
    return f"Mean and 95 % t interval over {tell_span(n_participants)} participants;{people}"


def _add_legend(figure: Figure, shown: Mapping[str, Line2D]) -> None:
    """Give the legend as many columns as its names leave room for, and the figure the height that it takes."""
    tight: dict[str, Any] = {"loc": "outside lower center", "handletextpad": 0, "columnspacing": 0.6, "frameon": False}
    labels = [wrap_name(name, LEGEND_LETTERS) for name in shown]
    for columns in range(LEGEND_COLUMNS, 0, -1):
        legend = figure.legend(list(shown.values()), labels, ncols=columns, **tight)
        size = legend.get_window_extent()
        if size.width <= figure.bbox.width or columns == 1:
            break
        legend.remove()
    width, height = figure.get_size_inches()
    figure.set_size_inches(width, height + size.height / figure.dpi)


def _scatter_reducer(axes: Axes, stimuli: DataFrame, *, metric: str, look: Look) -> Line2D:
    true = stimuli[metric].to_numpy(np.float64)
    mean, low, high = stimuli[["mean", "low", "high"]].to_numpy(np.float64).T
    shown, inside = np.maximum(true, CUT), true >= CUT
    axes.vlines(shown, low, high, colors=GREY, linewidths=0.35, alpha=0.6, zorder=1)
    style: dict[str, Any] = {"marker": look.marker, "linestyle": "none", "color": look.colour, "zorder": 3}
    axes.plot(shown[~inside], mean[~inside], markerfacecolor="white", markeredgewidth=THIN, **style)
    return axes.plot(shown[inside], mean[inside], markeredgecolor="white", markeredgewidth=THIN, **style)[0]


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
    size = f"{result.n_items} stimuli, {result.n_recordings} recordings"
    narrow = tell_range(result.participants_low, result.participants_high)
    return (
        f"{result.method.capitalize()} r = {tell_number(result.value)}, {size}\n"
        f"95 % two-way interval {tell_range(result.low, result.high)}\n"
        f"over {result.n_participants} participants only {narrow}"
    )


def _label_rows(profile: DataFrame, order: list[str]) -> dict[tuple[str, str], str]:
    """Label of each (role, reducer), from top to bottom: tests, reference, anchors."""
    found = set(zip(profile["role"], profile["reducer"], strict=True))
    keys = [(role, name) for role in ROLES for name in order if (role, name) in found]
    return {
        (role, name): wrap_name(name, LABEL_LETTERS)
        if role == ROLES[0]
        else f"{wrap_name(name, LABEL_LETTERS, lines=1)}\n({role})"
        for role, name in keys
    }


def _place_rows(labels: Mapping[tuple[str, str], str]) -> dict[tuple[str, str], float]:
    """Height of each row's middle, the first at 0; rows of two lines take more room."""
    room = np.array([TWO_LINES if "\n" in label else 1.0 for label in labels.values()])
    below = np.array([APART * (role != ROLES[0]) for role, _ in labels])
    middles = np.cumsum(room) - room / 2 + below
    return dict(zip(labels, (middles[0] - middles).tolist(), strict=True))


def _draw_people(axes: Axes, participants: DataFrame, *, places: Mapping[tuple[str, str], float]) -> None:
    style: dict[str, Any] = {"color": GREY, "linewidth": 0.4, "alpha": 0.6, "marker": ".", "markersize": 2}
    is_test = participants["role"] == ROLES[0]
    for (joined, _), part in participants.groupby([is_test, "participant"]):
        height = np.array([places[key] for key in zip(part["role"], part["reducer"], strict=True)])
        down, rating = np.argsort(-height), part["rating"].to_numpy(np.float64)
        axes.plot(rating[down], height[down], linestyle="-" if joined else "none", **style)


def _draw_mean(axes: Axes, row: Mapping[Hashable, Any], *, height: float, look: Look) -> None:
    spread = np.array([[row["mean"] - row["low"]], [row["high"] - row["mean"]]])
    error = None if np.isnan(spread).any() else spread
    axes.errorbar(
        row["mean"], height, xerr=error, fmt=look.marker, color=look.colour, markersize=4.5,
        markeredgecolor="white", markeredgewidth=THIN, elinewidth=1.2, capsize=2.5, zorder=3,
    )  # fmt: skip


def _mark_rows(axes: Axes, places: Mapping[tuple[str, str], float], *, labels: Sequence[str]) -> None:
    axes.set_yticks(list(places.values()), labels)
    axes.set_ylim(min(places.values()) - 0.6, 0.6)
    apart = [height for (role, _), height in places.items() if role != ROLES[0]]
    if apart:
        line = max(apart) + (TWO_LINES + APART) / 2
        axes.axhline(line, color=GREY, linewidth=THIN, linestyle=":")
