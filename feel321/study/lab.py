"""Sessions in the lab: a participant, a screen, and actuators.

Device and window are opened only once the journal has its header. What can be known to be missing or wrong before
that is refused before the participant gets a number.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, ExitStack, closing, contextmanager, suppress
from dataclasses import dataclass, replace
from functools import partial
from importlib.util import find_spec
from time import perf_counter
from typing import TYPE_CHECKING, Any

from feel321.stimuli.sets.manifest import Stimulus, StimulusSet, read_stimuli
from feel321.study.actuator.certificate import judge_certificates
from feel321.study.actuator.rig import (
    FILE_DEVICE,
    SIMULATED_DEVICE,
    Rig,
    identify,
    read_rig,
    take_device,
)
from feel321.study.checkpoints import note_checkpoint
from feel321.study.folder import DELIVERED
from feel321.study.keys import USUAL
from feel321.study.minutes import read_pace
from feel321.study.observer.model import identify_observer
from feel321.study.observer.simulated import Participant
from feel321.study.people import read_progress
from feel321.study.session.engine import Outcome
from feel321.study.session.events import UNCALIBRATED, DeviceOpened
from feel321.study.session.outlet import check_lsl, open_outlet
from feel321.study.settings import read
from feel321.study.strength import find_unfelt

if TYPE_CHECKING:
    from feel321.study.actuator.certificate import Certificate
    from feel321.study.actuator.delivered import DeliveryCheck
    from feel321.study.actuator.mixer import Frames
    from feel321.study.actuator.output import Output
    from feel321.study.folder import StudyFolder
    from feel321.study.screen.view import Hand
    from feel321.study.session.journal import Clock, Journal
    from feel321.study.session.plan import Plan
    from feel321.study.session.ports import Place, Presenter
    from feel321.study.settings.schema import Settings

from feel321.study.observer.model import Casting, cast_observers, find_person
from feel321.study.sessions import (
    lead_session,
    list_rig_problems,
    open_room,
    plan_sessions,
    require_current_set,
)

INSTALL = "install it from feel321's source folder: pip install -c constraints.txt '.[rig]'"


@dataclass(frozen=True, slots=True)
class Lab:
    """The lab of a real session: study, stimuli and rig, and who sits there if nobody does."""

    study: StudyFolder
    settings: Settings
    stimuli: StimulusSet
    rig: Rig
    sounds: Mapping[str, Frames]
    windowed: bool = False
    screen: int = 0
    casting: Casting | None = None
    certificate: Certificate | None = None
    lsl: bool = False


def check_lab(rig: Rig, *, screen: int = 0, has_lsl: bool = False) -> None:
    """Check everything that can be checked before anything is opened."""
    has_device = rig.device.name not in {FILE_DEVICE, SIMULATED_DEVICE}
    needed = ["psychopy", "sounddevice"] if has_device else ["psychopy"]
    if missing := [name for name in needed if find_spec(name) is None]:
        raise OSError(f"run: {' and '.join(missing)} not found, which sessions need; {INSTALL}")
    if sys.platform == "linux" and not os.environ.get("DISPLAY"):
        raise OSError(
            "run: no display found (DISPLAY is not set); run it on the lab's own screen, or under xvfb-run"
        )
    if has_device:
        # Before its name stands in the header of a session that could not go on with another device.
        from feel321.study.actuator.device import find_devices

        find_devices(rig)
    if has_lsl:
        check_lsl()
    if screen:  # there is always a first one
        from feel321.study.screen.window import check_screen

        check_screen(screen)


def identify_lab(lab: Lab) -> dict[str, Any]:
    """Describe what a session depends on besides its plan, for the header of its journal."""
    casting = lab.casting
    who = identify_observer(casting.model, seed=casting.seed) if casting else {"simulated": False}
    presenter = {**who, "rehearsal": lab.study.is_rehearsal, "rig": identify(lab.rig)}
    calibration = lab.certificate.identity if lab.certificate else UNCALIBRATED
    return read.make_identity(lab.settings, lab.study.path, presenter, calibration=calibration)


@contextmanager
def open_lab(
    plan: Plan, journal: Journal, stimuli: Mapping[str, Stimulus], *, lab: Lab
) -> Iterator[Presenter]:
    """Open the actuators and the screen, and close both whatever happens."""
    from feel321.study.screen.presenter import ScreenPresenter
    from feel321.study.screen.view import make_screen_texts
    from feel321.study.screen.window import open_screen

    clock = start_clock(journal.records.find_elapsed())
    texts = make_screen_texts(read.read_study_texts(lab.settings, lab.study.path), lab.rig.keys)
    surfaces = read.list_surfaces(lab.settings, lab.study.path)
    with ExitStack() as stack:
        output = stack.enter_context(_open_output(plan, lab=lab, clock=clock))
        output.lead_s = lab.certificate.lead_s if lab.certificate else 0.0
        screen = open_screen(clock=clock, windowed=lab.windowed, screen=lab.screen)
        window = stack.enter_context(screen)
        hand = _open_hand(plan, journal, stimuli, lab=lab, stack=stack)
        own = {} if lab.rig.keys == USUAL else {"keys": lab.rig.keys.model_dump(mode="json")}
        if lab.lsl or lab.settings.session.lsl:
            stack.enter_context(open_outlet(journal, clock))
        journal.write(DeviceOpened({**output.identity, **own}))
        yield ScreenPresenter(window, output, texts, clock=clock, surfaces=surfaces, hand=hand)


def start_clock(elapsed_s: float) -> Callable[[], float]:
    """Start the clock of a session where it stopped."""
    start_s = perf_counter() - elapsed_s
    return lambda: perf_counter() - start_s


def _open_output(
    plan: Plan, *, lab: Lab, clock: Callable[[], float]
) -> AbstractContextManager[Output]:
    """Open what the rig plays on, with all that the study plays rendered before."""
    from feel321.study.actuator.output import open_output

    rate_hz, sounds = lab.settings.rig.rate_hz, dict(lab.sounds)
    rig = lab.certificate.apply(lab.rig) if lab.certificate else lab.rig
    if plan.threshold:
        from feel321.study.actuator.render import render_tones

        sounds |= render_tones(
            plan.threshold, lab.rig, rate_hz=rate_hz, certificate=lab.certificate
        )
    folder = lab.study.sessions / plan.participant / DELIVERED
    check = _make_check(lab)
    return open_output(rig, sounds, rate_hz=rate_hz, clock=clock, folder=folder, check=check)


def _make_check(lab: Lab) -> DeliveryCheck | None:
    """Make what compares playbacks with what was asked; without their recordings, stimuli have no delivered metrics."""
    is_known = lab.rig.sensor is not None or lab.certificate is not None
    if lab.rig.device.name == FILE_DEVICE or not is_known:
        return None
    from feel321.study.actuator.delivered import DeliveryCheck, reduce_stimuli

    recordings = []
    for source in read.list_unread(lab.settings, lab.study.path):
        with suppress(OSError, TypeError, ValueError):  # its stimuli have no delivered metrics
            recordings.append(source.read())
    reduced = reduce_stimuli(
        lab.stimuli, recordings, read.make_recipe(lab.settings, lab.study.path)
    )
    return DeliveryCheck(
        lab.stimuli,
        lab.rig,
        full_scale_m_s2=lab.settings.rig.full_scale_m_s2,
        reduced=reduced,
        certificate=lab.certificate,
    )


def _open_hand(
    plan: Plan, journal: Journal, stimuli: Mapping[str, Stimulus], *, lab: Lab, stack: ExitStack
) -> Hand | None:
    """Seat a simulated participant, who remembers the last answer before a break."""
    if (casting := lab.casting) is None:
        return None
    from feel321.study.screen.robot import PressingHand, XKeyboard

    person = find_person(plan.participant)
    mind = Participant(casting.model, seed=casting.seed, number=person, percepts=casting.percepts)
    mind.recall(journal.records, plan.trials, stimuli=stimuli)
    keyboard = stack.enter_context(closing(XKeyboard()))
    return PressingHand(mind, keyboard, stimuli=stimuli, clock=perf_counter, keys=lab.rig.keys)


@dataclass(frozen=True, slots=True)
class Visit:
    """A participant's visit to the lab, as the command line asks for it."""

    participant: str
    windowed: bool = False
    screen: int = 0
    device: str | None = None
    simulated: bool = False
    seed: int | None = None
    accept_rig: bool = False
    lsl: bool = False


