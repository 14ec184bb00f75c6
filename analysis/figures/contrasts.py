"""Equivalence plot: differences between reducers against the margin within which they would not matter."""

from __future__ import annotations

from typing import TYPE_CHECKING

from analysis.figures.rows import AXIS_CM, Mark, Row, draw_rows, find_height, find_limits, fit_rows
from analysis.figures.style import BLACK, BLUE, GREY, PALE, Look, new_figure, print_style
from analysis.figures.text import add_title
from analysis.table.sources import tell_recordings
from analysis.words import tell_number

if TYPE_CHECKING:
    from collections.abc import Mapping

    from matplotlib.figure import Figure

    from analysis.contrasts.equivalence import Equivalence

EQUIVALENT, OPEN = Look(BLUE, "o"), Look(BLACK, "D")


def draw_equivalence(
    contrasts: Mapping[str, Equivalence],
    *,
    n_participants: int,
    n_recordings: int,
    n_sources: int | None = None,
    unit: str = "points of rating",
) -> Figure:
    """Draw 90 % intervals of differences against the margin of equivalence.

    Parameters
    ----------
    contrasts : Mapping of str to Equivalence
        What is compared, such as ``dft321 − mag321`` -> its test; all against the same margin.
    n_participants, n_recordings, n_sources : int
        What the differences rest on.
    unit : str
        Of the differences.

    Returns
    -------
    Figure
        A row per contrast, in the order given; filled where equivalence is shown, hollow where it is not.

    Raises
    ------
    ValueError
        If there are no contrasts, or several margins.
    """
    margins = {(test.low, test.high) for test in contrasts.values()}
    if len(margins) != 1:
        raise ValueError(f"contrasts: got {len(margins)} margins, allowed is one for all; draw a figure for each")
    ((low, high),) = margins
    with print_style():
        rows = fit_rows(Row(name, (_mark(test),)) for name, test in contrasts.items())
        figure, axes = new_figure(find_height(rows) + AXIS_CM)
        axes.axvspan(low, high, color=PALE, linewidth=0, zorder=0)
        axes.axvline(0, color=GREY, linewidth=0.6, zorder=1)
        draw_rows(axes, rows, limits=find_limits(rows, 0, low, high))
        axes.set_xlabel(f"Difference ({unit})")
        shown = sum(test.equivalent for test in contrasts.values())
        margin = f"{tell_number(low, kind='rating')} to {tell_number(high, kind='rating')}"
        add_title(
            figure,
            f"Bars: 90 % intervals, of two one-sided tests at 5 %. Shaded: margin, {margin} {unit}. "
            f"Filled: equivalent, {shown} of {len(contrasts)}; hollow: not shown. n = {n_participants} participants, "
            f"{tell_recordings(n_recordings, n_sources or n_recordings)}.",
        )
    return figure


def _mark(test: Equivalence) -> Mark:
    look = EQUIVALENT if test.equivalent else OPEN
    return Mark(test.estimate, test.low90, test.high90, look, filled=test.equivalent)
