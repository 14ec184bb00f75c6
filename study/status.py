"""How far every participant of a study has come."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from protocols.design import count_cycle
from study.journal import read_journal
from study.plan import require_plan
from study.session import PLAN_FILE, SESSION, find_completed, find_header, is_finished, name_journal

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from study.folder import StudyFolder


@dataclass(frozen=True, slots=True)
class Progress:
    """How far one participant has come.

    Parameters
    ----------
    participant : str
        The participant's code.
    done, left : int
        Trials that were rated, and those that were not.
    finished : bool
        Whether the session came to its end.
    simulated : bool
        Whether the participant is simulated.
    last_activity : str
        Time of the last record, ISO 8601, UTC; empty before the first.
    torn_bytes : int
        What a crash left of a line; mended when the session is resumed.
    cycle : int
        Number of participants over whom the design comes full circle; 0 if the plan cannot be read.
    problem : str
        Why nothing is known about the participant; mostly empty.
    """

    participant: str
    done: int = 0
    left: int = 0
    finished: bool = False
    simulated: bool = False
    last_activity: str = ""
    torn_bytes: int = 0
    cycle: int = 0
    problem: str = ""


def read_status(study: StudyFolder) -> list[Progress]:
    """Read how far every participant has come, also while sessions run.

    Parameters
    ----------
    study : StudyFolder
        The study.

    Returns
    -------
    list of Progress
        One per participant, sorted by code; a broken plan or journal is the problem of its own entry.
    """
    return [_try_progress(folder) for folder in study.participants]


def describe_balance(entries: Sequence[Progress]) -> str:
    """Say how far the participants who finished have come round the design.

    Parameters
    ----------
    entries : sequence of Progress
        All participants.

    Returns
    -------
    str
        One line.

    Examples
    --------
    >>> describe_balance([Progress("p01", finished=True, cycle=6), Progress("p02", cycle=6)])
    'balance: 1 finished; orders balance over 6 participants or a multiple, 5 to go'
    """
    finished = sum(entry.finished for entry in entries)
    cycle = max((entry.cycle for entry in entries), default=0)
    if not cycle:
        return "balance: nobody has begun"
    to_go = -finished % cycle if finished else cycle
    return f"balance: {finished} finished; orders balance over {cycle} participants or a multiple, {to_go} to go"


def _try_progress(folder: Path) -> Progress:
    try:
        return _read_progress(folder)
    except (OSError, ValueError) as error:
        return Progress(folder.name, problem=str(error))


def _read_progress(folder: Path) -> Progress:
    plan = require_plan(folder / PLAN_FILE)
    if plan.participant != folder.name:
        raise ValueError(f"{folder / PLAN_FILE}: is the plan of {plan.participant!r}, it was copied here; move it away")
    path = folder / name_journal(SESSION)
    # A crash between plan and journal leaves the first alone; the session then simply begins.
    chain = read_journal(path) if path.exists() else None
    records = chain.records if chain else ()
    header = find_header(records)
    done = len(find_completed(records))
    return Progress(
        participant=plan.participant,
        done=done,
        left=len(plan.trials) - done,
        finished=is_finished(records),
        simulated=header is not None and header["presenter"]["simulated"],
        last_activity=records[-1].utc if records else "",
        torn_bytes=len(chain.torn) if chain else 0,
        cycle=count_cycle(plan.trials),
    )
