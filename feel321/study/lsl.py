"""A session's events on the lab streaming layer (LSL), so that recordings of other devices can be lined up with them.

A listener of the journal: each record becomes one marker once it is on the disk. A marker is stamped with the time of
the event itself, taken from the session's clock to that of LSL; that of a playback with its onset, although it is
recorded once it is over.
"""

from __future__ import annotations

import json
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from typing import TYPE_CHECKING

from feel321.study.session import events
from feel321.study.session.journal import digest

if TYPE_CHECKING:
    from pathlib import Path

    from feel321.study.session.journal import Journal, Record

STREAM, KIND = "feel321", "Markers"

SENT = {
    kind.event
    for kind in (
        events.TrialShown, events.TonePresented, events.PartPlayed, events.SurfaceStroked, events.TrialRated,
        events.TrialSpoiled, events.TrialPaused, events.TrialContinued, events.PageRead, events.SessionFinished,
        events.SessionAborted,
    )
}  # fmt: skip
"""Events that become a marker; answers to question pages and notes do not."""

FIELDS = ("trial", "attempt", "part", "completed", "values", "rejected", "flags", "key")
"""What a marker has of its record, beside the event's name and the journal's sequence."""


def check_lsl() -> None:
    """Demand the library, before a session begins."""
    if find_spec("pylsl") is None:
        raise OSError(
            "run: pylsl not found, which [session] lsl and --lsl need; pip install 'feel321[lsl]', or switch them off"
        )


def make_marker(record: Record) -> tuple[str, float | None]:
    """Make the text of a marker, and its time on the session's clock; None: the record has none."""
    data = record.data
    own = {name: data[name] for name in FIELDS if name in data}
    text = json.dumps(
        {"event": record.event, "sequence": record.sequence, **own}, ensure_ascii=False
    )
    times = (data.get(name) for name in ("onset_s", "requested_s", "time_s"))
    return text, next((time_s for time_s in times if time_s is not None), None)


def name_source(journal: Path) -> str:
    """Name the source of a session's markers: the network sees it, so that it must not name the participant."""
    return f"{STREAM} {digest(str(journal.resolve()))[:16]}"


@contextmanager
def open_outlet(journal: Journal, clock: Callable[[], float]) -> Iterator[None]:
    """Send the records of a journal as they are written, until the session ends; clock: the session's, in s.

    A push only hands a marker to LSL's own threads; where it fails the session goes on, and its end names the loss.
    """
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
    lost: list[Exception] = []

    def send(record: Record) -> None:
        if record.event not in SENT:
            return
        text, time_s = make_marker(record)
        now = pylsl.local_clock()
        try:
            stream.push_sample([text], now if time_s is None else time_s + now - clock())
        except Exception as error:  # noqa: BLE001 - whatever the library raises, the session goes on
            lost.append(error)

    journal.listeners.append(send)
    try:
        yield
    finally:
        journal.listeners.remove(send)
        if lost:
            warnings.warn(
                f"LSL: {len(lost)} markers were lost ({lost[-1]}); the journal has them all",
                stacklevel=2,
            )
