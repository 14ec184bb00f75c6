"""The ledger's tables and transactions: SQLite in a file, or PostgreSQL in a schema of a server. Behind SQLAlchemy.

Transactions that write come one after the other, so that what they read cannot change before they write: in SQLite
they take the file's lock at their beginning (`BEGIN IMMEDIATE`), in PostgreSQL an advisory lock of the study.
SQLite's rollback journal is left as it is: it survives a kill, and unlike a write-ahead log it works on a network
drive. No server is waited for longer than `ANSWER_S`, whatever becomes of it or of the network.

This module imports SQLAlchemy; import it where it is used, so that the command line answers at once.
"""

import hashlib
import socket
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import closing, contextmanager, suppress
from dataclasses import Field, asdict, dataclass, field, fields
from functools import partial
from pathlib import Path
from sqlite3 import Connection as SqliteConnection
from sqlite3 import Error as SqliteError
from sqlite3 import connect
from threading import Timer
from typing import Any

import sqlalchemy as sa
from sqlalchemy.exc import DBAPIError, InterfaceError, OperationalError
from sqlalchemy.pool import NullPool

from feel321.files import as_line, create_file
from feel321.study.server import Server, scrub
from feel321.study.session.journal import Anchor

PATIENCE_S = 60.0
"""How long a transaction waits for others to end, in a file."""

CONNECT_S, ANSWER_S = 3, 10.0
"""How long a server may take to accept a connection, and for all of a transaction."""

_DAMAGED = {"SQLITE_NOTADB", "SQLITE_CORRUPT", "SQLITE_ERROR"}
"""What SQLite says of a file that is no database, a damaged one, or one with other tables."""

LIVE = ("claimed", "running", "finished")
"""States in which a participant holds a slot."""

STATES = (*LIVE, "released", "withdrawn")


@dataclass(frozen=True, slots=True)
class Entry:
    """What the ledger knows about a participant; `number` is that in the design, from 1.

    station: where the session is held, by the computer's name; empty where all share one file.
    """

    participant: str
    simulated: bool
    number: int
    state: str
    done: int = 0
    total: int = 0
    anchors: tuple[Anchor, ...] = ()
    claimed_utc: str = field(default="", compare=False)
    station: str = field(default="", compare=False)


_TABLES = sa.MetaData()
_TYPES: dict[object, type] = {str: sa.String, bool: sa.Boolean, int: sa.Integer}


def _declare(name: str, *columns: Field[object], keys: Sequence[str]) -> sa.Table:
    made: list[sa.Column[object]] = [
        sa.Column(one.name, _TYPES[one.type], primary_key=one.name in keys, nullable=False)
        for one in columns
    ]
    return sa.Table(name, _TABLES, *made)


_NAME, *_REST = (one for one in fields(Entry) if one.name not in {"anchors", "station"})
_STATION = fields(Entry)[-1]
_PARTICIPANTS = _declare("participants", _NAME, *_REST, keys=["participant"])
_ANCHORS = _declare("anchors", _NAME, *fields(Anchor), keys=["participant", "journal"])
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
_OF_FILES = [_PARTICIPANTS, _ANCHORS]

# On a server only, where stations have to agree. A folder's id tells apart two stations of one name.
FOLDERS = sa.Table(
    "folders",
    _TABLES,
    sa.Column("station", sa.String, primary_key=True),
    sa.Column("folder", sa.String, nullable=False),
)
_HOMES = _declare("homes", _NAME, _STATION, keys=["participant"])
STATIONS = sa.Table(
    "stations",
    _TABLES,
    sa.Column("station", sa.String, primary_key=True),
    sa.Column("ahead_s", sa.Float, nullable=False),
    sa.Column("seen_utc", sa.String, nullable=False),
)
TERMS = sa.Table(
    "terms",
    _TABLES,
    sa.Column("name", sa.String, primary_key=True),
    sa.Column("value", sa.Text, nullable=False),
)


