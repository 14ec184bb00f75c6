"""Speed and memory of the ground floor, as ratios measured in one run: `make bench`.

Times are medians of repeated pairs, the thing and its baseline in turn, so that a machine that changes its speed
changes both. The baseline ("floor") is what no 321 transform in the frequency domain can do without: three forward and
one inverse real FFT of the same length. Every line says what was promised; the exit code is 1 if a promise was broken.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from scipy import fft

from feel321.stimuli.formats.read import read_recording
from feel321.stimuli.match import spectral_match, spectral_match_details, temporal_match
from feel321.stimuli.reducers.fourier import (
    dft321,
    dft321_principal,
    dft321_principal_windowed,
    dft321_windowed,
)
from feel321.stimuli.reducers.registry import REDUCERS
from feel321.stimuli.sets.build import build_stimuli
from feel321.stimuli.sets.recipe import Recipe
from feel321.stimuli.synthesis import SCENES, make_scene

if TYPE_CHECKING:
    from collections.abc import Callable

    from feel321.stimuli.recording import Recording

RATE_HZ = 10_000.0
LENGTHS = (100_000, 99_991, 131_072)
PAIRS = 21
SHARED = Path(__file__).resolve().parents[3] / "shared" / "recordings"


def ratio_to_floor(work: Callable[[], object], n: int) -> float:
    """Median of the time of `work` over that of the four FFTs of length n, timed in turn."""
    axis = np.random.default_rng(0).standard_normal(n)
    spectrum = fft.rfft(axis)

    def floor() -> None:
        for _ in range(3):
            fft.rfft(axis)
        fft.irfft(spectrum, n)

    return ratio(work, floor)


def ratio(work: Callable[[], object], baseline: Callable[[], object]) -> float:
    """Median of the time of `work` over that of `baseline`, timed in turn; other processes' time does not count."""
    ratios = []
    for _ in range(PAIRS + 1):
        begun = time.process_time()
        baseline()
        between = time.process_time()
        work()
        ratios.append((time.process_time() - between) / (between - begun))
    return float(np.median(ratios[1:]))  # the first pair warms caches and plans


def report(what: str, got: float, promised: str, *, kept: bool) -> bool:
    print(f"{'ok  ' if kept else 'MISS'} {what:<46} {got:8.2f}   {promised}")
    return kept


def bench_ratios() -> bool:
    kept = True
    for n in LENGTHS:
        acceleration = np.random.default_rng(1).standard_normal((3, n))
        reduced = dft321(acceleration, RATE_HZ)
        for what, limit, work in (
            ("dft321", 1.5, lambda a=acceleration: dft321(a, RATE_HZ)),
            ("dft321_windowed", 2.5, lambda a=acceleration: dft321_windowed(a, RATE_HZ)),
            (
                "spectral_match",
                2.0,
                lambda a=acceleration, s=reduced: spectral_match(a, s, RATE_HZ),
            ),
            ("temporal_match", 2.0, lambda a=acceleration, s=reduced: temporal_match(a, s)),
        ):
            got = ratio_to_floor(work, n)
            kept &= report(
                f"{what}, n = {n}", got, f"times four FFTs, at most {limit}", kept=got <= limit
            )
        got = ratio(
            lambda a=acceleration, s=reduced: spectral_match_details(a, s, RATE_HZ),
            lambda a=acceleration, s=reduced: spectral_match(a, s, RATE_HZ),
        )
        what = f"both spectral matches, n = {n}"
        kept &= report(what, got, "times spectral_match, at most 1.1", kept=got <= 1.1)
        for principal, plain, limit in (
            (dft321_principal, dft321, 1.5),
            (dft321_principal_windowed, dft321_windowed, 2.25),
        ):
            got = ratio(
                lambda a=acceleration, f=principal: f(a, RATE_HZ),
                lambda a=acceleration, f=plain: f(a, RATE_HZ),
            )
            what, promised = (
                f"{principal.__name__}, n = {n}",
                f"times {plain.__name__}, at most {limit}",
            )
            kept &= report(what, got, promised, kept=got <= limit)
    for name in set(REDUCERS) - {"dft321", "dft321_windowed"}:
        acceleration = np.random.default_rng(1).standard_normal((3, LENGTHS[0]))
        got = ratio_to_floor(lambda a=acceleration, f=REDUCERS[name]: f(a, RATE_HZ), LENGTHS[0])
        report(f"{name}, n = {LENGTHS[0]}", got, "times four FFTs", kept=True)
    return kept


def bench_build() -> bool:
    files = [path for path in sorted(SHARED.glob("*")) if path.suffix in {".csv", ".npz", ".wav"}]
    recordings: list[Recording] = [read_recording(path) for path in files] or [
        make_scene(name) for name in SCENES
    ]
    source = "shared recordings" if files else "bundled scenes (NO shared recordings here)"
    factors = []
    for _ in range(5):
        with tempfile.TemporaryDirectory() as folder:
            begun = time.process_time()
            built = build_stimuli(recordings, folder, recipe=Recipe())
            spent = time.process_time() - begun
        factors.append(sum(stimulus.duration_s for stimulus in built.stimuli) / spent)
    got = float(np.median(factors))
    return report(
        f"building the {source}", got, "s of stimuli per core second, at least 150", kept=got >= 150
    )


# Linux keeps the high-water mark of this process alone; getrusage would inherit that of its parent.
MEMORY = """
import re, sys
from pathlib import Path
import numpy as np
from feel321.stimuli.reducers.registry import REDUCERS

def high_water_kib():
    return int(re.search(r"VmHWM:\\s+(\\d+)", Path("/proc/self/status").read_text())[1])

REDUCERS[sys.argv[1]](np.ones((3, 100)), 10_000.0)
acceleration = np.random.default_rng(0).standard_normal((3, 6_000_000))
before = high_water_kib()
REDUCERS[sys.argv[1]](acceleration, 10_000.0)
print(1 + (high_water_kib() - before) * 1024 / acceleration.nbytes)
"""


def bench_memory() -> bool:
    kept = True
    for name in REDUCERS:
        done = subprocess.run(
            [sys.executable, "-c", MEMORY, name], capture_output=True, text=True, check=True
        )
        got = float(done.stdout)
        kept &= report(
            f"{name}, 10 minutes at 10 kHz",
            got,
            "times the input in memory, at most 6",
            kept=got <= 6,
        )
    return kept


def main() -> int:
    print(
        f"Python {sys.version.split()[0]}, numpy {np.__version__}, {os.cpu_count()} processors, {PAIRS} pairs"
    )
    kept = [bench_ratios(), bench_build(), bench_memory()]
    return 0 if all(kept) else 1


if __name__ == "__main__":
    sys.exit(main())
