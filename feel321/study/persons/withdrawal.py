"""Participants who leave: one who withdraws takes all data along, one who is released leaves them.

Either way the slot is free for the next. A withdrawal that is interrupted at any instant has left everything as it
was, or a tombstone that says so; the same call finishes it.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from sqlalchemy import Engine

from feel321.files import hold_lock, make_folder, sync_folder
from feel321.stimuli.sets.manifest import read_stimuli
from feel321.study import server
from feel321.study.folder import StudyFolder
from feel321.study.ledger import progress, slots
from feel321.study.ledger.database import Entry, read_ledger
from feel321.study.matches import MATCHES_FILE, write_matches
from feel321.study.persons.answers import ANSWERS_FILE, write_answers
from feel321.study.ratings import write_ratings
from feel321.study.session.events import SessionFinished, SessionReleased
from feel321.study.session.journal import (
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
    ledger, notice = slots.open_study_ledger(study, now=now)
    entry = require_entry(ledger, participant, study=study, verb="withdraw")
    folder = study.sessions / participant
    if (
        (found := progress.read_tombstone(folder))
        and found.state == progress.REMOVED
        and entry.state == "withdrawn"
    ):
        raise ValueError(f"participant {participant}: withdrew at {found.utc}, all data are gone")
    with hold_folder(folder):
        # Or the one of a withdrawal that was interrupted.
        tombstone = found or _make_tombstone(folder, entry, reason=reason, now=now)
        removed = _remove_data(folder)
        warnings = [notice, *_renew_tables(study)]
        if tombstone.journals:
            warnings += _remove_report(study)
        rehearsal = replace(study, is_rehearsal=True).sessions / participant
        if rehearsal.exists() and rehearsal != folder:
            warnings.append(f"{rehearsal}: was rehearsed under the same code; remove the folder")
        slots.enter(
            ledger, participant, Entry(participant, entry.simulated, entry.number, "withdrawn")
        )
        progress.write_tombstone(folder, replace(tombstone, state=progress.REMOVED))
    (folder / progress.LOCK_FILE).unlink(missing_ok=True)
    if warn is not None:
        for warning in filter(None, warnings):
            warn(warning)
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
        _remove_data(folder)
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
    make_folder(folder)
    busy = "a session is running here; let it finish or stop it first"
    with hold_lock(folder / progress.LOCK_FILE, busy=busy):
        yield


def _make_tombstone(folder: Path, entry: Entry, *, reason: str, now: Clock) -> progress.Tombstone:
    tombstone = progress.Tombstone(
        participant=entry.participant,
        number=entry.number,
        simulated=entry.simulated,
        utc=now().isoformat(timespec="seconds"),
        reason=reason,
        journals=tuple(read_anchor(path) for path in list_journals(folder)),
        state=progress.REMOVING,
    )
    progress.write_tombstone(folder, tombstone)
    return tombstone


def _remove_data(folder: Path) -> list[str]:
    """Remove everything in a folder but its tombstone and the lock that is held."""
    kept = {folder / TOMBSTONE_FILE, folder / progress.LOCK_FILE}
    found = [path for path in sorted(folder.rglob("*"), reverse=True) if path not in kept]
    for path in found:
        if path.is_dir() and not path.is_symlink():
            path.rmdir()
        else:
            path.unlink()
    sync_folder(folder)
    return sorted(str(path.relative_to(folder)) for path in found)


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
    twin.unlink(missing_ok=True)
    for path in (twin, *tables):
        # What a kill may have left of an earlier writing.
        for unfinished in path.parent.glob(f".{path.name}.*.part"):
            unfinished.unlink()
    for path, write in tables.items():
        if path.exists():
            try:
                write()
            except (OSError, ValueError) as error:
                # A derived table can be made again; the data of someone who withdrew may not stay.
                path.unlink()
                yield f"{path}: was removed, because it could not be rewritten ({error})"


def _remove_report(study: StudyFolder) -> Iterator[str]:
    if study.report.is_dir():
        from feel321.analysis.report.folder import remove_results

        remove_results(study.report)
        yield f"{study.report}: was removed, for it held the participant's data; write it anew: feel321 analyze"
    if study.report.exists():
        yield f"{study.report}: holds other files; remove those with the participant's data"


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
