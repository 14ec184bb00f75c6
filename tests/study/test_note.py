"""The experimenter's notes: in the journal, and of no effect on anything but what they say."""

import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta
from functools import partial
from typing import Any

import pytest

from feel321.stimuli.sets.manifest import read_stimuli
from feel321.study.cli import main
from feel321.study.evidence.checkpoints import take_marks
from feel321.study.folder import StudyFolder
from feel321.study.participants.roster import write_roster
from feel321.study.ratings import write_ratings
from feel321.study.run import run_participant
from feel321.study.session.journal import read_journal
from feel321.study.session.ports import Abort
from feel321.study.sessions import read_room
from feel321.study.status import read_status
from feel321.study.withdrawal import release_participant, take_note, withdraw_participant
from tests.study.conftest import audit_study

Run = Callable[..., Any]

START = datetime(2026, 5, 4, 9, tzinfo=UTC)


@pytest.fixture
def study(smallest: StudyFolder) -> StudyFolder:
    return smallest


@pytest.fixture
def run(study: StudyFolder, scripted: Any, monkeypatch: pytest.MonkeyPatch) -> Run:
    """Run p01's session so many hours after the first one, with somebody in the place of screen and actuators."""
    monkeypatch.setenv("DISPLAY", ":99")
    monkeypatch.setattr("feel321.study.run.find_spec", lambda _: "there")

    def visit(hours: float = 0, **script: Any) -> Any:
        @contextmanager
        def open_presenter(_plan: Any, journal: Any, *_: object, **__: object) -> Iterator[Any]:
            yield scripted(**script, time_s=journal.records.find_elapsed())

        monkeypatch.setattr("feel321.study.run.open_lab", open_presenter)
        now = START + timedelta(hours=hours)
        return run_participant(read_room(study, now=lambda: now), "p01")

    return visit


def leave() -> dict[str, Any]:
    """Write the script of somebody who leaves at the first trial."""
    return {"acts": {(1, 1): [Abort(2.0, "not today")]}}


def note(study: StudyFolder, text: str = "left coil rattled", *, hours: float = 0) -> str:
    return take_note(study, "p01", text, now=lambda: START + timedelta(hours=hours))


def read_names(study: StudyFolder) -> list[str]:
    return [record.event for record in read_journal(study.journals[-1]).records]


def test_notes_change_neither_trials_nor_ratings_and_audit_finds_nothing(
    study: StudyFolder, run: Run
) -> None:
    """Between two openings, after the end, and after a release that is due to nobody."""
    assert run(**leave()).stopped == "not today"
    before, marks = read_status(study), take_marks(study)
    assert note(study, hours=1) == ""
    (entry,) = read_status(study).participants
    assert (entry.done, entry.left, entry.last_activity) == (
        before.participants[0].done,
        before.participants[0].left,
        before.participants[0].last_activity,
    )
    assert read_status(study).balance == before.balance
    assert take_marks(study) != marks
    assert run(2).done == 2
    stimuli = read_stimuli(study.stimuli)
    tables = [write_ratings, lambda study, _: write_roster(study)]
    files = [study.ratings, study.path / "participants.csv"]
    for write in tables:
        write(study, stimuli)
    rows = [file.read_bytes() for file in files]
    note(study, "said afterwards that wood felt like stone", hours=30)
    note(study, "called: hand was cold; größer", hours=31)
    for write in tables:
        write(study, stimuli)
    assert [file.read_bytes() for file in files] == rows
    assert audit_study(study) == []
    (entry,) = read_status(study).participants
    assert entry.state == "finished"
    assert [(one.utc[:13], one.text) for one in entry.notes] == [
        ("2026-05-04T10", "left coil rattled"),
        ("2026-05-05T15", "said afterwards that wood felt like stone"),
        ("2026-05-05T16", "called: hand was cold; größer"),
    ]
    assert run(40).done == 2  # still finished


def test_a_note_makes_no_old_session_fresh(study: StudyFolder, run: Run) -> None:
    run(**leave())
    note(study, hours=23.9)
    run(24, **leave())
    assert "warm_up" in read_names(
        study
    )  # 24 h since anything was done, six minutes since the note
    assert audit_study(study) == []


def test_notes_need_a_journal_and_outlive_a_release_but_no_withdrawal(
    study: StudyFolder, run: Run
) -> None:
    now = partial(datetime.now, UTC)
    with pytest.raises(ValueError, match="'p01' has no session here; known: nobody yet"):
        note(study)
    run(**leave())
    release_participant(study, "p01", now=lambda: START)
    note(study, "moved to another city", hours=1)
    assert audit_study(study) == []
    assert [one.text for one in read_status(study).participants[0].notes] == [
        "moved to another city"
    ]
    assert read_status(study).participants[0].state == "released"
    withdraw_participant(study, "p01", now=now)
    with pytest.raises(ValueError, match="p01: withdrew, nothing is recorded any longer"):
        note(study)
    assert "another city" not in "".join(
        path.read_text(errors="replace") for path in study.path.rglob("*") if path.is_file()
    )


def test_the_command_line_writes_and_shows_notes(
    study: StudyFolder, run: Run, capsys: pytest.CaptureFixture[str]
) -> None:
    run(**leave())
    where = str(study.path)
    assert main(["status", where, "--notes"]) == 0
    assert capsys.readouterr().out.endswith("notes: none\n")
    assert main(["note", where, "--participant", "p01", "a cough in block 2"]) == 0
    assert capsys.readouterr().out == "p01: noted\n"
    assert main(["status", where, "--notes"]) == 0
    assert capsys.readouterr().out.splitlines()[-1].split()[::2][0] == "p01"
    assert main(["status", where]) == 0
    assert "cough" not in capsys.readouterr().out
    assert main(["status", where, "--json"]) == 0
    (entry,) = json.loads(capsys.readouterr().out)["participants"]
    assert [one["text"] for one in entry["notes"]] == ["a cough in block 2"]
    assert main(["note", where, "--participant", "p01", "two\nlines"]) == 1
    error = capsys.readouterr().err
    assert "one line without control characters" in error
    assert error.count("\n") == 1
