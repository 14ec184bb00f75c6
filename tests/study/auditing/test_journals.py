"""Journals beside each other: how one follows another, and headers that are none."""

from __future__ import annotations

from dataclasses import replace
from datetime import datetime, timedelta
from typing import TYPE_CHECKING, Any

import pytest

from feel321.study.auditing.journals import audit_journals
from feel321.study.session.journal import START, create_journal, digest, read_journal, write_line
from feel321.study.session.plan import POLICIES, Stale, require_plan

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from feel321.study.session.journal import Record

    Present = Callable[..., list[Record]]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """The participant's folder that `present` writes to."""
    return tmp_path / "sessions" / "p01"


def audit(folder: Path) -> list[str]:
    return list(audit_journals(folder, require_plan(folder / "plan.json")))


def leave(present: Present, scripted: type, now: Callable[[], datetime], *, policy: str) -> None:
    """Leave a session for a day, then come back and finish."""
    with pytest.raises(KeyboardInterrupt):
        present(scripted(stop_after=4))
    present(scripted(), now=lambda: now() + timedelta(days=1), stale=Stale(6.0, policy))


def forge(path: Path, records: list[Record]) -> None:
    content, tip = b"", START
    for sequence, record in enumerate(records):
        line = write_line(replace(record, sequence=sequence), tip)
        content, tip = content + line, digest(line.rstrip(b"\n"))
    path.write_bytes(content)


@pytest.mark.parametrize("policy", POLICIES)
def test_who_comes_back_after_a_day_gives_no_finding(
    present: Present, scripted: type, now: Callable[[], datetime], folder: Path, policy: str
) -> None:
    leave(present, scripted, now, policy=policy)
    assert len(list(folder.glob("session-*.jsonl"))) == 1 + (policy == "restart")
    assert audit(folder) == []


def test_a_second_session_that_took_no_ones_place_is_found(
    present: Present, scripted: type, now: Callable[[], datetime], folder: Path
) -> None:
    leave(present, scripted, now, policy="restart")
    first = folder / "session-01.jsonl"
    forge(first, [record for record in read_journal(first).records if record.event != "superseded"])
    assert audit(folder) == [f"{first}: does not mention session-02.jsonl, which stands beside it"]
    first.unlink()
    assert audit(folder) == [
        f"{folder / 'session-02.jsonl'}: is there without session-01.jsonl before it"
    ]


@pytest.mark.parametrize("events", [[], ["recovered"], ["recovered", "clock_stepped", "released"]])
def test_a_session_without_a_header_that_a_crash_left_gives_no_finding(
    present: Present, scripted: type, now: Callable[[], datetime], folder: Path, events: list[str]
) -> None:
    present(scripted())
    path = folder / "session-01.jsonl"
    path.unlink()
    journal = create_journal(path, now=now)
    for event in events:
        journal.write(event, {})
    assert audit(folder) == []
    journal.write("finished", {})
    assert audit(folder) == [f"{path}: has no header"]


@pytest.mark.parametrize(
    "change", [{"participant": None}, {"session": "x"}, {"session": None}, {"session": []}]
)
def test_a_header_with_other_types_is_a_finding(
    present: Present, scripted: type, folder: Path, change: dict[str, Any]
) -> None:
    first, *others = present(scripted())
    path = folder / "session-01.jsonl"
    forge(path, [replace(first, data={**first.data, **change}), *others])
    assert audit(folder)[0].startswith(str(path))
    forge(path, [replace(first, data={}), *others])
    assert audit(folder) == [
        f"{path}, line 1: is not a 'begun' record as feel321 writes it (format: Field required)"
    ]


def test_a_folder_in_the_place_of_a_journal_is_a_finding(
    present: Present, scripted: type, folder: Path
) -> None:
    present(scripted())
    (folder / "session-02.jsonl").mkdir()
    assert (
        f"{folder / 'session-02.jsonl'}: there is no such journal; begin the session first"
        in audit(folder)
    )
