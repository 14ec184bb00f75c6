from __future__ import annotations

import signal
import sqlite3
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from typing import TYPE_CHECKING, Any

import pytest

import feel321.study.ledger.database
from feel321.study.ledger.database import open_ledger, read_ledger
from feel321.study.ledger.keeper import note_progress
from feel321.study.ledger.slots import claim_slots
from feel321.study.session.journal import Anchor

if TYPE_CHECKING:
    from collections.abc import Callable
    from datetime import datetime
    from pathlib import Path

    from sqlalchemy import Engine

    Now = Callable[[], datetime]

CLAIM = """
import sys
from datetime import UTC, datetime
from pathlib import Path
from feel321.study.ledger.database import open_ledger
from feel321.study.ledger.slots import claim_slots
path, name, count = Path(sys.argv[1]), sys.argv[2], int(sys.argv[3])
sys.stdin.readline()
for place in range(count):
    claim_slots(open_ledger(path), [f"{name}-{place}"], simulated=True, now=lambda: datetime.now(UTC))
    print(place, flush=True)
"""


@pytest.fixture
def ledger(tmp_path: Path) -> Engine:
    return open_ledger(tmp_path / "ledger.sqlite")


def slots(ledger: Engine) -> dict[str, tuple[int, str]]:
    return {entry.participant: (entry.number, entry.state) for entry in read_ledger(ledger)}


def note(
    ledger: Engine, participant: str, *, lines: int = 1, tip: str = "a", **changes: Any
) -> None:
    known = {
        "journal": "session-01.jsonl",
        "lines": lines,
        "tip": tip,
        "done": 0,
        "total": 4,
        "state": "running",
    }
    noted = known | changes
    anchor = Anchor(*(noted.pop(name) for name in ("journal", "lines", "tip")))
    note_progress(ledger, participant, anchor=anchor, **noted)


def test_slots_are_claimed_in_order_and_kept(ledger: Engine, now: Now) -> None:
    assert claim_slots(ledger, ["p02", "p01"], simulated=False, now=now) == {"p02": 1, "p01": 2}
    assert claim_slots(ledger, ["p03", "p01", "p03"], simulated=False, now=now) == {
        "p03": 3,
        "p01": 2,
    }
    (entry,) = [entry for entry in read_ledger(ledger) if entry.participant == "p03"]
    assert (entry.state, entry.claimed_utc, entry.anchors) == (
        "claimed",
        "2026-01-01T12:00:00+00:00",
        (),
    )


@pytest.mark.parametrize("names", [["P01"], ["p02", "P02"]])
def test_codes_that_name_one_folder_elsewhere_are_refused(
    ledger: Engine, now: Now, names: list[str]
) -> None:
    claim_slots(ledger, ["p01"], simulated=False, now=now)
    with pytest.raises(
        ValueError, match=r"participant P0\d: differs from p0\d in capitals only; use another code"
    ):
        claim_slots(ledger, names, simulated=False, now=now)
    assert list(slots(ledger)) == ["p01"]


def test_simulated_and_real_people_are_counted_apart(ledger: Engine, now: Now) -> None:
    claim_slots(ledger, ["p01", "p02"], simulated=False, now=now)
    assert claim_slots(ledger, ["sim001"], simulated=True, now=now) == {"sim001": 1}


@pytest.mark.parametrize("state", ["released", "withdrawn"])
def test_a_slot_that_was_given_up_goes_to_the_next_one_and_its_code_to_nobody(
    ledger: Engine, now: Now, state: str
) -> None:
    claim_slots(ledger, ["p01", "p02", "p03"], simulated=False, now=now)
    note(ledger, "p02", state=state)
    assert claim_slots(ledger, ["p04", "p05"], simulated=False, now=now) == {"p04": 2, "p05": 4}
    with pytest.raises(
        ValueError, match=f"participant p02: was {state}; no code is used twice, use another"
    ):
        claim_slots(ledger, ["p06", "p02"], simulated=False, now=now)
    assert "p06" not in slots(ledger)  # All or nobody.


def test_a_finished_participant_keeps_the_slot(ledger: Engine, now: Now) -> None:
    claim_slots(ledger, ["p01"], simulated=False, now=now)
    note(ledger, "p01", state="finished")
    assert claim_slots(ledger, ["p02", "p01"], simulated=False, now=now) == {"p02": 2, "p01": 1}


