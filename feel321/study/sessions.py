"""Sessions, simulated and real: who takes part, with which plan, on which screen and actuators.

What simulated and real sessions have in common; only who presents differs.

Device and window are opened only once the journal has its header. What can be known to be missing or wrong before
that is refused before the participant gets a number.
"""

from __future__ import annotations

import hashlib
import os
import re
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import CancelledError, ThreadPoolExecutor, as_completed
from contextlib import AbstractContextManager, ExitStack, closing, contextmanager, nullcontext
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec
from itertools import count, islice
from pathlib import Path
from shlex import quote
from threading import Event, Lock
from time import perf_counter
from typing import TYPE_CHECKING, Any

from feel321.protocols.texts import read_scales
from feel321.stimuli.sets.manifest import Stimulus, StimulusSet, read_stimuli
from feel321.study.actuator.rig import FILE_DEVICE, Rig, identify, read_rig, take_device
from feel321.study.folder import StudyFolder, find_changes
from feel321.study.ledger.progress import Anchor, check_anchors
from feel321.study.ledger.slots import claim_slots, note_progress, open_study_ledger, read_ledger
from feel321.study.observer.participant import (
    SPECTRAL,
    ObserverModel,
    Participant,
    SimulatedObserver,
    Touch,
    expect_rating,
    identify_observer,
)
from feel321.study.observer.percepts import Percept, read_percepts
from feel321.study.session.engine import Outcome, run_session
from feel321.study.session.events import DeviceOpened, SessionFinished, SessionReleased
from feel321.study.session.journal import Clock, Journal, list_journals, read_journal
from feel321.study.session.plan import (
    TOMBSTONE_FILE,
    Plan,
    Stale,
    list_by_code,
    make_plan,
    open_session,
)
from feel321.study.session.ports import Place, Presenter
from feel321.study.settings.read import (
    find_language,
    list_surfaces,
    make_design,
    make_identity,
    make_recipe,
    read_settings,
    read_study_texts,
)
from feel321.study.strength import find_unfelt

if TYPE_CHECKING:
    from sqlalchemy import Engine

    from feel321.protocols.trial import Scale
    from feel321.study.actuator.output import Output
    from feel321.study.screen.layout import Hand
    from feel321.study.settings.schema import Settings

MakePresenter = Callable[[Plan, Journal, Mapping[str, Stimulus]], AbstractContextManager[Presenter]]

TRIALS_BETWEEN_NOTES = 25
"""Trials that the ledger may lag behind the journals of simulated participants; it follows real ones trial by trial."""


@dataclass(frozen=True, slots=True)
class Room:
    """The shared surroundings of a study's sessions."""

    study: StudyFolder
    stimuli: StimulusSet
    scales: Mapping[str, Scale]
    ledger: Engine
    stale: Stale
    now: Clock


def lead_session(
    room: Room,
    plan: Plan,
    *,
    identity: Mapping[str, Any],
    make_presenter: MakePresenter,
    on_step: Callable[[Place], None] | None = None,
) -> tuple[Outcome, str]:
    """Begin or resume the session of one participant and run it as far as it goes."""
    folder = room.study.sessions / plan.participant
    for entry in read_ledger(room.ledger, folder.name):
        check_anchors(entry.anchors, folder)  # a journal that was cut is not continued
    with open_session(folder, plan, identity=identity, now=room.now, stale=room.stale) as (
        stored,
        journal,
    ):
        by_code = list_by_code(room.stimuli, seed=stored.seed)
        keeper = _Keeper(
            room.ledger, journal, every=TRIALS_BETWEEN_NOTES if stored.simulated else 1
        )

        def note(place: Place) -> None:
            keeper.see(place)
            if on_step is not None:
                on_step(place)

        with ExitStack() as stack:
            stack.callback(keeper.write)
            presenter = stack.enter_context(make_presenter(stored, journal, by_code))
            outcome = run_session(
                stored,
                presenter,
                stimuli=room.stimuli,
                journal=journal,
                scales=room.scales,
                on_step=note,
            )
        return outcome, "; ".join(filter(None, (journal.notice, keeper.notice)))


@dataclass(slots=True)
class _Keeper:
    """Keeps the ledger beside the journal: at the opening of a session, now and then, and at its end.

    The journal is the truth: a ledger that cannot be written is reported, and ends nobody's session.
    """

    ledger: Engine
    journal: Journal
    every: int
    place: Place | None = None
    noted: int | None = None
    notice: str = ""

    def see(self, place: Place) -> None:
        self.place = place
        if self.noted is None or place.done - self.noted >= self.every:
            self.write()

    def write(self) -> None:
        if self.place is None:
            return
        self.noted = self.place.done
        is_finished = self.journal.records.has(SessionFinished)
        try:
            note_progress(
                self.ledger,
                self.journal.path.parent.name,
                anchor=Anchor(self.journal.path.name, len(self.journal.records), self.journal.tip),
                done=self.place.done,
                total=self.place.total,
                state="finished" if is_finished else "running",
            )
            self.notice = ""
        except (OSError, ValueError) as error:
            self.notice = str(error)


