"""A disk on which power fails: from the operations of a log, all states that a power cut may leave.

An operation changes an entry of a folder, or the content of a file. It is *synced* once its file (for contents) or all
its folders (for entries) were given to fsync; what is synced stays. Of all others any may be on the disk or not, in any
order: up to `FEW` of them every choice is tried, beyond that all, none, each one alone, each one missing, each
beginning, entries only, contents only. A write that is not synced may also be there in part, or as zeros.

After Pillai et al. (2014), All file systems are not created equal, OSDI: their abstract persistence model, with the
weakest file system that POSIX allows (files' own fsync does not keep their names).
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations
from pathlib import Path

FEW = 4
"""So many operations that are not synced are combined in every way."""

ROOT = 0
"""The number of the folder that was recorded."""

Content = bytes | dict[str, int]
"""What stands under a number: a file's bytes, or a folder's entries."""


@dataclass(frozen=True)
class Entries:
    """Sets entries of folders, at once: (folder, name) -> file or folder, or None where it goes."""

    changes: tuple[tuple[int, str, int | None], ...]
    is_content = False

    @property
    def places(self) -> set[int]:
        return {folder for folder, _, _ in self.changes}


@dataclass(frozen=True)
class Write:
    """Writes bytes into a file."""

    file: int
    offset: int
    data: bytes
    is_content = True

    @property
    def places(self) -> set[int]:
        return {self.file}


@dataclass(frozen=True)
class Resize:
    """Cuts a file, or fills it with zeros."""

    file: int
    size: int
    is_content = True

    @property
    def places(self) -> set[int]:
        return {self.file}


@dataclass(frozen=True)
class Sync:
    """All that was done to a file's content or a folder's entries is on the disk."""

    place: int


@dataclass(frozen=True)
class Mark:
    """Something was acknowledged."""

    text: str


Change = Entries | Write | Resize
Step = Change | Sync | Mark


@dataclass
class Log:
    """What was there before, and all steps in order; folders: the numbers of all there ever were."""

    before: dict[int, Content]
    folders: set[int]
    steps: list[Step] = field(default_factory=list)


@dataclass(frozen=True)
class Cut:
    """A power cut: after how many steps, what had been acknowledged, and what is on the disk."""

    point: int
    marks: tuple[str, ...]
    changes: tuple[Change, ...]
    lost: tuple[Change, ...]


def list_cuts(log: Log, *, stride: int = 1) -> Iterator[Cut]:
    """List all power cuts at every point of a log; of those that leave one state the last, which must keep most.

    stride: look at every n-th point only.
    """
    found: dict[bytes, Cut] = {}
    safe: list[tuple[int, Change]] = []
    open_: list[tuple[int, Change]] = []
    marks: list[str] = []
    for point, step in enumerate(log.steps, start=1):
        if isinstance(step, Mark):
            marks.append(step.text)
        elif isinstance(step, Sync):
            safe, open_ = _settle(safe, open_, step.place)
        else:
            open_.append((point, step))
        for kept in () if point % stride else choose(open_):
            changes = tuple(one for _, one in sorted([*safe, *kept], key=lambda pair: pair[0]))
            lost = tuple(one for pair in open_ if pair not in kept for one in pair[1:])
            cut = Cut(point, tuple(marks), changes, lost)
            found[digest(log, cut)] = cut
    yield from found.values()


def _settle(
    safe: list[tuple[int, Change]], open_: list[tuple[int, Change]], place: int
) -> tuple[list[tuple[int, Change]], list[tuple[int, Change]]]:
    """Sync a file or a folder: of what was moved between two folders, one end may be safe and the other not."""
    still: list[tuple[int, Change]] = []
    for number, change in open_:
        if place not in change.places:
            still.append((number, change))
        elif isinstance(change, Entries):
            here = tuple(one for one in change.changes if one[0] == place)
            there = tuple(one for one in change.changes if one[0] != place)
            safe = [*safe, (number, Entries(here))]
            still += [(number, Entries(there))] if there else []
        else:
            safe = [*safe, (number, change)]
    return safe, still


Numbered = Sequence[tuple[int, Change]]


def choose(open_: Numbered) -> Iterator[list[tuple[int, Change]]]:
    """Choose which of the operations that are not synced are on the disk."""
    yield from _choose_whole(open_)
    for place, (number, change) in enumerate(open_):
        if isinstance(change, Write):
            for part in _tear(change):
                yield [*open_[:place], (number, part), *open_[place + 1 :]]
                yield [pair for pair in open_ if not pair[1].is_content] + [(number, part)]


def _choose_whole(open_: Numbered) -> Iterator[list[tuple[int, Change]]]:
    if len(open_) <= FEW:
        for n in range(len(open_) + 1):
            yield from map(list, combinations(open_, n))
        return
    for place in range(len(open_) + 1):
        yield list(open_[:place])
    for place, one in enumerate(open_):
        yield [one]
        yield [*open_[:place], *open_[place + 1 :]]
    for is_content in (True, False):
        yield [pair for pair in open_ if pair[1].is_content is is_content]


def _tear(write: Write) -> Iterator[Write]:
    size = len(write.data)
    for left in {1, size // 2, size - 1} - {0, size}:
        yield replace(write, data=write.data[:left])
    yield replace(write, data=bytes(size))


def apply(log: Log, changes: Sequence[Change]) -> dict[int, Content]:
    """Make a disk of what was there and some changes."""
    disk: dict[int, Content] = {
        number: dict(one) if isinstance(one, dict) else one for number, one in log.before.items()
    }
    disk |= {number: {} for number in log.folders - set(disk)}
    for change in changes:
        if isinstance(change, Entries):
            _enter(disk, change)
        else:
            content = disk.get(change.file, b"")
            assert isinstance(content, bytes)
            disk[change.file] = _write(content, change)
    return disk


def _enter(disk: dict[int, Content], change: Entries) -> None:
    for folder, name, target in change.changes:
        entries = disk[folder]
        assert isinstance(entries, dict)
        entries.pop(name, None)
        if target is not None:
            entries[name] = target


def _write(content: bytes, change: Write | Resize) -> bytes:
    if isinstance(change, Resize):
        return content[: change.size].ljust(change.size, b"\0")
    end = change.offset + len(change.data)
    return content.ljust(change.offset, b"\0")[: change.offset] + change.data + content[end:]


def list_tree(
    disk: dict[int, Content], folder: int = ROOT, place: str = ""
) -> Iterator[tuple[str, bytes | None]]:
    """List what can be reached: files with their bytes, folders with None."""
    entries = disk.get(folder, {})
    assert isinstance(entries, dict)
    for name, target in sorted(entries.items()):
        content = disk.get(target, b"")
        if isinstance(content, dict):
            yield f"{place}{name}", None
            yield from list_tree(disk, target, f"{place}{name}/")
        else:
            yield f"{place}{name}", content


def digest(log: Log, cut: Cut) -> bytes:
    """Make a digest of a state."""
    found = hashlib.sha256()
    for name, content in list_tree(apply(log, cut.changes)):
        body = b"folder" if content is None else hashlib.sha256(content).digest()
        found.update(name.encode() + b"\0" + body)
    return found.digest()


def lay_out(log: Log, cut: Cut, folder: Path) -> None:
    """Write a state into an empty folder."""
    for name, content in list_tree(apply(log, cut.changes)):
        path = folder / name
        if content is None:
            path.mkdir()
        else:
            path.write_bytes(content)
