"""Cost of every reducer: time, its growth with length, and memory.

The signals are white noise: no spectral line of theirs vanishes, and no method knows them.

Conventions: n in samples per axis, times in s. A plain line through log t against log n would take the overhead of
short calls for slow growth; here it is a parameter of its own.

Reducers compute in float64 whatever they are given, as a host computer may; a small processor would not. While
`in_32_bit` lasts, the modules of the reducers see a numpy whose results are all 32 bits wide, and the threshold of
rounding is that of 32 bits. Only the chart uses it: it changes these modules for the whole process, so that nothing
else may reduce at the same time.
"""

from __future__ import annotations

import math
import tracemalloc
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from feel321.analysis.tradeoff.chart.measure import Method, list_hops, list_methods, list_windows
from feel321.analysis.tradeoff.chart.records import Cost, Growth, Memory, Precision, time_in_turn
from feel321.stimuli import recording
from feel321.stimuli.reducers import axes, fourier, matched
from feel321.stimuli.reducers.axes import DEFAULT_WINDOW_S, window_samples
from feel321.stimuli.reducers.registry import WHY_NOT_STREAMING, StreamingReducer

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence
    from types import ModuleType

    from numpy.typing import ArrayLike, NDArray

    from feel321.analysis.tradeoff.chart.records import Clock
    from feel321.stimuli.recording import Recording

    Values = NDArray[np.float64]
    Samples = NDArray[np.float64]

# How the time of one call grows with the length of the signal: a fixed overhead and a power of n.

PARAMETERS = 3
STEEPEST = 4.0


def fit_growth(n_samples: ArrayLike, seconds: ArrayLike, *, reducer: str) -> Growth:
    r"""Fit :math:`t = c + b\, n^p` to measured times.

    n_samples: (k,), lengths, at least three different ones; seconds: (k,).

    Notes
    -----
    Least squares of :math:`\log t`, so that every length counts alike. The interval is Student's, from the deviations
    of the k medians from the fit with k - 3 degrees of freedom: it holds what the model does not know, such as caches
    that are full at some length, and not only the clock's noise.

    Examples
    --------
    >>> n = np.array([1e3, 1e4, 1e5, 1e6])
    >>> round(fit_growth(n, 1e-5 + 2e-9 * n**1.1, reducer="made up").exponent, 6)
    1.1
    """
    from scipy.optimize import least_squares

    n, t = np.asarray(n_samples, dtype=np.float64), np.asarray(seconds, dtype=np.float64)
    if len(set(n.tolist())) < PARAMETERS or n.shape != t.shape:
        raise ValueError(
            f"n_samples: got {len(n)} lengths, allowed is {PARAMETERS} or more, each with its time"
        )
    if not (np.all(t > 0) and np.all(np.isfinite(t))):
        raise ValueError(
            f"seconds: got {t.min():g}, allowed is above 0; take a finer clock, or repeat the call"
        )
    middle = float(np.exp(np.log(n).mean()))

    def deviations(parameters: Values) -> Values:
        overhead, scale, exponent = parameters
        predicted = np.exp(overhead) + np.exp(scale + exponent * np.log(n / middle))
        return np.asarray(np.log(predicted) - np.log(t))

    highest = float(np.log(t.min()))
    begin = [highest - 1, float(np.log(t).mean()), 1.0]
    # An overhead of e^-10 of the shortest call is none; without that bound its logarithm would run away.
    bounds = ([highest - 10, -np.inf, 0.0], [highest + 1e-9, np.inf, STEEPEST])
    fit = least_squares(deviations, begin, bounds=bounds, xtol=1e-12, ftol=1e-12, gtol=1e-12)
    low, high = _bound_exponent(float(fit.x[2]), np.asarray(fit.jac), fit.fun)
    return Growth(
        reducer,
        1e6 * math.exp(fit.x[0]),
        float(fit.x[2]),
        low,
        high,
        int(n.min()),
        int(n.max()),
        float(np.sqrt(np.mean(fit.fun**2))),
    )


def _bound_exponent(
    exponent: float, jacobian: Values, deviations: Values
) -> tuple[float, float] | tuple[None, None]:
    from scipy.stats import t

    spare = len(deviations) - PARAMETERS
    if spare < 1:
        return None, None
    variance = float(deviations @ deviations) / spare
    spread = math.sqrt(variance * np.linalg.pinv(jacobian.T @ jacobian)[2, 2])
    margin = float(t.ppf(0.975, spare)) * spread
    return exponent - margin, exponent + margin


# What reducers lose in 32-bit arithmetic: their own code, with 32-bit samples, coefficients and transforms.

_MODULES = (axes, recording, fourier, axes, fourier, matched, axes, fourier)
_TYPES = {"float64": np.float32, "complex128": np.complex64}
_NARROW = {np.dtype(name): kind for name, kind in _TYPES.items()}
_SAFE_PEAK = (1e-9, 1e9)
_ROUNDING = 32 * float(np.finfo(np.float32).eps)


class _Narrowed:
    """A function of numpy whose results are at most 32 bits wide per real number."""

    def __init__(self, function: Callable[..., Any]) -> None:
        self._function = function

    def __call__(self, *given: object, **named: object) -> object:
        return _narrow(self._function(*given, **named))

    def __getattr__(self, name: str) -> Any:  # noqa: ANN401 - whatever a function of numpy has
        return _Narrowed(getattr(self._function, name))


class _Numpy32:
    """numpy as the modules of the reducers see it in 32 bits."""

    def __getattr__(self, name: str) -> Any:  # noqa: ANN401 - whatever numpy has
        found = _TYPES.get(name, getattr(np, name))
        return _Narrowed(found) if callable(found) and not isinstance(found, type) else found


