"""How far every participant of a study has come, and what the study lead should know about it. Blind."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING

from protocols.scoring import is_as_expected
from study.ledger.standing import read_standing
from study.session.journal import read_journal
from study.session.opening import PLAN_FILE, TOMBSTONE_FILE
from study.session.plan import require_plan
from study.session.replay import list_journals

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from study.folder import StudyFolder
    from study.session.chain import Chain, Record
    from study.session.plan import Plan


@dataclass(frozen=True, slots=True)
class Progress:
    """How far one participant has come.

    Parameters
    ----------
    participant : str
        The participant's code.
    state : str
        `claimed` (planned, nothing recorded yet), `running`, `finished`, `released` or `withdrawn`; empty if it
        cannot be told.
    number : int
        The participant's number in the design; 0 if it cannot be told.
    groups : str
        The participant's group, as `factor=level`; empty if participants do not differ.
    done, left : int
        Trials of the main phase that need no further attempt, and those that do.
    simulated : bool
        Whether the participant is simulated.
    last_activity : str
        Time of the last record, ISO 8601, UTC; empty before the first.
    warnings : tuple of str
        What the study lead should know.
    problem : str
        Why nothing is known about the participant; mostly empty.
    """

    participant: str
    state: str = ""
    number: int = 0
    groups: str = ""
    done: int = 0
    left: int = 0
    simulated: bool = False
    last_activity: str = ""
    warnings: tuple[str, ...] = ()
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


def _try_progress(folder: Path) -> Progress:
    try:
        return _read_progress(folder)
    except (OSError, ValueError) as error:
        return Progress(folder.name, problem=str(error))


def _read_progress(folder: Path) -> Progress:
    if (folder / TOMBSTONE_FILE).exists():
        return Progress(folder.name, state="withdrawn")
    standing = read_standing(folder)
    if standing.problem:
        return Progress(folder.name, problem=standing.problem)
    newest = list_journals(folder)[-1:]
    plan = require_plan(folder / PLAN_FILE)
    return Progress(
        participant=standing.participant,
        state=standing.state,
        number=standing.number,
        groups=", ".join(f"{factor}={level}" for factor, level in standing.groups.items()),
        done=standing.done,
        left=standing.total - standing.done,
        simulated=standing.simulated,
        last_activity=standing.last_utc,
        warnings=tuple(warning for path in newest for warning in _find_warnings(plan, read_journal(path))),
    )


def _find_warnings(plan: Plan, chain: Chain) -> Iterator[str]:
    if chain.torn:
        yield f"{len(chain.torn)} torn bytes, mended on resuming"
    counts = Counter(flag for record in chain.records for flag in record.data.get("flags", ()))
    yield from (f"{count} x {flag.replace('_', ' ')}" for flag, count in counts.items())
    if any(record.event == "page" and record.data["key"] == "training_failed" for record in chain.records):
        yield "training not passed"
    caught = find_catches(plan, chain.records)
    if missed := sum(not as_expected for as_expected in caught):
        yield f"{missed} of {len(caught)} catch trials not as expected"


def find_catches(plan: Plan, records: Sequence[Record]) -> list[bool]:
    """Find out how a participant did in the catch trials whose right answer is known.

    Parameters
    ----------
    plan : Plan
        The plan.
    records : sequence of Record
        The journal's records.

    Returns
    -------
    list of bool
        Whether the answer was as expected, of each that counts.
    """
    caught = {trial.number: trial for trial in plan.trials if trial.phase == "main" and trial.catch}
    answers = [
        is_as_expected(caught[record.data["trial"]], record.data["values"])
        for record in records
        if record.event == "rated" and record.data["trial"] in caught and not record.data["rejected"]
    ]
    return [answer for answer in answers if answer is not None]
