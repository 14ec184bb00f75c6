"""The answer in words, generated from the numbers and never stronger than they are.

A direction is claimed only where the two-way interval leaves zero out, and a better predictor only where its
own correlation has a direction; everything else is said to be undecided, not absent.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from analysis.report.lines import Line
from analysis.table.scales import PAIRED, SPACE
from analysis.table.sources import tell_recordings
from analysis.words import tell_name, tell_number, tell_range, tell_ratings

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from analysis.association.correlate import Association, Difference
    from analysis.findings import Panel

UNADJUSTED = "Each 95 % interval stands for itself; none is adjusted for how many there are."
UNANSWERED = (
    "These ratings do not tell whether the metrics predict what people feel: on no scale were single test stimuli "
    "rated. What there is stands in the profile; why there is no more stands under What was left out or assumed."
)
LEADING, RANKED = "pearson", "spearman"
"""The method that the verdict rests on, and the one it is checked against."""


def judge_absence(scales: Iterable[str]) -> tuple[Line, ...]:
    """Say that there is no answer.

    Parameters
    ----------
    scales : iterable of str
        What was rated.

    Returns
    -------
    tuple of Line
        What is missing.
    """
    return (Line(UNANSWERED), Line(SPACE)) if PAIRED in scales else (Line(UNANSWERED),)


def judge_panels(panels: Sequence[Panel]) -> tuple[str, ...]:
    """Say what the correlations show about the metrics.

    Parameters
    ----------
    panels : sequence of Panel
        One or more.

    Returns
    -------
    tuple of str
        One sentence or two per scale, level and metric, and per pair of metrics.
    """
    several = len({panel.level for panel in panels}) > 1
    return tuple(line for panel in panels for line in _judge_panel(panel, several=several))


def sum_up_panels(panels: Sequence[Panel]) -> tuple[Line, ...]:
    """Say in a line each what the correlations show.

    Parameters
    ----------
    panels : sequence of Panel
        One or more.

    Returns
    -------
    tuple of Line
        Per scale and level: each metric's correlation, the ceiling, and whether one metric is better; at length where
        a correlation or its interval is not defined.
    """
    several = len({panel.level for panel in panels}) > 1
    return tuple(_sum_up(panel, several=several) for panel in panels)


def _sum_up(panel: Panel, *, several: bool) -> Line:
    leading = [result for result in panel.associations if result.method == LEADING]
    if any(math.isnan(result.low) for result in leading):
        return Line(" ".join(dict.fromkeys(_judge_panel(panel, several=several))))
    subject = tell_name(panel.scale) + (f" (level {tell_name(panel.level)})" if several else "")
    ranked_by = {result.metric: result for result in panel.associations if result.method == RANKED}
    found = "; ".join(_tell_correlation(result, ranked_by[result.metric]) for result in leading)
    ceiling = leading[0].ceiling
    most = "" if math.isnan(ceiling) else f"; ratings as noisy as these allow at most {tell_number(ceiling)}"
    by_metric = {result.metric: result for result in leading}
    ranked = "".join(
        f" {_start(_rank(result, first=by_metric[result.first], second=by_metric[result.second]))}."
        for result in panel.differences
        if result.method == LEADING
    )
    return Line(f"{found}{most}.{ranked}", _start(subject), f"over {_count(leading[0].n_items, 'stimulus')}")


def _tell_correlation(result: Association, ranked: Association) -> str:
    r = f"r\N{NO-BREAK SPACE}=\N{NO-BREAK SPACE}{tell_number(result.value)}"
    covers = ", which covers zero" if _covers_zero(result) else ""
    interval = f"95 % two-way interval {tell_range(result.low, result.high)}{covers}"
    departs = not math.isnan(ranked.low) and _list_departures(result, ranked)
    ranks = f"; by ranks {tell_number(ranked.value)}, {tell_range(ranked.low, ranked.high)}" if departs else ""
    return f"{r} with {tell_name(result.metric)} ({interval}{ranks})"


def _rank(result: Difference, *, first: Association, second: Association) -> str:
    if math.isnan(result.low):
        return "the two cannot be compared by an interval here"
    evidence = f"difference {tell_number(result.value)}, {tell_range(result.low, result.high)}"
    told = "neither metric is shown to predict better" if _covers_zero(result) else _name_better(first, second)
    return f"{told} ({evidence})"


def _judge_panel(panel: Panel, *, several: bool) -> list[str]:
    subject = tell_name(panel.scale) + (f" (level {tell_name(panel.level)})" if several else "")
    by_method = {(result.metric, result.method): result for result in panel.associations}
    alone = [
        judge_association(result, subject, ranked=by_method[metric, RANKED])
        for (metric, method), result in by_method.items()
        if method == LEADING
    ]
    leading = {metric: result for (metric, method), result in by_method.items() if method == LEADING}
    paired = [
        judge_difference(result, subject, first=leading[result.first], second=leading[result.second])
        for result in panel.differences
        if result.method == LEADING
    ]
    return alone + paired


def judge_association(result: Association, subject: str, *, ranked: Association) -> str:
    """Say whether ratings go with a metric.

    Parameters
    ----------
    result : Association
        The correlation and its two-way interval.
    subject : str
        What was rated.
    ranked : Association
        The same by ranks: outlying values of the metric do not sway it.

    Returns
    -------
    str
        A claim with its evidence, or that there is none.
    """
    metric, size = tell_name(result.metric), _tell_size(result)
    if math.isnan(result.value):
        return f"{_start(subject)} and {metric}: {' '.join(result.notes)}"
    evidence = f"r\N{NO-BREAK SPACE}=\N{NO-BREAK SPACE}{tell_number(result.value)}"
    if math.isnan(result.low):
        return f"{_start(subject)} and {metric}: {evidence}, {size}; without an interval nothing follows."
    evidence += f"{_tell_ceiling(result)}, 95 % two-way interval {tell_range(result.low, result.high)}; {size}"
    if _covers_zero(result):
        claim = f"Whether {tell_ratings(subject)} go with {metric} is undecided: the interval covers zero"
    else:
        direction = "higher" if result.value > 0 else "lower"
        claim = f"Stimuli with a higher {metric} got {direction} {tell_ratings(subject)}"
    return f"{claim} ({evidence}). {_tell_ranks(result, ranked)}"


def judge_difference(result: Difference, subject: str, *, first: Association, second: Association) -> str:
    """Say whether ratings go with one metric more than with another.

    Parameters
    ----------
    result : Difference
        The difference of the correlations and its two-way interval.
    subject : str
        What was rated.
    first, second : Association
        The two correlations, each with its own interval.

    Returns
    -------
    str
        A claim with its evidence, or that there is none.
    """
    names = f"with {tell_name(result.first)} and with {tell_name(result.second)}"
    pair = f"the correlations of {tell_ratings(subject)} {names}"
    if math.isnan(result.low):
        return f"{_start(pair)} cannot be compared by an interval here."
    evidence = f"{tell_number(result.value)}, 95 % two-way interval {tell_range(result.low, result.high)}"
    if _covers_zero(result):
        undecided = f"Neither metric is shown to predict {subject} better"
        return f"{undecided}: {pair} differ by {evidence}, which covers zero."
    return f"{_start(pair)} differ by {evidence}, which leaves zero out: {_name_better(first, second)}."


def _covers_zero(result: Association | Difference) -> bool:
    return result.low <= 0 <= result.high


def _tell_ceiling(result: Association) -> str:
    if math.isnan(result.disattenuated):
        return ""
    return f" of at most {tell_number(result.ceiling)} that ratings as noisy as these allow"


def _tell_ranks(result: Association, ranked: Association) -> str:
    ranks = f"Spearman's rank correlation ({tell_number(ranked.value)}, {tell_range(ranked.low, ranked.high)})"
    if math.isnan(ranked.low):
        return f"{ranks} has no interval to compare."
    return f"{ranks} {' and '.join(_list_departures(result, ranked)) or 'agrees'}."


def _list_departures(result: Association, ranked: Association) -> list[str]:
    """Say in what the ranks contradict the values: a few outlying ones may hide what all others show."""
    departures = []
    if _covers_zero(result) != _covers_zero(ranked):
        departures.append("covers zero" if _covers_zero(ranked) else "leaves zero out")
    if result.value * ranked.value < 0:
        departures.append("has the opposite direction")
    return departures


def _name_better(first: Association, second: Association) -> str:
    stronger = max(first, second, key=lambda result: abs(result.value))
    unclear = [tell_name(result.metric) for result in (first, second) if not _has_direction(result)]
    if first.value * second.value < 0:
        if not unclear:
            return "they point in opposite directions"
        return f"the interval with {' and that with '.join(unclear)} covers zero, so neither is named the better"
    if not _has_direction(stronger):
        return f"the interval with {tell_name(stronger.metric)} covers zero, so neither is named the better"
    return f"{tell_name(stronger.metric)} is the better predictor"


def _has_direction(result: Association) -> bool:
    return result.low > 0 or result.high < 0


def _tell_size(result: Association) -> str:
    people = _count(result.n_participants, "participant")
    scenes = tell_recordings(result.n_recordings, result.n_sources)
    return f"{people}, {scenes}, {_count(result.n_items, 'stimulus')}"


def _count(number: int, noun: str) -> str:
    plural = {"stimulus": "stimuli"}.get(noun, noun + "s")
    return f"{number} {noun if number == 1 else plural}"


def _start(text: str) -> str:
    return text[:1].upper() + text[1:]
