"""What a journal says about its session: how it was begun, how far it has come, what comes next."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

from protocols.agenda import Agenda
from protocols.scoring import is_as_expected

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping
    from pathlib import Path

    from protocols.trial import Trial
    from study.session.chain import Record
    from study.session.plan import Plan

SESSION_FILE = re.compile(r"session-(\d{2,})\.jsonl")
"""Names of the journals in a participant's folder; copies under other names are none."""


def name_journal(session: int) -> str:
    """Name the file of a session's journal.

    Parameters
    ----------
    session : int
        The session's number, from 1.

    Returns
    -------
    str
        Its name in the participant's folder.

    Examples
    --------
    >>> name_journal(1)
    'session-01.jsonl'
    """
    return f"session-{session:02d}.jsonl"


def list_journals(folder: Path) -> list[Path]:
    """List the journals of a participant.

    Parameters
    ----------
    folder : Path
        The participant's folder.

    Returns
    -------
    list of Path
        Oldest first.
    """
    found = {path: SESSION_FILE.fullmatch(path.name) for path in folder.glob("session-*.jsonl")}
    return sorted((path for path, match in found.items() if match), key=lambda path: int(path.stem.rpartition("-")[2]))


def find_header(records: Iterable[Record]) -> Mapping[str, Any] | None:
    """Find what a session was begun with.

    Parameters
    ----------
    records : iterable of Record
        A journal's records.

    Returns
    -------
    mapping or None
        The header; None if a crash came before it was written.
    """
    return next((record.data for record in records if record.event == "begun"), None)


def find_elapsed(records: Iterable[Record]) -> float:
    """Find how far the presenter's clock had come.

    Parameters
    ----------
    records : iterable of Record
        A journal's records.

    Returns
    -------
    float
        Seconds since the session began; 0 before the first record that tells.
    """
    # Onsets do not count: an attempt that was broken off never was, and comes again in its own time.
    return max((record.data["time_s"] for record in records if "time_s" in record.data), default=0.0)


def has_event(records: Iterable[Record], event: str) -> bool:
    """Tell whether something ever happened in a session.

    Parameters
    ----------
    records : iterable of Record
        A journal's records.
    event : str
        What.

    Returns
    -------
    bool
        True if it did.
    """
    return any(record.event == event for record in records)


def replay(plan: Plan, records: Iterable[Record]) -> Agenda:
    """Tell a new agenda all that a journal holds.

    Parameters
    ----------
    plan : Plan
        The plan of the session.
    records : iterable of Record
        The journal's records.

    Returns
    -------
    Agenda
        It stands where the session stood.

    Raises
    ------
    ValueError
        If the journal tells of a step that was not next, naming the line.
    """
    agenda = Agenda(plan.trials, plan.flow)
    trials = {trial.number: trial for trial in plan.trials}
    for record in records:
        try:
            tell(agenda, record, trials)
        except ValueError as error:
            raise ValueError(f"line {record.sequence + 1}: {error}") from None
    return agenda


def tell(agenda: Agenda, record: Record, trials: Mapping[int, Trial]) -> None:
    """Tell an agenda what one record says; most say nothing about what comes next.

    Parameters
    ----------
    agenda : Agenda
        The agenda.
    record : Record
        The record.
    trials : mapping of int to Trial
        The plan's trials by number.

    Raises
    ------
    ValueError
        If another step was next.
    """
    data = record.data
    match record.event:
        case "page":
            agenda.tell_page(data["key"], time_s=data["time_s"])
        case "rated":
            understood = is_as_expected(trials[data["trial"]], data["values"]) if data["trial"] in trials else None
            accepted = not data["rejected"]
            agenda.tell_trial(data["trial"], accepted=accepted, as_expected=understood, time_s=data["time_s"])
        case "spoiled":
            spent = "device_error" not in data["flags"]
            agenda.tell_trial(data["trial"], accepted=False, as_expected=None, time_s=data["time_s"], spent=spent)
        case "warm_up":
            agenda.warm_up()
