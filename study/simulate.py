"""Whole studies with simulated participants, through the engine that real sessions use."""

from __future__ import annotations

from concurrent.futures import CancelledError, ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from functools import partial
from threading import Event, Lock
from typing import TYPE_CHECKING

from protocols.texts import read_scales
from study.observer import ObserverModel, SimulatedObserver, identify_observer
from study.plan import make_plan
from study.session import Stage, find_completed, find_elapsed, open_session, run_session

if TYPE_CHECKING:
    from collections.abc import Callable

    from stimuli.manifest import StimulusSet
    from study.folder import StudyFolder
    from study.journal import Clock
    from study.plan import Plan
    from study.tables import Settings

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
    plans = [plan_session(simulation, number) for number in range(1, participants + 1)]
    total = sum(len(plan.trials) for plan in plans)
    rated = [0] * len(plans)
    counting, stop = Lock(), Event()

    def count(place: int, done: int) -> None:
        if stop.is_set():
            raise CancelledError
        with counting:
            rated[place] = done
            if progress is not None:
                progress(sum(rated), total)

    pool = ThreadPoolExecutor(SIDE_BY_SIDE)
    try:
        sessions = [
            pool.submit(_run, plan, simulation, count=partial(count, place)) for place, plan in enumerate(plans)
        ]
        return sorted(notice for session in as_completed(sessions) if (notice := session.result()))
    finally:
        # After an error or Ctrl-C the other sessions end with the trial that they are in.
        stop.set()
        pool.shutdown(cancel_futures=True)


def plan_session(simulation: Simulation, number: int) -> Plan:
    """Plan the session of one simulated participant.

    Parameters
    ----------
    simulation : Simulation
        The study.
    number : int
        The participant's number, from 1.

    Returns
    -------
    Plan
        The plan.
    """
    return make_plan(
        simulation.stimuli,
        f"sim{number:03d}",
        number=number,
        seed=simulation.settings.study.seed,
        protocols=simulation.settings.session.protocols,
        repeats=simulation.settings.session.repeats,
    )


def _run(plan: Plan, simulation: Simulation, *, count: Callable[[int], None]) -> str:
    model = ObserverModel(**simulation.settings.observer.model_dump())
    identity = identify_observer(model, seed=simulation.seed)
    folder = simulation.study.sessions / plan.participant
    with open_session(folder, plan, identity=identity, now=simulation.now) as (stored, journal):
        observer = SimulatedObserver(
            model, seed=simulation.seed, number=stored.number, elapsed_s=find_elapsed(journal.records)
        )
        stage = Stage(
            presenter=observer,
            stimuli={stimulus.stimulus_id: stimulus for stimulus in simulation.stimuli.stimuli},
            scales=read_scales(simulation.settings.session.language),
            journal=journal,
        )
        if done := len(find_completed(journal.records)):
            count(done)
        run_session(stored, stage, on_rated=lambda trial: count(trial.number))
        return journal.notice