def run_participant(
    study: StudyFolder,
    visit: Visit,
    *,
    now: Clock,
    on_step: Callable[[Place], None] | None = None,
    warn: Callable[[str], None] = lambda _: None,
) -> Outcome:
    """Run the session of one participant, or resume it."""
    settings, stimuli = read.read_settings(study.settings), read_stimuli(study.stimuli)
    require_current_set(study, settings)
    if unfelt := find_unfelt(settings, stimuli):
        if not (study.is_rehearsal or visit.simulated):
            raise ValueError(f"{study.settings}: {unfelt}")
        warn(unfelt)
    rig, certificate, sounds = require_rig(
        study, settings, stimuli, visit=visit, now=now, warn=warn
    )
    check_lab(rig, screen=visit.screen, has_lsl=visit.lsl or settings.session.lsl)
    seed = settings.study.seed if visit.seed is None else visit.seed
    casting = cast_observers(settings, stimuli, seed=seed) if visit.simulated else None
    view = partial(Lab, windowed=visit.windowed, screen=visit.screen, lsl=visit.lsl)
    lab = view(study, settings, stimuli, rig, sounds, casting=casting, certificate=certificate)
    room = open_room(study, settings, stimuli, now=now)
    plan = plan_sessions(room, settings, [visit.participant], simulated=visit.simulated)[0]
    own = read_progress(study.sessions / plan.participant)
    if own.state == "finished":  # No window is opened for it.
        return Outcome(own.done, own.total)
    try:
        outcome, repaired = lead_session(
            replace(room, pace=read_pace(study, stimuli)),
            plan,
            identity=identify_lab(lab),
            make_presenter=partial(open_lab, lab=lab),
            on_step=on_step,
            accept_rig=visit.accept_rig,
        )
    finally:
        if problem := note_checkpoint(study, "session", who=plan.participant, now=now):
            warn(problem)
    if repaired:
        warn(repaired)
    return outcome


