"""Compute a chart: speed against accuracy of every reducer on the same recordings."""

from __future__ import annotations

import math
import os
import platform
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from functools import partial
from importlib.metadata import version
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from feel321 import __version__
from feel321.analysis.arrays import CONFIDENCE
from feel321.analysis.contrasts.compare import profile_reducers
from feel321.analysis.resampling import draw_counts
from feel321.analysis.table.metrics import order_reducers
from feel321.analysis.table.schema import ROLES
from feel321.analysis.tradeoff.chart import accuracy, cost, page
from feel321.analysis.tradeoff.chart.finding import describe_answers
from feel321.analysis.tradeoff.chart.points import (
    TABLES,
    Tables,
    find_reference,
    list_dominated,
    list_records,
    make_table,
    merge_rows,
    name_point,
    place_points,
)
from feel321.analysis.tradeoff.results import PageParts, PageResult, as_recordings, as_table
from feel321.doors import announce
from feel321.jobs import ALONE, Job, Workers, as_workers, gather_results
from feel321.types import Samples

if TYPE_CHECKING:
    from pandas import DataFrame

    from feel321.analysis.table.items import Table
    from feel321.analysis.tradeoff.chart.cost import Clock
    from feel321.stimuli.guard import OwnReducer
    from feel321.stimuli.recording import Recording

THREADS = 1
"""Of linear algebra while times are taken."""

DRAWS = 2000
KEY = ["scale", "level", "reducer"]


@dataclass(frozen=True, slots=True)
class Effort:
    """How much is measured."""

    name: str
    longest_s: float
    rotations: int
    sweep_rotations: int
    largest_n: int
    rounds: int


QUICK = Effort("quick", 2.0, 64, 12, 10**6, 7)
"""About a minute for six scenes."""

FULL = Effort("full", math.inf, 200, 64, 10**7, 15)
"""Whole recordings, the 200 orientations of `rotation_statistics`, and signals up to 10^7 samples."""


@dataclass(frozen=True, slots=True, repr=False, eq=False)
class Chart(PageResult):
    """Speed against accuracy, measured in one run; every table is a data frame.

    Parameters
    ----------
    machine : dict
        What the times were measured on: processor, clock, versions.
    scenes, points, dominated, accuracies, costs, growth : DataFrame
        The recordings; reducers in the plane of speed and accuracy; reducers that another one beats in every respect;
        accuracies of all methods; times; their growth with length.
    memory, precision, rated, realtime, resources, stability : DataFrame
        Of a call; of 32-bit input and arithmetic; mean ratings; times of streams by block; state and operations of
        every reducer; perturbation gains.
    seed : int
        Of the orientations, signals and bootstrap.
    effort : str
        Name of the effort: quick or full.
    simulated : bool
        Whether ratings come from simulated participants.
    notes : tuple of str
        What was left out or assumed.
    """

    machine: dict[str, Any]
    scenes: DataFrame
    points: DataFrame
    dominated: DataFrame
    accuracies: DataFrame
    costs: DataFrame
    growth: DataFrame
    memory: DataFrame
    precision: DataFrame
    rated: DataFrame
    realtime: DataFrame
    resources: DataFrame
    stability: DataFrame
    seed: int
    effort: str
    simulated: bool
    notes: tuple[str, ...]

    def to_frames(self) -> dict[str, DataFrame]:
        """Return everything that was measured as tables.

        Returns
        -------
        dict of str to DataFrame
            The tables, by the names of the fields.
        """
        return {name: getattr(self, name) for name in TABLES}

    def summary(self) -> str:
        """Write the main results for reading.

        Returns
        -------
        str
            One line for each.
        """
        tables = self.to_frames()
        return "\n".join(describe_answers(tables, merge_equal(tables)))

    def _make_page(self, tables: Mapping[str, DataFrame]) -> PageParts:
        merged = merge_equal(tables)
        pictures, values = page.list_pictures(tables, merged), page.build_page(tables, merged)
        rows = {name: list_records(frame) for name, frame in tables.items()}
        content = {
            field.name: rows.get(field.name, getattr(self, field.name)) for field in fields(self)
        }
        captions = {picture.name: picture.caption for picture in pictures}
        candidates = list(map(asdict, values["candidates"]))
        content |= {
            "headline": values["answers"][0], "answers": values["answers"], "candidates": candidates,
            "figures": captions,
        }  # fmt: skip
        return PageParts("chart.html", content, pictures, {"chart": self, **values})


