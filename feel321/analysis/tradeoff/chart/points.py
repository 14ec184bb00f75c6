"""Methods in the plane of speed and accuracy: their front, who is dominated by whom, and which are one point.

A *method* is a reducer with its window and hop; its label identifies it in every table.

Averaged over sensor orientations no axis of the sensor differs from another: sax321, say321 and saz321 differ in a
chart by the finite number of orientations alone, and so do their matched and running forms. In figures and sentences
each kind is one point. Ratings are not merged: people rated each axis as the sensor was mounted.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

if TYPE_CHECKING:
    from pandas import DataFrame


Tables: TypeAlias = "Mapping[str, DataFrame]"
Record = Mapping[str, Any]

MEASURES = (
    "spectral_match", "temporal_match",
    "spectral_match_bounded", "spectral_match_energy_weighted", "temporal_match_invariant",
)  # fmt: skip
"""The paper's two metrics, then their bounded counterparts, which no orientation of the sensor changes."""

PAPER = MEASURES[:2]
"""What a method must keep to dominate another: the paper's own metrics."""

ACCURACY = MEASURES[2]
"""The measure that stands for accuracy where there is room for one: from 0 to 1 whatever the reducer."""

TABLES: Mapping[str, tuple[str, ...]] = MappingProxyType({
    "scenes": ("name", "rate_hz", "duration_s", "used_s", "sha256"),
    "points": ("method", "reducer", "measure", "median", "mean", "lowest", "highest", "se",
               "ns_per_sample", "low", "high", "latency_s", "on_front", "group"),
    "dominated": ("reducer", "by", "clear", "scenes", "of"),
    "accuracies": ("sweep", "method", "reducer", "scene", "rate_hz", "measure", "as_mounted", "mean", "sd",
                   "rotations"),
    "costs": ("sweep", "method", "reducer", "n_samples", "rate_hz", "block", "bits", "ns_per_sample", "low", "high",
              "real_time", "rounds"),
    "growth": ("reducer", "overhead_us", "exponent", "low", "high", "smallest", "largest", "misfit"),
    "memory": ("reducer", "n_samples", "peak_bytes", "relative"),
    "precision": ("reducer", "output", "difference_db", "arithmetic_db", "worst"),
    "rated": ("reducer", "scale", "level", "mean", "low", "high", "two_way_low", "two_way_high", "participants",
              "recordings"),
    "realtime": ("reducer", "rate_hz", "block", "blocks", "median_us", "p99_us", "worst_us", "deadline_us"),
    "resources": ("reducer", "state_bytes", "operations", "parameters"),
    "stability": ("reducer", "scene", "gain", "worst", "draws"),
})  # fmt: skip
"""Tables of a chart, CSV files and entries of results.json alike -> their columns, with units as suffixes.

points: a reducer by one measure, compared by the median over scenes, because spectral match has no lower bound and one
scene with a band nearly without energy would decide a mean; se: of the median, over orientations; low, high: quartiles
of the cost; on_front: whether no other reducer is at least as cheap and as good, and clearly better in one. dominated:
`by` is at least as good in cost, latency and both of the paper's metrics, and better in one; clear: beyond noise;
scenes, of: where it is at least as good by both metrics. growth: time of a call = overhead + b n^exponent, with the
exponent's 95 % interval. memory: most that a call asks for, its output included. precision: change by 32-bit input and
error of 32-bit arithmetic. rated: low, high: 95 % t interval over participants, for these recordings; two_way: 95 %
bootstrap interval over participants and recordings. realtime: time of a stream for a block, against the time until the
next one. stability: how many times more the output changes than the input, under sensor noise 60 dB below the
recording.
"""

BEYOND_NOISE = 2.0
"""Standard errors by which two medians must differ."""

GROUPS: Mapping[str, tuple[str, ...]] = MappingProxyType({
    f"sax/say/saz321{form}": tuple(f"sa{axis}321{form}" for axis in "xyz")
    for form in ("", "_matched", "_matched_running")
})
"""Label of a point -> the reducers that are equal by construction."""

_GROUP_OF = {member: label for label, members in GROUPS.items() for member in members}
_AVERAGED = {
    "as_mounted", "mean", "sd", "ns_per_sample", "low", "high", "real_time", "relative", "peak_bytes", "gain", "worst",
}  # fmt: skip


def make_table(name: str, rows: Iterable[Record]) -> DataFrame:
    """Make a table of a chart, with its columns even where it has no rows."""
    import pandas as pd

    return pd.DataFrame(list(rows), columns=list(TABLES[name]))


def list_records(frame: DataFrame) -> list[dict[str, Any]]:
    """List the rows of a table."""
    return frame.to_dict("records")  # type: ignore[return-value]  # columns have names


def split(frame: DataFrame, *by: str) -> Iterator[tuple[Any, DataFrame]]:
    """Split a table by the values of columns, in their order."""
    yield from frame.groupby(by[0] if len(by) == 1 else list(by), sort=False)


def find_front(costs: ArrayLike) -> NDArray[np.bool_]:
    """Find the points, (n_points, n_objectives), that no other point dominates; infinite is the worst.

    Examples
    --------
    >>> find_front([[1, 3], [2, 2], [2, 3], [3, 1]]).tolist()
    [True, True, False, True]
    """
    return np.asarray(~dominates(costs).any(axis=0))


def dominates(costs: ArrayLike) -> NDArray[np.bool_]:
    """Find which point, (n_points, n_objectives), dominates which: at most as costly in all, less in one."""
    table = np.asarray(costs, dtype=np.float64)
    if np.isnan(table).any():
        raise ValueError("costs must be numbers, got NaN: such a point cannot be compared")
    no_worse = (table[:, None, :] <= table[None, :, :]).all(axis=-1)
    better = (table[:, None, :] < table[None, :, :]).any(axis=-1)
    return np.asarray(no_worse & better)


