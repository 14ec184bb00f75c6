"""Reducers and metrics against what no 321 transform in the frequency domain can do without: the *floor*.

The floor is three forward real FFTs in one batch and one inverse, of the same length; of many signals, of as many at a
time as stay in the processor's cache. Times are medians of repeated pairs, the thing and its baseline in turn, in CPU
time: a machine that changes its speed or has other work changes both.
"""

from __future__ import annotations

import subprocess
import sys
import time
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from figures import Figure
from scipy import fft

from feel321 import stimuli
from feel321.analysis.tradeoff.cost import Candidate, time_floor, time_stream
from feel321.stimuli.reducers.registry import WHY_NOT_STREAMING

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

RATE_HZ = 10_000.0
LENGTHS = (100_000, 99_991, 131_072)
OTHERS = (3_000, 10_000, 30_000, 300_000, 1_000_000)
SHORT, MANY, PAIRS = 3_000, 1_000, 21
FFTS = "times four FFTs"
REDUCERS = stimuli.REDUCERS


def ratio(work: Callable[[], object], baseline: Callable[[], object], pairs: int = PAIRS) -> float:
    """Median of the time of `work` over that of `baseline`, timed in turn; other processes' time does not count."""
    ratios = []
    for _ in range(pairs + 1):
        begun = time.process_time()
        baseline()
        between = time.process_time()
        work()
        ratios.append((time.process_time() - between) / (between - begun))
    return float(np.median(ratios[1:]))  # the first pair warms caches and plans


