"""Reducers and metrics against what no 321 transform in the frequency domain can do without: the *floor*.

The floor is three forward and one inverse real FFT of the same length; of many signals, of as many at a time as stay in
the processor's cache. Times are medians of repeated pairs, the thing and its baseline in turn, in CPU time: a machine
that changes its speed or has other work changes both.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import time
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from figures import Figure
from scipy import fft

from feel321 import stimuli
from feel321.stimuli.reducers.registry import WHY_NOT_STREAMING

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

RATE_HZ = 10_000.0
LENGTHS = (100_000, 99_991, 131_072)
SHORT = 3_000
MANY = 1_000
PAIRS = 21
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


def make_floor(n: int) -> Callable[[], None]:
    """Make the four FFTs of length n."""
    axis = np.random.default_rng(0).standard_normal(n)
    spectrum = fft.rfft(axis)

    def floor() -> None:
        for _ in range(max(1, 30_000 // n)):
            for _ in range(3):
                fft.rfft(axis)
            fft.irfft(spectrum, n)

    return floor


def make_many_floor(samples: np.ndarray) -> Callable[[], None]:
    """Make the four FFTs of many signals, (k, 3, n), so many at a time as the cache holds."""
    k, _, n = samples.shape
    spectra, step = fft.rfft(samples[:, 0]), max(1, 24_576 // n)

    def floor() -> None:
        for start in range(0, k, step):
            fft.rfft(samples[start : start + step])
            fft.irfft(spectra[start : start + step], n)

    return floor


def repeat(work: Callable[[], object], n: int) -> Callable[[], None]:
    """Do short work as often as the floor is."""

    def several() -> None:
        for _ in range(max(1, 30_000 // n)):
            work()

    return several


def measure_single() -> Iterator[Figure]:
    """One long recording at a time, with promises; all reducers and short recordings without."""
    for n in LENGTHS:
        a = np.random.default_rng(1).standard_normal((3, n))
        s, floor = REDUCERS["dft321"](a, RATE_HZ), make_floor(n)
        works: dict[str, tuple[float, Callable[[], object]]] = {
            "dft321": (1.5, lambda a=a: REDUCERS["dft321"](a, RATE_HZ)),
            "dft321_windowed": (2.5, lambda a=a: REDUCERS["dft321_windowed"](a, RATE_HZ)),
            "spectral_match": (2.0, lambda a=a, s=s: stimuli.spectral_match(a, s, RATE_HZ)),
            "temporal_match": (2.0, lambda a=a, s=s: stimuli.temporal_match(a, s)),
        }
        for name, (limit, work) in works.items():
            yield Figure(f"{name}, n = {n}", ratio(work, floor), FFTS, limit)
        both = ratio(
            lambda a=a, s=s: stimuli.spectral_match_details(a, s, RATE_HZ),
            works["spectral_match"][1],
        )
        yield Figure(f"both spectral matches, n = {n}", both, "times spectral_match", 1.1)
        for name, plain, limit in (
            ("dft321_principal", "dft321", 1.5),
            ("dft321_principal_windowed", "dft321_windowed", 2.25),
        ):
            got = ratio(lambda a=a, f=REDUCERS[name]: f(a, RATE_HZ), works[plain][1])
            yield Figure(f"{name}, n = {n}", got, f"times {plain}", limit)
    for n, left_out in ((LENGTHS[0], {"dft321", "dft321_windowed"}), (SHORT, set())):
        a = np.random.default_rng(1).standard_normal((3, n))
        for name in [name for name in REDUCERS if name not in left_out]:
            work = repeat(lambda a=a, f=REDUCERS[name]: f(a, RATE_HZ), n)
            what = f"{name}, n = {n}" if n == SHORT else f"{name} alone, n = {n}"
            yield Figure(what, ratio(work, make_floor(n)), FFTS)


def measure_many() -> Iterator[Figure]:
    """A thousand short recordings together, against the FFTs of all, a copy of all, and one by one."""
    a = np.random.default_rng(2).standard_normal((MANY, 3, SHORT))
    floor, few = make_many_floor(a), a[:100]
    what = f"{MANY} x {SHORT}"
    yield Figure(f"reading {what}", ratio(lambda: np.einsum("kin,kin->k", a, a), floor, 5), FFTS)
    for name in REDUCERS:
        work = partial(stimuli.reduce_many, a, name, rate_hz=RATE_HZ)
        limit = {"dft321": 3.0, "sax321": 1.0, "mag321": 1.0}.get(name)
        yield Figure(f"{name}, {what}", ratio(work, floor, 3), FFTS, limit)
        loop = ratio(
            lambda name=name: [stimuli.reduce(one, name, rate_hz=RATE_HZ) for one in few],
            lambda name=name: stimuli.reduce_many(few, name, rate_hz=RATE_HZ),
            5,
        )
        yield Figure(f"{name}, one by one", loop, "times reduce_many", at_least=True)
    reduced, floor = few[:, 0] + few[:, 1], make_many_floor(few)
    for name in stimuli.METRICS:
        work = partial(stimuli.match_many, few, reduced, rate_hz=RATE_HZ, metrics=[name])
        yield Figure(f"{name}, 100 x {SHORT}", ratio(work, floor, 5), FFTS)
    work = partial(stimuli.match_many, few, reduced, rate_hz=RATE_HZ, metrics="all")
    yield Figure(f"all {len(stimuli.METRICS)} metrics, 100 x {SHORT}", ratio(work, floor, 5), FFTS)


def naive_dft321(a: np.ndarray) -> np.ndarray:
    """Equations 3 and 4 as they are written down."""
    spectra = np.fft.rfft(a)
    size = np.sqrt((np.abs(spectra) ** 2).sum(axis=0))
    return np.fft.irfft(size * np.exp(1j * np.angle(spectra.sum(axis=0))), a.shape[-1])


def naive_windowed(a: np.ndarray, length: int = 350) -> np.ndarray:
    """Equations 3 and 4 frame by frame, in a loop."""
    hop, n = length // 2, a.shape[-1]
    window = np.sin(np.pi * np.arange(length) / length)
    padded = np.pad(a, ((0, 0), (hop, length)))
    out = np.zeros(padded.shape[-1])
    for start in range(0, n + hop, hop):
        part = slice(start, start + length)
        out[part] += window * naive_dft321(padded[:, part] * window)
    return out[hop : hop + n]


def naive_pca321(a: np.ndarray) -> np.ndarray:
    """Project on the first singular vector."""
    centred = a - a.mean(axis=1, keepdims=True)
    axis = np.linalg.svd(centred, full_matrices=False)[0][:, 0]
    return axis @ centred * np.sign(axis.sum())


NAIVE = {
    "soc321": lambda a: a[0] + a[1] + a[2],
    "mag321": lambda a: np.sqrt((a**2).sum(axis=0)),
    "pca321": naive_pca321,
    "dft321": naive_dft321,
    "dft321_windowed": naive_windowed,
}


def measure_naive() -> Iterator[Figure]:
    """Against the formula in plain NumPy, which gives the same signal."""
    a = np.random.default_rng(3).standard_normal((3, LENGTHS[0]))
    for name, plain in NAIVE.items():
        np.testing.assert_allclose(REDUCERS[name](a, RATE_HZ), plain(a), atol=1e-9)
        got = ratio(lambda f=REDUCERS[name]: f(a, RATE_HZ), lambda f=plain: f(a), 11)
        yield Figure(f"{name} against NumPy", got, "times the formula in NumPy")


OCTAVE = """
function s = dft321(a)
  A = fft(a, [], 2);
  s = real(ifft(sqrt(sum(abs(A) .^ 2, 1)) .* exp(1i * angle(sum(A, 1)))));
