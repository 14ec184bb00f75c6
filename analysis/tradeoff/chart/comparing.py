"""From accuracies and costs to points in the plane, its front, and who is dominated by whom."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from analysis.tradeoff.chart.pareto import dominates
from analysis.tradeoff.chart.records import MEASURES, Accuracy, Cost, Dominance, Point

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from analysis.tradeoff.chart.methods import Method

PAPER = MEASURES[:2]
"""What a method must keep to dominate another: the paper's own metrics."""

BEYOND_NOISE = 2.0
"""Standard errors by which two medians must differ."""


def place_points(
    methods: Iterable[Method], accuracies: Sequence[Accuracy], costs: Sequence[Cost], *, rate_hz: float
) -> list[Point]:
    """Put methods into the plane of speed and accuracy.

    Parameters
    ----------
    methods : iterable of Method
        Those that are charted.
    accuracies : sequence of Accuracy
        Among them all scenes of these methods.
    costs : sequence of Cost
        One for each of these methods.
    rate_hz : float
        Rate at which latency is told.

    Returns
    -------
    list of Point
        One per method and measure, the front of each measure marked.
    """
    found: dict[tuple[str, str], list[Accuracy]] = {}
    for row in accuracies:
        found.setdefault((row.method, row.measure), []).append(row)
    cost_of = {cost.method: cost for cost in costs}
    methods = list(methods)
    points: list[Point] = []
    for measure in MEASURES:
        points += mark_front([
            locate(found[method.label, measure], cost_of[method.label], latency_s=method.find_latency(rate_hz))
            for method in methods
        ])  # fmt: skip
    return points


def mark_front(points: Sequence[Point]) -> list[Point]:
    """Mark the front of cost and accuracy.

    Parameters
    ----------
    points : sequence of Point
        Of one measure.

    Returns
    -------
    list of Point
        The same. Off the front is what is dominated with at least one advantage beyond the measurement's noise:
        methods that cannot be told apart stand or fall together.
    """
    beaten = dominates([[point.ns_per_sample, -point.median] for point in points])
    return [
        replace(
            loser, on_front=not any(beaten[i, j] and is_clear([loser], [winner]) for i, winner in enumerate(points))
        )
        for j, loser in enumerate(points)
    ]


def is_clear(losers: Sequence[Point], winners: Sequence[Point]) -> bool:
    """Tell whether any advantage is beyond the measurement's noise.

    Parameters
    ----------
    losers, winners : sequence of Point
        The same measures of two methods.

    Returns
    -------
    bool
        Whether the quartiles of cost are apart, latency differs, or a median by more than two standard errors.
    """
    faster = winners[0].high < losers[0].low
    sooner = _tell_latency(winners[0]) < _tell_latency(losers[0])
    nearer = any(
        good.median - poor.median > BEYOND_NOISE * math.hypot(good.se, poor.se)
        for good, poor in zip(winners, losers, strict=True)
    )
    return faster or sooner or nearer


def list_dominated(points: Sequence[Point], accuracies: Sequence[Accuracy]) -> list[Dominance]:
    """List the dominated reducers, each with every one that dominates it.

    Parameters
    ----------
    points : sequence of Point
        All measures of the methods that are compared.
    accuracies : sequence of Accuracy
        Their scenes.

    Returns
    -------
    list of Dominance
        By cost, latency and both of the paper's metrics.
    """
    of_measure = [[point for point in points if point.measure == measure] for measure in PAPER]
    rows = list(zip(*of_measure, strict=True))
    beaten = dominates([_tell_objectives(row) for row in rows])
    return [
        _name_dominance(rows[loser], rows[winner], accuracies)
        for loser in range(len(rows))
        for winner in np.flatnonzero(beaten[:, loser])
    ]


def locate(own: Sequence[Accuracy], cost: Cost | Point, *, latency_s: float | None) -> Point:
    """Place a method by its scenes' accuracies and its cost.

    Parameters
    ----------
    own : sequence of Accuracy
        One per scene.
    cost : Cost or Point
        What holds its median time and quartiles.
    latency_s : float or None
        None if the whole signal is needed.

    Returns
    -------
    Point
        Not yet on any front.
    """
    means = [row.mean for row in own]
    # The orientations are the same in all scenes: their errors may all go one way, and the median with them.
    high, low = (np.median([row.mean + sign * row.sd / math.sqrt(row.rotations) for row in own]) for sign in (1, -1))
    return Point(
        own[0].method, own[0].reducer, own[0].measure, float(np.median(means)), float(np.mean(means)),
        min(means), max(means), float(high - low) / 2,
        cost.ns_per_sample, cost.low, cost.high, latency_s, on_front=False,
    )  # fmt: skip


def _tell_objectives(row: Sequence[Point]) -> list[float]:
    return [row[0].ns_per_sample, _tell_latency(row[0]), *(-point.median for point in row)]


def _tell_latency(point: Point) -> float:
    return math.inf if point.latency_s is None else point.latency_s


def _name_dominance(loser: Sequence[Point], winner: Sequence[Point], accuracies: Sequence[Accuracy]) -> Dominance:
    scenes = _compare_scenes(loser[0].method, winner[0].method, accuracies)
    return Dominance(loser[0].reducer, winner[0].reducer, is_clear(loser, winner), sum(scenes), len(scenes))


def _compare_scenes(loser: str, winner: str, accuracies: Sequence[Accuracy]) -> list[bool]:
    """Tell for each scene whether the winner is at least as good by both of the paper's metrics."""
    means = {(row.method, row.scene, row.measure): row.mean for row in accuracies}
    scenes = dict.fromkeys(row.scene for row in accuracies if row.method == loser)
    return [all(means[winner, scene, measure] >= means[loser, scene, measure] for measure in PAPER) for scene in scenes]
