"""The chart in words and tables."""

from __future__ import annotations

import csv
import io
from dataclasses import astuple, dataclass, fields
from statistics import median
from typing import TYPE_CHECKING

from feel321.analysis.table.sheet import APART, tell_measure
from feel321.analysis.tradeoff.chart.axes import merge_equal, tell_axis, tell_plainly
from feel321.analysis.tradeoff.chart.cost import CALLS, NS, RATE_HZ, REFERENCE_N
from feel321.analysis.tradeoff.chart.records import MEASURES, TABLES
from feel321.analysis.words import tell_name, tell_number, tell_range

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from feel321.analysis.tradeoff.chart.records import (
        Accuracy,
        Chart,
        Dominance,
        Growth,
        Machine,
        Point,
        Precision,
        Rated,
        RealTime,
        Stability,
    )
    from feel321.stimuli.recording import Recording

# What a chart leaves out or takes for granted, in words.


def list_notes(
    recordings: Sequence[Recording],
    longest_s: float,
    *,
    precision: Sequence[Precision],
    machine: Machine,
) -> tuple[str, ...]:
    """Say what was left out and what was assumed."""
    return (
        "Times are those of this run on this machine and differ from run to run; all other figures come out again from "
        "the same recordings and seed.",
        *_note_load(machine),
        f"Methods are compared at {tell_plainly(REFERENCE_N)} samples; × real time is told for {RATE_HZ / 1000:g} kHz. "
        "The signals that are timed are white noise.",
        "Over scenes the median is told and compared, not the mean: spectral match has no lower bound, so that one "
        "scene with a band nearly without energy would decide. The means stand in tables/points.csv.",
        *_note_pieces(recordings, longest_s),
        "sax/say/saz321 is any single axis: averaged over sensor orientations the three are equal by construction, and "
        "so are their matched and their running forms. Each kind is one point, the mean of its three members; tables "
        "and results.json keep all names. Ratings are those of the axes as mounted.",
        "Scenes were resampled to every sampling rate and compared with the recording at that rate: above a "
        "recording's own rate nothing is added, below it what lies above half the new rate is lost to both.",
        *_note_precision(precision),
        "The hop of every windowed reducer is half its window. Smaller hops of dft321_windowed are the mean of runs "
        "over shifted signals, which is the same output; an implementation of its own could be a little cheaper.",
        f"Block sizes: time of {CALLS} calls or more at {RATE_HZ / 1000:g} kHz, the stream being under way. "
        "A block of k samples adds (k - 1) / rate of waiting to the algorithmic latency.",
        "Memory is what numpy asks for beside the input, the output included; what a Fourier transform keeps inside is "
        "not seen.",
    )


def _note_load(machine: Machine) -> list[str]:
    if machine.load is None or machine.load <= machine.cores:
        return []
    busy = f"{machine.load:.1f} programs for {machine.cores} cores"
    return [
        f"The machine was busy when this began ({busy}): times are longer than on an idle one, ratios less so."
    ]


def _note_pieces(recordings: Sequence[Recording], longest_s: float) -> list[str]:
    cut = sum(recording.duration_s > longest_s for recording in recordings)
    if not cut:
        return []
    longer = f"{cut} of {len(recordings)} recordings are longer than {longest_s:g} s"
    return [f"{longer}: their middle was used; --full uses all."]


def _note_precision(precision: Sequence[Precision]) -> list[str]:
    kinds = sorted({row.output for row in precision})
    if kinds != ["float64"]:
        return [f"Output for 32-bit input: {', '.join(kinds)}."]
    return [
        "32-bit input is not computed in 32 bit: every reducer turns it into float64 first and answers in float64. "
        "What changes is the rounding of the input, and the time that the conversion takes.",
        *_note_arithmetic(precision),
    ]


