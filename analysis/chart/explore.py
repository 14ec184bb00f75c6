"""What the page's script needs to let a reader explore: axes, and what every method has on them."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from analysis.chart.axes import look_up, tell_measure
from analysis.chart.compute import list_reference_costs
from analysis.chart.cost import NS, RATE_HZ
from analysis.chart.methods import list_hops, list_methods, list_windows
from analysis.chart.records import MEASURES
from analysis.scales import APART
from analysis.scales import tell_measure as tell_scale
from analysis.words import tell_name

if TYPE_CHECKING:
    from collections.abc import Iterable

    from analysis.chart.chart import Chart
    from analysis.chart.methods import Method
    from analysis.chart.records import Accuracy, Cost, Rated

PLACES = 5
"""Significant digits that the page keeps; results.json keeps all."""


@dataclass(frozen=True, slots=True)
class Choice:
    """An axis that a reader can choose.

    Parameters
    ----------
    key : str
        Its name in the data.
    label : str
        Its name on the page, with unit.
    kind : str
        speed, accuracy or rating.
    better : str
        low or high.
    log : bool
        Whether a logarithmic axis makes sense.
    """

    key: str
    label: str
    kind: str
    better: str
    log: bool


def list_choices(chart: Chart) -> tuple[Choice, ...]:
    """List the axes that a chart offers.

    Parameters
    ----------
    chart : Chart
        What was measured.

    Returns
    -------
    tuple of Choice
        Speed, accuracy, and ratings if there are any.
    """
    rated = {_name_rating(row): "low" if row.scale in APART else "high" for row in chart.rated}
    return (
        Choice("cost", "Cost of one sample (ns)", "speed", "low", log=True),
        Choice("real_time", f"Speed (× real time at {RATE_HZ / 1000:g} kHz)", "speed", "high", log=True),
        Choice("latency", "Algorithmic latency (ms)", "speed", "low", log=True),
        *(Choice(measure, tell_measure(measure), "accuracy", "high", log=False) for measure in MEASURES),
        *(Choice(name, name, "rating", better, log=False) for name, better in rated.items()),
    )


def dump_data(chart: Chart, choices: Iterable[Choice]) -> str:
    """Write what the script reads.

    Parameters
    ----------
    chart : Chart
        What was measured.
    choices : iterable of Choice
        Its axes.

    Returns
    -------
    str
        JSON that can stand in a page: no name in it can end its element.
    """
    axes = [{name: getattr(choice, name) for name in Choice.__slots__} for choice in choices]
    methods = _list_entries(chart)
    data = {"axes": axes, "scenes": [scene.name for scene in chart.scenes], "methods": methods}
    return json.dumps(data, ensure_ascii=False, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")


def _list_entries(chart: Chart) -> list[dict[str, Any]]:
    looks = look_up(chart)
    accuracies: dict[tuple[str, str], list[Accuracy]] = {}
    for row in chart.accuracies:
        accuracies.setdefault((row.sweep, row.method), []).append(row)
    # A method that stands in two sweeps was timed twice, as was any other; here each needs one time only.
    costs = {(cost.sweep, cost.method): cost for cost in list_reference_costs(chart.costs)}
    ratings = _list_ratings(chart)
    kinds = (("reducer", "size", list_methods()), ("window", "window", list_windows()), ("hop", "hop", list_hops()))
    return [
        {
            "label": method.label,
            "reducer": method.reducer,
            "kind": kind,
            "colour": looks[method.reducer].colour,
            "marker": looks[method.reducer].marker,
            "speed": _tell_speed(method, costs[sweep, method.label]),
            "scores": _tell_scores(accuracies[kind, method.label]),
            "ratings": ratings.get(method.reducer, {}) if kind == "reducer" else {},
        }
        for kind, sweep, methods in kinds
        for method in methods
        if (kind, method.label) in accuracies
    ]


def _tell_speed(method: Method, cost: Cost) -> dict[str, list[float | None]]:
    latency = method.find_latency(RATE_HZ)
    return {
        "cost": [_round(time) for time in (cost.ns_per_sample, cost.low, cost.high)],
        "real_time": [_round(NS / RATE_HZ / time) for time in (cost.ns_per_sample, cost.high, cost.low)],
        "latency": [None if latency is None else _round(1000 * latency), None, None],
    }


def _tell_scores(rows: Iterable[Accuracy]) -> dict[str, dict[str, list[float]]]:
    """Scene -> measure -> mean and standard deviation over orientations, and the value as mounted."""
    scores: dict[str, dict[str, list[float]]] = {}
    for row in rows:
        scores.setdefault(row.scene, {})[row.measure] = [_round(row.mean), _round(row.sd), _round(row.as_mounted)]
    return scores


def _list_ratings(chart: Chart) -> dict[str, dict[str, list[float | None]]]:
    found: dict[str, dict[str, list[float | None]]] = {}
    for row in chart.rated:
        ends = (row.low, row.high, row.two_way_low, row.two_way_high)
        numbers = [_round(row.mean), *(None if end is None else _round(end) for end in ends)]
        found.setdefault(row.reducer, {})[_name_rating(row)] = numbers
    return found


def _name_rating(row: Rated) -> str:
    return f"Mean {tell_scale(row.scale)}, {tell_name(row.level)} (0 to 100)"


def _round(value: float) -> float:
    return float(f"{value:.{PLACES}g}")