def require_current_set(study: StudyFolder, settings: Settings) -> None:
    """Check that the stimulus set is the one of the settings; no recording is read for it."""
    named = dict.fromkeys(entry.title for entry in settings.recordings)
    if changes := find_changes(study.stimuli, make_recipe(settings), named):
        raise ValueError(
            "\n".join(f"{change}; run feel321 build {quote(str(study.path))}" for change in changes)
        )


def list_rig_problems(
    study: StudyFolder, rig: Rig, *, settings: Settings, stimuli: StimulusSet
) -> list[str]:
    """List the problems that keep a rig from playing the stimuli of a study as they are."""
    from feel321.study.actuator.render import find_mix, find_rig_problems

    try:
        find_mix(rig)
    except ValueError as error:
        return [f"{study.rig.name}: {error}"]
    own = settings.rig
    problems = find_rig_problems(
        rig, stimuli, rate_hz=own.rate_hz, full_scale_m_s2=own.full_scale_m_s2
    )
    return [f"{study.rig.name}: {problem}" for problem in problems]


def open_room(
    study: StudyFolder, settings: Settings, stimuli: StimulusSet, *, now: Clock
) -> tuple[Room, str]:
    """Open the shared surroundings of a study's sessions."""
    ledger, notice = open_study_ledger(study, now=now)
    scales = read_scales(find_language(settings, study.path))
    return Room(
        study, stimuli, scales, ledger, Stale(**settings.session.stale.model_dump()), now
    ), notice


def plan_sessions(
    room: Room, settings: Settings, participants: Sequence[str], *, simulated: bool
) -> list[Plan]:
    """Give participants their numbers in the design, and plan their sessions."""
    numbers = claim_slots(room.ledger, participants, simulated=simulated, now=room.now)
    design = make_design(settings)
    return [
        make_plan(design, room.stimuli, name, number=numbers[name], simulated=simulated)
        for name in participants
    ]


NUMBERED = re.compile(r"sim(\d+)")
"""Codes that hold the number of a simulated person."""


@dataclass(frozen=True, slots=True)
class Casting:
    """The simulated participants of a study: their model, seed and percepts."""

    model: ObserverModel
    seed: int
    percepts: Mapping[str, Percept]


def find_planted(settings: Settings, stimuli: StimulusSet) -> dict[str, float]:
    """Compute the slopes that simulated participants plant in realism ratings, after clipping at the ends of the scale.

    Returns metric -> points per +0.1 within recordings, of the mean ratings of careful participants.
    """
    import numpy as np

    model = _make_model(settings)
    tests = [stimulus for stimulus in stimuli.stimuli if stimulus.role == "test"]
    if model.uses_percepts or "realism" not in settings.session.protocols or not tests:
        return {}
    touch = Touch(model, {})
    points = [touch.locate(stimulus) for stimulus in tests]
    ratings = expect_rating(model, [touch.feel(point) for point in points])
    values = np.array([
        [point.spectral, point.temporal, rating]
        for point, rating in zip(points, ratings, strict=True)
    ])
    arms = np.unique(
        [f"{stimulus.recording}/{stimulus.level}" for stimulus in tests], return_inverse=True
    )[1]
    for arm in range(arms.max() + 1):
        values[arms == arm] -= values[arms == arm].mean(axis=0)
    slopes = np.linalg.lstsq(values[:, :2], values[:, 2], rcond=None)[0] / 10
    return dict(zip((model.spectral_metric, "temporal_match"), slopes.tolist(), strict=True))


def _make_model(settings: Settings) -> ObserverModel:
    declared = [name for name in settings.analysis.metrics if name in SPECTRAL]
    return ObserverModel(
        **settings.observer.model_dump(), spectral_metric=(declared or SPECTRAL)[0]
    )


def cast_observers(settings: Settings, stimuli: StimulusSet, *, seed: int) -> Casting:
    """Set the observer parameters of a study's simulated participants, by the spectral match that it declares."""
    model = _make_model(settings)
    return Casting(model, seed, read_percepts(stimuli) if model.uses_percepts else {})


def find_person(participant: str) -> int:
    """Find the simulated person of a code: always the same one, with or without a hand, whatever the design.

    Examples
    --------
    >>> find_person("sim007"), find_person("p07") == find_person("p07"), find_person("p07") == find_person("p08")
    (7, True, False)
    """
    if numbered := NUMBERED.fullmatch(participant):
        return int(numbered[1])
    return int.from_bytes(hashlib.sha256(participant.encode()).digest()[:8], "big")


