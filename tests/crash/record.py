"""The system calls of a program as steps on a disk: what `strace` saw below one folder."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path
from typing import TYPE_CHECKING, Final

from tests.crash.disk import ROOT, Content, Entries, Log, Mark, Resize, Step, Sync, Write

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

CALLS: Final = (
    "open", "openat", "creat", "close", "dup", "dup2", "dup3", "lseek", "write", "pwrite64", "writev", "pwritev",
    "ftruncate", "truncate", "rename", "renameat", "renameat2", "unlink", "unlinkat", "mkdir", "mkdirat", "rmdir",
    "link", "linkat", "symlink", "symlinkat", "fsync", "fdatasync", "sync", "syncfs", "copy_file_range", "sendfile",
    "mmap", "fallocate", "io_uring_setup",
)  # fmt: skip
"""Every call that may change the disk, and those that say where."""

MARKS = "/acknowledged/"
"""Looking for a file of this folder, which does not exist, is how a program marks what it has acknowledged."""

LINE = re.compile(r"^(?:\d+ +)?(\w+)\((.*)\) += (-?\d+)(?:<([^>]*)>)?.*$")
HEX = re.compile(r"\\x([0-9a-f]{2})")
STRING = re.compile(r'"([^"]*)"')
NAMED = re.compile(r"(-?\d+|AT_FDCWD)(?:<([^>]*)>)?")


def decode(text: str) -> bytes:
    """Decode a string of strace -xx."""
    return bytes(int(pair, 16) for pair in HEX.findall(text)) if "\\x" in text else text.encode()


def trace(words: Sequence[str | Path], folder: Path, log: Path) -> Log:
    """Run a program, and return what it did to a folder."""
    before = _take(folder)
    options = ["-f", "-y", "-xx", "-s", str(2**26), "-e", f"trace={','.join(CALLS)}", "-o", log]
    subprocess.run(["strace", *options, *words], check=True)
    recorder = _Recorder(folder, before)
    for line in _join(log.read_text(encoding="ascii", errors="replace").splitlines()):
        if match := LINE.match(line):
            recorder.take(match[1], match[2], int(match[3]))
    return Log(before, set(recorder.entries), recorder.steps)


def can_trace() -> bool:
    """Check whether strace is there and may trace."""
    words = ["strace", "-o", "/dev/null", "true"]
    return bool(shutil.which("strace")) and not subprocess.call(words, stderr=subprocess.DEVNULL)


def _join(lines: Sequence[str]) -> list[str]:
    """Put together the calls that another thread's came in between."""
    begun, whole = {}, []
    for line in lines:
        thread = line.partition(" ")[0]
        if line.endswith("<unfinished ...>"):
            begun[thread] = line.removesuffix("<unfinished ...>")
        elif "resumed>" in line:
            whole.append(begun.pop(thread, "") + line.partition("resumed>")[2])
        else:
            whole.append(line)
    return whole


def _take(folder: Path) -> dict[int, Content]:
    """Number all that is there."""
    disk: dict[int, Content] = {ROOT: {}}
    numbers = {folder: ROOT}
    for path in sorted(folder.rglob("*")):
        number = numbers[path] = len(numbers)
        disk[number] = {} if path.is_dir() else path.read_bytes()
        entries = disk[numbers[path.parent]]
        assert isinstance(entries, dict)
        entries[path.name] = number
    return disk


