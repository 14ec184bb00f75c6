"""Raters: what each screening rule found of each of them, against its limit."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from analysis.figures.style import BLACK, BLUE, COLUMN_CM, RED, new_figure, print_style
from analysis.figures.text import MARGIN_CM, add_title, fit_text
from analysis.screening.rules import RULES
from analysis.words import MINUS

if TYPE_CHECKING:
    from collections.abc import Hashable, Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from pandas import DataFrame

    from analysis.screening.screen import Screening

STRIP_CM, LINE_CM, GAP_CM, AXIS_CM = 0.45, 0.31, 0.28, 1.5
"""Height of a rule's points, of a line of text, between rules, and of the axis."""

NAMED = 4
"""Flagged raters that are named; the table names all."""

NAME_CM = 1.4
GOLDEN = 0.618
"""Steps by this share of a strip part neighbours as far as can be."""


def draw_raters(screening: Screening) -> Figure:
    """Draw every rater's share under every rule against the rule's limit.

    Parameters
    ----------
    screening : Screening
        What `screen_raters` returns.

    Returns
    -------
    Figure
        A strip per rule: a point per rater, a line at the limit, flagged raters as crosses, named above.
    """
    table = screening.table
    with print_style():
        texts = {rule: _tell(rule, table[table["rule"] == rule], limit) for rule, limit in screening.limits.items()}
        heights = [STRIP_CM + GAP_CM + LINE_CM * (1 + text.count("\n")) for text in texts.values()]
        figure, axes = new_figure(sum(heights) + AXIS_CM)
        low = min(0.0, table["share"].min(), table["limit"].min())
        limits = (float(low) - 0.02, max(1.0, float(table["share"].max())) + 0.02)
        axes.set(xlim=limits, ylim=(-sum(heights), 0), yticks=[])
        axes.spines["left"].set_visible(False)
        for (rule, text), bottom in zip(texts.items(), -np.cumsum(heights), strict=True):
            # Left out of the layout, which would take the texts for something beside the axes.
            axes.text(limits[0], bottom + STRIP_CM, text, va="bottom", in_layout=False)
            _draw_strip(axes, table[table["rule"] == rule], bottom=float(bottom))
        figure.supxlabel("Share of judgements; or the rule's correlation,\nor SD as share of the scale")
        number = table["participant"].nunique()
        add_title(
            figure,
            f"Screening, n = {number} participants, a point each; line: the rule's limit; cross: flagged. No "
            "intervals: values describe these ratings. Flagged raters should be followed up, not automatically "
            "excluded.",
        )
    return figure


def _tell(rule: str, part: DataFrame, limit: float) -> str:
    known = RULES[rule]
    says = known.says.format(limit=limit).replace("%", " %").replace(" -", f" {MINUS}")
    width = COLUMN_CM - 3 * MARGIN_CM
    source = fit_text(f"{says[:1].upper()}{says[1:]} ({known.source})", width, lines=3)
    silent = int(part["share"].isna().sum())
    if silent == len(part):
        return f"{source}\n{fit_text(f'Not applied: it needs {known.needs}.', width)}"
    few = f"; not applied to {silent}" if silent else ""
    hits = _name_hits(part.loc[part["hit"], "participant"].tolist())
    return f"{source}\n{fit_text(f'{hits}{few}', width)}"


def _name_hits(names: Sequence[Hashable]) -> str:
    if not names:
        return "Nobody flagged"
    shown = ", ".join(fit_text(str(name), NAME_CM, lines=1) for name in names[:NAMED])
    more = f" and {len(names) - NAMED} more" if len(names) > NAMED else ""
    return f"Flagged: {shown}{more}"


def _draw_strip(axes: Axes, part: DataFrame, *, bottom: float) -> None:
    share, hit = part["share"].to_numpy(np.float64), part["hit"].to_numpy(bool)
    height = bottom + STRIP_CM * (0.15 + 0.7 * (np.arange(len(part)) * GOLDEN % 1))
    axes.axhline(bottom, color=BLACK, linewidth=0.3, zorder=1)
    axes.vlines(part["limit"].iloc[0], bottom, bottom + STRIP_CM, color=BLACK, linewidth=1.0, zorder=2)
    # Nothing to draw is not drawn: unclipped, it would count as a point in the figure's corner.
    for chosen, marker, size, colour in ((~hit, "o", 3.5, BLUE), (hit, "X", 5.0, RED)):
        if np.isfinite(share[chosen]).any():
            axes.plot(
                share[chosen], height[chosen], marker=marker, markersize=size, color=colour, linestyle="none",
                markeredgecolor="white", markeredgewidth=0.3, alpha=0.8, zorder=3, clip_on=False,
            )  # fmt: skip
