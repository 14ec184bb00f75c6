"""The journal of a session: an append-only chain of records, one fsync per record, nothing ever overwritten.

`create_journal` refuses a file that is there, `require_journal` refuses one that is not. A record is on the
disk when `write` returns. The line that a crash or power cut tore is moved into a file beside the journal and
reported.

A line is one JSON object: `sequence` (from 0), `previous` (SHA-256 of the line before, without its line end;
64 zeros in the first line), `utc`, `event`, `data`, and last `sha256`, the digest of the line without that
field. `previous` betrays lines that were taken out, put in or moved; `sha256` betrays a change in any line,
the last one too.
"""

from __future__ import annotations

import hashlib
import json
import os
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import datetime
from typing import TYPE_CHECKING, Any

from feel321.files import sync_folder

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping
    from pathlib import Path

    Clock = Callable[[], datetime]

# The text of a journal: JSON lines in a chain of SHA-256 digests.

START = "0" * 64
"""What the first line has instead of the digest of the line before."""

_FIELDS = {"sequence": int, "previous": str, "utc": str, "event": str, "data": dict}


@dataclass(frozen=True, slots=True)
class Record:
    """One event of a session.

    sequence: place in the journal, from 0.
    """

    sequence: int
    utc: str
    event: str
    data: Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class Chain:
    """What a journal file holds."""

    records: tuple[Record, ...]
    tip: str
    torn: bytes


def write_line(record: Record, previous: str) -> bytes:
    """Write a record as the line that follows another."""
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
    """Read all whole lines of a journal and check that they form one chain."""
    *lines, torn = content.split(b"\n")
    records: list[Record] = []
    previous = START
    for number, line in enumerate(lines, start=1):
        try:
            records.append(_read_line(line, previous, sequence=number - 1))
        except ValueError as error:
            raise ValueError(
                f"{name}, line {number}: {error}; restore the file from a copy"
            ) from None
        previous = digest(line)
    return Chain(tuple(records), previous, torn)


