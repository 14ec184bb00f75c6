"""Estimates with intervals, one row each: what forest plots, abilities and equivalence tests have in common.

Conventions: heights are in cm, the first row ends at 0 and the others lie below, so that a row with a label of two
lines, or with several marks, has the room that it needs.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from analysis.figures.style import BLACK, GREY, THIN, Look
from analysis.figures.text import fit_text

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from matplotlib.axes import Axes

LABEL_CM = 2.9
LINE_CM, GAP_CM, MARK_CM = 0.29, 0.1, 0.2
"""Height of a line of text, between rows, and of a mark."""

AXIS_CM = 1.4
"""Room for an axis's numbers and its label."""

PAD = 0.06
FARTHEST = 6.0
"""An interval is cut, with an arrow, where it is this many times as wide as the range of the estimates and of half
of all intervals: one that tells nothing must not squeeze all others."""

PLAIN = Look(BLACK, "o")
UNKNOWN = "no estimate"


@dataclass(frozen=True, slots=True)
class Mark:
    """An estimate to be drawn.

    Parameters
    ----------
    value, low, high : float
        Estimate and interval; NaN where there is none, infinite ends get an arrow.
    look : Look
        Colour and marker.
    filled : bool
        Whether the marker is filled.
    """

    value: float
    low: float = float("nan")
    high: float = float("nan")
    look: Look = PLAIN
    filled: bool = True


@dataclass(frozen=True, slots=True)
class Row:
    """A row.

    Parameters
    ----------
    label : str
        Any name; it is broken, and if need be cut, to its place.
    marks : tuple of Mark
        From top to bottom; a heading has none.
    """

    label: str
    marks: tuple[Mark, ...] = ()

    @property
    def height_cm(self) -> float:
        """Room that it takes."""
        return GAP_CM + max(LINE_CM * (1 + self.label.count("\n")), MARK_CM * len(self.marks))


def fit_rows(rows: Iterable[Row], *, width_cm: float = LABEL_CM) -> list[Row]:
    """Break the labels of rows to their place.

    Parameters
    ----------
    rows : iterable of Row
        With labels of any length.
    width_cm : float
        Width of the place.

    Returns
    -------
    list of Row
        With labels of two lines at most.
    """
    return [replace(row, label=fit_text(row.label, width_cm)) for row in rows]


def find_height(rows: Iterable[Row]) -> float:
    """Add the heights of rows.

    Parameters
    ----------
    rows : iterable of Row
        With broken labels.

    Returns
    -------
    float
        In cm.
    """
    return sum(row.height_cm for row in rows)


def find_limits(rows: Iterable[Row], *include: float) -> tuple[float, float]:
    """Find the part of the axis that holds all estimates, and all intervals that are not endless.

    Parameters
    ----------
    rows : iterable of Row
        What is to be seen.
    *include : float
        What is to be seen besides, as 0.

    Returns
    -------
    tuple of float
        Lower and upper limit of the axis.
    """
    marks = [mark for row in rows for mark in row.marks]
    values = np.array([*(mark.value for mark in marks), *include], dtype=np.float64)
    ends = np.array([(mark.low, mark.high) for mark in marks], dtype=np.float64).reshape(-1, 2)
    values, ends = values[np.isfinite(values)], ends[np.isfinite(ends).all(axis=1)]
    if not len(values):
        return -1.0, 1.0
    least, most = values.min(), values.max()
    usual = float(np.median(ends[:, 1] - ends[:, 0])) if len(ends) else 0.0
    room = FARTHEST * max(most - least, usual, np.finfo(float).tiny)
    low = max(min(least, ends[:, 0].min(initial=least)), least - room)
    high = min(max(most, ends[:, 1].max(initial=most)), most + room)
    pad = PAD * (high - low) or 1.0
    return float(low - pad), float(high + pad)


def draw_rows(axes: Axes, rows: Sequence[Row], *, limits: tuple[float, float]) -> None:
    """Draw rows and label them.

    Parameters
    ----------
    axes : Axes
        Where to.
    rows : sequence of Row
        From top to bottom, with broken labels.
    limits : tuple of float
        Of the axis.
    """
    middles = _place(rows)
    axes.set(xlim=limits, ylim=(-find_height(rows), 0))
    for row, middle in zip(rows, middles, strict=True):
        for mark, height in zip(row.marks, _spread(middle, len(row.marks)), strict=True):
            _draw_mark(axes, mark, height=height, limits=limits)
    axes.set_yticks(middles, [row.label for row in rows])
    axes.tick_params(axis="y", length=0)
    for label, row in zip(axes.get_yticklabels(), rows, strict=True):
        label.set_fontweight("normal" if row.marks else "bold")
    axes.locator_params(axis="x", nbins=5)


def _place(rows: Sequence[Row]) -> list[float]:
    heights = np.array([row.height_cm for row in rows])
    middles: list[float] = (heights / 2 - np.cumsum(heights)).tolist()
    return middles


def _spread(middle: float, number: int) -> Iterator[float]:
    return (middle + MARK_CM * ((number - 1) / 2 - place) for place in range(number))


def _draw_mark(axes: Axes, mark: Mark, *, height: float, limits: tuple[float, float]) -> None:
    style: dict[str, Any] = {"color": mark.look.colour, "zorder": 3, "clip_on": False}
    if np.isnan(mark.value):
        axes.text(sum(limits) / 2, height, UNKNOWN, ha="center", va="center", color=GREY)
        return
    low, high = np.clip((mark.low, mark.high), *limits)
    axes.plot([low, high], [height, height], linewidth=1.0, solid_capstyle="butt", **style)
    for end, edge, arrow in ((mark.low, limits[0], "<"), (mark.high, limits[1], ">")):
        if (end < edge) if arrow == "<" else (end > edge):
            axes.plot(edge, height, marker=arrow, markersize=3, markeredgewidth=0, **style)
    if np.isfinite(mark.value):
        face = mark.look.colour if mark.filled else "white"
        edge_colour = "white" if mark.filled else mark.look.colour
        axes.plot(
            mark.value, height, marker=mark.look.marker, markerfacecolor=face, markeredgecolor=edge_colour,
            markeredgewidth=THIN if mark.filled else 0.8, **style,
        )  # fmt: skip