def repeat(work: Callable[[], object], n: int) -> Callable[[], None]:
    """Do short work as often as takes about as long as on 30 000 samples."""

    def several() -> None:
        for _ in range(max(1, 30_000 // n)):
            work()

    return several


def make_floor(n: int) -> Callable[[], None]:
    """Make the four FFTs of length n."""
    return repeat(partial(time_floor, np.random.default_rng(0).standard_normal((3, n))), n)


def make_many_floor(samples: np.ndarray) -> Callable[[], None]:
    """Make the four FFTs of many signals, (k, 3, n), so many at a time as the cache holds."""
    k, _, n = samples.shape
    spectra, step = fft.rfft(samples[:, 0]), max(1, 24_576 // n)

    def floor() -> None:
        for start in range(0, k, step):
            fft.rfft(samples[start : start + step])
            fft.irfft(spectra[start : start + step], n)

    return floor


def unchecked_dft321(acceleration: np.ndarray) -> np.ndarray:
    """Equations 3 and 4 in four lines without any check: what SciPy itself can do."""
    spectra = fft.rfft(acceleration)
    merged = spectra.sum(axis=0)
    energy = (spectra.real**2 + spectra.imag**2).sum(axis=0)
    return fft.irfft(merged * (np.sqrt(energy) / np.abs(merged)), acceleration.shape[-1])


def measure_single() -> Iterator[Figure]:
    """One recording at a time: dft321 at all lengths, with promises; all reducers at two."""
    for n in (*OTHERS, *LENGTHS):
        a = np.random.default_rng(1).standard_normal((3, n))
        floor, pairs = make_floor(n), PAIRS if n < max(OTHERS) else 7
        own, plain = (
            repeat(partial(work, a), n)
            for work in (partial(REDUCERS["dft321"], rate_hz=RATE_HZ), unchecked_dft321)
        )
        yield Figure(f"dft321, n = {n}", ratio(own, floor, pairs), FFTS, 1.6)
        yield Figure(f"four unchecked lines of SciPy, n = {n}", ratio(plain, floor, pairs), FFTS)
    for n in LENGTHS:
        a = np.random.default_rng(1).standard_normal((3, n))
        s, floor = REDUCERS["dft321"](a, RATE_HZ), make_floor(n)
        works: dict[str, tuple[float, Callable[[], object]]] = {
            "dft321_windowed": (2.5, lambda a=a: REDUCERS["dft321_windowed"](a, RATE_HZ)),
            "spectral_match": (2.0, lambda a=a, s=s: stimuli.spectral_match(a, s, RATE_HZ)),
            "temporal_match": (2.0, lambda a=a, s=s: stimuli.temporal_match(a, s)),
        }
        for name, (limit, work) in works.items():
            yield Figure(f"{name}, n = {n}", ratio(work, floor), FFTS, limit)
        for name, plain, limit in (
            ("dft321_principal", "dft321", 1.5),
            ("dft321_principal_windowed", "dft321_windowed", 2.25),
        ):
            works = (partial(REDUCERS[one], a, RATE_HZ) for one in (name, plain))
            yield Figure(f"{name}, n = {n}", ratio(*works), f"times {plain}", limit)
    for n in (LENGTHS[0], SHORT):
        a = np.random.default_rng(1).standard_normal((3, n))
        for name in [name for name in REDUCERS if not name.startswith("dft321_w")]:
            work = repeat(partial(REDUCERS[name], a, RATE_HZ), n)
            yield Figure(f"{name} alone, n = {n}", ratio(work, make_floor(n)), FFTS)


def measure_many() -> Iterator[Figure]:
    """A thousand short recordings together, against the FFTs of all, and one by one."""
    a = np.random.default_rng(2).standard_normal((MANY, 3, SHORT))
    floor, few = make_many_floor(a), a[:100]
    for name in REDUCERS:
        work = partial(stimuli.reduce_many, a, name, rate_hz=RATE_HZ)
        limit = {"dft321": 3.0, "sax321": 1.0, "mag321": 1.0}.get(name)
        yield Figure(f"{name}, {MANY} x {SHORT}", ratio(work, floor, 3), FFTS, limit)
        together = partial(stimuli.reduce_many, few, name, rate_hz=RATE_HZ)
        loop = ratio(
            lambda name=name: [stimuli.reduce(one, name, rate_hz=RATE_HZ) for one in few],
            together,
            5,
        )
        yield Figure(f"{name}, one by one", loop, "times reduce_many", at_least=True)


def measure_streams() -> Iterator[Figure]:
    """How much of the time that passes a stream takes, in blocks of 64 samples at 48 kHz: 99 of 100 blocks."""
    rng = np.random.default_rng(4)
    for name in [name for name in REDUCERS if name not in WHY_NOT_STREAMING]:
        times_us = time_stream(Candidate(name, name, REDUCERS[name]), rng)
        share = float(np.quantile(times_us, 0.99)) / (1e6 * 64 / 48_000)
        unit = "of the time of a block, 99th percentile"
        yield Figure(f"{name}, stream", share, unit, 0.5, compared=False)


# Linux keeps the high-water mark of this process alone; getrusage would inherit that of its parent.
MEMORY = """
import re, sys
from pathlib import Path
import numpy as np
from feel321 import stimuli

def high_water_kib():
    return int(re.search(r"VmHWM:\\s+(\\d+)", Path("/proc/self/status").read_text())[1])

reduce = lambda a: (stimuli.reduce_many if a.ndim > 2 else stimuli.reduce)(a, sys.argv[1], rate_hz=10_000)
shape = tuple(map(int, sys.argv[2:]))
reduce(np.ones((*shape[:-1], 100)))
acceleration = np.random.default_rng(0).standard_normal(shape)
before = high_water_kib()
reduce(acceleration)
print(1 + (high_water_kib() - before) * 1024 / acceleration.nbytes)
"""


def measure_memory() -> Iterator[Figure]:
    """The most memory, input included, for ten minutes at 10 kHz, and for a thousand recordings of 6 s."""
    kinds = [(name, (3, 6_000_000), "ten minutes at 10 kHz", 6.0) for name in REDUCERS]
    many = [
        (name, (1_000, 3, 60_000), "1000 x 60000", 1.6)
        for name in ("sax321", "dft321", "dft321_principal_windowed")
    ]
    for name, shape, what, limit in kinds + many:
        command = [sys.executable, "-c", MEMORY, name, *map(str, shape)]
        done = subprocess.run(command, capture_output=True, text=True, check=True)
        unit = "times the input in memory"
        yield Figure(f"{name}, {what}", float(done.stdout), unit, limit)
