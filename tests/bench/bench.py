"""Speed and memory in one table: `make bench`. The exit code is 1 if a promise was broken.

Reducers and metrics are held against what no 321 transform in the frequency domain can do without, the *floor*: three
forward and one inverse real FFT of the same length. Times are medians of repeated pairs, the thing and its baseline in
turn, in CPU time: a machine that changes its speed or has other work changes both.
"""

import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from scipy import fft

from feel321 import stimuli
from feel321.stimuli.reducers.registry import REDUCERS, WHY_NOT_STREAMING
from feel321.study import Study

RATE_HZ = 10_000.0
LENGTHS = (100_000, 99_991)
PAIRS = 21
FFTS = "times four FFTs"

Row = tuple[str, float, str, float | None]
"""What was measured, its value, the unit, and the most that is promised."""


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


def spend(work: Callable[[], object]) -> float:
    """CPU time of some work in s."""
    begun = time.process_time()
    work()
    return time.process_time() - begun


def make_floor(n: int) -> Callable[[], None]:
    """Make the four FFTs of length n."""
    axis = np.random.default_rng(0).standard_normal(n)
    spectrum = fft.rfft(axis)

    def floor() -> None:
        for _ in range(3):
            fft.rfft(axis)
        fft.irfft(spectrum, n)

    return floor


def measure_signals() -> Iterator[Row]:
    """One long recording at a time: the transforms and matches of the papers, with promises; all others without."""
    limits = {"dft321": 1.5, "dft321_windowed": 2.5}
    for n in LENGTHS:
        a = np.random.default_rng(1).standard_normal((3, n))
        s, floor = REDUCERS["dft321"](a, RATE_HZ), make_floor(n)
        for name, reducer in REDUCERS.items():
            got = ratio(lambda a=a, f=reducer: f(a, RATE_HZ), floor)
            yield f"{name}, n = {n}", got, FFTS, limits.get(name)
        got = ratio(lambda a=a, s=s: stimuli.spectral_match(a, s, RATE_HZ), floor)
        yield f"spectral_match, n = {n}", got, FFTS, 2.0
        got = ratio(lambda a=a, s=s: stimuli.temporal_match(a, s), floor)
        yield f"temporal_match, n = {n}", got, FFTS, 2.0


def measure_streams() -> Iterator[Row]:
    """How much of the time that passes a stream takes, in blocks of 64 samples at 48 kHz."""
    rate_hz, block = 48_000.0, 64
    blocks = np.random.default_rng(4).standard_normal((750, 3, block))
    for name in [name for name in REDUCERS if name not in WHY_NOT_STREAMING]:
        stream = stimuli.StreamingReducer(name, rate_hz)
        spent = spend(lambda stream=stream: [stream.process(one) for one in blocks])
        share = spent * rate_hz / (len(blocks) * block)
        yield f"{name}, stream", share, "of the time that passes", 1.0


# Linux keeps the high-water mark of this process alone; getrusage would inherit that of its parent.
MEMORY = """
import re, sys
from pathlib import Path
import numpy as np
from feel321 import stimuli

def high_water_kib():
    return int(re.search(r"VmHWM:\\s+(\\d+)", Path("/proc/self/status").read_text())[1])

stimuli.reduce(np.ones((3, 100)), sys.argv[1], rate_hz=10_000)
acceleration = np.random.default_rng(0).standard_normal((3, 6_000_000))
before = high_water_kib()
stimuli.reduce(acceleration, sys.argv[1], rate_hz=10_000)
print(1 + (high_water_kib() - before) * 1024 / acceleration.nbytes)
"""


def measure_memory() -> Iterator[Row]:
    """The most memory, input included, for ten minutes at 10 kHz."""
    for name in REDUCERS:
        command = [sys.executable, "-c", MEMORY, name]
        done = subprocess.run(command, capture_output=True, text=True, check=True)
        yield f"{name}, ten minutes", float(done.stdout), "times the input in memory", 6.0


def measure_chain() -> Iterator[Row]:
    """Build, simulate and analyze the bundled scenes."""
    with tempfile.TemporaryDirectory() as folder:
        study = Study.create(Path(folder) / "study")
        floor = spend(lambda: [make_floor(100_000)() for _ in range(100)]) / 100
        built = spend(study.build) / len(study.stimuli()) / floor
        yield "building, a stimulus", built, "times four FFTs of 100 000 samples", None
        rated = len(study.simulate(2))
        simulated = spend(lambda: study.simulate(8))
        yield "simulating, a rating", 1e3 * simulated / (3 * rated), "ms", None
        study.analyze(draws=200)  # loads what it needs
        spent = spend(lambda: study.analyze(draws=200))
        yield "analyze, 8 people", spent / floor / 1000, "times 1000 times four FFTs", None


def main() -> int:
    """Measure, and print each figure as it comes."""
    broken = 0
    for part in (measure_signals, measure_streams, measure_memory, measure_chain):
        for what, value, unit, limit in part():
            is_kept = limit is None or value <= limit
            broken += not is_kept
            promise = "" if limit is None else f"promised {limit:g}"
            print(f"{'ok' if is_kept else 'MISS':4} {what:<48} {value:9.3g} {unit}  {promise}")
    return 1 if broken else 0


if __name__ == "__main__":
    sys.exit(main())
