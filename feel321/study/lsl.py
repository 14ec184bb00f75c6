"""Onsets on the lab streaming layer (LSL), so that recordings of other devices can be lined up with a session.

A listener of the journal: each playback becomes one marker once it is on the disk, stamped with the time of its onset,
taken from the session's clock to that of LSL.
"""

import json
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path

from feel321.study.session.events import PartPlayed, SurfaceStroked
from feel321.study.session.journal import Journal, Record, digest

SENT = {PartPlayed.event, SurfaceStroked.event}  # events that become a marker
FIELDS = ("trial", "attempt", "part", "completed")  # of the event, in its marker


def check_lsl() -> None:
    """Demand the library, before a session begins."""
    if find_spec("pylsl") is None:
        raise OSError(
            "run: pylsl not found, which [session] lsl and --lsl need; pip install 'feel321[lsl]', or switch them off"
        )


def make_marker(record: Record) -> tuple[str, float]:
    """Make the text of a marker, and its time on the session's clock; of what never began, that of the request."""
    data = record.data
    own = {"event": record.event, "sequence": record.sequence}
    text = json.dumps(own | {name: data[name] for name in FIELDS}, ensure_ascii=False)
    onset_s = data["onset_s"]
    return text, data["requested_s"] if onset_s is None else onset_s


def name_source(journal: Path) -> str:
    """Name the source of a session's markers: the network sees it, so that it must not name the participant."""
    return f"feel321 {digest(str(journal.resolve()))[:16]}"


@contextmanager
def open_outlet(journal: Journal, clock: Callable[[], float]) -> Iterator[None]:
    """Send the onsets of a journal as they are written, until the session ends; clock: the session's, in s.

    A push only hands a marker to LSL's own threads; where it fails the session goes on, and its end names the loss.
    """
    check_lsl()
    import pylsl

    source, rate = name_source(journal.path), pylsl.IRREGULAR_RATE
    try:
        info = pylsl.StreamInfo("feel321", "Markers", 1, rate, pylsl.cf_string, source)
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
        try:
            stream.push_sample([text], time_s + pylsl.local_clock() - clock())
        except Exception as error:  # noqa: BLE001 - whatever the library raises, the session goes on
            lost.append(error)

    journal.listeners.append(send)
    try:
        yield
    finally:
        journal.listeners.remove(send)
        if lost:
            words = f"LSL: {len(lost)} markers were lost ({lost[-1]}); the journal has them all"
            warnings.warn(words, stacklevel=2)
