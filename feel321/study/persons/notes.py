"""Notes of the experimenter: written into a participant's newest journal between openings and after its end.

A note is a record like any other: chained, seen by the ledger, part of the seal. It moves no trial, makes no old
session fresh, and is in no table of ratings.
"""

from feel321.study.folder import StudyFolder
from feel321.study.ledger import progress, slots
from feel321.study.persons.withdrawal import hold_folder, require_entry
from feel321.study.session.events import NoteTaken
from feel321.study.session.journal import Clock, list_journals, require_journal


def take_note(study: StudyFolder, participant: str, text: str, *, now: Clock) -> str:
    """Write a note into the newest journal of a participant; returns what the experimenter should know besides."""
    note = NoteTaken(text)
    ledger, notice = slots.open_study_ledger(study, now=now)
    entry = require_entry(ledger, participant, study=study, verb="take the note")
    folder = study.sessions / participant
    if progress.read_tombstone(folder) is not None:
        raise ValueError(f"participant {participant}: withdrew, nothing is recorded any longer")
    begin = f"participant {participant}: no session has begun, so there is no journal; begin one, then add the note"
    if not list_journals(folder):
        raise ValueError(begin)
    with hold_folder(folder):
        progress.check_anchors(entry.anchors, folder)
        journal = require_journal(list_journals(folder)[-1], now=now)
        if journal.records.find_header() is None:
            raise ValueError(begin)
        journal.write(note)
        notices = [notice, journal.notice]
        try:
            slots.enter(ledger, participant, slots.make_entry(progress.read_progress(folder)))
        except (OSError, ValueError) as error:
            notices.append(f"the note is in the journal, not yet in the ledger ({error})")
    return "; ".join(filter(None, notices))
