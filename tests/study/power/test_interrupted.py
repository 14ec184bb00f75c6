"""The verb as a process: Ctrl-C keeps what is done, the same call continues, two workers write the same bytes."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from pathlib import Path

    from feel321.study.folder import StudyFolder

SIZES = (
    "--participants",
    "6",
    "--recordings",
    "4",
    "--reducers",
    "5",
    "--repeats",
    "1",
    "--studies",
    "150",
)


def start(study: StudyFolder, out: Path, *more: str) -> subprocess.Popen[str]:
    code = "import sys; from feel321.study.cli import main; sys.exit(main())"
    words = ("power", str(study.path), *SIZES, "--out", str(out), *more)
    return subprocess.Popen([sys.executable, "-c", code, *words], stderr=subprocess.PIPE, text=True)


def read(out: Path) -> dict[str, bytes]:
    files = (file for file in out.rglob("*") if file.is_file() and ".studies" not in file.parts)
    return {file.relative_to(out).as_posix(): file.read_bytes() for file in files}


@pytest.mark.soak
def test_interrupted_and_continued_and_two_workers_give_the_same_bytes(
    built: StudyFolder, tmp_path: Path
) -> None:
    one, two = tmp_path / "one", tmp_path / "two"
    first = start(built, one)
    while not list(one.glob(".studies/*.json")):
        assert first.poll() is None, first.communicate()[1]
        time.sleep(0.02)
    first.send_signal(signal.SIGINT)
    _, error = first.communicate()
    assert (first.returncode, read(one)) == (130, {})
    assert "the same command continues" in error
    kept = {file: file.stat().st_mtime_ns for file in one.glob(".studies/*.json")}
    second = start(built, one)
    assert second.communicate() == (None, "")
    assert second.returncode == 0
    assert kept == {file: file.stat().st_mtime_ns for file in kept}
    third = start(built, two, "--workers", "2")
    third.communicate()
    assert third.returncode == 0
    assert read(one) == read(two)
