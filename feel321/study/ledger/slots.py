"""The ledger: who takes part under which number, and how far each session is.

A slot is a number in the design; simulated and real people are counted apart. It is claimed in one transaction,
confirmed when the session finishes, and free again when the participant is given up or withdraws. The ledger only
remembers: plans, journals and tombstones are the truth, from which it can be rebuilt.

This module imports SQLAlchemy; import it where it is used, so that the command line answers at once.
"""

from __future__ import annotations

import csv
import io
from dataclasses import dataclass, replace
from itertools import count
from typing import TYPE_CHECKING, Any

from feel321.files import write_text
from feel321.study.columns import LAST_PARTICIPANT_COLUMNS, PARTICIPANT_COLUMNS
from feel321.study.ledger.database import (
    LIVE,
    STATES,
    Anchor,
    Entry,
    begin_reading,
    begin_writing,
    create_tables,
    open_database,
    read_anchor,
    read_entries,
    write_entries,
)
from feel321.study.session.opening import (
    PLAN_FILE,
    TOMBSTONE_FILE,
    Dossier,
    read_as_written,
    read_dossier,
    require_own_plan,
)
from feel321.study.session.plan import PARTICIPANT_ID, find_header, has_event, list_journals, replay

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
    from pathlib import Path

    from sqlalchemy import Engine

    from feel321.study.folder import StudyFolder
    from feel321.study.session.journal import Clock, Record

# The ledger: who takes part under which number, and how far each journal was seen to reach.


def open_ledger(path: Path) -> Engine:
    """Open a ledger, or begin an empty one."""
    ledger = open_database(path)
    create_tables(ledger)
    return ledger


def claim_slots(
    ledger: Engine, participants: Sequence[str], *, simulated: bool, now: Clock
) -> dict[str, int]:
    """Give each participant a number, all in one transaction.

    Returns participant -> number, from 1.
    """
    for participant in participants:
        if not PARTICIPANT_ID.fullmatch(participant):
            raise ValueError(
                f"participant: got {participant!r}, allowed are letters, digits, - and _"
            )
    utc = now().isoformat(timespec="seconds")
    with begin_writing(ledger) as connection:
        known = {entry.participant: entry for entry in read_entries(connection)}
        kept = {
            name: _keep_slot(known[name], simulated=simulated)
            for name in participants
            if name in known
        }
        free = _list_free_numbers(known.values(), simulated=simulated)
        claimed = {name: next(free) for name in dict.fromkeys(participants) if name not in known}
        _check_apart([*known, *claimed])
        write_entries(
            connection,
            [
                Entry(name, simulated, slot, "claimed", claimed_utc=utc)
                for name, slot in claimed.items()
            ],
        )
    return {name: (kept | claimed)[name] for name in participants}


def note_progress(  # noqa: PLR0913 - a row of the ledger, each of its cells by name
    ledger: Engine,
    participant: str,
    *,
    journal: str,
    lines: int,
    tip: str,
    done: int,
    total: int,
    state: str,
) -> None:
    """Note how far a participant's journal reaches."""
    if state not in STATES:
        raise ValueError(f"state: got {state!r}, allowed: {', '.join(STATES)}")
    anchor = Anchor(journal, lines, tip)
    with begin_writing(ledger) as connection:
        entry = next(iter(read_entries(connection, participant)), None)
        if entry is None:
            raise ValueError(
                f"participant {participant}: holds no slot in the ledger; claim one first"
            )
        _check_live(entry)
        _check_grown(entry, anchor)
        anchors = {**{a.journal: a for a in entry.anchors}, journal: anchor}
        noted = replace(entry, state=state, done=done, total=total, anchors=tuple(anchors.values()))
        write_entries(connection, [noted], instead_of=[participant])


def read_ledger(ledger: Engine, participant: str | None = None) -> list[Entry]:
    """Read everything that the ledger knows."""
    with begin_reading(ledger) as connection:
        return read_entries(connection, participant)


def rewrite_ledger(ledger: Engine, change: Callable[[list[Entry]], list[Entry]]) -> list[Entry]:
    """Put other entries into the place of all, in one transaction."""
    with begin_writing(ledger) as connection:
        before = read_entries(connection)
        write_entries(
            connection, change(before), instead_of=[entry.participant for entry in before]
        )
    return before


def _list_free_numbers(entries: Iterable[Entry], *, simulated: bool) -> Iterator[int]:
    taken = {
        entry.number for entry in entries if entry.simulated == simulated and entry.state in LIVE
    }
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
            raise ValueError(
                f"participant {name}: differs from {other} in capitals only; take another code"
            )


def _check_live(entry: Entry) -> None:
    if entry.state not in LIVE:
        raise ValueError(
            f"participant {entry.participant}: was {entry.state}; no code is used twice, take another"
        )


def _check_grown(entry: Entry, anchor: Anchor) -> None:
    seen = next((a for a in entry.anchors if a.journal == anchor.journal), anchor)
    if anchor.lines < seen.lines or (anchor.lines == seen.lines and anchor.tip != seen.tip):
        raise ValueError(
            f"participant {entry.participant}: got {anchor.journal} with {anchor.lines} lines, {seen.lines} were seen, "
            "and another end; restore the file from a copy, or take it as it is: feel321 ledger --rebuild"
        )


# Where each participant stands, by plan and journals and by nothing else.


@dataclass(frozen=True, slots=True)
class Standing:
    """Where a participant stands."""

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
    """Read where all participants stand who have a plan or a journal and did not withdraw."""
    return [read_standing(folder) for folder in study.participants if _takes_part(folder)]


def read_standing(folder: Path) -> Standing:
    """Read where one participant stands, also while a session runs."""
    try:
        return make_standing(read_dossier(folder))
    except ValueError as error:
        # A broken plan raises again; of a broken journal the plan still says who it is.
        planned = make_standing(Dossier(folder, require_own_plan(folder), ()))
        return replace(planned, state="running", problem=str(error))


def make_standing(dossier: Dossier) -> Standing:
    """Read off where one participant stands."""
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


# `participants.csv`: one row per participant, derived from plans and journals and from nothing else.

ROSTER_FILE = "participants.csv"


_TRUTH = {True: "true", False: "false", None: ""}


def write_roster(study: StudyFolder) -> Path:
    """Write who takes part, in which group, and how far they have come; those who withdrew are not there."""
    standings = read_standings(study)
    for standing in standings:
        if standing.problem:
            raise ValueError(standing.problem)
    factors = dict.fromkeys(factor for standing in standings for factor in standing.groups)
    rows = [_make_row(standing) for standing in standings]
    text = io.StringIO(newline="")
    table = csv.DictWriter(text, [*PARTICIPANT_COLUMNS, *factors, *LAST_PARTICIPANT_COLUMNS])
    table.writeheader()
    table.writerows(rows)
    path = study.path / ROSTER_FILE
    write_text(path, text.getvalue())
    return path


def _make_row(standing: Standing) -> dict[str, Any]:
    return {
        **standing.groups,
        "participant": standing.participant,
        "number": standing.number,
        "simulated": _TRUTH[standing.simulated],
        "state": standing.state,
        "sessions": len(standing.anchors),
        "done": standing.done,
        "total": standing.total,
        "first_utc": standing.first_utc,
        "last_utc": standing.last_utc,
        "training_passed": _TRUTH[standing.training_passed],
    }
