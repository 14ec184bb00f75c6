"""The lab as a participant finds it: who comes, what is demanded before, and how screen and actuators are opened."""

from __future__ import annotations

import os
import sys
from contextlib import ExitStack, closing, contextmanager, nullcontext
from dataclasses import dataclass
from importlib.util import find_spec
from time import perf_counter
from typing import TYPE_CHECKING, Any

from study.actuator.rig import FILE_DEVICE, identify
from study.casting import tell_person
from study.observer.participant import Participant
from study.observer.simulated import identify_observer
from study.session.replay import find_elapsed
from study.settings.sources import list_surfaces
from study.settings.wording import read_study_texts

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping
    from contextlib import AbstractContextManager

    from stimuli.manifest import Stimulus, StimulusSet
    from study.actuator.output import Output
    from study.actuator.rig import Rig
    from study.casting import Casting
    from study.folder import StudyFolder
    from study.screen.views import Hand
    from study.session.journal import Journal
    from study.session.plan import Plan
    from study.session.ports import Presenter
    from study.settings.tables import Settings

DELIVERED = "delivered"
"""Folder, in the participant's, of what was rendered or measured at each playback."""

INSTALL = "install it from feel321's source folder: pip install -c constraints.txt '.[rig]'"


@dataclass(frozen=True, slots=True)
class Lab:
    """What a participant finds ready.

    Parameters
    ----------
    study : StudyFolder
        The study.
    settings : Settings
        Its settings.
    stimuli : StimulusSet
        What is felt.
    rig : Rig
        The actuators.
    windowed : bool
        Whether the screen is a window.
    casting : Casting or None
        Who presses the keys; None for a person.
    """

    study: StudyFolder
    settings: Settings
    stimuli: StimulusSet
    rig: Rig
    windowed: bool = False
    casting: Casting | None = None


def check_lab(rig: Rig) -> None:
    """Demand what can be known to be there before anything is opened.

    Parameters
    ----------
    rig : Rig
        The actuators.

    Raises
    ------
    OSError
        If PsychoPy, sounddevice, a display or the device is missing.
    """
    needed = ["psychopy"] if rig.device.name == FILE_DEVICE else ["psychopy", "sounddevice"]
    if missing := [name for name in needed if find_spec(name) is None]:
        raise OSError(f"run: {' and '.join(missing)} not found, which sessions need; {INSTALL}")
    if sys.platform == "linux" and not os.environ.get("DISPLAY"):
        raise OSError("run: got no display (DISPLAY is not set); run it on the lab's own screen, or under xvfb-run")
    if rig.device.name != FILE_DEVICE:
        _require_device(rig)


def _require_device(rig: Rig) -> None:
    """Demand the device before its name stands in the header of a session that could not go on with another one."""
    from study.actuator.devices import check_channels, find_device
    from study.actuator.stream import list_devices

    check_channels(find_device(list_devices(), rig.device.name, host_api=rig.device.host_api), rig)


def identify_lab(lab: Lab) -> dict[str, Any]:
    """Say what a session depends on besides its plan, for the header of its journal.

    Parameters
    ----------
    lab : Lab
        What the participant finds ready.

    Returns
    -------
    dict
        Everything, as JSON can hold it.
    """
    who = {"simulated": False} if lab.casting is None else identify_observer(lab.casting.model, seed=lab.casting.seed)
    return {**who, "rehearsal": lab.study.is_rehearsal, "rig": identify(lab.rig)}


@contextmanager
def open_lab(plan: Plan, journal: Journal, stimuli: Mapping[str, Stimulus], *, lab: Lab) -> Iterator[Presenter]:
    """Open the actuators and the screen, and close both whatever happens.

    Parameters
    ----------
    plan : Plan
        The stored plan.
    journal : Journal
        The journal, open.
    stimuli : mapping of str to Stimulus
        The stimuli by the names that they have in the plan.
    lab : Lab
        What the participant finds ready.

    Yields
    ------
    Presenter
        Who presents.

    Raises
    ------
    OSError
        If the device or the screen is not there.
    """
    from study.screen.presenter import ScreenPresenter
    from study.screen.window import open_screen
    from study.screen.wording import make_screen_texts

    clock = start_clock(find_elapsed(journal.records))
    texts = make_screen_texts(read_study_texts(lab.settings, lab.study.path))
    surfaces = list_surfaces(lab.settings, lab.study.path)
    with ExitStack() as stack:
        output = stack.enter_context(_open_output(plan, lab=lab, clock=clock))
        window = stack.enter_context(open_screen(clock=clock, windowed=lab.windowed))
        hand = stack.enter_context(_open_hand(plan, journal, stimuli, casting=lab.casting))
        journal.write("device", dict(output.identity))
        yield ScreenPresenter(window, output, texts, clock=clock, surfaces=surfaces, hand=hand)


def start_clock(elapsed_s: float) -> Callable[[], float]:
    """Start the clock of a session where it stopped.

    Parameters
    ----------
    elapsed_s : float
        Seconds that the session has taken so far.

    Returns
    -------
    callable
        Gives the seconds since the session began, those between its openings left out.
    """
    start_s = perf_counter() - elapsed_s
    return lambda: perf_counter() - start_s


def _open_output(plan: Plan, *, lab: Lab, clock: Callable[[], float]) -> AbstractContextManager[Output]:
    """Open what the rig plays on, with every stimulus of the study rendered before."""
    from study.actuator.render import render_set

    rate_hz, full_scale_m_s2 = lab.settings.rig.rate_hz, lab.settings.rig.full_scale_m_s2
    sounds = render_set(lab.stimuli, lab.rig, full_scale_m_s2=full_scale_m_s2)
    folder = lab.study.sessions / plan.participant / DELIVERED
    if lab.rig.device.name == FILE_DEVICE:
        from study.actuator.file_output import FileOutput

        return nullcontext(FileOutput(lab.rig, sounds, rate_hz=rate_hz, folder=folder, clock=clock))
    from study.actuator.stream_output import open_stream

    return open_stream(lab.rig, sounds, rate_hz=rate_hz, folder=folder, clock=clock)


@contextmanager
def _open_hand(
    plan: Plan, journal: Journal, stimuli: Mapping[str, Stimulus], *, casting: Casting | None
) -> Iterator[Hand | None]:
    """Let a simulated participant sit down, who remembers what was answered before."""
    if casting is None:
        yield None
        return
    from study.screen.fingers import XFingers
    from study.screen.hand import PressingHand

    person = tell_person(plan.participant)
    mind = Participant(casting.model, seed=casting.seed, number=person, percepts=casting.percepts)
    mind.recall(journal.records, plan.trials, stimuli=stimuli)
    with closing(XFingers()) as keyboard:
        yield PressingHand(mind, keyboard, stimuli=stimuli, clock=perf_counter)