def compute_chart(  # noqa: PLR0913 - every choice that changes the numbers has a name of its own
    recordings: Recording | Iterable[Recording],
    *,
    ratings: Table | DataFrame | None = None,
    effort: Effort = QUICK,
    seed: int = 0,
    own: Mapping[str, OwnReducer] | None = None,
    clock: Clock | None = None,
    workers: int | Workers = ALONE,
    progress: Callable[[int, int], None] | None = None,
) -> Chart:
    """Measure speed and accuracy of every method; the same seed gives the same accuracies, never the same times.

    own: reducers of a lab; workers: who measures accuracies. Times are taken here, when nothing else runs.
    """
    from threadpoolctl import threadpool_limits

    recordings = as_recordings(recordings, fewest=1)
    rows = None if ratings is None else as_table(ratings).rows
    name, clock = cost.choose_clock() if clock is None else ("given", clock)
    steps, variants = count(1), accuracy.list_variants(own=own)
    show = progress or (lambda _done, _total: None)
    total = 2 * len(recordings) + effort.rounds + 2 + 2 * len(variants)

    def tick() -> None:
        show(next(steps), total)

    # Threads of the linear algebra would be timed with the methods.
    with threadpool_limits(limits=THREADS):
        jobs = list_accuracy_jobs(recordings, effort, own or {}, seed=seed)
        scenes = gather_results(jobs, workers=as_workers(workers), done=tick)
        measured = _measure(recordings, effort, own or {}, seed=seed, clock=clock, tick=tick)
    measured["accuracies"] = [row for rows in scenes for row in rows]
    tables = {name: make_table(name, own) for name, own in measured.items()}
    tables["growth"] = make_table("growth", cost.fit_all(tables["costs"]))
    machine = describe_machine(name)
    notes = page.collect_notes(
        recordings, effort.longest_s, precision=measured["precision"], machine=machine
    )
    return Chart(
        machine=machine,
        **_place(tables, variants),
        rated=make_table("rated", () if rows is None else rate_reducers(rows, seed=seed)),
        seed=seed,
        effort=effort.name,
        simulated=rows is not None and bool(rows["simulated"].any()),
        notes=tuple(notes),
    )


def _measure(
    recordings: Sequence[Recording],
    effort: Effort,
    own: Mapping[str, OwnReducer],
    *,
    seed: int,
    clock: Clock,
    tick: Callable[[], None],
) -> dict[str, list[dict[str, Any]]]:
    """Measure the rows of most tables but accuracies, each with the same seed."""
    announce("speed")
    rng = np.random.default_rng(seed)
    jobs = cost.list_jobs(largest=effort.largest_n, rng=rng, own=own)
    costs = cost.time_jobs(jobs, rounds=effort.rounds, clock=clock, rng=rng, done=tick)
    pieces = [accuracy.cut_piece(recording, effort.longest_s) for recording in recordings]
    lengths = [n for n in cost.list_lengths(effort.largest_n) if str(n).startswith("1")]
    memory, precision, realtime = [], [], []
    for variant in accuracy.list_variants(own=own):
        announce(f"memory and precision of {variant.reducer}")
        memory += [cost.measure_memory(variant, n, np.random.default_rng(seed)) for n in lengths]
        rng = np.random.default_rng(seed)
        precision.append(cost.compare_precision(variant.reducer, rng, pieces, own=variant.own))
        tick()
    for variant in accuracy.list_variants(own=own):
        if variant.open_stream(cost.CARD_HZ) is not None:
            rng = np.random.default_rng(seed)
            how = partial(cost.time_blocks, rounds=effort.rounds, clock=clock, rng=rng)
            realtime.append(how(variant.reducer, own=variant.own))
        tick()
    stability = list(cost.measure_stability(recordings, seed=seed, own=own))
    tick()
    return {
        "scenes": [
            {"name": one.name, "rate_hz": one.rate_hz, "duration_s": one.duration_s,
             "used_s": min(one.duration_s, effort.longest_s), "sha256": one.sha256} for one in recordings
        ],
        "costs": costs, "memory": memory,
        "precision": precision, "realtime": realtime, "resources": list(cost.list_resources(own)),
        "stability": stability,
    }  # fmt: skip


def _place(
    tables: dict[str, DataFrame], variants: Iterable[accuracy.ReducerVariant]
) -> dict[str, DataFrame]:
    """Add the points, and who is dominated, of what was measured."""
    accuracies = tables["accuracies"]
    usual = accuracies[accuracies["sweep"] == "reducer"]
    latencies = {one.reducer: one.find_latency(cost.RATE_HZ) for one in variants}
    points = place_points(usual, find_reference(tables["costs"]), latencies)
    merged = merge_equal({**tables, "points": points})["points"]
    # Equal methods stand or fall together.
    front = merged.set_index(["reducer", "measure"])["on_front"]
    places = zip(points["reducer"].map(name_point), points["measure"], strict=True)
    points["on_front"] = [bool(front[place]) for place in places]
    return {**tables, "points": points, "dominated": list_dominated(merged, merge_rows(usual))}


def merge_equal(tables: Tables) -> dict[str, DataFrame]:
    """Merge the rows of reducers that are equal by construction, for figures and sentences; files keep all names."""
    names = ("accuracies", "costs", "memory", "stability")
    merged = {name: merge_rows(tables[name]) for name in names}
    usual = merged["accuracies"][merged["accuracies"]["sweep"] == "reducer"]
    rows = list_records(tables["points"])
    latencies = {name_point(row["reducer"]): row["latency_s"] for row in rows}
    points = place_points(usual, find_reference(merged["costs"]), latencies)
    growth = make_table("growth", cost.fit_all(merged["costs"]))
    return {**tables, **merged, "points": points, "growth": growth}


