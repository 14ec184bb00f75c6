"""Axes of the chart's figures, and the methods that are one point on them because they are equal by construction.

Averaged over sensor orientations no axis of the sensor differs from another: sax321, say321 and saz321 differ in a
chart by the finite number of orientations alone, and so do their matched and running forms. Ratings are not merged:
people rated each axis as the sensor was mounted.
"""

from __future__ import annotations

import math
from dataclasses import replace
from statistics import fmean
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from feel321.analysis.figures.style import Look, assign_looks
from feel321.analysis.tradeoff.chart.records import (
    MEASURES,
    Accuracy,
    Cost,
    Dominance,
    Memory,
    Point,
    Stability,
    dominates,
)
from feel321.analysis.words import start

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from matplotlib.axis import Axis

    from feel321.analysis.tradeoff.chart.measure import Method
    from feel321.analysis.tradeoff.chart.records import Chart

# From accuracies and costs to points in the plane, its front, and who is dominated by whom.

PAPER = MEASURES[:2]
"""What a method must keep to dominate another: the paper's own metrics."""

BEYOND_NOISE = 2.0
"""Standard errors by which two medians must differ."""


def place_points(
    methods: Iterable[Method],
    accuracies: Sequence[Accuracy],
    costs: Sequence[Cost],
    *,
    rate_hz: float,
) -> list[Point]:
    """Put methods into the plane of speed and accuracy."""
    found: dict[tuple[str, str], list[Accuracy]] = {}
    for row in accuracies:
        found.setdefault((row.method, row.measure), []).append(row)
    cost_of = {cost.method: cost for cost in costs}
    methods = list(methods)
    points: list[Point] = []
    for measure in MEASURES:
        points += mark_front([
            locate(
                found[method.label, measure],
                cost_of[method.label],
                latency_s=method.find_latency(rate_hz),
            )
            for method in methods
        ])
    return points


def mark_front(points: Sequence[Point]) -> list[Point]:
    """Mark the front of cost and accuracy.

    Returns off the front is what is dominated with at least one advantage beyond the measurement's
    noise: methods that cannot be told apart stand or fall together.
    """
    beaten = dominates([[point.ns_per_sample, -point.median] for point in points])
    return [
        replace(
            loser,
            on_front=not any(
                beaten[i, j] and is_clear([loser], [winner]) for i, winner in enumerate(points)
            ),
        )
        for j, loser in enumerate(points)
    ]


def is_clear(losers: Sequence[Point], winners: Sequence[Point]) -> bool:
    """Tell whether any advantage is beyond the measurement's noise."""
    faster = winners[0].high < losers[0].low
    sooner = _tell_latency(winners[0]) < _tell_latency(losers[0])
    nearer = any(
        good.median - poor.median > BEYOND_NOISE * math.hypot(good.se, poor.se)
        for good, poor in zip(winners, losers, strict=True)
    )
    return faster or sooner or nearer


def list_dominated(points: Sequence[Point], accuracies: Sequence[Accuracy]) -> list[Dominance]:
    """List the dominated reducers, each with every one that dominates it."""
    of_measure = [[point for point in points if point.measure == measure] for measure in PAPER]
    rows = list(zip(*of_measure, strict=True))
    beaten = dominates([_tell_objectives(row) for row in rows])
    return [
        _name_dominance(rows[loser], rows[winner], accuracies)
        for loser in range(len(rows))
        for winner in np.flatnonzero(beaten[:, loser])
    ]


def locate(own: Sequence[Accuracy], cost: Cost | Point, *, latency_s: float | None) -> Point:
    """Place a method by its scenes' accuracies and its cost."""
    means = [row.mean for row in own]
    # The orientations are the same in all scenes: their errors may all go one way, and the median with them.
    high, low = (
        np.median([row.mean + sign * row.sd / math.sqrt(row.rotations) for row in own])
        for sign in (1, -1)
    )
    return Point(
        own[0].method,
        own[0].reducer,
        own[0].measure,
        float(np.median(means)),
        float(np.mean(means)),
        min(means),
        max(means),
        float(high - low) / 2,
        cost.ns_per_sample,
        cost.low,
        cost.high,
        latency_s,
        on_front=False,
    )


