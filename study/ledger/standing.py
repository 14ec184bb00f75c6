"""Where each participant stands, by plan and journals and by nothing else."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from study.ledger.sightings import Anchor, read_anchor
from study.session.dossier import Dossier, read_as_written, read_dossier, require_own_plan
from study.session.opening import PLAN_FILE, TOMBSTONE_FILE
from study.session.replay import find_header, has_event, list_journals, replay

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from study.folder import StudyFolder
    from study.session.chain import Record


@dataclass(frozen=True, slots=True)
class Standing:
    """Where a participant stands.

    Parameters
    ----------
    participant : str
        The participant's code.
    simulated : bool
        Whether the participant is simulated.
    number : int
        The participant's number in the design.
    groups : mapping of str to str
        The participant's level of each factor in which participants differ.
    total, done : int
        Trials of the main phase, and those of them that are done; of the newest session.
    state : str
        `claimed` (nothing is recorded yet), `running`, `finished` or `released`.
    anchors : tuple of Anchor
        What there is of each journal, oldest first.
    first_utc, last_utc : str
        Times of the first and of the last record, ISO 8601; empty if there is none.
    training_passed : bool or None
        Whether all training of the newest session was passed; None as long as that is open.
    problem : str
        What is wrong with a journal, so that no more is known; mostly empty.
    """

    participant: str
    simulated: bool
    number: int
    groups: Mapping[str, str]
    total: int
    done: int = 0
    state: str = "claimed"
    anchors: tuple[Anchor, ...] = ()
    first_utc: str = ""
    last_utc: str = ""
    training_passed: bool | None = None
    problem: str = ""


def read_standings(study: StudyFolder) -> list[Standing]:
    """Read where all participants stand who have a plan or a journal and did not withdraw.

    Parameters
    ----------
    study : StudyFolder
        The study.

    Returns
    -------
    list of Standing
        Sorted by code.

    Raises
    ------
    OSError
        If a plan is missing.
    ValueError
        If a plan is broken or lies elsewhere than it was stored.
    """
    return [read_standing(folder) for folder in study.participants if _takes_part(folder)]


def read_standing(folder: Path) -> Standing:
    """Read where one participant stands, also while a session runs.

    Parameters
    ----------
    folder : Path
        The participant's folder.

    Returns
    -------
    Standing
        If a journal is broken, with what the plan says and with the problem.

    Raises
    ------
    OSError
        If the plan is missing.
    ValueError
        If the plan is broken or lies elsewhere than it was stored.
    """
    try:
        return make_standing(read_dossier(folder))
    except ValueError as error:
        # A broken plan raises again; of a broken journal the plan still says who it is.
        planned = make_standing(Dossier(folder, require_own_plan(folder), ()))
        return replace(planned, state="running", problem=str(error))


def make_standing(dossier: Dossier) -> Standing:
    """Read off where one participant stands.

    Parameters
    ----------
    dossier : Dossier
        Plan and journals.

    Returns
    -------
    Standing
        By them.

    Raises
    ------
    ValueError
        If the newest journal contradicts the plan.
    """
    with read_as_written(dossier.folder):
        return _make_standing(dossier)


def _make_standing(dossier: Dossier) -> Standing:
    plan, newest = dossier.plan, dossier.records
    times = [record.utc for chain in dossier.chains for record in chain.records]
    return Standing(
        participant=plan.participant,
        simulated=plan.simulated,
        number=plan.number,
        groups=plan.groups,
        total=sum(trial.phase == "main" for trial in plan.trials),
        done=replay(plan, newest).done,
        state=_tell_state(newest),
        anchors=tuple(read_anchor(path) for path in list_journals(dossier.folder)),
        first_utc=times[0] if times else "",
        last_utc=times[-1] if times else "",
        training_passed=_tell_training(newest),
    )


def _takes_part(folder: Path) -> bool:
    if (folder / TOMBSTONE_FILE).exists():
        return False
    return (folder / PLAN_FILE).exists() or bool(list_journals(folder))


def _tell_state(records: Sequence[Record]) -> str:
    for event in ("released", "finished"):
        if has_event(records, event):
            return event
    return "running" if find_header(records) else "claimed"


def _tell_training(records: Sequence[Record]) -> bool | None:
    pages = {record.data["key"] for record in records if record.event == "page"}
    if "training_failed" in pages:
        return False
    return True if "training_passed" in pages else None
