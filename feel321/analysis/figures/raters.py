"""What each screening rule found of each rater, against its limit."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from feel321.analysis.figures import style
from feel321.analysis.figures.style import Look
from feel321.analysis.words import MINUS, format_count

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from pandas import DataFrame

    from feel321.analysis.screening.rules import Rule
    from feel321.analysis.screening.screen import Screening

STRIP_CM, LINE_CM, GAP_CM, QUALITY_AXIS_CM = 0.45, 0.35, 0.28, 1.6
"""Height of a rule's points, of a line of text, between rules, and of the axis."""

NAMED = 4
"""Flagged raters that are named; the table names all."""

NAME_CM = 1.6
GOLDEN = 0.618
"""Steps by this share of a strip keep neighbours as far apart as can be."""


def draw_raters(screening: Screening) -> Figure:
    """Draw every rater's share under every rule against the rule's limit."""
    table = screening.table
    parts = {rule: table[table["rule"] == rule] for rule in screening.limits}
    with style.print_style():
        texts = {
            rule: _describe_rule(screening.known[rule], parts[rule], limit)
            for rule, limit in screening.limits.items()
        }
        heights = [STRIP_CM + GAP_CM + LINE_CM * (1 + text.count("\n")) for text in texts.values()]
        figure, axes = style.new_figure(sum(heights) + QUALITY_AXIS_CM)
        low = min(0.0, table["share"].min(), table["limit"].min())
        limits = (float(low) - 0.02, max(1.0, float(table["share"].max())) + 0.02)
        axes.set(xlim=limits, ylim=(-sum(heights), 0), yticks=[])
        axes.spines["left"].set_visible(False)
        for (rule, text), bottom in zip(texts.items(), -np.cumsum(heights), strict=True):
            # Left out of the layout, which would take the texts for something beside the axes.
            axes.text(limits[0], bottom + STRIP_CM, text, va="bottom", in_layout=False)
            _draw_strip(axes, parts[rule], bottom=float(bottom))
        figure.supxlabel(
            "Share of judgements; or the rule's correlation,\nor SD as share of the scale"
        )
        number = table["participant"].nunique()
        style.add_title(
            figure,
            f"Screening, {format_count(number, 'participant')}, a point each; line: the rule's limit; cross: flagged. "
            "No intervals: values describe these ratings. Flagged raters should be followed up, not automatically "
            "excluded.",
        )
    return figure


def _describe_rule(known: Rule, part: DataFrame, limit: float) -> str:
    width = style.WIDTH_CM - 3 * style.MARGIN_CM
    says = known.says.format(limit=limit).replace("%", " %").replace(" -", f" {MINUS}")
    source = style.fit_text(f"{says[:1].upper()}{says[1:]} ({known.source})", width, lines=3)
    silent = int(part["share"].isna().sum())
    if silent == len(part):
        return f"{source}\n{style.fit_text(f'Not applied: it needs {known.needs}.', width)}"
    few = f"; not applied to {silent}" if silent else ""
    names = [str(name) for name in part.loc[part["hit"], "participant"]]
    shown = ", ".join(style.fit_text(name, NAME_CM, lines=1) for name in names[:NAMED])
    more = f" and {len(names) - NAMED} more" if len(names) > NAMED else ""
    hits = f"Flagged: {shown}{more}" if names else "Nobody flagged"
    return f"{source}\n{style.fit_text(f'{hits}{few}', width)}"


def _draw_strip(axes: Axes, part: DataFrame, *, bottom: float) -> None:
    share, hit = part["share"].to_numpy(np.float64), part["hit"].to_numpy(bool)
    height = bottom + STRIP_CM * (0.15 + 0.7 * (np.arange(len(part)) * GOLDEN % 1))
    limit = part["limit"].iloc[0]
    axes.axhline(bottom, color=style.BLACK, linewidth=0.3, zorder=1)
    axes.vlines(limit, bottom, bottom + STRIP_CM, color=style.BLACK, linewidth=1.0, zorder=2)
    # Nothing to draw is not drawn: unclipped, it would count as a point in the figure's corner.
    for chosen, look, size in (
        (~hit, Look(style.GREY, "o"), 3.5),
        (hit, Look(style.BLACK, "X"), 5.0),
    ):
        if np.isfinite(share[chosen]).any():
            strokes: dict[str, Any] = {"markeredgewidth": 0.3, "alpha": 0.8, "clip_on": False}
            style.plot_marks(axes, share[chosen], height[chosen], look=look, size=size, **strokes)