def require_rig(
    study: StudyFolder,
    settings: Settings,
    stimuli: StimulusSet,
    *,
    visit: Visit,
    now: Clock,
    warn: Callable[[str], None],
) -> tuple[Rig, Certificate | None, dict[str, Frames]]:
    """Read the rig and its certificate, and check that it can play the stimuli, which are rendered here once."""
    if not study.rig.is_file():
        raise FileNotFoundError(
            f"{study.rig}: there is none; feel321 new DIR writes one, copy it from there and name your actuators in it"
        )
    rig = read_rig(study.rig)
    if visit.device is not None:
        rig = take_device(rig, visit.device)
    own = settings.rig
    certificate, faults = judge_certificates(study.path, rig, now=now(), rate_hz=own.rate_hz)
    if faults and own.certificate == "require":
        raise ValueError("\n".join(faults))
    sounds: dict[str, Frames] = {}
    if problems := list_rig_problems(
        study, rig, settings=settings, stimuli=stimuli, certificate=certificate, sounds=sounds
    ):
        raise ValueError("\n".join(problems))
    is_felt = not visit.simulated and rig.device.name != FILE_DEVICE
    if faults and is_felt:
        warn(f"{faults[0]}; until then every row is {UNCALIBRATED}")
    return rig, certificate, sounds
