"""Who may read what a participant gave: from the first byte, whatever the umask is."""

import os
import stat
import sys
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path

import pytest

from feel321.study.folder import StudyFolder
from feel321.study.participants.traces import recording_output
from feel321.study.simulate import simulate_study
from tests.study.participants.conftest import ASKING

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="Windows knows no modes")


@pytest.fixture
def usual_umask() -> Iterator[None]:
    before = os.umask(0o022)
    yield
    os.umask(before)


def find_mode(path: Path) -> int:
    return stat.S_IMODE(path.lstat().st_mode)


@pytest.mark.usefixtures("usual_umask")
@pytest.mark.parametrize("is_shared", [False, True])
def test_places_are_their_owners_from_the_first_byte(
    smallest: StudyFolder, monkeypatch: pytest.MonkeyPatch, *, is_shared: bool
) -> None:
    with smallest.settings.open("a", encoding="utf-8") as file:
        file.write(ASKING)
    smallest.make_sessions()
    file_mode, folder_mode = (0o640, 0o750) if is_shared else (0o600, 0o700)
    smallest.sessions.chmod(folder_mode)
    opened: list[tuple[str, int]] = []
    original = os.open

    def note(path: str, flags: int, mode: int = 0o777, **rest: int) -> int:
        if flags & os.O_CREAT and "sessions" in str(path):
            opened.append((str(path), mode))
        return original(path, flags, mode, **rest)

    monkeypatch.setattr(os, "open", note)
    simulate_study(smallest, participants=1, seed=3, now=lambda: datetime.now(UTC))
    tables = [smallest.path / f"{name}.csv" for name in ("ratings", "participants", "answers")]
    files = [*tables, *(path for path in smallest.sessions.rglob("*") if path.is_file())]
    assert {"plan.json", "session-01.jsonl", "personal.jsonl"} <= {path.name for path in files}
    assert {path.name: oct(find_mode(path)) for path in files} == {
        path.name: oct(file_mode) for path in files
    }
    folders = [smallest.sessions, *(path for path in smallest.sessions.rglob("*") if path.is_dir())]
    assert {find_mode(path) for path in folders} == {folder_mode}
    assert len(opened) > 5
    assert {mode for _, mode in opened} == {file_mode}


@pytest.mark.parametrize(("folder_mode", "file_mode"), [(0o700, 0o600), (0o750, 0o640)])
def test_results_are_as_private_as_the_sessions(
    smallest: StudyFolder, folder_mode: int, file_mode: int
) -> None:
    smallest.make_sessions()
    smallest.sessions.chmod(folder_mode)
    with recording_output(smallest, "analyze", smallest.report, now=lambda: datetime.now(UTC)):
        (smallest.report / "tables").mkdir()
        (smallest.report / "tables" / "raters.csv").touch()
    found = [smallest.report, *smallest.report.rglob("*")]
    assert [find_mode(path) for path in found] == [folder_mode, folder_mode, file_mode]
    assert not (smallest.path / "outputs.jsonl").exists()
