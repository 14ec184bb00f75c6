"""What the page's script needs to let a reader explore: axes, and what every method has on them."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from feel321.analysis.table.sheet import APART, tell_measure
from feel321.analysis.tradeoff.chart.axes import (
    find_group,
    look_up,
    merge_equal,
    name_point,
    tell_axis,
)
from feel321.analysis.tradeoff.chart.compute import list_reference_costs
from feel321.analysis.tradeoff.chart.cost import NS, RATE_HZ
from feel321.analysis.tradeoff.chart.measure import Method, list_hops, list_methods, list_windows
from feel321.analysis.tradeoff.chart.records import MEASURES
from feel321.analysis.words import tell_name

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from feel321.analysis.tradeoff.chart.records import Accuracy, Chart, Cost, Rated

STABILITY = "stability"
PLACES = 5
"""Significant digits that the page keeps; results.json keeps all."""


@dataclass(frozen=True, slots=True)
class Choice:
    """An axis that a reader can choose."""

    key: str
    label: str
    kind: str
    better: str
    log: bool


@dataclass(frozen=True, slots=True)
class _Entry:
    """A marker of the page: what it is, what it costs, where its scores are."""

    kind: str
    label: str
    method: Method
    cost: Cost
    scored: tuple[str, str, float | None]
    waiting_s: float = 0.0


def list_choices(chart: Chart) -> tuple[Choice, ...]:
    """List the axes that a chart offers."""
    rated = {_name_rating(row): "low" if row.scale in APART else "high" for row in chart.rated}
    return (
        Choice("cost", "Cost of one sample (ns)", "speed", "low", log=True),
        Choice(
            "real_time",
            f"Speed (× real time, {RATE_HZ / 1000:g} kHz unless named)",
            "speed",
            "high",
            log=True,
        ),
        Choice("latency", "Algorithmic latency (ms)", "speed", "low", log=True),
        *(
            Choice(measure, tell_axis(measure), "accuracy", "high", log=False)
            for measure in MEASURES
        ),
        Choice(
            STABILITY,
            "Perturbation gain (1: sensor noise passes as it is)",
            "stability",
            "low",
            log=True,
        ),
        *(Choice(name, name, "rating", better, log=False) for name, better in rated.items()),
    )


def dump_data(chart: Chart, choices: Iterable[Choice]) -> str:
    """Write what the script reads."""
    axes = [{name: getattr(choice, name) for name in Choice.__slots__} for choice in choices]
    methods = _list_entries(chart)
    data = {"axes": axes, "scenes": [scene.name for scene in chart.scenes], "methods": methods}
    return json.dumps(data, ensure_ascii=False, allow_nan=False, separators=(",", ":")).replace(
        "<", "\\u003c"
    )


def _list_entries(chart: Chart) -> list[dict[str, Any]]:
    ratings = _list_ratings(chart)
    chart = merge_equal(chart)
    looks = look_up(chart)
    gains = {(row.reducer, row.scene): row.gain for row in chart.stability}
    scores: dict[tuple[str, str, float | None], list[Accuracy]] = {}
    for row in chart.accuracies:
        rate_hz = row.rate_hz if row.sweep == "rate" else None
        scores.setdefault((row.sweep, row.method, rate_hz), []).append(row)
    return [
        {
            "label": entry.label,
            "reducer": name_point(entry.method.reducer),
            "kind": entry.kind,
            "member": bool(find_group(entry.label)),
            "colour": looks[name_point(entry.method.reducer)].colour,
            "marker": looks[name_point(entry.method.reducer)].marker,
            "speed": _tell_speed(entry),
            "scores": _add_gains(_tell_scores(scores[entry.scored]), gains, entry),
            "ratings": ratings.get(entry.label, {}) if entry.kind == "reducer" else {},
        }
        for entry in (
            *_find_whole(chart),
            *_find_rated(chart),
            *_find_rates(chart),
            *_find_streams(chart),
        )
        if entry.scored in scores
    ]


def _find_whole(chart: Chart) -> Iterator[_Entry]:
    # A method that stands in two sweeps was timed twice, as was any other; here each needs one time only.
    costs = {(cost.sweep, cost.method): cost for cost in list_reference_costs(chart.costs)}
    kinds = (
        ("reducer", "size", list_methods()),
        ("window", "window", list_windows()),
        ("hop", "hop", list_hops()),
    )
    for kind, sweep, methods in kinds:
        for label, method in _name_methods(methods).items():
            yield _Entry(kind, label, method, costs[sweep, label], (kind, label, None))


def _find_rated(chart: Chart) -> Iterator[_Entry]:
    """List the members of a point that were rated: people rated each as the sensor was mounted."""
    costs = {
        cost.method: cost for cost in list_reference_costs(chart.costs) if cost.sweep == "size"
    }
    for reducer in dict.fromkeys(row.reducer for row in chart.rated if find_group(row.reducer)):
        label = name_point(reducer)
        if label in costs:
            yield _Entry(
                "reducer", reducer, Method(reducer), costs[label], ("reducer", label, None)
            )


def _name_methods(methods: Iterable[Method]) -> dict[str, Method]:
    """Name of a point -> a method behind it: the first of those that are equal by construction."""
    named: dict[str, Method] = {}
    for method in methods:
        named.setdefault(find_group(method.label) or method.label, method)
    return named


def _find_rates(chart: Chart) -> Iterator[_Entry]:
    methods = _name_methods(list_methods())
    for cost in chart.costs:
        if cost.sweep == "rate":
            label = f"{cost.method}, {cost.rate_hz / 1000:g} kHz"
            yield _Entry(
                "rate", label, methods[cost.method], cost, ("rate", cost.method, cost.rate_hz)
            )


def _find_streams(chart: Chart) -> Iterator[_Entry]:
    """List streams: they give what the whole signal gives, a block later."""
    methods = _name_methods(list_methods())
    for cost in chart.costs:
        if cost.sweep == "block":
            label = f"{cost.method}, blocks of {cost.block}"
            waiting_s = (cost.block - 1) / cost.rate_hz
            yield _Entry(
                "block",
                label,
                methods[cost.method],
                cost,
                ("reducer", cost.method, None),
                waiting_s,
            )


def _tell_speed(entry: _Entry) -> dict[str, list[float | None]]:
    cost, latency = entry.cost, entry.method.find_latency(entry.cost.rate_hz)
    times = [NS / cost.rate_hz / time for time in (cost.ns_per_sample, cost.high, cost.low)]
    return {
        "cost": [_round(time) for time in (cost.ns_per_sample, cost.low, cost.high)],
        "real_time": [_round(time) for time in times],
        "latency": [
            None if latency is None else _round(1000 * (latency + entry.waiting_s)),
            None,
            None,
        ],
    }


def _tell_scores(rows: Iterable[Accuracy]) -> dict[str, dict[str, list[float]]]:
    """Scene -> measure -> mean and standard deviation over orientations, and the value as mounted."""
    scores: dict[str, dict[str, list[float]]] = {}
    for row in rows:
        scores.setdefault(row.scene, {})[row.measure] = [
            _round(row.mean),
            _round(row.sd),
            _round(row.as_mounted),
        ]
    return scores


def _add_gains(
    scores: dict[str, dict[str, list[float]]], gains: dict[tuple[str, str], float], entry: _Entry
) -> dict[str, dict[str, list[float]]]:
    """Add the perturbation gain of each scene, for reducers as they are: that of other windows was not measured."""
    for scene, own in scores.items():
        gain = gains.get((name_point(entry.method.reducer), scene))
        if gain is not None and entry.kind in {"reducer", "block"}:
            own[STABILITY] = [_round(gain)]
    return scores


def _list_ratings(chart: Chart) -> dict[str, dict[str, list[float | None]]]:
    found: dict[str, dict[str, list[float | None]]] = {}
    for row in chart.rated:
        ends = (row.low, row.high, row.two_way_low, row.two_way_high)
        numbers = [_round(row.mean), *(None if end is None else _round(end) for end in ends)]
        found.setdefault(row.reducer, {})[_name_rating(row)] = numbers
    return found


def _name_rating(row: Rated) -> str:
    return f"Mean {tell_measure(row.scale)}, {tell_name(row.level)} (0 to 100)"


def _round(value: float) -> float:
    return float(f"{value:.{PLACES}g}")