def _note_arithmetic(precision: Sequence[Precision]) -> list[str]:
    losses = [(row.arithmetic_db, row) for row in precision if row.arithmetic_db is not None]
    if not losses:
        return []
    loss, worst = max(losses, key=lambda one: one[0])
    return [
        "In 32-bit arithmetic throughout (samples, coefficients and transforms) the error is at worst "
        f"{loss:.0f} dB relative to the output in 64 bits, of {worst.reducer} on {worst.worst}."
    ]


# What a chart says, in sentences; every number in them stands in its tables.


def tell_answers(chart: Chart) -> tuple[str, ...]:
    """Say what came out."""
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

    Examples
    --------
    >>> join(["a"]), join(["a", "b", "c"])
    ('a', 'a, b and c')
    """
    *first, last = names
    return f"{', '.join(first)} and {last}" if first else last


def tell_cost(point: Point) -> str:
    """Tell what a sample costs."""
    times = NS / RATE_HZ / point.ns_per_sample
    return f"{point.ns_per_sample:.3g} ns per sample, {tell_plainly(float(f'{times:.2g}'))} × real time"


def tell_exponent(row: Growth) -> str:
    """Tell an exponent."""
    interval = (
        ""
        if row.low is None or row.high is None
        else f", 95 % interval {tell_range(row.low, row.high)}"
    )
    return f"{row.exponent:.2f} ({row.reducer}{interval})"


def _tell_speed(points: list[Point]) -> str:
    cheapest, dearest = (
        extreme(points, key=lambda point: point.ns_per_sample) for extreme in (min, max)
    )
    length = f"at {tell_plainly(REFERENCE_N)} samples and {RATE_HZ / 1000:g} kHz"
    ends = f"Cheapest is {cheapest.reducer} ({tell_cost(cheapest)}), dearest {dearest.reducer} ({tell_cost(dearest)})"
    return f"{ends}, {length}."


def _tell_front(chart: Chart, measure: str) -> str:
    front = [point for point in chart.points if point.measure == measure and point.on_front]
    front.sort(key=lambda point: point.ns_per_sample)
    shown = join(f"{point.reducer} ({point.median:.2f})" for point in front)
    name = tell_axis(measure)
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
            f"Best mean {tell_measure(scale)} ({tell_name(level)}): {best.reducer}, {best.mean:.1f} "
            f"(95 % two-way interval {interval}; participants: {best.participants}, recordings: {best.recordings})."
        )


# The tables of a chart's page, and all its records as CSV.

NO = "no"


@dataclass(frozen=True, slots=True)
class Sheet:
    """A table of the page."""

    caption: str
    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


def list_sheets(chart: Chart) -> tuple[Sheet, ...]:
    """List the tables of the page."""
    return tuple(
        sheet
        for sheet in (
            _lay_reducers(chart),
            _lay_running(chart),
            _lay_hops(chart),
            _lay_growth(chart),
            _lay_precision(chart),
            _lay_rated(chart),
        )
        if sheet.rows
    )


def write_tables(chart: Chart) -> dict[str, str]:
    """Write every record as CSV.

    Returns name of a table -> its text, RFC 4180.
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
    head = (
        "Reducer",
        "ns per sample",
        "× real time",
        "Latency",
        *map(tell_axis, MEASURES),
        "On a front",
    )
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
    fronts = [
        name
        for name, point in zip(("s", "t", "s b", "s e", "t i"), points, strict=True)
        if point.on_front
    ]
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
    head = (
        "Reducer",
        "Block: median (µs)",
        "99 % (µs)",
        "Worst (µs)",
        "Worst, share of the deadline (%)",
        "State (bytes)",
        "Operations per sample",
        "Perturbation gain, median",
        "Worst scene",
    )
    return Sheet(
        caption,
        head,
        tuple(
            (
                row.reducer,
                *_tell_times(timed.get(row.reducer)),
                tell_plainly(row.state_bytes) if row.state_bytes else "0",
                f"{row.operations:.0f}",
                *_tell_gains([one.gain for one in gains.get(row.reducer, [])]),
            )
            for row in chart.resources
        ),
    )


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
        (
            method,
            f"{costs[method].ns_per_sample:.3g}",
            *(_find_median(own, measure) for measure in MEASURES),
        )
        for method, own in rows.items()
    ]
    caption = (
        "Other hops of the same window: medians over scenes of the means over orientations. The first is half the "
        "window."
    )
    return Sheet(caption, ("Method", "ns per sample", *map(tell_axis, MEASURES)), tuple(cells))


