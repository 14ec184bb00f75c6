"""A session from plan to end."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path
from typing import Any

import pytest

from feel321.protocols.texts import read_scales
from feel321.stimuli.sets.manifest import StimulusSet
from feel321.study.folder import StudyFolder
from feel321.study.participants.roster import Station, plan_participants
from feel321.study.session.plan import Plan, Stale
from feel321.study.sessions import Room, lead_session
from feel321.study.withdrawal import release_participant

IDENTITY = {"presenter": {"simulated": True}}


@pytest.fixture
def room(tmp_path: Path, stimuli: StimulusSet, now: Callable[[], datetime]) -> Room:
    no_settings: Any = None
    return Room(StudyFolder(tmp_path), no_settings, stimuli, read_scales(), Stale(), now)


def lead(room: Room, plan: Plan, presenter: Any, **options: Any) -> Any:
    @contextmanager
    def open_presenter(*_: object) -> Iterator[Any]:
        try:
            yield presenter
        finally:
            presenter.log.append("closed")

    plan_participants(
        room.study, [plan.participant], lambda *_: plan, simulated=True, station=Station()
    )
    return lead_session(room, plan, identity=IDENTITY, make_presenter=open_presenter, **options)


@pytest.mark.parametrize("stop_after", [3, float("inf")])
def test_the_presenter_is_closed_however_a_session_ends(
    room: Room, plan: Plan, scripted: type, stop_after: float
) -> None:
    presenter = scripted(stop_after=stop_after)
    if stop_after == 3:
        with pytest.raises(KeyboardInterrupt):
            lead(room, plan, presenter)
    else:
        outcome, notice = lead(room, plan, presenter)
        assert (outcome.done, outcome.total, outcome.stopped, notice) == (20, 20, "", "")
    assert presenter.log[-1] == "closed"


def test_nobody_is_led_whose_plan_was_given_back(room: Room, plan: Plan, scripted: type) -> None:
    """The number may be another's by now."""
    plan_participants(room.study, ["p01"], lambda *_: plan, simulated=True, station=Station())
    assert release_participant(room.study, "p01", now=room.now) == 1
    with pytest.raises(FileNotFoundError):
        lead_session(room, plan, identity=IDENTITY, make_presenter=scripted)