def measure_loss(method: Method, recordings: Iterable[Recording]) -> tuple[float | None, str]:
    """Measure the energy of the error of 32-bit arithmetic relative to the output in 64 bits."""
    worst: tuple[float | None, str] = (None, "")
    for scene in recordings:
        exact = method.reduce(scene.acceleration, scene.rate_hz)
        error = float(np.sum((reduce_in_32_bit(method, scene) - exact) ** 2))
        if error > 0 and exact.any():
            loss = 10 * float(np.log10(error / np.sum(exact**2)))
            worst = max(
                worst, (loss, scene.name), key=lambda one: -np.inf if one[0] is None else one[0]
            )
    return worst


def reduce_in_32_bit(method: Method, recording: Recording) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Reduce a recording in 32-bit arithmetic.

    Returns (n_samples,).
    """
    exponent = int(np.frexp(np.abs(recording.acceleration).max(initial=0.0))[1])
    samples = np.ldexp(recording.acceleration, -exponent).astype(np.float32)
    with in_32_bit():
        reduced = method.reduce(samples, recording.rate_hz)
    if reduced.dtype != np.float32:
        raise TypeError(
            f"{method.label}: got an output of type {reduced.dtype}, allowed is float32 in 32 bits"
        )
    return np.ldexp(reduced.astype(np.float64), exponent)


@contextmanager
def in_32_bit() -> Iterator[None]:
    """Let all reducers compute in 32 bits; not for use beside other threads."""
    swaps: list[tuple[ModuleType, str, Any]] = [(module, "np", _Numpy32()) for module in _MODULES]
    swaps += [(module, "ROUNDING", _ROUNDING) for module in _MODULES if hasattr(module, "ROUNDING")]
    swaps += [(fourier, "_CUT", np.complex64(np.exp(1j))), (recording, "SAFE_PEAK", _SAFE_PEAK)]
    swaps += [(recording, "coerce_acceleration", np.asarray)]
    before = [(module, name, getattr(module, name)) for module, name, _ in swaps]
    try:
        for module, name, narrow in swaps:
            setattr(module, name, narrow)
        yield
    finally:
        for module, name, usual in before:
            setattr(module, name, usual)


def _narrow(result: Any) -> Any:  # noqa: ANN401 - whatever numpy gives
    if isinstance(result, (tuple, list)):
        return type(result)(map(_narrow, result))
    kind = _NARROW.get(result.dtype) if isinstance(result, (np.ndarray, np.generic)) else None
    with np.errstate(over="ignore", invalid="ignore"):  # fresh memory holds anything
        return result if kind is None else result.astype(kind)


# What methods cost: time per sample by length, window, hop, block, rate and type of the input; memory.

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
    """One thing to be timed."""

    sweep: str
    method: Method
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
    decades = (10**power for power in range(3, 10))
    return tuple(
        length
        for decade in decades
        for length in (decade, 2 * decade, 5 * decade)
        if length <= largest
    )


def list_jobs(*, largest: int, rng: np.random.Generator) -> list[Job]:
    """List everything that is timed."""
    signals = {
        n: rng.standard_normal((3, n)) for n in sorted({*list_lengths(largest), REFERENCE_N})
    }
    usual = signals[REFERENCE_N]
    whole = [
        *(
            ("size", method, signal, RATE_HZ)
            for signal in signals.values()
            for method in list_methods()
        ),
        *(("window", method, usual, RATE_HZ) for method in list_windows()),
        *(("hop", method, usual, RATE_HZ) for method in list_hops()),
        *(
            ("rate", method, rng.standard_normal((3, round(RATE_DURATION_S * rate_hz))), rate_hz)
            for rate_hz in RATES_HZ
            for method in list_methods()
        ),
        *(
            ("bits", method, usual.astype(kind), RATE_HZ)
            for kind in ("f4", "f8")
            for method in list_methods()
        ),
    ]
    return [
        _make_whole(sweep, method, signal, rate_hz=rate_hz)
        for sweep, method, signal, rate_hz in whole
    ] + [
        _make_stream(method, block, rng)
        for method in list_methods()
        for block in BLOCKS
        if _streams(method)
    ]


def time_jobs(
    jobs: Sequence[Job],
    *,
    rounds: int,
    clock: Clock,
    rng: np.random.Generator,
    done: Callable[[], None] | None = None,
) -> list[Cost]:
    """Time jobs in turn."""
    seconds = time_in_turn(
        [job.run for job in jobs], rounds=rounds, clock=clock, rng=rng, done=done
    )
    quartiles = np.quantile(seconds, (0.5, 0.25, 0.75), axis=0).T
    return [
        _make_cost(job, own, rounds=rounds)
        for job, own in zip(jobs, quartiles.tolist(), strict=True)
    ]


def fit_all(costs: Sequence[Cost]) -> list[Growth]:
    """Fit the growth of every reducer."""
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
    """Measure the most memory that a method holds beside its input."""
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
    """Find out what becomes of 32-bit input, and what 32-bit arithmetic loses."""
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
        raise ValueError(
            f"clock: got {low:g} s for {job.method.label}, allowed is above 0; take a finer clock"
        )
    per_sample = NS / job.n_samples
    return Cost(
        job.sweep,
        job.method.label,
        job.method.reducer,
        job.n_samples,
        job.rate_hz,
        job.block,
        job.bits,
        per_sample * median,
        per_sample * low,
        per_sample * high,
        job.n_samples / job.rate_hz / median,
        rounds,
    )
