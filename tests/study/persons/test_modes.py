"""Who may read what a participant gave: from the first byte, whatever the umask is."""

from __future__ import annotations

import os
import stat
import sys
from datetime import UTC, datetime
from typing import TYPE_CHECKING

import pytest

from feel321.study.persons.places import list_places
from feel321.study.simulation import simulate_study

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from feel321.study.folder import StudyFolder

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="Windows knows no modes")

ASKING = '[[session.questions]]\nuse = "demographics"\n'


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
        file.write(f"{ASKING}[data]\ngroup_readable = {str(is_shared).lower()}\n")
    opened: list[tuple[str, int]] = []
    original = os.open

    def note(path: str, flags: int, mode: int = 0o777, **rest: int) -> int:
        if flags & os.O_CREAT and "sessions" in str(path):
            opened.append((str(path), mode))
        return original(path, flags, mode, **rest)

    monkeypatch.setattr(os, "open", note)
    simulate_study(smallest, participants=1, seed=3, now=lambda: datetime.now(UTC))
    file_mode, folder_mode = (0o640, 0o750) if is_shared else (0o600, 0o700)
    places = {
        place.path: place.kind
        for place in list_places(smallest)
        if place.kind not in {"temporary", "checkpoints"}
    }
    assert {"plan", "journal", "personal", "ledger", "ratings", "roster", "answers"} <= {
        *places.values()
    }
    assert {path.name: oct(find_mode(path)) for path in places} == {
        path.name: oct(file_mode) for path in places
    }
    folders = [smallest.sessions, *(path for path in smallest.sessions.rglob("*") if path.is_dir())]
    assert {find_mode(path) for path in folders} == {folder_mode}
    assert len(opened) > 5
    assert {mode for _, mode in opened} == {file_mode}
