"""The ledger: who takes part under which number, and how far each session is. SQLite behind SQLAlchemy.

A slot is a number in the design; simulated and real people are counted apart. It is claimed in one transaction,
confirmed when the session finishes, and free again when the participant is given up or withdraws. The ledger only
remembers: plans, journals and tombstones are the truth, from which it can be rebuilt.

Transactions that write take the file's lock at their beginning (`BEGIN IMMEDIATE`), so that what they read cannot
change before they write; others wait. The rollback journal is left as it is: it survives a kill, and unlike a
write-ahead log it works on a network drive.

This module imports SQLAlchemy; import it where it is used, so that the command line answers at once.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import Field, asdict, dataclass, field, fields, replace
from itertools import count
from pathlib import Path
from shlex import quote
from sqlite3 import Connection as SqliteConnection

import sqlalchemy as sa
from sqlalchemy.exc import DBAPIError
from sqlalchemy.pool import NullPool

from feel321.study.folder import StudyFolder
from feel321.study.ledger import progress
from feel321.study.session.journal import (
    Clock,
    create_journal,
    read_journal,
    require_journal,
    utc_now,
)
from feel321.study.session.plan import PARTICIPANT_ID, TOMBSTONE_FILE

PATIENCE_S = 60.0
"""How long a transaction waits for others to end."""

_DAMAGED = {"SQLITE_NOTADB", "SQLITE_CORRUPT", "SQLITE_ERROR"}
"""What SQLite says of a file that is no database, a damaged one, or one with other tables."""

LIVE = ("claimed", "running", "finished")
"""States in which a participant holds a slot."""

STATES = (*LIVE, "released", "withdrawn")


@dataclass(frozen=True, slots=True)
class Entry:
    """What the ledger knows about a participant; `number` is that in the design, from 1."""

    participant: str
    simulated: bool
    number: int
    state: str
    done: int = 0
    total: int = 0
    anchors: tuple[progress.Anchor, ...] = ()
    claimed_utc: str = field(default="", compare=False)


_TABLES = sa.MetaData()
_TYPES: dict[object, type] = {str: sa.String, bool: sa.Boolean, int: sa.Integer}


def _declare(name: str, *columns: Field[object], keys: Sequence[str]) -> sa.Table:
    made: list[sa.Column[object]] = [
        sa.Column(one.name, _TYPES[one.type], primary_key=one.name in keys, nullable=False)
        for one in columns
    ]
    return sa.Table(name, _TABLES, *made)


_NAME, *_REST = (one for one in fields(Entry) if one.name != "anchors")
_PARTICIPANTS = _declare("participants", _NAME, *_REST, keys=["participant"])
_ANCHORS = _declare("anchors", _NAME, *fields(progress.Anchor), keys=["participant", "journal"])
_HOLDS_SLOT = _PARTICIPANTS.c.state.in_(LIVE)
# Claims see to it by themselves; this keeps any other program from doing otherwise.
sa.Index(
    "one_participant_per_slot",
    _PARTICIPANTS.c.simulated,
    _PARTICIPANTS.c.number,
    unique=True,
    sqlite_where=_HOLDS_SLOT,
    postgresql_where=_HOLDS_SLOT,
)


# Transactions.


def open_ledger(path: Path) -> sa.Engine:
    """Open a ledger, or begin an empty one; one that may only be read is not written to."""
    # No pool: connections cost little here, and none is left open in a thread or a forked process.
    ledger = sa.create_engine(
        sa.URL.create("sqlite", database=str(path)),
        poolclass=NullPool,
        connect_args={"timeout": PATIENCE_S},
    )
    sa.event.listen(ledger, "connect", _leave_transactions_alone)
    sa.event.listen(ledger, "begin", _begin)
    with _transact(ledger, writes=False) as connection:
        missing = not all(sa.inspect(connection).has_table(name) for name in _TABLES.tables)
    if missing:
        with _transact(ledger) as connection:
            _TABLES.create_all(connection)
    return ledger


@contextmanager
def _transact(ledger: sa.Engine, *, writes: bool = True) -> Iterator[sa.Connection]:
    """Do all of what is inside, or nothing; no other transaction comes in between."""
    try:
        with ledger.execution_options(writes=writes).begin() as connection:
            yield connection
    except DBAPIError as error:
        path, reason = ledger.url.database, error.orig
        if getattr(reason, "sqlite_errorname", "") in _DAMAGED:
            raise ValueError(
                f"{path}: got a damaged file ({reason}); move it away, then rebuild it from the journals: "
                "feel321 ledger --rebuild"
            ) from error
        raise OSError(
            f"{path}: could not be used ({reason}); check that the folder may be written to, the disk has room "
            "and no other program holds the file, then run again"
        ) from error


def _leave_transactions_alone(connection: SqliteConnection, _record: object) -> None:
    # Python's sqlite3 would begin transactions by itself, and late.
    connection.isolation_level = None


def _begin(connection: sa.Connection) -> None:
    writes = connection.get_execution_options()["writes"]
    connection.exec_driver_sql("BEGIN IMMEDIATE" if writes else "BEGIN")


def _read(connection: sa.Connection, participant: str | None = None) -> list[Entry]:
    people, seen = sa.select(_PARTICIPANTS), sa.select(_ANCHORS).order_by(_ANCHORS.c.journal)
    if participant is not None:
        people = people.where(_PARTICIPANTS.c.participant == participant)
        seen = seen.where(_ANCHORS.c.participant == participant)
    anchors: dict[str, tuple[progress.Anchor, ...]] = {}
    for name, *anchor in connection.execute(seen):
        anchors[name] = (*anchors.get(name, ()), progress.Anchor(*anchor))
    entries = [
        Entry(**row, anchors=anchors.get(row["participant"], ()))
        for row in connection.execute(people).mappings()
    ]
    return sorted(
        entries,
        key=lambda entry: (entry.simulated, entry.number, entry.state in LIVE, entry.participant),
    )


def _write(
    connection: sa.Connection, entries: Sequence[Entry], *, instead_of: Iterable[str] = ()
) -> None:
    names = list(instead_of)
    rows = [asdict(entry) for entry in entries]
    anchors = [
        {"participant": row["participant"], **anchor}
        for row in rows
        for anchor in row.pop("anchors")
    ]
    for table, values in ((_PARTICIPANTS, rows), (_ANCHORS, anchors)):
        connection.execute(sa.delete(table).where(table.c.participant.in_(names)))
        if values:  # Without any, one row of defaults would be written.
            connection.execute(sa.insert(table), values)


# Claims and progress.


def claim_slots(
    ledger: sa.Engine, participants: Sequence[str], *, simulated: bool, now: Clock
) -> dict[str, int]:
    """Give each participant a number, from 1, all in one transaction."""
    for participant in participants:
        if not PARTICIPANT_ID.fullmatch(participant):
            raise ValueError(
                f"participant must be letters, digits, - and _, got {participant!r}; use another code"
            )
    utc = now().isoformat(timespec="seconds")
    with _transact(ledger) as connection:
        known = {entry.participant: entry for entry in _read(connection)}
        taken = {
            entry.number
            for entry in known.values()
            if entry.simulated == simulated and entry.state in LIVE
        }
        free = (number for number in count(1) if number not in taken)
        numbers = {
            name: _keep_slot(known[name], simulated=simulated) if name in known else next(free)
            for name in dict.fromkeys(participants)
        }
        _check_capitals([*known, *numbers])
        claimed = [
            Entry(name, simulated, number, "claimed", claimed_utc=utc)
            for name, number in numbers.items()
            if name not in known
        ]
        _write(connection, claimed)
    return numbers


def _keep_slot(entry: Entry, *, simulated: bool) -> int:
    if entry.simulated != simulated:
        got, known = ("simulated", "real") if simulated else ("real", "simulated")
        raise ValueError(
            f"participant {entry.participant}: {known} in the ledger, got a {got} one; use another code"
        )
    _check_live(entry)
    return entry.number


def _check_capitals(participants: Sequence[str]) -> None:
    """Refuse codes that differ in capitals only: on many systems they name one folder."""
    named: dict[str, str] = {}
    for name in participants:
        if (other := named.setdefault(name.lower(), name)) != name:
            raise ValueError(
                f"participant {name}: differs from {other} in capitals only; use another code"
            )


def _check_live(entry: Entry) -> None:
    if entry.state not in LIVE:
        raise ValueError(
            f"participant {entry.participant}: was {entry.state}; no code is used twice, use another"
        )


def note_progress(
    ledger: sa.Engine,
    participant: str,
    *,
    anchor: progress.Anchor,
    done: int,
    total: int,
    state: str,
) -> None:
    """Record how far a participant's journal reaches."""
    if state not in STATES:
        raise ValueError(f"state must be one of {', '.join(STATES)}, got {state!r}")
    with _transact(ledger) as connection:
        entry = next(iter(_read(connection, participant)), None)
        if entry is None:
            raise ValueError(f"participant {participant}: no slot in the ledger; claim one first")
        _check_live(entry)
        anchors = {seen.journal: seen for seen in entry.anchors}
        seen = anchors.get(anchor.journal, anchor)
        if anchor.lines < seen.lines or (anchor.lines == seen.lines and anchor != seen):
            raise ValueError(
                f"participant {participant}: got {anchor.journal} with {anchor.lines} lines, {seen.lines} were "
                "seen, and another end; restore the file from a copy, or accept it as it is: feel321 ledger --rebuild"
            )
        anchors[anchor.journal] = anchor
        noted = replace(entry, state=state, done=done, total=total, anchors=tuple(anchors.values()))
        _write(connection, [noted], instead_of=[participant])


