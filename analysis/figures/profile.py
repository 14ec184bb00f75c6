"""Ratings per reducer: every participant, their distribution, the mean and its interval."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from analysis.agreement.reliability import SMALLEST
from analysis.figures.style import GREY, THIN, Look, new_figure, print_style
from analysis.figures.text import tell_scale
from analysis.table.reading import HIGHEST, LOWEST, ROLES
from analysis.words import tell_span, wrap_name

if TYPE_CHECKING:
    from collections.abc import Hashable, Mapping, Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import NDArray
    from pandas import DataFrame, Series

LABEL_LETTERS = 20
"""Letters per line of a row's label."""

ROW_CM = 0.8
TWO_LINES, APART = 1.4, 0.8
"""Rows that a label of two lines takes, and that part references and anchors from tests."""

CLOUD, CLOUD_POINTS = 3, 201
"""Participants that a distribution needs, and points of its outline."""

CLOUD_OFF, CLOUD_ROWS, CLOUD_EDGE = 0.14, 0.5, 0.01
"""Where a distribution starts above its row and how high it is, in rows; where it ends, as share of its height."""


def draw_profile(profile: DataFrame, participants: DataFrame, *, looks: Mapping[str, Look]) -> Figure:
    """Draw ratings per reducer as a raincloud: every participant, their distribution, the mean and its interval.

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
        for (role, name), height in places.items():
            chosen = (participants["role"] == role) & (participants["reducer"] == name)
            _draw_cloud(axes, participants.loc[chosen, "rating"].to_numpy(), height=height, look=looks[name])
        for row in profile.to_dict("records"):
            _draw_mean(axes, row, height=places[row["role"], row["reducer"]], look=looks[row["reducer"]])
        _mark_rows(axes, places, labels=list(labels.values()))
        axes.set(xlim=(LOWEST - 2, HIGHEST + 2))
        # Told of the figure, not the axes: long names may leave the axes less room than the words need.
        figure.supxlabel(tell_scale(profile["scale"].iloc[0]))
        figure.suptitle(_tell_profile(profile["n_participants"]), x=0.02, ha="left")
    return figure


def _tell_profile(n_participants: Series) -> str:
    people = "\ngrey: each participant's mean; clouds: their distribution"
    if n_participants.max() < SMALLEST:
        return f"Mean of 1 participant, no interval;{people}"
    return f"Mean and 95 % t interval over {tell_span(n_participants)} participants;{people}"


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


def _draw_cloud(axes: Axes, ratings: NDArray[np.float64], *, height: float, look: Look) -> None:
    """Draw how the participants' means are distributed, above their row."""
    from scipy.stats import gaussian_kde

    if len(np.unique(ratings)) < CLOUD:
        return
    place = np.linspace(LOWEST, HIGHEST, CLOUD_POINTS)
    density = gaussian_kde(ratings)(place)
    seen = density > CLOUD_EDGE * density.max()
    top = height + CLOUD_OFF + CLOUD_ROWS * density / density.max()
    axes.fill(
        np.concatenate([place[seen], place[seen][::-1]]),
        np.concatenate([top[seen], np.full(seen.sum(), height + CLOUD_OFF)]),
        color=look.colour, alpha=0.3, linewidth=0, zorder=2,
    )  # fmt: skip


def _draw_mean(axes: Axes, row: Mapping[Hashable, Any], *, height: float, look: Look) -> None:
    spread = np.array([[row["mean"] - row["low"]], [row["high"] - row["mean"]]])
    error = None if np.isnan(spread).any() else spread
    axes.errorbar(
        row["mean"], height, xerr=error, fmt=look.marker, color=look.colour, markersize=4.5,
        markeredgecolor="white", markeredgewidth=THIN, elinewidth=1.2, capsize=2.5, zorder=3,
    )  # fmt: skip


def _mark_rows(axes: Axes, places: Mapping[tuple[str, str], float], *, labels: Sequence[str]) -> None:
    axes.set_yticks(list(places.values()), labels)
    axes.set_ylim(min(places.values()) - 0.6, 0.8)
    apart = [height for (role, _), height in places.items() if role != ROLES[0]]
    if apart:
        line = max(apart) + (TWO_LINES + APART) / 2
        axes.axhline(line, color=GREY, linewidth=THIN, linestyle=":")