def compact(ledger: sa.Engine) -> None:
    """Write the file of a ledger anew, without what was deleted; a server does so when it pleases (VACUUM FULL)."""
    if is_shared(ledger):
        return
    try:
        with closing(connect(str(ledger.url.database), PATIENCE_S, isolation_level=None)) as file:
            file.execute("PRAGMA secure_delete = ON")
            file.execute("PRAGMA synchronous = EXTRA")  # as in `_prepare_file`
            file.execute("VACUUM")
    except SqliteError as error:
        raise OSError(
            f"{name_ledger(ledger)}: could not be compacted ({error}); run again"
        ) from error


def is_shared(ledger: sa.Engine | sa.Connection) -> bool:
    """Check whether a ledger is on a server."""
    return ledger.dialect.name == "postgresql"


def get_station(ledger: sa.Engine | sa.Connection) -> str:
    """Get the name under which a ledger was opened; none has the one who uses a file."""
    station: str = ledger.get_execution_options().get("station", "")
    return station


# How a ledger is opened.


def connect_ledger(place: Path | Server) -> sa.Engine:
    """Make what opens a ledger at each transaction; nothing is opened yet."""
    # No pool: connections cost little here, and none is left open in a thread or a forked process.
    if isinstance(place, Path):
        ledger = sa.create_engine(
            sa.URL.create("sqlite", database=str(place)),
            poolclass=NullPool,
            connect_args={"timeout": PATIENCE_S},
        )
        sa.event.listen(ledger, "do_connect", partial(_begin_file, place))
        sa.event.listen(ledger, "connect", _prepare_file)
    else:
        ledger = _connect_server(place)
        sa.event.listen(ledger, "connect", _limit, insert=True)
        sa.event.listen(ledger, "close", _lift_limit)
    sa.event.listen(ledger, "begin", _begin)
    return ledger


def _begin_file(path: Path, *_: object) -> None:
    """Begin the file of a ledger with the mode that it, its journal and all pieces of it are to have."""
    with suppress(OSError):  # what is wrong with its place SQLite says
        create_file(path, private=True)


def _connect_server(server: Server) -> sa.Engine:
    try:
        return sa.create_engine(
            server.url,
            poolclass=NullPool,
            use_native_hstore=False,
            connect_args={
                "connect_timeout": CONNECT_S,
                "prepare_threshold": None,
                "application_name": f"feel321 {server.station}",
            },
            execution_options={
                "schema_translate_map": {None: server.schema},
                "station": server.station,
            },
        )
    except ModuleNotFoundError:
        raise OSError(
            "a ledger on a server needs psycopg; install it from feel321's source folder: "
            "pip install -c constraints.txt '.[server]'"
        ) from None
    except sa.exc.ArgumentError:
        raise ValueError(
            "the ledger's URL cannot be read; write postgresql+psycopg://host/database"
        ) from None


def make_tables(ledger: sa.Engine) -> None:
    """Make the tables of a ledger where they are missing; one that may only be read is not written to."""
    if not _has_tables(ledger):
        tables, schema = _list_tables(ledger), _find_schema(ledger)
        with transact(ledger) as connection:
            if schema and not sa.inspect(connection).has_schema(schema):
                connection.execute(sa.schema.CreateSchema(schema))
            _TABLES.create_all(connection, tables=tables)


def _list_tables(ledger: sa.Engine) -> list[sa.Table]:
    return list(_TABLES.tables.values()) if is_shared(ledger) else _OF_FILES


def _has_tables(ledger: sa.Engine) -> bool:
    with transact(ledger, writes=False) as connection:
        known = sa.inspect(connection).get_table_names(schema=_find_schema(ledger))
    return {table.name for table in _list_tables(ledger)} <= set(known)