def _find_median(rows: Sequence[Accuracy], measure: str) -> str:
    return f"{median(row.mean for row in rows if row.measure == measure):.3f}"


def _lay_growth(chart: Chart) -> Sheet:
    memory = {row.reducer: row for row in chart.memory}  # the longest stands last
    longest = max(row.n_samples for row in chart.memory)
    head = (
        "Reducer",
        "Exponent",
        "95 % interval",
        "Overhead (µs)",
        "Misfit (%)",
        f"Peak memory at {tell_plainly(longest)} (MB)",
        "× input",
    )
    caption = (
        "Time of one call: overhead + b n^exponent, fitted to the medians; misfit: RMS deviation from the fit. Where "
        "the operations grow with n and the exponent is above 1, memory is the reason: long signals leave the caches."
    )
    return Sheet(
        caption,
        head,
        tuple(
            (
                row.reducer,
                f"{row.exponent:.2f}",
                _tell_interval(row),
                f"{row.overhead_us:.0f}",
                f"{100 * row.misfit:.0f}",
                f"{memory[row.reducer].peak_bytes / 1e6:.1f}",
                f"{memory[row.reducer].relative:.2f}",
            )
            for row in chart.growth
        ),
    )


def _tell_interval(row: Growth) -> str:
    return "–" if row.low is None or row.high is None else tell_range(row.low, row.high)


def _lay_precision(chart: Chart) -> Sheet:
    costs = {(cost.reducer, cost.bits): cost for cost in chart.costs if cost.sweep == "bits"}
    caption = (
        "32-bit input: time beside that of 64-bit input, type of the output, and energy of its change. 32-bit "
        "arithmetic: energy of the error where samples, coefficients and transforms are all 32 bits wide, relative to "
        "the output in 64 bits, and the recording where it is largest."
    )
    head = (
        "Reducer",
        "32 bit: ns per sample",
        "64 bit: ns per sample",
        "Output",
        "Change (dB)",
        "32-bit arithmetic, error at worst (dB)",
        "Worst recording",
    )
    return Sheet(
        caption,
        head,
        tuple(
            (
                row.reducer,
                *(f"{costs[row.reducer, bits].ns_per_sample:.3g}" for bits in (32, 64)),
                row.output,
                *(
                    "none" if loss is None else f"{loss:.0f}"
                    for loss in (row.difference_db, row.arithmetic_db)
                ),
                row.worst,
            )
            for row in chart.precision
        ),
    )


def _lay_rated(chart: Chart) -> Sheet:
    head = (
        "Ratings",
        "Reducer",
        "Mean",
        "Over participants",
        "Two-way",
        "Participants",
        "Recordings",
    )
    return Sheet("Mean ratings with 95 % intervals.", head, tuple(_lay_ratings(chart)))


def _lay_ratings(chart: Chart) -> Iterator[tuple[str, ...]]:
    for row in chart.rated:
        people = (
            "–"
            if row.low is None or row.high is None
            else tell_range(row.low, row.high, kind="rating")
        )
        both = tell_range(row.two_way_low, row.two_way_high, kind="rating")
        name = f"{tell_measure(row.scale)}, {tell_name(row.level)}"
        yield (
            name,
            row.reducer,
            f"{row.mean:.1f}",
            people,
            both,
            str(row.participants),
            str(row.recordings),
        )
