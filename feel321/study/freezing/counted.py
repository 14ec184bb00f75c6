"""Ratings of people, counted without a look at any: in journals, and those that only ledger or table remember."""

from __future__ import annotations

from collections import Counter
from csv import DictReader
from typing import TYPE_CHECKING

from feel321 import intake
from feel321.study.freezing.record import Seen, find_first, list_times
from feel321.study.ledger.slots import read_study_ledger

if TYPE_CHECKING:
    from collections.abc import Iterator

    from feel321.study.folder import StudyFolder


def count_ratings(study: StudyFolder) -> Seen:
    """Count the ratings of real people, those too that the ledger or the table remembers and no journal holds."""
    own = find_first(study)
    others = dict(_list_remembered(study, set(list_times(study))))
    judgements = own.judgements + sum(others.values())
    return Seen(judgements, own.participants + len(others), own.first_utc)


def _list_remembered(study: StudyFolder, known: set[str]) -> Iterator[tuple[str, int]]:
    """List participants of whose ratings no journal is there: withdrawn, at another station, or removed by hand."""
    try:
        entries = read_study_ledger(study)
    except (OSError, ValueError):
        entries = []
    left = {one.participant: one.done for one in entries if one.done and not one.simulated}
    for name, count in _count_table(study).items():
        left[name] = max(count, left.get(name, 0))
    yield from ((name, count) for name, count in left.items() if name not in known)


def _count_table(study: StudyFolder) -> dict[str, int]:
    """Count the ratings of real people in the table of a study."""
    if not study.ratings.is_file():
        return {}
    with intake.open_text(study.ratings) as file:
        rows = DictReader(file)
        return Counter(row["participant"] for row in rows if row.get("simulated") == "false")
