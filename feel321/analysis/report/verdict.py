"""What correlations of mean ratings with metrics show, in words, never stronger than the numbers.

They pool all stimuli, those of different recordings too. The claim of a study is about stimuli of the same recording
and stands in `feel321.analysis.report.answer`; correlations are beside it, for comparison with the literature.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from feel321.analysis.table.sheet import PAIRED, SPACE
from feel321.analysis.words import Line, start, tell_name, tell_number, tell_range

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from feel321.analysis.association.correlate import Association, Difference, Panel

UNADJUSTED = "95 % intervals are not adjusted for their number."
UNANSWERED = (
    "These ratings do not show whether the metrics predict what people feel: on no scale were single test stimuli "
    "rated. What was rated is in the profile; the reasons are under What was left out or assumed."
)
LEADING, RANKED = "pearson", "spearman"
"""The method that is shown first, and the one it is checked against."""


def judge_absence(scales: Iterable[str]) -> tuple[Line, ...]:
    """Say that there is no answer."""
    return (Line(UNANSWERED), Line(SPACE)) if PAIRED in scales else (Line(UNANSWERED),)


def sum_up_panels(panels: Sequence[Panel]) -> tuple[str, ...]:
    """Say what the correlations of each scale and level show: with each metric, the ceiling, and their difference."""
    several = len({panel.level for panel in panels}) > 1
    return tuple(_sum_up(panel, several=several) for panel in panels)


def _sum_up(panel: Panel, *, several: bool) -> str:
    leading = [result for result in panel.associations if result.method == LEADING]
    ranked = {result.metric: result for result in panel.associations if result.method == RANKED}
    subject = start(
        tell_name(panel.scale) + (f" (level {tell_name(panel.level)})" if several else "")
    )
    found = "; ".join(_tell_correlation(result, ranked[result.metric]) for result in leading)
    ceiling = (
        ""
        if math.isnan(leading[0].ceiling)
        else f"; the noise ceiling is {tell_number(leading[0].ceiling)}"
    )
    compared = "".join(
        f" {_tell_difference(two)}" for two in panel.differences if two.method == LEADING
    )
    return f"{subject}, over all {leading[0].n_items} stimuli pooled: {found}{ceiling}.{compared}"


def _tell_correlation(result: Association, ranked: Association) -> str:
    name = tell_name(result.metric)
    if math.isnan(result.value):
        why = result.notes[0].removeprefix("No correlation: ").removesuffix(".")
        return f"no correlation with {name} ({why})"
    r = f"r\N{NO-BREAK SPACE}=\N{NO-BREAK SPACE}{tell_number(result.value)} with {name}"
    if math.isnan(result.low):
        return f"{r}, without an interval"
    covers = ", which covers zero" if _covers_zero(result) else ""
    ranks = f"; by ranks {tell_number(ranked.value)}, {tell_range(ranked.low, ranked.high)}"
    ranks = ranks if not math.isnan(ranked.low) and _departs(result, ranked) else ""
    return f"{r} (95 % two-way interval {tell_range(result.low, result.high)}{covers}{ranks})"


def _tell_difference(two: Difference) -> str:
    names = f"{tell_name(two.first)} and {tell_name(two.second)}"
    if math.isnan(two.low):
        return f"The correlations with {names} cannot be compared by an interval."
    interval = tell_range(two.low, two.high)
    zero = ", which covers zero" if _covers_zero(two) else ", which excludes zero"
    return f"The correlations with {names} differ by {tell_number(two.value)} ({interval}{zero})."


def _covers_zero(result: Association | Difference) -> bool:
    return result.low <= 0 <= result.high


def _departs(result: Association, ranked: Association) -> bool:
    """Whether ranks contradict the values: a few outlying ones may hide what all others show."""
    return _covers_zero(result) != _covers_zero(ranked) or result.value * ranked.value < 0