def _tell_objectives(row: Sequence[Point]) -> list[float]:
    return [row[0].ns_per_sample, _tell_latency(row[0]), *(-point.median for point in row)]


def _tell_latency(point: Point) -> float:
    return math.inf if point.latency_s is None else point.latency_s


def _name_dominance(
    loser: Sequence[Point], winner: Sequence[Point], accuracies: Sequence[Accuracy]
) -> Dominance:
    scenes = _compare_scenes(loser[0].method, winner[0].method, accuracies)
    return Dominance(
        loser[0].reducer, winner[0].reducer, is_clear(loser, winner), sum(scenes), len(scenes)
    )


def _compare_scenes(loser: str, winner: str, accuracies: Sequence[Accuracy]) -> list[bool]:
    """Tell for each scene whether the winner is at least as good by both of the paper's metrics."""
    means = {(row.method, row.scene, row.measure): row.mean for row in accuracies}
    scenes = dict.fromkeys(row.scene for row in accuracies if row.method == loser)
    return [
        all(means[winner, scene, measure] >= means[loser, scene, measure] for measure in PAPER)
        for scene in scenes
    ]


# Methods that are equal by construction, drawn and named as one point.

Row = TypeVar("Row", Accuracy, Cost, Memory, Stability, Point)

AXES = ("sax321", "say321", "saz321")

GROUPS: Mapping[str, tuple[str, ...]] = MappingProxyType({
    f"sax/say/saz321{form}": tuple(f"{axis}{form}" for axis in AXES)
    for form in ("", "_matched", "_matched_running")
})
"""Label of a point -> the reducers that are equal by construction."""

_GROUP_OF = {member: label for label, members in GROUPS.items() for member in members}

_SAME: Mapping[type, tuple[str, ...]] = MappingProxyType({
    Accuracy: ("sweep", "scene", "rate_hz", "measure"),
    Cost: ("sweep", "n_samples", "rate_hz", "block", "bits"),
    Memory: ("n_samples",),
    Stability: ("scene",),
    Point: ("measure",),
})
"""Record -> the fields in which rows that are merged agree."""

_MEANS = (
    "as_mounted",
    "mean",
    "ns_per_sample",
    "low",
    "high",
    "real_time",
    "relative",
    "gain",
    "worst",
)


def find_group(reducer: str) -> str:
    """Return the label of the group that a reducer belongs to, or an empty text."""
    return _GROUP_OF.get(reducer, "")


def name_point(reducer: str) -> str:
    """Return the name under which a reducer is drawn: its group's label, or its own name.

    Examples
    --------
    >>> name_point("say321"), name_point("saz321_matched"), name_point("dft321")
    ('sax/say/saz321', 'sax/say/saz321_matched', 'dft321')
    """
    return _GROUP_OF.get(reducer, reducer)


def list_members(name: str) -> tuple[str, ...]:
    """List the reducers behind a point's name."""
    return GROUPS.get(name, (name,))


def merge_equal(chart: Chart) -> Chart:
    """Merge the rows of methods that are equal by construction, for figures and sentences.

    Accuracies and costs are averaged over the members; their tables and ``results.json`` keep all names.
    """
    from feel321.analysis.tradeoff.chart.cost import fit_all

    accuracies, costs = merge_rows(chart.accuracies), merge_rows(chart.costs)
    return replace(
        chart,
        points=tuple(
            merge_points(chart.points, [row for row in accuracies if row.sweep == "reducer"])
        ),
        accuracies=tuple(accuracies),
        costs=tuple(costs),
        growth=tuple(fit_all(costs)),
        memory=tuple(merge_rows(chart.memory)),
        stability=tuple(merge_rows(chart.stability)),
    )


def merge_points(points: Sequence[Point], accuracies: Iterable[Accuracy]) -> list[Point]:
    """Merge points, placed anew by merged accuracies, and mark the front of each measure."""
    found: dict[tuple[str, str], list[Accuracy]] = {}
    for row in accuracies:
        found.setdefault((row.reducer, row.measure), []).append(row)
    merged = [
        locate(found[point.reducer, point.measure], point, latency_s=point.latency_s)
        for point in merge_rows(points)
    ]
    return [
        point
        for measure in MEASURES
        for point in mark_front([point for point in merged if point.measure == measure])
    ]


