"""What stations that share a ledger agree on: how sessions are planned, and the time of day."""

from __future__ import annotations

import json
import secrets
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any

import sqlalchemy as sa

from feel321.files import write_text
from feel321.study.ledger import database
from feel321.study.session.identity import find_differences

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from pathlib import Path

    from feel321.study.session.journal import Clock

SKEW_S = 60.0
"""How far a station's clock may be off before it is worth a word."""


@dataclass(frozen=True, slots=True)
class StationClock:
    """By how much the clock of a station was ahead of the server's, when the station last claimed a slot."""

    station: str
    ahead_s: float
    seen_utc: str


def introduce(ledger: sa.Engine, path: Path) -> bool:
    """Check that a station's name is that of one study folder, by its id in a file; the first that comes has it."""
    if not path.exists():
        with database.transact(ledger):  # one process at a time
            if not path.exists():
                write_text(path, f"{secrets.token_hex(16)}\n")
    folder, table = path.read_text(encoding="utf-8").strip(), database.FOLDERS
    name = database.get_station(ledger)
    asked = sa.select(table.c.folder).where(table.c.station == name)
    with database.transact(ledger, writes=False) as connection:
        known = connection.execute(asked).scalar()
    if known is None:
        with database.transact(ledger) as connection:
            known = connection.execute(asked).scalar()
            if known is None:
                connection.execute(sa.insert(table), [{"station": name, "folder": folder}])
    return known in {None, folder}


def tell_time(connection: sa.Connection, *, now: Clock) -> str:
    """Tell the time of a claim: the server's, where there is one; it keeps how far the station's is from it."""
    own = now().astimezone(UTC)
    if not database.is_shared(connection):
        return own.isoformat(timespec="seconds")
    there: datetime = connection.execute(sa.select(sa.func.clock_timestamp())).scalar_one()
    utc, name = (
        there.astimezone(UTC).isoformat(timespec="seconds"),
        database.get_station(connection),
    )
    table = database.STATIONS
    connection.execute(sa.delete(table).where(table.c.station == name))
    seen = {"station": name, "ahead_s": (own - there).total_seconds(), "seen_utc": utc}
    connection.execute(sa.insert(table), [seen])
    return utc


def read_clocks(ledger: sa.Engine) -> list[StationClock]:
    """Read how far the clocks of all stations were off; none share a file."""
    if not database.is_shared(ledger):
        return []
    with database.transact(ledger, writes=False) as connection:
        rows = connection.execute(sa.select(database.STATIONS).order_by("station"))
        return [StationClock(*row) for row in rows]


def describe_clocks(clocks: list[StationClock]) -> Iterator[str]:
    """Describe clocks that are off by more than a minute; journals need no right one, times of day do."""
    for clock in clocks:
        if abs(clock.ahead_s) > SKEW_S:
            way = "ahead of" if clock.ahead_s > 0 else "behind"
            yield (
                f"station {clock.station}: its clock was {abs(clock.ahead_s):.0f} s {way} the server's at "
                f"{clock.seen_utc}; set it, times of day in its journals are off by that"
            )


def agree_on(ledger: sa.Engine, terms: Mapping[str, Any], *, remedy: str) -> None:
    """Check that this station plans sessions as the others do; the first to claim a slot settles it for all."""
    if not database.is_shared(ledger):
        return
    table = database.TERMS
    own = json.loads(json.dumps(terms))
    with database.transact(ledger) as connection:
        known = {name: json.loads(value) for name, value in connection.execute(sa.select(table))}
        if known and database.read_entries(connection):
            if differences := find_differences(known, own):
                raise ValueError(
                    f"{database.name_ledger(ledger)}: the other stations run this study otherwise "
                    f"({'; '.join(differences)}); {remedy}"
                )
            return
        connection.execute(sa.delete(table))
        rows = [{"name": name, "value": json.dumps(value)} for name, value in own.items()]
        connection.execute(sa.insert(table), rows)


def forget_terms(ledger: sa.Engine) -> None:
    """Let the next claim settle anew how sessions are planned."""
    if database.is_shared(ledger):
        with database.transact(ledger) as connection:
            connection.execute(sa.delete(database.TERMS))