SIDE_BY_SIDE = 16
"""Sessions at the same time: each waits for the disk after every record, and a disk syncs several files at once."""


def run_simulation(
    room: Room,
    settings: Settings,
    participants: int,
    *,
    seed: int,
    progress: Callable[[int, int], None] | None = None,
) -> list[str]:
    """Run the sessions of simulated participants; finished ones are kept, broken ones resumed."""
    names = list_participants(room.study, participants)
    plans = plan_sessions(room, settings, names, simulated=True)
    casting = cast_observers(settings, room.stimuli, seed=seed)
    tally = _Tally(plans, progress)
    pool = ThreadPoolExecutor(SIDE_BY_SIDE)
    try:
        sessions = [
            pool.submit(
                _run, plan, settings, room, casting=casting, count=partial(tally.take, place)
            )
            for place, plan in enumerate(plans)
        ]
        return sorted(filter(None, [session.result() for session in as_completed(sessions)]))
    finally:
        # After an error or Ctrl-C the other sessions end with the trial that they are in.
        tally.stop.set()
        pool.shutdown(cancel_futures=True)


def list_participants(study: StudyFolder, number: int) -> list[str]:
    """List the codes of simulated participants, without those who were released or withdrawn."""
    names = (f"sim{place:03d}" for place in count(1))
    return list(islice((name for name in names if not _is_gone(study.sessions / name)), number))


class _Tally:
    """Counts trials over all sessions, and ends those that run when one has failed."""

    def __init__(self, plans: Sequence[Plan], progress: Callable[[int, int], None] | None) -> None:
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
        number=find_person(plan.participant),
        percepts=casting.percepts,
        elapsed_s=journal.records.find_elapsed(),
    )
    observer.recall(journal.records, plan.trials, stimuli=stimuli)
    yield observer


def _is_gone(folder: Path) -> bool:
    if (folder / TOMBSTONE_FILE).exists():
        return True
    journals = list_journals(folder)
    return bool(journals) and read_journal(journals[-1]).records.has(SessionReleased)


DELIVERED = "delivered"
"""Folder, in the participant's, of the samples that were rendered or measured at each playback."""

INSTALL = "install it from feel321's source folder: pip install -c constraints.txt '.[rig]'"


@dataclass(frozen=True, slots=True)
class Lab:
    """The lab of a real session: study, stimuli and rig, and who sits there if nobody does."""

    study: StudyFolder
    settings: Settings
    stimuli: StimulusSet
    rig: Rig
    windowed: bool = False
    screen: int = 0
    casting: Casting | None = None


def check_lab(rig: Rig, *, screen: int = 0) -> None:
    """Check everything that can be checked before anything is opened."""
    needed = ["psychopy"] if rig.device.name == FILE_DEVICE else ["psychopy", "sounddevice"]
    if missing := [name for name in needed if find_spec(name) is None]:
        raise OSError(f"run: {' and '.join(missing)} not found, which sessions need; {INSTALL}")
    if sys.platform == "linux" and not os.environ.get("DISPLAY"):
        raise OSError(
            "run: no display found (DISPLAY is not set); run it on the lab's own screen, or under xvfb-run"
        )
    if rig.device.name != FILE_DEVICE:
        # Before its name stands in the header of a session that could not go on with another device.
        from feel321.study.actuator.stream import check_channels, find_device, list_devices

        device = find_device(list_devices(), rig.device.name, host_api=rig.device.host_api)
        check_channels(device, rig)
    if screen:  # there is always a first one
        from feel321.study.screen.window import check_screen

        check_screen(screen)


def identify_lab(lab: Lab) -> dict[str, Any]:
    """Describe what a session depends on besides its plan, for the header of its journal."""
    who = (
        {"simulated": False}
        if lab.casting is None
        else identify_observer(lab.casting.model, seed=lab.casting.seed)
    )
    return {**who, "rehearsal": lab.study.is_rehearsal, "rig": identify(lab.rig)}


@contextmanager
def open_lab(
    plan: Plan, journal: Journal, stimuli: Mapping[str, Stimulus], *, lab: Lab
) -> Iterator[Presenter]:
    """Open the actuators and the screen, and close both whatever happens."""
    from feel321.study.screen.layout import make_screen_texts
    from feel321.study.screen.presenter import ScreenPresenter
    from feel321.study.screen.window import open_screen

    clock = start_clock(journal.records.find_elapsed())
    texts = make_screen_texts(read_study_texts(lab.settings, lab.study.path))
    surfaces = list_surfaces(lab.settings, lab.study.path)
    with ExitStack() as stack:
        output = stack.enter_context(_open_output(plan, lab=lab, clock=clock))
        screen = open_screen(clock=clock, windowed=lab.windowed, screen=lab.screen)
        window = stack.enter_context(screen)
        hand = stack.enter_context(_open_hand(plan, journal, stimuli, casting=lab.casting))
        journal.write(DeviceOpened(dict(output.identity)))
        yield ScreenPresenter(window, output, texts, clock=clock, surfaces=surfaces, hand=hand)


