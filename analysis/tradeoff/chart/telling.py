"""What a chart says, in sentences; every number in them stands in its tables."""

from __future__ import annotations

from typing import TYPE_CHECKING

from analysis.table.scales import APART
from analysis.table.scales import tell_measure as tell_scale
from analysis.tradeoff.chart.axes import tell_measure, tell_plainly
from analysis.tradeoff.chart.cost import NS, RATE_HZ, REFERENCE_N
from analysis.tradeoff.chart.equal import merge_equal
from analysis.tradeoff.chart.records import MEASURES
from analysis.words import tell_name, tell_range

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from analysis.tradeoff.chart.chart import Chart
    from analysis.tradeoff.chart.records import Dominance, Growth, Point, Rated


def tell_answers(chart: Chart) -> tuple[str, ...]:
    """Say what came out.

    Parameters
    ----------
    chart : Chart
        What was measured.

    Returns
    -------
    tuple of str
        Speed, fronts, who is dominated, growth, ratings.
    """
    chart = merge_equal(chart)
    return (
        _tell_speed([point for point in chart.points if point.measure == MEASURES[0]]),
        *(_tell_front(chart, measure) for measure in MEASURES),
        *_tell_dominated(chart.dominated),
        _tell_growth(chart),
        *_tell_rated(chart),
    )


def join(names: Iterable[str]) -> str:
    """Join names to a list in words.

    Parameters
    ----------
    names : iterable of str
        One or more.

    Returns
    -------
    str
        With "and" before the last.

    Examples
    --------
    >>> join(["a"]), join(["a", "b", "c"])
    ('a', 'a, b and c')
    """
    *first, last = names
    return f"{', '.join(first)} and {last}" if first else last


def tell_cost(point: Point) -> str:
    """Tell what a sample costs.

    Parameters
    ----------
    point : Point
        Of a reducer.

    Returns
    -------
    str
        In ns and as a multiple of real time.
    """
    times = NS / RATE_HZ / point.ns_per_sample
    return f"{point.ns_per_sample:.3g} ns per sample, {tell_plainly(float(f'{times:.2g}'))} × real time"


def tell_exponent(row: Growth) -> str:
    """Tell an exponent.

    Parameters
    ----------
    row : Growth
        Of a reducer.

    Returns
    -------
    str
        With the reducer and, where there is one, the interval.
    """
    interval = "" if row.low is None or row.high is None else f", 95 % interval {tell_range(row.low, row.high)}"
    return f"{row.exponent:.2f} ({row.reducer}{interval})"


def _tell_speed(points: list[Point]) -> str:
    cheapest, dearest = (extreme(points, key=lambda point: point.ns_per_sample) for extreme in (min, max))
    length = f"at {tell_plainly(REFERENCE_N)} samples and {RATE_HZ / 1000:g} kHz"
    ends = f"Cheapest is {cheapest.reducer} ({tell_cost(cheapest)}), dearest {dearest.reducer} ({tell_cost(dearest)})"
    return f"{ends}, {length}."


def _tell_front(chart: Chart, measure: str) -> str:
    front = [point for point in chart.points if point.measure == measure and point.on_front]
    front.sort(key=lambda point: point.ns_per_sample)
    shown = join(f"{point.reducer} ({point.median:.2f})" for point in front)
    name = tell_measure(measure)
    return f"{name}{',' if ',' in name else ''} against cost: on the front are {shown}."


def _tell_dominated(dominated: Iterable[Dominance]) -> Iterator[str]:
    clear: dict[str, list[str]] = {}
    unclear: dict[str, list[str]] = {}
    for row in dominated:
        winner = f"{row.by} ({row.scenes} of {row.of})"
        (clear if row.clear else unclear).setdefault(row.reducer, []).append(winner)
    named = "; ".join(f"{reducer} by {join(winners)}" for reducer, winners in clear.items())
    yield (
        f"Dominated in cost, latency and both of the paper's metrics together: {named}. In brackets: scenes in which "
        "the other one is at least as good by both metrics."
        if named
        else "No reducer is clearly dominated in cost, latency and both of the paper's metrics together."
    )
    for reducer, winners in unclear.items():
        if reducer not in clear:
            yield f"{reducer} cannot be told apart from {join(winners)}: its disadvantage is within the noise."


def _tell_growth(chart: Chart) -> str:
    ordered = sorted(chart.growth, key=lambda row: row.exponent)
    slowest, fastest = ordered[0], ordered[-1]
    above = [row.reducer for row in chart.growth if row.low is not None and row.low > 1]
    steep = f"clearly faster than n: {join(above)}" if above else "for none clearly faster than n"
    lengths = f"{tell_plainly(slowest.smallest)} to {tell_plainly(slowest.largest)} samples"
    return (
        f"Time grows with length n (from {lengths}) as n^{tell_exponent(slowest)} to n^{tell_exponent(fastest)}, "
        f"{steep}."
    )


def _tell_rated(chart: Chart) -> Iterator[str]:
    groups: dict[tuple[str, str], list[Rated]] = {}
    for row in chart.rated:
        groups.setdefault((row.scale, row.level), []).append(row)
    for (scale, level), rows in groups.items():
        best = (min if scale in APART else max)(rows, key=lambda row: row.mean)
        interval = tell_range(best.two_way_low, best.two_way_high, kind="rating")
        yield (
            f"Best mean {tell_scale(scale)} ({tell_name(level)}): {best.reducer}, {best.mean:.1f} "
            f"(95 % two-way interval {interval}; participants: {best.participants}, recordings: {best.recordings})."
        )