def read_place(place: Path | Server) -> tuple[sa.Engine, list[Entry]]:
    """Read the ledger at a place, and write nothing on a server; where there are no tables yet, nobody takes part."""
    if isinstance(place, Path):
        ledger = open_ledger(place)
        return ledger, read_ledger(ledger)
    ledger = connect_ledger(place)
    return ledger, read_ledger(ledger) if _has_tables(ledger) else []


def open_ledger(place: Path | Server) -> sa.Engine:
    """Open a ledger, or begin an empty one."""
    ledger = connect_ledger(place)
    make_tables(ledger)
    return ledger


def _find_schema(ledger: sa.Engine | sa.Connection) -> str | None:
    schema: str | None = ledger.get_execution_options().get("schema_translate_map", {}).get(None)
    return schema


# Transactions.


@contextmanager
def transact(ledger: sa.Engine, *, writes: bool = True) -> Iterator[sa.Connection]:
    """Do all of what is inside, or nothing; no other transaction comes in between."""
    own = {} if writes or not is_shared(ledger) else {"isolation_level": "REPEATABLE READ"}
    try:
        with ledger.execution_options(writes=writes, **own).begin() as connection:
            yield connection
    except DBAPIError as error:
        raise (_describe_server if is_shared(ledger) else _describe_file)(ledger, error) from error


def name_ledger(ledger: sa.Engine) -> str:
    """Name a ledger: its file, or its URL."""
    if is_shared(ledger):
        return ledger.url.render_as_string(hide_password=True)
    return str(ledger.url.database)


def _describe_file(ledger: sa.Engine, error: DBAPIError) -> Exception:
    path, reason = name_ledger(ledger), error.orig
    words = as_line(" ".join(str(reason).split()))
    if getattr(reason, "sqlite_errorname", "") in _DAMAGED:
        return ValueError(
            f"{path}: got a damaged file ({words}); move it away, then rebuild it from the journals: "
            "feel321 ledger --rebuild"
        )
    return OSError(
        f"{path}: could not be used ({words}); check that the folder may be written to, the disk has room "
        "and no other program holds the file, then run again"
    )


def _describe_server(ledger: sa.Engine, error: DBAPIError) -> Exception:
    name, reason = name_ledger(ledger), scrub(str(error.orig))
    if isinstance(error, OperationalError | InterfaceError):
        return ConnectionError(
            f"{name}: the ledger is out of reach ({reason}); check network, server and login, then run again"
        )
    return OSError(
        f"{name}: could not be used ({reason}); check that the database is the study's, and that you may make "
        "schemas and tables in it"
    )


def _prepare_file(connection: SqliteConnection, _record: object) -> None:
    # Python's sqlite3 would begin transactions by itself, and late.
    connection.isolation_level = None
    connection.execute("PRAGMA secure_delete = ON")  # what is deleted is overwritten
    # A commit is the end of SQLite's journal: its going must be on the disk too, or a power cut takes it back.
    connection.execute("PRAGMA synchronous = EXTRA")


def _begin(connection: sa.Connection) -> None:
    writes = connection.get_execution_options()["writes"]
    if not is_shared(connection):
        connection.exec_driver_sql("BEGIN IMMEDIATE" if writes else "BEGIN")
    elif writes:
        limits = ("lock_timeout", "statement_timeout")
        set_config, for_this_transaction = sa.func.set_config, sa.true()
        connection.execute(
            sa.select(
                *(set_config(name, f"{ANSWER_S:g}s", for_this_transaction) for name in limits)
            )
        )
        schema = _find_schema(connection) or ""
        key = int.from_bytes(hashlib.sha256(schema.encode()).digest()[:8], "big", signed=True)
        connection.execute(sa.select(sa.func.pg_advisory_xact_lock(key)))


