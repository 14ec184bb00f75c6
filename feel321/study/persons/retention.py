"""How long data are kept: what is due by `[data]` of the settings, and personal answers that go before the rest.

Nothing is removed by itself: what is due is said, and goes when somebody asks for it.
"""

from __future__ import annotations

from calendar import monthrange
from dataclasses import dataclass
from datetime import date, datetime
from typing import TYPE_CHECKING

from feel321.files import sweep, sync_folder
from feel321.study.ledger import progress, slots
from feel321.study.persons import vault
from feel321.study.persons.answers import ANSWERS_FILE, write_answers
from feel321.study.persons.withdrawal import hold_folder, require_entry
from feel321.study.session import events, journal
from feel321.study.session.plan import TOMBSTONE_FILE

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from feel321.study.folder import StudyFolder
    from feel321.study.settings.schema import DataTable


@dataclass(frozen=True, slots=True)
class DueData:
    """What is kept longer than the settings say: whose, "all" data or "personal" answers, and since which day."""

    participant: str
    what: str
    since: str

    def describe(self) -> str:
        """Describe it in a line."""
        named = {"all": "all data", "personal": "personal answers"}[self.what]
        return f"participant {self.participant}: {named} due for removal since {self.since}"


def find_due(study: StudyFolder, table: DataTable, *, today: date) -> list[DueData]:
    """Find what is kept longer than the settings say; those who withdrew have nothing left."""
    people = [one for one in study.participants if not (one / TOMBSTONE_FILE).exists()]
    if table.keep_until and date.fromisoformat(table.keep_until) < today:
        return [DueData(one.name, "all", table.keep_until) for one in people]
    if table.keep_personal_months is None:
        return []
    found = []
    for folder in people:
        last = _find_last_day(folder) if _has_personal(folder) else None
        if last and (day := add_months(last, table.keep_personal_months)) <= today:
            found.append(DueData(folder.name, "personal", day.isoformat()))
    return found


def list_due(study: StudyFolder, *, today: date) -> list[DueData]:
    """Find what is due by the study's own settings."""
    from feel321.study.settings.read import read_settings

    return find_due(study, read_settings(study.settings).data, today=today)


def describe_due(study: StudyFolder, *, today: date) -> Iterator[str]:
    """Describe what is due, and what to do; nothing where nothing is, or where journals cannot be read."""
    try:
        due = list_due(study, today=today)
    except (OSError, ValueError):
        return  # found by whoever reads settings and journals for their own sake
    yield from (one.describe() for one in due)
    if due:
        yield f"remove what is due: feel321 withdraw {study.path} --due"


def add_months(day: date, months: int) -> date:
    """Add months to a day; the last day of a shorter month stands for those that it has not.

    Examples
    --------
    >>> add_months(date(2027, 1, 31), 1)
    datetime.date(2027, 2, 28)
    """
    year, month = divmod(day.year * 12 + day.month - 1 + months, 12)
    return date(year, month + 1, min(day.day, monthrange(year, month + 1)[1]))


def _has_personal(folder: Path) -> bool:
    return (folder / vault.PERSONAL_FILE).exists() or any(_list_in_journals(folder))


def _find_last_day(folder: Path) -> date | None:
    """Find the day of the last record that is not a note."""
    notes = {events.NoteTaken.event, events.PersonalRemoved.event}
    times = [
        record.utc
        for path in journal.list_journals(folder)
        for record in journal.read_journal(path).records
        if record.event not in notes
    ]
    return datetime.fromisoformat(max(times)).date() if times else None


def _list_in_journals(folder: Path) -> Iterator[str]:
    """List personal answers that lie in the journals themselves, as earlier versions wrote them."""
    for path in journal.list_journals(folder):
        for one in journal.read_journal(path).records.find(events.QuestionAnswered):
            if one.personal and not one.sha256 and one.value is not None:
                yield f"{path.name}: {one.question}"


def remove_personal(study: StudyFolder, participant: str, *, now: journal.Clock) -> list[str]:
    """Remove the personal answers of a participant and leave the ratings; the newest journal records it.

    Returns the questions. The record comes first: where a kill comes between, `audit` names the file, and the same call
    finishes.
    """
    ledger, _ = slots.open_study_ledger(study, now=now)
    entry = require_entry(ledger, participant, study=study, verb="withdraw")
    folder = study.sessions / participant
    if (folder / TOMBSTONE_FILE).exists():
        raise ValueError(f"participant {participant}: withdrew, all data are gone")
    if old := next(_list_in_journals(folder), ""):
        raise ValueError(
            f"{folder}/{old}: lies in the journal, where an earlier version kept it, and cannot be taken out of its "
            "chain; to remove all data of the participant: feel321 withdraw without --personal"
        )
    path = folder / vault.PERSONAL_FILE
    if not path.exists() and not path.is_symlink():
        raise ValueError(
            f"participant {participant}: no personal answers are kept; nothing to remove"
        )
    with hold_folder(folder):
        progress.check_anchors(entry.anchors, folder)
        asked = _record_removal(folder, now=now)
        sweep(folder)
        path.unlink()
        sync_folder(folder)
        slots.enter(ledger, participant, slots.make_entry(progress.read_progress(folder)))
    if (study.path / ANSWERS_FILE).exists():
        write_answers(study)
    return asked


def _record_removal(folder: Path, *, now: journal.Clock) -> list[str]:
    paths = journal.list_journals(folder)
    newest = journal.require_journal(paths[-1], now=now)
    records = [one for path in paths for one in journal.read_journal(path).records]
    answered = journal.Records(records).find(events.QuestionAnswered)
    gone = vault.list_removed(folder)
    asked = [one for one in answered if one.sha256 and one.sha256 not in gone]
    names = list(dict.fromkeys(one.question for one in asked))
    if asked:
        newest.write(events.PersonalRemoved(f"personal answers were removed: {', '.join(names)}"))
    return names
