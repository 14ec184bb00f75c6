"""What comes before a session, simulated or real: the right stimulus set, the ledger, a number, a plan."""

from __future__ import annotations

from shlex import quote
from typing import TYPE_CHECKING

from protocols.texts import read_scales
from study.lead import Room
from study.ledger.rebuilding import open_study_ledger
from study.ledger.slots import claim_slots
from study.provenance import find_changes
from study.session.plan import make_plan
from study.settings.designs import make_design, make_stale
from study.settings.sources import make_recipe
from study.settings.wording import find_language

if TYPE_CHECKING:
    from collections.abc import Sequence

    from stimuli.manifest import StimulusSet
    from study.actuator.rig import Rig
    from study.folder import StudyFolder
    from study.session.journal import Clock
    from study.session.plan import Plan
    from study.settings.tables import Settings


def require_current_set(study: StudyFolder, settings: Settings) -> None:
    """Demand the stimulus set that the settings ask for; no recording is read for it.

    Parameters
    ----------
    study : StudyFolder
        The study.
    settings : Settings
        Its settings.

    Raises
    ------
    ValueError
        If the set that is there is another one: one line per difference.
    """
    named = dict.fromkeys(entry.title for entry in settings.recordings)
    if changes := find_changes(study.stimuli, make_recipe(settings), named):
        raise ValueError("\n".join(f"{change}; run feel321 build {quote(str(study.path))}" for change in changes))


def list_rig_problems(study: StudyFolder, rig: Rig, *, settings: Settings, stimuli: StimulusSet) -> list[str]:
    """List what keeps a rig from playing the stimuli of a study as they are.

    Parameters
    ----------
    study : StudyFolder
        The study.
    rig : Rig
        The rig.
    settings : Settings
        The study's settings.
    stimuli : StimulusSet
        What is to be played.

    Returns
    -------
    list of str
        One line per kind of problem; empty if there is none.
    """
    from study.actuator.inspection import find_rig_problems
    from study.actuator.reach import find_mix

    try:
        find_mix(rig)
    except ValueError as error:
        return [f"{study.rig.name}: {error}"]
    own = settings.rig
    problems = find_rig_problems(rig, stimuli, rate_hz=own.rate_hz, full_scale_m_s2=own.full_scale_m_s2)
    return [f"{study.rig.name}: {problem}" for problem in problems]


def open_room(study: StudyFolder, settings: Settings, stimuli: StimulusSet, *, now: Clock) -> tuple[Room, str]:
    """Open what the sessions of a study share.

    Parameters
    ----------
    study : StudyFolder
        The study.
    settings : Settings
        Its settings.
    stimuli : StimulusSet
        What is felt.
    now : callable
        Gives the time of day, with its zone.

    Returns
    -------
    room : Room
        With the ledger open.
    notice : str
        What had to be mended; mostly empty.
    """
    ledger, notice = open_study_ledger(study, now=now)
    scales = read_scales(find_language(settings, study.path))
    return Room(study, stimuli, scales, ledger, make_stale(settings), now), notice


def plan_sessions(room: Room, settings: Settings, participants: Sequence[str], *, simulated: bool) -> list[Plan]:
    """Give participants their numbers in the design, and plan their sessions.

    Parameters
    ----------
    room : Room
        With the ledger, where the numbers are claimed.
    settings : Settings
        The study's settings.
    participants : sequence of str
        Their codes.
    simulated : bool
        Whether they are simulated.

    Returns
    -------
    list of Plan
        One per participant.
    """
    numbers = claim_slots(room.ledger, participants, simulated=simulated, now=room.now)
    design = make_design(settings)
    return [
        make_plan(design, room.stimuli, name, number=numbers[name], simulated=simulated) for name in participants
    ]
