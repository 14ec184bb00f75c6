"""A participant's plan and journals: each chain, its header and times, and how one session follows another."""

from __future__ import annotations

import hashlib
from datetime import datetime
from itertools import pairwise
from typing import TYPE_CHECKING

from feel321.study.auditing.replay import MALFORMED, audit_steps
from feel321.study.folder import DELIVERED, name_delivered
from feel321.study.persons.answers import audit_personal
from feel321.study.ratings import find_misplaced
from feel321.study.session import events
from feel321.study.session.journal import Chain, Record, list_journals, name_journal, read_journal

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence
    from pathlib import Path

    from feel321.study.session.plan import Plan

APART_S = 10.0
"""How far the time of day and the presenter's clock may part between two records."""

_CLOCKS_APART = {
    kind.event for kind in (events.SessionBegun, events.SessionResumed, events.ClockStepped)
}
_CLOCKS_ASLEEP = {
    kind.event
    for kind in (events.PageRead, events.QuestionAnswered, events.TrialContinued, events.DeviceOpened)
}  # fmt: skip
"""In a pause or on a page the computer may sleep, and the presenter's clock with it."""


def guard(place: Path, findings: Iterable[str]) -> Iterator[str]:
    """Make one finding of what cannot be looked at, so that everything else is."""
    try:
        yield from findings
    except (OSError, ValueError) as error:
        named = getattr(error, "filename", None)  # the system's own words name it last
        text = f"{named}: {getattr(error, 'strerror', '')}" if named else str(error)
        yield text if str(place) in text else f"{place}: {text}"
    except MALFORMED as error:
        text = f"holds what feel321 does not write ({type(error).__name__}: {error})"
        yield f"{place}: {text}; restore it from a copy"


def audit_journals(
    folder: Path, plan: Plan, chains: dict[Path, Chain] | None = None
) -> Iterator[str]:
    """Verify all journals of a participant; chains: filled with those that can be read."""
    chains = {} if chains is None else chains
    for path in sorted(folder.glob("session-*.jsonl")):  # Copies under other names too.
        yield from guard(path, _audit_file(path, plan, chains))
    yield from _audit_succession(list_journals(folder), chains)


def _audit_file(path: Path, plan: Plan, chains: dict[Path, Chain]) -> Iterator[str]:
    chains[path] = chain = read_journal(path)
    if chain.torn:
        yield f"{path}: ends in {len(chain.torn)} bytes of an unfinished line; resuming moves them aside"
    try:
        header = chain.records.find_header()
    except ValueError as error:
        yield f"{path}, {error}"
        return
    if header is not None:
        yield from (
            f"{path}{finding}" for finding in _audit_journal(header, chain, plan, path=path)
        )
        return
    # A crash may have come before it, and nobody come back.
    allowed = {kind.event for kind in (*events.REPAIRS, events.SessionReleased)}
    if not {record.event for record in chain.records} <= allowed:
        yield f"{path}: has no header"


def _audit_journal(
    header: events.SessionBegun, chain: Chain, plan: Plan, *, path: Path
) -> Iterator[str]:
    yield from find_misplaced(path, header, plan)
    yield from _audit_header(header, plan, path)
    yield from _audit_clocks(header, chain.records)
    times = [datetime.fromisoformat(record.utc) for record in chain.records]
    for record, (before, time) in zip(chain.records[1:], pairwise(times), strict=True):
        if time < before and record.event != events.ClockStepped.event:
            yield f", line {record.sequence + 1}: is older than the line before, and nothing says why"
    steps = list(audit_steps(chain.records, plan))
    yield from steps
    if not steps:  # else records need not be as they should
        yield from _audit_files(chain.records, path.parent)
        yield from audit_personal(path.parent, chain.records)


def _audit_header(header: events.SessionBegun, plan: Plan, path: Path) -> Iterator[str]:
    """Compare the header with the plan, and with where the journal is."""
    presenter = header.identity.get("presenter", {})
    is_simulated = presenter.get("simulated")
    if is_simulated is not plan.simulated:
        yield f", line 1: has simulated {is_simulated}, the plan says {plan.simulated}"
    if not is_simulated and "observer" in presenter:
        yield ", line 1: has simulated false, and a simulated observer in the place of a participant"
    if presenter.get("rehearsal") and path.parent.parent.name == "sessions":
        yield ", line 1: is a rehearsal; move it out of sessions/"
    for name in ("seed", "stimuli_sha256"):
        if (got := getattr(header, name)) != (planned := getattr(plan, name)):
            yield f", line 1: has {name} {got}, the plan says {planned}"


def _audit_clocks(header: events.SessionBegun, records: Sequence[Record]) -> Iterator[str]:
    """Find where the time of day and the presenter's clock part, and nothing says why."""
    if header.identity.get("presenter", {}).get("simulated", True):
        return  # Simulated participants have a clock of their own.
    before, is_asleep = None, False
    for record in records:
        if record.event in _CLOCKS_APART:
            before = None
        is_asleep |= record.event in _CLOCKS_ASLEEP
        if not isinstance(record.data.get("time_s"), int | float):
            continue
        if before is not None:
            day = datetime.fromisoformat(record.utc) - datetime.fromisoformat(before.utc)
            day_s, own_s = day.total_seconds(), record.data["time_s"] - before.data["time_s"]
            if own_s - day_s > APART_S or (day_s - own_s > APART_S and not is_asleep):
                yield (
                    f", line {record.sequence + 1}: {day_s:.0f} s after line {before.sequence + 1} by the time of day, "
                    f"{own_s:.0f} s by the clock of the session, and nothing says why"
                )
        before, is_asleep = record, False


def list_files(records: Sequence[Record], folder: Path) -> Iterator[tuple[Record, Path, str]]:
    """List the files of what was rendered or measured: who names them, where they are, their digest."""
    for record in records:
        played = record.content if record.event == events.PartPlayed.event else None
        if isinstance(played, events.PartPlayed) and played.delivered_sha256:
            name = name_delivered(int(played.measured.get("file_number", 0)))
            yield record, folder / DELIVERED / name, played.delivered_sha256


def _audit_files(records: Sequence[Record], folder: Path) -> Iterator[str]:
    for record, path, sha256 in list_files(records, folder):
        name = f", line {record.sequence + 1}: {path.parent.name}/{path.name}"
        if not path.is_file():
            yield f"{name} is gone; restore it from a copy"
        elif hashlib.sha256(path.read_bytes()).hexdigest() != sha256:
            yield f"{name} was changed since it was written; restore it from a copy"


def _audit_succession(journals: Sequence[Path], chains: Mapping[Path, Chain]) -> Iterator[str]:
    """Check that sessions are numbered on, and that each but the newest says which one took its place."""
    for session, path in enumerate(journals, start=1):
        if path.name != name_journal(session):
            yield f"{path}: is there without {name_journal(session)} before it"
            return
        if path == journals[-1] or path not in chains:
            continue
        superseded = events.SessionSuperseded.event
        by = [one.data.get("by") for one in chains[path].records if one.event == superseded]
        if session + 1 not in by:
            yield f"{path}: does not mention {name_journal(session + 1)}, which stands beside it"
