"""The ledger: who takes part under which number, and how far each journal was seen to reach.

A slot is a number in the design; simulated and real people are counted apart. It is claimed in one transaction,
confirmed when the session finishes, and free again when the participant is given up or withdraws. The ledger only
remembers: plans, journals and tombstones are the truth, from which it can be rebuilt.

This module imports SQLAlchemy; import it where it is used, so that the command line answers at once.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import count
from typing import TYPE_CHECKING

from study.ledger.database import begin_reading, begin_writing, open_database
from study.ledger.entries import LIVE, STATES, Entry, create_tables, read_entries, write_entries
from study.ledger.sightings import Anchor
from study.session.plan import PARTICIPANT_ID

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence
    from pathlib import Path

    from sqlalchemy import Engine

    from study.session.journal import Clock


def open_ledger(path: Path) -> Engine:
    """Open a ledger, or begin an empty one.

    Parameters
    ----------
    path : Path
        The file; its folder must exist.

    Returns
    -------
    Engine
        The ledger, for the functions of this module; threads may share it.

    Raises
    ------
    ValueError
        If the file is damaged.
    OSError
        If it cannot be read or begun.
    """
    ledger = open_database(path)
    create_tables(ledger)
    return ledger


def claim_slots(ledger: Engine, participants: Sequence[str], *, simulated: bool, now: Clock) -> dict[str, int]:
    """Give each participant a number, all in one transaction.

    Parameters
    ----------
    ledger : Engine
        The ledger.
    participants : sequence of str
        The participants' codes. One who holds a slot keeps it; others get the lowest free ones, in order.
    simulated : bool
        Whether they are simulated; real people have slots of their own.
    now : callable
        Gives the time of day, with its zone.

    Returns
    -------
    dict of str to int
        Participant -> number, from 1.

    Raises
    ------
    ValueError
        If a code is not allowed, or was used by someone else or before; then nobody gets a slot.
    """
    for participant in participants:
        if not PARTICIPANT_ID.fullmatch(participant):
            raise ValueError(f"participant: got {participant!r}, allowed are letters, digits, - and _")
    utc = now().isoformat(timespec="seconds")
    with begin_writing(ledger) as connection:
        known = {entry.participant: entry for entry in read_entries(connection)}
        kept = {name: _keep_slot(known[name], simulated=simulated) for name in participants if name in known}
        free = _list_free_numbers(known.values(), simulated=simulated)
        claimed = {name: next(free) for name in dict.fromkeys(participants) if name not in known}
        _check_apart([*known, *claimed])
        write_entries(
            connection, [Entry(name, simulated, slot, "claimed", claimed_utc=utc) for name, slot in claimed.items()]
        )
    return {name: (kept | claimed)[name] for name in participants}


def note_progress(  # noqa: PLR0913 - a row of the ledger, each of its cells by name
    ledger: Engine, participant: str, *, journal: str, lines: int, tip: str, done: int, total: int, state: str
) -> None:
    """Note how far a participant's journal reaches.

    Parameters
    ----------
    ledger : Engine
        The ledger.
    participant : str
        A participant who holds a slot.
    journal : str
        Name of the journal's file.
    lines : int
        Number of its whole lines.
    tip : str
        SHA-256 of the last of them.
    done, total : int
        Trials of the main phase that are done, and all of them.
    state : str
        One of `STATES`; `released` gives the slot up.

    Raises
    ------
    ValueError
        If the participant holds no slot, or the journal is shorter than it was; nothing is noted then.
    """
    if state not in STATES:
        raise ValueError(f"state: got {state!r}, allowed: {', '.join(STATES)}")
    anchor = Anchor(journal, lines, tip)
    with begin_writing(ledger) as connection:
        entry = next(iter(read_entries(connection, participant)), None)
        if entry is None:
            raise ValueError(f"participant {participant}: holds no slot in the ledger; claim one first")
        _check_live(entry)
        _check_grown(entry, anchor)
        anchors = {**{a.journal: a for a in entry.anchors}, journal: anchor}
        noted = replace(entry, state=state, done=done, total=total, anchors=tuple(anchors.values()))
        write_entries(connection, [noted], instead_of=[participant])


def read_ledger(ledger: Engine, participant: str | None = None) -> list[Entry]:
    """Read everything that the ledger knows.

    Parameters
    ----------
    ledger : Engine
        The ledger.
    participant : str, optional
        Whom to read about; all if left out.

    Returns
    -------
    list of Entry
        One per participant: real people before simulated ones, by number, of one number the holder of the slot last.
    """
    with begin_reading(ledger) as connection:
        return read_entries(connection, participant)


def rewrite_ledger(ledger: Engine, change: Callable[[list[Entry]], list[Entry]]) -> list[Entry]:
    """Put other entries into the place of all, in one transaction.

    Parameters
    ----------
    ledger : Engine
        The ledger.
    change : callable
        Takes the entries that are there, gives those that are to be.

    Returns
    -------
    list of Entry
        Those that were there.
    """
    with begin_writing(ledger) as connection:
        before = read_entries(connection)
        write_entries(connection, change(before), instead_of=[entry.participant for entry in before])
    return before


def _list_free_numbers(entries: Iterable[Entry], *, simulated: bool) -> Iterator[int]:
    taken = {entry.number for entry in entries if entry.simulated == simulated and entry.state in LIVE}
    return (number for number in count(1) if number not in taken)


def _keep_slot(entry: Entry, *, simulated: bool) -> int:
    if entry.simulated != simulated:
        got, known = ("simulated", "real") if simulated else ("real", "simulated")
        raise ValueError(
            f"participant {entry.participant}: got a {got} one, the ledger knows a {known} one; take another code"
        )
    _check_live(entry)
    return entry.number


def _check_apart(participants: Sequence[str]) -> None:
    """Refuse codes that differ in capitals only: on many systems they name one folder."""
    named: dict[str, str] = {}
    for name in participants:
        if (other := named.setdefault(name.lower(), name)) != name:
            raise ValueError(f"participant {name}: differs from {other} in capitals only; take another code")


def _check_live(entry: Entry) -> None:
    if entry.state not in LIVE:
        raise ValueError(f"participant {entry.participant}: was {entry.state}; no code is used twice, take another")


def _check_grown(entry: Entry, anchor: Anchor) -> None:
    seen = next((a for a in entry.anchors if a.journal == anchor.journal), anchor)
    if anchor.lines < seen.lines or (anchor.lines == seen.lines and anchor.tip != seen.tip):
        raise ValueError(
            f"participant {entry.participant}: got {anchor.journal} with {anchor.lines} lines, {seen.lines} were seen, "
            "and another end; restore the file from a copy, or take it as it is: feel321 ledger --rebuild"
        )
