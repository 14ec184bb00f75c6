"""Cost of reducers: what each needs by its definition, and its time beside the transforms that none can do without.

Time is given relative to the *floor*: three real FFTs of that length in one batch, and one back. Both are timed in
turn, in one run, in a new order each round; so a machine that slows down for a while slows all of them alike.

Streams are timed in blocks of a sound card: 64 samples at 48 kHz, every 1.33 ms. A window's work is done in the block
that completes half a window, so the 99th percentile, not the mean, must keep the deadline.

A real transform of n samples counts 2.5 n log2(n) operations; an addition, a multiplication, a division and a root one
each. State is the number of values that must be held at once.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from inspect import signature
from math import inf, log2
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from feel321.stimuli.own_methods import OwnReducer, OwnStream
from feel321.stimuli.reducers.axes import DEFAULT_WINDOW_S, window_samples
from feel321.stimuli.reducers.registry import WHY_NOT_STREAMING, StreamingReducer
from feel321.types import Reducer, Samples

if TYPE_CHECKING:
    from feel321.stimuli.recording import Recording

MS_PER_S = 1000.0
CARD_HZ, CARD_BLOCK = 48_000.0, 64
WARM_UP, BLOCKS = 60, 1000  # Blocks of a stream before times are taken, and those that are timed


class Candidate(NamedTuple):
    """A reducer as it is compared: with its usual window or another.

    name: in all tables; base: of the reducer; window_s: of its window, the usual one where it has none.
    """

    name: str
    base: str
    reduce: Reducer
    window_s: float = DEFAULT_WINDOW_S


def list_candidates(
    reducers: Mapping[str, Reducer], *, windows_ms: Sequence[float] = ()
) -> list[Candidate]:
    """List reducers, and those with a window also with other windows."""
    found = []
    for name, reducer in reducers.items():
        found.append(Candidate(name, name, reducer))
        if windows_ms and "window_s" in signature(reducer).parameters:
            others = (one / MS_PER_S for one in windows_ms if one / MS_PER_S != DEFAULT_WINDOW_S)
            for window_s in others:
                label = f"{name}@{MS_PER_S * window_s:g}ms"
                reduce = partial(reducer, window_s=window_s)  # type: ignore[call-arg]  # looked up above
                found.append(Candidate(label, name, reduce, window_s))
    return found


_PROJECTION, _COVARIANCE, _MEAN = 5.0, 12.0, 6.0
_TO_ONE = 11.0
"""Per sample, of three spectra: squared magnitudes and their root, the phase of the sum, and their product."""

_LEADING = 23.0  # Per sample, to find the axis of the motion and take the phase along it

_AXIS_MEMORY = 19
"""Numbers that frames remember of the axis: two covariances of six, two axes, one loudness."""


def _transforms(n: int) -> float:
    return 4 * 2.5 * log2(max(n, 2))  # three axes there, one back


_PCA = _MEAN + _COVARIANCE + _PROJECTION
_FRAMES = _TO_ONE + 4
_WORK: Mapping[str, Callable[[int, int], tuple[float, float]]] = MappingProxyType({
    **{f"sa{axis}321": lambda *_: (0.0, 0.0) for axis in "xyz"},
    "soc321": lambda *_: (0.0, 2.0),
    "mag321": lambda *_: (0.0, 6.0),
    **{f"sa{axis}321_matched": lambda n, _: (n + 2.0, 7.0) for axis in "xyz"},
    **{f"sa{axis}321_matched_running": lambda *_: (2.0, 14.0) for axis in "xyz"},
    "pca321": lambda n, _: (3.0 * n, _PCA),
    "pca321_matched": lambda n, _: (3.0 * n, _PCA + 1),
    "pca321_matched_windowed": lambda _, window: (3.0 * window + 10, _COVARIANCE + 16 + _PROJECTION),
    "pca321_adaptive": lambda _, window: (3.0 * window + 6, 2 * (_MEAN + _COVARIANCE) + 18 + _PROJECTION),
    "dft321": lambda n, _: (4.0 * n, _transforms(n) + _TO_ONE),
    "dft321_principal": lambda n, _: (4.0 * n, _transforms(n) + _TO_ONE + _LEADING),
    "dft321_windowed": lambda _, window: (3.5 * window, 2 * (_transforms(window) + _FRAMES) + 1),
    "dft321_principal_windowed": lambda _, window: (
        3.5 * window + _AXIS_MEMORY, 2 * (_transforms(window) + _FRAMES + _LEADING) + 1),
    "dft321_bands": lambda n, _: (4.0 * n, _transforms(n) + _LEADING + _COVARIANCE + _PROJECTION + 1),
    # Five low-passes of three axes; six bands: 3 differences, 2 sums over axes, 4 squares, 2 sums, 8 for the gain, 2.
    "dft321_filtered": lambda *_: (27.0, 5 * 3 * 3 + 6 * 21.0),
})  # fmt: skip
"""Reducer -> numbers held at once and operations per sample, by lengths of the signal and the window."""


def find_needs(candidate: Candidate, *, n_samples: int, rate_hz: float) -> dict[str, float]:
    """Find what a candidate needs; infinite: the delay where the whole recording is needed, and what is unknown."""
    reducer = candidate.reduce
    if isinstance(reducer, OwnReducer):
        facts = {name: reducer.method.find_fact(name) for name in ("operations", "state")}
        known = {k: float(v) if isinstance(v, int | float) else inf for k, v in facts.items()}
        latency_s = reducer.find_latency(rate_hz)
        latency_ms = inf if latency_s is None else MS_PER_S * latency_s
        return {"parameters": 0, **known, "latency_ms": latency_ms}
    if candidate.base not in _WORK:  # a plain function: nothing is declared
        unknown = dict.fromkeys(("operations", "state", "latency_ms"), inf)
        return {"parameters": 0, **unknown}
    window = window_samples(candidate.window_s, rate_hz)
    state, operations = _WORK[candidate.base](n_samples, window)
    latency_ms = inf
    if candidate.base not in WHY_NOT_STREAMING:
        stream = StreamingReducer(candidate.base, rate_hz, candidate.window_s)
        latency_ms = MS_PER_S * stream.latency_samples / rate_hz
    chosen = [one for one in signature(reducer).parameters.values() if one.kind is one.KEYWORD_ONLY]
    needs = {"parameters": len(chosen), "operations": operations, "state": state}
    return needs | {"latency_ms": latency_ms}


def time_floor(samples: Samples) -> None:
    """Do the least that a transform in the frequency domain must do."""
    from scipy import fft

    fft.irfft(fft.rfft(samples)[0], samples.shape[-1], overwrite_x=True)


def time_reducers(
    candidates: Sequence[Candidate], recording: Recording, *, rounds: int, rng: np.random.Generator
) -> Iterator[tuple[Candidate, list[float]]]:
    """Time reducers on a signal: median and quartiles of the ratio to the floor."""
    samples = recording.acceleration
    tasks: list[Callable[[], object]] = [partial(time_floor, samples)]
    tasks += [partial(one.reduce, samples, recording.rate_hz) for one in candidates]
    clocks = [time.thread_time, *map(_choose_clock, candidates)]
    # The first round, unmeasured, warms caches and plans.
    seconds = np.empty((rounds + 1, len(tasks)))
    for row in seconds:
        for which in rng.permutation(len(tasks)):
            begun = clocks[which]()
            tasks[which]()
            row[which] = clocks[which]() - begun
    floor = float(np.median(seconds[1:, 0]))
    for place, candidate in enumerate(candidates, start=1):
        yield candidate, (np.quantile(seconds[1:, place], (0.5, 0.25, 0.75)) / floor).tolist()


def _choose_clock(candidate: Candidate) -> Callable[[], float]:
    """Count this thread's time, which other programs disturb least; of another program the time that passes."""
    reducer: Any = candidate.reduce
    is_program = isinstance(reducer, OwnReducer) and not reducer.method.is_python
    return time.perf_counter if is_program else time.thread_time


def time_stream(candidate: Candidate, rng: np.random.Generator) -> Samples | None:
    """Time a stream block by block, in µs; None where the reducer has no streaming form."""
    stream: StreamingReducer | OwnStream | None = None
    if isinstance(candidate.reduce, OwnReducer):
        stream = candidate.reduce.open_stream(CARD_HZ)
    elif candidate.base in _WORK and candidate.base not in WHY_NOT_STREAMING:
        stream = StreamingReducer(candidate.base, CARD_HZ, candidate.window_s)
    if stream is None:
        return None
    out = np.empty(CARD_BLOCK)
    blocks = rng.standard_normal((32, 3, CARD_BLOCK))
    seconds = np.empty(WARM_UP + BLOCKS)
    for number in range(len(seconds)):
        begun = time.thread_time()
        stream.process(blocks[number % len(blocks)], out=out)
        seconds[number] = time.thread_time() - begun
    return 1e6 * seconds[WARM_UP:]
