"""Whole studies with simulated participants, through the engine that real sessions use."""

from __future__ import annotations

from concurrent.futures import CancelledError, ThreadPoolExecutor, as_completed
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from itertools import count, islice
from threading import Event, Lock
from typing import TYPE_CHECKING

from protocols.texts import read_scales
from study.lead import Room, lead_session
from study.ledger.rebuilding import open_study_ledger
from study.ledger.slots import claim_slots
from study.observer.percepts import read_percepts
from study.observer.simulated import ObserverModel, SimulatedObserver, identify_observer
from study.session.journal import read_journal
from study.session.opening import TOMBSTONE_FILE
from study.session.plan import make_plan
from study.session.replay import find_elapsed, has_event, list_journals
from study.settings.designs import make_design, make_identity, make_stale
from study.settings.wording import find_language

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence
    from pathlib import Path

    from stimuli.manifest import Stimulus, StimulusSet
    from study.folder import StudyFolder
    from study.observer.percepts import Percept
    from study.session.journal import Clock, Journal
    from study.session.plan import Plan
    from study.settings.tables import Settings

    Progress = Callable[[int, int], None]

SIDE_BY_SIDE = 8
"""Sessions at a time: each waits for the disk after every record, and a disk syncs several files at once."""


@dataclass(frozen=True, slots=True)
class Simulation:
    """A study that simulated participants take part in.

    Parameters
    ----------
    study : StudyFolder
        Where it lies.
    settings : Settings
        What it consists of.
    stimuli : StimulusSet
        What is felt.
    seed : int
        Seed of the participants.
    now : callable
        Gives the time of day, with its zone.
    """

    study: StudyFolder
    settings: Settings
    stimuli: StimulusSet
    seed: int
    now: Clock


def run_simulation(simulation: Simulation, participants: int, *, progress: Progress | None = None) -> list[str]:
    """Lead simulated participants through their sessions; finished ones are kept, broken ones resumed.

    Parameters
    ----------
    simulation : Simulation
        The study.
    participants : int
        How many; they are called sim001, sim002, ...
    progress : callable, optional
        Called with the numbers of trials done, by earlier runs too, and to do.

    Returns
    -------
    list of str
        What had to be mended when sessions were resumed, one line each; mostly empty.

    Raises
    ------
    ValueError
        If a session was begun with other settings, stimuli or seed, saying what differs.
    """
    room, notices = _open_room(simulation)
    plans = plan_sessions(simulation, room, list_participants(simulation.study, participants))
    casting = _Casting(simulation.seed, ObserverModel(**simulation.settings.observer.model_dump()), {})
    if casting.model.uses_percepts:
        casting.percepts.update(read_percepts(simulation.stimuli))
    tally = _Tally(plans, progress)
    pool = ThreadPoolExecutor(SIDE_BY_SIDE)
    try:
        sessions = [
            pool.submit(_run, plan, simulation.settings, room, casting=casting, count=partial(tally.take, place))
            for place, plan in enumerate(plans)
        ]
        notices += [notice for session in as_completed(sessions) if (notice := session.result())]
    finally:
        # After an error or Ctrl-C the other sessions end with the trial that they are in.
        tally.stop.set()
        pool.shutdown(cancel_futures=True)
    return sorted(notices)


def list_participants(study: StudyFolder, number: int) -> list[str]:
    """Name simulated participants, passing over those who were released or withdrawn.

    Parameters
    ----------
    study : StudyFolder
        The study.
    number : int
        How many.

    Returns
    -------
    list of str
        Their codes.
    """
    names = (f"sim{place:03d}" for place in count(1))
    return list(islice((name for name in names if not _is_gone(study.sessions / name)), number))


def plan_sessions(simulation: Simulation, room: Room, participants: Sequence[str]) -> list[Plan]:
    """Give simulated participants their numbers in the design, and plan their sessions.

    Parameters
    ----------
    simulation : Simulation
        The study.
    room : Room
        With the ledger, where the numbers are claimed.
    participants : sequence of str
        Their codes.

    Returns
    -------
    list of Plan
        One per participant.
    """
    numbers = claim_slots(room.ledger, participants, simulated=True, now=simulation.now)
    design = make_design(simulation.settings)
    return [
        make_plan(design, simulation.stimuli, name, number=numbers[name], simulated=True) for name in participants
    ]


@dataclass(frozen=True, slots=True)
class _Casting:
    """Who the simulated participants are."""

    seed: int
    model: ObserverModel
    percepts: dict[str, Percept]

    @contextmanager
    def make_observer(
        self, plan: Plan, journal: Journal, stimuli: Mapping[str, Stimulus]
    ) -> Iterator[SimulatedObserver]:
        # A code belongs to one person for ever; the number in the design may have been somebody else's before.
        person = int(plan.participant.removeprefix("sim"))
        elapsed_s = find_elapsed(journal.records)
        observer = SimulatedObserver(
            self.model, seed=self.seed, number=person, percepts=self.percepts, elapsed_s=elapsed_s
        )
        observer.recall(journal.records, plan.trials, stimuli=stimuli)
        yield observer


class _Tally:
    """Counts trials over all sessions, and ends those that run when one has failed."""

    def __init__(self, plans: Sequence[Plan], progress: Progress | None) -> None:
        self.stop = Event()
        self._progress = progress
        self._done = [0] * len(plans)
        self._total = sum(trial.phase == "main" for plan in plans for trial in plan.trials)
        self._counting = Lock()

    def take(self, place: int, done: int) -> None:
        if self.stop.is_set():
            raise CancelledError
        with self._counting:
            is_news, self._done[place] = done != self._done[place], done
            if is_news and self._progress is not None:
                self._progress(sum(self._done), self._total)


def _open_room(simulation: Simulation) -> tuple[Room, list[str]]:
    ledger, notice = open_study_ledger(simulation.study, now=simulation.now)
    scales = read_scales(find_language(simulation.settings, simulation.study.path))
    stale = make_stale(simulation.settings)
    room = Room(simulation.study, simulation.stimuli, scales, ledger, stale, simulation.now)
    return room, [notice] if notice else []


def _run(
    plan: Plan, settings: Settings, room: Room, *, casting: _Casting, count: Callable[[int], None]
) -> str:
    presenter = identify_observer(casting.model, seed=casting.seed)
    _, notice = lead_session(
        room,
        plan,
        identity=make_identity(settings, room.study.path, presenter),
        make_presenter=casting.make_observer,
        on_step=lambda place: count(place.done),
    )
    return notice


def _is_gone(folder: Path) -> bool:
    if (folder / TOMBSTONE_FILE).exists():
        return True
    journals = list_journals(folder)
    return bool(journals) and has_event(read_journal(journals[-1]).records, "released")
