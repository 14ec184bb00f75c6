"""The tables that are derived from the journals, against the journals.

A table may be older than the journals: it lacks what was recorded since, and nothing else. What it holds must be what
the journals say, row by row.
"""

from __future__ import annotations

import csv
import math
from collections import defaultdict
from collections.abc import Mapping, Sequence
from itertools import chain
from typing import TYPE_CHECKING, Any

from feel321 import intake
from feel321.files import list_csv
from feel321.study.folder import RATING_COLUMNS
from feel321.study.people import ROSTER_FILE, Progress, list_roster, make_progress
from feel321.study.persons import answers
from feel321.study.ratings import MATCH_COLUMNS, MATCHES_FILE, list_judgements, list_matches

if TYPE_CHECKING:
    from feel321.stimuli.sets.manifest import StimulusSet
    from feel321.study.folder import StudyFolder
    from feel321.study.session.plan import Dossier

Row = Mapping[str, str]

ANEW = "derive it anew: feel321 analyze"

KEYS = {
    ROSTER_FILE: ("participant",),
    "ratings.csv": ("participant", "session", "trial", "stimulus_id", "reference_id", "scale", "other_id"),
    answers.ANSWERS_FILE: ("participant", "session", "question", "occasion"),
    MATCHES_FILE: ("participant", "trial", "stimulus_id"),
}  # fmt: skip
"""Columns that name a row."""

COLUMNS: Mapping[str, Sequence[str]] = {
    "ratings.csv": RATING_COLUMNS, MATCHES_FILE: MATCH_COLUMNS, answers.ANSWERS_FILE: answers.COLUMNS,
}  # fmt: skip

FIXED = {"participant", "number", "simulated", "first_utc", "total"}
"""Columns of the roster that do not change as a session goes on."""


class Tables:
    """The tables of a study, derived anew; unread: participants whose files cannot be read, among the findings."""

    def __init__(self, study: StudyFolder, stimuli: StimulusSet | None) -> None:
        self.study, self.stimuli = study, stimuli
        self.people, self.unread = list[Progress](), set[str]()
        self._rows: dict[str, list[dict[str, Any]]] = {}
        if stimuli and study.participants:  # without, ratings may come from elsewhere
            self._rows = {name: [] for name in COLUMNS}

    def take(self, dossier: Dossier) -> None:
        """Derive the rows of a participant, all or none."""
        own: dict[str, list[dict[str, Any]]] = {}
        if self.stimuli:
            own["ratings.csv"] = list_judgements(dossier, self.stimuli)
            own[MATCHES_FILE] = [*list_matches(dossier, self.stimuli)]
            own[answers.ANSWERS_FILE] = answers.list_answers(dossier)
        self.people.append(make_progress(dossier))
        for name, rows in own.items():
            self._rows[name] += rows

    def compare(self) -> tuple[list[str], list[str]]:
        """Compare all tables that are there with the journals; returns findings and remarks."""
        findings, remarks = list[str](), list[str]()
        columns, roster = list_roster(self.people)
        for name, rows in {ROSTER_FILE: roster, **self._rows}.items():
            path = self.study.path / name
            lines = [*list_csv(COLUMNS.get(name, columns), rows)]
            if not path.is_file() or path.read_bytes() == "".join(lines).encode():
                continue
            try:
                with intake.open_text(path) as file:
                    reader = csv.DictReader(file)
                    written = [(reader.line_num, row) for row in reader]
            except (ValueError, csv.Error) as error:
                findings.append(f"{path}: cannot be read ({error}); {ANEW}")
                continue
            # What changes as a session goes on; one that was begun anew is rejected as a whole.
            lagging = {*columns} - FIXED if name == ROSTER_FILE else {"rejected"}
            kept = [one for one in written if one[1].get("participant") not in self.unread]
            wrong, late = _compare([*csv.DictReader(lines)], kept, key=KEYS[name], lagging=lagging)
            findings += [f"{path}{text}; {ANEW}" for text in wrong]
            if late:
                text = f"lacks rows that the journals have ({late}); unless they are newer, it was edited"
                remarks.append(f"{path}: {text}; {ANEW}")
        return findings, remarks


def _compare(
    derived: Sequence[Row],
    written: Sequence[tuple[int, Row]],
    *,
    key: Sequence[str],
    lagging: set[str],
) -> tuple[list[str], int]:
    """Compare row by row; returns what is wrong, and how many rows are missing at the end."""

    def name(row: Row) -> tuple[str, ...]:
        return tuple(row.get(one) or "" for one in key)

    left: dict[tuple[str, ...], list[Row]] = defaultdict(list)
    for row in derived:  # a trial that was rejected comes again, under the same number
        left[name(row)].append(row)
    others, wrong = [], []
    for line, row in written:
        same = next((one for one in left[name(row)] if not _find_wrong(row, one, lagging)), None)
        if same is None:
            others.append((line, row))
        else:
            left[name(row)].remove(same)
    for line, row in others:
        text = f"holds a row of {row.get('participant') or 'nobody'} that the journals do not have"
        if own := left[name(row)]:
            text = _find_wrong(row, own.pop(0), lagging)
        wrong.append(f", line {line}: {text}")
    missing, there = [*chain.from_iterable(left.values())], {name(row) for _, row in written}
    amid = _find_amid(missing, [row for row in derived if name(row) in there])
    for row in amid:
        label = ", ".join(f"{one} {row[one]}" for one in key if row[one])
        wrong.append(f": lacks the row of {label}, which the journals have")
    return wrong, len(missing) - len(amid)


def _find_amid(missing: Sequence[Row], present: Sequence[Row]) -> list[Row]:
    """Find rows that were left out amid others; those at the end of a session may be newer than the table."""

    def place(row: Row) -> tuple[tuple[str, str], float]:
        # Trials that were spoiled come again later, so their numbers do not say when.
        return (row["participant"], row.get("session", "")), float(row.get("onset_s") or math.inf)

    last: dict[tuple[str, str], float] = defaultdict(lambda: -math.inf)
    for session, onset in map(place, present):
        if math.isfinite(onset):
            last[session] = max(last[session], onset)
    return [row for row in missing if place(row)[1] < last[place(row)[0]]]


def _find_wrong(row: Row, own: Row, lagging: set[str]) -> str:
    """Find the first cell that the journals contradict."""
    got, last = row.get("last_utc") or "", own.get("last_utc", "")
    if got > last:
        return f"last_utc is {got}, the journals {f'end at {last}' if last else 'that are left hold nothing'}"
    is_old = got < last or (own.get("rejected"), row.get("rejected")) == ("true", "false")
    for name, value in own.items():
        if (got := row.get(name, "")) != value and not (is_old and name in lagging):
            return f"{name} is {got!r}, the journals say {value!r}"
    return ""
