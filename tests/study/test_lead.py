"""A session with the ledger beside it: how closely it follows, and what happens when it cannot."""

from __future__ import annotations

from contextlib import contextmanager
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import pytest

from feel321.protocols.texts import read_scales
from feel321.study.folder import StudyFolder
from feel321.study.ledger.database import read_ledger
from feel321.study.ledger.slots import claim_slots, open_study_ledger
from feel321.study.session.plan import Stale
from feel321.study.sessions import TRIALS_BETWEEN_NOTES, Room, lead_session

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from datetime import datetime
    from pathlib import Path

    from feel321.stimuli.sets.manifest import StimulusSet
    from feel321.study.session.plan import Plan

IDENTITY = {"presenter": {"simulated": True}}


@pytest.fixture
def room(tmp_path: Path, stimuli: StimulusSet, now: Callable[[], datetime]) -> Room:
    study = StudyFolder(tmp_path)
    return Room(study, stimuli, read_scales(), open_study_ledger(study)[0], Stale(), now)


def lead(room: Room, plan: Plan, presenter: Any, **options: Any) -> Any:
    @contextmanager
    def open_presenter(*_: object) -> Iterator[Any]:
        try:
            yield presenter
        finally:
            presenter.log.append("closed")

    claim_slots(room.ledger, [plan.participant], simulated=plan.simulated, now=room.now)
    return lead_session(room, plan, identity=IDENTITY, make_presenter=open_presenter, **options)


def read_anchor(room: Room) -> tuple[str, int, int]:
    (entry,) = read_ledger(room.ledger, "p01")
    return entry.state, entry.done, entry.anchors[0].lines


def test_at_the_end_the_ledger_holds_the_whole_journal(
    room: Room, plan: Plan, scripted: type
) -> None:
    presenter = scripted()
    outcome, notice = lead(room, plan, presenter)
    lines = (room.study.sessions / "p01" / "session-01.jsonl").read_bytes().count(b"\n")
    assert read_anchor(room) == ("finished", 20, lines)
    assert (outcome.done, outcome.total, outcome.stopped, notice) == (20, 20, "", "")
    assert presenter.log[-1] == "closed"


@pytest.mark.parametrize("simulated", [True, False])
def test_the_ledger_follows_real_people_trial_by_trial(
    room: Room, plan: Plan, scripted: type, simulated: bool
) -> None:
    seen: dict[int, int] = {}
    plan = replace(plan, simulated=simulated)
    lead(
        room,
        plan,
        scripted(),
        on_step=lambda place: seen.setdefault(place.done, read_anchor(room)[1]),
    )
    behind = [done - noted for done, noted in seen.items()]
    # The session of twenty trials is shorter than the distance that simulated participants may have.
    assert max(behind) == (20 if simulated else 0)
    assert TRIALS_BETWEEN_NOTES > 20


def test_a_session_broken_off_is_noted_and_its_presenter_closed(
    room: Room, plan: Plan, scripted: type
) -> None:
    presenter = scripted(stop_after=3)
    with pytest.raises(KeyboardInterrupt):
        lead(room, plan, presenter)
    lines = (room.study.sessions / "p01" / "session-01.jsonl").read_bytes().count(b"\n")
    assert read_anchor(room) == ("running", 3, lines)
    assert presenter.log[-1] == "closed"


def test_a_ledger_that_cannot_be_written_ends_nobodys_session(
    room: Room, plan: Plan, scripted: type, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object, **__: object) -> None:
        raise OSError("ledger.sqlite: is busy")

    monkeypatch.setattr("feel321.study.ledger.keeper.note_progress", fail)
    outcome, notice = lead(room, plan, scripted())
    assert (outcome.done, notice) == (20, "ledger.sqlite: is busy")


def test_a_journal_of_which_less_is_there_than_was_seen_is_refused(
    room: Room, plan: Plan, scripted: type
) -> None:
    with pytest.raises(KeyboardInterrupt):
        lead(room, plan, scripted(stop_after=3))
    journal = room.study.sessions / "p01" / "session-01.jsonl"
    journal.write_bytes(b"".join(journal.read_bytes().splitlines(keepends=True)[:-2]))
    with pytest.raises(
        ValueError, match=r"ends with line \d+, \d+ lines of it were seen; restore it from a copy"
    ):
        lead(room, plan, scripted())