def name_groups(points: Iterable[Point], merged: Iterable[Point]) -> list[Point]:
    """Give every point its group's name and place on the front: equal methods stand or fall together."""
    on_front = {(point.reducer, point.measure): point.on_front for point in merged}
    return [
        replace(
            point,
            group=find_group(point.reducer),
            on_front=on_front[name_point(point.reducer), point.measure],
        )
        for point in points
    ]


def merge_rows(rows: Iterable[Row]) -> list[Row]:
    """Average the rows of equal methods; all others stay as they are, in their order."""
    found: dict[tuple[object, ...], list[Row]] = {}
    for number, row in enumerate(rows):
        group = find_group(row.reducer)
        same: list[object] = [getattr(row, field) for field in _SAME[type(row)]]
        found.setdefault((group, *same) if group else (number,), []).append(row)
    return [_average(own) if find_group(own[0].reducer) else own[0] for own in found.values()]


def _average(rows: Sequence[Row]) -> Row:
    first, label = rows[0], find_group(rows[0].reducer)
    own: dict[str, Any] = {
        name: fmean(getattr(row, name) for row in rows) for name in _MEANS if hasattr(first, name)
    }
    if hasattr(first, "method"):
        own["method"] = label
    if isinstance(first, Accuracy):
        # The same orientations serve all members, which are not independent: no root of three is gained.
        own["sd"] = math.sqrt(fmean(row.sd**2 for row in rows if isinstance(row, Accuracy)))
    return replace(first, reducer=label, **own)


# What the axes of the chart's figures share: names, limits, plain numbers, each reducer's look.

CUT = -1.0
"""Accuracies below this stand at the edge: spectral match knows no bottom."""

FEW_DECADES = 2.5


def look_up(chart: Chart) -> dict[str, Look]:
    """Give every reducer of a chart its look."""
    names = list(dict.fromkeys(point.reducer for point in chart.points))
    looks = assign_looks([member for name in names for member in list_members(name)])
    return {name: looks[list_members(name)[0]] for name in names}


def find_size(look: Look, points: float) -> float:
    """Find the size at which a marker looks as large as others."""
    return 1.6 * points if look.marker == "*" else points


def tell_axis(measure: str) -> str:
    """Label an axis by its measure.

    Examples
    --------
    >>> tell_axis("temporal_match_invariant")
    'Temporal match, invariant'
    """
    metric, _, kind = measure.partition("_match")
    return start(f"{metric} match") + (f", {kind.strip('_').replace('_', '-')}" if kind else "")


def limit_accuracy(values: Iterable[float]) -> tuple[float, float]:
    """Find the ends of an axis of accuracy.

    Examples
    --------
    >>> limit_accuracy([0.3, 0.9]), limit_accuracy([-283.0])
    ((-0.04, 1.04), (-1.08, 1.08))
    """
    lowest = max(CUT, min(0.0, *values, 0.0))
    return lowest - 0.04 * (1 - lowest), 1 + 0.04 * (1 - lowest)


def write_plainly(axis: Axis) -> None:
    """Write whole decades on a logarithmic axis as plain numbers; where there are too few, the halves between too."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    low, high = axis.get_view_interval()
    parts = (1.0,) if math.log10(high / low) > FEW_DECADES else (1.0, 2.0, 5.0)
    axis.set_major_locator(LogLocator(subs=parts))
    axis.set_major_formatter(FuncFormatter(lambda value, _: tell_plainly(value)))
    axis.set_minor_formatter(NullFormatter())


def tell_plainly(value: float) -> str:
    """Write a number of any size without powers.

    Examples
    --------
    >>> tell_plainly(0.001), tell_plainly(20_000)
    ('0.001', '20\u202f000')
    """
    return f"{value:,.0f}".replace(",", "\u202f") if value >= 1 else f"{value:.10f}".rstrip("0")
