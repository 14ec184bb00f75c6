"""What a stream needs while it runs: time per block against its deadline, memory, operations; and how steady it is.

Blocks are those of a sound card: 64 samples at 48 kHz, every 1.33 ms. The work of a window is not spread over its
blocks: the block that completes half a window does it all, so the worst time, not the mean, must keep the deadline.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from feel321.analysis.tradeoff.advise.measures import find_cost
from feel321.analysis.tradeoff.chart.measure import list_methods
from feel321.analysis.tradeoff.chart.records import RealTime, Resources, Stability
from feel321.analysis.tradeoff.stress.battery import take_excerpt
from feel321.analysis.tradeoff.stress.measures import perturbation_gain
from feel321.stimuli.reducers.registry import REDUCERS, WHY_NOT_STREAMING, StreamingReducer

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from feel321.analysis.tradeoff.chart.measure import Method
    from feel321.analysis.tradeoff.chart.records import Clock
    from feel321.stimuli.recording import Recording

RATE_HZ, BLOCK = 48_000.0, 64
BLOCKS_PER_ROUND = 200
WARM_UP = 60
"""Blocks before times are taken: two windows and more."""

NUMBER_BYTES = 8
NOISES = 4
STRONGEST_S = 1.0
"""Longest part of a scene whose steadiness is measured."""


def time_blocks(
    method: Method, *, rounds: int, clock: Clock, rng: np.random.Generator
) -> RealTime | None:
    """Time a stream block by block."""
    if method.reducer in WHY_NOT_STREAMING:
        return None
    stream, out = StreamingReducer(method.reducer, RATE_HZ), np.empty(BLOCK)
    blocks = rng.standard_normal((32, 3, BLOCK))
    seconds = np.empty(WARM_UP + rounds * BLOCKS_PER_ROUND)
    for number in range(len(seconds)):
        block = blocks[number % len(blocks)]
        begun = clock()
        stream.process(block, out=out)
        seconds[number] = clock() - begun
    median, p99, worst = np.quantile(1e6 * seconds[WARM_UP:], (0.5, 0.99, 1.0)).tolist()
    return RealTime(
        method.reducer,
        RATE_HZ,
        BLOCK,
        len(seconds) - WARM_UP,
        median,
        p99,
        worst,
        1e6 * BLOCK / RATE_HZ,
    )


def list_resources(n_samples: int, rate_hz: float) -> Iterator[Resources]:
    """List what every reducer holds and does, by its definition."""
    for name, reducer in REDUCERS.items():
        cost = find_cost(name, reducer, n_samples=n_samples, rate_hz=rate_hz)
        yield Resources(name, NUMBER_BYTES * cost.state, cost.operations, cost.parameters)


def measure_stability(recordings: Iterable[Recording], *, seed: int) -> Iterator[Stability]:
    """Measure how much every reducer amplifies weak sensor noise, on the strongest second of every scene."""
    for recording in recordings:
        excerpt = take_excerpt(recording, duration_s=STRONGEST_S)
        if not excerpt.acceleration.any():
            continue
        for method in list_methods():
            rng = np.random.default_rng([seed, *recording.name.encode()])
            gain = perturbation_gain(method.reduce, excerpt, rng=rng, draws=NOISES)
            yield Stability(method.reducer, recording.name, gain.median, gain.worst, NOISES)
