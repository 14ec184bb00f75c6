"""The text of a journal: JSON lines in a chain of SHA-256 digests.

A line is one JSON object: `sequence` (from 0), `previous` (SHA-256 of the line before, without its line end;
64 zeros in the first line), `utc`, `event`, `data`, and last `sha256`, the digest of the line without that
field. `previous` betrays lines that were taken out, put in or moved; `sha256` betrays a change in any line,
the last one too.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from datetime import datetime
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Mapping

START = "0" * 64
"""What the first line has instead of the digest of the line before."""

_FIELDS = {"sequence": int, "previous": str, "utc": str, "event": str, "data": dict}


@dataclass(frozen=True, slots=True)
class Record:
    """One event of a session.

    Parameters
    ----------
    sequence : int
        Place in the journal, from 0.
    utc : str
        When it was written, ISO 8601.
    event : str
        What happened.
    data : mapping
        What is known about it.
    """

    sequence: int
    utc: str
    event: str
    data: Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class Chain:
    """What a journal file holds.

    Parameters
    ----------
    records : tuple of Record
        The events of all whole lines.
    tip : str
        SHA-256 of the last whole line, 64 zeros if there is none.
    torn : bytes
        What stands after the last line end: the beginning of a line that was never finished, mostly nothing.
    """

    records: tuple[Record, ...]
    tip: str
    torn: bytes


def write_line(record: Record, previous: str) -> bytes:
    """Write a record as the line that follows another.

    Parameters
    ----------
    record : Record
        The event.
    previous : str
        SHA-256 of the line before.

    Returns
    -------
    bytes
        The line, with its line end.

    Raises
    ------
    ValueError
        If a value is no finite number.
    TypeError
        If a value cannot be written as JSON.
    """
    entry = {
        "sequence": record.sequence,
        "previous": previous,
        "utc": record.utc,
        "event": record.event,
        "data": record.data,
    }
    body = json.dumps(entry, ensure_ascii=False, allow_nan=False)
    return f'{body[:-1]}, "sha256": "{digest(body)}"}}\n'.encode()


def read_chain(content: bytes, name: str) -> Chain:
    """Read all whole lines of a journal and check that they form one chain.

    Parameters
    ----------
    content : bytes
        The file's content.
    name : str
        The file's name, for messages.

    Returns
    -------
    Chain
        The records, and what is left of a torn last line.

    Raises
    ------
    ValueError
        If a whole line is not what was once written, naming the line.
    """
    *lines, torn = content.split(b"\n")
    records: list[Record] = []
    previous = START
    for number, line in enumerate(lines, start=1):
        try:
            records.append(_read_line(line, previous, sequence=number - 1))
        except ValueError as error:
            raise ValueError(f"{name}, line {number}: {error}; restore the file from a copy") from None
        previous = digest(line)
    return Chain(tuple(records), previous, torn)


def digest(text: str | bytes) -> str:
    """SHA-256 of a text, in hexadecimal digits.

    Parameters
    ----------
    text : str or bytes
        A str is digested as UTF-8.

    Returns
    -------
    str
        64 digits.

    Examples
    --------
    >>> digest("tap")[:12]
    '729cd87c6329'
    """
    return hashlib.sha256(text.encode() if isinstance(text, str) else text).hexdigest()


def _read_line(line: bytes, previous: str, *, sequence: int) -> Record:
    body, mark, rest = line.rpartition(b', "sha256": "')
    if not mark or rest != f'{digest(body + b"}")}"}}'.encode():
        raise ValueError("was changed after it was written (its SHA-256 does not match)")
    entry = _read_entry(body + b"}")
    if entry["previous"] != previous:
        raise ValueError("does not follow the line before (a line was taken out, put in or moved)")
    if entry["sequence"] != sequence:
        raise ValueError(f"got sequence number {entry['sequence']}, expected {sequence}")
    return Record(entry["sequence"], entry["utc"], entry["event"], entry["data"])


def _read_entry(body: bytes) -> dict[str, Any]:
    """Read a line's fields; a digest that is right does not tell that feel321 wrote them."""
    try:
        entry = json.loads(body)
        is_record = {name: type(value) for name, value in entry.items()} == _FIELDS
        is_record = is_record and datetime.fromisoformat(entry["utc"]).tzinfo is not None
    except (AttributeError, ValueError, RecursionError):
        is_record = False
    if not is_record:
        raise ValueError("is no record as feel321 writes them")
    return dict(entry)
