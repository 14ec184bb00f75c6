"""The tables of a chart's page, and all its records as CSV."""

from __future__ import annotations

import csv
import io
from dataclasses import astuple, dataclass, fields
from statistics import median
from typing import TYPE_CHECKING

from analysis.table.scales import tell_measure as tell_scale
from analysis.tradeoff.chart.axes import tell_measure, tell_plainly
from analysis.tradeoff.chart.chart import TABLES
from analysis.tradeoff.chart.cost import NS, RATE_HZ, REFERENCE_N
from analysis.tradeoff.chart.records import MEASURES
from analysis.words import tell_name, tell_number, tell_range

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from analysis.tradeoff.chart.chart import Chart
    from analysis.tradeoff.chart.records import Accuracy, Growth, Point, RealTime, Stability

NO = "no"


@dataclass(frozen=True, slots=True)
class Sheet:
    """A table of the page.

    Parameters
    ----------
    caption : str
        What each number is.
    head : tuple of str
        Column heads.
    rows : tuple of tuple of str
        Cells.
    """

    caption: str
    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


def list_sheets(chart: Chart) -> tuple[Sheet, ...]:
    """List the tables of the page.

    Parameters
    ----------
    chart : Chart
        What was measured.

    Returns
    -------
    tuple of Sheet
        Reducers, what they need while they run, hops, growth, precision, ratings if there are any.
    """
    return tuple(sheet for sheet in (_lay_reducers(chart), _lay_running(chart), _lay_hops(chart), _lay_growth(chart),
                                     _lay_precision(chart), _lay_rated(chart)) if sheet.rows)  # fmt: skip


def write_tables(chart: Chart) -> dict[str, str]:
    """Write every record as CSV.

    Parameters
    ----------
    chart : Chart
        What was measured.

    Returns
    -------
    dict of str to str
        Name of a table -> its text, RFC 4180; what is not defined is empty.
    """
    texts = {}
    for name, record in TABLES.items():
        text = io.StringIO(newline="")
        table = csv.writer(text)
        table.writerow([field.name for field in fields(record)])
        table.writerows(astuple(row) for row in getattr(chart, name))
        texts[name] = text.getvalue()
    return texts


def _lay_reducers(chart: Chart) -> Sheet:
    head = ("Reducer", "ns per sample", "× real time", "Latency", *map(tell_measure, MEASURES), "On a front")
    by_reducer: dict[str, list[Point]] = {}
    for point in chart.points:
        by_reducer.setdefault(point.reducer, []).append(point)
    caption = (
        "Reducers as they are. Cost: median and quartiles. Accuracy: median over scenes of the mean over sensor "
        "orientations, and the lowest and highest scene. On a front: of cost and the named measures, s(pectral), "
        "t(emporal), b(ounded), e(nergy-weighted), i(nvariant)."
    )
    return Sheet(caption, head, tuple(_lay_reducer(points) for points in by_reducer.values()))


def _lay_reducer(points: Sequence[Point]) -> tuple[str, ...]:
    first = points[0]
    latency = "whole signal" if first.latency_s is None else f"{1000 * first.latency_s:.3g} ms"
    fronts = [name for name, point in zip(("s", "t", "s b", "s e", "t i"), points, strict=True) if point.on_front]
    return (
        first.reducer, f"{first.ns_per_sample:.3g} [{first.low:.3g} to {first.high:.3g}]",
        tell_plainly(float(f"{NS / RATE_HZ / first.ns_per_sample:.2g}")), latency,
        *(f"{tell_number(point.median)} [{tell_range(point.lowest, point.highest)}]" for point in points),
        ", ".join(fronts) or NO,
    )  # fmt: skip


def _lay_running(chart: Chart) -> Sheet:
    timed = {row.reducer: row for row in chart.realtime}
    gains: dict[str, list[Stability]] = {}
    for row in chart.stability:
        gains.setdefault(row.reducer, []).append(row)
    deadline = f"{next(iter(timed.values())).deadline_us:.0f} µs" if timed else "none"
    caption = (
        f"While it runs. Time per block of 64 samples at 48 kHz (deadline {deadline}): median, 99th percentile and "
        "worst; the block that completes half a window does the work of all of it, which is not spread. State of what "
        f"needs the whole signal: {tell_plainly(REFERENCE_N)} samples. Stability: perturbation gain under sensor noise "
        "of -60 dB, median and worst scene (1: noise passes as it is)."
    )
    head = ("Reducer", "Block: median (µs)", "99 % (µs)", "Worst (µs)", "Worst, share of the deadline (%)",
            "State (bytes)", "Operations per sample", "Perturbation gain, median", "Worst scene")  # fmt: skip
    return Sheet(caption, head, tuple(
        (
            row.reducer, *_tell_times(timed.get(row.reducer)),
            tell_plainly(row.state_bytes) if row.state_bytes else "0", f"{row.operations:.0f}",
            *_tell_gains([one.gain for one in gains.get(row.reducer, [])]),
        )
        for row in chart.resources
    ))  # fmt: skip