class _Recorder:
    """Follows calls: which number has each name, each descriptor and its place in the file."""

    def __init__(self, folder: Path, before: dict[int, Content]) -> None:
        self.folder = str(folder)
        self.entries = {n: dict(one) for n, one in before.items() if isinstance(one, dict)}
        self.sizes = {n: len(one) for n, one in before.items() if isinstance(one, bytes)}
        self.count = len(before)
        self.descriptors: dict[int, list[int]] = {}  # file, offset, whether it appends
        self.steps: list[Step] = []

    def take(self, name: str, text: str, result: int) -> None:
        """Take one call."""
        arguments = text.split(", ")
        if name in {"open", "openat", "creat"}:
            self._open(arguments, text, result)
        elif result >= 0:
            call: Callable[[list[str], int], None] = getattr(self, f"_{name}", self._refuse)
            call(arguments, result)

    # Names.

    def _resolve(self, words: list[str]) -> tuple[int, str] | None:
        """Find folder and name of a path, given by itself or after a descriptor; None outside the folder."""
        string = STRING.search(words[-1])
        assert string is not None, words
        path = decode(string[1]).decode()
        if not path.startswith("/"):
            base = NAMED.match(words[0])
            assert base is not None, words
            path = f"{decode(base[2] or '').decode()}/{path}"
        if path.startswith(MARKS):
            self.steps.append(Mark(path.removeprefix(MARKS)))
        if path == self.folder:
            return ROOT, "."
        if not path.startswith(f"{self.folder}/"):
            return None
        *above, name = path.removeprefix(f"{self.folder}/").strip("/").split("/")
        folder: int | None = ROOT
        for part in above:
            folder = self.entries.get(folder if folder is not None else -1, {}).get(part)
        return None if folder is None else (folder, name)

    def _set(self, *changes: tuple[int, str, int | None]) -> None:
        for folder, name, target in changes:
            self.entries[folder].pop(name, None)
            if target is not None:
                self.entries[folder][name] = target
        self.steps.append(Entries(changes))

    def _make(self, place: tuple[int, str], *, is_folder: bool) -> int:
        number, self.count = self.count, self.count + 1
        if is_folder:
            self.entries[number] = {}
        else:
            self.sizes[number] = 0
        self._set((*place, number))
        return number

    def _open(self, words: list[str], text: str, result: int) -> None:
        place = self._resolve(words[: 1 if words[0].startswith('"') else 2])
        if result < 0:
            return
        if place is None or place[1] == ".":
            self.descriptors.pop(result, None)
            if place:
                self.descriptors[result] = [ROOT, 0, 0]
            return
        number = self.entries.get(place[0], {}).get(place[1])
        if number is None:
            assert "O_CREAT" in text, text
            number = self._make(place, is_folder=False)
        elif "O_TRUNC" in text and self.sizes.get(number):
            self._resize(number, 0)
        self.descriptors[result] = [number, 0, int("O_APPEND" in text)]

    def _mkdirat(self, words: list[str], _: int) -> None:
        if place := self._resolve(words[:2]):
            self._make(place, is_folder=True)

    def _mkdir(self, words: list[str], _: int) -> None:
        if place := self._resolve(words[:1]):
            self._make(place, is_folder=True)

    def _unlinkat(self, words: list[str], _: int) -> None:
        if place := self._resolve(words[:2]):
            self._set((*place, None))

    def _unlink(self, words: list[str], _: int) -> None:
        if place := self._resolve(words[:1]):
            self._set((*place, None))

    _rmdir = _unlink

    def _rename(self, words: list[str], _: int) -> None:
        self._move(self._resolve(words[:1]), self._resolve(words[1:2]))

    def _renameat(self, words: list[str], _: int) -> None:
        self._move(self._resolve(words[:2]), self._resolve(words[2:4]))

    _renameat2 = _renameat

    def _move(self, old: tuple[int, str] | None, new: tuple[int, str] | None) -> None:
        assert (old is None) == (new is None), "moved over the border of what is recorded"
        if old is not None and new is not None:
            self._set((*new, self.entries[old[0]][old[1]]), (*old, None))

    # Contents.

    def _find(self, word: str) -> list[int] | None:
        match = NAMED.match(word)
        return self.descriptors.get(int(match[1])) if match and match[1] != "AT_FDCWD" else None

    def _write_at(self, number: int, offset: int, data: bytes) -> None:
        self.sizes[number] = max(self.sizes[number], offset + len(data))
        self.steps.append(Write(number, offset, data))

    def _write(self, words: list[str], result: int) -> None:
        if (found := self._find(words[0])) and result:
            data = b"".join(decode(one) for one in STRING.findall(", ".join(words[1:])))[:result]
            assert len(data) == result, "strace cut a string"
            if found[2]:
                found[1] = self.sizes[found[0]]
            self._write_at(found[0], found[1], data)
            found[1] += result

    _writev = _write

    def _pwrite64(self, words: list[str], result: int) -> None:
        if found := self._find(words[0]):
            data = b"".join(decode(one) for one in STRING.findall(", ".join(words[1:-1])))
            self._write_at(found[0], int(words[-1]), data[:result])

    _pwritev = _pwrite64

    def _resize(self, number: int, size: int) -> None:
        self.sizes[number] = size
        self.steps.append(Resize(number, size))

    def _ftruncate(self, words: list[str], _: int) -> None:
        if found := self._find(words[0]):
            self._resize(found[0], int(words[1]))

    def _truncate(self, words: list[str], _: int) -> None:
        if place := self._resolve(words[:1]):
            self._resize(self.entries[place[0]][place[1]], int(words[1]))

    def _lseek(self, words: list[str], result: int) -> None:
        if found := self._find(words[0]):
            found[1] = result

    def _close(self, words: list[str], _: int) -> None:
        if match := NAMED.match(words[0]):
            self.descriptors.pop(int(match[1]), None)

    def _dup(self, words: list[str], result: int) -> None:
        if found := self._find(words[0]):
            self.descriptors[result] = found  # one offset for both

    _dup2 = _dup3 = _dup

    def _fsync(self, words: list[str], _: int) -> None:
        if found := self._find(words[0]):
            self.steps.append(Sync(found[0]))

    _fdatasync = _fsync

    def _mmap(self, words: list[str], _: int) -> None:
        shared = "MAP_SHARED" in words[3] and "PROT_WRITE" in words[2]
        assert not (shared and self._find(words[4])), "a file was mapped for writing"

    def _refuse(self, words: list[str], _: int) -> None:
        """Do not pretend to know what was not modelled."""
        is_ours = any(self._find(word) for word in words) or self.folder in decode_all(words)
        assert not is_ours, f"not modelled: {words}"


def decode_all(words: list[str]) -> str:
    return " ".join(
        decode(one).decode("utf-8", "replace") for word in words for one in STRING.findall(word)
    )