end
function t = spent(f)
  t = zeros(1, 15);
  for k = 1:15, begun = cputime(); f(); f(); f(); t(k) = (cputime() - begun) / 3; end
  t = median(t);
end
a = randn(3, %d);
printf("dft321 %%.9f\\nmag321 %%.9f\\n", spent(@() dft321(a)), spent(@() sqrt(sum(a .^ 2, 1))));
"""


def measure_octave() -> Iterator[Figure]:
    """Against the same formulas in Octave, where it is installed."""
    octave = shutil.which("octave-cli") or shutil.which("octave")
    if octave is None:
        print("Octave is not installed: nothing is compared with it (apt-get install octave)")
        return
    command = [octave, "--quiet", "--no-gui", "--eval", OCTAVE % LENGTHS[0]]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    a = np.random.default_rng(3).standard_normal((3, LENGTHS[0]))
    for name, seconds in re.findall(r"(\w+) ([\d.]+)", done.stdout):
        own = []
        for _ in range(15):
            begun = time.process_time()
            for _ in range(3):
                REDUCERS[name](a, RATE_HZ)
            own.append((time.process_time() - begun) / 3)
        # One after the other, not in turn: other work on the machine may change it, so it is not compared.
        got = float(np.median(own)) / float(seconds)
        yield Figure(f"{name} against Octave", got, "times the formula in Octave", compared=False)


def measure_streams() -> Iterator[Figure]:
    """How much of the time that passes a stream takes, in blocks of 64 samples at 48 kHz."""
    rate_hz, block = 48_000.0, 64
    blocks = np.random.default_rng(4).standard_normal((750, 3, block))
    out = np.empty(block)
    for name in [name for name in REDUCERS if name not in WHY_NOT_STREAMING]:
        stream, shares = stimuli.StreamingReducer(name, rate_hz), []
        for _ in range(3):
            begun = time.process_time()
            for one in blocks:
                stream.process(one, out=out)
            shares.append((time.process_time() - begun) * rate_hz / (len(blocks) * block))
        unit = "of the time that passes"
        yield Figure(f"{name}, stream", float(np.median(shares)), unit, 1.0, compared=False)


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
