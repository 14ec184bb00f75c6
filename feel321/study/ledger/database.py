"""The ledger's database: SQLite behind SQLAlchemy, its tables, and the anchors of the journals.

Transactions that write take the file's lock at their beginning (`BEGIN IMMEDIATE`), so that what they read cannot
change before they write; others wait. The rollback journal is left as it is: it survives a kill, and unlike a
write-ahead log it works on a network drive.

The chain inside a journal cannot tell that whole lines are missing at its end; whoever kept an anchor can.

The log is a chain like a journal's. Without it, a journal could be cut and the ledger made to agree.
"""

from __future__ import annotations

from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from shlex import quote
from typing import TYPE_CHECKING

from sqlalchemy import (
    URL,
    Boolean,
    Column,
    Index,
    Integer,
    MetaData,
    String,
    Table,
    create_engine,
    delete,
    event,
    insert,
    inspect,
    select,
)
from sqlalchemy.exc import DBAPIError
from sqlalchemy.pool import NullPool

from feel321.study.session.journal import (
    START,
    create_journal,
    digest,
    read_journal,
    require_journal,
)

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence
    from pathlib import Path
    from sqlite3 import Connection as SqliteConnection

    from sqlalchemy import Connection, Engine

    from feel321.study.folder import StudyFolder
    from feel321.study.session.journal import Clock

# A SQLite file behind SQLAlchemy: all that is SQLite's own, so that a server can take its place.

PATIENCE_S = 60.0
"""How long a transaction waits for others to end."""

_DAMAGED = {"SQLITE_NOTADB", "SQLITE_CORRUPT", "SQLITE_ERROR"}
"""What SQLite says of a file that is no database, a damaged one, or one with other tables."""


def open_database(path: Path) -> Engine:
    """Open a SQLite file; it is created with the first connection."""
    # No pool: connections cost little here, and none is left open in a thread or a forked process.
    engine = create_engine(
        URL.create("sqlite", database=str(path)),
        poolclass=NullPool,
        connect_args={"timeout": PATIENCE_S},
    )
    event.listen(engine, "connect", _leave_transactions_alone)
    event.listen(engine, "begin", _begin)
    return engine


@contextmanager
def begin_reading(engine: Engine) -> Iterator[Connection]:
    """Read in one transaction, which sees one state and writes nothing."""
    with _speak_plainly(engine), engine.execution_options(only_reads=True).begin() as connection:
        yield connection


@contextmanager
def begin_writing(engine: Engine) -> Iterator[Connection]:
    """Read and write in one transaction: all of it happens, or nothing, and no other one in between."""
    with _speak_plainly(engine), engine.begin() as connection:
        yield connection


def _leave_transactions_alone(connection: SqliteConnection, _record: object) -> None:
    # Python's sqlite3 would begin transactions by itself, and late.
    connection.isolation_level = None


def _begin(connection: Connection) -> None:
    only_reads = connection.get_execution_options().get("only_reads", False)
    connection.exec_driver_sql("BEGIN" if only_reads else "BEGIN IMMEDIATE")


@contextmanager
def _speak_plainly(engine: Engine) -> Iterator[None]:
    try:
        yield
    except DBAPIError as error:
        path, reason = engine.url.database, error.orig
        if getattr(reason, "sqlite_errorname", "") in _DAMAGED:
            raise ValueError(
                f"{path}: got a damaged file ({reason}); move it away, then rebuild it from the journals: "
                "feel321 ledger --rebuild"
            ) from error
        raise OSError(
            f"{path}: could not be used ({reason}); see that the folder may be written to, the disk has room "
            "and no other program holds the file, then run again"
        ) from error


# What was last seen of a journal: how many lines, and the digest of the last of them.


@dataclass(frozen=True, slots=True)
class Anchor:
    """What was seen of a journal."""

    journal: str
    lines: int
    tip: str


def read_anchor(path: Path) -> Anchor:
    """Look at a journal as it is now, whether or not its chain holds."""
    lines = _read_lines(path)
    return Anchor(path.name, len(lines), digest(lines[-1]) if lines else START)


def find_cut(anchor: Anchor, folder: Path) -> str:
    """Tell what is missing of a journal since it was last seen."""
    path = folder / anchor.journal
    if not path.is_file():
        return f"{path}: is gone, {anchor.lines} lines of it were seen"
    lines = _read_lines(path)
    if len(lines) < anchor.lines:
        return f"{path}: ends with line {len(lines)}, {anchor.lines} lines of it were seen"
    if anchor.lines and digest(lines[anchor.lines - 1]) != anchor.tip:
        return f"{path}, line {anchor.lines}: is not the line that was seen there"
    return ""


