"""Files that are whole, durable, private where asked, and swept where their process was killed."""

from __future__ import annotations

import os
import signal
import stat
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from feel321 import files

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

WRITERS: dict[str, Callable[[Path, bool], object]] = {
    "bytes": lambda path, private: files.write_bytes(path, b"1\n", private=private),
    "text": lambda path, private: files.write_text(path, "1\n", private=private),
    "created": lambda path, private: files.create_text(path, "1\n", private=private),
    "chunks": lambda path, private: files.write_chunks(path, ["1\n"], private=private),
    "table": lambda path, private: files.write_table(path, ["1"], [], private=private),
    "begun": lambda path, private: files.create_file(path, private=private),
}

HOLDING = """
import sys, time
from pathlib import Path
from feel321 import files
def write(file):
    file.write(b"half")
    file.flush()
    with files.temporary_folder(Path(sys.argv[1])) as folder:
        (folder / "piece").write_bytes(b"1")
        print(folder, flush=True)
        time.sleep(60)
files._replace(Path(sys.argv[1]), write)
"""


def mode(path: Path) -> int:
    return stat.S_IMODE(path.stat().st_mode)


@pytest.fixture
def open_umask() -> Iterator[None]:
    before = os.umask(0o022)
    yield
    os.umask(before)


@pytest.mark.usefixtures("open_umask")
@pytest.mark.parametrize("name", WRITERS)
def test_private_from_the_first_byte(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen = []
    make = os.open

    def watch(path: str | Path, flags: int, *rest: int, **more: int) -> int:
        descriptor = make(path, flags, *rest, **more)
        if flags & os.O_CREAT:
            seen.append(stat.S_IMODE(os.fstat(descriptor).st_mode))
        return descriptor

    monkeypatch.setattr(os, "open", watch)
    WRITERS[name](tmp_path / "mine", True)
    WRITERS[name](tmp_path / "all", False)
    assert seen == [0o600, 0o644]
    assert (mode(tmp_path / "mine"), mode(tmp_path / "all")) == (0o600, 0o644)


@pytest.mark.usefixtures("open_umask")
def test_an_open_file_of_the_same_content_becomes_private(tmp_path: Path) -> None:
    files.write_text(tmp_path / "a", "1")
    files.write_text(tmp_path / "a", "1", private=True)
    assert mode(tmp_path / "a") == 0o600


@pytest.mark.usefixtures("open_umask")
def test_folders_are_private_and_each_new_name_is_durable(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    synced: list[Path] = []
    monkeypatch.setattr(files, "sync_folder", synced.append)
    files.make_folder(tmp_path / "a/b/c", private=True)
    assert synced == [tmp_path, tmp_path / "a", tmp_path / "a/b"]
    assert [mode(tmp_path / one) for one in ("a", "a/b", "a/b/c")] == [0o700] * 3
    files.make_folder(tmp_path / "a/b/c")
    assert len(synced) == 3
    (tmp_path / "file").touch()
    with pytest.raises(OSError, match=r"exists|Not a directory"):
        files.make_folder(tmp_path / "file")


@pytest.mark.skipif(os.name == "nt", reason="Windows: folders are not swept")
def test_sweep_removes_what_a_killed_process_left_and_nothing_of_a_live_one(tmp_path: Path) -> None:
    target = tmp_path / "study" / "ratings.csv"
    target.parent.mkdir()
    target.write_text("whole")
    (target.parent / ".ratings.csv.part").touch()  # not ours
    (target.parent / ".old.csv.77.part").touch()  # of an earlier version
    command = [sys.executable, "-c", HOLDING, str(target)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as writer:
        assert writer.stdout is not None
        folder = Path(writer.stdout.readline().strip())
        assert folder.parent == target.parent
        assert folder.name.startswith(f"feel321-{writer.pid}-")
        (unfinished,) = target.parent.glob(f".ratings.csv.{writer.pid}.*.part")
        assert mode(folder) == 0o700
        assert files.sweep(tmp_path) == [target.parent / ".old.csv.77.part"]
        writer.send_signal(signal.SIGKILL)
        writer.wait()
    assert files.sweep(tmp_path) == sorted([unfinished, folder])
    assert files.sweep(tmp_path) == []
    assert sorted(one.name for one in target.parent.iterdir()) == [
        ".ratings.csv.part",
        "ratings.csv",
    ]
    assert target.read_text() == "whole"


def test_sweep_follows_no_link(tmp_path: Path) -> None:
    elsewhere, here = tmp_path / "elsewhere", tmp_path / "here"
    (elsewhere / "feel321-1-a").mkdir(parents=True)
    (elsewhere / ".a.1.part").touch()
    here.mkdir()
    (here / "feel321-1-b").symlink_to(elsewhere)
    (here / "folder").symlink_to(elsewhere)
    (here / ".b.1.part").symlink_to(elsewhere / ".a.1.part")
    assert files.sweep(here) == []
    assert len(list(elsewhere.iterdir())) == 2
