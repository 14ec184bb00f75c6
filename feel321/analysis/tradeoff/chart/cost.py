"""Cost of every reducer: time, its growth with length, memory, precision, and what a stream needs while it runs.

Everything is timed in turn, in one run, by a clock that is passed in. The signals are white noise: no spectral line of
theirs vanishes, and no method knows them. n is in samples per axis, times are in s. A plain line through log t against
log n would take the overhead of short calls for slow growth; here it is a parameter of its own.

Reducers compute in float64 whatever they are given, as a host computer may; a small processor would not. What they lose
in 32-bit arithmetic is measured on private copies of their modules, whose numpy gives results that are all 32 bits
wide; the reducers themselves are left alone.

Streams are timed in the blocks of a sound card: 64 samples at 48 kHz, every 1.33 ms. The work of a window is not spread
over its blocks: the block that completes half a window does it all, so the worst time, not the mean, must keep the
deadline.
"""

from __future__ import annotations

import math
import time
import tracemalloc
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, partial
from importlib.util import find_spec, module_from_spec
from types import ModuleType
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from feel321.analysis.tradeoff.advise.measures import find_complexity
from feel321.analysis.tradeoff.chart.accuracy import ReducerVariant, list_variants
from feel321.analysis.tradeoff.chart.points import TABLES, split
from feel321.analysis.tradeoff.stress.battery import take_excerpt
from feel321.analysis.tradeoff.stress.measures import perturbation_gain
from feel321.stimuli import recording
from feel321.stimuli.reducers import axes, bands, fourier
from feel321.stimuli.reducers.axes import DEFAULT_WINDOW_S, window_samples
from feel321.stimuli.reducers.registry import REDUCERS, WHY_NOT_STREAMING
from feel321.types import Samples

if TYPE_CHECKING:
    from pandas import DataFrame

    from feel321.stimuli.guard import OwnReducer
    from feel321.stimuli.recording import Recording

    Clock = Callable[[], float]
    Row = dict[str, Any]

RATE_HZ, NS = 10_000.0, 1e9
REFERENCE_N = 100_000
"""10 s at 10 kHz, a recording of the Penn Haptic Texture Toolkit: the length at which methods are compared."""

BLOCKS = (1, 4, 16, 64, 256, 1024)
RATES_HZ = (1000.0, 2000.0, 5000.0, 10_000.0, 26_000.0)
RATE_DURATION_S = 4.0
CALLS, FRAMES = 200, 8
"""What a stream is timed over at least: blocks, and half windows, whose work comes all at once."""

CARD_HZ, CARD_BLOCK = 48_000.0, 64
BLOCKS_PER_ROUND = 200
WARM_UP = 60
"""Blocks before times are taken: two windows and more."""

FEWEST_ROUNDS = 3
"""Quartiles of fewer are the values themselves."""

FINE_S = 1e-6
"""A clock that moves in longer steps cannot time a short call."""

PARAMETERS, STEEPEST = 3, 4.0
"""Of the model of growth: number of parameters, and the largest exponent."""

NUMBER_BYTES, NOISES = 8, 4
STRONGEST_S = 1.0
"""Longest part of a scene whose stability is measured."""


def choose_clock() -> tuple[str, Clock]:
    """Choose the clock that other programs disturb least."""
    fine = time.get_clock_info("thread_time").resolution < FINE_S
    return ("thread_time", time.thread_time) if fine else ("perf_counter", time.perf_counter)


def time_in_turn(
    tasks: Sequence[Callable[[], object]],
    *,
    rounds: int,
    clock: Clock,
    rng: np.random.Generator,
    done: Callable[[], None] = lambda: None,
) -> Samples:
    """Time every task once per round, in a new order each round: (rounds, n_tasks).

    A machine that slows down for a while slows all tasks alike, and none always runs behind the same other one. One
    round goes before, unmeasured, so that caches and plans are warm.
    """
    if rounds < FEWEST_ROUNDS:
        raise ValueError(
            f"rounds must be {FEWEST_ROUNDS} or more, got {rounds}: quartiles need them"
        )
    seconds = np.empty((rounds + 1, len(tasks)))
    for number in range(rounds + 1):
        for which in rng.permutation(len(tasks)):
            begun = clock()
            tasks[which]()
            seconds[number, which] = clock() - begun
        done()
    return seconds[1:]


