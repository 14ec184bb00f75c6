"""Hostile machines: what the user is told in one line, what is kept, and that the same command then goes on."""

import ctypes
import re
import resource
import shutil
import subprocess
import sys
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from feel321.files import hold_lock
from feel321.study.cli import main
from feel321.study.folder import StudyFolder
from feel321.study.session.journal import read_journal
from tests.study.conftest import audit_study

CLONE_NEWNS = 0x00020000


def simulate(study: StudyFolder, *, participants: int = 2) -> int:
    return main(["simulate", str(study.path), "--participants", str(participants)])


@pytest.fixture(scope="module")
def whole(lab: Any, tmp_path_factory: pytest.TempPathFactory) -> StudyFolder:
    """A study that nothing happened to; not to be touched."""
    study = lab.make_study(tmp_path_factory.mktemp("whole") / "study")
    assert lab.processes.fork(partial(simulate, study)) == 0
    return study


@pytest.fixture
def study(lab: Any, tmp_path: Path) -> StudyFolder:
    return lab.make_study(tmp_path / "study")


@pytest.fixture
def finished(whole: StudyFolder, study: StudyFolder) -> StudyFolder:
    shutil.copytree(whole.sessions, study.sessions)
    shutil.copy(whole.ratings, study.ratings)
    return study


def mount(*arguments: object) -> None:
    subprocess.run(["mount", *map(str, arguments)], check=True, capture_output=True)


def leave_mounts() -> None:
    """Mount for this process only: what it mounts is gone with it."""
    if ctypes.CDLL(None, use_errno=True).unshare(CLONE_NEWNS) != 0:
        raise OSError(ctypes.get_errno(), "unshare")
    mount("--make-rprivate", "/")


@pytest.fixture(scope="module")
def may_mount(lab: Any) -> None:
    if sys.platform != "linux" or lab.processes.fork(leave_mounts) != 0:
        pytest.skip(
            "NO MOUNTS: small and read-only disks need the right to mount (root, CAP_SYS_ADMIN)"
        )


def limit_files(n_bytes: int) -> None:
    resource.setrlimit(resource.RLIMIT_FSIZE, (n_bytes, n_bytes))


def check_all_there(lab: Any, study: StudyFolder, whole: StudyFolder) -> None:
    """The same command goes on, and nothing is missing."""
    said = lab.processes.speak(partial(simulate, study), path=study.path)
    assert said.code == 0, said.err
    assert study.ratings.read_bytes() == whole.ratings.read_bytes()
    assert audit_study(study) == []


@pytest.mark.parametrize("n_bytes", [30_000, 30_123, 41_000])
def test_a_full_disk_under_a_journal(
    lab: Any, study: StudyFolder, whole: StudyFolder, n_bytes: int, tmp_path: Path
) -> None:
    said = lab.processes.speak(
        partial(limit_files, n_bytes), partial(simulate, study), path=tmp_path / "said"
    )
    assert said.code == 1
    assert said.err.splitlines()[-1:] == said.err.splitlines(), said.err
    assert said.err.startswith(f"feel321: {study.sessions}/sim00")
    assert said.err.endswith((
        "bytes; make room, then resume\n",
        "make room or repair the disk, then resume\n",
    ))
    # What was rated before is whole and in its place; the session beside the one that failed was told to stop.
    found = {
        path: [r for r in read_journal(path).records if r.event != "aborted"]
        for path in study.journals
    }
    assert max(map(len, found.values())) > 50
    for path, records in found.items():
        expected = read_journal(whole.sessions / path.relative_to(study.sessions)).records[
            : len(records)
        ]
        assert [r.data for r in records[1:]] == [r.data for r in expected[1:]]
    assert audit_study(study) == []
    check_all_there(lab, study, whole)


@pytest.mark.parametrize("n_bytes", [2_000, 9_000, 16_000])
def test_a_full_disk_under_a_plan(
    lab: Any, study: StudyFolder, whole: StudyFolder, n_bytes: int, tmp_path: Path
) -> None:
    said = lab.processes.speak(
        partial(limit_files, n_bytes), partial(simulate, study), path=tmp_path / "said"
    )
    assert (said.code, said.err.count("\n")) == (1, 1), said.err
    assert said.err.startswith(f"feel321: {study.sessions}")
    assert (
        "check that the folder may be written to, the disk has room" in said.err
        or "File too large" in said.err
    )
    check_all_there(lab, study, whole)