def digest(text: str | bytes) -> str:
    """SHA-256 of a text, in hexadecimal digits.

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


# The journal of a session: append-only, one fsync per record, nothing ever overwritten.

_APPEND = os.O_WRONLY | os.O_APPEND | getattr(os, "O_BINARY", 0)


@dataclass(slots=True)
class Journal:
    """A journal open for writing; hold the session's lock while it is.

    Parameters
    ----------
    path : Path
        The file.
    now : callable
        Gives the time of day, with its zone.
    records : list of Record
        All events so far, in order.
    notice : str
        What had to be mended when it was opened, for whoever leads the session; mostly empty.
    """

    path: Path
    now: Clock
    records: list[Record] = field(default_factory=list)
    notice: str = ""
    _tip: str = START
    _is_open: bool = True

    @property
    def tip(self) -> str:
        """SHA-256 of the last line, 64 zeros if there is none."""
        return self._tip

    @property
    def is_open(self) -> bool:
        """Whether it takes records: after a write that was broken off it does not."""
        return self._is_open

    def write(self, event: str, data: Mapping[str, Any]) -> None:
        """Append one record; it is on the disk when this returns.

        If the time of day was set back since the last record, a record `clock_stepped` before it says by how much.

        Parameters
        ----------
        event : str
            What happened.
        data : mapping
            What is known about it; everything JSON can hold.

        Raises
        ------
        OSError
            If the disk takes no more. Whatever breaks off a write closes the journal, for the file may hold
            all of the line, some or none: only reading it again tells where the chain goes on.
        """
        utc = self.now().isoformat(timespec="milliseconds")
        if (back_s := self._measure_step_back(utc)) > 0:
            self._append(utc, "clock_stepped", {"back_s": back_s})
        self._append(utc, event, data)

    def _append(self, utc: str, event: str, data: Mapping[str, Any]) -> None:
        if not self._is_open:
            raise OSError(
                f"{self.path}: an earlier write was broken off, the journal is closed; reopen it to resume"
            )
        record = Record(len(self.records), utc, event, data)
        line = write_line(record, self._tip)
        self._is_open = False
        _append(self.path, line)
        self.records.append(record)
        self._tip = digest(line.rstrip(b"\n"))
        self._is_open = True

    def _measure_step_back(self, utc: str) -> float:
        """Tell by how many seconds the time of day lies before that of the last record."""
        if not self.records:
            return 0.0
        last, this = (datetime.fromisoformat(text) for text in (self.records[-1].utc, utc))
        return (last - this).total_seconds()


def create_journal(path: Path, *, now: Clock) -> Journal:
    """Begin a journal where no file is yet.

    Parameters
    ----------
    path : Path
        The file to begin; its folder must exist.
    now : callable
        Gives the time of day, with its zone.

    Returns
    -------
    Journal
        Without records.

    Raises
    ------
    FileExistsError
        If there is a file already; it is left alone.
    """
    try:
        os.close(os.open(path, os.O_CREAT | os.O_EXCL | _APPEND, 0o644))
    except FileExistsError:
        raise FileExistsError(
            f"{path}: is there already, nothing is overwritten; resume it"
        ) from None
    sync_folder(path.parent)
    return Journal(path, now)


def require_journal(path: Path, *, now: Clock) -> Journal:
    """Go on with a journal that is there.

    Parameters
    ----------
    path : Path
        The file.
    now : callable
        Gives the time of day, with its zone.

    Returns
    -------
    Journal
        With all its records. If the last line was torn, a record `recovered` and the notice say so.

    Raises
    ------
    FileNotFoundError
        If there is none.
    ValueError
        If the chain is broken, naming the line.
    """
    chain = read_journal(path)
    journal = Journal(path, now, list(chain.records), _tip=chain.tip)
    if chain.torn:
        with _naming(path):
            torn = _cut_torn_line(path, chain.torn)
        journal.write("recovered", {"torn_bytes": len(chain.torn), "moved_to": torn.name})
        journal.notice = f"{path}: {len(chain.torn)} bytes of a line that was never finished were moved to {torn.name}"
    return journal


def read_journal(path: Path) -> Chain:
    """Read a journal without writing to it, also while its session runs.

    Parameters
    ----------
    path : Path
        The file.

    Returns
    -------
    Chain
        The records, and what is left of a torn last line.

    Raises
    ------
    FileNotFoundError
        If there is none.
    ValueError
        If the chain is broken, naming the line.
    """
    if not path.is_file():
        raise FileNotFoundError(f"{path}: there is no such journal; begin the session first")
    return read_chain(path.read_bytes(), str(path))


def _append(path: Path, line: bytes) -> None:
    with _naming(path):
        written = _write_through(path, line)
    if written != len(line):
        raise OSError(
            f"{path}: the disk took {written} of {len(line)} bytes; make room, then resume"
        )


@contextmanager
def _naming(path: Path) -> Iterator[None]:
    """Say which file it was: a full or broken disk does not."""
    try:
        yield
    except OSError as error:
        raise OSError(
            f"{path}: the disk took no record ({error.strerror or error}); make room or mend the disk, then resume"
        ) from error


def _write_through(path: Path, line: bytes) -> int:
    descriptor = os.open(path, _APPEND)
    try:
        before = os.fstat(descriptor).st_size
        written = os.write(descriptor, line)
        if written != len(line):
            # A full disk takes the beginning of a line and says so by a short count only.
            os.ftruncate(descriptor, before)
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
    return written


def _cut_torn_line(path: Path, torn: bytes) -> Path:
    number = 1
    while (target := path.with_name(f"{path.name}.torn{number}")).exists():
        number += 1
    # The piece is safe beside the journal before the journal loses it.
    target.write_bytes(torn)
    _sync(target, size=len(torn))
    _sync(path, size=path.stat().st_size - len(torn))
    sync_folder(path.parent)
    return target


def _sync(path: Path, *, size: int) -> None:
    with path.open("r+b") as file:
        file.truncate(size)
        os.fsync(file.fileno())