@pytest.mark.parametrize(
    ("names", "message"),
    [
        (["p02", "../p03"], r"must be letters, digits, - and _, got '\.\./p03'"),
        (
            ["p02", "p01"],
            "participant p01: real in the ledger, got a simulated one; use another code",
        ),
    ],
)
def test_codes_that_are_not_allowed_leave_the_ledger_as_it_was(
    ledger: Engine, now: Now, names: list[str], message: str
) -> None:
    claim_slots(ledger, ["p01"], simulated=False, now=now)
    with pytest.raises(ValueError, match=message):
        claim_slots(ledger, names, simulated=True, now=now)
    assert slots(ledger) == {"p01": (1, "claimed")}


def start_claiming(path: Path, name: str, *, count: int) -> subprocess.Popen[str]:
    command = [sys.executable, "-c", CLAIM, path, name, str(count)]
    return subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)


def test_eight_processes_at_once_get_eight_slots(tmp_path: Path) -> None:
    path = tmp_path / "ledger.sqlite"  # Not there yet: they race for its tables as well.
    processes = [start_claiming(path, f"sim{place}", count=3) for place in range(8)]
    for process in processes:
        assert process.stdin is not None
        process.stdin.write("\n")
        process.stdin.flush()
    for process in processes:
        process.communicate()
    assert [process.returncode for process in processes] == [0] * 8
    assert [entry.number for entry in read_ledger(open_ledger(path))] == list(range(1, 25))


def test_threads_share_a_ledger(ledger: Engine, now: Now) -> None:
    with ThreadPoolExecutor(8) as pool:
        claims = pool.map(
            lambda n: claim_slots(ledger, [f"p{n}"], simulated=False, now=now), range(16)
        )
        assert sorted(number for claim in claims for number in claim.values()) == list(range(1, 17))


def test_a_kill_while_claiming_loses_no_slot_that_was_given(tmp_path: Path, now: Now) -> None:
    path, given = tmp_path / "ledger.sqlite", 0
    for kill in range(6):
        with start_claiming(path, f"sim{kill}", count=1000) as process:
            assert process.stdin is not None
            assert process.stdout is not None
            process.stdin.write("\n")
            process.stdin.flush()
            process.stdout.readline()
            time.sleep(0.013 * kill)  # Inside one transaction or another.
            process.send_signal(signal.SIGKILL)
            given += 1 + len(process.stdout.readlines())
        numbers = [entry.number for entry in read_ledger(open_ledger(path))]
        assert numbers == list(range(1, len(numbers) + 1))
        # Claimed, but killed before it could say so.
        assert given <= len(numbers) <= given + kill + 1
    claim_slots(open_ledger(path), ["after"], simulated=True, now=now)


def test_no_other_program_can_give_a_slot_twice(ledger: Engine, now: Now, tmp_path: Path) -> None:
    claim_slots(ledger, ["p01"], simulated=False, now=now)
    double = "INSERT INTO participants VALUES ('p02', 0, 1, ?, 0, 0, '')"
    with closing(sqlite3.connect(tmp_path / "ledger.sqlite")) as other:
        with pytest.raises(sqlite3.IntegrityError):
            other.execute(double, ["running"])
        other.execute(double, ["released"])


def test_progress_is_noted_per_journal(ledger: Engine, now: Now) -> None:
    claim_slots(ledger, ["p01", "p02"], simulated=False, now=now)
    note(ledger, "p01", lines=5, tip="b", done=2)
    note(ledger, "p01", lines=9, tip="c", done=4, state="finished")
    note(ledger, "p01", journal="session-02.jsonl")
    first, second = read_ledger(ledger)
    assert [(a.journal, a.lines, a.tip) for a in first.anchors] == [
        ("session-01.jsonl", 9, "c"),
        ("session-02.jsonl", 1, "a"),
    ]
    assert (first.done, first.total, first.state) == (0, 4, "running")
    assert (second.anchors, second.state) == ((), "claimed")


