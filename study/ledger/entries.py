"""The ledger's tables, and the record that stands for a row of them."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING

from sqlalchemy import Boolean, Column, Index, Integer, MetaData, String, Table, delete, insert, inspect, select

from study.ledger.database import begin_reading, begin_writing
from study.ledger.sightings import Anchor

if TYPE_CHECKING:
    from collections.abc import Sequence

    from sqlalchemy import Connection, Engine

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

    Parameters
    ----------
    participant : str
        The participant's code.
    simulated : bool
        Whether the participant is simulated.
    number : int
        The participant's number in the design, from 1.
    state : str
        One of `STATES`.
    done, total : int
        Trials of the main phase that are done, and all of them.
    anchors : tuple of Anchor
        What was last seen of each journal, by name.
    claimed_utc : str
        When the slot was claimed, ISO 8601; in a rebuilt ledger, the time of the first record.
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
    """Create the tables unless they are there; a ledger that may only be read is not written to.

    Parameters
    ----------
    ledger : Engine
        The ledger.
    """
    with begin_reading(ledger) as connection:
        missing = not all(inspect(connection).has_table(name) for name in _TABLES.tables)
    if missing:
        with begin_writing(ledger) as connection:
            _TABLES.create_all(connection)


def read_entries(connection: Connection, participant: str | None = None) -> list[Entry]:
    """Read entries within a transaction.

    Parameters
    ----------
    connection : Connection
        The transaction.
    participant : str, optional
        Whose entry; everybody's if left out.

    Returns
    -------
    list of Entry
        Real people before simulated ones, by number, of one number the holder of the slot last.
    """
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
    return sorted(entries, key=lambda entry: (entry.simulated, entry.number, entry.state in LIVE, entry.participant))


def write_entries(connection: Connection, entries: Sequence[Entry], *, instead_of: Sequence[str] = ()) -> None:
    """Write entries within a transaction.

    Parameters
    ----------
    connection : Connection
        The transaction.
    entries : sequence of Entry
        What is to stand there.
    instead_of : sequence of str
        Participants whose entries go.
    """
    for table in (_PARTICIPANTS, _ANCHORS):
        connection.execute(delete(table).where(table.c.participant.in_(instead_of)))
    rows = [asdict(entry) for entry in entries]
    anchors = [{"participant": row["participant"], **anchor} for row in rows for anchor in row.pop("anchors")]
    for table, values in ((_PARTICIPANTS, rows), (_ANCHORS, anchors)):
        if values:  # Without any, one row of defaults would be written.
            connection.execute(insert(table), values)