def place_points(
    accuracies: DataFrame, costs: DataFrame, latencies: Mapping[str, float | None]
) -> DataFrame:
    """Put reducers into the plane of speed and accuracy, measure by measure, and mark the fronts.

    accuracies: of reducers as they are; costs: one row per reducer; latencies: reducer -> in s.
    """
    columns = ["reducer", "ns_per_sample", "low", "high"]
    cost_of = {row["reducer"]: row for row in list_records(costs[columns])}
    rows: dict[str, list[dict[str, Any]]] = {measure: [] for measure in MEASURES}
    for (measure, reducer), own in split(accuracies, "measure", "reducer"):
        means, error = own["mean"], own["sd"] / np.sqrt(own["rotations"])
        # The orientations are the same in all scenes: their errors may all go one way, and the median with them.
        se = float(np.median(means + error) - np.median(means - error)) / 2
        rows[measure].append({
            "method": own["method"].iloc[0], "reducer": reducer, "measure": measure,
            "median": float(np.median(means)), "mean": float(np.mean(means)),
            "lowest": means.min(), "highest": means.max(), "se": se,
            **cost_of[reducer], "latency_s": latencies[reducer], "group": _GROUP_OF.get(reducer, ""),
        })  # fmt: skip
    return make_table("points", (point for own in rows.values() for point in mark_front(own)))


def mark_front(points: Sequence[Record]) -> list[dict[str, Any]]:
    """Mark the front of cost and accuracy of points of one measure.

    Off the front is what is dominated with at least one advantage beyond the measurement's noise: methods that the
    noise does not separate stand or fall together.
    """
    beaten = dominates([[point["ns_per_sample"], -point["median"]] for point in points])
    marked = []
    for j, loser in enumerate(points):
        winners = (points[i] for i in np.flatnonzero(beaten[:, j]))
        marked.append({**loser, "on_front": not any(is_clear([loser], [one]) for one in winners)})
    return marked


def is_clear(losers: Sequence[Record], winners: Sequence[Record]) -> bool:
    """Whether any advantage, of two points by the same measures, is beyond the measurement's noise."""
    faster = winners[0]["high"] < losers[0]["low"]
    sooner = find_latency(winners[0]) < find_latency(losers[0])
    nearer = any(
        good["median"] - poor["median"] > BEYOND_NOISE * math.hypot(good["se"], poor["se"])
        for good, poor in zip(winners, losers, strict=True)
    )
    return bool(faster or sooner or nearer)


def find_latency(point: Record) -> float:
    """Find the latency of a point in s; infinite where the whole signal is needed."""
    latency = point["latency_s"]
    return math.inf if latency is None or math.isnan(latency) else float(latency)


def list_dominated(points: DataFrame, accuracies: DataFrame) -> DataFrame:
    """List the dominated reducers, each with every one that dominates it."""
    by_measure = [list_records(points[points["measure"] == measure]) for measure in PAPER]
    places = list(zip(*by_measure, strict=True))
    objectives = [
        [place[0]["ns_per_sample"], find_latency(place[0]), *(-one["median"] for one in place)]
        for place in places
    ]
    means = accuracies.pivot_table(index="scene", columns=["method", "measure"], values="mean")
    rows = []
    for loser, winner in np.argwhere(dominates(objectives).T).tolist():
        good, poor = places[winner], places[loser]
        ahead = [means[good[0]["method"], name] >= means[poor[0]["method"], name] for name in PAPER]
        scenes = np.logical_and(*ahead)
        rows.append({
            "reducer": poor[0]["reducer"], "by": good[0]["reducer"], "clear": is_clear(poor, good),
            "scenes": int(scenes.sum()), "of": len(scenes),
        })  # fmt: skip
    return make_table("dominated", rows)


def name_point(reducer: str) -> str:
    """Return the name under which a reducer is drawn: its group's label, or its own name.

    Examples
    --------
    >>> name_point("say321"), name_point("saz321_matched"), name_point("dft321")
    ('sax/say/saz321', 'sax/say/saz321_matched', 'dft321')
    """
    return _GROUP_OF.get(reducer, reducer)


def format_plainly(value: float) -> str:
    """Write a number of any size without powers.

    Examples
    --------
    >>> format_plainly(0.001), format_plainly(20_000)
    ('0.001', '20\u202f000')
    """
    return f"{value:,.0f}".replace(",", "\u202f") if value >= 1 else f"{value:.10f}".rstrip("0")


def merge_rows(frame: DataFrame) -> DataFrame:
    """Average the rows of reducers that are equal by construction; all others stay as they are, in their order."""
    names = [name for name in ("method", "reducer") if name in frame]
    frame = frame.assign(**{name: frame[name].map(name_point) for name in names})
    averaged = [name for name in frame if name in _AVERAGED]
    keys = [name for name in frame if name not in _AVERAGED]
    if "sd" in frame:
        # The same orientations serve all members, which are not independent: no root of three is gained.
        frame = frame.assign(sd=frame["sd"] ** 2)
    merged = frame.groupby(keys, sort=False, as_index=False)[averaged].mean()
    if "sd" in merged:
        merged["sd"] = np.sqrt(merged["sd"])
    return merged[[*frame]]


def find_reference(costs: DataFrame) -> DataFrame:
    """Find the costs at which reducers are compared: whole signals of the length that the windows are timed at."""
    reference = costs.loc[costs["sweep"] == "window", "n_samples"].iloc[0]
    found: DataFrame = costs[(costs["sweep"] == "size") & (costs["n_samples"] == reference)]
    return found