def read_ledger(ledger: sa.Engine, participant: str | None = None) -> list[Entry]:
    """Read all that the ledger knows, or what it knows of one participant."""
    with _transact(ledger, writes=False) as connection:
        return _read(connection, participant)


def rewrite_ledger(ledger: sa.Engine, change: Callable[[list[Entry]], list[Entry]]) -> list[Entry]:
    """Replace all entries by others, in one transaction; returns those before."""
    with _transact(ledger) as connection:
        before = _read(connection)
        _write(connection, change(before), instead_of=[entry.participant for entry in before])
    return before


# The ledger of a study, rebuilt from its files.

WAS_MISSING = "all that it had seen, for it was missing"


def open_study_ledger(study: StudyFolder, *, now: Clock = utc_now) -> tuple[sa.Engine, str]:
    """Open the ledger of a study to write in it; one that is missing is rebuilt, and the log beside it says so."""
    ledger = _open(study)
    if read_ledger(ledger):
        return ledger, ""
    entries, _ = _read_disk(study)

    def change(known: list[Entry]) -> list[Entry]:
        # Another process may have found it missing first, and claimed slots since.
        if not known:
            _log_forgotten(study, [WAS_MISSING], now=now)
        return known or entries

    if not entries or rewrite_ledger(ledger, change):
        return ledger, ""
    done = f"{len(entries)} participants were entered from their plans and journals"
    return ledger, f"{study.ledger}: was missing; {done}"


