"""The chart's page: answers, notes and tables in words, figures, and what its script lets a reader explore."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from feel321.analysis import words
from feel321.analysis.page import TEMPLATES, write_script_data
from feel321.analysis.report import section
from feel321.analysis.report.section import PageTable, Picture
from feel321.analysis.table.schema import APART
from feel321.analysis.tradeoff.chart import figures
from feel321.analysis.tradeoff.chart.accuracy import ReducerVariant, list_variants
from feel321.analysis.tradeoff.chart.cost import CALLS, NS, REFERENCE_N
from feel321.analysis.tradeoff.chart.finding import (
    KHZ,
    choose_candidates,
    describe_answers,
    format_real_time,
)
from feel321.analysis.tradeoff.chart.points import (
    GROUPS,
    MEASURES,
    Record,
    Tables,
    find_latency,
    find_reference,
    format_plainly,
    list_records,
    name_point,
    split,
)
from feel321.stimuli.reducers.registry import REDUCERS

if TYPE_CHECKING:
    from feel321.stimuli.recording import Recording

PLACES = 5
"""Significant digits that the page's script gets; results.json has all."""

_MARKS = (
    "A marker is the median over scenes of the mean over random sensor orientations, a small dot one scene, the "
    f"vertical line their span. Values below {figures.CUT:g} are drawn at the edge."
)
_FRONT = (
    "The horizontal line spans the quartiles of the cost. Dashed: the Pareto front; edged in black: reducers that no "
    "other one clearly beats in both. Averaged over orientations, the three single-axis reducers are equivalent: they "
    "are one point, sax/say/saz321, as are their matched and running forms."
)


_THREE = (
    "Accuracy: bounded spectral match, median over scenes (mark) and their span. Cost: median and quartiles. "
    "Stability: how many times stronger sensor noise becomes, median (mark) to worst scene; from "
    f"{figures.LIMIT:g} on (dashed) a reducer fails. Names in bold, joined by a dashed line: the front of accuracy and "
    "cost, which no other reducer clearly beats in both."
)

_TIMES_VARY = (
    "Times are those of this run on this machine and differ from run to run; all other numbers are reproduced from the "
    "same recordings and seed."
)
_COMPARED = (
    f"Methods are compared at {format_plainly(REFERENCE_N)} samples; × real time is for {KHZ}. The timed "
    "signals are white noise.",
    "Medians over scenes are reported and compared, not means: spectral match has no lower bound, so that a single "
    "scene with an almost empty band would dominate the mean. The means are in tables/points.csv.",
)
_EQUAL = (
    "sax/say/saz321 is any single axis: averaged over sensor orientations the three are equal by construction, and so "
    "are their matched and their running forms. Each kind is one point, the mean of its three members; tables and "
    "results.json keep all names. Ratings are those of the axes as mounted.",
    "Scenes were resampled to every sampling rate and compared with the recording at that rate: above its own "
    "rate nothing is added, below it what lies above half the new rate is lost to both.",
)
_SWEPT = (
    "The hop of every windowed reducer is half its window. Smaller hops of dft321_windowed are the mean of runs over "
    "shifted signals, which is the same output; an implementation of its own could be a little cheaper.",
    f"Block sizes: time of {CALLS} calls or more at {KHZ}, once the stream is running. A block of k samples adds "
    "(k - 1) / rate of waiting to the algorithmic latency.",
    "Memory is what NumPy allocates besides the input, including the output; buffers internal to the Fourier transform "
    "are not counted.",
)


def collect_notes(
    recordings: Sequence[Recording],
    longest_s: float,
    *,
    precision: Sequence[Record],
    machine: Mapping[str, Any],
) -> Iterator[str]:
    """Collect what was left out and what was assumed."""
    yield _TIMES_VARY
    if machine["load"] is not None and machine["load"] > machine["cores"]:
        busy = f"{machine['load']:.1f} programs for {machine['cores']} cores"
        yield (
            f"The machine was busy at the start ({busy}): times are longer than on an idle one, ratios less so."
        )
    yield from _COMPARED
    if cut := sum(recording.duration_s > longest_s for recording in recordings):
        longer = f"{cut} of {len(recordings)} recordings are longer than {longest_s:g} s"
        yield f"{longer}: their middle was used; full=True (--full) uses all."
    yield from _EQUAL
    yield from _note_precision(precision)
    yield from _SWEPT


