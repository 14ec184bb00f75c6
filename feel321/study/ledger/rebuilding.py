"""The ledger rebuilt from the files of a study, and tombstones of participants who withdrew."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from shlex import quote
from typing import TYPE_CHECKING

from feel321.files import write_text
from feel321.study.ledger.database import (
    LIVE,
    WAS_MISSING,
    Anchor,
    Entry,
    find_cut,
    list_forgotten,
    note_forgotten,
    tell_time,
)
from feel321.study.ledger.slots import (
    Standing,
    open_ledger,
    read_ledger,
    read_standing,
    read_standings,
    rewrite_ledger,
)
from feel321.study.session.journal import digest
from feel321.study.session.opening import TOMBSTONE_FILE

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping
    from pathlib import Path
    from typing import Any

    from sqlalchemy import Engine

    from feel321.study.folder import StudyFolder
    from feel321.study.session.journal import Clock

# What stays of a participant who withdrew: a code that is not used again, and digests of what was removed.

REMOVING, REMOVED = "removing", "removed"

LOCK_FILE = ".lock"
"""Held while a session runs or a participant leaves."""


@dataclass(frozen=True, slots=True)
class Tombstone:
    """What stays of a participant who withdrew."""

    participant: str
    number: int
    simulated: bool
    utc: str
    reason: str
    journals: tuple[Anchor, ...]
    state: str


def write_tombstone(folder: Path, tombstone: Tombstone) -> None:
    """Write a tombstone and seal it with its digest, replacing the one that is there."""
    entry = asdict(tombstone)
    sealed = entry | {"sha256": _digest(entry)}
    write_text(folder / TOMBSTONE_FILE, json.dumps(sealed, indent=1, ensure_ascii=False) + "\n")


def read_tombstone(folder: Path) -> Tombstone | None:
    """Read a tombstone."""
    path = folder / TOMBSTONE_FILE
    if not path.exists():
        return None
    try:
        entry = json.loads(path.read_bytes())
        is_sealed = entry.pop("sha256") == _digest(entry)
        tombstone = Tombstone(
            **entry | {"journals": tuple(Anchor(**anchor) for anchor in entry["journals"])}
        )
    except (AttributeError, KeyError, TypeError, ValueError, RecursionError):
        is_sealed, tombstone = False, None
    if not is_sealed:
        raise ValueError(
            f"{path}: got no tombstone, or one that was changed after it was written; restore the file from a copy"
        )
    return tombstone


def find_leftovers(folder: Path) -> list[str]:
    """Find what lies beside a tombstone: nothing of someone who withdrew may stay, or come back with a copy."""
    if not (folder / TOMBSTONE_FILE).exists():
        return []
    kept = {folder / TOMBSTONE_FILE, folder / LOCK_FILE}
    files = {path for path in folder.rglob("*") if path.is_symlink() or not path.is_dir()}
    return [
        f"{path}: lies beside a tombstone, the participant withdrew; remove it"
        for path in sorted(files - kept)
    ]


def _digest(entry: Mapping[str, Any]) -> str:
    return digest(json.dumps(entry, sort_keys=True))


# The ledger against what lies on the disk: rebuilt from it, and asked what is missing there.


def open_study_ledger(study: StudyFolder, *, now: Clock = tell_time) -> tuple[Engine, str]:
    """Open the ledger of a study to write in it; one that is missing is rebuilt, and the log beside it says so."""
    ledger = _open(study)
    if read_ledger(ledger):
        return ledger, ""
    entries, _ = _read_disk(study)

    def change(known: list[Entry]) -> list[Entry]:
        # Whoever else found it missing may have been quicker, and claimed slots since.
        if not known:
            note_forgotten(study, [WAS_MISSING], now=now)
        return known or entries

    if not entries or rewrite_ledger(ledger, change):
        return ledger, ""
    count = len(entries)
    return (
        ledger,
        f"{study.ledger}: was missing; {count} participants were entered from their plans and journals",
    )


def read_study_ledger(study: StudyFolder) -> list[Entry]:
    """Read the ledger of a study and write nothing."""
    if study.ledger.exists():
        return read_ledger(open_ledger(study.ledger))
    if any(map(_is_begun, study.participants)):
        raise FileNotFoundError(_describe_missing(study))
    return []


def rebuild_ledger(study: StudyFolder, *, now: Clock = tell_time) -> list[str]:
    """Make the ledger of a study anew from plans, journals and tombstones.

    Slots that were claimed by participants without a plan so far are kept: they stand nowhere else. What is
    forgotten is noted for good in a log beside the ledger.
    """
    was_missing = not study.ledger.exists()
    lost, wrong = ([], []) if was_missing else _compare(study)
    problems: list[str] = []

    def change(known: list[Entry]) -> list[Entry]:
        entries, found = _read_disk(study)
        problems.extend(found)
        names = {entry.participant for entry in entries}
        waiting = [
            e
            for e in known
            if e.state == "claimed" and not e.anchors and e.participant not in names
        ]
        _check_slots(entries + waiting)
        note_forgotten(study, [WAS_MISSING] if was_missing and entries else lost, now=now)
        return entries + waiting

    rewrite_ledger(_open(study), change)
    return lost + wrong + problems


def find_lost(study: StudyFolder) -> list[str]:
    """Find what the ledger once saw and the disk no longer holds, the other way round, and what it ever forgot."""
    lost, wrong = _compare(study)
    return lost + wrong + list_forgotten(study)


def make_entry(standing: Standing) -> Entry:
    """Make the entry of a participant from where they stand."""
    return Entry(
        participant=standing.participant,
        simulated=standing.simulated,
        number=standing.number,
        state=standing.state,
        done=standing.done,
        # The ledger learns the total with the first line that it sees.
        total=standing.total if standing.anchors else 0,
        anchors=standing.anchors,
        claimed_utc=standing.first_utc,
    )


def _compare(study: StudyFolder) -> tuple[list[str], list[str]]:
    """Find what the ledger saw and the disk does not hold, and what a rebuild only sets right."""
    try:
        entries = {entry.participant: entry for entry in read_study_ledger(study)}
    except (OSError, ValueError) as error:
        return [str(error)], []
    lost: list[str] = []
    edited: list[str] = []
    for entry in entries.values():
        lines = list(_find_lost_of(entry, study))
        lost += lines
        edited += [] if lines else _find_edited(entry, study)
    unknown = [
        folder for folder in study.participants if folder.name not in entries and _is_begun(folder)
    ]
    return lost, edited + [
        f"{folder}: is not in the ledger; enter it: {_name_rebuild(study)}" for folder in unknown
    ]


def _describe_missing(study: StudyFolder) -> str:
    return f"{study.ledger}: is missing, so nobody can tell what else is; rebuild it: {_name_rebuild(study)}"


def _name_rebuild(study: StudyFolder) -> str:
    return f"feel321 ledger {quote(str(study.path))} --rebuild"


def _open(study: StudyFolder) -> Engine:
    study.sessions.mkdir(exist_ok=True)
    return open_ledger(study.ledger)


def _read_disk(study: StudyFolder) -> tuple[list[Entry], list[str]]:
    """Read the entries of all participants, and what is wrong with their journals."""
    standings = read_standings(study)
    tombstones = filter(None, (read_tombstone(folder) for folder in study.participants))
    entries = [*map(make_entry, standings), *map(_make_withdrawn, tombstones)]
    _check_slots(entries)
    return entries, [standing.problem for standing in standings if standing.problem]


def _make_withdrawn(tombstone: Tombstone) -> Entry:
    return Entry(tombstone.participant, tombstone.simulated, tombstone.number, "withdrawn")


def _check_slots(entries: Iterable[Entry]) -> None:
    holders: dict[tuple[bool, int], str] = {}
    for entry in entries:
        if entry.state in LIVE:
            holder = holders.setdefault((entry.simulated, entry.number), entry.participant)
            if holder != entry.participant:
                raise ValueError(
                    f"number {entry.number}: is held by {holder} and by {entry.participant}, allowed is one of them; "
                    "release one, or move one's folder out of sessions/"
                )


def _is_begun(folder: Path) -> bool:
    return any(folder.glob("*.json*"))


def _find_lost_of(entry: Entry, study: StudyFolder) -> Iterator[str]:
    folder = study.sessions / entry.participant
    try:
        tombstone = read_tombstone(folder)
    except ValueError as error:
        yield str(error)
        return
    if tombstone is not None:
        yield from _find_unlike(tombstone, entry, study)
    elif entry.state == "withdrawn":
        yield f"{folder}: the participant was withdrawn, the tombstone is gone; restore it from a copy"
    elif entry.anchors and not _is_begun(folder):
        lines = sum(anchor.lines for anchor in entry.anchors)
        yield f"{folder}: is gone without a tombstone, {lines} lines of its journals were seen; restore it from a copy"
    elif cuts := [cut for anchor in entry.anchors if (cut := find_cut(anchor, folder))]:
        yield from cuts


def _find_unlike(tombstone: Tombstone, entry: Entry, study: StudyFolder) -> Iterator[str]:
    folder = study.sessions / entry.participant
    if (tombstone.state, entry.state) != (REMOVED, "withdrawn"):
        again = f"feel321 withdraw {quote(str(study.path))} --participant {entry.participant}"
        yield f"{folder}: the withdrawal was broken off; finish it: {again}"
    elif (tombstone.number, tombstone.simulated) != (entry.number, entry.simulated):
        yield f"{folder}: the tombstone is another one than the ledger saw written; restore both from a copy"


def _find_edited(entry: Entry, study: StudyFolder) -> Iterator[str]:
    """Find what the ledger says of a participant and neither plan nor journals ever said."""
    folder = study.sessions / entry.participant
    if (folder / TOMBSTONE_FILE).exists() or not _is_begun(folder):
        return
    try:
        standing = read_standing(folder)
    except (OSError, ValueError):
        return  # Whatever is wrong with plan or journals is for those to say who read them.
    pairs: list[tuple[str, object, object]] = [
        ("number", entry.number, standing.number),
        ("simulated", entry.simulated, standing.simulated),
    ]
    # The ledger may lag behind a journal, but what ends a session it only knows from there.
    if not standing.problem and (
        entry.anchors == standing.anchors or entry.state in {"finished", "released"}
    ):
        pairs.append(("state", entry.state, standing.state))
    for name, got, expected in pairs:
        if got != expected:
            yield (
                f"{study.ledger}: {entry.participant} has {name} {got}, plan and journals say {expected}; "
                f"rebuild it: {_name_rebuild(study)}"
            )
