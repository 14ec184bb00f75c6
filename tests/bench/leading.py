"""The leading-axis reducers beside dft321 and pca321, scene by scene. Run by hand: `python tests/bench/leading.py`.

Columns: perturbation gain at -60 dB, median and worst of the noises, up to sign; rotation means of `inv` (the
rotation-invariant temporal match), of spectral and of temporal match; time over that of `dft321`, in turn in this run.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from feel321.stimuli.condition import Conditioning, condition
from feel321.stimuli.formats.read import read_recording
from feel321.stimuli.match import spectral_match, temporal_match
from feel321.stimuli.reducers.registry import REDUCERS
from feel321.stimuli.rotation import random_rotations, temporal_match_invariant
from feel321.stimuli.synthesis import SCENES, make_scene

if TYPE_CHECKING:
    from feel321.stimuli.recording import Recording

SHARED = Path(__file__).resolve().parents[3] / "shared" / "recordings"
COMPARED = ("pca321", "dft321", "dft321_principal", "dft321_windowed", "dft321_principal_windowed")
DRAWS, MOUNTINGS, PAIRS, LEVEL = 15, 20, 7, 1e-3


def gains(name: str, recording: Recording) -> tuple[float, float]:
    """Median and worst change of the output over that of the input."""
    acceleration, rate, rng = recording.acceleration, recording.rate_hz, np.random.default_rng(0)
    once, found = REDUCERS[name](acceleration, rate), []
    for _ in range(DRAWS):
        hiss = rng.standard_normal(acceleration.shape)
        hiss *= LEVEL * np.linalg.norm(acceleration) / np.linalg.norm(hiss)
        other = REDUCERS[name](acceleration + hiss, rate)
        away = min(np.linalg.norm(other - once), np.linalg.norm(other + once))
        found.append(away / np.linalg.norm(once) / LEVEL)
    return float(np.median(found)), float(np.max(found))


def matches(name: str, recording: Recording) -> tuple[float, float, float]:
    """Mean over mountings of inv, spectral match and temporal match."""
    rate, found = recording.rate_hz, []
    for turn in random_rotations(MOUNTINGS, np.random.default_rng(1)):
        turned = turn @ recording.acceleration
        reduced = REDUCERS[name](turned, rate)
        spectral = spectral_match(turned, reduced, rate)
        found.append((
            temporal_match_invariant(turned, reduced),
            spectral,
            temporal_match(turned, reduced),
        ))
    inv, spectral, temporal = np.mean(found, axis=0)
    return float(inv), float(spectral), float(temporal)


def cost(name: str, recording: Recording) -> float:
    """Median time over that of dft321, in turn."""
    ratios = []
    for _ in range(PAIRS):
        begun = time.thread_time()
        REDUCERS["dft321"](recording.acceleration, recording.rate_hz)
        between = time.thread_time()
        REDUCERS[name](recording.acceleration, recording.rate_hz)
        ratios.append((time.thread_time() - between) / (between - begun))
    return float(np.median(ratios))


def main() -> int:
    files = [path for path in sorted(SHARED.glob("*")) if path.suffix in {".csv", ".npz", ".wav"}]
    print("gain, worst, inv, spectral, temporal, cost")
    print(f"{'scene':20} l2/l1  {'  '.join(f'{name:>34}' for name in COMPARED)}")
    for made in [*map(make_scene, SCENES), *map(read_recording, files)]:
        recording = condition(made, Conditioning())
        values = np.linalg.eigvalsh(np.cov(recording.acceleration))
        cells = []
        for name in COMPARED:
            (median, worst), (inv, spectral, temporal) = (
                gains(name, recording),
                matches(name, recording),
            )
            spent = cost(name, recording)
            cells.append(
                f"{median:5.1f} {worst:5.1f} {inv:.3f} {spectral:5.2f} {temporal:.3f} {spent:4.2f}"
            )
        print(
            f"{recording.name:20} {values[-2] / values[-1]:5.3f}  {'  '.join(f'{c:>34}' for c in cells)}",
            flush=True,
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
