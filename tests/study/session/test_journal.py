"""The journal of a session: a chain that shows every change, and no record is lost or torn."""

import errno
import json
import os
from collections.abc import Callable
from datetime import datetime
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from feel321.study.session.events import TrialContinued
from feel321.study.session.journal import (
    START,
    Journal,
    Record,
    create_journal,
    digest,
    read_chain,
    read_journal,
    require_journal,
    write_line,
)

Now = Callable[[], datetime]

JSON = st.recursive(
    st.none()
    | st.booleans()
    | st.integers()
    | st.floats(allow_nan=False, allow_infinity=False)
    | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
    max_leaves=5,
)


SIXTH = TrialContinued(6, 1, 63.0)


@pytest.fixture
def journal(tmp_path: Path, now: Now) -> Journal:
    journal = create_journal(tmp_path / "session-01.jsonl", now=now)
    for number in range(1, 6):
        journal.write(TrialContinued(number, 1, number * 10.5))
    return journal


def test_every_line_is_json_with_number_time_and_digest_of_the_line_before(
    journal: Journal,
) -> None:
    lines = journal.path.read_bytes().splitlines()
    entries = [json.loads(line) for line in lines]
    assert [entry["sequence"] for entry in entries] == [0, 1, 2, 3, 4]
    assert [entry["previous"] for entry in entries] == [
        START,
        *(digest(line) for line in lines[:-1]),
    ]
    assert entries[2]["utc"] == "2026-01-01T00:00:02.000+00:00"
    assert entries[4]["data"] == {"trial": 5, "attempt": 1, "time_s": 52.5}


@given(st.lists(st.tuples(st.text(), st.dictionaries(st.text(), JSON, max_size=4)), max_size=6))
def test_any_events_make_the_round_trip(events: list[tuple[str, dict[str, Any]]]) -> None:
    content, tip = b"", START
    records = [
        Record(number, "2026-01-01T12:00:00+00:00", event, data)
        for number, (event, data) in enumerate(events)
    ]
    for record in records:
        line = write_line(record, tip)
        content, tip = content + line, digest(line[:-1])
    chain = read_chain(content, "any")
    assert list(chain.records) == records
    assert (chain.tip, chain.torn) == (tip, b"")


def test_a_journal_is_never_begun_twice(journal: Journal, now: Now) -> None:
    before = journal.path.read_bytes()
    with pytest.raises(FileExistsError, match="already exists; not overwritten, resume it"):
        create_journal(journal.path, now=now)
    assert journal.path.read_bytes() == before


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_a_changed_byte_in_any_line_is_named(journal: Journal, data: st.DataObject) -> None:
    content = journal.path.read_bytes()
    place = data.draw(st.integers(0, len(content) - 2).filter(lambda i: content[i] != ord("\n")))
    byte = data.draw(st.integers(0, 255).filter(lambda b: b not in {content[place], ord("\n")}))
    changed = content[:place] + bytes([byte]) + content[place + 1 :]
    line = content[:place].count(b"\n") + 1
    with pytest.raises(ValueError, match=f"^j, line {line}: was changed after it was written"):
        read_chain(changed, "j")


def test_lines_taken_out_put_in_or_moved_are_named(journal: Journal) -> None:
    a, b, c, d, e = journal.path.read_bytes().splitlines(keepends=True)
    for lines, line in (
        ([a, c, d, e], 2),
        ([a, b, b, c], 3),
        ([a, c, b], 2),
        ([b, c], 1),
        ([a, b, e], 3),
    ):
        with pytest.raises(ValueError, match=f"line {line}: does not follow the line before"):
            read_chain(b"".join(lines), "j")


def test_a_file_cut_at_any_byte_is_recovered_without_losing_a_whole_line(
    journal: Journal, now: Now
) -> None:
    whole = journal.path.read_bytes()
    ends = [i + 1 for i, byte in enumerate(whole) if byte == ord("\n")]
    for cut in range(ends[3], len(whole) + 1):
        journal.path.write_bytes(whole[:cut])
        kept = sum(end <= cut for end in ends)
        again = require_journal(journal.path, now=now)
        torn = cut - ([0, *ends][kept])
        assert again.records[:kept] == journal.records[:kept]
        assert [r.event for r in again.records[kept:]] == (["recovered"] if torn else [])
        assert read_journal(journal.path).records == again.records
        if torn:
            aside = journal.path.with_name(again.records[-1].data["moved_to"])
            assert aside.read_bytes() == whole[cut - torn : cut]
            assert again.records[-1].data["torn_bytes"] == torn
            assert again.notice == (
                f"{journal.path}: {torn} bytes of an unfinished line were moved to {aside.name}"
            )
            aside.unlink()


