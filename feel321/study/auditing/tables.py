"""The tables that are derived from the journals, against the journals, and whether the report was made of them.

A table may be older than the journals: it lacks what was recorded since, and nothing else. What it holds must be what
the journals say, row by row.
"""

from __future__ import annotations

import csv
import json
import math
from collections import defaultdict
from collections.abc import Mapping
from itertools import chain
from typing import TYPE_CHECKING, Any, NamedTuple

from feel321 import intake
from feel321.files import digest_file, list_csv
from feel321.study.folder import RATING_COLUMNS
from feel321.study.people import ROSTER_FILE, Progress, list_roster, make_progress
from feel321.study.persons import answers
from feel321.study.ratings import MATCH_COLUMNS, MATCHES_FILE, list_judgements, list_matches
from feel321.study.session.plan import TOMBSTONE_FILE

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from feel321.stimuli.sets.manifest import StimulusSet
    from feel321.study.folder import StudyFolder
    from feel321.study.session.plan import Dossier

Row = Mapping[str, str]

ANEW = "derive it anew: feel321 analyze"

RATED = ("participant", "session", "trial", "stimulus_id", "reference_id", "scale", "other_id")
ASKED = ("participant", "session", "question", "occasion")

FIXED = {"participant", "number", "simulated", "first_utc", "total"}
"""Columns of the roster that do not change as a session goes on."""


class Derived(NamedTuple):
    """What a table should hold; key: columns that name a row; lagging: columns that change as a session goes on."""

    path: Path
    columns: Sequence[str]
    key: tuple[str, ...]
    rows: list[dict[str, Any]]
    lagging: frozenset[str] = frozenset({"rejected"})  # a session that was begun anew is so

    def name(self, row: Row) -> tuple[str, ...]:
        """Name a row by its key."""
        return tuple(row.get(one) or "" for one in self.key)

    def describe(self, row: Row) -> str:
        """Describe a row that is not there."""
        label = ", ".join(f"{one} {row[one]}" for one in self.key if row[one])
        return f"the row of {label}, which the journals have"


