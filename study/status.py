"""How far every participant of a study has come."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from study.journal import read_journal
from study.plan import require_plan
from study.session import PLAN_FILE, SESSION, find_completed, find_header, is_finished, name_journal

if TYPE_CHECKING:
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
    """

    participant: str
    done: int
    left: int
    finished: bool
    simulated: bool
    last_activity: str
    torn_bytes: int


def read_status(study: StudyFolder) -> list[Progress]:
    """Read how far every participant has come, also while sessions run.

    Parameters
    ----------
    study : StudyFolder
        The study.

    Returns
    -------
    list of Progress
        One per participant, sorted by code.

    Raises
    ------
    ValueError
        If a plan or journal is broken.
    """
    return [_read_progress(folder) for folder in study.participants if (folder / PLAN_FILE).exists()]


def _read_progress(folder: Path) -> Progress:
    plan = require_plan(folder / PLAN_FILE)
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
    )