def _note_precision(precision: Sequence[Record]) -> Iterator[str]:
    kinds = sorted({row["output"] for row in precision})
    if kinds != ["float64"]:
        yield f"Output for 32-bit input: {', '.join(kinds)}."
        return
    yield (
        "32-bit input is not computed in 32 bit: every reducer converts it to float64 first and returns float64. What "
        "changes is the rounding of the input, and the time that the conversion takes."
    )
    losses = [row for row in precision if row["arithmetic_db"] is not None]
    if losses:
        worst = max(losses, key=lambda row: float(row["arithmetic_db"]))
        yield (
            "In 32-bit arithmetic throughout (samples, coefficients and transforms) the error is at worst "
            f"{worst['arithmetic_db']:.0f} dB relative to the output in 64 bits, of {worst['reducer']} on "
            f"{worst['worst']}."
        )


def tabulate(tables: Tables) -> tuple[PageTable, ...]:
    """Build the tables of the page."""
    built = (
        _tabulate_reducers(tables), _tabulate_running(tables), _tabulate_hops(tables),
        _tabulate_growth(tables), _tabulate_precision(tables), _tabulate_rated(tables),
    )  # fmt: skip
    return tuple(table for table in built if table.rows)


def _build(caption: str, rows: Iterable[Mapping[str, str]]) -> PageTable:
    """Build a table of rows whose keys are its head."""
    listed = list(rows)
    return PageTable(
        caption, tuple(listed[0]) if listed else (), tuple(tuple(row.values()) for row in listed)
    )


def _tabulate_reducers(tables: Tables) -> PageTable:
    rows = []
    for reducer, own in split(tables["points"], "reducer"):
        points = list_records(own)
        first, latency = points[0], f"{1000 * points[0]['latency_s']:.3g} ms"
        fronts = [
            name
            for name, one in zip(("s", "t", "s b", "s e", "t i"), points, strict=True)
            if one["on_front"]
        ]
        rows.append({
            "Reducer": str(reducer),
            "ns per sample": f"{first['ns_per_sample']:.3g} [{first['low']:.3g} to {first['high']:.3g}]",
            "× real time": format_real_time(first),
            "Latency": "whole signal" if math.isnan(first["latency_s"]) else latency,
            **{
                figures.describe_measure(one["measure"]):
                    f"{words.format_number(one['median'])} [{words.format_interval(one['lowest'], one['highest'])}]"
                for one in points
            },
            "On a front": ", ".join(fronts) or "no",
        })  # fmt: skip
    caption = (
        "Reducers as they are. Cost: median and quartiles. Accuracy: median over scenes of the mean over sensor "
        "orientations, and the lowest and highest scene. On a front: of cost and the named measures, s(pectral), "
        "t(emporal), b(ounded), e(nergy-weighted), i(nvariant)."
    )
    return _build(caption, rows)


def _tabulate_running(tables: Tables) -> PageTable:
    timed = {row["reducer"]: row for row in list_records(tables["realtime"])}
    gains = tables["stability"].groupby("reducer")["gain"]
    rows = []
    for row in list_records(tables["resources"]):
        name, own = row["reducer"], timed.get(row["reducer"])
        gain = gains.get_group(name) if name in gains.groups else None
        times = [own[key] if own else math.nan for key in ("median_us", "p99_us", "worst_us")]
        shown = [words.ABSENT if math.isnan(one) else f"{one:.0f}" for one in times]
        rows.append({
            "Reducer": name, "Block: median (µs)": shown[0] if own else "whole signal",
            "99 % (µs)": shown[1], "Worst (µs)": shown[2],
            "Worst, share of the deadline (%)": f"{100 * times[2] / own['deadline_us']:.0f}" if own else words.ABSENT,
            "State (bytes)": _format_known(row["state_bytes"], format_plainly),
            "Operations per sample": _format_known(row["operations"], "{:.0f}".format),
            "Perturbation gain, median": words.ABSENT if gain is None else f"{gain.median():.2g}",
            "Worst scene": words.ABSENT if gain is None else f"{gain.max():.3g}",
        })  # fmt: skip
    deadline = f"{next(iter(timed.values()))['deadline_us']:.0f} µs" if timed else "none"
    caption = (
        f"While a reducer runs. Time per block of 64 samples at 48 kHz (deadline {deadline}): median, 99th percentile "
        "and worst; the block that completes half a window does the work of all of it. State of reducers that need the "
        f"whole signal: {format_plainly(REFERENCE_N)} samples. Stability: perturbation gain under sensor noise "
        "of -60 dB, median and worst scene (1: noise passes as it is)."
    )
    return _build(caption, rows)


