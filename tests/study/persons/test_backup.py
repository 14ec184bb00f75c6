"""Backups: whole or the old one, bit for bit, also while a session runs; who withdrew does not come back."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import threading
from datetime import datetime
from functools import partial
from typing import TYPE_CHECKING, Any

import pytest

from feel321.study.auditing.sealing import seal_study, sealing_analysis
from feel321.study.auditing.study import audit_study
from feel321.study.folder import StudyFolder
from feel321.study.ledger.database import read_ledger
from feel321.study.ledger.progress import read_tombstone
from feel321.study.ledger.slots import open_study_ledger
from feel321.study.persons import backup as backups
from feel321.study.persons.withdrawal import withdraw_participant
from feel321.study.simulation import simulate_study
from tests.study.persons.conftest import copy_study, now

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path


def read_files(study: StudyFolder) -> dict[str, tuple[bytes, int]]:
    """Read all that a backup is to hold, with modes; the ledger by what it says."""
    found = {}
    for path in study.path.rglob("*"):
        name = path.relative_to(study.path).as_posix()
        if path.is_file() and not name.endswith(".lock") and "ledger.sqlite" not in name:
            found[name] = (path.read_bytes(), path.stat().st_mode)
    return found


@pytest.fixture
def held(made_open: StudyFolder, tmp_path: Path) -> StudyFolder:
    """A study in which three have finished."""
    return copy_study(made_open, tmp_path / "study")


def test_there_and_back_is_bit_for_bit(held: StudyFolder, tmp_path: Path) -> None:
    first = backups.back_up(held, tmp_path / "safe", now=now)
    before, known = read_files(held), read_ledger(open_study_ledger(held)[0])
    again = backups.back_up(held, tmp_path / "safe", now=now)
    assert first.new > 10
    assert again.new <= 2  # the note that a backup was made, and the time in it
    done = backups.restore(tmp_path / "safe", tmp_path / "back", now=now)
    back = StudyFolder(tmp_path / "back")
    after = read_files(back)
    assert {n: one for n, one in after.items() if n != "outputs.jsonl"} == {
        name: one for name, one in before.items() if name != "outputs.jsonl"
    }
    assert read_ledger(open_study_ledger(back)[0]) == known
    assert (done.notes, audit_study(back)) == ((), [])
    with pytest.raises(FileExistsError, match="already exists, and nothing is overwritten"):
        backups.restore(tmp_path / "safe", tmp_path / "back", now=now)


@pytest.mark.parametrize("known_by", ["live study", "list beside the backup", "next backup"])
def test_who_withdrew_is_not_brought_back(held: StudyFolder, tmp_path: Path, known_by: str) -> None:
    safe = tmp_path / "safe"
    backups.back_up(held, safe, now=now)
    mark = (held.sessions / "sim002" / "session-01.jsonl").read_bytes()
    now_then = partial(datetime.fromisoformat, "2026-02-03T04:05:06+00:00")
    if known_by == "live study":
        shutil.copytree(safe, tmp_path / "other")  # a copy of the backup that nobody told
        withdraw_participant(held, "sim002", now=now_then)
        safe = tmp_path / "other"
    else:
        withdraw_participant(held, "sim002", now=now_then)
        assert [*json.loads((safe / "withdrawn.json").read_text())] == ["sim002"]
        if known_by == "next backup":
            backups.back_up(held, safe, now=now)
            kept = [path.read_bytes() for path in (safe / "objects").rglob("*") if path.is_file()]
            assert mark not in kept
        else:
            shutil.rmtree(held.path)
    backups.restore(safe, tmp_path / "back", now=now)
    back = StudyFolder(tmp_path / "back")
    assert [path.name for path in (back.sessions / "sim002").iterdir()] == ["withdrawn.json"]
    assert not any(mark in content for content, _ in read_files(back).values())
    assert (back.sessions / "sim001" / "session-01.jsonl").exists()
    states = {one.participant: one.state for one in read_ledger(open_study_ledger(back)[0])}
    assert states["sim002"] == "withdrawn"
    stone = read_tombstone(back.sessions / "sim002")
    assert stone
    assert stone.utc == now_then().isoformat(timespec="seconds")
    assert audit_study(back) == []


def test_a_backup_while_sessions_run_is_consistent(
    made_asking: StudyFolder, tmp_path: Path
) -> None:
    smallest = copy_study(made_asking, tmp_path / "study")
    thread = threading.Thread(
        target=lambda: simulate_study(smallest, participants=6, seed=3, now=now)
    )
    thread.start()
    rounds = 0
    while thread.is_alive() or not rounds:
        backups.back_up(smallest, tmp_path / "safe", now=now)
        backups.restore(tmp_path / "safe", tmp_path / f"back{rounds}", now=now)
        back = StudyFolder(tmp_path / f"back{rounds}")
        assert audit_study(back) == [], rounds
        rounds += 1
    thread.join()


def test_what_comes_up_after_a_journal_was_copied_is_in_the_next_backup(
    held: StudyFolder, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    later = ("checkpoints.jsonl", "ratings.csv", "participants.csv")
    kept = {name: (held.path / name).read_bytes() for name in later}
    for name in later:
        (held.path / name).unlink()
    copy_file = backups._Copy.copy

    def copy(self: Any, path: Path) -> None:
        copy_file(self, path)
        if path.name == "session-01.jsonl":  # the first session ends just then
            for name in later:
                (held.path / name).write_bytes(kept[name])

    monkeypatch.setattr(backups._Copy, "copy", copy)
    backups.back_up(held, tmp_path / "safe", now=now)
    assert not {*later} & backups.read_manifest(tmp_path / "safe")["files"].keys()
    backups.back_up(held, tmp_path / "safe", now=now)
    assert {*later} <= backups.read_manifest(tmp_path / "safe")["files"].keys()


def test_results_that_are_written_meanwhile_are_never_newer_than_their_checkpoint(
    held: StudyFolder, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    held.report.mkdir()
    (held.report / "results.json").write_text("old")
    seal_study(held, now=now)
    copy_file, times = backups._Copy.copy, []

    def copy(self: Any, path: Path) -> None:
        if path.name == "results.json" and not times:  # an analysis begins and ends just then
            times.append(path)
            with sealing_analysis(held):
                path.write_text("new")
        copy_file(self, path)

    monkeypatch.setattr(backups._Copy, "copy", copy)
    backups.back_up(held, tmp_path / "safe", now=now)
    backups.restore(tmp_path / "safe", tmp_path / "back", now=now)
    back = StudyFolder(tmp_path / "back")
    assert (back.report / "results.json").read_text() == "new"
    assert not [one for one in audit_study(back) if "was changed" in one]


DYING = """
import os, signal, sys
from datetime import datetime
from functools import partial
from pathlib import Path
from feel321.study.folder import StudyFolder
from feel321.study.persons import backup
import filelock
verb, root, steps = sys.argv[1], Path(sys.argv[2]), [int(one) for one in sys.argv[3].split(",")]
watched = {"open", "os.remove", "os.rename", "os.rmdir", "os.mkdir", "os.chmod", "sqlite3.connect"}
def now():
    return datetime.now(UTC)
