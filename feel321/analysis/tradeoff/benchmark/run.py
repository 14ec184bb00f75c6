"""The benchmark run: methods through the battery, timed side by side in one run, a card each."""

from __future__ import annotations

import hashlib
import inspect
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from feel321.analysis.tradeoff.advise.measures import find_complexity
from feel321.analysis.tradeoff.benchmark.battery import make_battery
from feel321.analysis.tradeoff.benchmark.card import Card, make_card, write_card
from feel321.analysis.tradeoff.benchmark.measure import (
    Entrant,
    check_repeats,
    measure_look_ahead,
    measure_recordings,
    measure_stress,
    trim,
)
from feel321.analysis.tradeoff.chart import cost
from feel321.analysis.tradeoff.chart.compute import describe_machine
from feel321.doors import as_path, name_of
from feel321.records import Result
from feel321.stimuli.guard import OwnReducer, find_reducer
from feel321.stimuli.reducers.registry import REDUCERS, WHY_NOT_STREAMING
from feel321.types import PathLike, Reducer, Samples

if TYPE_CHECKING:
    from pandas import DataFrame

    from feel321.analysis.tradeoff.benchmark.battery import Battery
    from feel321.analysis.tradeoff.chart.cost import Clock

ROUNDS = 7
SOFTWARE = ("python", "numpy", "scipy", "feel321")
"""Versions that stand in a card; what else is known of the machine stands beside its times."""


@dataclass(frozen=True, slots=True, repr=False, eq=False)
class Benchmark(Result):
    """Cards of methods.

    Parameters
    ----------
    cards : tuple of Card
        What the battery found, one card per method.
    failures : tuple of str
        Methods without a card, and why, a line each.
    """

    cards: tuple[Card, ...]
    failures: tuple[str, ...] = ()

    def to_frame(self) -> DataFrame:
        """Return the figures of the leaderboard as a table.

        Returns
        -------
        DataFrame
            A row per card.
        """
        import pandas as pd

        from feel321.analysis.tradeoff.benchmark.leaderboard import list_figures

        return pd.DataFrame([list_figures(card) for card in self.cards])

    def write(self, folder: PathLike) -> list[Path]:
        """Write the cards.

        Parameters
        ----------
        folder : str or PathLike
            The folder; a method's former card is replaced.

        Returns
        -------
        list of Path
            A file per card.
        """
        return [write_card(card, as_path(folder, "folder")) for card in self.cards]


def run_benchmark(
    methods: Mapping[str, Reducer],
    *,
    folder: PathLike | None = None,
    clock: Clock | None = None,
    rounds: int = ROUNDS,
    progress: Callable[[int, int], None] = lambda _done, _total: None,
) -> Benchmark:
    """Put methods through the battery; a method that fails costs its own card only."""
    from threadpoolctl import threadpool_limits

    battery, failures = make_battery(folder), []
    measured: dict[str, dict[str, Any]] = {}
    entered = [_enter(given, reduce) for given, reduce in methods.items()]
    _check_names(entered)
    # Wall-clock time: a method may be a program of its own, or use threads.
    timer = time.perf_counter if clock is None else clock
    machine = describe_machine("perf_counter" if clock is None else "given")
    software = {name: machine.pop(name) for name in SOFTWARE}
    with threadpool_limits(limits=1):
        for number, method in enumerate(entered):
            try:
                measured[method.name] = {**_measure(method, battery), "software": software}
            except ValueError as error:  # as `extensions.call` words whatever a lab's code does
                failures.append(f"{method.name}: {error}")
            progress(number + 1, len(entered) + rounds)
        working = [method for method in entered if method.name in measured]
        rows = time_methods(
            working, rounds=rounds, clock=timer,
            done=lambda done: progress(len(entered) + done, len(entered) + rounds),
        )  # fmt: skip
    cards = [
        make_card(measured[method.name], {**row, "machine": machine})
        for method, row in zip(working, rows, strict=True)
    ]
    return Benchmark(tuple(cards), tuple(failures))


def _enter(given: str, reduce: Reducer) -> Entrant:
    """Enter a method under its short name, with what it declares and the digest of its code."""
    name = name_of(given).rpartition(":")[2]
    if reduce in REDUCERS.values():
        facts = find_complexity(name, reduce, n_samples=cost.REFERENCE_N, rate_hz=cost.RATE_HZ)
        latency_s = None if name in WHY_NOT_STREAMING else facts.latency_ms / 1000
        source = Path(inspect.getsourcefile(inspect.unwrap(reduce)) or "").read_bytes()
        digest = hashlib.sha256(source).hexdigest()
        return Entrant(name, reduce, digest, latency_s, facts.operations, facts.state)
    own = reduce if isinstance(reduce, OwnReducer) else find_reducer(reduce, REDUCERS)
    declared = [own.method.find_fact(fact) for fact in ("operations", "state")]
    numbers = [trim(float(v)) if isinstance(v, int | float) else None for v in declared]
    return Entrant(name, own, own.method.sha256, own.find_latency(cost.RATE_HZ), *numbers)


def _check_names(methods: Sequence[Entrant]) -> None:
    names = [method.name for method in methods]
    for method in methods:
        known = method.name in REDUCERS and method.reduce is not REDUCERS[method.name]
        if known or names.count(method.name) > 1:
            raise ValueError(
                f"methods must have names of their own, got {method.name!r} twice; rename yours"
            )


def _measure(method: Entrant, battery: Battery) -> dict[str, Any]:
    check_repeats(method, battery.scenes[0])
    return {
        "method": method.declared,
        "battery": battery.describe(),
        "look_ahead_s": trim(measure_look_ahead(method.reduce)),
        "rows": {
            "scenes": measure_recordings(method, battery.scenes, battery.turns),
            "recordings": measure_recordings(method, battery.recordings, battery.turns),
            "stress": measure_stress(method, battery),
        },
    }


def time_methods(
    methods: Sequence[Entrant], *, rounds: int, clock: Clock, done: Callable[[int], None]
) -> Iterator[dict[str, Any]]:
    """Time methods and the transforms that DFT321 cannot do without, in turn, in one run: `times` of their cards."""
    if not methods:
        return
    rng = np.random.default_rng(0)
    signal = rng.standard_normal((3, cost.REFERENCE_N))
    tasks = [partial(transform, signal)]
    tasks += [partial(method.reduce, signal, cost.RATE_HZ) for method in methods]
    rounds_done = iter(range(rounds + 1))
    seconds = cost.time_in_turn(
        tasks, rounds=rounds, clock=clock, rng=rng, done=lambda: done(next(rounds_done))
    )
    floor, per_sample = seconds[:, 0], cost.NS / cost.REFERENCE_N
    for place, method in enumerate(methods, start=1):
        own = seconds[:, place]
        median, low, high = (per_sample * np.quantile(own, (0.5, 0.25, 0.75))).tolist()
        block = None
        if method.reduce in REDUCERS.values() and method.name not in WHY_NOT_STREAMING:
            block = cost.time_blocks(method.name, rounds=2, clock=clock, rng=rng)
            del block["reducer"]
        yield {
            "relative": float(np.median(own / floor)), "ns_per_sample": median, "low": low, "high": high,
            "floor_ns_per_sample": per_sample * float(np.median(floor)), "block": block,
        }  # fmt: skip


def transform(signal: Samples) -> Samples:
    """Do three transforms there and one back: the floor that costs are relative to."""
    from scipy import fft

    spectra = fft.rfft(signal)
    return np.asarray(fft.irfft(spectra[0], signal.shape[-1]))
