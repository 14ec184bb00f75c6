"""Server or network lost in mid-session: the session goes on by its journal, and the ledger follows later."""

from __future__ import annotations

import subprocess
import sys
import time
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from feel321.study.auditing.study import audit_study
from feel321.study.ledger import database, slots
from feel321.study.ledger.keeper import Keeper
from feel321.study.session.journal import create_journal, list_journals, read_journal
from feel321.study.session.ports import Place
from feel321.study.status import read_status

if TYPE_CHECKING:
    from collections.abc import Callable

    import pytest

    from feel321.study.folder import StudyFolder


def tell_time() -> datetime:
    return datetime.now(UTC)


def wait_for(path: Path, lines: int, process: subprocess.Popen[str]) -> None:
    while process.poll() is None and not (path.exists() and path.read_bytes().count(b"\n") > lines):
        time.sleep(0.02)


def test_a_session_outlives_its_server(
    login: Any, make_station: Callable[..., StudyFolder], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Stopped first, as a server or network that does not answer; then killed."""
    study = make_station("one", login.url)
    study.settings.write_text(study.settings.read_text().replace("repeats = 2", "repeats = 150"))
    journal = study.sessions / "sim001" / "session-01.jsonl"
    command = [
        Path(sys.executable).with_name("feel321"),
        "simulate",
        study.path,
        "--participants",
        "1",
    ]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process:
        wait_for(journal, 60, process)
        login.freeze()
        frozen_at = journal.read_bytes().count(b"\n")
        wait_for(journal, frozen_at + 60, process)
        login.kill()
        killed_at = journal.read_bytes().count(b"\n")
        _, printed = process.communicate()
    assert (process.returncode, printed.count("out of reach")) == (0, 1)
    assert printed.startswith(f"feel321: warning: {journal}: the ledger lags behind (postgresql")
    records = read_journal(journal).records
    assert records[-1].event == "finished"
    assert frozen_at < killed_at < len(records)
    assert read_status(study).stations[0].startswith("postgresql+psycopg://")
    login.start()
    (entry,) = slots.read_study_ledger(study)
    assert entry.state == "running"
    assert sum(anchor.lines for anchor in entry.anchors) < len(records)
    assert audit_study(study) == []  # The ledger may lag behind.
    slots.open_study_ledger(study)
    (entry,) = slots.read_study_ledger(study)
    assert (entry.state, entry.done, entry.anchors[0].lines) == ("finished", 300, len(records))
    monkeypatch.setenv("FEEL321_STATION", "two")
    other = make_station("two", login.url)
    (shown,) = read_status(other).participants
    assert (shown.state, shown.done, shown.warnings) == (
        "finished",
        300,
        ("at station one, by the ledger",),
    )


def test_no_trial_waits_for_a_server(
    login: Any, make_station: Callable[..., StudyFolder], monkeypatch: pytest.MonkeyPatch
) -> None:
    study, told = make_station("one", login.url), []
    ledger, _ = slots.open_study_ledger(study)
    slots.claim_numbers(study, ledger, ["p01"], simulated=False, now=tell_time)
    (study.sessions / "p01").mkdir()
    journal = create_journal(study.sessions / "p01" / "session-01.jsonl", now=tell_time)
    keeper = Keeper(ledger, journal, every=1, warn=told.append)
    monkeypatch.setattr(database, "CONNECT_S", 2)
    login.freeze()
    try:
        for done in range(5):
            journal.write("rated")
            keeper.see(Place(done, 9))
        first = keeper._sent
        assert first is not None
        assert not first.done()  # All five returned while the first note was under way.
        first.result()
        for done in range(5, 7):
            journal.write("rated")
            keeper.see(Place(done, 9))
            assert keeper._sent is not None
            keeper._sent.result()
    finally:
        login.thaw()
    journal.write("rated")
    keeper.see(Place(7, 9))
    keeper.close()
    assert len(told) == 1  # Said once, however often it was tried.
    assert "the ledger is out of reach" in told[0]
    assert keeper.notice == ""
    (entry,) = database.read_ledger(ledger)
    assert (entry.done, entry.anchors[0].lines) == (7, 8)
    assert list_journals(study.sessions / "p01") == [journal.path]