def read_study_ledger(study: StudyFolder) -> list[Entry]:
    """Read the ledger of a study and write nothing."""
    if study.ledger.exists():
        return read_ledger(open_ledger(study.ledger))
    if any(map(_is_begun, study.participants)):
        raise FileNotFoundError(
            f"{study.ledger}: is missing, so losses cannot be detected; rebuild it: {_write_rebuild(study)}"
        )
    return []


def rebuild_ledger(study: StudyFolder, *, now: Clock = utc_now) -> list[str]:
    """Make the ledger of a study anew from plans, journals and tombstones.

    Slots claimed by participants without a plan so far are kept: they are recorded nowhere else. What is forgotten is
    recorded for good in a log beside the ledger.
    """
    was_missing = not study.ledger.exists()
    lost, wrong = ([], []) if was_missing else _compare(study)
    problems: list[str] = []

    def change(known: list[Entry]) -> list[Entry]:
        entries, found = _read_disk(study)
        problems.extend(found)
        names = {entry.participant for entry in entries}
        entries += [
            entry
            for entry in known
            if entry.state == "claimed" and not entry.anchors and entry.participant not in names
        ]
        _check_slots(entries)
        _log_forgotten(study, [WAS_MISSING] if was_missing and names else lost, now=now)
        return entries

    rewrite_ledger(_open(study), change)
    return lost + wrong + problems


def find_lost(study: StudyFolder) -> list[str]:
    """Find what the ledger once saw and the disk no longer holds, the reverse, and what it ever forgot."""
    lost, wrong = _compare(study)
    return lost + wrong + list_forgotten(study)


def make_entry(own: progress.Progress) -> Entry:
    """Make the entry of a participant from plan and journals."""
    total = (
        own.total if own.anchors else 0
    )  # The ledger learns it with the first line that it sees.
    known = (own.participant, own.simulated, own.number, own.state, own.done, total, own.anchors)
    return Entry(*known, claimed_utc=own.first_utc)


def _log_forgotten(study: StudyFolder, lines: Sequence[str], *, now: Clock) -> None:
    """Log for good what the ledger forgets with a rebuild: without that, a journal could be cut unseen."""
    if lines:
        begin = require_journal if study.ledger_log.exists() else create_journal
        # The folder may be moved, its log with it.
        forgot = [line.replace(f"{study.path}/", "") for line in lines]
        begin(study.ledger_log, now=now).write("rebuilt", {"forgot": forgot})


def list_forgotten(study: StudyFolder) -> list[str]:
    """List what the ledger ever forgot with a rebuild."""
    if not study.ledger_log.exists():
        return []
    try:
        records = read_journal(study.ledger_log).records
    except (OSError, ValueError) as error:
        return [str(error)]
    return [
        f"{study.ledger}: was rebuilt at {record.utc}, and forgot: {line}"
        for record in records
        for line in record.data.get("forgot", ())
    ]


