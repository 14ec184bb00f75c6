"""How far every participant of a study has come, and what the study lead should know about it. Blind."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING

from protocols.scoring import is_as_expected
from study.ledger.standing import make_standing
from study.realised import measure_realised
from study.session.dossier import read_as_written, read_dossier
from study.session.opening import TOMBSTONE_FILE

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence
    from pathlib import Path

    from study.folder import StudyFolder
    from study.realised import Realised
    from study.session.chain import Chain, Record
    from study.session.dossier import Dossier
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


@dataclass(frozen=True, slots=True)
class Status:
    """How far a study has come.

    Parameters
    ----------
    participants : tuple of Progress
        One per participant, sorted by code.
    balance : Realised or None
        Balance of what was run so far; None if no trial counts yet.
    """

    participants: tuple[Progress, ...]
    balance: Realised | None


def read_status(study: StudyFolder, *, progress: Callable[[int, int], None] | None = None) -> Status:
    """Read how far a study has come, also while sessions run.

    Parameters
    ----------
    study : StudyFolder
        The study.
    progress : callable, optional
        Called with the numbers of participants read and to read.

    Returns
    -------
    Status
        A broken plan or journal is the problem of its own participant, who is left out of the balance.
    """
    entries, dossiers = [], []
    folders = study.participants
    for count, folder in enumerate(folders, start=1):
        entry, dossier = _read_progress(folder)
        entries.append(entry)
        if dossier is not None:
            dossiers.append(dossier)
        if progress is not None:
            progress(count, len(folders))
    return Status(tuple(entries), measure_realised(dossiers))


def _read_progress(folder: Path) -> tuple[Progress, Dossier | None]:
    """Read how far a participant has come; the dossier comes too if it counts for the balance."""
    if (folder / TOMBSTONE_FILE).exists():
        return Progress(folder.name, state="withdrawn"), None
    try:
        dossier = read_dossier(folder)
        with read_as_written(folder):
            return _make_progress(dossier), dossier
    except (OSError, ValueError) as error:
        return Progress(folder.name, problem=str(error)), None


def _make_progress(dossier: Dossier) -> Progress:
    standing = make_standing(dossier)
    return Progress(
        participant=standing.participant,
        state=standing.state,
        number=standing.number,
        groups=", ".join(f"{factor}={level}" for factor, level in standing.groups.items()),
        done=standing.done,
        left=standing.total - standing.done,
        simulated=standing.simulated,
        last_activity=standing.last_utc,
        warnings=tuple(warning for chain in dossier.chains[-1:] for warning in _find_warnings(dossier.plan, chain)),
    )


def _find_warnings(plan: Plan, chain: Chain) -> Iterator[str]:
    if chain.torn:
        yield f"{len(chain.torn)} torn bytes, mended on resuming"
    counts = Counter(flag for record in chain.records for flag in record.data.get("flags", ()))
    yield from (f"{count} x {flag.replace('_', ' ')}" for flag, count in counts.items())
    if any(record.event == "page" and record.data["key"] == "training_failed" for record in chain.records):
        yield "training not passed"
    if given_up := sum(record.data.get("given_up", 0) for record in chain.records if record.event == "finished"):
        yield f"{given_up} {'trial' if given_up == 1 else 'trials'} given up"
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