def check_anchors(anchors: Iterable[Anchor], folder: Path) -> None:
    """Refuse to go on with journals of which less is there than was seen."""
    for anchor in anchors:
        if cut := find_cut(anchor, folder):
            rebuild = f"feel321 ledger {quote(str(folder.parent.parent))} --rebuild"
            raise ValueError(f"{cut}; restore it from a copy, or take it as it is: {rebuild}")


def _read_lines(path: Path) -> list[bytes]:
    return path.read_bytes().split(b"\n")[:-1]


# The ledger's tables, and the record that stands for a row of them.

LIVE = ("claimed", "running", "finished")
"""States in which a participant holds a slot."""

STATES = (*LIVE, "released", "withdrawn")

_TABLES = MetaData()
_PARTICIPANTS = Table(
    "participants",
    _TABLES,
    Column("participant", String, primary_key=True),
    Column("simulated", Boolean, nullable=False),
    Column("number", Integer, nullable=False),
    Column("state", String, nullable=False),
    Column("done", Integer, nullable=False),
    Column("total", Integer, nullable=False),
    Column("claimed_utc", String, nullable=False),
)
_ANCHORS = Table(
    "anchors",
    _TABLES,
    Column("participant", String, primary_key=True),
    Column("journal", String, primary_key=True),
    Column("lines", Integer, nullable=False),
    Column("tip", String, nullable=False),
)
_HOLDS_SLOT = _PARTICIPANTS.c.state.in_(LIVE)
# Claims see to it by themselves; this keeps any other program from doing otherwise.
Index(
    "one_participant_per_slot",
    _PARTICIPANTS.c.simulated,
    _PARTICIPANTS.c.number,
    unique=True,
    sqlite_where=_HOLDS_SLOT,
    postgresql_where=_HOLDS_SLOT,
)


@dataclass(frozen=True, slots=True)
class Entry:
    """What the ledger knows about a participant.

    number: the participant's number in the design, from 1.
    """

    participant: str
    simulated: bool
    number: int
    state: str
    done: int = 0
    total: int = 0
    anchors: tuple[Anchor, ...] = ()
    claimed_utc: str = field(default="", compare=False)


def create_tables(ledger: Engine) -> None:
    """Create the tables unless they are there; a ledger that may only be read is not written to."""
    with begin_reading(ledger) as connection:
        missing = not all(inspect(connection).has_table(name) for name in _TABLES.tables)
    if missing:
        with begin_writing(ledger) as connection:
            _TABLES.create_all(connection)


def read_entries(connection: Connection, participant: str | None = None) -> list[Entry]:
    """Read entries within a transaction."""
    people, seen = select(_PARTICIPANTS), select(_ANCHORS).order_by(_ANCHORS.c.journal)
    if participant is not None:
        people = people.where(_PARTICIPANTS.c.participant == participant)
        seen = seen.where(_ANCHORS.c.participant == participant)
    anchors: dict[str, list[Anchor]] = {}
    for row in connection.execute(seen):
        anchors.setdefault(row.participant, []).append(Anchor(row.journal, row.lines, row.tip))
    entries = [
        Entry(**row, anchors=tuple(anchors.get(row["participant"], ())))
        for row in connection.execute(people).mappings()
    ]
    return sorted(
        entries,
        key=lambda entry: (entry.simulated, entry.number, entry.state in LIVE, entry.participant),
    )


def write_entries(
    connection: Connection, entries: Sequence[Entry], *, instead_of: Sequence[str] = ()
) -> None:
    """Write entries within a transaction."""
    for table in (_PARTICIPANTS, _ANCHORS):
        connection.execute(delete(table).where(table.c.participant.in_(instead_of)))
    rows = [asdict(entry) for entry in entries]
    anchors = [
        {"participant": row["participant"], **anchor}
        for row in rows
        for anchor in row.pop("anchors")
    ]
    for table, values in ((_PARTICIPANTS, rows), (_ANCHORS, anchors)):
        if values:  # Without any, one row of defaults would be written.
            connection.execute(insert(table), values)


# What the ledger forgot: a log beside it, in which every rebuild that lost anything leaves a line for good.

WAS_MISSING = "all that it had seen, for it was missing"


def tell_time() -> datetime:
    """Tell the time of day."""
    return datetime.now(UTC)


def note_forgotten(study: StudyFolder, lines: Sequence[str], *, now: Clock) -> None:
    """Note what the ledger forgets with a rebuild; if that is nothing, nothing is noted."""
    if not lines:
        return
    # The folder may be moved, its log with it.
    forgot = [line.replace(f"{study.path}/", "") for line in lines]
    begin = require_journal if study.ledger_log.exists() else create_journal
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
