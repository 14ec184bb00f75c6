"""CPU time and memory of `feel321 analyze`: `python tests/bench/analyze.py [people] [recordings] [reducers] [repeats]`.

Writes ratings of realism and similarity, with planted effects and fixed seeds, and the manifest of their stimuli, runs
the verb on them in a process of its own, and prints what that took. `--each N` lets every person rate N recordings
only, as in a corpus; `--keep DIR` keeps tables and report; `--profile` lists the functions that take most time;
`--scale` measures 10, 40 and 100 people. Ratios between such figures are of use, the seconds are those of one machine.
"""

from __future__ import annotations

import argparse
import cProfile
import os
import pstats
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import pandas as pd

REDUCERS = (
    "sax321",
    "soc321",
    "mag321",
    "pca321",
    "pca321_adaptive",
    "dft321",
    "dft321_windowed",
    "say321",
    "saz321",
)
SLOPES = {"realism": (20.0, 15.0), "similarity": (30.0, 5.0)}
"""Points per unit of both metrics."""
MEBIBYTE = 2**20


def make_manifest(recordings: int, reducers: int, rng: np.random.Generator) -> pd.DataFrame:
    """One row per stimulus; metrics differ mostly between reducers."""
    scene, kind = (axis.ravel() for axis in np.indices((recordings, reducers)))

    def draw(low: float, high: float) -> np.ndarray:
        own = rng.normal(0, 0.08, len(scene)) + rng.normal(0, 0.05, recordings)[scene]
        return np.clip(np.linspace(low, high, reducers)[kind] + own, 0, 1).round(6)

    bounded, temporal = draw(0.5, 0.9), draw(0.9, 0.4)
    names = [f"scene{one:05d}" for one in scene]
    return pd.DataFrame({
        "stimulus_id": [f"{name}_{REDUCERS[one]}" for name, one in zip(names, kind, strict=True)],
        "recording": names, "reducer": [REDUCERS[one] for one in kind], "level": "as_is", "role": "test",
        "rms_m_s2": rng.uniform(0.5, 3, len(scene)).round(6),
        "spectral_match": (bounded - rng.exponential(0.05, len(scene))).round(6), "temporal_match": temporal,
        "spectral_match_bounded": bounded,
    })  # fmt: skip


def rate(
    manifest: pd.DataFrame, *, people: int, repeats: int, each: int, rng: np.random.Generator
) -> pd.DataFrame:
    """One row per judgement, with spreads of people, their slopes, recordings, reducers and stimuli."""
    scene, kind = (manifest[name].factorize()[0] for name in ("recording", "reducer"))
    used = manifest[["spectral_match_bounded", "temporal_match"]]
    within = (used - used.groupby(manifest["recording"]).transform("mean")).to_numpy()
    scenes, n = int(scene.max()) + 1, len(manifest)
    parts = []
    for scale, slopes in SLOPES.items():
        shared = 50 + within @ np.array(slopes) + rng.normal(0, 3, n)
        shared += rng.normal(0, 5, scenes)[scene] + rng.normal(0, 3, int(kind.max()) + 1)[kind]
        for person in range(people):
            seen = (
                np.isin(scene, rng.choice(scenes, each, replace=False))
                if each < scenes
                else np.full(n, True)
            )
            order = np.concatenate([rng.permutation(np.flatnonzero(seen)) for _ in range(repeats)])
            own = rng.normal(0, 8) + within @ rng.normal(0, 10, 2) + rng.normal(0, 3, scenes)[scene]
            ratings = np.clip((shared + own)[order] + rng.normal(0, 10, len(order)), 0, 100).round(
                1
            )
            parts.append(pd.DataFrame({
                "participant": f"p{person:04d}", "session": 1, "protocol": scale, "block": 1,
                "trial": np.arange(1, len(order) + 1), "repeat": 1 + np.arange(len(order)) * repeats // len(order),
                **{name: manifest[name].to_numpy()[order] for name in ("stimulus_id", "recording", "reducer", "level")},
                "reference_id": "", "scale": scale, "rating": ratings,
                "response_time_s": rng.lognormal(0.5, 0.4, len(order)).round(3), "underruns": 0, "rejected": "false",
                "simulated": "true",
            }))  # fmt: skip
    return pd.concat(parts, ignore_index=True)


def write_study(folder: Path, sizes: argparse.Namespace) -> list[str]:
    """Write both tables; returns the arguments of the verb."""
    rng = np.random.default_rng([318, sizes.people, sizes.recordings])
    manifest = make_manifest(sizes.recordings, sizes.reducers, rng)
    each = sizes.each or sizes.recordings
    ratings = rate(manifest, people=sizes.people, repeats=sizes.repeats, each=each, rng=rng)
    paths = folder / "ratings.csv", folder / "manifest.csv"
    for table, path in zip((ratings, manifest), paths, strict=True):
        table.to_csv(path, index=False)
    return [
        "analyze",
        "--ratings",
        str(paths[0]),
        "--manifest",
        str(paths[1]),
        "--out",
        str(folder / "report"),
    ]


def measure(sizes: argparse.Namespace, folder: Path) -> tuple[float, float, float]:
    """Wall time, CPU time (s) and largest memory (MiB) of the verb, in a process of its own."""
    arguments = write_study(folder, sizes)
    start = time.perf_counter()
    child = subprocess.Popen([Path(sys.executable).with_name("feel321"), *arguments, *sizes.more])
    _, status, used = os.wait4(child.pid, 0)
    if status:
        sys.exit(f"analyze ended with status {status}")
    return (
        time.perf_counter() - start,
        used.ru_utime + used.ru_stime,
        used.ru_maxrss * 1024 / MEBIBYTE,
    )


def profile(sizes: argparse.Namespace, folder: Path) -> None:
    """List what takes most time, in this process."""
    from feel321.study.cli import main

    arguments, watch = write_study(folder, sizes), cProfile.Profile(time.process_time)
    watch.enable()
    main([*arguments, *sizes.more])
    watch.disable()
    watch.dump_stats(folder / "profile")
    print("MiB at most:", resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / MEBIBYTE)
    for key in ("tottime", "cumulative"):
        pstats.Stats(watch).strip_dirs().sort_stats(key).print_stats(45)


def main_bench() -> None:
    """Read the sizes, and measure."""
    parser = argparse.ArgumentParser(description=__doc__)
    for name, default in {"people": 100, "recordings": 50, "reducers": 6, "repeats": 1}.items():
        parser.add_argument(name, type=int, nargs="?", default=default)
    parser.add_argument("--each", type=int, default=0)
    parser.add_argument("--keep", type=Path)
    parser.add_argument("--profile", action="store_true")
    parser.add_argument("--scale", action="store_true")
    sizes, sizes.more = parser.parse_known_args()
    with tempfile.TemporaryDirectory() as scratch:
        folder = sizes.keep or Path(scratch)
        folder.mkdir(parents=True, exist_ok=True)
        if sizes.profile:
            return profile(sizes, folder)
        print("people recordings reducers repeats: wall s, CPU s, MiB; CPU over that of the first")
        first = 0.0
        for people in (10, 40, 100) if sizes.scale else (sizes.people,):
            sizes.people = people
            wall, cpu, memory = measure(sizes, folder)
            first = first or cpu
            print(f"{people:6} {sizes.recordings:10} {sizes.reducers:8} {sizes.repeats:7}: "
                  f"{wall:.1f} {cpu:.1f} {memory:.0f}; {cpu / first:.2f}", flush=True)  # fmt: skip
    return None


if __name__ == "__main__":
    main_bench()
