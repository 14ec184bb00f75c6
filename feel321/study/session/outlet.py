"""A session's events on the lab streaming layer (LSL), so that other devices can be lined up with them.

Markers are sent by a thread of their own: the session leaves an event in a queue and goes on. They are stamped with the
time of the event itself, taken from the session's clock to that of LSL. A playback is recorded once it is over: its two
markers, began and ended, then come together, each with its own time.
"""

from __future__ import annotations

import json
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from importlib.util import find_spec
from queue import SimpleQueue
from threading import Thread
from typing import TYPE_CHECKING, Any

from feel321.study.session import events
from feel321.study.session.journal import digest

if TYPE_CHECKING:
    from pathlib import Path

    from feel321.study.session.journal import Journal, Record

STREAM, KIND = "feel321", "Markers"

SENT: dict[str, tuple[str, ...]] = {
    events.TrialShown.event: ("trial", "attempt"),
    events.TonePresented.event: ("trial", "attempt"),
    events.TrialRated.event: ("trial", "attempt", "values", "rejected"),
    events.TrialSpoiled.event: ("trial", "attempt", "flags"),
    events.TrialPaused.event: ("trial", "attempt"),
    events.TrialContinued.event: ("trial", "attempt"),
    events.PageRead.event: ("key",),
    events.SessionFinished.event: (),
    events.SessionAborted.event: (),
}
"""Events that become a marker, and the fields sent with each; answers to question pages are not sent."""

PLAYED = {kind.event for kind in (events.PartPlayed, events.SurfaceStroked)}
"""Events that become two: a playback began and ended."""

WAIT_S = 2.0
"""Longest time that the end of a session waits for the last markers."""

Marker = tuple[dict[str, Any], float]
"""What is sent, and its time on LSL's clock."""


def check_lsl() -> None:
    """Demand the library, before a session begins."""
    if find_spec("pylsl") is None:
        raise OSError(
            "run: pylsl not found, which [session] lsl and --lsl need; pip install 'feel321[lsl]', or switch them off"
        )


def make_markers(record: Record, *, now: float, offset_s: float) -> Iterator[Marker]:
    """Make the markers of a record; now: LSL's time; offset_s: what LSL's clock is ahead of the session's."""
    data = record.data
    place = {"event": record.event, "sequence": record.sequence}
    if record.event in SENT:
        own = {name: data[name] for name in SENT[record.event] if name in data}
        yield {**place, **own}, data["time_s"] + offset_s if "time_s" in data else now
    elif record.event in PLAYED:
        own = {name: data[name] for name in ("trial", "attempt", "part")}
        began_s = data["requested_s"] if data["onset_s"] is None else data["onset_s"]
        yield {**place, **own, "event": "playback_began"}, began_s + offset_s
        yield {**place, **own, "event": "playback_ended", "completed": data["completed"]}, now


@dataclass(slots=True)
class EventOutlet:
    """Sends markers; send, clock: of LSL; session_clock: that of the presenter, in s."""

    send: Callable[[str, float], None]
    clock: Callable[[], float]
    session_clock: Callable[[], float]
    fault: str = ""
    _queue: SimpleQueue[Marker | None] = field(default_factory=SimpleQueue)
    _thread: Thread | None = None

    def take(self, record: Record) -> None:
        """Take a record as soon as it is on the disk; this never waits."""
        now = self.clock()
        for marker in make_markers(record, now=now, offset_s=now - self.session_clock()):
            self._queue.put(marker)

    def start(self) -> None:
        """Start sending."""
        self._thread = Thread(target=self._run, name="lsl", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Send what is left, as far as that takes no longer than two seconds."""
        self._queue.put(None)
        if self._thread is not None:
            self._thread.join(WAIT_S)

    def _run(self) -> None:
        while (marker := self._queue.get()) is not None:
            try:
                self.send(json.dumps(marker[0], ensure_ascii=False), marker[1])
            except Exception as error:  # noqa: BLE001 - whatever the library raises, the session goes on
                self.fault = f"{type(error).__name__}: {error}"


def name_source(journal: Path) -> str:
    """Name the source of a session's markers: the network sees it, so that it must not name the participant."""
    return f"{STREAM} {digest(str(journal.resolve()))[:16]}"


@contextmanager
def open_outlet(journal: Journal, clock: Callable[[], float]) -> Iterator[EventOutlet]:
    """Send the records of a journal as they are written, until the session ends."""
    check_lsl()
    import pylsl

    source = name_source(journal.path)
    info = pylsl.StreamInfo(STREAM, KIND, 1, pylsl.IRREGULAR_RATE, pylsl.cf_string, source)
    try:
        stream = pylsl.StreamOutlet(info)
    except RuntimeError as error:
        raise OSError(
            f"run: LSL cannot open an outlet ({error}); switch off [session] lsl"
        ) from None
    outlet = EventOutlet(
        lambda text, time: stream.push_sample([text], time), pylsl.local_clock, clock
    )
    outlet.start()
    journal.listeners.append(outlet.take)
    try:
        yield outlet
    finally:
        journal.listeners.remove(outlet.take)
        outlet.close()
        if outlet.fault:
            warnings.warn(
                f"LSL: markers were lost ({outlet.fault}); the journal has them all", stacklevel=2
            )