def _tabulate_hops(tables: Tables) -> PageTable:
    costs, accuracies = (
        tables[name][tables[name]["sweep"] == "hop"] for name in ("costs", "accuracies")
    )
    medians = accuracies.groupby(["method", "measure"])["mean"].median()
    rows = (
        {
            "Method": row["method"], "ns per sample": f"{row['ns_per_sample']:.3g}",
            **{figures.describe_measure(name): f"{medians[row['method'], name]:.3f}" for name in MEASURES},
        }
        for row in list_records(costs)
    )  # fmt: skip
    caption = (
        "Other hops of the same window: medians over scenes of the means over orientations. The first is half the "
        "window."
    )
    return _build(caption, rows)


def _tabulate_growth(tables: Tables) -> PageTable:
    memory = {
        row["reducer"]: row for row in list_records(tables["memory"])
    }  # the longest stands last
    longest = format_plainly(tables["memory"]["n_samples"].max())
    rows = (
        {
            "Reducer": row["reducer"], "Exponent": f"{row['exponent']:.2f}",
            "95 % interval": words.format_interval(row["low"], row["high"]),
            "Overhead (µs)": f"{row['overhead_us']:.0f}", "Misfit (%)": f"{100 * row['misfit']:.0f}",
            f"Peak memory at {longest} (MB)": f"{memory[row['reducer']]['peak_bytes'] / 1e6:.1f}",
            "× input": f"{memory[row['reducer']]['relative']:.2f}",
        }
        for row in list_records(tables["growth"])
    )  # fmt: skip
    caption = (
        "Time of one call: overhead + b n^exponent, fitted to the medians; misfit: RMS deviation from the fit. Where "
        "the operations grow with n and the exponent is above 1, memory is the reason: long signals leave the caches."
    )
    return _build(caption, rows)


def _tabulate_precision(tables: Tables) -> PageTable:
    bits = tables["costs"][tables["costs"]["sweep"] == "bits"].set_index(["reducer", "bits"])[
        "ns_per_sample"
    ]

    def level(value: float | None) -> str:
        return "none" if value is None or math.isnan(value) else f"{value:.0f}"

    rows = (
        {
            "Reducer": row["reducer"],
            **{f"{width} bit: ns per sample": f"{bits[row['reducer'], width]:.3g}" for width in (32, 64)},
            "Output": row["output"], "Change (dB)": level(row["difference_db"]),
            "32-bit arithmetic, error at worst (dB)": level(row["arithmetic_db"]), "Worst recording": row["worst"],
        }
        for row in list_records(tables["precision"])
    )  # fmt: skip
    caption = (
        "32-bit input: time beside that of 64-bit input, type of the output, and energy of its change. 32-bit "
        "arithmetic: energy of the error where samples, coefficients and transforms are all 32 bits wide, relative to "
        "the output in 64 bits, and the recording where it is largest."
    )
    return _build(caption, rows)


def _tabulate_rated(tables: Tables) -> PageTable:
    def interval(row: Record, which: str = "") -> str:
        return words.format_interval(row[f"{which}low"], row[f"{which}high"], kind="rating")

    rows = (
        {
            "Ratings": f"{words.format_measure(row['scale'])}, {words.format_name(row['level'])}",
            "Reducer": row["reducer"], "Mean": f"{row['mean']:.1f}", "Over participants": interval(row),
            "Two-way": interval(row, "two_way_"), "Participants": str(row["participants"]),
            "Recordings": str(row["recordings"]),
        }
        for row in list_records(tables["rated"])
    )  # fmt: skip
    return _build("Mean ratings with 95 % intervals.", rows)