def fit_growth(n_samples: ArrayLike, seconds: ArrayLike, *, reducer: str) -> Row:
    r"""Fit :math:`t = c + b\, n^p` to the times, (k,), of at least three different lengths, (k,).

    Notes
    -----
    Least squares of :math:`\log t`, so that every length counts alike. The interval is Student's, from the deviations
    of the k medians from the fit with k - 3 degrees of freedom: it holds what the model does not know, such as caches
    that are full at some length, and not only the clock's noise.
    """
    from scipy.optimize import least_squares
    from scipy.stats import t as student

    n, t = np.asarray(n_samples, dtype=np.float64), np.asarray(seconds, dtype=np.float64)
    if len(set(n.tolist())) < PARAMETERS or n.shape != t.shape:
        raise ValueError(
            f"n_samples must be {PARAMETERS} or more different lengths, each with its time, got {len(n)} and {len(t)}"
        )
    if not (np.all(t > 0) and np.all(np.isfinite(t))):
        raise ValueError(
            f"seconds must be above 0 and finite, got {t.min():g} to {t.max():g}; take a finer clock, or repeat"
        )
    middle = float(np.exp(np.log(n).mean()))

    def deviations(parameters: Samples) -> Samples:
        overhead, scale, exponent = parameters
        predicted = np.exp(overhead) + np.exp(scale + exponent * np.log(n / middle))
        return np.asarray(np.log(predicted) - np.log(t))

    highest = float(np.log(t.min()))
    begin = [highest - 1, float(np.log(t).mean()), 1.0]
    # An overhead of e^-10 of the shortest call is none; without that bound its logarithm would run away.
    bounds = ([highest - 10, -np.inf, 0.0], [highest + 1e-9, np.inf, STEEPEST])
    fit = least_squares(deviations, begin, bounds=bounds, xtol=1e-12, ftol=1e-12, gtol=1e-12)
    exponent, spare, margin = float(fit.x[2]), len(n) - PARAMETERS, math.nan
    if spare > 0:
        variance = float(fit.fun @ fit.fun) / spare
        jacobian = np.asarray(fit.jac)
        spread = math.sqrt(variance * np.linalg.pinv(jacobian.T @ jacobian)[2, 2])
        margin = float(student.ppf(0.975, spare)) * spread
    return {
        "reducer": reducer, "overhead_us": 1e6 * math.exp(fit.x[0]), "exponent": exponent,
        "low": exponent - margin, "high": exponent + margin,
        "smallest": int(n.min()), "largest": int(n.max()), "misfit": float(np.sqrt(np.mean(fit.fun**2))),
    }  # fmt: skip


def fit_all(costs: DataFrame) -> list[Row]:
    """Fit the growth of every reducer."""
    sizes = costs[costs["sweep"] == "size"]
    return [
        fit_growth(own["n_samples"], own["ns_per_sample"] * own["n_samples"] / NS, reducer=reducer)
        for reducer, own in split(sizes, "reducer")
    ]


@dataclass(frozen=True, slots=True)
class Job:
    """One thing to be timed."""

    sweep: str
    variant: ReducerVariant
    n_samples: int
    rate_hz: float
    block: int
    bits: int
    run: Callable[[], object]


def list_lengths(largest: int) -> tuple[int, ...]:
    """List signal lengths, 1, 2 and 5 times the powers of ten: none is hard to transform.

    Examples
    --------
    >>> list_lengths(10_000)
    (1000, 2000, 5000, 10000)
    """
    lengths = (step * 10**power for power in range(3, 10) for step in (1, 2, 5))
    return tuple(length for length in lengths if length <= largest)


def list_jobs(
    *, largest: int, rng: np.random.Generator, own: Mapping[str, OwnReducer] | None = None
) -> list[Job]:
    """List everything that is timed; own: reducers of a lab, whose guards count little."""
    lengths = sorted({*list_lengths(largest), REFERENCE_N})
    signals = {n: rng.standard_normal((3, n)) for n in lengths}
    usual, every = signals[REFERENCE_N], list_variants(own=own)
    jobs = [_make_whole("size", one, signal) for signal in signals.values() for one in every]
    jobs += [
        _make_whole(sweep, one, usual)
        for sweep in ("window", "hop")
        for one in list_variants(sweep)
    ]
    for rate_hz in RATES_HZ:
        for one in every:
            signal = rng.standard_normal((3, round(RATE_DURATION_S * rate_hz)))
            jobs.append(_make_whole("rate", one, signal, rate_hz=rate_hz))
    for kind in ("f4", "f8"):
        jobs += [_make_whole("bits", one, usual.astype(kind)) for one in every]
    for one in every:
        for block in BLOCKS if one.open_stream(RATE_HZ) else ():
            jobs.append(_make_stream(one, block, rng))
    return jobs


def _make_whole(
    sweep: str, variant: ReducerVariant, signal: Samples, *, rate_hz: float = RATE_HZ
) -> Job:
    n, run = signal.shape[-1], partial(variant.reduce, signal, rate_hz)
    return Job(sweep, variant, n, rate_hz, n, 8 * signal.itemsize, run)


