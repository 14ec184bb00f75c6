"""The ledger beside a running session: the journal is the truth, the ledger follows it.

A ledger in a file is written between trials. One on a server is written by a thread beside the session, one note at a
time and always the newest, so that no trial waits for a network; while it is out of reach the session goes on by its
journal, and the next note that gets through holds all that was missed.
"""

from __future__ import annotations

from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from feel321.study.ledger import database
from feel321.study.session.events import SessionFinished
from feel321.study.session.journal import Anchor, Journal

if TYPE_CHECKING:
    from collections.abc import Callable

    from sqlalchemy import Engine

    from feel321.study.session.ports import Place


def check_live(entry: database.Entry) -> None:
    """Refuse a participant who left."""
    if entry.state not in database.LIVE:
        raise ValueError(
            f"participant {entry.participant}: was {entry.state}; no code is used twice, use another"
        )


def note_progress(
    ledger: Engine, participant: str, *, anchor: Anchor, done: int, total: int, state: str
) -> None:
    """Record how far a participant's journal reaches."""
    if state not in database.STATES:
        raise ValueError(f"state must be one of {', '.join(database.STATES)}, got {state!r}")
    with database.transact(ledger) as connection:
        entry = next(iter(database.read_entries(connection, participant)), None)
        if entry is None:
            raise ValueError(f"participant {participant}: no slot in the ledger; claim one first")
        check_live(entry)
        if entry.station not in {"", database.get_station(ledger)}:
            raise ValueError(
                f"participant {participant}: the session is at station {entry.station}"
            )
        anchors = {seen.journal: seen for seen in entry.anchors}
        seen = anchors.get(anchor.journal, anchor)
        if anchor.lines < seen.lines or (anchor.lines == seen.lines and anchor != seen):
            raise ValueError(
                f"participant {participant}: got {anchor.journal} with {anchor.lines} lines, {seen.lines} were "
                "seen, and another end; restore the file from a copy, or accept it as it is: feel321 ledger --rebuild"
            )
        anchors[anchor.journal] = anchor
        noted = replace(
            entry,
            state=state,
            done=done,
            total=total,
            anchors=tuple(anchors.values()),
            station=database.get_station(ledger),
        )
        database.write_entries(connection, [noted], instead_of=[participant])


@dataclass(frozen=True, slots=True)
class _Note:
    """How far a journal reaches at one moment."""

    anchor: Anchor
    done: int
    total: int
    state: str


@dataclass(slots=True)
class Keeper:
    """Keeps the ledger beside the journal: at the opening of a session, now and then, and at its end.

    A ledger that cannot be written is reported, and ends nobody's session: to `warn` once, as soon as it is known; and
    by `notice`, if it lags behind at the end.
    """

    ledger: Engine
    journal: Journal
    every: int
    warn: Callable[[str], None] | None = None
    place: Place | None = None
    noted: int | None = None
    notice: str = ""
    _helper: ThreadPoolExecutor | None = None
    _sent: Future[str] | None = None
    _is_behind: bool = field(default=False)

    def see(self, place: Place) -> None:
        """Follow the session, between trials."""
        self.place = place
        if self.noted is not None and place.done - self.noted < self.every:
            return
        if not database.is_shared(self.ledger):
            self._take(self._write(self._make_note(place)))
        elif self._sent is None or self._sent.done():
            self._hear()
            self._helper = self._helper or ThreadPoolExecutor(1)
            self._sent = self._helper.submit(self._write, self._make_note(place))
        else:
            return  # The one before is still under way; the next one holds this one's news.
        self.noted = place.done

    def close(self) -> None:
        """Write where the session was left; a server is given its time, for no trial waits any longer."""
        if self.place is None:
            return
        if self._helper is not None:
            self._helper.shutdown()
            self._hear()
        self._take(self._write(self._make_note(self.place)))
        if self.notice and database.is_shared(self.ledger):
            self.notice = (
                f"{self.journal.path}: the ledger lags behind ({self.notice}); it catches up when a "
                "session is next begun at this station"
            )

    def _hear(self) -> None:
        if self._sent is not None:
            self._take(self._sent.result())

    def _take(self, problem: str) -> None:
        self.notice = problem
        if problem and not self._is_behind and self.warn is not None:
            self.warn(f"{problem}; the session goes on, its journal keeps everything")
        self._is_behind = bool(problem)

    def _make_note(self, place: Place) -> _Note:
        anchor = Anchor(self.journal.path.name, len(self.journal.records), self.journal.tip)
        is_finished = self.journal.records.has(SessionFinished)
        return _Note(anchor, place.done, place.total, "finished" if is_finished else "running")

    def _write(self, note: _Note) -> str:
        try:
            note_progress(
                self.ledger,
                self.journal.path.parent.name,
                anchor=note.anchor,
                done=note.done,
                total=note.total,
                state=note.state,
            )
        except (OSError, ValueError) as error:
            return str(error)
        return ""