class Tables:
    """The tables of a study; unread: participants whose files cannot be read, which is among the findings."""

    def __init__(self, study: StudyFolder, stimuli: StimulusSet | None) -> None:
        self._study, self._stimuli = study, stimuli
        self._people = list[Progress]()
        self._rows: dict[str, list[dict[str, Any]]] = defaultdict(list)
        self.unread = set[str]()

    def take(self, dossier: Dossier) -> None:
        """Derive the rows of a participant."""
        self._people.append(make_progress(dossier))
        if self._stimuli:
            self._rows["rated"] += list_judgements(dossier, self._stimuli)
            self._rows["matched"] += list_matches(dossier, self._stimuli)
            self._rows["asked"] += answers.list_answers(dossier)

    def compare(self) -> tuple[list[str], list[str]]:
        """Compare all tables that are there with the journals; returns findings and remarks."""
        findings: list[str] = []
        remarks: list[str] = []
        study, rows = self._study, self._rows
        columns, people = list_roster(self._people)
        roster = study.path / ROSTER_FILE
        tables = [Derived(roster, columns, ("participant",), people, frozenset(columns) - FIXED)]
        if self._stimuli and study.participants:  # without, ratings may come from elsewhere
            asked, matched = study.path / answers.ANSWERS_FILE, study.path / MATCHES_FILE
            tables += [
                Derived(study.ratings, RATING_COLUMNS, RATED, rows["rated"]),
                Derived(asked, answers.COLUMNS, ASKED, rows["asked"]),
                Derived(
                    matched, MATCH_COLUMNS, ("participant", "trial", "stimulus_id"), rows["matched"]
                ),
            ]
        for table in tables:
            if study.is_rehearsal or not table.path.is_file():
                continue
            derived = list(list_csv(table.columns, table.rows))
            if table.path.read_bytes() == "".join(derived).encode():
                continue
            try:
                with intake.open_text(table.path) as file:
                    reader = csv.DictReader(file)
                    written = [(reader.line_num, row) for row in reader]
            except (ValueError, csv.Error) as error:
                findings.append(f"{table.path}: cannot be read ({error}); {ANEW}")
                continue
            findings += self._compare(
                table, list(csv.DictReader(derived)), written, remarks=remarks
            )
        return findings, remarks

    def _compare(
        self,
        table: Derived,
        derived: Sequence[Row],
        written: Sequence[tuple[int, Row]],
        *,
        remarks: list[str],
    ) -> Iterator[str]:
        """Compare row by row; a trial that was rejected comes again, under the same number."""
        left: dict[tuple[str, ...], list[Row]] = defaultdict(list)
        for row in derived:
            left[table.name(row)].append(row)
        known, others = set(left), []
        for line, row in written:
            own = left[table.name(row)]
            same = next((one for one in own if not _find_wrong(row, one, table.lagging)), None)
            if same is not None:
                own.remove(same)
            elif row.get("participant") not in self.unread:
                others.append((line, row))
        for line, row in others:
            if own := left[table.name(row)]:
                text = _find_wrong(row, own.pop(0), table.lagging)
            else:
                text = self._judge_stranger(table.name(row), is_known=table.name(row) in known)
            yield f"{table.path}, line {line}: {text}; {ANEW}"
        missing, there = [*chain.from_iterable(left.values())], {table.name(r) for _, r in written}
        amid = _find_amid(missing, [row for row in derived if table.name(row) in there])
        yield from (f"{table.path}: lacks {table.describe(one)}; {ANEW}" for one in amid)
        if late := len(missing) - len(amid):
            count = "a row" if late == 1 else f"{late} rows"
            text = f"lacks {count} that the journals have; unless they are newer, it was edited"
            remarks.append(f"{table.path}: {text}; {ANEW}")

    def _judge_stranger(self, name: tuple[str, ...], *, is_known: bool) -> str:
        who, folder = name[0], self._study.sessions / name[0]
        if is_known:
            return f"{' '.join(filter(None, name))} occurs once more often than in the journals"
        if (folder / TOMBSTONE_FILE).is_file():
            return f"holds data of {who}, who withdrew"
        if who and folder.is_dir():
            return f"a row of {who} that is in no journal"
        return f"a row of {who or 'nobody'}, of whom there is no journal; restore sessions/ from a copy, or"


def _find_wrong(row: Row, own: Row, lagging: frozenset[str]) -> str:
    """Find the first cell that the journals contradict."""
    got, last = row.get("last_utc") or "", own.get("last_utc", "")
    if got > last:
        return f"last_utc is {got}, the journals end at {last}"
    is_old = got < last or (own.get("rejected"), row.get("rejected")) == ("true", "false")
    for name, value in own.items():
        if (got := row.get(name, "")) != value and not (is_old and name in lagging):
            return f"{name} is {got!r}, the journals say {value!r}"
    return ""


def _find_amid(missing: Sequence[Row], present: Sequence[Row]) -> list[Row]:
    """Find rows that were left out amid others; those at the end of a session may be newer than the table."""

    def place(row: Row) -> tuple[tuple[str, str], float]:
        # Trials that were spoiled come again later, so their numbers do not say when.
        session = row["participant"], row.get("session", "")
        try:
            return session, float(row.get("onset_s") or math.inf)
        except ValueError:
            return session, math.inf

    last: dict[tuple[str, str], float] = defaultdict(lambda: -math.inf)
    for session, onset in map(place, present):
        if math.isfinite(onset):
            last[session] = max(last[session], onset)
    return [row for row in missing if place(row)[1] < last[place(row)[0]]]


def audit_inputs(study: StudyFolder) -> Iterator[str]:
    """Find which files that the report was made of are other ones now."""
    path = study.report / "results.json"
    try:
        inputs = json.loads(intake.read_bytes(path))["inputs"]
        made = {inputs[role]: inputs[f"{role}_sha256"] for role in ("ratings", "manifest")}
    except (OSError, ValueError, LookupError, TypeError, RecursionError):
        return
    for own in (study.ratings, study.manifest):
        if own.is_file() and made.get(own.name, "") not in {"", digest_file(own)}:
            text = f"was computed from another {own.name} than the one here"
            yield f"{path}: {text}; compute it anew: feel321 analyze"
