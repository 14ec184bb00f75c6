"""What a chart shows, in words: the reducers worth considering, one sentence, and a few answers.

Accuracy is the bounded spectral match here, from 0 to 1 whatever the reducer. Values that agree in two decimals count
as equal, and of equals the fastest is named. Every number is in the tables.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from feel321.analysis import words
from feel321.analysis.table.schema import APART
from feel321.analysis.tradeoff.chart.cost import NS, RATE_HZ, REFERENCE_N
from feel321.analysis.tradeoff.chart.points import (
    ACCURACY,
    MEASURES,
    Record,
    Tables,
    find_latency,
    format_plainly,
    list_records,
    split,
)
from feel321.analysis.tradeoff.stress.measures import MEASURES as STRESS

if TYPE_CHECKING:
    from pandas import DataFrame

KHZ = f"{RATE_HZ / 1000:g} kHz"
MOST = 5
"""Reducers that are put forward."""

STEADY = STRESS["gain"].caution
"""Gain of sensor noise below which a reducer is steady in a scene."""


@dataclass(frozen=True, slots=True)
class Candidate:
    """A reducer worth considering, and why.

    accuracy, lowest, highest: bounded spectral match, median, lowest and highest scene; gain: of sensor noise in the
    worst scene, NaN where no scene has motion; time_course: invariant temporal match; latency_s: infinite where the
    whole signal is needed; cost_low, cost_high: quartiles.
    """

    reducer: str
    why: str
    accuracy: float
    lowest: float
    highest: float
    ns_per_sample: float
    cost_low: float
    cost_high: float
    real_time: float
    gain: float
    time_course: float
    latency_s: float
    on_front: bool

    @property
    def steady(self) -> bool:
        """Whether sensor noise is amplified in no scene."""
        return not self.gain >= STEADY


def list_candidates(merged: Tables) -> tuple[Candidate, ...]:
    """List all reducers of a chart, the most accurate first, without a reason."""
    points = merged["points"]
    time = points[points["measure"] == MEASURES[-1]].set_index("reducer")["median"]
    gains = merged["stability"].groupby("reducer")["gain"].max()
    found = [
        Candidate(
            row["reducer"], "", row["median"], row["lowest"], row["highest"], row["ns_per_sample"], row["low"],
            row["high"], NS / RATE_HZ / row["ns_per_sample"], float(gains.get(row["reducer"], math.nan)),
            float(time[row["reducer"]]), find_latency(row), bool(row["on_front"]),
        )
        for row in list_records(points[points["measure"] == ACCURACY])
    ]  # fmt: skip
    return tuple(sorted(found, key=_rank_accuracy))


def _rank_accuracy(one: Candidate) -> tuple[float, float]:
    return -round(one.accuracy, 2), one.ns_per_sample


def choose_candidates(merged: Tables) -> tuple[Candidate, ...]:
    """Choose at most five reducers worth considering, and say why."""
    from dataclasses import replace

    every = list_candidates(merged)
    reasons: dict[str, list[str]] = {}
    for why, one in _assign_reasons(every):
        if one.reducer in reasons or len(reasons) < MOST:
            reasons.setdefault(one.reducer, []).append(why)
    return tuple(
        replace(one, why=", ".join(reasons[one.reducer])) for one in every if one.reducer in reasons
    )


def _assign_reasons(rivals: Sequence[Candidate]) -> Iterator[tuple[str, Candidate]]:
    """Assign each reason to a reducer, the weightiest first; rivals: the most accurate first."""
    yield "most accurate", rivals[0]
    if not rivals[0].steady:
        yield from (
            ("most accurate of the steady", one) for one in _first(rivals, lambda x: x.steady)
        )
    if math.isinf(rivals[0].latency_s):
        live = _first(rivals, lambda one: not math.isinf(one.latency_s))
        yield from (("most accurate live", one) for one in live)
    yield "fastest", min(rivals, key=lambda one: one.ns_per_sample)
    if (middle := find_middle(rivals)) is not None:
        yield "best in between", middle
    by_time = min(rivals, key=lambda one: (-round(one.time_course, 2), one.ns_per_sample))
    yield "keeps the time course best", by_time


def _first(rivals: Sequence[Candidate], fits: Callable[[Candidate], bool]) -> Sequence[Candidate]:
    return [one for one in rivals if fits(one)][:1]


def find_middle(rivals: Sequence[Candidate]) -> Candidate | None:
    """Find who gains most between the fastest and the most accurate, on the front; None if nobody is above their line.

    The line is straight over the logarithm of the cost; rivals: the most accurate first.
    """
    best, fast = rivals[0], min(rivals, key=lambda one: one.ns_per_sample)
    width = math.log(best.ns_per_sample / fast.ns_per_sample)
    if width <= 0:
        return None

    def rise(one: Candidate) -> float:
        share = math.log(one.ns_per_sample / fast.ns_per_sample) / width
        return one.accuracy - fast.accuracy - share * (best.accuracy - fast.accuracy)

    between = [
        one
        for one in rivals
        if one.on_front
        and fast.ns_per_sample < one.ns_per_sample < best.ns_per_sample
        and fast.accuracy < one.accuracy
        and rise(one) > 0
    ]
    return max(between, key=rise, default=None)


def describe_finding(merged: Tables) -> str:
    """Describe in one sentence who is most accurate, how steady it is, and what a faster one loses."""
    rivals = list_candidates(merged)
    best, said = rivals[0], _describe_best(rivals)
    if len(rivals) == 1:
        return f"{said}."
    clear = [one for one in rivals if one.cost_high < best.cost_low]
    if not clear:
        return f"{said}; no other is clearly faster."
    middle = find_middle(rivals)
    other = middle if middle in clear else min(clear, key=lambda one: one.ns_per_sample)
    ratio = best.ns_per_sample / other.ns_per_sample
    times = f"{ratio:.0f}" if ratio >= 9.95 else f"{ratio:.1f}"  # noqa: PLR2004 - where rounding adds a digit
    lost = f"{best.accuracy - other.accuracy:.2f}"
    lost = lost if float(lost) > 0 else "less than 0.01"
    return f"{said}; {other.reducer} is {times} times faster and loses {lost}."


def _describe_best(rivals: Sequence[Candidate]) -> str:
    best = rivals[0]
    equal = sum(round(one.accuracy, 2) == round(best.accuracy, 2) for one in rivals)
    place = (
        f"the fastest of the {equal} most accurate reducers" if equal > 1 else "the most accurate"
    )
    said = f"{best.reducer} is {place} (bounded spectral match {best.accuracy:.2f})"
    if math.isnan(best.gain):
        return said
    noise = f"{float(f'{best.gain:.2g}'):g} times"
    return f"{said} {'and steady' if best.steady else f'but amplifies sensor noise up to {noise}'}"


def describe_answers(tables: Tables, merged: Tables) -> tuple[str, ...]:
    """Describe the main results; every number in the sentences is in the tables; merged: see `merge_equal`."""
    points = merged["points"]
    return (
        describe_finding(merged),
        _describe_speed(list_records(points[points["measure"] == ACCURACY])),
        _describe_front(points),
        _describe_dominated(tables["dominated"]),
        _describe_growth(list_records(merged["growth"])),
        *_describe_rated(tables["rated"]),
    )


def format_real_time(point: Record) -> str:
    """Write how many times faster than real time a point is."""
    return format_plainly(float(f"{NS / RATE_HZ / point['ns_per_sample']:.2g}"))


def _describe_speed(points: Sequence[Record]) -> str:
    ordered = sorted(points, key=lambda one: one["ns_per_sample"])
    shown = [
        f"{one['reducer']} ({one['ns_per_sample']:.3g} ns per sample, {format_real_time(one)} × real time)"
        for one in (ordered[0], ordered[-1])
    ]
    return f"Fastest: {shown[0]}; slowest: {shown[1]}, at {format_plainly(REFERENCE_N)} samples and {KHZ}."


def _describe_front(points: DataFrame) -> str:
    own = points[points["on_front"]].groupby("reducer", sort=False)["measure"].agg(list)
    kinds = {"spectral": 0, "temporal": 0}
    for measure in MEASURES:
        kinds[measure.split("_")[0]] += 1
    shown = []
    for reducer, measures in own.items():
        parts = []
        for kind, of in kinds.items():
            count = sum(measure.startswith(kind) for measure in measures)
            if count:
                parts.append(f"{'each' if count == of else f'{count} of {of}'} {kind}")
        shown.append(f"{reducer} ({', '.join(parts)})")
    return f"On the front of cost and a match: {'; '.join(shown)}. No other reducer clearly beats these in both."


def _describe_dominated(dominated: DataFrame) -> str:
    clear = dominated[dominated["clear"].astype(bool)]
    named = []
    for reducer, own in split(clear, "reducer"):
        best = own.sort_values("scenes", ascending=False, kind="stable").iloc[0]
        named.append(
            f"{reducer} (by {best['by']}, as good in {best['scenes']} of {best['of']} scenes)"
        )
    beaten = "in cost, latency and both of the paper's metrics together"
    if not named:
        return f"No reducer is clearly dominated {beaten}."
    return f"Clearly dominated {beaten}: {'; '.join(named)}."


def _describe_growth(growth: Sequence[Record]) -> str:
    ordered = sorted(growth, key=lambda row: row["exponent"])
    ends = [f"{row['exponent']:.2f} ({row['reducer']})" for row in (ordered[0], ordered[-1])]
    steep = sum(row["low"] > 1 for row in growth)
    lengths = " to ".join(format_plainly(growth[0][name]) for name in ("smallest", "largest"))
    which = f"{steep} of {len(growth)} reducers" if steep else "no reducer"
    return (
        f"Computing time grows with length n ({lengths} samples) as n^{ends[0]} to n^{ends[1]}; clearly faster than "
        f"linearly for {which}."
    )


def _describe_rated(rated: DataFrame) -> Iterator[str]:
    for (scale, level), own in split(rated, "scale", "level"):
        best = own.sort_values("mean", ascending=scale in APART, kind="stable").iloc[0]
        interval = words.format_interval(best["two_way_low"], best["two_way_high"], kind="rating")
        of = f"{words.format_measure(scale)} ({words.format_name(level)})"
        yield (
            f"Best mean {of}: {best['reducer']}, {best['mean']:.1f} (95 % two-way interval "
            f"{interval}; participants: {best['participants']}, recordings: {best['recordings']})."
        )
