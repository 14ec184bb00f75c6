from __future__ import annotations

import shutil
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import feel321.study.ledger.slots
from feel321.study.ledger.database import read_ledger, rewrite_ledger
from feel321.study.ledger.progress import REMOVING, check_anchors, read_tombstone, write_tombstone
from feel321.study.ledger.slots import find_lost, open_study_ledger, rebuild_ledger
from feel321.study.persons.withdrawal import release_participant, withdraw_participant
from feel321.study.session.journal import digest

if TYPE_CHECKING:
    from collections.abc import Callable

    from feel321.study.ledger.database import Entry

NAMES = ("p01", "p02", "p03", "sim001", "sim002")
DEEDS = ("work", "finish", "spoil", "again", "release", "withdraw")
ACTS = st.tuples(st.sampled_from(NAMES), st.sampled_from(DEEDS))


def entries(lab: Any) -> list[Entry]:
    return read_ledger(open_study_ledger(lab.study)[0])


def act(lab: Any, name: str, deed: str, now: Any) -> None:
    """Do something with a participant, who begins if need be; what is refused is left."""
    simulated = name.startswith("sim")
    deeds: dict[str, Callable[[], object]] = {
        "work": lambda: lab.work(name, 1),
        "spoil": lambda: lab.work(name, 1, rejected=True),
        "finish": lambda: lab.work(name),
        "again": lambda: lab.begin(name, simulated=simulated, session=2),
        "release": lambda: release_participant(lab.study, name, now=now),
        "withdraw": lambda: withdraw_participant(lab.study, name, now=now),
    }
    # Refused: whoever is released or has withdrawn, a third session, giving up someone who has finished.
    with suppress(ValueError, OSError):
        if not (lab.study.sessions / name).exists():
            lab.begin(name, simulated=simulated)
        deeds[deed]()