def _write_rebuild(study: StudyFolder) -> str:
    return f"feel321 ledger {quote(str(study.path))} --rebuild"


def _open(study: StudyFolder) -> sa.Engine:
    study.sessions.mkdir(exist_ok=True)
    return open_ledger(study.ledger)


def _read_disk(study: StudyFolder) -> tuple[list[Entry], list[str]]:
    """Read the entries of all participants, and what is wrong with their journals."""
    everybody = progress.list_progress(study)
    stones = filter(None, (progress.read_tombstone(folder) for folder in study.participants))
    entries = [
        *map(make_entry, everybody),
        *(Entry(one.participant, one.simulated, one.number, "withdrawn") for one in stones),
    ]
    _check_slots(entries)
    return entries, [own.problem for own in everybody if own.problem]


def _check_slots(entries: Iterable[Entry]) -> None:
    holders: dict[tuple[bool, int], str] = {}
    for entry in entries:
        if entry.state in LIVE:
            holder = holders.setdefault((entry.simulated, entry.number), entry.participant)
            if holder != entry.participant:
                raise ValueError(
                    f"number {entry.number} must be held by one participant, got {holder} and {entry.participant}; "
                    "release one, or move one's folder out of sessions/"
                )


def _is_begun(folder: Path) -> bool:
    return any(folder.glob("*.json*"))


def _compare(study: StudyFolder) -> tuple[list[str], list[str]]:
    """Find what the ledger saw and the disk does not hold, and what a rebuild only corrects."""
    try:
        entries = {entry.participant: entry for entry in read_study_ledger(study)}
    except (OSError, ValueError) as error:
        return [str(error)], []
    lost: list[str] = []
    wrong: list[str] = []
    for entry in entries.values():
        lines = list(_find_lost_of(entry, study))
        lost += lines
        wrong += [] if lines else _find_edited(entry, study)
    wrong += [
        f"{folder}: is not in the ledger; enter it: {_write_rebuild(study)}"
        for folder in study.participants
        if folder.name not in entries and _is_begun(folder)
    ]
    return lost, wrong


def _find_lost_of(entry: Entry, study: StudyFolder) -> Iterator[str]:
    folder = study.sessions / entry.participant
    try:
        tombstone = progress.read_tombstone(folder)
    except ValueError as error:
        yield str(error)
        return
    if tombstone is not None:
        yield from _find_unlike(tombstone, entry, study)
    elif entry.state == "withdrawn":
        yield f"{folder}: the participant was withdrawn, the tombstone is gone; restore it from a copy"
    elif entry.anchors and not _is_begun(folder):
        lines = sum(anchor.lines for anchor in entry.anchors)
        yield f"{folder}: is gone without a tombstone, {lines} lines of its journals were seen; restore it from a copy"
    else:
        yield from filter(None, (progress.find_cut(anchor, folder) for anchor in entry.anchors))


def _find_unlike(tombstone: progress.Tombstone, entry: Entry, study: StudyFolder) -> Iterator[str]:
    folder = study.sessions / entry.participant
    if (tombstone.state, entry.state) != (progress.REMOVED, "withdrawn"):
        again = f"feel321 withdraw {quote(str(study.path))} --participant {entry.participant}"
        yield f"{folder}: the withdrawal was interrupted; finish it: {again}"
    elif (tombstone.number, tombstone.simulated) != (entry.number, entry.simulated):
        yield f"{folder}: the tombstone is not the one that the ledger knows; restore both from a copy"


def _find_edited(entry: Entry, study: StudyFolder) -> Iterator[str]:
    """Find what the ledger says of a participant and neither plan nor journals ever said."""
    folder = study.sessions / entry.participant
    if (folder / TOMBSTONE_FILE).exists() or not _is_begun(folder):
        return
    try:
        own = progress.read_progress(folder)
    except (OSError, ValueError):
        return  # What is wrong with plan or journals is reported by whoever reads them.
    names = ["number", "simulated"]
    # The ledger may lag behind a journal, but what ends a session it only knows from there.
    ended = entry.anchors == own.anchors or entry.state in {"finished", "released"}
    for name in [*names, "state"] if ended and not own.problem else names:
        got, expected = getattr(entry, name), getattr(own, name)
        if got != expected:
            yield (
                f"{study.ledger}: {entry.participant} has {name} {got}, plan and journals say {expected}; "
                f"rebuild it: {_write_rebuild(study)}"
            )
