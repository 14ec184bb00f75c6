"""`run`: a session in the lab, with a participant, a screen and actuators.

Device and window are opened only once the journal has its header. What can be known to be missing or wrong before
that is refused before the participant gets a number.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import replace
from functools import partial
from importlib.util import find_spec
from shlex import join
from time import perf_counter
from typing import TYPE_CHECKING

from feel321.study.actuator import render
from feel321.study.actuator import rig as rigs
from feel321.study.actuator.certificate import judge_certificates
from feel321.study.evidence.checkpoints import note_checkpoint
from feel321.study.folder import DELIVERED
from feel321.study.keys import USUAL, label_key
from feel321.study.lsl import check_lsl, open_outlet
from feel321.study.minutes import read_pace
from feel321.study.observer import Casting, Participant, find_person, make_model
from feel321.study.participants.roster import make_progress
from feel321.study.session.events import UNCALIBRATED, DeviceOpened
from feel321.study.session.ports import Place
from feel321.study.sessions import Room, lead_session, plan_sessions
from feel321.study.settings import read
from feel321.study.settings.read import list_surfaces, try_recordings
from feel321.study.strength import find_unfelt
from feel321.study.terminal import CALL, echo, is_terminal

if TYPE_CHECKING:
    from pathlib import Path

    from feel321.study.actuator.output import Output
    from feel321.study.session.journal import Journal
    from feel321.study.session.plan import Plan
    from feel321.study.session.ports import Presenter

INSTALL = "install it from feel321's source folder: pip install -c constraints.txt '.[rig]'"


LINE = 60  # characters of the line that says what is left; it is overwritten by the next


class SessionLog:
    """Prints how far a session is, and, where something ends it, how to resume it."""

    def __init__(self, participant: str, rig: Path) -> None:
        self._participant, self._rig = participant, rig
        self._place: Place | None = None

    def _count(self, place: Place) -> str:
        """Count answered trials, and those that were given up apart from them."""
        gone = f", {place.given_up} given up" if place.given_up else ""
        return f"{self._participant}: {place.answered} of {place.total} answered{gone}"

    def note(self, place: Place) -> None:
        """Print where the session is now."""
        done, begin = self._count(place), "\n" if is_terminal() else ""
        if self._place is None:
            echo(f"{done} so far")
        self._place = place
        who = f"{begin}{self._participant}"
        if place.notice:
            wrong = f"{who}: look after the rig in a break ({place.notice})"
            echo(f"{wrong}; what the hand gets is within tolerance, trials count", err=True)
        if place.fault:
            key = label_key(rigs.read_rig(self._rig).keys.find_key("experimenter"), {})
            failed = f"{who}: the device failed ({place.fault}); check it"
            echo(f"{failed}, then press {key} in the participant's window", err=True)
        elif is_terminal():
            minutes = "" if place.left_s is None else f", about {place.left_s / 60:.0f} min left"
            echo(f"{done + minutes:<{LINE}}", over=True, err=True)

    def lead(self, run: Callable[..., Place]) -> Place:
        """Run a session, and print how far it came, or how to resume what ended it: an error, say, or Ctrl-C."""
        reason = ""
        try:
            outcome = run(on_step=self.note)
            reason = outcome.stopped
        except BaseException as error:
            reason = type(error).__name__
            raise
        finally:
            if self._place is not None and is_terminal():
                echo(err=True)
            if reason and self._place is not None:
                # A change of the rig is accepted only once.
                words = [word for word in CALL.get().words if word != "--accept-rig"]
                done = f"{self._count(self._place)} (aborted: {reason})"
                echo(f"{done}; resume with: {join(['feel321', *words])}", err=True)
        if not reason:
            echo(self._count(outcome))
        return outcome


def run_participant(
    room: Room,
    participant: str,
    *,
    seed: int | None = None,
    simulated: bool = False,
    on_step: Callable[[Place], None] | None = None,
    warn: Callable[[str], None] = lambda _: None,
) -> Place:
    """Run the session of one participant, or resume it; seed: of a simulated one."""
    study, settings, stimuli = room.study, room.settings, room.stimuli
    read.require_current_set(study, settings)
    if unfelt := find_unfelt(settings, stimuli):
        if not (study.is_rehearsal or simulated):
            raise ValueError(f"{study.settings}: {unfelt}")
        warn(unfelt)
    room = replace(room, lsl=room.lsl or settings.session.lsl)
    room = require_rig(room, warn=warn if not simulated else lambda _: None)
    check_lab(room)
    if simulated:
        seed = settings.study.seed if seed is None else seed
        room = replace(room, casting=Casting(make_model(settings), seed))
    plan = plan_sessions(room, [participant], simulated=simulated)[0]
    own = make_progress(study.read_person(study.sessions / plan.participant))
    if own.state == "finished":  # No window is opened for it.
        return Place(own.answered, own.total, given_up=own.given_up)
    room = replace(room, pace=read_pace(study, stimuli))
    own_rig, certificate = {"rig": rigs.identify(_get_rig(room))}, room.certificate
    who = room.casting.identity if room.casting else {"simulated": False}
    presenter = {**who, "rehearsal": study.is_rehearsal, **own_rig}
    calibration = certificate.identity if certificate else UNCALIBRATED
    identity = read.make_identity(settings, study.path, presenter, calibration=calibration)
    make = partial(open_lab, room=room)
    try:
        outcome, repaired = lead_session(
            room, plan, identity=identity, make_presenter=make, on_step=on_step
        )
    finally:
        if problem := note_checkpoint(study, "session", who=plan.participant, now=room.now):
            warn(problem)
    if repaired:
        warn(repaired)
    return outcome


def require_rig(room: Room, *, warn: Callable[[str], None]) -> Room:
    """Read the rig and its certificate, and check that it can play the stimuli, which are rendered here once."""
    study, own = room.study, room.settings.rig
    rig = rigs.read_rig(study.rig)
    if room.device is not None:
        rig = rigs.take_device(rig, room.device)
    certificate, faults = judge_certificates(study.path, rig, now=room.now(), rate_hz=own.rate_hz)
    if faults and own.certificate == "require":
        raise ValueError("\n".join(faults))
    problems, sounds = render.find_rig_problems(
        rig, room.stimuli, room.settings, certificate=certificate
    )
    if problems:
        raise ValueError("\n".join(problems))
    if faults and rig.device.name != rigs.FILE_DEVICE:
        warn(f"{faults[0]}; until then every row is {UNCALIBRATED}")
    return replace(room, rig=rig, certificate=certificate, sounds=sounds)


def check_lab(room: Room) -> None:
    """Check everything that can be checked before anything is opened."""
    rig = _get_rig(room)
    has_device = rig.device.name not in {rigs.FILE_DEVICE, rigs.SIMULATED_DEVICE}
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
    if room.lsl:
        check_lsl()
    if room.screen:  # there is always a first one
        from feel321.study.screen.window import check_screen

        check_screen(room.screen)


def _get_rig(room: Room) -> rigs.Rig:
    if room.rig is None:
        raise ValueError("run: no rig was read; a session needs one")
    return room.rig


@contextmanager
def open_lab(plan: Plan, journal: Journal, *, room: Room) -> Iterator[Presenter]:
    """Open the actuators and the screen, and close both whatever happens."""
    from feel321.study.screen.input import make_screen_texts
    from feel321.study.screen.presenter import PressingHand, ScreenPresenter
    from feel321.study.screen.window import open_screen

    settings, keys, folder = room.settings, _get_rig(room).keys, room.study.path
    clock = start_clock(journal.records.find_elapsed())
    texts = make_screen_texts(read.read_study_texts(settings, folder), keys)
    surfaces = list_surfaces(settings, folder)
    with ExitStack() as stack:
        output = stack.enter_context(_open_output(plan, room=room, clock=clock))
        output.lead_s = room.certificate.lead_s if room.certificate else 0.0
        screen = open_screen(clock=clock, windowed=room.windowed, screen=room.screen)
        window = stack.enter_context(screen)
        hand = None
        if (casting := room.casting) is not None:
            person = find_person(plan.participant)
            mind = Participant(casting.model, seed=casting.seed, number=person)
            hand = PressingHand(mind, clock=clock, keys=keys)
        own = {} if keys == USUAL else {"keys": keys.model_dump(mode="json")}
        if room.lsl:
            stack.enter_context(open_outlet(journal, clock))
        journal.write(DeviceOpened({**output.identity, **own}))
        yield ScreenPresenter(window, output, texts, clock=clock, surfaces=surfaces, hand=hand)


def start_clock(elapsed_s: float) -> Callable[[], float]:
    """Start the clock of a session where it stopped."""
    start_s = perf_counter() - elapsed_s
    return lambda: perf_counter() - start_s


def _open_output(
    plan: Plan, *, room: Room, clock: Callable[[], float]
) -> AbstractContextManager[Output]:
    """Open what the rig plays on, with all that the study plays rendered before."""
    from feel321.study.actuator.delivered import DeliveryCheck, reduce_stimuli
    from feel321.study.actuator.output import open_output

    rig, certificate, settings = _get_rig(room), room.certificate, room.settings
    own, sounds, check = settings.rig, dict(room.sounds), None
    if plan.threshold:
        sounds |= render.render_tones(
            plan.threshold, rig, rate_hz=own.rate_hz, certificate=certificate
        )
    if rig.device.name != rigs.FILE_DEVICE and rig.sensor is not None:
        # Without their recordings, stimuli have no delivered metrics.
        found = (one for _, one in try_recordings(settings, room.study.path))
        recordings = [one for one in found if not isinstance(one, str)]
        recipe = read.make_recipe(settings, room.study.path)
        check = DeliveryCheck(
            room.stimuli,
            rig,
            full_scale_m_s2=own.full_scale_m_s2,
            reduced=reduce_stimuli(room.stimuli, recordings, recipe),
            certificate=certificate,
            tolerance_db=settings.session.quality.level_error_db,
        )
    folder = room.study.sessions / plan.participant / DELIVERED
    played = certificate.apply(rig) if certificate else rig
    return open_output(played, sounds, rate_hz=own.rate_hz, clock=clock, folder=folder, check=check)