@settings(max_examples=20, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(history=st.lists(ACTS, min_size=3, max_size=12))
def test_after_any_history_the_files_alone_give_the_same_ledger(
    make_lab: Any, now: Any, history: list[tuple[str, str]]
) -> None:
    lab = make_lab()
    for name, deed in history:
        act(lab, name, deed, now)
    kept = entries(lab)
    assert find_lost(lab.study) == []
    lab.study.ledger.unlink()
    assert entries(lab) == kept
    assert rebuild_ledger(lab.study) == []
    assert entries(lab) == kept


def test_a_missing_ledger_is_rebuilt_with_one_line(lab: Any) -> None:
    assert open_study_ledger(lab.study)[1] == ""  # Nobody has begun: nothing was missing.
    lab.begin("p01")
    lab.begin("p02")
    lab.work("p02", 2)
    path = lab.study.ledger
    path.unlink()
    ledger, notice = open_study_ledger(lab.study)
    assert (
        notice == f"{path}: was missing; 2 participants were entered from their plans and journals"
    )
    assert [(entry.participant, entry.number, entry.done) for entry in read_ledger(ledger)] == [
        ("p01", 1, 0),
        ("p02", 2, 2),
    ]
    assert open_study_ledger(lab.study)[1] == ""


def test_who_finds_it_missing_second_leaves_what_was_claimed_since(
    lab: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    lab.begin("p01")
    lab.study.ledger.unlink()
    read = feel321.study.ledger.slots._read_disk

    def be_slow(folder: Any) -> Any:
        found = read(folder)
        monkeypatch.undo()
        lab.claim("p02")
        return found

    monkeypatch.setattr(feel321.study.ledger.slots, "_read_disk", be_slow)
    assert open_study_ledger(lab.study)[1] == ""
    assert [entry.participant for entry in entries(lab)] == ["p01", "p02"]


def test_a_claim_without_a_plan_outlives_a_rebuild(lab: Any) -> None:
    lab.begin("p01")
    lab.claim("p02")
    assert rebuild_ledger(lab.study) == []
    assert [(entry.participant, entry.number, entry.state) for entry in entries(lab)] == [
        ("p01", 1, "running"),
        ("p02", 2, "claimed"),
    ]


def test_one_number_held_twice_is_refused_and_the_ledger_stays(make_lab: Any) -> None:
    lab, other = make_lab(), make_lab()
    lab.begin("p01")
    shutil.copytree(other.begin("p02"), lab.study.sessions / "p02")
    kept = entries(lab)
    with pytest.raises(
        ValueError, match="number 1 must be held by one participant, got p01 and p02; withdraw"
    ):
        rebuild_ledger(lab.study)
    assert entries(lab) == kept
    shutil.rmtree(lab.study.sessions / "p01")  # Now p01 holds the number by a claim alone.
    lab.study.ledger.unlink()
    shutil.rmtree(lab.study.sessions / "p02")
    lab.claim("p01")
    shutil.copytree(other.study.sessions / "p02", lab.study.sessions / "p02")
    with pytest.raises(ValueError, match="number 1 must be held by one participant, got p02 and"):
        rebuild_ledger(lab.study)


def test_a_plan_without_a_journal_is_entered_as_it_was_claimed(lab: Any) -> None:
    (lab.begin("p01") / "session-01.jsonl").unlink()
    lab.study.ledger.unlink()
    (entry,) = entries(lab)
    assert (entry.number, entry.state, entry.done, entry.total) == (1, "claimed", 0, 0)


def test_a_plan_that_was_copied_or_is_gone_is_refused(lab: Any) -> None:
    folder = lab.begin("p01")
    shutil.copytree(folder, lab.study.sessions / "p02")
    with pytest.raises(
        ValueError, match=r"p02/plan\.json: is the plan of 'p01', it was copied here; move it away"
    ):
        rebuild_ledger(lab.study)
    (lab.study.sessions / "p02" / "plan.json").unlink()
    with pytest.raises(FileNotFoundError, match=r"plan\.json"):
        rebuild_ledger(lab.study)


def test_a_broken_journal_keeps_its_slot_and_is_told(lab: Any) -> None:
    journal = lab.begin("p01") / "session-01.jsonl"
    journal.write_bytes(b"{}\n" + journal.read_bytes())
    lost, problem = rebuild_ledger(lab.study)
    assert lost.endswith("session-01.jsonl, line 1: is not the line that was seen there")
    assert "session-01.jsonl, line 1: was changed after it was written" in problem
    assert [(entry.number, entry.state, entry.done) for entry in entries(lab)] == [
        (1, "running", 0)
    ]


def cut(journal: Path) -> None:
    """Take the last whole line away: the chain that is left holds."""
    journal.write_bytes(b"".join(journal.read_bytes().splitlines(keepends=True)[:-1]))


def remake_last_line(journal: Path) -> None:
    """Put another last line there, with digests that are right."""
    *lines, last = journal.read_bytes().splitlines(keepends=True)
    body = last.partition(b', "sha256"')[0].replace(b"finished", b"aborted") + b"}"
    journal.write_bytes(b"".join(lines) + body[:-1] + f', "sha256": "{digest(body)}"}}\n'.encode())


def remove_all(journal: Path) -> None:
    shutil.rmtree(journal.parent)


def remove_ledger(journal: Path) -> None:
    (journal.parent.parent / "ledger.sqlite").unlink()


def damage_ledger(journal: Path) -> None:
    (journal.parent.parent / "ledger.sqlite").write_bytes(b"x" * 500)


def remove_tombstone(journal: Path) -> None:
    (journal.parent.parent / "gone" / "withdrawn.json").unlink()


def damage_tombstone(journal: Path) -> None:
    (journal.parent.parent / "gone" / "withdrawn.json").write_text("[]")


def edit_tombstone(journal: Path) -> None:
    path = journal.parent.parent / "gone" / "withdrawn.json"
    path.write_text(path.read_text().replace("2026", "2025"))


def reopen_tombstone(journal: Path) -> None:
    folder = journal.parent.parent / "gone"
    write_tombstone(folder, replace(read_tombstone(folder), state=REMOVING))


def bring_stranger(journal: Path) -> None:
    shutil.copytree(journal.parent, journal.parent.parent / "stranger")


@pytest.mark.parametrize(
    ("harm", "finding"),
    [
        (cut, "sessions/p01/session-01.jsonl: ends with line 10, 11 lines of it were seen"),
        (
            remake_last_line,
            "sessions/p01/session-01.jsonl, line 11: is not the line that was seen there",
        ),
        (Path.unlink, "sessions/p01/session-01.jsonl: is gone, 11 lines of it were seen"),
        (
            remove_all,
            "sessions/p01: is gone without a tombstone, 11 lines of its journals were seen; restore it",
        ),
        (
            remove_ledger,
            "sessions/ledger.sqlite: is missing, so losses cannot be detected; rebuild it: feel321",
        ),
        (
            damage_ledger,
            "sessions/ledger.sqlite: got a damaged file (file is not a database); move it away",
        ),
        (
            remove_tombstone,
            "sessions/gone: the participant was withdrawn, the tombstone is gone; restore it",
        ),
        (
            damage_tombstone,
            "sessions/gone/withdrawn.json: not a tombstone, or changed after it was",
        ),
        (edit_tombstone, "sessions/gone/withdrawn.json: not a tombstone, or changed after it was"),
        (
            reopen_tombstone,
            "sessions/gone: the withdrawal was interrupted; finish it: feel321 withdraw",
        ),
        (bring_stranger, "sessions/stranger: is not in the ledger; enter it: feel321 ledger"),
    ],
)
def test_whatever_is_lost_is_named(
    lab: Any, now: Any, harm: Callable[[Path], None], finding: str
) -> None:
    lab.begin("gone")
    withdraw_participant(lab.study, "gone", now=now)
    lab.begin("p01")
    lab.begin("p02")
    journal = lab.work("p01")
    assert find_lost(lab.study) == []
    harm(journal)
    (line,) = find_lost(lab.study)
    assert line.startswith(f"{lab.study.path}/{finding}")


def test_what_grew_since_it_was_noted_is_not_lost(lab: Any) -> None:
    journal = lab.begin("p01") / "session-01.jsonl"
    seen = entries(lab)[0].anchors
    with journal.open("ab") as file:
        file.write(b"more\n and a torn piece")
    assert find_lost(lab.study) == []
    check_anchors(seen, journal.parent)


def test_a_loss_is_accepted_by_a_rebuild_that_is_named_ever_after(lab: Any, now: Any) -> None:
    lab.begin("p01")
    journal = lab.work("p01", 2)
    remembered = entries(lab)[0].anchors
    cut(journal)
    with pytest.raises(
        ValueError,
        match=r"ends with line 6, 7 lines of it were seen; restore it from a copy, or accept",
    ):
        check_anchors(remembered, journal.parent)
    loss = "sessions/p01/session-01.jsonl: ends with line 6, 7 lines of it were seen"
    for _ in range(2):  # The second finds nothing lost, and adds nothing.
        rebuild_ledger(lab.study, now=now)
    trace = f"{lab.study.ledger}: was rebuilt at 2026-01-01T12:00:00.000+00:00, and forgot: {loss}"
    assert find_lost(lab.study) == [trace]
    lab.work("p01")
    assert entries(lab)[0].state == "finished"
    assert find_lost(lab.study) == [trace]


@pytest.mark.parametrize("rebuild", [open_study_ledger, rebuild_ledger])
def test_a_ledger_that_was_missing_is_remembered(
    lab: Any, now: Any, rebuild: Callable[..., object]
) -> None:
    lab.begin("p01")
    lab.study.ledger.unlink()
    rebuild(lab.study, now=now)
    utc = "2026-01-01T12:00:00.000+00:00"
    assert find_lost(lab.study) == [
        f"{lab.study.ledger}: was rebuilt at {utc}, and forgot: all that it had seen, for it was missing"
    ]
    lab.study.ledger_log.write_bytes(b"{}\n")
    (line,) = find_lost(lab.study)
    assert line.startswith(f"{lab.study.ledger_log}, line 1: was changed after it was written")


def test_entering_someone_new_forgets_nothing(lab: Any, make_lab: Any) -> None:
    lab.begin("p01")
    other = make_lab()
    other.claim("p01")
    shutil.copytree(other.begin("p02"), lab.study.sessions / "p02")
    (line,) = rebuild_ledger(lab.study)
    assert line.startswith(f"{lab.study.sessions / 'p02'}: is not in the ledger; enter it: ")
    assert find_lost(lab.study) == []


def edit(lab: Any, name: str, **values: Any) -> None:
    def change(known: list[Entry]) -> list[Entry]:
        return [replace(entry, **values) if entry.participant == name else entry for entry in known]

    rewrite_ledger(open_study_ledger(lab.study)[0], change)


def test_setting_an_edited_row_right_forgets_nothing(lab: Any) -> None:
    lab.begin("p01")
    edit(lab, "p01", number=2)
    (line,) = find_lost(lab.study)
    assert line.startswith(
        f"{lab.study.ledger}: p01 has number 2, plan and journals say 1; rebuild it: feel321 ledger"
    )
    assert rebuild_ledger(lab.study) == [line]
    assert find_lost(lab.study) == []


def test_another_tombstone_than_the_ledger_saw_is_named(lab: Any, now: Any) -> None:
    lab.begin("p01")
    withdraw_participant(lab.study, "p01", now=now)
    edit(lab, "p01", number=2)
    (line,) = find_lost(lab.study)
    assert line.startswith(
        f"{lab.study.sessions / 'p01'}: the tombstone is not the one that the ledger knows"
    )


def test_a_ledger_alone_is_no_study(lab: Any) -> None:
    assert find_lost(lab.study) == []
    lab.claim("p01")
    assert find_lost(lab.study) == []
    lab.study.ledger.unlink()
    assert find_lost(lab.study) == []
