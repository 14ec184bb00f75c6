"""The page of running sessions: renewed beside real processes, whole at any time, and blind."""

import json
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest

from feel321.stimuli.sets.manifest import read_stimuli
from feel321.study import status
from feel321.study.cli import main
from feel321.study.folder import StudyFolder
from feel321.study.session import events
from feel321.study.session import journal as journals
from feel321.study.session.plan import PLAN_FILE, require_plan

STATION = Path(__file__).with_name("station.py")
NOON = datetime(2026, 1, 1, 12, tzinfo=UTC)
QUICK = """
import sys
from feel321.study import cli, status
status.EVERY_S = 0.2
sys.exit(cli.main(sys.argv[1:]))
"""
"""The command line, with a page that is renewed five times per s."""


def write_page(study: StudyFolder) -> str:
    return status.write_page(study, {}, NOON)


def read_row(page: str, participant: str) -> list[str]:
    """The cells of a participant's row, without tags."""
    rows = [row for row in page.split("<tr") if f">{participant}" in row]
    return re.findall(r"<t[hd][^>]*>([^<]*)</t[hd]>", rows[0]) if rows else []


def wait_until(find: Callable[[], bool]) -> None:
    end_s = time.monotonic() + 120
    while not find():
        assert time.monotonic() < end_s
        time.sleep(0.02)


def list_names(study: StudyFolder) -> set[str]:
    rows = read_stimuli(study.stimuli)
    return {
        name for row in rows for name in (row.stimulus_id, row.recording, row.reducer, row.level)
    }


def test_the_page_follows_a_session_until_both_end(copied: StudyFolder, tmp_path: Path) -> None:
    page, pages = tmp_path / "sessions.html", set[str]()
    before = {path: path.read_bytes() for path in copied.sessions.rglob("*.json*")}
    session = subprocess.Popen([sys.executable, STATION, str(copied.path), "p01", "3", "0.3"])
    watching = subprocess.Popen(
        [sys.executable, "-c", QUICK, "status", str(copied.path), "--watch", str(page)],
        text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
    )  # fmt: skip

    def see() -> list[str]:
        """Read the page as a browser may at any time: it is whole or absent."""
        if not page.exists():
            return []
        pages.add(text := page.read_text(encoding="utf-8"))
        assert text.rstrip().endswith("</html>")
        return read_row(text, "p01")

    try:
        wait_until(lambda: watching.poll() is not None or see()[7:8] not in ([], [""]))
        first = see()
        assert (first[1], first[4], first[7]) == ("running", "10", "1 x underrun")
        assert 0 <= int(first[5]) < 10
        wait_until(lambda: see()[2] != first[2])
        session.kill()
        session.wait()
        wait_until(lambda: see()[1] == "aborted")
        watching.send_signal(signal.SIGINT)
        printed, told = watching.communicate(timeout=120)
    finally:
        for process in (session, watching):
            process.kill()
            process.wait()
    assert (watching.returncode, told) == (0, f"{page}\n")
    assert printed.startswith("participant ")
    assert len(pages) > 3
    assert all('<meta http-equiv="refresh"' in text for text in pages)
    last = page.read_text(encoding="utf-8")
    assert "http-equiv" not in last
    assert "no longer renewed" in last
    names = list_names(copied)
    assert len(names) > 6
    for text in (*pages, last):
        assert not re.search(rf"\b({'|'.join(map(re.escape, names))})\b", text)
    assert {path: path.read_bytes() for path in before} == before
    assert page.stat().st_mode & 0o077 == 0


# Blindness, as a law: whatever is rated, the same is shown.


def rewrite(path: Path, change: Callable[[str, dict[str, Any]], None]) -> None:
    """Write a journal anew, as it would be had other things happened."""
    tip, lines = journals.START, []
    for record in journals.read_journal(path).records:
        data = json.loads(json.dumps(dict(record.data)))
        change(record.event, data)
        lines.append(journals.write_line(replace(record, data=data), tip))
        tip = journals.digest(lines[-1].rstrip(b"\n"))
    path.write_bytes(b"".join(lines))


def test_other_ratings_show_the_same(copied: StudyFolder) -> None:
    before, changed = write_page(copied), 0
    for folder in copied.participants:
        plan = require_plan(folder / PLAN_FILE)
        free = {trial.number for trial in plan.trials if trial.phase == "main" and not trial.catch}

        def change(event: str, data: dict[str, Any], free: set[int] = free) -> None:
            nonlocal changed
            if event == "rated" and data["trial"] in free:
                data["values"] = {key: 100 - value for key, value in data["values"].items()}
                changed += 1

        for path in journals.list_journals(folder):
            rewrite(path, change)
    assert changed == 8  # of two participants
    assert write_page(copied) == before


def add(study: StudyFolder, event: str, **data: Any) -> None:
    journal = journals.require_journal(
        study.sessions / "sim001" / "session-01.jsonl", now=lambda: NOON
    )
    journal.write(events.find_kind(event)(**data))


def test_free_words_are_not_shown_and_who_is_called_for_stands_first(copied: StudyFolder) -> None:
    add(copied, "note", text="the mag321 of bumps felt odd")
    add(copied, "device_failed", reason="mag321 of bumps was lost", time_s=99.0)
    page = write_page(copied)
    assert "mag321" not in page
    assert read_row(page, "sim001")[1] == "experimenter called"
    assert page.index(">sim001") < page.index(">sim002")
    add(copied, "page", key="call_us", time_s=100.0, stood_s=1.0)
    assert read_row(write_page(copied), "sim001")[1] == "finished"
    add(copied, "device_failed", reason="lost", time_s=101.0)
    add(copied, "released")
    assert read_row(write_page(copied), "sim001")[1] == "released"


def test_what_cannot_be_read_is_named_and_hides_nobody_else(copied: StudyFolder) -> None:
    (copied.sessions / "sim001" / PLAN_FILE).write_text('{"mag321": 1}', encoding="utf-8")
    copied.manifest.unlink()
    page = write_page(copied)
    assert "mag321" not in page
    assert read_row(page, "sim001")[1:] == [
        "unreadable", *("0", "0", "0"), *[""] * 2, "run feel321 audit",
    ]  # fmt: skip
    assert read_row(page, "sim002")[1:4] == ["finished", "10", "0"]
    assert "Nobody has begun yet." in write_page(replace(copied, is_rehearsal=True))


def test_no_other_file_is_overwritten(
    copied: StudyFolder, capsys: pytest.CaptureFixture[str]
) -> None:
    before = copied.settings.read_bytes()
    assert main(["status", str(copied.path), "--watch", str(copied.settings)]) == 1
    assert "exists and is no page of status --watch" in capsys.readouterr().err
    assert main(["status", str(copied.path), "--watch", "page.html", "--notes"]) == 2
    assert copied.settings.read_bytes() == before
