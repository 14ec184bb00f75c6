"""Compute a chart: speed against accuracy of every reducer on the same recordings."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial
from itertools import count
from typing import TYPE_CHECKING, Any

import numpy as np

from feel321.analysis.tradeoff.chart.axes import list_dominated, place_points
from feel321.analysis.tradeoff.chart.records import (
    THREADS,
    Chart,
    Scene,
    choose_clock,
    describe_machine,
    rate_reducers,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from feel321.analysis.table.reading import Table
    from feel321.analysis.tradeoff.chart.records import Accuracy, Clock, Cost, Memory, Precision
    from feel321.stimuli.recording import Recording

    Tick = Callable[[], None]


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


def compute_chart(
    recordings: Sequence[Recording],
    *,
    ratings: Table | None = None,
    effort: Effort = QUICK,
    seed: int = 0,
    clock: Callable[[], float] | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Chart:
    """Measure speed and accuracy of every method.

    Parameters
    ----------
    recordings : sequence of Recording
        The scenes, conditioned, each with a name of its own.
    ratings : Table, optional
        What was rated.
    effort : Effort
        How much is measured.
    seed : int
        The same seed gives the same accuracies; times are never the same twice.
    clock : callable, optional
        Gives seconds; `choose_clock` if left out.
    progress : callable, optional
        Called with the numbers of steps done and to do.

    Returns
    -------
    Chart
        Every figure.

    Raises
    ------
    ValueError
        If there is no recording, two bear one name, or one cannot be compared.

    Examples
    --------
    >>> from feel321.stimuli.synthesis import make_scene
    >>> tiny = Effort("tiny", longest_s=0.1, rotations=2, sweep_rotations=2, largest_n=5000, rounds=3)
    >>> chart = compute_chart([make_scene("bumps", duration_s=0.1)], effort=tiny)
    >>> [point.method for point in chart.points][:3]
    ['sax321', 'say321', 'saz321']
    """
    from threadpoolctl import threadpool_limits

    from feel321.analysis.tradeoff.chart.cost import fit_all
    from feel321.analysis.tradeoff.chart.measure import list_methods
    from feel321.analysis.tradeoff.chart.tables import list_notes

    _require_names(recordings)
    name, clock = choose_clock() if clock is None else ("given", clock)
    tick = _make_tick(
        progress, total=2 * len(recordings) + effort.rounds + 2 + 2 * len(list_methods())
    )
    # Threads of the linear algebra would be timed with the methods.
    with threadpool_limits(limits=THREADS):
        accuracies = _measure_scenes(recordings, effort, seed=seed, tick=tick)
        costs = _time_methods(effort, seed=seed, clock=clock, tick=tick)
        memory, precision = _measure_memory(recordings, effort, seed=seed, tick=tick)
        running = _measure_running(recordings, effort, seed=seed, clock=clock, tick=tick)
    machine = describe_machine(name)
    return Chart(
        machine=machine,
        scenes=tuple(_describe_scene(recording, effort) for recording in recordings),
        **_place_methods(accuracies, costs),
        accuracies=tuple(accuracies),
        costs=tuple(costs),
        growth=tuple(fit_all(costs)),
        memory=tuple(memory),
        precision=tuple(precision),
        rated=() if ratings is None else tuple(rate_reducers(ratings.rows, seed=seed)),
        **running,
        seed=seed,
        effort=effort.name,
        simulated=ratings is not None and bool(ratings.rows["simulated"].any()),
        notes=list_notes(recordings, effort.longest_s, precision=precision, machine=machine),
    )


def _place_methods(accuracies: Sequence[Accuracy], costs: Sequence[Cost]) -> dict[str, Any]:
    """Place every method by cost and accuracy, and list those that another beats in everything."""
    from feel321.analysis.tradeoff.chart.axes import merge_points, merge_rows, name_groups
    from feel321.analysis.tradeoff.chart.cost import RATE_HZ
    from feel321.analysis.tradeoff.chart.measure import list_methods

    usual = [row for row in accuracies if row.sweep == "reducer"]
    points = place_points(list_methods(), usual, list_reference_costs(costs), rate_hz=RATE_HZ)
    together = merge_rows(usual)
    merged = merge_points(points, together)
    return {
        "points": tuple(name_groups(points, merged)),
        "dominated": tuple(list_dominated(merged, together)),
    }


def _make_tick(progress: Callable[[int, int], None] | None, *, total: int) -> Tick:
    steps = count(1)

    def tick() -> None:
        if progress is not None:
            progress(next(steps), total)

    return tick


def list_reference_costs(costs: Sequence[Cost]) -> list[Cost]:
    """List the costs at which methods are compared: whole signals of the reference length."""
    from feel321.analysis.tradeoff.chart.cost import REFERENCE_N

    return [
        cost
        for cost in costs
        if cost.sweep in {"size", "window", "hop"} and cost.n_samples == REFERENCE_N
    ]


def _require_names(recordings: Sequence[Recording]) -> None:
    names = [recording.name for recording in recordings]
    if not names:
        raise ValueError(
            "recordings: got none, allowed is one or more; name some, or add the bundled scenes"
        )
    if len(set(names)) < len(names):
        doubled = next(name for name in names if names.count(name) > 1)
        raise ValueError(
            f"recordings: got {doubled!r} twice, allowed is a name for each; rename one"
        )


def _measure_scenes(
    recordings: Sequence[Recording], effort: Effort, *, seed: int, tick: Tick
) -> list[Accuracy]:
    from feel321.analysis.tradeoff.chart.cost import RATES_HZ
    from feel321.analysis.tradeoff.chart.measure import (
        change_rate,
        cut_piece,
        draw_turns,
        list_hops,
        list_methods,
        list_windows,
        measure_accuracy,
    )

    turns = draw_turns(effort.rotations, seed)
    few = turns[: effort.sweep_rotations]
    found: list[Accuracy] = []
    for recording in recordings:
        piece = cut_piece(recording, effort.longest_s)
        found += measure_accuracy(piece, list_methods(), turns=turns)
        tick()
        found += measure_accuracy(piece, list_windows(), turns=few, sweep="window")
        found += measure_accuracy(piece, list_hops(), turns=few, sweep="hop")
        for rate_hz in RATES_HZ:
            found += measure_accuracy(
                change_rate(piece, rate_hz), list_methods(), turns=few, sweep="rate"
            )
        tick()
    return found


def _time_methods(effort: Effort, *, seed: int, clock: Clock, tick: Tick) -> list[Cost]:
    from feel321.analysis.tradeoff.chart.cost import list_jobs, time_jobs

    rng = np.random.default_rng(seed)
    jobs = list_jobs(largest=effort.largest_n, rng=rng)
    return time_jobs(jobs, rounds=effort.rounds, clock=clock, rng=rng, done=tick)


def _measure_memory(
    recordings: Sequence[Recording], effort: Effort, *, seed: int, tick: Tick
) -> tuple[list[Memory], list[Precision]]:
    from feel321.analysis.tradeoff.chart.cost import compare_precision, list_lengths, measure_memory
    from feel321.analysis.tradeoff.chart.measure import cut_piece, list_methods

    make_rng = partial(np.random.default_rng, seed)
    pieces = [cut_piece(recording, effort.longest_s) for recording in recordings]
    memory, precision = [], []
    for method in list_methods():
        lengths = [n for n in list_lengths(effort.largest_n) if str(n).startswith("1")]
        memory += [measure_memory(method, n, make_rng()) for n in lengths]
        precision.append(compare_precision(method, make_rng(), pieces))
        tick()
    return memory, precision


def _measure_running(
    recordings: Sequence[Recording], effort: Effort, *, seed: int, clock: Clock, tick: Tick
) -> dict[str, Any]:
    """Measure what reducers need while they run: the chart's fields by name."""
    from feel321.analysis.tradeoff.chart.cost import RATE_HZ, REFERENCE_N
    from feel321.analysis.tradeoff.chart.measure import list_methods
    from feel321.analysis.tradeoff.chart.realtime import (
        list_resources,
        measure_stability,
        time_blocks,
    )

    found = []
    for method in list_methods():
        found.append(
            time_blocks(method, rounds=effort.rounds, clock=clock, rng=np.random.default_rng(seed))
        )
        tick()
    stability = tuple(measure_stability(recordings, seed=seed))
    tick()
    return {
        "realtime": tuple(row for row in found if row is not None),
        "resources": tuple(list_resources(REFERENCE_N, RATE_HZ)),
        "stability": stability,
    }


def _describe_scene(recording: Recording, effort: Effort) -> Scene:
    used = min(recording.duration_s, effort.longest_s)
    return Scene(recording.name, recording.rate_hz, recording.duration_s, used, recording.sha256)
