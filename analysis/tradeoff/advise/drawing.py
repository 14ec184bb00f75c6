"""The figure: scenes against reducers, and which are sufficient."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from analysis.figures.style import BLUE, CM_PER_INCH, COLUMN_CM, GREY, PALE, RED, new_figure, print_style
from analysis.figures.text import add_title, fit_text

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from analysis.tradeoff.advise.choice import Advice
    from analysis.tradeoff.advise.verdict import Verdict

ROW_CM, LETTER_CM, REST_CM = 0.42, 0.15, 2.0
"""Height of a row, of a letter of an upright label, and of key and gaps."""

NAME_CM = 2.9
COLUMN_WIDE_CM = 0.36
"""Least width of a reducer's column: its upright name must not touch the next."""

TITLE = "Least sufficient reducer of every scene: the simplest (from left to right) that is as good as the best."
CLOSEST = "closest, not sufficient"
KEYS = ("simplest sufficient", "sufficient", "not sufficient", CLOSEST, "beyond the latency budget")


def draw_advice(advices: Sequence[Advice]) -> Figure:
    """Draw which reducers suffice for which scenes.

    Parameters
    ----------
    advices : sequence of Advice
        Of one context, one row each.

    Returns
    -------
    Figure
        Reducers from the simplest on; scenes without vibration have an empty row.
    """
    names = [verdict.name for verdict in next((each.verdicts for each in advices if each.verdicts), ())]
    with print_style():
        head = LETTER_CM * max(map(len, names), default=0)
        figure, axes = new_figure(head + ROW_CM * len(advices) + REST_CM)
        figure.set_figwidth(max(figure.get_figwidth(), (COLUMN_WIDE_CM * len(names) + NAME_CM + 0.5) / CM_PER_INCH))
        states = set()
        for row, advice in enumerate(advices):
            for verdict in advice.verdicts:
                states.add(state := tell_state(advice, verdict))
                axes.plot(names.index(verdict.name), row, linestyle="none", **_MARKS[state])
        axes.set(xlim=(-0.6, max(len(names), 1) - 0.4), ylim=(len(advices) - 0.4, -0.6))
        axes.set_xticks(range(len(names)), names, rotation=90)
        axes.set_yticks(range(len(advices)), [fit_text(advice.scene.name, NAME_CM, lines=1) for advice in advices])
        axes.xaxis.tick_top()
        axes.tick_params(length=0)
        axes.spines[:].set_visible(False)
        _add_key(axes, [key for key in KEYS if key in states], wide=figure.get_figwidth() * CM_PER_INCH / COLUMN_CM)
        add_title(figure, TITLE)
    return figure


def tell_state(advice: Advice, verdict: Verdict) -> str:
    """Say what a reducer is to a scene.

    Parameters
    ----------
    advice : Advice
        Of the scene.
    verdict : Verdict
        Of the reducer.

    Returns
    -------
    str
        One of `KEYS`.
    """
    if not verdict.in_budget:
        return "beyond the latency budget"
    if verdict.name == advice.answer:
        return "simplest sufficient"
    if verdict.is_sufficient:
        return "sufficient"
    return CLOSEST if verdict.name == advice.closest else "not sufficient"


_MARKS: dict[str, Any] = {
    "simplest sufficient": {"marker": "o", "markersize": 7, "color": BLUE},
    "sufficient": {"marker": "o", "markersize": 7, "color": PALE, "markeredgecolor": BLUE, "markeredgewidth": 0.6},
    "not sufficient": {"marker": "x", "markersize": 4, "color": GREY},
    CLOSEST: {"marker": "D", "markersize": 4.5, "color": "white", "markeredgecolor": RED, "markeredgewidth": 0.9},
    "beyond the latency budget": {"marker": "_", "markersize": 5, "color": GREY},
}


def _add_key(axes: Axes, keys: Sequence[str], *, wide: float) -> None:
    from matplotlib.lines import Line2D

    handles = [Line2D([], [], linestyle="none", label=key, **_MARKS[key]) for key in keys]
    axes.legend(
        handles=handles, loc="upper left", bbox_to_anchor=(-0.45 / wide, 0.0), ncols=2, frameon=False,
        columnspacing=1.0, handletextpad=0.3,
    )  # fmt: skip
