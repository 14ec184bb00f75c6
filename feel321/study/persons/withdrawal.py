"""Participants who leave: one who withdraws takes all data along, one who is released leaves them.

Either way the slot is free for the next. A withdrawal that is interrupted at any instant has left everything as it
was, or a tombstone that says so; the same call finishes it.
"""

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from sqlalchemy import Engine

from feel321.files import hold_lock, make_folder
from feel321.stimuli.sets.manifest import read_stimuli
from feel321.study import server
from feel321.study.folder import StudyFolder
from feel321.study.ledger import database, progress, slots
from feel321.study.ledger.database import Entry, read_ledger
from feel321.study.matches import MATCHES_FILE, write_matches
from feel321.study.persons import removal
from feel321.study.persons.answers import ANSWERS_FILE, write_answers
from feel321.study.ratings import write_ratings
from feel321.study.session.events import SessionFinished, SessionReleased
from feel321.study.session.journal import (
    PARTICIPANT_ID,
    Clock,
    Journal,
    list_journals,
    read_anchor,
    require_journal,
)
from feel321.study.session.plan import TOMBSTONE_FILE


def withdraw_participant(
    study: StudyFolder,
    participant: str,
    *,
    now: Clock,
    reason: str = "",
    warn: Callable[[str], None] | None = None,
) -> list[str]:
    """Remove the data of a participant for good; a tombstone keeps the code from being used again."""
    say: Callable[[str], None] = warn or (lambda _: None)
    ledger, notice = slots.open_study_ledger(study, now=now)
    removed = _withdraw_rehearsals(study, participant, say=say)
    if removed and participant not in {entry.participant for entry in read_ledger(ledger)}:
        return removed
    entry = require_entry(ledger, participant, study=study, verb="withdraw")
    folder = study.sessions / participant
    found = progress.read_tombstone(folder)
    if _is_over(study, entry, found):
        if removed or found is None:
            return removed
        raise ValueError(f"participant {participant}: withdrew at {found.utc}, all data are gone")
    if folder.is_symlink():  # what it leads to is left, but looked at
        found = found or _make_tombstone(folder, entry, reason=reason, now=now)
        _announce(removal.drop_link(folder), say)
    with hold_folder(folder):
        # Or the tombstone of a withdrawal that was interrupted.
        tombstone = found or _make_tombstone(folder, entry, reason=reason, now=now)
        progress.write_tombstone(folder, replace(tombstone, state=progress.REMOVING))
        removed += _remove_data(folder, say)
        _announce([notice, *clear_derived(study, tombstone)], say)
        gone = Entry(participant, entry.simulated, entry.number, "withdrawn")
        slots.enter(ledger, participant, gone)
        database.compact(ledger)
        progress.write_tombstone(folder, replace(tombstone, state=progress.REMOVED))
    (folder / progress.LOCK_FILE).unlink(missing_ok=True)
    return removed


def _is_over(study: StudyFolder, entry: Entry, found: progress.Tombstone | None) -> bool:
    """Whether a withdrawal was finished, and nothing of the participant has come back with a copy."""
    if found is None or (found.state, entry.state) != (progress.REMOVED, "withdrawn"):
        return False
    left = progress.find_leftovers(study.sessions / entry.participant)
    return not any((left, *removal.find_data_left(study)))


def _announce(lines: Iterable[str], say: Callable[[str], None]) -> None:
    for line in filter(None, lines):
        say(line)


def clear_derived(study: StudyFolder, tombstone: progress.Tombstone) -> Iterator[str]:
    """Remove the participant from all that was derived, whatever a kill left of it included."""
    yield from removal.clear_unfinished(study)
    yield from _renew_tables(study)
    if tombstone.journals:
        yield from removal.clear_results(study)
        yield from removal.clear_outputs(study)


def _withdraw_rehearsals(
    study: StudyFolder, participant: str, *, say: Callable[[str], None]
) -> list[str]:
    """Remove what was rehearsed under the participant's code, and its entry in the ledger of rehearsals."""
    own = replace(study, is_rehearsal=True)
    folder = own.sessions / participant
    if study.is_rehearsal or not PARTICIPANT_ID.fullmatch(participant):
        return []
    removed = []
    if folder.is_symlink() or folder.is_dir():
        _announce(removal.drop_link(folder), say)
        with hold_folder(folder):
            removed = [
                f"{own.sessions.name}/{participant}/{name}" for name in _remove_data(folder, say)
            ]
        (folder / progress.LOCK_FILE).unlink(missing_ok=True)
        folder.rmdir()
    if own.ledger.is_file() and not own.ledger.is_symlink():
        ledger = database.open_ledger(own.ledger)
        if read_ledger(ledger, participant):
            slots.enter(ledger, participant, None)
            removed = removed or [f"{own.sessions.name}/{participant}"]
        database.compact(ledger)
    return removed