@pytest.mark.usefixtures("may_mount")
def test_a_read_only_folder_can_be_looked_at(
    lab: Any, finished: StudyFolder, tmp_path: Path
) -> None:
    def lock_folder() -> None:
        leave_mounts()
        mount("--bind", finished.path, finished.path)
        mount("-o", "remount,ro,bind", finished.path)

    before = {path: path.read_bytes() for path in finished.sessions.rglob("*") if path.is_file()}
    refused = lab.processes.speak(
        lock_folder, partial(simulate, finished, participants=3), path=tmp_path / "refused"
    )
    assert (refused.code, refused.err.count("\n")) == (1, 1), refused.err
    assert refused.err.startswith(f"feel321: {finished.sessions}")
    assert "Read-only file system" in refused.err
    for verb in ("status", "audit"):
        looked = lab.processes.speak(
            lock_folder, partial(main, [verb, str(finished.path)]), path=tmp_path / verb
        )
        assert (looked.code, looked.err) == (0, "")
    assert {
        path: path.read_bytes() for path in finished.sessions.rglob("*") if path.is_file()
    } == before


def test_a_second_writer_is_sent_away(lab: Any, finished: StudyFolder, tmp_path: Path) -> None:
    busy = hold_lock(finished.sessions / "sim001" / ".lock", busy="")
    with busy:
        simulated = lab.processes.speak(partial(simulate, finished), path=tmp_path / "simulated")
        arguments = ["withdraw", str(finished.path), "--participant", "sim001", "--yes"]
        withdrawn = lab.processes.speak(partial(main, arguments), path=tmp_path / "withdrawn")
    folder = finished.sessions / "sim001"
    assert (
        simulated.err
        == f"feel321: {folder}: another session is writing here; let it finish or stop it first\n"
    )
    assert (
        withdrawn.err
        == f"feel321: {folder}: a session is running here; let it finish or stop it first\n"
    )
    assert (simulated.code, withdrawn.code) == (1, 1)
    assert audit_study(finished) == []


def test_a_withdrawal_while_others_are_simulated(
    lab: Any, finished: StudyFolder, tmp_path: Path
) -> None:
    child, (_, err) = lab.processes.whisper(
        partial(simulate, finished, participants=6), path=tmp_path / "simulated"
    )
    arguments = ["withdraw", str(finished.path), "--participant", "sim002", "--yes"]
    withdrawn = lab.processes.speak(partial(main, arguments), path=tmp_path / "withdrawn")
    code = lab.processes.wait(child)
    simulated = err.read_text(encoding="utf-8")
    assert (code, withdrawn.code) in {(0, 0), (0, 1), (1, 0)}, simulated + withdrawn.err
    said = (simulated + withdrawn.err).splitlines()
    # A plan of somebody else may be under way just then: at most that is warned of, and nothing else.
    under_way = re.compile(
        rf"feel321: warning: {finished.sessions}/sim00[13456]/\.plan\.json\.[\w.]+\.part: "
        "is still being written; when it is finished, run feel321 audit"
    )
    assert sum(not under_way.fullmatch(line) for line in said) <= 1 + withdrawn.code
    again = lab.processes.speak(partial(main, arguments), path=tmp_path / "again")
    assert again.code == int(withdrawn.code == 0)
    assert (
        lab.processes.speak(
            partial(simulate, finished, participants=6), path=tmp_path / "last"
        ).code
        == 0
    )
    assert audit_study(finished) == []
    assert b"sim002" not in finished.ratings.read_bytes()


def test_a_clock_that_is_set_back_while_nobody_is_there(lab: Any, tmp_path: Path) -> None:
    session = lab.session("abx", "observer")
    study = session.make_study(tmp_path / "study")
    kill = lab.place(0.5, task="abx", presenter="observer")
    assert lab.processes.fork(partial(session.lead, study), kill=kill) < 0
    session.lead(study, later_h=-2.0)
    (journal,) = study.journals
    stepped = [
        record.data["back_s"]
        for record in read_journal(journal).records
        if record.event == "clock_stepped"
    ]
    assert stepped == [pytest.approx(7200, abs=60)]
    assert audit_study(study) == []