def list_pictures(tables: Tables, merged: Tables) -> list[Picture]:
    """List the figures."""
    spans = f"A vertical line spans the scenes. Values below {figures.CUT:g} are drawn at the edge."
    pictures = [
        Picture("tradeoff", f"Accuracy, cost and stability of each reducer, the most accurate first. {_THREE}",
                figures.draw_tradeoff(merged)),
        Picture("cost", f"Both of the paper's metrics against cost. {_MARKS} {_FRONT}", figures.draw_cost(merged)),
        Picture("cost_invariant", "Their bounded counterparts, which no orientation of the sensor changes, against "
                f"cost. {_MARKS} {_FRONT}", figures.draw_cost(merged, MEASURES[2:])),
        Picture("latency", "Both of the paper's metrics against algorithmic latency, windowed reducers with windows of "
                f"10 to 200 ms. {spans} Markers are offset to avoid overlap.", figures.draw_latency(merged)),
        Picture("growth", "Time of one call (median, shaded: quartiles) and the most memory that it holds beside its "
                "input, against the length of the signal.", figures.draw_growth(merged)),
        Picture("blocks", "Cost of streaming against the samples per call (median, shaded: quartiles); reducers that "
                "need the whole signal cannot stream.", figures.draw_blocks(merged)),
        Picture("rates", "Both of the paper's metrics and speed against the sampling rate: medians over scenes of the "
                f"means over orientations. Values below {figures.CUT:g} are drawn at the edge.",
                figures.draw_rates(merged)),
    ]  # fmt: skip
    for (scale, level), _ in split(tables["rated"], "scale", "level"):
        of = f"{words.format_measure(scale)} (level {words.format_name(level)})"
        caption = (
            f"Mean {of} against cost. Thick: 95 % t interval over participants, for these recordings; thin: 95 % "
            "bootstrap interval over participants and recordings."
        )
        drawing = figures.draw_rated(tables, scale, level)
        pictures.append(Picture(section.make_slug("rated", scale, level), caption, drawing))
    return list(section.name_pictures(pictures))


def build_page(tables: Tables, merged: Tables) -> dict[str, Any]:
    """Build what the page shows of the tables."""
    axes, candidates = list_axes(tables), choose_candidates(merged)
    return {
        "answers": describe_answers(tables, merged),
        "candidates": candidates,
        "speeds": {one.reducer: format_real_time(asdict(one)) for one in candidates},
        "rated": [
            section.make_slug("rated", *key) for key, _ in split(tables["rated"], "scale", "level")
        ],
        "axes": axes,
        "looks": figures.choose_looks(merged),
        "grids": tabulate(tables),
        "data": dump_data(tables, merged, axes),
        "script": (TEMPLATES / "chart.js").read_text(encoding="utf-8"),
        "styles": ("chart.css",),
    }


def list_axes(tables: Tables) -> list[dict[str, Any]]:
    """List the axes that a reader can choose."""
    rated = {_name_rating(row): row["scale"] in APART for row in list_records(tables["rated"])}
    rows = [
        ("cost", "Cost of one sample (ns)", "speed", "low"),
        ("real_time", f"Speed (× real time, {KHZ} unless named)", "speed", "high"),
        ("latency", "Algorithmic latency (ms)", "speed", "low"),
        *((name, figures.describe_measure(name), "accuracy", "high") for name in MEASURES),
        ("stability", "Perturbation gain (1: sensor noise passes as it is)", "stability", "low"),
        *((name, name, "rating", "low" if apart else "high") for name, apart in rated.items()),
    ]
    keys = ("key", "label", "kind", "better")
    return [
        {**dict(zip(keys, row, strict=True)), "log": row[2] in {"speed", "stability"}}
        for row in rows
    ]


def dump_data(tables: Tables, merged: Tables, axes: Sequence[Mapping[str, Any]]) -> str:
    """Write what the script reads."""
    scenes = tables["scenes"]["name"].tolist()
    methods = list(_list_markers(merged, _list_ratings(tables)))
    return write_script_data({"axes": axes, "scenes": scenes, "methods": methods})


