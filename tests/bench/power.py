"""Power three ways: closed form, fast simulation, whole studies: `python tests/bench/power.py [whole] [fast]`.

Three studies of the bundled scenes, planned for simulated observers with small slopes, then the same without any slope
(false positives). Whole studies run through plans, session engine, observers, decoding, `fit_primary` and Holm's
method; the fast simulation and the closed form get the standard deviations of these observers. Then CPU time per study
each way, and the ratio of both.
"""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from feel321.analysis.power.find import find_power
from feel321.jobs import ALONE
from feel321.study.folder import create_study
from feel321.study.power import setup

if TYPE_CHECKING:
    import pandas as pd

SCENES = (
    "bumps",
    "texture_drag",
    "hard_taps",
    "constrained_drag",
    "isotropic_rumble",
    "circular_motion",
)
REDUCERS = ("sax321", "soc321", "mag321", "pca321", "dft321", "pca321_adaptive")
SHOWN = [
    "metric",
    "closed",
    "fast",
    "fast_low",
    "fast_high",
    "whole",
    "whole_low",
    "whole_high",
    "tests",
    "failed",
    "singular",
]
KNOWN = ["metric", "slope", "mean", "closed_width", "fast_width", "whole_width", "fast_coverage", "coverage",
         "coverage_low", "coverage_high"]  # fmt: skip


class Bench(NamedTuple):
    """A study: its sizes, what is rated, and the slope of both metrics in points per +0.1."""

    participants: int
    recordings: int
    reducers: int
    repeats: int
    protocol: str
    points: float

    def write(self) -> str:
        scenes = "".join(
            f'[[recordings]]\nscene = "{one}"\nduration_s = 1.0\n'
            for one in SCENES[: self.recordings]
        )
        return (
            f"{scenes}[stimuli]\nreducers = {list(REDUCERS[: self.reducers])}\nanchors = false\n"
            f'below_threshold = "accept"\n[session]\nprotocols = ["{self.protocol}"]\nrepeats = {self.repeats}\n'
            "[session.rehearsal]\ntraining = 0\npractice = 0\n"
        )


STUDIES = (
    Bench(8, 4, 5, 1, "realism", 1.2), Bench(12, 6, 5, 1, "realism", 0.7), Bench(10, 6, 6, 2, "similarity", 0.5),
)  # fmt: skip


def compare(bench: Bench, *, whole: int, fast: int) -> tuple[pd.DataFrame, float]:
    """Compare the three ways; also the CPU time of a whole study in s."""
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        study = create_study(folder / "study")
        study.settings.write_text(bench.write(), encoding="utf-8")
        effects = dict.fromkeys(("spectral_match_bounded", "temporal_match"), bench.points)
        task = setup.set_up(study, effects=effects)
        sizes = setup.Sizes(studies=fast, whole=whole, seed=11)
        shown = task.design.change(participants=bench.participants)
        how = {"seed": sizes.seed, "workers": ALONE, "keep": folder / "kept"}
        first = time.process_time()
        found = setup.check_whole(task, shown, sizes, how=how, progress=lambda _done, _all: None)
        both = time.process_time() - first
        first = time.process_time()
        find_power(shown, task.truth, studies=fast, seed=1)
        return found, (both - (time.process_time() - first)) / whole


def time_fast(studies: int) -> float:
    """CPU time of a fast study of 20 people x 200 trials, in ms: with slopes and without, so two tables each."""
    with tempfile.TemporaryDirectory() as place:
        study = create_study(Path(place) / "study")
        bench = Bench(20, 6, 5, 4, "realism", 1.0)
        study.settings.write_text(bench.write(), encoding="utf-8")
        task = setup.set_up(study, effects={"temporal_match": 1.0})
        design = task.design.change(participants=20, repeats=200 // len(task.design.items))
        first = time.process_time()
        find_power(design, task.truth, studies=studies, seed=1)
        return 1000 * (time.process_time() - first) / studies


if __name__ == "__main__":
    n_whole = int(sys.argv[1]) if len(sys.argv) > 1 else 200
    n_fast = int(sys.argv[2]) if len(sys.argv) > 2 else 1000
    for one in (*STUDIES, STUDIES[1]._replace(points=0.0)):
        table, each_s = compare(one, whole=n_whole, fast=n_fast)
        print(f"\n{one}, {n_whole} whole studies of {each_s:.2f} s CPU, {n_fast} fast ones")
        print(table[SHOWN].round(3).to_string(index=False))
        print(table[KNOWN].round(3).to_string(index=False), flush=True)
    print(
        f"\nfast, 20 people x 200 trials: {time_fast(200):.1f} ms CPU per study (with and without slopes)"
    )
