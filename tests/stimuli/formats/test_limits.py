"""Doors with bounds: what a file promises is looked at before memory is taken, and only regular files are opened."""

import os
import socket
import sys
import time
import tracemalloc
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from feel321.files import LIMIT
from feel321.stimuli import read_recording, write_wav
from tests.stimuli.formats.hostile import HOSTILE

PROMISES = ["wav: promises 4 GB", "csv: time stamps of a century"]

SLOW = {"npz: zeros that inflate to 1.2 GB", "mat: 40 variables of 60 MB"}
"""Slow to write."""


@pytest.mark.parametrize("case", sorted(HOSTILE.keys() - SLOW))
def test_what_is_hostile_is_refused_in_one_line(case: str, tmp_path: Path) -> None:
    name, make, message = HOSTILE[case]
    if name.endswith("ide"):
        pytest.importorskip("idelib")
    path = tmp_path / name
    path.write_bytes(make())
    with pytest.raises(ValueError, match=message) as caught:
        read_recording(path, resample=True)
    assert str(caught.value).startswith(f"{name}: ")
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 500
    if case in PROMISES:  # for which nothing is allocated, once all is imported
        tracemalloc.start()
        try:
            with pytest.raises(ValueError, match=message):
                read_recording(path, resample=True)
            assert tracemalloc.get_traced_memory()[1] < 5e6
        finally:
            tracemalloc.stop()


def test_the_limit_can_be_raised_as_its_message_says(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_wav(tmp_path / "a.wav", np.random.default_rng(1).normal(size=(3, 100_000)), 10_000)
    monkeypatch.setenv(LIMIT, "1")
    with pytest.raises(ValueError, match="at most 1 MB") as caught:
        read_recording(tmp_path / "a.wav", unit="g")
    setting = str(caught.value).partition(f"{LIMIT}=")[2].split()[0]
    monkeypatch.setenv(LIMIT, setting)
    assert read_recording(tmp_path / "a.wav", unit="g").acceleration.shape == (3, 100_000)
    monkeypatch.setenv(LIMIT, "much")
    with pytest.raises(ValueError, match=f"{LIMIT} must be a number .* got 'much'"):
        read_recording(tmp_path / "a.wav", unit="g")


def make_fifo(path: Path) -> None:
    os.mkfifo(path)


def make_socket(path: Path) -> None:
    here = Path.cwd()
    os.chdir(path.parent)  # a socket's name has at most 108 letters
    try:
        with socket.socket(socket.AF_UNIX) as one:
            one.bind(path.name)
    finally:
        os.chdir(here)


IRREGULAR: dict[str, tuple[Callable[[Path], object], str]] = {
    "fifo": (make_fifo, "must be a regular file, got a named pipe"),
    "socket": (make_socket, "must be a regular file, got a socket"),
    "device": (lambda path: path.symlink_to("/dev/zero"), "must be a regular file, got a device"),
    "terminal": (lambda path: path.symlink_to("/dev/tty"), "must be a regular file, got a device"),
    "folder": (Path.mkdir, "is a folder"),
    "broken link": (lambda path: path.symlink_to("nowhere"), "No such file"),
    "circle": (lambda path: path.symlink_to(path), "Too many levels|too many levels"),
    "process file": (lambda path: path.symlink_to("/proc/self/mem"), "Input/output|empty"),
}


@pytest.mark.skipif(sys.platform == "win32", reason="Windows: other kinds of files")
@pytest.mark.parametrize("name", ["a.wav", "a.csv", "a.npz", "a.npy", "a.mat", "a.xml", "a.ide"])
@pytest.mark.parametrize("kind", IRREGULAR)
def test_only_regular_files_are_read_and_none_is_waited_for(
    kind: str, name: str, tmp_path: Path
) -> None:
    make, message = IRREGULAR[kind]
    make(tmp_path / name)
    begun = time.process_time()
    with pytest.raises((ValueError, OSError), match=message) as caught:
        read_recording(tmp_path / name)
    assert time.process_time() - begun < 1
    assert str(caught.value).startswith(f"{name}: ")
