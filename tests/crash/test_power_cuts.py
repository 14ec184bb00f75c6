"""Power cuts at every point of a session, a build, a withdrawal, a rebuilt ledger and a collection.

The system calls of each are recorded once; from the log come all states that a cut may leave (see `disk`). By default a
sample of them is looked at, in `make soak` every one.
"""

from __future__ import annotations

import shutil
import sys
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from tests.crash import steps
from tests.crash.check import CHECKS, Lost
from tests.crash.disk import (
    ROOT,
    Cut,
    Entries,
    Log,
    Mark,
    Resize,
    Sync,
    Write,
    apply,
    lay_out,
    list_cuts,
    list_tree,
)
from tests.crash.record import can_trace, trace
from tests.fuzz.trial import MEMORY

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

SAMPLE = {"session": 40, "withdraw": 25}
"""So many states of these steps are looked at by default."""

STRIDE = 7
"""By default, power is cut at every seventh point."""

AGAIN = 8
"""After every eighth cut the step is done again."""


BEGIN = """
import sys, types
package = sys.modules["tests"] = types.ModuleType("tests")
package.__path__ = [{tests!r}]
from tests.crash.steps import main
main(*sys.argv[1:])
"""
"""Finds the package of the tests: some distribution may have installed another of that name."""


@pytest.fixture
def place(tmp_path: Path) -> Iterator[Path]:
    """A folder in memory, where there is one: thousands of states are written."""
    folder = MEMORY / f"crash-{tmp_path.name}" if MEMORY.is_dir() else tmp_path / "states"
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    yield folder
    shutil.rmtree(folder)


@pytest.fixture(scope="module")
def record(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], tuple[Log, Path]]:
    """Records a step, once: what it did, and the folder as it is after it."""

    @cache
    def make(step: str) -> tuple[Log, Path]:
        if not can_trace():
            pytest.skip("NO REPLAY OF POWER CUTS: strace is missing or may not trace")
        place = tmp_path_factory.mktemp("recorded")
        whole = place / "whole"
        steps.prepare(step, whole)
        words = [
            sys.executable,
            "-c",
            BEGIN.format(tests=str(Path(__file__).parents[1])),
            step,
            whole,
        ]
        return trace(words, whole, place / "calls.txt"), whole

    return make


def replay(
    step: str,
    recorded: tuple[Log, Path],
    cuts: Iterable[Cut],
    *,
    place: Path,
    again_after: int = AGAIN,
) -> list[str]:
    """Look at the states that cuts leave, and after some do the step again; returns what failed."""
    (log, whole), state, failed = recorded, place / "state", []
    at_once, again = CHECKS[step]
    for number, cut in enumerate(cuts):
        state.mkdir()
        lay_out(log, cut, state)
        try:
            at_once(cut, state, whole)
            if number % again_after == 0:
                again(cut, state, whole)
        except Exception as error:  # noqa: BLE001 - whatever it is, the cut is named
            lost = "; ".join(f"{one!s:.120}" for one in cut.lost)
            failed.append(
                f"after step {cut.point}, without {lost}: {type(error).__name__}: {error}"
            )
        shutil.rmtree(state)
    return failed


