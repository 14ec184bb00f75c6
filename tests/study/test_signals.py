"""SIGTERM and a closed terminal end every verb as Ctrl-C does: one line, no process and no unfinished file left."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import pytest

from feel321.study.folder import StudyFolder
from feel321.study.workflow import build_study

FEEL321 = Path(sys.executable).with_name("feel321")
STUDY = """
[[recordings]]
scene = "bumps"
duration_s = 2.0
[[recordings]]
scene = "hard_taps"
duration_s = 2.0
[stimuli]
reducers = ["sax321", "dft321", "pca321"]
[session]
repeats = 1
"""
VERBS: dict[str, tuple[str, ...]] = {
    "build": ("build", "STUDY", "--workers", "2"),
    "simulate": ("simulate", "STUDY", "--participants", "50"),
    "analyze": ("analyze", "STUDY"),
    "chart": ("chart", "STUDY", "--workers", "2"),
    "stress": ("stress", "--out", "STUDY/stress", "--workers", "2"),
    "power": ("power", "STUDY", "--workers", "2"),
    "export": ("export", "STUDY", "STUDY/r"),
}


def list_children(parent: int) -> set[int]:
    """The processes that a process has begun, and theirs."""
    found = {parent}
    for _ in range(4):
        for stat in Path("/proc").glob("[0-9]*/stat"):
            try:
                fields = stat.read_text().rpartition(")")[2].split()
            except OSError:
                continue
            if int(fields[1]) in found and fields[0] != "Z":
                found.add(int(stat.parent.name))
    return found - {parent}


@pytest.fixture(scope="module")
def rated(tmp_path_factory: pytest.TempPathFactory) -> StudyFolder:
    study = StudyFolder(tmp_path_factory.mktemp("signals"))
    study.settings.write_text(STUDY, encoding="utf-8")
    build_study(study)
    command = [FEEL321, "simulate", study.path, "--participants", "6"]
    subprocess.run(command, check=True, capture_output=True)
    return study
