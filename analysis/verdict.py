"""The answer in words, generated from the numbers and never stronger than they are.

A direction is claimed only where the two-way interval leaves zero out; everything else is said to be
undecided, not absent.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from analysis.words import tell_name, tell_number, tell_range

if TYPE_CHECKING:
    from analysis.association import Association, Difference
    from analysis.findings import Findings, Panel

LEADING, RANKED = "pearson", "spearman"
"""The method that the verdict rests on, and the one it is checked against."""


def write_verdict(findings: Findings) -> tuple[str, ...]:
    """Say what the ratings show about the metrics.

    Parameters
    ----------
    findings : Findings
        All results.

    Returns
    -------
    tuple of str
        One sentence or two per scale, level and metric, and per pair of metrics.
    """
    several = len({panel.level for panel in findings.panels}) > 1
    return tuple(line for panel in findings.panels for line in _judge_panel(panel, several=several))


def _judge_panel(panel: Panel, *, several: bool) -> list[str]:
    subject = tell_name(panel.scale) + (f" (level {tell_name(panel.level)})" if several else "")
    by_method = {(result.metric, result.method): result for result in panel.associations}
    alone = [
        judge_association(result, subject, ranked=by_method[metric, RANKED])
        for (metric, method), result in by_method.items()
        if method == LEADING
    ]
    paired = [judge_difference(result, subject) for result in panel.differences if result.method == LEADING]
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
    evidence += f", 95 % two-way interval {tell_range(result.low, result.high)}; {size}"
    if _covers_zero(result):
        claim = f"Whether {subject} ratings go with {metric} is undecided: the interval covers zero"
    else:
        direction = "higher" if result.value > 0 else "lower"
        claim = f"Stimuli with a higher {metric} got {direction} {subject} ratings"
    return f"{claim} ({evidence}). {_tell_ranks(result, ranked)}"


def judge_difference(result: Difference, subject: str) -> str:
    """Say whether ratings go with one metric more than with another.

    Parameters
    ----------
    result : Difference
        The difference of the correlations and its two-way interval.
    subject : str
        What was rated.

    Returns
    -------
    str
        A claim with its evidence, or that there is none.
    """
    first, second = tell_name(result.first), tell_name(result.second)
    pair = f"the correlations of {subject} ratings with {first} and with {second}"
    if math.isnan(result.low):
        return f"{_start(pair)} cannot be compared by an interval here."
    evidence = f"{tell_number(result.value)}, 95 % two-way interval {tell_range(result.low, result.high)}"
    if _covers_zero(result):
        undecided = f"Neither metric is shown to predict {subject} better"
        return f"{undecided}: {pair} differ by {evidence}, which covers zero."
    return f"{_start(pair)} differ by {evidence}, which leaves zero out: {_name_better(result)}."


def _covers_zero(result: Association | Difference) -> bool:
    return result.low <= 0 <= result.high


def _tell_ranks(result: Association, ranked: Association) -> str:
    agrees = _covers_zero(result) == _covers_zero(ranked)
    verb = "agrees" if agrees else "disagrees: a few stimuli or a bent relation make the difference"
    ranks = f"{tell_number(ranked.value)}, {tell_range(ranked.low, ranked.high)}"
    return f"Spearman's rank correlation ({ranks}) {verb}."


def _name_better(result: Difference) -> str:
    if result.first_value * result.second_value <= 0:
        return "they do not point in the same direction"
    stronger = result.first if abs(result.first_value) > abs(result.second_value) else result.second
    return f"{tell_name(stronger)} is the better predictor"


def _tell_size(result: Association) -> str:
    people = _count(result.n_participants, "participant")
    return f"{people}, {_count(result.n_recordings, 'recording')}, {_count(result.n_items, 'stimulus')}"


def _count(number: int, noun: str) -> str:
    plural = {"stimulus": "stimuli"}.get(noun, noun + "s")
    return f"{number} {noun if number == 1 else plural}"


def _start(text: str) -> str:
    return text[:1].upper() + text[1:]