def _limit(connection: Any, record: Any) -> None:  # noqa: ANN401 - psycopg's, which few have
    """Hang up on a server that takes too long: its own limits do not count when it, or the network, has stopped."""
    line = socket.fromfd(connection.fileno(), socket.AF_INET, socket.SOCK_STREAM)

    def hang_up() -> None:
        with suppress(OSError):
            line.shutdown(socket.SHUT_RDWR)

    timer = Timer(ANSWER_S, hang_up)
    timer.daemon = True
    timer.start()
    record.info["limit"] = timer, line


def _lift_limit(_connection: object, record: Any) -> None:  # noqa: ANN401 - SQLAlchemy's
    timer, line = record.info.pop("limit")
    timer.cancel()
    line.close()


# Entries.


def read_entries(connection: sa.Connection, participant: str | None = None) -> list[Entry]:
    """Read entries inside a transaction, by their numbers."""
    people, seen = sa.select(_PARTICIPANTS), sa.select(_ANCHORS).order_by(_ANCHORS.c.journal)
    if participant is not None:
        people = people.where(_PARTICIPANTS.c.participant == participant)
        seen = seen.where(_ANCHORS.c.participant == participant)
    anchors: dict[str, tuple[Anchor, ...]] = {}
    for name, *anchor in connection.execute(seen):
        anchors[name] = (*anchors.get(name, ()), Anchor(*anchor))
    homes: dict[str, str] = (
        dict(connection.execute(sa.select(_HOMES)).all()) if is_shared(connection) else {}
    )
    entries = [
        Entry(
            **row,
            anchors=anchors.get(row["participant"], ()),
            station=homes.get(row["participant"], ""),
        )
        for row in connection.execute(people).mappings()
    ]
    for entry in entries:
        _check_cells([entry, *entry.anchors], connection)
    return sorted(
        entries,
        key=lambda entry: (entry.simulated, entry.number, entry.state in LIVE, entry.participant),
    )


def _check_cells(rows: Iterable[Entry | Anchor], connection: sa.Connection) -> None:
    """Refuse what no column of ours holds: SQLite keeps whatever it is given, of any type."""
    cells = ((one, getattr(row, one.name)) for row in rows for one in fields(row))
    for cell, value in cells:
        if cell.type not in _TYPES:
            continue
        known = STATES if cell.name == "state" else None
        is_ours = type(value) is cell.type and (known is None or value in known)
        if not is_ours or (isinstance(value, int) and value < 0):
            raise ValueError(
                f"{name_ledger(connection.engine)}: got a damaged cell ({cell.name} is {as_line(repr(value))}); move "
                "it away, then rebuild it from the journals: feel321 ledger --rebuild"
            )


def write_entries(
    connection: sa.Connection, entries: Sequence[Entry], *, instead_of: Iterable[str] = ()
) -> None:
    """Write entries inside a transaction, in place of others."""
    names = list(instead_of)
    rows = [asdict(entry) for entry in entries]
    homes = [{"participant": row["participant"], "station": row.pop("station")} for row in rows]
    anchors = [
        {"participant": row["participant"], **anchor}
        for row in rows
        for anchor in row.pop("anchors")
    ]
    tables = [(_PARTICIPANTS, rows), (_ANCHORS, anchors)]
    for table, values in [*tables, (_HOMES, homes)] if is_shared(connection) else tables:
        connection.execute(sa.delete(table).where(table.c.participant.in_(names)))
        if values:  # Without any, one row of defaults would be written.
            connection.execute(sa.insert(table), values)


def read_ledger(ledger: sa.Engine, participant: str | None = None) -> list[Entry]:
    """Read all that the ledger knows, or what it knows of one participant."""
    with transact(ledger, writes=False) as connection:
        return read_entries(connection, participant)


def rewrite_ledger(ledger: sa.Engine, change: Callable[[list[Entry]], list[Entry]]) -> list[Entry]:
    """Replace all entries by others, in one transaction; returns those before."""
    with transact(ledger) as connection:
        before = read_entries(connection)
        write_entries(
            connection, change(before), instead_of=[entry.participant for entry in before]
        )
    return before