@pytest.mark.parametrize("step", SAMPLE)
def test_some_power_cuts(step: str, place: Path, record: Callable[[str], tuple[Log, Path]]) -> None:
    recorded = record(step)
    cuts = list(list_cuts(recorded[0], stride=STRIDE))
    chosen = cuts[:: max(1, len(cuts) // SAMPLE[step])]
    assert not replay(step, recorded, chosen, place=place)


@pytest.mark.soak
@pytest.mark.parametrize("step", CHECKS)
def test_every_power_cut(step: str, place: Path, record: Callable[[str], tuple[Log, Path]]) -> None:
    recorded = record(step)
    cuts = list(list_cuts(recorded[0]))
    print(f"{step}: {len(recorded[0].steps)} steps, {len(cuts)} states")  # noqa: T201 - the count of states
    assert not replay(step, recorded, cuts, place=place)


# The replay finds what is not synced.


def forget(log: Log, *, is_folder: bool) -> Log:
    """Forget the fsync of files, or of folders."""
    kept = [
        one
        for one in log.steps
        if not (isinstance(one, Sync) and (one.place in log.folders) is is_folder)
    ]
    return Log(log.before, log.folders, list(kept))


@pytest.mark.parametrize("is_folder", [True, False])
def test_a_sync_less_is_seen(
    is_folder: bool, place: Path, record: Callable[[str], tuple[Log, Path]]
) -> None:
    """Without the fsync of files, or of folders, acknowledged records are lost: the replay must say so."""
    log, whole = record("session")
    third = [n for n, one in enumerate(log.steps, 1) if isinstance(one, Mark)][3]
    less = forget(Log(log.before, log.folders, log.steps[:third]), is_folder=is_folder)
    cuts = list(list_cuts(less, stride=len(less.steps)))
    failed = replay("session", (less, whole), cuts[::8], place=place, again_after=len(cuts))
    assert any("acknowledged" in one for one in failed), failed


# The disk.


def tree(log: Log, cut: Cut) -> dict[str, bytes | None]:
    return dict(list_tree(apply(log, cut.changes)))


@pytest.fixture
def log() -> Log:
    """A file is written, synced and moved over another; then the folder is synced."""
    new = ".new"
    changes = [
        Entries(((ROOT, new, 2),)), Write(2, 0, b"after"), Sync(2), Entries(((ROOT, "a", 2), (ROOT, new, None))),
        Sync(ROOT), Mark("done"),
    ]  # fmt: skip
    return Log({ROOT: {"a": 1}, 1: b"before"}, {ROOT}, changes)


def test_what_is_synced_before_it_is_moved_is_whole_or_absent(log: Log) -> None:
    states = [tree(log, cut) for cut in list_cuts(log)]
    assert {state["a"] for state in states} == {b"before", b"after"}
    assert {state.get(".new") for state in states} == {
        None,
        b"",
        b"a",
        b"af",
        b"afte",
        b"after",
        bytes(5),
    }
    assert [tree(log, cut) for cut in list_cuts(log) if cut.marks] == [{"a": b"after"}]


def test_what_is_not_synced_may_be_half_there(log: Log) -> None:
    del log.steps[2]
    assert b"" in {tree(log, cut)["a"] for cut in list_cuts(log) if cut.marks}


def test_a_name_that_is_not_synced_may_be_the_former(log: Log) -> None:
    del log.steps[4]
    assert {tree(log, cut)["a"] for cut in list_cuts(log) if cut.marks} == {b"before", b"after"}


def test_a_move_between_folders_is_safe_where_its_folder_is_synced() -> None:
    moved = Entries(((3, "a", 1), (ROOT, "a", None)))
    log = Log({ROOT: {"a": 1, "b": 3}, 1: b"x", 3: {}}, {ROOT, 3}, [moved, Sync(3), Mark("done")])
    states = [tree(log, cut) for cut in list_cuts(log) if cut.marks]
    assert all(state["b/a"] == b"x" for state in states)
    assert {"a" in state for state in states} == {True, False}


def test_a_file_that_was_cut_may_be_long_again() -> None:
    log = Log({ROOT: {"a": 1}, 1: b"12345"}, {ROOT}, [Resize(1, 2)])
    assert {tree(log, cut)["a"] for cut in list_cuts(log)} == {b"12345", b"12"}


PROGRAM = """
import os, sys
folder = sys.argv[1]
os.mkdir(f"{folder}/sub")
with open(f"{folder}/sub/a", "wb") as file:
    file.write(b"one")
    file.flush()
    file.seek(1)
    file.write(b"ON")
    file.flush()
    os.fsync(file.fileno())
descriptor = os.open(f"{folder}/old", os.O_WRONLY | os.O_APPEND)
os.write(descriptor, b" and more")
os.ftruncate(descriptor, 5)
os.rename(f"{folder}/old", f"{folder}/sub/new")
place = os.open(folder, os.O_RDONLY)
os.fsync(place)
try:
    os.open("/acknowledged/it", os.O_RDONLY)
except FileNotFoundError:
    os.unlink(f"{folder}/sub/a")
"""


def test_a_program_is_recorded_as_it_was(place: Path) -> None:
    if not can_trace():
        pytest.skip("NO REPLAY OF POWER CUTS: strace is missing or may not trace")
    folder = place / "folder"
    folder.mkdir()
    (folder / "old").write_bytes(b"old")
    log = trace([sys.executable, "-c", PROGRAM, folder], folder, place / "calls.txt")
    changes = [one for one in log.steps if not isinstance(one, Mark | Sync)]
    assert dict(list_tree(apply(log, changes))) == {"sub": None, "sub/new": b"old a"}
    assert [one.text for one in log.steps if isinstance(one, Mark)] == ["it"]
    assert [one.place for one in log.steps if isinstance(one, Sync)] == [3, ROOT]
    assert apply(log, changes)[3] == b"oON"


def test_what_fails_is_named(log: Log, place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def lose(_cut: Cut, _folder: Path, _whole: Path) -> None:
        raise Lost("gone")

    check: tuple[Callable[..., None], Callable[..., None]] = (lose, lose)
    monkeypatch.setitem(CHECKS, "session", check)
    failed = replay("session", (log, place), [next(list_cuts(log))], place=place)
    assert len(failed) == 1
    assert failed[0].endswith("Lost: gone")