def _list_markers(merged: Tables, ratings: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
    """List the markers that a reader can show: what each is, what it costs, its scores and ratings."""
    looks = figures.choose_looks(merged)
    gains = merged["stability"].set_index(["reducer", "scene"])["gain"].to_dict()
    known = {row["reducer"]: find_latency(row) for row in list_records(merged["points"])}
    latencies = {name: one if math.isfinite(one) else None for name, one in known.items()}
    scores: dict[Any, dict[str, dict[str, list[float]]]] = {}
    for row in list_records(merged["accuracies"]):
        key = row["sweep"], row["method"], row["rate_hz"] if row["sweep"] == "rate" else None
        own = scores.setdefault(key, {}).setdefault(row["scene"], {})
        own[row["measure"]] = [_round(row[name]) for name in ("mean", "sd", "as_mounted")]
    for kind, label, variant, cost, scored in _list_costs(merged, ratings):
        name = name_point(variant.reducer)
        found = {scene: dict(own) for scene, own in scores.get(scored, {}).items()}
        for scene, own in found.items():
            # The gain of other windows was not measured.
            if (name, scene) in gains and kind in {"reducer", "block"}:
                own["stability"] = [_round(gains[name, scene])]
        ours = variant.reducer in REDUCERS
        latency = variant.find_latency(cost["rate_hz"]) if ours else latencies[name]
        if found:
            yield {
                "label": label, "reducer": name, "kind": kind, "member": name_point(label) != label,
                "colour": looks[name].colour, "marker": looks[name].marker,
                "speed": _describe_costs(kind, latency, cost), "scores": found,
                "ratings": ratings.get(label, {}) if kind == "reducer" else {},
            }  # fmt: skip


def _format_known(value: float | None, write: Callable[[float], str]) -> str:
    """Format what is known by definition; a lab need not declare it."""
    if value is None or math.isnan(value):
        return "unknown"
    return write(value) if value else "0"


Marker = tuple[str, str, ReducerVariant, Record, tuple[str, str, float | None]]
"""Kind, label, variant, cost and key of the scores."""


def _list_costs(tables: Tables, ratings: Mapping[str, object]) -> Iterator[Marker]:
    """List the markers; streams score as the whole signal does, a block later."""
    costs = tables["costs"]
    whole = {row["method"]: row for row in list_records(find_reference(costs))}
    swept = {(row["sweep"], row["method"]): row for row in list_records(costs)}
    own = [row["reducer"] for row in whole.values() if row["reducer"] not in REDUCERS]
    for label in dict.fromkeys(map(name_point, (*REDUCERS, *own))):
        yield "reducer", label, _first(label), whole[label], ("reducer", label, None)
    for kind in ("window", "hop"):
        for variant in list_variants(kind):
            key = kind, variant.label
            yield *key, variant, swept[key], (*key, None)
    for member in ratings:  # those that were rated stand beside their point
        if (label := name_point(member)) != member and label in whole:
            yield "reducer", member, ReducerVariant(member), whole[label], ("reducer", label, None)
    for row in list_records(costs[costs["sweep"].isin(["rate", "block"])]):
        name, rate_hz = row["method"], row["rate_hz"]
        if row["sweep"] == "rate":
            label = f"{name}, {rate_hz / 1000:g} kHz"
            yield "rate", label, _first(name), row, ("rate", name, rate_hz)
        else:
            label = f"{name}, blocks of {row['block']}"
            yield "block", label, _first(name), row, ("reducer", name, None)


def _first(label: str) -> ReducerVariant:
    """Find the reducer, of a group the first, that a point stands for."""
    return ReducerVariant(GROUPS.get(label, (label,))[0])


def _describe_costs(
    kind: str, latency: float | None, cost: Record
) -> dict[str, list[float | None]]:
    rate_hz = cost["rate_hz"]
    waiting_s = (cost["block"] - 1) / rate_hz if kind == "block" else 0.0
    return {
        "cost": [_round(cost[name]) for name in ("ns_per_sample", "low", "high")],
        "real_time": [
            _round(NS / rate_hz / cost[name]) for name in ("ns_per_sample", "high", "low")
        ],
        "latency": [None if latency is None else _round(1000 * (latency + waiting_s)), None, None],
    }


def _list_ratings(tables: Tables) -> dict[str, dict[str, list[float | None]]]:
    found: dict[str, dict[str, list[float | None]]] = {}
    for row in list_records(tables["rated"]):
        values = [row[name] for name in ("mean", "low", "high", "two_way_low", "two_way_high")]
        shown = [None if math.isnan(value) else _round(value) for value in values]
        found.setdefault(row["reducer"], {})[_name_rating(row)] = shown
    return found


def _name_rating(row: Record) -> str:
    return (
        f"Mean {words.format_measure(row['scale'])}, {words.format_name(row['level'])} (0 to 100)"
    )


def _round(value: float) -> float:
    return float(f"{value:.{PLACES}g}")