def _make_stream(variant: ReducerVariant, block: int, rng: np.random.Generator) -> Job:
    signal = rng.standard_normal((3, block))
    stream = variant.open_stream(RATE_HZ)
    if stream is None:
        raise ValueError(f"{variant.label} cannot stream")
    step = stream.process
    calls = max(CALLS, FRAMES * window_samples(DEFAULT_WINDOW_S, RATE_HZ) // 2 // block)

    def run() -> None:
        for _ in range(calls):
            step(signal)

    return Job("block", variant, calls * block, RATE_HZ, block, 64, run)


def time_jobs(
    jobs: Sequence[Job],
    *,
    rounds: int,
    clock: Clock,
    rng: np.random.Generator,
    done: Callable[[], None] = lambda: None,
) -> list[Row]:
    """Time jobs in turn: rows of the table "costs"."""
    tasks = [job.run for job in jobs]
    seconds = time_in_turn(tasks, rounds=rounds, clock=clock, rng=rng, done=done)
    quartiles = np.quantile(seconds, (0.5, 0.25, 0.75), axis=0).T.tolist()
    rows = []
    for job, (median, low, high) in zip(jobs, quartiles, strict=True):
        if not low > 0:
            raise ValueError(
                f"clock must show more than 0 s for {job.variant.label}, got {low:g}; take a finer clock"
            )
        per_sample = NS / job.n_samples
        rows.append({
            "sweep": job.sweep, "method": job.variant.label, "reducer": job.variant.reducer,
            "n_samples": job.n_samples, "rate_hz": job.rate_hz, "block": job.block, "bits": job.bits,
            "ns_per_sample": per_sample * median, "low": per_sample * low, "high": per_sample * high,
            "real_time": job.n_samples / job.rate_hz / median, "rounds": rounds,
        })  # fmt: skip
    return rows


def measure_memory(variant: ReducerVariant, n_samples: int, rng: np.random.Generator) -> Row:
    """Measure the most memory that a method holds beside its input."""
    signal = rng.standard_normal((3, n_samples))
    variant.reduce(signal[:, :100], RATE_HZ)  # what is imported at the first call is not the call's
    tracemalloc.start()
    try:
        variant.reduce(signal, RATE_HZ)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    return dict(
        zip(TABLES["memory"], (variant.reducer, n_samples, peak, peak / signal.nbytes), strict=True)
    )


def compare_precision(
    name: str,
    rng: np.random.Generator,
    recordings: Iterable[Recording] = (),
    *,
    own: OwnReducer | None = None,
) -> Row:
    """Measure what 32-bit input changes, and what 32-bit arithmetic loses; the latter not of a lab's own code."""
    signal, reduce = rng.standard_normal((3, REFERENCE_N)), own or REDUCERS[name]
    exact, rough = reduce(signal, RATE_HZ), reduce(signal.astype(np.float32), RATE_HZ)
    change = float(np.sum((rough - exact) ** 2) / np.sum(exact**2))
    loss, worst = measure_loss(name, () if own else recordings)
    return {
        "reducer": name, "output": str(rough.dtype),
        "difference_db": 10 * math.log10(change) if change > 0 else None,
        "arithmetic_db": loss, "worst": worst,
    }  # fmt: skip


def measure_loss(name: str, recordings: Iterable[Recording]) -> tuple[float | None, str]:
    """Measure the energy of the error of 32-bit arithmetic relative to the output in 64 bits, where it is largest."""
    losses = []
    for scene in recordings:
        exact = REDUCERS[name](scene.acceleration, scene.rate_hz)
        error = float(np.sum((reduce_in_32_bit(name, scene) - exact) ** 2))
        if error > 0 and exact.any():
            losses.append((10 * float(np.log10(error / np.sum(exact**2))), scene.name))
    return max(losses, key=lambda one: one[0], default=(None, ""))


def reduce_in_32_bit(name: str, scene: Recording) -> Samples:
    """Reduce a recording, scaled by a power of two, in 32-bit arithmetic."""
    exponent = int(np.frexp(np.abs(scene.acceleration).max(initial=0.0))[1])
    samples = np.ldexp(scene.acceleration, -exponent).astype(np.float32)
    reducer: Any = REDUCERS[name]
    reduced = getattr(_copy_modules()[reducer.__module__], reducer.__name__)(samples, scene.rate_hz)
    if reduced.dtype != np.float32:
        raise TypeError(f"{name}: output must be float32 in 32-bit arithmetic, got {reduced.dtype}")
    return np.asarray(np.ldexp(reduced.astype(np.float64), exponent))


_WIDTHS = {"float64": np.float32, "complex128": np.complex64}
_NARROW = {np.dtype(name): kind for name, kind in _WIDTHS.items()}
_IN_32_BIT: dict[str, Any] = {
    "ROUNDING": 32 * float(np.finfo(np.float32).eps),
    "_CUT": np.complex64(np.exp(1j)),
    "SAFE_PEAK": (1e-9, 1e9),
    "coerce_acceleration": np.asarray,
}
"""What else differs in 32 bits: the threshold of rounding, a constant, the safe range, and the door to float64."""


@cache
def _copy_modules() -> dict[str, ModuleType]:
    """Make private copies of the reducers' modules that compute in 32 bits."""
    copies: dict[str, Any] = {}
    for original in (recording, axes, fourier, bands):
        spec: Any = find_spec(original.__name__)
        copies[spec.name] = module_from_spec(spec)
        spec.loader.exec_module(copies[spec.name])
    for copy in copies.values():
        for name, value in list(vars(copy).items()):
            home = copies.get(getattr(value, "__module__", ""))
            if home is not None and hasattr(home, name):  # imported from another: from its copy
                setattr(copy, name, getattr(home, name))
        known = {name: value for name, value in _IN_32_BIT.items() if hasattr(copy, name)}
        vars(copy).update(known, np=_Numpy32())
    return copies


class _Numpy32:
    """numpy as the copied modules see it: no result is wider than 32 bits per real number."""

    def __getattr__(self, name: str) -> Any:  # noqa: ANN401 - whatever numpy has
        found = _WIDTHS.get(name, getattr(np, name))
        return _Narrowed(found) if callable(found) and not isinstance(found, type) else found


class _Narrowed:
    """A function of numpy with narrowed results."""

    def __init__(self, function: Callable[..., Any]) -> None:
        self._function = function

    def __call__(self, *given: object, **named: object) -> object:
        return _narrow(self._function(*given, **named))

    def __getattr__(self, name: str) -> Any:  # noqa: ANN401 - whatever a function of numpy has
        return _Narrowed(getattr(self._function, name))


def _narrow(result: Any) -> Any:  # noqa: ANN401 - whatever numpy gives
    if isinstance(result, (tuple, list)):
        return type(result)(map(_narrow, result))
    kind = _NARROW.get(result.dtype) if isinstance(result, (np.ndarray, np.generic)) else None
    with np.errstate(over="ignore", invalid="ignore"):  # fresh memory holds anything
        return result if kind is None else result.astype(kind)


def time_blocks(
    name: str, *, rounds: int, clock: Clock, rng: np.random.Generator, own: OwnReducer | None = None
) -> Row:
    """Time a stream block by block: a row of the table "realtime"."""
    stream, out = ReducerVariant(name, own=own).open_stream(CARD_HZ), np.empty(CARD_BLOCK)
    if stream is None:
        raise ValueError(
            f"{name} cannot stream: {WHY_NOT_STREAMING.get(name, 'it has no form for it')}"
        )
    blocks = rng.standard_normal((32, 3, CARD_BLOCK))
    seconds = np.empty(WARM_UP + rounds * BLOCKS_PER_ROUND)
    for number in range(len(seconds)):
        block = blocks[number % len(blocks)]
        begun = clock()
        stream.process(block, out=out)
        seconds[number] = clock() - begun
    median, p99, worst = np.quantile(1e6 * seconds[WARM_UP:], (0.5, 0.99, 1.0)).tolist()
    return {
        "reducer": name, "rate_hz": CARD_HZ, "block": CARD_BLOCK, "blocks": len(seconds) - WARM_UP,
        "median_us": median, "p99_us": p99, "worst_us": worst, "deadline_us": 1e6 * CARD_BLOCK / CARD_HZ,
    }  # fmt: skip


def list_resources(own: Mapping[str, OwnReducer] | None = None) -> Iterator[Row]:
    """List what every reducer holds and does, by its definition; of a lab's own, as declared, NaN where unknown."""
    for name, reducer in {**REDUCERS, **(own or {})}.items():
        cost = find_complexity(name, reducer, n_samples=REFERENCE_N, rate_hz=RATE_HZ)
        held = [math.nan if math.isinf(one) else one for one in (cost.state, cost.operations)]
        row = name, NUMBER_BYTES * held[0], held[1], cost.parameters
        yield dict(zip(TABLES["resources"], row, strict=True))


def measure_stability(
    recordings: Iterable[Recording], *, seed: int, own: Mapping[str, OwnReducer] | None = None
) -> Iterator[Row]:
    """Measure how much every reducer amplifies weak sensor noise, on the strongest second of every scene."""
    for scene in recordings:
        excerpt = take_excerpt(scene, duration_s=STRONGEST_S)
        every = {**REDUCERS, **(own or {})}
        for name, reduce in every.items() if excerpt.acceleration.any() else ():
            rng = np.random.default_rng([seed, *scene.name.encode()])
            gain = perturbation_gain(reduce, excerpt, rng=rng, draws=NOISES)
            row = name, scene.name, gain.median, gain.worst, NOISES
            yield dict(zip(TABLES["stability"], row, strict=True))