def list_accuracy_jobs(
    recordings: Sequence[Recording], effort: Effort, own: Mapping[str, OwnReducer], *, seed: int
) -> Iterator[Job]:
    """List two jobs for every recording: its accuracies as it is, and with other windows, hops and rates."""
    turns = accuracy.draw_turns(effort.rotations, seed)
    for recording in recordings:
        piece = accuracy.cut_piece(recording, effort.longest_s)
        yield _measure_usual, (piece, own), {"turns": turns}
        yield _measure_sweeps, (piece, own), {"turns": turns[: effort.sweep_rotations]}


def _measure_usual(
    piece: Recording, own: Mapping[str, OwnReducer], *, turns: Samples
) -> list[dict[str, Any]]:
    from threadpoolctl import threadpool_limits

    announce(f"accuracy on {piece.name}")
    with threadpool_limits(limits=THREADS):
        return accuracy.measure_accuracy(piece, accuracy.list_variants(own=own), turns=turns)


def _measure_sweeps(
    piece: Recording, own: Mapping[str, OwnReducer], *, turns: Samples
) -> list[dict[str, Any]]:
    from threadpoolctl import threadpool_limits

    every = accuracy.list_variants(own=own)
    tasks = [("window", piece, accuracy.list_variants("window"))]
    tasks += [("hop", piece, accuracy.list_variants("hop"))]
    tasks += [("rate", accuracy.change_rate(piece, rate), every) for rate in cost.RATES_HZ]
    with threadpool_limits(limits=THREADS):
        return [
            row
            for sweep, one, variants in tasks
            for row in accuracy.measure_accuracy(one, variants, turns=turns, sweep=sweep)
        ]


def describe_machine(clock: str, *, cpu_list: Path = Path("/proc/cpuinfo")) -> dict[str, Any]:
    """Describe what times are measured on: without its name a time means nothing."""
    try:
        lines = cpu_list.read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        lines = []
    named = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    processor = next(named, "") or platform.processor() or platform.machine() or "unknown"
    try:
        load = round(os.getloadavg()[0], 2)  # programs that wanted to run in the last minute
    except (AttributeError, OSError):  # not every system counts them
        load = None
    return {
        "processor": processor,
        "system": f"{platform.system()} {platform.release()}",
        "cores": os.cpu_count() or 1,
        "threads": THREADS,
        "load": load,
        "clock": clock,
        "python": platform.python_version(),
        "numpy": version("numpy"),
        "scipy": version("scipy"),
        "feel321": __version__,
    }


def rate_reducers(ratings: DataFrame, *, seed: int, draws: int = DRAWS) -> list[dict[str, Any]]:
    """Average the ratings of every reducer.

    Notes
    -----
    The mean is that of the participants' means. The two-way interval draws participants and recordings with
    replacement, the same draws for all reducers, and takes the 2.5 % and 97.5 % quantiles of the mean.
    """
    tests = ratings[ratings["role"] == ROLES[0]]
    people, scenes = sorted(tests["participant"].unique()), sorted(tests["recording"].unique())
    rng = np.random.default_rng(seed)
    drawn = draw_counts(len(people), draws, rng=rng), draw_counts(len(scenes), draws, rng=rng)
    means = tests.groupby([*KEY, "participant", "recording"], observed=True)["rating"].mean()
    rows = []
    for row in list_records(profile_reducers(tests)):
        key = {name: row[name] for name in KEY}
        table = means.loc[tuple(key.values())].reset_index()
        table = table.pivot_table(index="participant", columns="recording", values="rating")
        table = table.reindex(index=people, columns=scenes)
        low, high = draw_interval(table.to_numpy(np.float64), *drawn)
        # One participant, or participants who all agree, give no t interval.
        ends = {end: row[end] if math.isfinite(row[end]) else math.nan for end in ("low", "high")}
        rows.append({
            **key, "mean": float(row["mean"]), **ends, "two_way_low": low, "two_way_high": high,
            "participants": int(row["n_participants"]), "recordings": int(table.notna().any().sum()),
        })  # fmt: skip
    order = order_reducers(row["reducer"] for row in rows)
    return sorted(rows, key=lambda row: (row["scale"], row["level"], order.index(row["reducer"])))


def draw_interval(
    table: NDArray[np.float64], people: NDArray[np.float64], scenes: NDArray[np.float64]
) -> tuple[float, float]:
    """Find the two-way interval, 95 % of the draws, of the mean of participants' means.

    table: (n_participants, n_recordings), NaN where there is none; people: (draws, n_participants); scenes: (draws,
    n_recordings), how often each was drawn.
    """
    seen = np.isfinite(table)
    sums, counts = scenes @ np.where(seen, table, 0.0).T, scenes @ seen.T.astype(np.float64)
    means = np.divide(sums, counts, out=np.zeros_like(sums), where=counts > 0)
    weights = people * (counts > 0)
    total = weights.sum(axis=1)
    drawn = (weights * means).sum(axis=1)[total > 0] / total[total > 0]
    low, high = np.quantile(drawn, [(1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2])
    return float(low), float(high)