def die_at(last):
    left = last
    def count(event, arguments):
        nonlocal left
        if event in watched and root.name in str(arguments[0]):
            left -= 1
            if left < 0:
                os.kill(os.getpid(), signal.SIGKILL)
    sys.addaudithook(count)
for step in steps:
    home, child = root / str(step), os.fork()
    if not child:
        die_at(step)
        if verb == "backup":
            backup.back_up(StudyFolder(root / "study"), home / "safe", now=now)
        else:
            backup.restore(root / "safe", home / "back", now=now)
        os._exit(0)
    _, status = os.waitpid(child, 0)
    print(step, "whole" if os.WIFEXITED(status) else "killed", flush=True)
"""


@pytest.mark.parametrize("stride", [500, pytest.param(3, marks=pytest.mark.soak)])
def test_a_backup_that_is_killed_is_the_old_one_or_the_new(
    held: StudyFolder, tmp_path: Path, stride: int
) -> None:
    (root := tmp_path / "kills").mkdir()
    shutil.copytree(held.path, root / "study")
    study = StudyFolder(root / "study")
    old = backups.back_up(study, root / "safe", now=now)
    (study.sessions / "sim003" / "more.txt").write_text("new")
    manifest = (root / "safe" / "backup.json").read_bytes()
    steps = range(0, 620, stride)
    for step in steps:
        shutil.copytree(root / "safe", root / str(step) / "safe")
    shutil.rmtree(root / "safe")
    listed = ",".join(map(str, steps))
    done = subprocess.run(
        [sys.executable, "-c", DYING, "backup", root, listed],
        capture_output=True,
        text=True,
        check=True,
    )
    ends = dict(line.split() for line in done.stdout.splitlines())
    assert {"killed", "whole"} == set(ends.values())
    for step in steps:
        safe = root / str(step) / "safe"
        is_old = (safe / "backup.json").read_bytes() == manifest
        found = backups.restore(safe, tmp_path / f"back{step}", now=now)
        assert found.files == old.files + (not is_old)
        assert (tmp_path / f"back{step}" / "sessions" / "sim003" / "more.txt").exists() != is_old
        backups.back_up(study, safe, now=now)
        assert not list(safe.rglob("*.part"))


@pytest.mark.parametrize("stride", [800, pytest.param(5, marks=pytest.mark.soak)])
def test_a_restore_that_is_killed_goes_on(held: StudyFolder, tmp_path: Path, stride: int) -> None:
    (root := tmp_path / "kills").mkdir()
    backups.back_up(held, root / "safe", now=now)
    withdraw_participant(held, "sim002", now=now)
    steps = range(0, 840, stride)
    for step in steps:
        (root / str(step)).mkdir()
    listed = ",".join(map(str, steps))
    done = subprocess.run(
        [sys.executable, "-c", DYING, "restore", root, listed],
        capture_output=True,
        text=True,
        check=True,
    )
    ends = dict(line.split() for line in done.stdout.splitlines())
    assert {"killed", "whole"} == set(ends.values())
    for step in steps:
        back = StudyFolder(root / str(step) / "back")
        if not back.path.exists():
            backups.restore(root / "safe", back.path, now=now)
        assert audit_study(back) == [], step
        assert (back.sessions / "sim002" / "withdrawn.json").exists()
        assert {path.name for path in (root / str(step)).iterdir()} - {".back.lock"} == {"back"}


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda safe: next((safe / "objects").glob("*/*")).write_bytes(b""), "is damaged"),
        (lambda safe: (safe / "backup.json").write_text("{}"), "not a whole backup"),
        (lambda safe: (safe / "backup.json").unlink(), "no backup is there"),
        (lambda safe: (safe / "withdrawn.json").write_text("7"), "which codes withdrew and when"),
    ],
)
def test_what_is_damaged_is_refused(
    held: StudyFolder, tmp_path: Path, damage: Callable[[Path], Any], message: str
) -> None:
    backups.back_up(held, tmp_path / "safe", now=now)
    damage(tmp_path / "safe")
    with pytest.raises((OSError, ValueError), match=message):
        backups.restore(tmp_path / "safe", tmp_path / "back", now=now)
    assert not (tmp_path / "back").exists()


def test_a_backup_has_a_folder_of_its_own(held: StudyFolder, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="must not contain the study"):
        backups.back_up(held, held.path / "safe", now=now)
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "mine").touch()
    with pytest.raises(FileExistsError, match="holds other files"):
        backups.back_up(held, tmp_path / "full", now=now)
    backups.back_up(held, tmp_path / "safe", now=now)
    moved = StudyFolder(held.path.rename(tmp_path / "moved"))
    with pytest.raises(ValueError, match="holds the backup of"):
        backups.back_up(moved, tmp_path / "safe", now=now)
