"""Whole studies with simulated participants, through the engine that real sessions use."""

from __future__ import annotations

from concurrent.futures import CancelledError, ThreadPoolExecutor, as_completed
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from itertools import count, islice
from threading import Event, Lock
from typing import TYPE_CHECKING

from study.casting import cast_observers, tell_person
from study.lead import lead_session
from study.observer.simulated import SimulatedObserver, identify_observer
from study.preparing import open_room, plan_sessions
from study.session.journal import read_journal
from study.session.opening import TOMBSTONE_FILE
from study.session.replay import find_elapsed, has_event, list_journals
from study.settings.designs import make_identity

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence
    from pathlib import Path

    from stimuli.manifest import Stimulus, StimulusSet
    from study.casting import Casting
    from study.folder import StudyFolder
    from study.lead import Room
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
    settings = simulation.settings
    room, notice = open_room(simulation.study, settings, simulation.stimuli, now=simulation.now)
    names = list_participants(simulation.study, participants)
    plans = plan_sessions(room, settings, names, simulated=True)
    casting = cast_observers(settings, simulation.stimuli, seed=simulation.seed)
    notices = [notice] if notice else []
    tally = _Tally(plans, progress)
    pool = ThreadPoolExecutor(SIDE_BY_SIDE)
    try:
        sessions = [
            pool.submit(_run, plan, settings, room, casting=casting, count=partial(tally.take, place))
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


def _run(
    plan: Plan, settings: Settings, room: Room, *, casting: Casting, count: Callable[[int], None]
) -> str:
    presenter = identify_observer(casting.model, seed=casting.seed)
    _, notice = lead_session(
        room,
        plan,
        identity=make_identity(settings, room.study.path, presenter),
        make_presenter=partial(_make_observer, casting=casting),
        on_step=lambda place: count(place.done),
    )
    return notice


@contextmanager
def _make_observer(
    plan: Plan, journal: Journal, stimuli: Mapping[str, Stimulus], *, casting: Casting
) -> Iterator[SimulatedObserver]:
    observer = SimulatedObserver(
        casting.model,
        seed=casting.seed,
        number=tell_person(plan.participant),
        percepts=casting.percepts,
        elapsed_s=find_elapsed(journal.records),
    )
    observer.recall(journal.records, plan.trials, stimuli=stimuli)
    yield observer


def _is_gone(folder: Path) -> bool:
    if (folder / TOMBSTONE_FILE).exists():
        return True
    journals = list_journals(folder)
    return bool(journals) and has_event(read_journal(journals[-1]).records, "released")
