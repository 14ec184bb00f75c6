"""`simulate`: sessions of simulated participants: who takes part, what is planted, and many of them side by side."""

from collections.abc import Callable
from concurrent.futures import CancelledError, ThreadPoolExecutor, as_completed
from contextlib import AbstractContextManager, nullcontext
from itertools import count, islice
from threading import Event, Lock

from feel321.arguments import follow
from feel321.stimuli.sets.manifest import StimulusSet, read_stimuli
from feel321.study.evidence.checkpoints import note_checkpoint
from feel321.study.folder import OpenStudy, Outcome, StudyFolder
from feel321.study.observer import (
    Casting,
    SimulatedObserver,
    Touch,
    expect_rating,
    find_person,
    make_model,
)
from feel321.study.participants.answers import write_answers
from feel321.study.participants.roster import PLANNED, read_holder, write_roster
from feel321.study.ratings import write_matches, write_ratings
from feel321.study.session.journal import Clock, Journal
from feel321.study.session.plan import Plan
from feel321.study.session.ports import Presenter
from feel321.study.sessions import Room, lead_session, open_room, plan_sessions
from feel321.study.settings.read import make_identity, read_settings, require_current_set
from feel321.study.settings.schema import Settings
from feel321.study.strength import find_unfelt

SIDE_BY_SIDE = 16
"""Sessions at the same time: each waits for the disk after every record, and a disk syncs several files at once."""


def regress_planted(
    settings: Settings, stimuli: StimulusSet
) -> tuple[dict[str, float], dict[str, float]]:
    """Compute what simulated participants plant in realism ratings: a regression within recordings, after clipping.

    Returns points per +0.1 of each metric, and points of each reducer.
    """
    import numpy as np

    model = make_model(settings)
    tests = [stimulus for stimulus in stimuli.stimuli if stimulus.role == "test"]
    if "realism" not in settings.session.protocols or not tests:
        return {}, {}
    touch = Touch(model)
    points = [touch.locate(stimulus) for stimulus in tests]
    ratings = expect_rating(model, [touch.feel(point) for point in points])
    felt = {stimulus.reducer for stimulus in tests}
    terms = [name for name, points in model.reducers.items() if points and name in felt]
    values = np.array([
        [point.spectral, point.temporal, *(stimulus.reducer == name for name in terms), rating]
        for stimulus, point, rating in zip(tests, points, ratings, strict=True)
    ])
    groups = [(one.recording, one.level) for one in tests]
    for group in set(groups):
        own = np.array([one == group for one in groups])
        values[own] -= values[own].mean(axis=0)
    found = np.linalg.lstsq(values[:, :-1], values[:, -1], rcond=None)[0].tolist()
    metrics = (model.spectral_metric, "temporal_match")
    slopes = {name: slope / 10 for name, slope in zip(metrics, found[:2], strict=True)}
    return slopes, dict(zip(terms, found[2:], strict=True))


def report_simulated(lab: OpenStudy, participants: int, seed: int | None) -> Outcome:
    """Run the sessions of simulated participants, and say how many ratings there are and what was planted in them."""
    study = lab.folder
    with follow(lab.progress, "simulate") as step:
        rows = simulate_study(
            study, participants=participants, seed=seed, now=lab.now, progress=step, warn=lab.say
        )
    slopes, reducers = regress_planted(read_settings(study.settings), read_stimuli(study.stimuli))
    facts = {"participants": participants, "ratings": rows, "file": str(study.ratings)}
    facts |= {"planted": slopes} | ({"planted_reducers": reducers} if reducers else {})
    terms = [f"{slope:.2f} per +0.1 of {metric}" for metric, slope in slopes.items()]
    terms += [f"{points:+.1f} for {reducer}" for reducer, points in reducers.items()]
    said = f" in realism, in points: {', '.join(terms)}" if terms else ": more than the two matches"
    return Outcome(facts, [f"{study.ratings}: {rows} ratings", f"planted{said}"])


def simulate_study(
    study: StudyFolder,
    *,
    participants: int,
    seed: int | None,
    now: Clock,
    progress: Callable[[int, int], None] | None = None,
    warn: Callable[[str], None] | None = None,
) -> int:
    """Run the sessions of simulated participants and derive the table of ratings; returns its rows."""
    settings = read_settings(study.settings)
    stimuli = read_stimuli(study.stimuli)
    require_current_set(study, settings)
    seed = settings.study.seed if seed is None else seed
    room = open_room(study, settings, stimuli, now=now)
    notices = _run_sessions(room, participants, seed=seed, progress=progress)
    write_roster(study)
    write_matches(study, stimuli)
    write_answers(study)
    rows = write_ratings(study, stimuli)
    notices += [note_checkpoint(study, "simulate", now=now)]
    if warn is not None:
        for notice in filter(None, (find_unfelt(settings, stimuli), *notices)):
            warn(notice)
    return rows


def _run_sessions(
    room: Room, participants: int, *, seed: int, progress: Callable[[int, int], None] | None
) -> list[str]:
    """Run the sessions of simulated participants; finished ones are kept, broken ones resumed."""
    settings, names = room.settings, list_participants(room.study, participants)
    plans = plan_sessions(room, names, simulated=True)
    casting = Casting(make_model(settings), seed)
    total = sum(trial.phase == "main" for plan in plans for trial in plan.trials)
    done, counting, stop = dict.fromkeys(names, 0), Lock(), Event()

    def sit(plan: Plan, journal: Journal) -> AbstractContextManager[Presenter]:
        person, elapsed_s = find_person(plan.participant), journal.records.find_elapsed()
        observer = SimulatedObserver(casting.model, seed=seed, number=person, elapsed_s=elapsed_s)
        return nullcontext(observer)

    def run(plan: Plan) -> str:
        def take(number: int) -> None:
            if stop.is_set():
                raise CancelledError
            with counting:
                is_news, done[plan.participant] = done[plan.participant] != number, number
                if is_news and progress is not None:
                    progress(sum(done.values()), total)

        _, notice = lead_session(
            room,
            plan,
            identity=make_identity(settings, room.study.path, casting.identity),
            make_presenter=sit,
            on_step=lambda place: take(place.done),
        )
        return notice

    pool = ThreadPoolExecutor(SIDE_BY_SIDE)
    try:
        sessions = [pool.submit(run, plan) for plan in plans]
        return sorted(filter(None, [session.result() for session in as_completed(sessions)]))
    finally:
        # After an error or Ctrl-C the other sessions end with the trial that they are in.
        stop.set()
        pool.shutdown(cancel_futures=True)


def list_participants(study: StudyFolder, number: int) -> list[str]:
    """List the codes of simulated participants, without those who were released or withdrawn."""
    folders = (study.sessions / f"sim{place:03d}" for place in count(1))
    known = ((folder.name, read_holder(folder)) for folder in folders)
    return list(islice((name for name, own in known if not own or own.state == PLANNED), number))
