"""Time and memory of a study with a large corpus, verb by verb: `python tests/bench/corpus.py 100 1000 10000`.

Each verb runs in a process of its own, by the command line, as a lab runs it. Given are wall time, processor time, both
per recording, and the largest memory of the process. Growth of memory is set beside the size of the manifest, and the
time per recording beside that of the smallest corpus.
"""

from __future__ import annotations

import argparse
import os
import shutil
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from feel321.stimuli.wav import write_wav

RATE_HZ = 2000.0
DURATIONS_S = (0.25, 0.5)
SETTINGS = """
[[recordings]]
files = "corpus/*.wav"
unit = "m/s^2"
[stimuli]
reducers = ["sax321", "pca321", "dft321"]
anchors = {anchors}
gain = "per_recording"
below_threshold = "accept"
[rig]
rate_hz = 4000.0
[session]
protocols = ["realism"]
recordings_per_participant = {share}
[analysis]
draws = 200
"""
VERBS = {
    "check": ("check",), "build": ("build",), "build again": ("build",), "check built": ("check",),
    "simulate": ("simulate", "--participants", "2"), "status": ("status",), "audit": ("audit",),
    "analyze": ("analyze",),
}  # fmt: skip


def make_corpus(folder: Path, count: int, *, share: int = 20, anchors: bool = False) -> None:
    """Make a study with so many short recordings: taps and rubbing, no two alike."""
    (folder / "corpus").mkdir(parents=True)
    for number in range(count):
        rng = np.random.default_rng([321, number])
        n = round(RATE_HZ * rng.uniform(*DURATIONS_S))
        decay = np.exp(-np.arange(n) / RATE_HZ / rng.uniform(0.02, 0.3))
        noise = rng.standard_normal((3, n)) * rng.uniform(0.5, 2.0, (3, 1))
        write_wav(folder / "corpus" / f"tap{number:05d}.wav", 5 * noise * decay, RATE_HZ)
    text = SETTINGS.format(share=min(share, count), anchors=str(anchors).lower())
    (folder / "study.toml").write_text(text, encoding="utf-8")


def run(arguments: tuple[str, ...], folder: Path, log: Path) -> tuple[float, float, float]:
    """Run a verb; returns wall time and processor time in s, and the largest memory in MB."""
    begun = time.monotonic()
    verb, *options = arguments
    program = str(Path(sys.executable).with_name("feel321"))
    process = os.posix_spawn(
        program,
        [program, verb, str(folder), *options],
        os.environ,
        file_actions=[
            (os.POSIX_SPAWN_OPEN, 1, str(log), os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o644),
            (os.POSIX_SPAWN_DUP2, 1, 2),
        ],
    )
    _, status, used = os.wait4(process, 0)
    wall = time.monotonic() - begun
    if status:
        sys.exit(f"feel321 {' '.join(arguments)} failed: {log.read_text()[:2000]}")
    return wall, used.ru_utime + used.ru_stime, used.ru_maxrss / 1024


def main() -> None:
    """Measure each corpus, and print one table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("counts", type=int, nargs="*", default=[100, 1000])
    parser.add_argument("--verbs", default=",".join(VERBS))
    parser.add_argument("--keep", type=Path, help="Folder in which the studies stay.")
    given = parser.parse_args()
    home = given.keep or Path(tempfile.mkdtemp())
    base: dict[str, float] = {}
    print(f"{'verb':<12} {'n':>6} {'wall s':>8} {'CPU s':>8} {'ms each':>8} {'ratio':>6} {'MB':>7}")
    for count in given.counts:
        folder = home / f"corpus{count}"
        if not folder.exists():
            make_corpus(folder, count)
        for name in given.verbs.split(","):
            wall, cpu, memory = run(VERBS[name], folder, home / "log.txt")
            each = 1000 * cpu / count
            ratio = each / base.setdefault(name, each)
            print(
                f"{name:<12} {count:>6} {wall:8.1f} {cpu:8.1f} {each:8.2f} {ratio:6.2f} {memory:7.0f}",
                flush=True,
            )
        sizes = [path.stat().st_size for path in (folder / "stimuli").glob("manifest.*")]
        print(f"manifest     {count:>6} {sum(sizes) / 2**20:.1f} MB", flush=True)
        if given.keep is None:
            shutil.rmtree(folder)


if __name__ == "__main__":
    main()
