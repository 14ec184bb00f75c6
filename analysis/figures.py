"""The report's figures: ratings against a metric, ratings per reducer. Every one names its interval and n."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from analysis.style import GREY, THIN, Look, new_figure, print_style
from analysis.table import HIGHEST, LOWEST, ROLES
from analysis.words import tell_axis, tell_name, tell_number, tell_range

if TYPE_CHECKING:
    from collections.abc import Hashable, Mapping

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import NDArray
    from pandas import DataFrame

    from analysis.association import Association
    from analysis.findings import Panel

CUT = -1.0
"""Metrics below this are drawn at the edge: one spectral match of -30 would squeeze all others together."""

LEGEND_COLUMNS = 3
ROW_CM = 0.55
TWO_LINES = 1.4
"""Rows that the label of a reference or an anchor takes."""


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
        One column wide; thin bars are 95 % intervals over participants. Stimuli with a metric below `CUT`
        stand, hollow, at the left edge and are counted.
    """
    with print_style():
        figure, axes = new_figure(height_cm=9.5)
        for name, look in looks.items():
            stimuli = panel.stimuli[panel.stimuli["reducer"] == name]
            _scatter_reducer(axes, stimuli, metric=association.metric, look=look)
        _mark_clipped(axes, panel.stimuli[association.metric].to_numpy(np.float64), falling=association.value < 0)
        scale = f"Mean {tell_name(panel.scale)} rating ({LOWEST:.0f}–{HIGHEST:.0f})"
        axes.set(xlabel=tell_axis(association.metric), ylabel=scale, ylim=(LOWEST - 3, HIGHEST + 3))
        axes.locator_params(axis="x", nbins=5)
        axes.set_title(_tell_association(association))
        tight: dict[str, Any] = {"handletextpad": 0, "columnspacing": 0.6, "frameon": False}
        figure.legend(loc="outside lower center", ncols=LEGEND_COLUMNS, **tight)
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
    places = _place_rows(profile, list(looks))
    with print_style():
        figure, axes = new_figure(height_cm=3.0 - ROW_CM * min(places.values()))
        _draw_people(axes, participants, places=places)
        for row in profile.to_dict("records"):
            _draw_mean(axes, row, height=places[row["role"], row["reducer"]], look=looks[row["reducer"]])
        _label_rows(axes, places)
        scale = f"Mean {tell_name(profile['scale'].iloc[0])} rating ({LOWEST:.0f}–{HIGHEST:.0f})"
        axes.set(xlabel=scale, xlim=(LOWEST - 2, HIGHEST + 2))
        n = int(profile["n_participants"].max())
        axes.set_title(f"Mean and 95 % t interval over {n} participants;\ngrey: each participant's mean")
    return figure


def _scatter_reducer(axes: Axes, stimuli: DataFrame, *, metric: str, look: Look) -> None:
    if stimuli.empty:
        return
    true = stimuli[metric].to_numpy(np.float64)
    mean, low, high = stimuli[["mean", "low", "high"]].to_numpy(np.float64).T
    shown, inside = np.maximum(true, CUT), true >= CUT
    axes.vlines(shown, low, high, colors=GREY, linewidths=0.35, alpha=0.6, zorder=1)
    style: dict[str, Any] = {"marker": look.marker, "linestyle": "none", "color": look.colour, "zorder": 3}
    name = str(stimuli["reducer"].iloc[0])
    axes.plot(shown[inside], mean[inside], markeredgecolor="white", markeredgewidth=THIN, label=name, **style)
    axes.plot(shown[~inside], mean[~inside], markerfacecolor="white", markeredgewidth=THIN, **style)


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


def _place_rows(profile: DataFrame, order: list[str]) -> dict[tuple[str, str], float]:
    """Height of each (role, reducer), tests on top and a free row below them."""
    found = set(zip(profile["role"], profile["reducer"], strict=True))
    tests, *others = [[(role, name) for name in order if (role, name) in found] for role in ROLES]
    apart = [key for keys in others for key in keys]
    places = {key: -float(number) for number, key in enumerate(tests)}
    return places | {key: -len(tests) - 1 - TWO_LINES * number for number, key in enumerate(apart)}


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


def _label_rows(axes: Axes, places: Mapping[tuple[str, str], float]) -> None:
    labels = [name if role == ROLES[0] else f"{name}\n({role})" for role, name in places]
    axes.set_yticks(list(places.values()), labels)
    axes.set_ylim(min(places.values()) - 0.6, 0.6)
    tests = sum(role == ROLES[0] for role, _ in places)
    if tests < len(places):
        axes.axhline(-float(tests), color=GREY, linewidth=THIN, linestyle=":")
