"""The same set on every processor: BLAS kernels and vector instructions may change the last digits only."""

import csv
import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from feel321.stimuli.wav import read_wav

# Names that NumPy and OpenBLAS do not know, as on another architecture, are ignored by them.
KERNELS = {
    "haswell": {"OPENBLAS_CORETYPE": "Haswell"},
    "skylakex": {"OPENBLAS_CORETYPE": "SkylakeX"},
    "zen": {"OPENBLAS_CORETYPE": "Zen"},
    "prescott": {
        "OPENBLAS_CORETYPE": "Prescott",
        "NPY_DISABLE_CPU_FEATURES": "AVX2 FMA3 F16C AVX AVX512F AVX512CD AVX512_SKX AVX512_CLX AVX512_CNL AVX512_ICL",
    },
}

# The demonstration's scenes and recipe, shorter, and with both levels.
BUILD = """
import sys
from feel321 import stimuli

scenes = [stimuli.make_scene(name, rng=321, duration_s=0.5) for name in stimuli.SCENES]
stimuli.build_stimuli(scenes, sys.argv[1], levels=["as_is", "equal_intensity"])
"""


def build(folder: Path, settings: dict[str, str]) -> int:
    own = {name: value for name, value in os.environ.items() if name not in settings}
    own |= {"OPENBLAS_NUM_THREADS": "1", "PYTHONWARNINGS": "ignore", **settings}
    command = [sys.executable, "-c", BUILD, str(folder)]
    return subprocess.run(command, env=own, check=False).returncode


def read_rows(folder: Path) -> dict[str, dict[str, str]]:
    with (folder / "manifest.csv").open(encoding="utf-8", newline="") as file:
        return {row["stimulus_id"]: row for row in csv.DictReader(file)}


def test_sets_agree_between_kernels(tmp_path: Path) -> None:
    codes = {name: build(tmp_path / name, settings) for name, settings in KERNELS.items()}
    # A processor that lacks the instructions of a kernel ends the process; every x86 runs the last.
    assert set(codes.values()) <= {0, -signal.SIGILL}
    assert codes["prescott"] == 0
    others = [name for name, code in codes.items() if code == 0 and name != "prescott"]
    assert others
    expected = read_rows(tmp_path / "prescott")
    for name in others:
        found = read_rows(tmp_path / name)
        assert found.keys() == expected.keys()
        for key, row in expected.items():
            compare(row, found[key])
            one, other = (
                read_wav(tmp_path / kernel / row["file"])[0] for kernel in ("prescott", name)
            )
            assert np.linalg.norm(one - other) <= 1e-5 * np.linalg.norm(one), (name, key)  # -100 dB


def compare(row: dict[str, str], other: dict[str, str]) -> None:
    for column in row.keys() - {"sha256", "recording_sha256"}:
        try:
            expected = pytest.approx(float(row[column]), rel=1e-6, abs=1e-6)
        except ValueError:
            assert other[column] == row[column], column
        else:
            assert float(other[column]) == expected, (row["stimulus_id"], column)
