"""What methods cost: time per sample by length, window, hop, block, rate and type of the input; memory.

The signals are white noise: no spectral line of theirs vanishes, and no method knows them.
"""

from __future__ import annotations

import tracemalloc
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from analysis.tradeoff.chart.growth import fit_growth
from analysis.tradeoff.chart.methods import Method, list_hops, list_methods, list_windows
from analysis.tradeoff.chart.narrow import measure_loss
from analysis.tradeoff.chart.records import Cost, Growth, Memory, Precision
from analysis.tradeoff.chart.timing import time_in_turn
from stimuli.frames import DEFAULT_WINDOW_S, window_samples
from stimuli.stream import WHY_NOT_STREAMING, StreamingReducer

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from numpy.typing import NDArray

    from analysis.tradeoff.chart.timing import Clock
    from stimuli.recording import Recording

    Samples = NDArray[np.float64]

RATE_HZ, NS = 10_000.0, 1e9
REFERENCE_N = 100_000
"""10 s at 10 kHz, a recording of the Penn Haptic Texture Toolkit: the length at which methods are compared."""

BLOCKS = (1, 4, 16, 64, 256, 1024)
RATES_HZ = (1000.0, 2000.0, 5000.0, 10_000.0, 26_000.0)
RATE_DURATION_S = 4.0
CALLS, FRAMES = 200, 8
"""What a stream is timed over at least: blocks, and half windows, whose work comes all at once."""


@dataclass(frozen=True, slots=True)
class Job:
    """One thing to be timed.

    Parameters
    ----------
    sweep : str
        One of `SWEEPS`.
    method : Method
        What does the work.
    n_samples : int
        Samples per measurement.
    rate_hz : float
        Their rate.
    block : int
        Samples per call.
    bits : int
        Of the input.
    run : callable
        Does the work once.
    """

    sweep: str
    method: Method
    n_samples: int
    rate_hz: float
    block: int
    bits: int
    run: Callable[[], object]


def list_lengths(largest: int) -> tuple[int, ...]:
    """List signal lengths, 1, 2 and 5 times the powers of ten: none is hard to transform.

    Parameters
    ----------
    largest : int
        The longest.

    Returns
    -------
    tuple of int
        From 1000.

    Examples
    --------
    >>> list_lengths(10_000)
    (1000, 2000, 5000, 10000)
    """
    decades = (10**power for power in range(3, 10))
    return tuple(length for decade in decades for length in (decade, 2 * decade, 5 * decade) if length <= largest)


def list_jobs(*, largest: int, rng: np.random.Generator) -> list[Job]:
    """List everything that is timed.

    Parameters
    ----------
    largest : int
        Longest signal.
    rng : numpy.random.Generator
        Source of the signals.

    Returns
    -------
    list of Job
        By sweep, in the order of `SWEEPS`.
    """
    signals = {n: rng.standard_normal((3, n)) for n in sorted({*list_lengths(largest), REFERENCE_N})}
    usual = signals[REFERENCE_N]
    whole = [
        *(("size", method, signal, RATE_HZ) for signal in signals.values() for method in list_methods()),
        *(("window", method, usual, RATE_HZ) for method in list_windows()),
        *(("hop", method, usual, RATE_HZ) for method in list_hops()),
        *(
            ("rate", method, rng.standard_normal((3, round(RATE_DURATION_S * rate_hz))), rate_hz)
            for rate_hz in RATES_HZ
            for method in list_methods()
        ),
        *(("bits", method, usual.astype(kind), RATE_HZ) for kind in ("f4", "f8") for method in list_methods()),
    ]
    return [_make_whole(sweep, method, signal, rate_hz=rate_hz) for sweep, method, signal, rate_hz in whole] + [
        _make_stream(method, block, rng) for method in list_methods() for block in BLOCKS if _streams(method)
    ]


