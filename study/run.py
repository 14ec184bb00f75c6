"""A real session: one participant before a screen, with the stylus in the hand.

Device and window are opened only once the journal has its header. What can be known to be missing or wrong before
that is refused before the participant gets a number.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

from stimuli.manifest import read_stimuli
from study.actuator.rig import read_rig, take_device
from study.casting import cast_observers
from study.lab import Lab, check_lab, identify_lab, open_lab
from study.lead import lead_session
from study.ledger.slots import read_ledger
from study.preparing import list_rig_problems, open_room, plan_sessions, require_current_set
from study.session.engine import Outcome
from study.settings.designs import make_identity
from study.settings.reading import read_settings
from study.strength import find_unfelt

if TYPE_CHECKING:
    from collections.abc import Callable

    from stimuli.manifest import StimulusSet
    from study.actuator.rig import Rig
    from study.folder import StudyFolder
    from study.lead import Room
    from study.session.journal import Clock
    from study.session.plan import Plan
    from study.session.ports import Place
    from study.settings.tables import Settings


@dataclass(frozen=True, slots=True)
class Visit:
    """Who comes to the lab, and what is asked for.

    Parameters
    ----------
    participant : str
        The participant's code.
    windowed : bool
        Whether the screen is a window.
    device : str or None
        The audio device; None for the one that the rig names.
    simulated : bool
        Whether a simulated participant presses the keys.
    seed : int or None
        Seed of the simulated participant; None for the study's.
    """

    participant: str
    windowed: bool = False
    device: str | None = None
    simulated: bool = False
    seed: int | None = None


def run_participant(
    study: StudyFolder,
    visit: Visit,
    *,
    now: Clock,
    on_step: Callable[[Place], None] | None = None,
    warn: Callable[[str], None] | None = None,
) -> Outcome:
    """Lead one participant through a session, or go on with it.

    Parameters
    ----------
    study : StudyFolder
        The study; its stimuli are built.
    visit : Visit
        Who comes.
    now : callable
        Gives the time of day, with its zone.
    on_step : callable, optional
        Called with how far the session has come, at its opening and after every page and trial.
    warn : callable, optional
        Called with each line on what was mended.

    Returns
    -------
    Outcome
        How the session ended.

    Raises
    ------
    ValueError
        If the stimulus set or the rig does not serve, stimuli of a real session cannot be felt and nobody accepted
        that, or the session was begun otherwise.
    OSError
        If the device or the screen is not there.
    """
    settings, stimuli = read_settings(study.settings), read_stimuli(study.stimuli)
    require_current_set(study, settings)
    if unfelt := find_unfelt(settings, stimuli):
        if not (study.is_rehearsal or visit.simulated):
            raise ValueError(f"{study.settings}: {unfelt}")
        (warn or (lambda _: None))(unfelt)
    lab = _prepare_lab(study, visit, settings=settings, stimuli=stimuli)
    room, notice = open_room(study, settings, stimuli, now=now)
    plan = plan_sessions(room, settings, [visit.participant], simulated=visit.simulated)[0]
    if (finished := _find_finished(room, plan)) is not None:
        return finished
    outcome, mended = lead_session(
        room,
        plan,
        identity=make_identity(settings, study.path, identify_lab(lab)),
        make_presenter=partial(open_lab, lab=lab),
        on_step=on_step,
    )
    if warn is not None:
        for line in filter(None, (notice, mended)):
            warn(line)
    return outcome


def require_rig(study: StudyFolder, settings: Settings, stimuli: StimulusSet, *, device: str | None) -> Rig:
    """Read the rig, and demand that it can play the stimuli.

    Parameters
    ----------
    study : StudyFolder
        The study.
    settings : Settings
        Its settings.
    stimuli : StimulusSet
        What is played.
    device : str or None
        A device in place of the one that the rig names.

    Returns
    -------
    Rig
        The rig.

    Raises
    ------
    ValueError
        If it does not serve: one line per reason.
    OSError
        If there is none.
    """
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


def _prepare_lab(study: StudyFolder, visit: Visit, *, settings: Settings, stimuli: StimulusSet) -> Lab:
    rig = require_rig(study, settings, stimuli, device=visit.device)
    check_lab(rig)
    seed = settings.study.seed if visit.seed is None else visit.seed
    casting = cast_observers(settings, stimuli, seed=seed) if visit.simulated else None
    return Lab(study, settings, stimuli, rig, windowed=visit.windowed, casting=casting)


def _find_finished(room: Room, plan: Plan) -> Outcome | None:
    """Find out whether there is nothing left to do, so that no window is opened for it."""
    entries = read_ledger(room.ledger, plan.participant)
    return next((Outcome(entry.done, entry.total) for entry in entries if entry.state == "finished"), None)