def test_a_full_disk_leaves_the_last_whole_record(
    journal: Journal, now: Now, monkeypatch: pytest.MonkeyPatch
) -> None:
    before, write = journal.path.read_bytes(), os.write
    with monkeypatch.context() as patch:
        patch.setattr(os, "write", lambda descriptor, data: write(descriptor, data[:20]))
        with pytest.raises(OSError, match=r"the disk took 20 of \d+ bytes; make room, then resume"):
            journal.write(SIXTH)
    assert journal.path.read_bytes() == before
    again = require_journal(journal.path, now=now)
    again.write(SIXTH)
    assert len(require_journal(journal.path, now=now).records) == 6


@pytest.mark.parametrize(
    ("error", "message"),
    [
        (
            OSError(errno.EIO, "I/O error"),
            r"session-01\.jsonl: the disk took no record \(I/O error\); make room",
        ),
        (KeyboardInterrupt(), "^$"),
    ],
)
@pytest.mark.parametrize("call", ["fsync", "write"])
def test_a_write_that_was_broken_off_closes_the_journal_and_the_chain_holds(
    journal: Journal,
    now: Now,
    monkeypatch: pytest.MonkeyPatch,
    call: str,
    error: BaseException,
    message: str,
) -> None:
    kept, real = len(journal.records), getattr(os, call)

    def do_it_then_fail(*arguments: Any) -> None:
        real(*arguments)
        raise error

    with monkeypatch.context() as patch:
        patch.setattr(os, call, do_it_then_fail)
        with pytest.raises(type(error), match=message):
            journal.write(SIXTH)
    with pytest.raises(
        OSError, match=r"session-01\.jsonl: an earlier write was broken off, .* reopen it to resume"
    ):
        journal.write(SIXTH)
    again = require_journal(journal.path, now=now)
    assert again.records[:kept] == journal.records
    again.write(SIXTH)
    assert read_journal(journal.path).records == again.records


def test_every_record_is_synced_before_write_returns(
    journal: Journal, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls: list[str] = []
    write, fsync = os.write, os.fsync
    monkeypatch.setattr(os, "write", lambda d, data: (calls.append("write"), write(d, data))[1])
    monkeypatch.setattr(os, "fsync", lambda d: (calls.append("fsync"), fsync(d))[1])
    journal.write(SIXTH)
    assert calls == ["write", "fsync"]


def test_a_torn_piece_is_safe_before_the_journal_loses_it(
    journal: Journal, now: Now, synced: list[int]
) -> None:
    with journal.path.open("ab") as file:
        file.write(b'{"sequence')
    require_journal(journal.path, now=now)
    aside = journal.path.with_name("session-01.jsonl.torn1")
    own = journal.path.stat().st_ino
    assert synced == [aside.stat().st_ino, journal.path.parent.stat().st_ino, own, own]


def test_a_full_disk_on_resuming_names_the_journal_and_loses_nothing(
    journal: Journal, now: Now, monkeypatch: pytest.MonkeyPatch
) -> None:
    with journal.path.open("ab") as file:
        file.write(b'{"sequence')
    before = journal.path.read_bytes()

    def refuse(_descriptor: int) -> None:
        raise OSError(errno.ENOSPC, "No space left")

    monkeypatch.setattr(os, "fsync", refuse)
    with pytest.raises(
        OSError, match=r"session-01\.jsonl: the disk took no record \(No space left\); make room"
    ):
        require_journal(journal.path, now=now)
    assert journal.path.read_bytes() == before


# Lines whose digest is right.

ENTRY = {
    "sequence": 0,
    "previous": START,
    "utc": "2026-01-01T12:00:00.000+00:00",
    "event": "begun",
    "data": {},
}


def seal(body: str) -> bytes:
    return f'{body[:-1]}, "sha256": "{digest(body)}"}}\n'.encode()


@pytest.mark.parametrize(
    "change",
    [
        {"sequence": "0"},
        {"sequence": False},
        {"previous": None},
        {"event": 1},
        {"data": []},
        {"data": None},
        {"utc": 0},
        {"utc": ""},
        {"utc": "2026-01-01T12:00:00"},
        {"utc": "yesterday"},
        {"more": 1},
    ],
)
def test_a_line_with_other_fields_is_refused_though_its_digest_is_right(
    change: dict[str, Any],
) -> None:
    assert read_chain(seal(json.dumps(ENTRY)), "j").records[0].event == "begun"
    with pytest.raises(
        ValueError, match="j, line 1: is not a record as feel321 writes them; restore the file"
    ):
        read_chain(seal(json.dumps(ENTRY | change)), "j")
