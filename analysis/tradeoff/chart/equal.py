"""Methods that are equal by construction, drawn and named as one point.

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

from analysis.tradeoff.chart.comparing import locate, mark_front
from analysis.tradeoff.chart.records import MEASURES, Accuracy, Cost, Memory, Point, Stability

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from analysis.tradeoff.chart.chart import Chart

Row = TypeVar("Row", Accuracy, Cost, Memory, Stability, Point)

AXES = ("sax321", "say321", "saz321")

GROUPS: Mapping[str, tuple[str, ...]] = MappingProxyType({
    f"sax/say/saz321{form}": tuple(f"{axis}{form}" for axis in AXES) for form in ("", "_matched", "_matched_running")
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

_MEANS = ("as_mounted", "mean", "ns_per_sample", "low", "high", "real_time", "relative", "gain", "worst")


def find_group(reducer: str) -> str:
    """Return the label of the group that a reducer belongs to, or an empty text.

    Parameters
    ----------
    reducer : str
        A name of `REDUCERS`, or a group's label.

    Returns
    -------
    str
        The label.
    """
    return _GROUP_OF.get(reducer, "")


def name_point(reducer: str) -> str:
    """Return the name under which a reducer is drawn: its group's label, or its own name.

    Parameters
    ----------
    reducer : str
        A name of `REDUCERS`, or a group's label.

    Returns
    -------
    str
        The name.

    Examples
    --------
    >>> name_point("say321"), name_point("saz321_matched"), name_point("dft321")
    ('sax/say/saz321', 'sax/say/saz321_matched', 'dft321')
    """
    return _GROUP_OF.get(reducer, reducer)


def list_members(name: str) -> tuple[str, ...]:
    """List the reducers behind a point's name.

    Parameters
    ----------
    name : str
        From `name_point`.

    Returns
    -------
    tuple of str
        One, or all members of a group.
    """
    return GROUPS.get(name, (name,))


def merge_equal(chart: Chart) -> Chart:
    """Merge the rows of methods that are equal by construction, for figures and sentences.

    Accuracies and costs are averaged over the members; their tables and ``results.json`` keep all names.

    Parameters
    ----------
    chart : Chart
        What was measured.

    Returns
    -------
    Chart
        With one row for each group; a merged chart stays as it is.
    """
    from analysis.tradeoff.chart.cost import fit_all

    accuracies, costs = merge_rows(chart.accuracies), merge_rows(chart.costs)
    return replace(
        chart,
        points=tuple(merge_points(chart.points, [row for row in accuracies if row.sweep == "reducer"])),
        accuracies=tuple(accuracies), costs=tuple(costs), growth=tuple(fit_all(costs)),
        memory=tuple(merge_rows(chart.memory)), stability=tuple(merge_rows(chart.stability)),
    )  # fmt: skip


def merge_points(points: Sequence[Point], accuracies: Iterable[Accuracy]) -> list[Point]:
    """Merge points, placed anew by merged accuracies, and mark the front of each measure.

    Parameters
    ----------
    points : sequence of Point
        Of all methods.
    accuracies : iterable of Accuracy
        Merged ones, of reducers as they are.

    Returns
    -------
    list of Point
        One per group and measure.
    """
    found: dict[tuple[str, str], list[Accuracy]] = {}
    for row in accuracies:
        found.setdefault((row.reducer, row.measure), []).append(row)
    merged = [
        locate(found[point.reducer, point.measure], point, latency_s=point.latency_s) for point in merge_rows(points)
    ]
    return [
        point
        for measure in MEASURES
        for point in mark_front([point for point in merged if point.measure == measure])
    ]


def name_groups(points: Iterable[Point], merged: Iterable[Point]) -> list[Point]:
    """Give every point its group's name and place on the front: equal methods stand or fall together.

    Parameters
    ----------
    points : iterable of Point
        Of all methods.
    merged : iterable of Point
        From `merge_points`.

    Returns
    -------
    list of Point
        All methods.
    """
    on_front = {(point.reducer, point.measure): point.on_front for point in merged}
    return [
        replace(
            point, group=find_group(point.reducer), on_front=on_front[name_point(point.reducer), point.measure]
        )
        for point in points
    ]


def merge_rows(rows: Iterable[Row]) -> list[Row]:
    """Average the rows of equal methods; all others stay as they are, in their order.

    Parameters
    ----------
    rows : iterable of Accuracy, Cost, Memory, Stability or Point
        All of one kind.

    Returns
    -------
    list
        One row per group.
    """
    found: dict[tuple[object, ...], list[Row]] = {}
    for number, row in enumerate(rows):
        group = find_group(row.reducer)
        same: list[object] = [getattr(row, field) for field in _SAME[type(row)]]
        found.setdefault((group, *same) if group else (number,), []).append(row)
    return [_average(own) if find_group(own[0].reducer) else own[0] for own in found.values()]


def _average(rows: Sequence[Row]) -> Row:
    first, label = rows[0], find_group(rows[0].reducer)
    own: dict[str, Any] = {name: fmean(getattr(row, name) for row in rows) for name in _MEANS if hasattr(first, name)}
    if hasattr(first, "method"):
        own["method"] = label
    if isinstance(first, Accuracy):
        # The same orientations serve all members, which are not independent: no root of three is gained.
        own["sd"] = math.sqrt(fmean(row.sd**2 for row in rows if isinstance(row, Accuracy)))
    return replace(first, reducer=label, **own)