def time_jobs(
    jobs: Sequence[Job], *, rounds: int, clock: Clock, rng: np.random.Generator, done: Callable[[], None] | None = None
) -> list[Cost]:
    """Time jobs in turn.

    Parameters
    ----------
    jobs : sequence of Job
        What is timed.
    rounds : int
        Measurements of each.
    clock : callable
        Gives seconds.
    rng : numpy.random.Generator
        Source of the orders.
    done : callable, optional
        Called after every round.

    Returns
    -------
    list of Cost
        One per job.

    Raises
    ------
    ValueError
        If there are too few rounds, or the clock does not move.
    """
    seconds = time_in_turn([job.run for job in jobs], rounds=rounds, clock=clock, rng=rng, done=done)
    quartiles = np.quantile(seconds, (0.5, 0.25, 0.75), axis=0).T
    return [_make_cost(job, own, rounds=rounds) for job, own in zip(jobs, quartiles.tolist(), strict=True)]


def fit_all(costs: Sequence[Cost]) -> list[Growth]:
    """Fit the growth of every reducer.

    Parameters
    ----------
    costs : sequence of Cost
        Among them the lengths of each reducer.

    Returns
    -------
    list of Growth
        One per reducer.
    """
    sizes: dict[str, list[Cost]] = {}
    for cost in costs:
        if cost.sweep == "size":
            sizes.setdefault(cost.reducer, []).append(cost)
    return [
        fit_growth(
            [cost.n_samples for cost in own],
            [1e-9 * cost.ns_per_sample * cost.n_samples for cost in own],
            reducer=reducer,
        )
        for reducer, own in sizes.items()
    ]


def measure_memory(method: Method, n_samples: int, rng: np.random.Generator) -> Memory:
    """Measure the most memory that a method holds beside its input.

    Parameters
    ----------
    method : Method
        What works.
    n_samples : int
        Length of the signal.
    rng : numpy.random.Generator
        Source of the signal.

    Returns
    -------
    Memory
        As numpy asks for it; the little that transforms keep inside is not seen.
    """
    signal = rng.standard_normal((3, n_samples))
    method.reduce(signal[:, :100], RATE_HZ)  # what is imported at the first call is not the call's
    tracemalloc.start()
    try:
        method.reduce(signal, RATE_HZ)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    return Memory(method.reducer, n_samples, peak, peak / signal.nbytes)


def compare_precision(
    method: Method, rng: np.random.Generator, recordings: Iterable[Recording] = ()
) -> Precision:
    """Find out what becomes of 32-bit input, and what 32-bit arithmetic loses.

    Parameters
    ----------
    method : Method
        What works.
    rng : numpy.random.Generator
        Source of the signal.
    recordings : iterable of Recording
        What is reduced in 32-bit arithmetic.

    Returns
    -------
    Precision
        Type and change of the output; error of the worst recording.
    """
    signal = rng.standard_normal((3, REFERENCE_N))
    exact, rough = method.reduce(signal, RATE_HZ), method.reduce(signal.astype(np.float32), RATE_HZ)
    change = float(np.sum((rough - exact) ** 2) / np.sum(exact**2))
    change_db = 10 * float(np.log10(change)) if change > 0 else None
    return Precision(method.reducer, str(rough.dtype), change_db, *measure_loss(method, recordings))


def _streams(method: Method) -> bool:
    return method.reducer not in WHY_NOT_STREAMING


def _make_whole(sweep: str, method: Method, signal: Samples, *, rate_hz: float) -> Job:
    n, bits = signal.shape[-1], 8 * signal.itemsize
    return Job(sweep, method, n, rate_hz, n, bits, partial(method.reduce, signal, rate_hz))


def _make_stream(method: Method, block: int, rng: np.random.Generator) -> Job:
    signal = rng.standard_normal((3, block))
    stream = StreamingReducer(method.reducer, RATE_HZ)
    calls = max(CALLS, FRAMES * window_samples(DEFAULT_WINDOW_S, RATE_HZ) // 2 // block)

    def run() -> None:
        for _ in range(calls):
            stream.process(signal)

    return Job("block", method, calls * block, RATE_HZ, block, 64, run)


def _make_cost(job: Job, quartiles: Sequence[float], *, rounds: int) -> Cost:
    median, low, high = quartiles
    if not low > 0:
        raise ValueError(f"clock: got {low:g} s for {job.method.label}, allowed is above 0; take a finer clock")
    per_sample = NS / job.n_samples
    return Cost(
        job.sweep, job.method.label, job.method.reducer, job.n_samples, job.rate_hz, job.block, job.bits,
        per_sample * median, per_sample * low, per_sample * high,
        job.n_samples / job.rate_hz / median, rounds,
    )  # fmt: skip
