"""Paired judgements: Bradley-Terry abilities, and d' of ABX trials."""

from __future__ import annotations

from typing import TYPE_CHECKING

from analysis.contrasts.bradley_terry import ORDER
from analysis.figures.rows import AXIS_CM, PLAIN, Mark, Row, draw_rows, find_height, find_limits, fit_rows
from analysis.figures.style import BLUE, GREY, Look, new_figure, print_style
from analysis.figures.text import add_title, fit_text
from analysis.words import tell_span

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from matplotlib.figure import Figure

    from analysis.contrasts.bradley_terry import BradleyTerry
    from analysis.contrasts.discrimination import Discrimination

OBSERVERS = {"independent": "independent observations", "differencing": "differencing"}
"""Model of the observer -> its name in words."""

AXIS_LABEL_CM = 6.5


def draw_abilities(result: BradleyTerry, *, looks: Mapping[str, Look] | None = None) -> Figure:
    """Draw Bradley-Terry abilities with their intervals.

    Parameters
    ----------
    result : BradleyTerry
        The model.
    looks : Mapping of str to Look, optional
        Look per item, where other figures show the same ones.

    Returns
    -------
    Figure
        Items from the ablest down; the reference, at 0 by definition, is hollow; an order effect comes last.
    """
    given = looks or {}
    items = result.fixed.drop(index=ORDER, errors="ignore").sort_values("estimate", ascending=False, kind="stable")
    marks = {
        str(name): Mark(row["estimate"], row["low"], row["high"], given.get(str(name), PLAIN),
                        filled=name != result.reference)
        for name, row in items.iterrows()
    }  # fmt: skip
    rows = [Row(name, (mark,)) for name, mark in marks.items()]
    for order in result.fixed[result.fixed.index == ORDER].to_dict("records"):
        rows += [Row("being first"), Row("against an equal", (Mark(order["estimate"], order["low"], order["high"]),))]
    ties = f", {result.n_ties} of them ties" if result.n_ties else ""
    text = (
        f"Bradley-Terry abilities; bars: {result.uncertainty}. n = {result.n_comparisons:.0f} comparisons{ties}. "
        "Hollow: reference, 0 by definition."
    )
    return _draw(rows, f"Ability (log odds against {result.reference})", text)


def draw_discrimination(results: Mapping[str, Discrimination], *, observer: str = "independent") -> Figure:
    """Draw the d' of each pair of stimuli that was compared in ABX trials.

    Parameters
    ----------
    results : Mapping of str to Discrimination
        Name of the pair -> its result.
    observer : str
        Model of the observer, ``independent`` or ``differencing``.

    Returns
    -------
    Figure
        A row per pair, in the order given; labels hold correct answers over trials. 0 is guessing; an arrow
        leads to infinity, where no answer was wrong.

    Raises
    ------
    ValueError
        If there are no results, or the observer is unknown.
    """
    if observer not in OBSERVERS:
        raise ValueError(f"observer: got {observer!r}, allowed are {', '.join(OBSERVERS)}")
    if not results:
        raise ValueError("results: got none, allowed is one pair or more")
    rows = []
    for name, found in results.items():
        value, low, high = (float(getattr(found, f"d_{observer}{end}")) for end in ("", "_low", "_high"))
        label = f"{name} ({found.n_correct}/{found.n_trials})"
        rows.append(Row(label, (Mark(value, low, high, Look(BLUE, "o")),)))
    trials = tell_span(found.n_trials for found in results.values())
    text = (
        f"ABX, observer's model: {OBSERVERS[observer]}. Bars: 95 % Wilson intervals of the share correct, as d′. "
        f"n = {trials} trials per pair (correct/trials in brackets). Line: guessing."
    )
    return _draw(rows, "d′", text)


def _draw(labelled: Sequence[Row], label: str, text: str) -> Figure:
    with print_style():
        rows = fit_rows(labelled)
        figure, axes = new_figure(find_height(rows) + AXIS_CM)
        axes.axvline(0, color=GREY, linewidth=0.6, zorder=1)
        draw_rows(axes, rows, limits=find_limits(rows, 0))
        # Told of the figure, not the axes: long names may leave the axes less room than the words need.
        figure.supxlabel(fit_text(label, AXIS_LABEL_CM))
        add_title(figure, text)
    return figure
