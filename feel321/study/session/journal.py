"""The journal of a session: an append-only chain of records, one fsync per record, nothing ever overwritten.

A record is on the disk when `write` returns. A line that a crash or power cut left unfinished is moved into a file
beside the journal and reported.

A line is one JSON object: `sequence` (from 0), `previous` (SHA-256 of the line before, without its line end;
64 zeros in the first line), `utc`, `event`, `data`, and last `sha256`, the digest of the line without that
field. `previous` shows lines that were taken out, put in or moved; `sha256` a change in any line, the last one too.
"""

import hashlib
import json
import os
import re
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import cached_property, lru_cache
from itertools import count
from pathlib import Path
from typing import Any

from pydantic_core import from_json

from feel321.files import create_file, sync_folder, write_bytes
from feel321.study.session import events
from feel321.study.session.events import SessionEvent

Clock = Callable[[], datetime]

START = "0" * 64  # in the first line, for the digest of the line before

PARTICIPANT_ID = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]*")  # allowed codes: they name folders
SESSION_FILE = re.compile(r"session-(\d{2,})\.jsonl")  # copies under other names are no journals
_APPEND = os.O_WRONLY | os.O_APPEND | getattr(os, "O_BINARY", 0)
_FIELDS = {"sequence": int, "previous": str, "utc": str, "event": str, "data": dict}


@dataclass(frozen=True)
class Record:
    """One line of a journal; sequence: its place, from 0."""

    sequence: int
    utc: str
    event: str
    data: Mapping[str, Any]

    @cached_property
    def content(self) -> SessionEvent:
        """The event, checked once."""
        try:
            return events.read_event(self.event, self.data)
        except ValueError as error:
            raise ValueError(f"line {self.sequence + 1}: {error}") from None


class Records(list[Record]):
    """The records of a journal, in order."""

    def find(self, *kinds: type[events.E]) -> Iterator[events.E]:
        """Find all events of some kinds."""
        names = {kind.event for kind in kinds}
        for record in self:
            if record.event in names and isinstance(event := record.content, kinds):
                yield event

    def has(self, kind: type[SessionEvent]) -> bool:
        """Check whether something ever happened in the session."""
        return any(record.event == kind.event for record in self)

    def find_header(self) -> events.SessionBegun | None:
        """Find the header of the session."""
        return next(self.find(events.SessionBegun), None)

    def find_elapsed(self) -> float:
        """Find the last time on the presenter's clock, in s."""
        # Onsets do not count: an attempt that was broken off never was, and comes again in its own time.
        return max((r.data["time_s"] for r in self if "time_s" in r.data), default=0.0)


@dataclass(frozen=True, slots=True)
class Chain:
    """The content of a journal file: its records, the digest of the last line, and an unfinished line."""

    records: Records
    tip: str
    torn: bytes


def write_line(record: Record, previous: str) -> bytes:
    """Write a record as the line that follows another."""
    own = {"utc": record.utc, "event": record.event, "data": record.data}
    entry = {"sequence": record.sequence, "previous": previous, **own}
    body = json.dumps(entry, ensure_ascii=False, allow_nan=False)
    return f'{body[:-1]}, "sha256": "{digest(body)}"}}\n'.encode()


@lru_cache(maxsize=4)  # whoever derives several tables reads each journal once
def read_chain(content: bytes, name: str) -> Chain:
    """Read all whole lines of a journal and check that they form one chain; a checkout may have changed line ends."""
    *lines, torn = content.replace(b"\r\n", b"\n").split(b"\n")
    records = Records()
    previous = START
    for number, line in enumerate(lines, start=1):
        try:
            records.append(_read_line(line, previous, sequence=number - 1))
        except ValueError as error:
            raise ValueError(
                f"{name}, line {number}: {error}; restore the file from a copy"
            ) from None
        previous = digest(line)
    return Chain(records, previous, torn)


def digest(text: str | bytes) -> str:
    """SHA-256 of a text, in hexadecimal digits."""
    return hashlib.sha256(text.encode() if isinstance(text, str) else text).hexdigest()


def _read_line(line: bytes, previous: str, *, sequence: int) -> Record:
    body, mark, rest = line.rpartition(b', "sha256": "')
    if not mark or rest != f'{digest(body + b"}")}"}}'.encode():
        raise ValueError("was changed after it was written (its SHA-256 does not match)")
    try:  # A digest that is right does not prove that feel321 wrote the line.
        entry = from_json(body + b"}")
        is_record = {name: type(value) for name, value in entry.items()} == _FIELDS
        is_record = is_record and datetime.fromisoformat(entry["utc"]).tzinfo is not None
    except (AttributeError, ValueError, RecursionError):
        is_record = False
    if not is_record:
        raise ValueError("is not a record as feel321 writes them")
    if entry["previous"] != previous:
        raise ValueError("does not follow the line before (a line was taken out, put in or moved)")
    if entry["sequence"] != sequence:
        raise ValueError(f"has sequence number {entry['sequence']}, expected {sequence}")
    return Record(entry["sequence"], entry["utc"], entry["event"], entry["data"])


