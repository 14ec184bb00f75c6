"""What simulated and real sessions have in common: the stimulus set, the plans, and how a session is led."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field, replace
from math import prod
from typing import TYPE_CHECKING, Any

from feel321.protocols.texts import make_scales
from feel321.stimuli.sets.manifest import StimulusSet, read_stimuli
from feel321.study.minutes import SIMULATED, Pace, find_durations, find_left
from feel321.study.participants.answers import make_keeper
from feel321.study.participants.roster import Station, plan_participants
from feel321.study.session.engine import run_session
from feel321.study.session.journal import Clock, Journal
from feel321.study.session.opening import open_session
from feel321.study.session.plan import Plan, Stale, make_plan
from feel321.study.session.ports import Place, Presenter
from feel321.study.settings.read import make_design, read_settings, read_study_texts

if TYPE_CHECKING:
    from feel321.protocols.trial import Scale
    from feel321.study.actuator.certificate import Certificate
    from feel321.study.actuator.mixer import Frames
    from feel321.study.actuator.rig import Rig
    from feel321.study.folder import StudyFolder
    from feel321.study.observer import Casting
    from feel321.study.settings.schema import Settings

MakePresenter = Callable[[Plan, Journal], AbstractContextManager[Presenter]]


@dataclass(frozen=True, slots=True)
class Room:
    """Where sessions are held; casting: who sits there if nobody does; sounds: the stimuli as the rig plays them."""

    study: StudyFolder
    settings: Settings
    stimuli: StimulusSet
    scales: Mapping[str, Scale]
    stale: Stale
    now: Clock
    pace: Pace = SIMULATED
    windowed: bool = False
    screen: int = 0
    device: str | None = None
    accept_rig: bool = False
    lsl: bool = False
    casting: Casting | None = None
    rig: Rig | None = None
    certificate: Certificate | None = None
    sounds: Mapping[str, Frames] = field(default_factory=dict)


def open_room(study: StudyFolder, settings: Settings, stimuli: StimulusSet, *, now: Clock) -> Room:
    """Open the shared surroundings of a study's sessions."""
    scales = make_scales(read_study_texts(settings, study.path))
    return Room(study, settings, stimuli, scales, settings.session.stale, now)


def read_room(study: StudyFolder, *, now: Clock) -> Room:
    """Read settings and stimuli of a study whose sessions are to be held."""
    return open_room(study, read_settings(study.settings), read_stimuli(study.stimuli), now=now)


def plan_sessions(room: Room, participants: Sequence[str], *, simulated: bool) -> list[Plan]:
    """Give participants their numbers in the design, and plan their sessions."""
    settings = room.settings
    design = make_design(settings)

    def make(name: str, number: int) -> Plan:
        return make_plan(design, room.stimuli, name, number=number, simulated=simulated)

    groups = prod(map(len, settings.between.values()))
    station = Station(settings.stations.this, settings.stations.of, groups)
    return plan_participants(room.study, participants, make, simulated=simulated, station=station)


def lead_session(
    room: Room,
    plan: Plan,
    *,
    identity: Mapping[str, Any],
    make_presenter: MakePresenter,
    on_step: Callable[[Place], None] | None = None,
) -> tuple[Place, str]:
    """Begin or resume the session of one participant and run it as far as it goes."""
    folder = room.study.sessions / plan.participant
    with open_session(
        folder, plan, identity=identity, now=room.now, stale=room.stale, accept_rig=room.accept_rig
    ) as (own, journal):
        durations, keep = find_durations(room.stimuli), make_keeper(folder, journal)
        left_s = find_left(own, journal.records, durations=durations, pace=room.pace)

        def note(place: Place) -> None:
            if on_step is not None:
                on_step(replace(place, left_s=left_s.get(place.done)))

        stimuli, scales = room.stimuli, room.scales
        with make_presenter(own, journal) as shown:
            outcome = run_session(
                own, shown, stimuli=stimuli, journal=journal, scales=scales, on_step=note, keep=keep
            )
        return outcome, journal.notice