@pytest.mark.parametrize(("lines", "tip"), [(4, "z"), (5, "other")])
def test_a_journal_never_gets_shorter_or_ends_otherwise(
    ledger: Engine, now: Now, lines: int, tip: str
) -> None:
    claim_slots(ledger, ["p01"], simulated=False, now=now)
    note(ledger, "p01", lines=5, tip="b", done=2)
    before = read_ledger(ledger)
    message = f"participant p01: got session-01.jsonl with {lines} lines, 5 were seen, and another end; restore"
    with pytest.raises(ValueError, match=message):
        note(ledger, "p01", lines=lines, tip=tip, done=3)
    assert read_ledger(ledger) == before
    note(ledger, "p01", lines=5, tip="b", done=2)  # The same again is no news.


@pytest.mark.parametrize(
    ("participant", "changes", "message"),
    [
        ("p09", {}, "participant p09: no slot in the ledger; claim one first"),
        ("p02", {}, "participant p02: was released; no code is used twice"),
        (
            "p01",
            {"state": "done"},
            "state must be one of claimed, running, finished, released, withdrawn, got 'done'",
        ),
    ],
)
def test_progress_of_nobody_is_refused(
    ledger: Engine, now: Now, participant: str, changes: dict[str, str], message: str
) -> None:
    claim_slots(ledger, ["p01", "p02"], simulated=False, now=now)
    note(ledger, "p02", state="released")
    with pytest.raises(ValueError, match=message):
        note(ledger, participant, **changes)


@pytest.mark.parametrize(
    "content", [b"no database at all" * 100, b"SQLite format 3\0" + b"\1" * 4096]
)
def test_a_damaged_file_is_named_with_what_to_do(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "ledger.sqlite"
    path.write_bytes(content)
    with pytest.raises(
        ValueError,
        match=r"ledger\.sqlite: got a damaged file \(.*\); move it away, then rebuild it",
    ):
        read_ledger(open_ledger(path))


def test_a_page_that_was_overwritten_is_damage(ledger: Engine, now: Now, tmp_path: Path) -> None:
    claim_slots(ledger, [f"p{place}" for place in range(100)], simulated=False, now=now)
    path = tmp_path / "ledger.sqlite"
    content = bytearray(path.read_bytes())
    content[4096:] = b"\xff" * (len(content) - 4096)
    path.write_bytes(content)
    with pytest.raises(ValueError, match="got a damaged file"):
        read_ledger(open_ledger(path))


def test_tables_of_another_version_are_damage(tmp_path: Path) -> None:
    with closing(sqlite3.connect(tmp_path / "ledger.sqlite")) as other:
        other.executescript(
            "CREATE TABLE participants (name TEXT); CREATE TABLE anchors (name TEXT)"
        )
    with pytest.raises(
        ValueError, match=r"got a damaged file \(no such column: .*\); move it away"
    ):
        read_ledger(open_ledger(tmp_path / "ledger.sqlite"))


def test_a_file_that_cannot_be_opened_is_named(tmp_path: Path) -> None:
    with pytest.raises(
        OSError, match=r"nowhere/ledger\.sqlite: could not be used \(unable to open database file\)"
    ):
        open_ledger(tmp_path / "nowhere" / "ledger.sqlite")


def test_a_ledger_that_another_program_holds_is_given_up_after_a_while(
    tmp_path: Path, now: Now, monkeypatch: pytest.MonkeyPatch
) -> None:
    open_ledger(tmp_path / "ledger.sqlite")
    monkeypatch.setattr(feel321.study.ledger.database, "PATIENCE_S", 0.05)
    with closing(sqlite3.connect(tmp_path / "ledger.sqlite", isolation_level=None)) as other:
        other.execute("BEGIN IMMEDIATE")
        hurried = open_ledger(tmp_path / "ledger.sqlite")
        assert read_ledger(hurried) == []  # Who reads need not wait.
        with pytest.raises(OSError, match=r"could not be used \(database is locked\); check that"):
            claim_slots(hurried, ["p01"], simulated=False, now=now)
    assert claim_slots(hurried, ["p01"], simulated=False, now=now) == {"p01": 1}


def test_the_command_line_starts_without_sqlalchemy() -> None:
    code = "import sys, feel321.study.cli; print('sqlalchemy' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "False\n"
