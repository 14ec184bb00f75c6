"""Throughput of `build` and `analyze`, as CPU time against the floor of the FFTs and in s of stimuli."""

from __future__ import annotations

import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from figures import Figure
from signals import make_floor

from feel321 import stimuli

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

SHARED = Path(__file__).resolve().parents[3] / "shared" / "recordings"
PEOPLE, DRAWS = 12, 200


def read_all() -> tuple[list[stimuli.Recording], str]:
    """Read the shared recordings; where they are not, make the bundled scenes."""
    files = [path for path in sorted(SHARED.glob("*")) if path.suffix in {".csv", ".npz", ".wav"}]
    if files:
        return [stimuli.read_recording(path) for path in files], "shared recordings"
    return [stimuli.make_scene(name) for name in stimuli.SCENES], "bundled scenes"


def spend(work: Callable[[], object]) -> float:
    """CPU time of some work in s."""
    begun = time.process_time()
    work()
    return time.process_time() - begun


def measure_build() -> Iterator[Figure]:
    """Build a set of default reducers: against the FFTs of what it reduces, and in s of stimuli."""
    recordings, source = read_all()
    spent, floors, duration_s = [], [], 0.0
    for _ in range(3):
        with tempfile.TemporaryDirectory() as folder:
            begun = time.process_time()
            built = stimuli.build_stimuli(recordings, folder)
            spent.append(time.process_time() - begun)
        floors.append(sum(spend(make_floor(max(one.n_samples, 30_000))) for one in recordings))
        duration_s = sum(one.duration_s for one in built)
    per_stimulus = len(built) / len(recordings)
    got = float(np.median(np.array(spent) / floors)) / per_stimulus
    yield Figure(f"building the {source}, a stimulus", got, "times four FFTs of its recording", 5.0)
    rate = duration_s / float(
        np.median(spent)
    )  # 150 or more on an idle machine, half of it on a busy one
    what, unit = f"building the {source}, throughput", "s of stimuli per core second"
    yield Figure(what, rate, unit, at_least=True, compared=False)


def measure_analyze() -> Iterator[Figure]:
    """Analyze simulated ratings of the bundled scenes."""
    from feel321.study import Study

    with tempfile.TemporaryDirectory() as folder:
        study = Study.create(Path(folder) / "study")
        study.build()
        study.simulate(PEOPLE)
        floor = make_floor(100_000)
        study.analyze(draws=DRAWS)  # loads what it needs
        pairs = [(spend(lambda: [floor() for _ in range(100)]), spend(lambda: study.analyze(draws=DRAWS)))
                 for _ in range(3)]  # fmt: skip
    got = float(np.median([work / base for base, work in pairs])) / 10
    yield Figure(f"analyze, {PEOPLE} people", got, "times 1000 times four FFTs of 100 000 samples")