@dataclass(slots=True)
class Journal:
    """A journal open for writing; hold the session's lock while it is."""

    path: Path
    now: Clock
    records: Records = field(default_factory=Records)
    notice: str = ""  # repairs that were made when it was opened, for the experimenter
    tip: str = START  # SHA-256 of the last line
    is_open: bool = True  # whether it takes records
    listeners: list[Callable[[Record], None]] = field(default_factory=list)
    """Called with every record that is on the disk; they must not wait."""

    def write(self, event: SessionEvent) -> None:
        """Append one record; it is on the disk when this returns.

        If the time of day was set back since the last record, a record before it says by how much. Whatever breaks off
        a write closes the journal, for the file may hold all of the line, some or none: only reading it again shows
        where the chain goes on.
        """
        utc = self.now().isoformat(timespec="milliseconds")
        if self.records:
            last, this = (datetime.fromisoformat(text) for text in (self.records[-1].utc, utc))
            if (back_s := (last - this).total_seconds()) > 0:
                self._append(events.ClockStepped(back_s), utc)
        self._append(event, utc)

    def _append(self, event: SessionEvent, utc: str) -> None:
        record = Record(len(self.records), utc, event.event, event.to_data())
        if not self.is_open:
            raise OSError(
                f"{self.path}: an earlier write was broken off, the journal is closed; reopen it to resume"
            )
        line, self.is_open = write_line(record, self.tip), False
        with _naming(self.path):
            descriptor = os.open(self.path, _APPEND)
            try:
                before = os.fstat(descriptor).st_size
                written = os.write(descriptor, line)
                if written != len(line):
                    # A full disk takes the beginning of a line and says so by a short count only.
                    os.ftruncate(descriptor, before)
                os.fsync(descriptor)
            finally:
                os.close(descriptor)
        if written != len(line):
            raise OSError(
                f"{self.path}: the disk took {written} of {len(line)} bytes; make room, then resume"
            )
        self.records.append(record)
        self.tip, self.is_open = digest(line.rstrip(b"\n")), True
        for listen in self.listeners:
            listen(record)


def utc_now() -> datetime:
    """Return the time of day."""
    return datetime.now(UTC)


def create_journal(path: Path, *, now: Clock) -> Journal:
    """Begin a journal, of which the folder must exist; a file that is there is refused and left alone."""
    try:
        create_file(path, private=True)
        sync_folder(path.parent)
    except FileExistsError:
        raise FileExistsError(f"{path}: already exists; not overwritten, resume it") from None
    return Journal(path, now)


def require_journal(path: Path, *, now: Clock) -> Journal:
    """Go on with a journal that is there; a record and the notice say so if its last line was unfinished."""
    chain = read_journal(path)
    journal = Journal(path, now, Records(chain.records), tip=chain.tip)
    if chain.torn:
        names = (path.with_name(f"{path.name}.torn{number}") for number in count(1))
        piece = next(name for name in names if not name.exists())
        with _naming(path):
            # The piece is safe beside the journal before the journal loses it.
            write_bytes(piece, chain.torn, private=True)
            with path.open("r+b") as file:
                file.truncate(path.stat().st_size - len(chain.torn))
                os.fsync(file.fileno())
        size = len(chain.torn)
        journal.write(events.LineRecovered(size, piece.name))
        journal.notice = f"{path}: {size} bytes of an unfinished line were moved to {piece.name}"
    return journal


def read_journal(path: Path) -> Chain:
    """Read a journal without writing to it, also while its session runs; a broken chain is refused with its line."""
    if not path.is_file():
        raise FileNotFoundError(f"{path}: there is no such journal; begin the session first")
    return read_chain(path.read_bytes(), str(path))


def name_journal(session: int) -> str:
    """Make the name of a session's journal; sessions are numbered from 1."""
    return f"session-{session:02d}.jsonl"


def list_journals(folder: Path) -> list[Path]:
    """List the journals of a participant."""
    found = {path: SESSION_FILE.fullmatch(path.name) for path in folder.glob("session-*.jsonl")}
    return sorted((path for path in found if found[path]), key=lambda path: int(path.stem[8:]))


@contextmanager
def _naming(path: Path) -> Iterator[None]:
    """Name the file: a full or broken disk does not."""
    try:
        yield
    except OSError as error:
        raise OSError(
            f"{path}: the disk took no record ({error.strerror or error}); make room or repair the disk, then resume"
        ) from error


@dataclass(frozen=True, slots=True)
class Anchor:
    """What was seen of a journal: how many lines, and the digest of the last of them."""

    journal: str
    lines: int
    tip: str


def read_anchor(path: Path) -> Anchor:
    """Look at a journal as it is now, whether or not its chain holds."""
    lines = path.read_bytes().split(b"\n")[:-1]
    return Anchor(path.name, len(lines), digest(lines[-1]) if lines else START)
