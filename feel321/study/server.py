"""The server on which several stations share a study's ledger: its address, who may log in, which study it is.

A station is a computer with a study folder of its own. Passwords are for the PostgreSQL client to find (`PGPASSWORD`,
`PGPASSFILE`, `PGSERVICE`, `~/.pgpass`): no URL holds one, and what is printed or raised repeats none.
"""

from __future__ import annotations

import hashlib
import os
import re
import tomllib
from dataclasses import dataclass
from math import prod
from pathlib import Path
from platform import node
from shlex import quote
from typing import Any
from urllib.parse import unquote

URL_VARIABLE, STATION_VARIABLE = "FEEL321_LEDGER", "FEEL321_STATION"
"""A station's own URL, which wins over `study.toml`; and its name, by default that of the computer."""

UNNAMED = "pilot"
"""Name of a study that has none of its own, as in the template."""

EXAMPLE = "postgresql+psycopg://host/database"
_KINDS = ("postgresql+psycopg://", "postgresql://")
_OTHERS = 0o077


@dataclass(frozen=True, slots=True)
class Server:
    """Where a study's ledger is on a server: in a schema of its own; station: the name of this computer."""

    url: str
    schema: str
    station: str


def check_url(url: str) -> str:
    """Demand the URL of a PostgreSQL database without a password; what is refused is not repeated."""
    if holds_password(url):
        raise ValueError(
            "must hold no password, got one; take it out (and change it, if others saw the file): PostgreSQL's "
            "client reads PGPASSWORD, or ~/.pgpass with mode 0600"
        )
    if not url.startswith(_KINDS) or re.search(r"\s", url):
        raise ValueError(f"must look like {EXAMPLE}, got something else; omit it to use SQLite")
    return url


def holds_password(url: str) -> bool:
    """Check whether a URL holds a password."""
    while (plain := unquote(url)) != url:
        url = plain
    # Up to the last @: a password may hold any sign, also those that end the host of other URLs.
    login, at, _ = url.partition("//")[2].rpartition("@")
    return bool(at and ":" in login) or "password" in url.casefold()


def check_table(table: object) -> None:
    """Demand a table `[ledger]` that says where the ledger is, or how slots are divided, or nothing."""
    kinds = {"url": str, "station": int, "of": int}
    if not isinstance(table, dict) or any(
        type(value) is not kinds.get(name) for name, value in table.items()
    ):
        raise ValueError(
            f'must be a table with url, or with station and of, got something else; such as url = "{EXAMPLE}"'
        )
    if "url" in table:
        check_url(table["url"])
    station, of = table.get("station", 1), table.get("of", 1)
    if ("station" in table) != ("of" in table):
        raise ValueError("must have both station and of, got only one; add the other")
    if not 1 <= station <= of:
        raise ValueError(f"must have station from 1 to {of}, got {station}")


def find_share(settings: Path) -> tuple[int, int, int]:
    """Find which blocks of numbers a station gives away, and of how many: place, step and size, by default all."""
    tables = _read_tables(settings)
    table = _find_table(tables)
    factors = tables.get("between", {}).values()
    return table.get("station", 1), table.get("of", 1), prod(map(len, factors))


def find_server(settings: Path) -> Server | None:
    """Find the server of a study's ledger, by its `study.toml` and the environment; None where it is a file."""
    tables = _read_tables(settings)
    url = os.environ.get(URL_VARIABLE) or _find_table(tables).get("url")
    if not url:
        return None
    try:
        check_url(url)
    except ValueError as error:
        raise ValueError(f"{URL_VARIABLE} {error}") from None
    check_credentials()
    kind, _, rest = url.partition("://")
    name = str(tables.get("study", {}).get("name", "")).strip()
    if name in {"", UNNAMED}:
        raise ValueError(
            f'{settings}: study.name must be the study\'s own on a server that other studies may use, got "{name}"; '
            'such as name = "wood 2027, lab A"'
        )
    return Server(f"{kind.partition('+')[0]}+psycopg://{rest}", name_schema(name), find_station())


def _find_table(tables: dict[str, Any]) -> dict[str, Any]:
    table = tables.get("ledger", {})
    try:
        check_table(table)
    except ValueError as error:
        raise ValueError(f"study.toml: ledger {error}") from None
    return dict(table)


def find_station() -> str:
    """Find the name of this station."""
    return os.environ.get(STATION_VARIABLE) or node() or "unnamed"


def is_station_named() -> bool:
    """Check whether the name of this station was given on purpose."""
    return bool(os.environ.get(STATION_VARIABLE))


def take_over(station: str) -> str:
    """Say how another station acts in the place of one; nobody does so by accident."""
    return f"{STATION_VARIABLE}={quote(station)} feel321 ..."


def name_schema(study: str) -> str:
    """Name the schema of a study: all stations must come to the same one, and other studies to others.

    Examples
    --------
    >>> name_schema("Wood, 2nd pilot")
    'feel321_wood_2nd_pilot_a033734f'
    """
    readable = re.sub(r"[^a-z0-9]+", "_", study.casefold()).strip("_")[:40]
    return f"feel321_{readable}_{hashlib.sha256(study.encode()).hexdigest()[:8]}"


def check_credentials() -> None:
    """Refuse files of passwords that others may read; PostgreSQL's client checks only one of both."""
    if os.name == "nt":  # pragma: no cover - permissions are of another kind there
        return
    home = Path("~").expanduser()
    passwords = Path(os.environ.get("PGPASSFILE") or home / ".pgpass")
    services = Path(os.environ.get("PGSERVICEFILE") or home / ".pg_service.conf")
    for path in (passwords, services):
        if path.is_file() and (mode := path.stat().st_mode & 0o777) & _OTHERS:
            if path == services and b"password" not in path.read_bytes().lower():
                continue
            raise ValueError(
                f"{path}: must be readable by you alone, got mode {mode:04o}, and it may hold a password; "
                f"chmod 600 {path}"
            )


def scrub(text: str) -> str:
    """Put a foreign error on one line, without the password that the environment holds."""
    line = " ".join(text.split())
    password = os.environ.get("PGPASSWORD")
    return line.replace(password, "***") if password else line


def _read_tables(settings: Path) -> dict[str, Any]:
    """Read `study.toml` as far as the ledger needs it; whoever plans sessions reads it with every check."""
    try:
        return tomllib.loads(settings.read_text(encoding="utf-8-sig"))
    except FileNotFoundError:
        return {}
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{settings}: not valid TOML ({error}); fix that place") from None
