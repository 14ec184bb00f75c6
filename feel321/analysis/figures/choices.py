"""Specification curves, and the quality of raters."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from feel321.analysis.figures import style
from feel321.analysis.figures.style import Look
from feel321.analysis.words import MINUS, format_count, format_name, format_span

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import NDArray
    from pandas import DataFrame

    from feel321.analysis.screening.rules import Rule
    from feel321.analysis.screening.screen import Screening

# Specification curve: one estimate under every choice of screening rules.

CURVE_CM, ROW_CM, UNIVERSES_AXIS_CM = 4.0, 0.41, 1.3
LABEL_CM = 4.2


def draw_multiverse(
    curve: DataFrame, *, rules: Sequence[str], counts: tuple[int, int], per: str = "+0.1"
) -> Figure:
    """Draw the estimate for every distinct set of raters, from the smallest up, and the rules that leave it.

    curve, rules: of a `Multiverse`. counts: combinations of rules, and distinct sets without an estimate.
    """
    if not len(curve):
        raise ValueError("result must have a universe with an estimate, got none; see its notes")
    rules = list(rules)
    heights = [CURVE_CM, ROW_CM * len(rules)]
    with style.print_style():
        figure = style.new_canvas(sum(heights) + UNIVERSES_AXIS_CM)
        upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=heights)
        _draw_curve(upper, curve, alone=~curve[rules].any(axis=1).to_numpy(bool))
        _draw_rules(lower, curve[rules].to_numpy(bool).T, names=rules)
        upper.set_ylabel(f"Points per {per}")
        lower.set_xlabel("Sets of raters, from the smallest estimate up")
        style.add_title(figure, _describe_sets(counts, curve))
    return figure


def _draw_curve(axes: Axes, curve: DataFrame, *, alone: NDArray[np.bool_]) -> None:
    place = np.arange(1, len(curve) + 1)
    value, low, high = curve[["value", "low", "high"]].to_numpy(np.float64).T
    for chosen, look, size in (
        (~alone, Look(style.GREY, "o"), 3.5),
        (alone, Look(style.BLACK, "D"), 5),
    ):
        at = place[chosen]
        bars: dict[str, Any] = {"color": look.colour, "linewidth": 0.8, "alpha": 0.6}
        axes.vlines(at, low[chosen], high[chosen], zorder=2, **bars)
        style.plot_marks(axes, at, value[chosen], look=look, size=size)
    for everybody in value[alone]:
        axes.axhline(everybody, color=style.BLACK, linewidth=0.6, linestyle="--", zorder=1)
    axes.axhline(0, color=style.GREY, linewidth=0.6, zorder=1)
    axes.locator_params(axis="y", nbins=5)
    axes.tick_params(axis="x", length=0, labelbottom=False)


def _draw_rules(axes: Axes, applied: NDArray[np.bool_], *, names: list[str]) -> None:
    for row, chosen in enumerate(applied):
        sets = np.flatnonzero(chosen) + 1
        strokes: dict[str, Any] = {"marker": "s", "markersize": 2.2, "markeredgewidth": 0}
        axes.plot(sets, np.full(len(sets), -row), color=style.BLACK, linestyle="none", **strokes)
    labels = [style.fit_text(format_name(name), LABEL_CM, lines=1) for name in names]
    axes.set_yticks(-np.arange(len(names)), labels)
    axes.set(ylim=(0.6 - len(names), 0.6), xlim=(0.2, applied.shape[1] + 0.8))
    axes.tick_params(axis="y", length=0)
    axes.locator_params(axis="x", integer=True)


def _describe_sets(counts: tuple[int, int], curve: DataFrame) -> str:
    combinations, lost = counts
    without = f" {lost} without an estimate are left out." if lost else ""
    bars = "Bars: 95 % intervals. " if curve["low"].notna().any() else "No intervals. "
    sets = "set" if len(curve) == 1 else "sets"
    return (
        f"{len(curve)} distinct {sets} of raters from {combinations} combinations of screening rules; "
        f"n = {format_span(curve['n_participants'])} participants. {bars}"
        f"Diamond, dashed line: nobody excluded. Below: the fewest rules that leave a set.{without}"
    )


# Raters: what each screening rule found of each of them, against its limit.

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
