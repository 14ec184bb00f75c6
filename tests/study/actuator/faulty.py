"""Amplifier, coil and sensor between two sinks of a sound server, with faults.

Arguments: source, sink, number of channels of the source, and a file that holds the fault of the moment.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np

RATE_HZ, BLOCK_FRAMES = 48000, 480
NOISE = 1e-4  # of full scale: an input that is connected to something
PATHS = {
    "none": (1.0, 0.0), "coil dead": (0.0, 0.0), "amplifier half": (0.5, 0.0), "polarity": (-1.0, 0.0),
    "channels swapped": (0.0, 1.0), "stream moved": (1.0, 0.0), "sensor dead": (0.0, 0.0),
}  # fmt: skip
"""Fault -> gain of the first two channels on the way to the sensor."""


def main(source: str, sink: str, channels: int, fault: Path) -> None:
    form = ["--raw", "--format=float32le", f"--rate={RATE_HZ}"]
    recorder = subprocess.Popen(
        ["parec", *form, f"--device={source}", f"--channels={channels}", "--no-remix", "--latency-msec=10"],
        stdout=subprocess.PIPE,
    )  # fmt: skip
    player = subprocess.Popen(
        ["pacat", *form, f"--device={sink}", "--channels=1", "--latency-msec=150"],
        stdin=subprocess.PIPE,
    )
    rng = np.random.default_rng(1)
    assert recorder.stdout is not None
    assert player.stdin is not None
    try:
        while block := recorder.stdout.read(4 * channels * BLOCK_FRAMES):
            name = fault.read_text(encoding="utf-8")
            frames = np.frombuffer(block, dtype="<f4").reshape(-1, channels)
            heard = frames[:, : len(PATHS[name])] @ np.array(PATHS[name])
            if name != "sensor dead":
                heard = heard + rng.normal(0, NOISE, len(heard))
            player.stdin.write(heard.astype("<f4").tobytes())
            player.stdin.flush()
    except BrokenPipeError:
        pass
    finally:
        recorder.kill()
        player.kill()


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2], int(sys.argv[3]), Path(sys.argv[4]))