def release_participant(study: StudyFolder, participant: str, *, now: Clock) -> int:
    """Release a participant who will not come back: the slot is free again, what was recorded is kept.

    Of one who never began there is nothing to keep: the plan goes, and the code may be used again.
    """
    ledger, _ = slots.open_study_ledger(study, now=now)
    entry = require_entry(ledger, participant, study=study, verb="release")
    folder = study.sessions / participant
    if progress.read_tombstone(folder) is not None:
        raise ValueError(f"participant {participant}: withdrew, there is nothing to release")
    if entry.state == "released":
        raise ValueError(
            f"participant {participant}: was released before; number {entry.number} is free"
        )
    with hold_folder(folder):
        progress.check_anchors(entry.anchors, folder)
        journal = _open_newest(folder, now=now)
        if journal is not None:
            _write_release(journal, participant)
            slots.enter(ledger, participant, slots.make_entry(progress.read_progress(folder)))
            return entry.number
        removal.clear_folder(folder, keep={folder / progress.LOCK_FILE})
        slots.enter(ledger, participant, None)
    (folder / progress.LOCK_FILE).unlink(missing_ok=True)
    folder.rmdir()
    return entry.number


def require_entry(ledger: Engine, participant: str, *, study: StudyFolder, verb: str) -> Entry:
    """Find a participant in the ledger, whose session is this station's."""
    entries = {entry.participant: entry for entry in read_ledger(ledger)}
    if participant not in entries:
        known = ", ".join(entries) or "nobody yet"
        raise ValueError(f"participant must be in the ledger, got {participant!r}; known: {known}")
    entry = entries[participant]
    # Data that were collected or copied here may be removed here; a session goes on, and ends, at its own station.
    if slots.is_absent(entry, study) if verb == "withdraw" else slots.is_away(entry):
        raise ValueError(
            f"participant {participant}: is at station {entry.station}; {verb} there, or, if that station is lost: "
            f"{server.take_over(entry.station)}"
        )
    return entry


@contextmanager
def hold_folder(folder: Path) -> Iterator[None]:
    """Keep sessions from writing to a participant's folder."""
    make_folder(folder, private=True)
    busy = "a session is running here; let it finish or stop it first"
    with hold_lock(folder / progress.LOCK_FILE, busy=busy):
        yield


def _make_tombstone(folder: Path, entry: Entry, *, reason: str, now: Clock) -> progress.Tombstone:
    return progress.Tombstone(
        participant=entry.participant,
        number=entry.number,
        simulated=entry.simulated,
        utc=now().isoformat(timespec="seconds"),
        reason=reason,
        journals=tuple(read_anchor(path) for path in list_journals(folder)) or entry.anchors,
        state=progress.REMOVING,
    )


def _remove_data(folder: Path, say: Callable[[str], None]) -> list[str]:
    """Remove everything in a folder but its tombstone and the lock that is held."""
    kept = {folder / TOMBSTONE_FILE, folder / progress.LOCK_FILE}
    removed, said = removal.clear_folder(folder, keep=kept)
    _announce(said, say)
    return removed


def _renew_tables(study: StudyFolder) -> Iterator[str]:
    """Rewrite, without the participant, the tables that are there; yield what is left to do by hand."""
    tables: dict[Path, Callable[[], object]] = {
        study.ratings: lambda: write_ratings(study, read_stimuli(study.stimuli)),
        study.path / progress.ROSTER_FILE: lambda: progress.write_roster(study),
        study.path / ANSWERS_FILE: lambda: write_answers(study),
        study.path / MATCHES_FILE: lambda: write_matches(study, read_stimuli(study.stimuli)),
    }
    # The Parquet twin of the ratings is made with the CSV; where that fails, or is missing, no twin may stay.
    twin = study.ratings.with_suffix(".parquet")
    yield from removal.drop_link(twin)
    twin.unlink(missing_ok=True)
    for path, write in tables.items():
        is_there = path.exists()
        yield from removal.drop_link(path)
        if is_there:
            try:
                write()
            except (OSError, ValueError) as error:
                # A derived table can be made again; the data of someone who withdrew may not stay.
                path.unlink(missing_ok=True)
                yield f"{path}: was removed, because it could not be rewritten ({error})"


def _open_newest(folder: Path, *, now: Clock) -> Journal | None:
    """Open the newest journal; None if no session was ever begun."""
    journals = list_journals(folder)
    journal = require_journal(journals[-1], now=now) if journals else None
    if journal is None or (len(journals) == 1 and not journal.records.find_header()):
        return None
    return journal


def _write_release(journal: Journal, participant: str) -> None:
    if journal.records.has(SessionFinished):
        raise ValueError(
            f"participant {participant}: has finished, so the slot stays taken; to remove the data: feel321 withdraw"
        )
    # After a crash, the journal may know already what the ledger does not.
    if not journal.records.has(SessionReleased):
        journal.write(SessionReleased())
