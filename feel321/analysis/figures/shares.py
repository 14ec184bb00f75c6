"""Shares of choices that metrics predict, against chance and against how far people agree."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from feel321.analysis.figures import estimates, style
from feel321.analysis.figures.style import Look

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.figure import Figure

    from feel321.analysis.choices.predict import VotePrediction

CHANCE = 50.0


def draw_shares(found: VotePrediction, labels: Sequence[str], subject: str) -> Figure:
    """Draw the percentage of choices that each metric predicts, by its label, the highest first."""
    rows = []
    table = found.shares.assign(label=list(labels)).sort_values(
        "share", ascending=False, kind="stable"
    )
    for row in table.to_dict("records"):
        value, low, high = (100 * float(row[key]) for key in ("share", "low", "high"))
        mark = estimates.Mark(value, low, high, Look(style.BLACK, "o"))
        rows.append(estimates.ForestRow(row["label"], (mark,)))
    rows = estimates.fit_rows(rows)
    known = [100 * share for share in (found.others, found.majority) if np.isfinite(share)]
    with style.print_style():
        figure, axes = style.new_figure(estimates.find_height(rows) + estimates.AXIS_CM)
        estimates.draw_rows(axes, rows, limits=estimates.find_limits(rows, CHANCE, *known))
        axes.axvline(CHANCE, color=style.GREY, linewidth=0.6, zorder=1)
        if known:
            axes.axvspan(min(known), max(known), color=style.PALE, linewidth=0, zorder=0)
        figure.supxlabel("Choices predicted (%)")
        style.add_title(
            figure,
            f"{subject}. n = {found.n_votes} choices, {found.n_participants} participants, {found.n_recordings} "
            "recordings. Bars: 95 % intervals, clustered by both. Line: chance."
            + " Band: majority of the others, and of all."
            * bool(known),
        )
    return figure
