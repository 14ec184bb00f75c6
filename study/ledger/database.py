"""A SQLite file behind SQLAlchemy: all that is SQLite's own, so that a server can take its place.

Transactions that write take the file's lock at their beginning (`BEGIN IMMEDIATE`), so that what they read cannot
change before they write; others wait. The rollback journal is left as it is: it survives a kill, and unlike a
write-ahead log it works on a network drive.
"""

from __future__ import annotations

from contextlib import contextmanager
from typing import TYPE_CHECKING

from sqlalchemy import URL, create_engine, event
from sqlalchemy.exc import DBAPIError
from sqlalchemy.pool import NullPool

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path
    from sqlite3 import Connection as SqliteConnection

    from sqlalchemy import Connection, Engine

PATIENCE_S = 60.0
"""How long a transaction waits for others to end."""

_DAMAGED = {"SQLITE_NOTADB", "SQLITE_CORRUPT", "SQLITE_ERROR"}
"""What SQLite says of a file that is no database, a damaged one, or one with other tables."""


def open_database(path: Path) -> Engine:
    """Open a SQLite file; it is created with the first connection.

    Parameters
    ----------
    path : Path
        The file; its folder must exist.

    Returns
    -------
    Engine
        To be used through `begin_reading` and `begin_writing`, from any thread.
    """
    # No pool: connections cost little here, and none is left open in a thread or a forked process.
    engine = create_engine(
        URL.create("sqlite", database=str(path)), poolclass=NullPool, connect_args={"timeout": PATIENCE_S}
    )
    event.listen(engine, "connect", _leave_transactions_alone)
    event.listen(engine, "begin", _begin)
    return engine


@contextmanager
def begin_reading(engine: Engine) -> Iterator[Connection]:
    """Read in one transaction, which sees one state and writes nothing.

    Parameters
    ----------
    engine : Engine
        The database.

    Yields
    ------
    Connection
        Open until the end of the block.

    Raises
    ------
    ValueError
        If the file is damaged.
    OSError
        If it cannot be read.
    """
    with _speak_plainly(engine), engine.execution_options(only_reads=True).begin() as connection:
        yield connection


@contextmanager
def begin_writing(engine: Engine) -> Iterator[Connection]:
    """Read and write in one transaction: all of it happens, or nothing, and no other one in between.

    Parameters
    ----------
    engine : Engine
        The database.

    Yields
    ------
    Connection
        Open until the end of the block; an error undoes everything.

    Raises
    ------
    ValueError
        If the file is damaged.
    OSError
        If it cannot be written, or others keep it busy for a minute.
    """
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