def start_clock(elapsed_s: float) -> Callable[[], float]:
    """Start the clock of a session where it stopped."""
    start_s = perf_counter() - elapsed_s
    return lambda: perf_counter() - start_s


def _open_output(
    plan: Plan, *, lab: Lab, clock: Callable[[], float]
) -> AbstractContextManager[Output]:
    """Open what the rig plays on, with every stimulus of the study rendered before."""
    from feel321.study.actuator.render import render_set

    rate_hz, full_scale_m_s2 = lab.settings.rig.rate_hz, lab.settings.rig.full_scale_m_s2
    sounds = render_set(lab.stimuli, lab.rig, full_scale_m_s2=full_scale_m_s2)
    folder = lab.study.sessions / plan.participant / DELIVERED
    if lab.rig.device.name == FILE_DEVICE:
        from feel321.study.actuator.output import FileOutput

        return nullcontext(FileOutput(lab.rig, sounds, rate_hz=rate_hz, folder=folder, clock=clock))
    from feel321.study.actuator.output import open_stream

    return open_stream(lab.rig, sounds, rate_hz=rate_hz, folder=folder, clock=clock)


@contextmanager
def _open_hand(
    plan: Plan, journal: Journal, stimuli: Mapping[str, Stimulus], *, casting: Casting | None
) -> Iterator[Hand | None]:
    """Seat a simulated participant, who remembers the last answer before a break."""
    if casting is None:
        yield None
        return
    from feel321.study.screen.robot import PressingHand, XKeyboard

    person = find_person(plan.participant)
    mind = Participant(casting.model, seed=casting.seed, number=person, percepts=casting.percepts)
    mind.recall(journal.records, plan.trials, stimuli=stimuli)
    with closing(XKeyboard()) as keyboard:
        yield PressingHand(mind, keyboard, stimuli=stimuli, clock=perf_counter)


@dataclass(frozen=True, slots=True)
class Visit:
    """A participant's visit to the lab, as the command line asks for it."""

    participant: str
    windowed: bool = False
    screen: int = 0
    device: str | None = None
    simulated: bool = False
    seed: int | None = None


def run_participant(
    study: StudyFolder,
    visit: Visit,
    *,
    now: Clock,
    on_step: Callable[[Place], None] | None = None,
    warn: Callable[[str], None] = lambda _: None,
) -> Outcome:
    """Run the session of one participant, or resume it."""
    settings, stimuli = read_settings(study.settings), read_stimuli(study.stimuli)
    require_current_set(study, settings)
    if unfelt := find_unfelt(settings, stimuli):
        if not (study.is_rehearsal or visit.simulated):
            raise ValueError(f"{study.settings}: {unfelt}")
        warn(unfelt)
    rig = require_rig(study, settings, stimuli, device=visit.device)
    check_lab(rig, screen=visit.screen)
    seed = settings.study.seed if visit.seed is None else visit.seed
    casting = cast_observers(settings, stimuli, seed=seed) if visit.simulated else None
    view = partial(Lab, windowed=visit.windowed, screen=visit.screen)
    lab = view(study, settings, stimuli, rig, casting=casting)
    room, notice = open_room(study, settings, stimuli, now=now)
    plan = plan_sessions(room, settings, [visit.participant], simulated=visit.simulated)[0]
    for entry in read_ledger(room.ledger, plan.participant):
        if entry.state == "finished":  # No window is opened for it.
            return Outcome(entry.done, entry.total)
    outcome, repaired = lead_session(
        room,
        plan,
        identity=make_identity(settings, study.path, identify_lab(lab)),
        make_presenter=partial(open_lab, lab=lab),
        on_step=on_step,
    )
    for line in filter(None, (notice, repaired)):
        warn(line)
    return outcome


def require_rig(
    study: StudyFolder, settings: Settings, stimuli: StimulusSet, *, device: str | None
) -> Rig:
    """Read the rig, and check that it can play the stimuli."""
    if not study.rig.is_file():
        raise FileNotFoundError(
            f"{study.rig}: there is none; feel321 new DIR writes one, copy it from there and name your actuators in it"
        )
    rig = read_rig(study.rig)
    if device is not None:
        rig = take_device(rig, device)
    if problems := list_rig_problems(study, rig, settings=settings, stimuli=stimuli):
        raise ValueError("\n".join(problems))
    return rig