def _tell_times(row: RealTime | None) -> tuple[str, ...]:
    if row is None:
        return ("whole signal", "–", "–", "–")
    times = (f"{time:.0f}" for time in (row.median_us, row.p99_us, row.worst_us))
    return (*times, f"{100 * row.worst_us / row.deadline_us:.0f}")


def _tell_gains(gains: Sequence[float]) -> tuple[str, str]:
    return (f"{median(gains):.2g}", f"{max(gains):.3g}") if gains else ("–", "–")


def _lay_hops(chart: Chart) -> Sheet:
    costs = {cost.method: cost for cost in chart.costs if cost.sweep == "hop"}
    rows: dict[str, list[Accuracy]] = {}
    for row in chart.accuracies:
        if row.sweep == "hop":
            rows.setdefault(row.method, []).append(row)
    cells = [
        (method, f"{costs[method].ns_per_sample:.3g}", *(_find_median(own, measure) for measure in MEASURES))
        for method, own in rows.items()
    ]
    caption = (
        "Other hops of the same window: medians over scenes of the means over orientations. The first is half the "
        "window."
    )
    return Sheet(caption, ("Method", "ns per sample", *map(tell_measure, MEASURES)), tuple(cells))


def _find_median(rows: Sequence[Accuracy], measure: str) -> str:
    return f"{median(row.mean for row in rows if row.measure == measure):.3f}"


def _lay_growth(chart: Chart) -> Sheet:
    memory = {row.reducer: row for row in chart.memory}  # the longest stands last
    longest = max(row.n_samples for row in chart.memory)
    head = ("Reducer", "Exponent", "95 % interval", "Overhead (µs)", "Misfit (%)",
            f"Peak memory at {tell_plainly(longest)} (MB)", "× input")  # fmt: skip
    caption = (
        "Time of one call: overhead + b n^exponent, fitted to the medians; misfit: RMS deviation from the fit. Where "
        "the operations grow with n and the exponent is above 1, memory is the reason: long signals leave the caches."
    )
    return Sheet(caption, head, tuple(
        (
            row.reducer, f"{row.exponent:.2f}", _tell_interval(row), f"{row.overhead_us:.0f}",
            f"{100 * row.misfit:.0f}", f"{memory[row.reducer].peak_bytes / 1e6:.1f}",
            f"{memory[row.reducer].relative:.2f}",
        )
        for row in chart.growth
    ))  # fmt: skip


def _tell_interval(row: Growth) -> str:
    return "–" if row.low is None or row.high is None else tell_range(row.low, row.high)


def _lay_precision(chart: Chart) -> Sheet:
    costs = {(cost.reducer, cost.bits): cost for cost in chart.costs if cost.sweep == "bits"}
    caption = (
        "32-bit input: time beside that of 64-bit input, type of the output, and energy of its change. 32-bit "
        "arithmetic: energy of the error where samples, coefficients and transforms are all 32 bits wide, relative to "
        "the output in 64 bits, and the recording where it is largest."
    )
    head = ("Reducer", "32 bit: ns per sample", "64 bit: ns per sample", "Output", "Change (dB)",
            "32-bit arithmetic, error at worst (dB)", "Worst recording")  # fmt: skip
    return Sheet(caption, head, tuple(
        (
            row.reducer, *(f"{costs[row.reducer, bits].ns_per_sample:.3g}" for bits in (32, 64)), row.output,
            *("none" if loss is None else f"{loss:.0f}" for loss in (row.difference_db, row.arithmetic_db)), row.worst,
        )
        for row in chart.precision
    ))  # fmt: skip


def _lay_rated(chart: Chart) -> Sheet:
    head = ("Ratings", "Reducer", "Mean", "Over participants", "Two-way", "Participants", "Recordings")
    return Sheet("Mean ratings with 95 % intervals.", head, tuple(_lay_ratings(chart)))


def _lay_ratings(chart: Chart) -> Iterator[tuple[str, ...]]:
    for row in chart.rated:
        people = "–" if row.low is None or row.high is None else tell_range(row.low, row.high, kind="rating")
        both = tell_range(row.two_way_low, row.two_way_high, kind="rating")
        name = f"{tell_scale(row.scale)}, {tell_name(row.level)}"
        yield name, row.reducer, f"{row.mean:.1f}", people, both, str(row.participants), str(row.recordings)
