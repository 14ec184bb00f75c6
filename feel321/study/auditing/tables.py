"""The tables that are derived from the journals, and the report, against what they are derived from.

A table may be older than the journals: it lacks what was recorded since, and nothing else. What it holds must be what
the journals say, row by row.
"""

import csv
import html
import json
import math
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from feel321 import intake
from feel321.files import digest_file, list_csv
from feel321.stimuli.sets.manifest import read_stimuli
from feel321.study.auditing.replay import MALFORMED
from feel321.study.folder import RATING_COLUMNS, StudyFolder
from feel321.study.people import ROSTER_FILE, Progress, list_roster, read_progress
from feel321.study.persons import answers
from feel321.study.ratings import MATCH_COLUMNS, MATCHES_FILE, read_judgements, read_matches
from feel321.study.session.plan import TOMBSTONE_FILE

ANEW = "derive it anew: feel321 analyze"

Row = Mapping[str, str]


@dataclass(slots=True)
class DerivedTable:
    """A table that journals give; key: columns that name a row, read: makes the rows of a participant's folder.

    lagging: columns that change as a session goes on; skipped: participants whose files cannot be read; people: how
    far each is, of the roster, whose columns depend on all of them.
    """

    path: Path
    columns: Sequence[str]
    key: tuple[str, ...]
    read: Callable[[Path], Iterable[dict[str, Any]]]
    lagging: frozenset[str] = frozenset({"rejected"})  # a session that was begun anew is so
    rows: list[dict[str, Any]] = field(default_factory=list)
    skipped: set[str] = field(default_factory=set)
    people: list[Progress] = field(default_factory=list)

    def take(self, folder: Path) -> None:
        """Take the rows of a participant; what cannot be read is among the findings already."""
        try:
            self.rows += self.read(folder)
        except (*MALFORMED, OSError, ValueError):
            self.skipped.add(folder.name)


def list_tables(study: StudyFolder) -> list[DerivedTable]:
    """List the tables that are there; ratings may come from elsewhere where nobody takes part."""
    people: list[Progress] = []
    roster = DerivedTable(
        study.path / ROSTER_FILE, (), ("participant",), partial(_note_progress, people)
    )
    roster.people = people
    tables = [roster]
    with suppress(OSError, ValueError):  # of a set that is among the findings
        stimuli = read_stimuli(study.stimuli)
        rated = (
            "participant",
            "session",
            "trial",
            "stimulus_id",
            "reference_id",
            "scale",
            "other_id",
        )
        asked = ("participant", "session", "question", "occasion")
        answered, matched = study.path / answers.ANSWERS_FILE, study.path / MATCHES_FILE
        tables += [
            DerivedTable(
                study.ratings, RATING_COLUMNS, rated, partial(read_judgements, stimuli=stimuli)
            ),
            DerivedTable(answered, answers.COLUMNS, asked, answers.read_answers),
            DerivedTable(
                matched,
                MATCH_COLUMNS,
                ("participant", "trial", "stimulus_id"),
                partial(read_matches, stimuli=stimuli),
            ),
        ]
    is_compared = not study.is_rehearsal
    there = [table for table in tables if is_compared and table.path.is_file()]
    return there if study.participants else [one for one in there if one.path.name == ROSTER_FILE]


def _note_progress(people: list[Progress], folder: Path) -> Iterable[dict[str, Any]]:
    if not (folder / TOMBSTONE_FILE).exists():
        progress = read_progress(folder)
        if progress.problem:
            raise ValueError(progress.problem)
        people.append(progress)
    return ()


def compare_tables(
    study: StudyFolder, tables: Sequence[DerivedTable]
) -> tuple[list[str], list[str]]:
    """Compare all tables and the report with the journals; returns findings and remarks."""
    findings: list[str] = []
    remarks: list[str] = []
    if study.is_rehearsal:
        return findings, remarks
    for table in tables:
        if table.path.name == ROSTER_FILE:
            table.columns, table.rows = list_roster(table.people)
            fixed = {"participant", "number", "simulated", "first_utc", "total"}
            table.lagging = frozenset(table.columns) - fixed
        _Comparison(study, table, findings, remarks).compare()
    return [*findings, *_audit_page(study.report)], [*remarks, *_audit_inputs(study)]


@dataclass(frozen=True, slots=True)
class _Comparison:
    """A table against what the journals give."""

    study: StudyFolder
    table: DerivedTable
    findings: list[str]
    remarks: list[str]

    def compare(self) -> None:
        """Compare row by row; a trial that was rejected comes again, under the same number."""
        path = self.table.path
        try:
            with intake.open_text(path) as file:
                table = csv.DictReader(file)
                written = [(table.line_num, row) for row in table]
        except (ValueError, csv.Error) as error:
            self.findings.append(f"{path}: cannot be read ({error}); {ANEW}")
            return
        derived = list(csv.DictReader(list_csv(self.table.columns, self.table.rows)))
        left: dict[tuple[str, ...], list[Row]] = defaultdict(list)
        for row in derived:
            left[self._name(row)].append(row)
        known, others = set(left), []
        for line, row in written:
            own = left[self._name(row)]
            same = next((one for one in own if not self._find_wrong(row, one)), None)
            if same is not None:
                own.remove(same)
            elif row.get("participant") not in self.table.skipped:
                others.append((line, row))
        for line, row in others:
            own, is_known = left[self._name(row)], self._name(row) in known
            self.findings.append(f"{path}, line {line}: {self._judge(row, own, is_known=is_known)}")
        there = {self._name(row) for _, row in written}
        self._find_missing([one for own in left.values() for one in own], derived, there)

    def _name(self, row: Row) -> tuple[str, ...]:
        return tuple(row.get(name) or "" for name in self.table.key)

    def _find_wrong(self, row: Row, own: Row) -> str:
        """Find the first cell that the journals contradict."""
        got, last = row.get("last_utc") or "", own.get("last_utc", "")
        if got > last:
            return f"last_utc is {got}, the journals end at {last}"
        is_old = got < last or (own.get("rejected"), row.get("rejected")) == ("true", "false")
        for name, value in own.items():
            got = row.get(name, value)  # an earlier version wrote fewer columns
            if got != value and not (is_old and name in self.table.lagging):
                return f"{name} is {got!r}, the journals say {value!r}"
        return ""

    def _judge(self, row: Row, own: list[Row], *, is_known: bool) -> str:
        """Say what is wrong with a row that is not as the journals give it."""
        who = row.get("participant") or ""
        if own:
            return f"{self._find_wrong(row, own.pop(0))}; {ANEW}"
        if is_known:
            name = " ".join(filter(None, self._name(row)))
            return f"{name} occurs once more often than in the journals; {ANEW}"
        if (self.study.sessions / who / TOMBSTONE_FILE).is_file():
            return f"holds data of {who}, who withdrew; {ANEW}"
        if who and (self.study.sessions / who).is_dir():
            return f"a row of {who} that is in no journal; {ANEW}"
        return f"a row of {who or 'nobody'}, of whom there is no journal; restore sessions/ from a copy"

    def _find_missing(
        self, left: Sequence[Row], derived: Sequence[Row], there: set[tuple[str, ...]]
    ) -> None:
        """Find rows that are not there: those at the end may be newer, one amid others was left out."""
        last: dict[tuple[str, str], float] = defaultdict(lambda: -math.inf)
        for row in derived:
            if self._name(row) in there and math.isfinite(onset := _find_onset(row)):
                last[_find_session(row)] = max(last[_find_session(row)], onset)
        n_late = 0
        for row in left:
            if _find_onset(row) >= last[_find_session(row)]:
                n_late += 1
                continue
            name = ", ".join(f"{k} {row[k]}" for k in self.table.key if row[k])
            text = f"lacks the row of {name}, which the journals have"
            self.findings.append(f"{self.table.path}: {text}; {ANEW}")
        if n_late:
            count = "a row" if n_late == 1 else f"{n_late} rows"
            text = f"lacks {count} that the journals have; unless they are newer, it was edited"
            self.remarks.append(f"{self.table.path}: {text}; {ANEW}")


def _find_session(row: Row) -> tuple[str, str]:
    return row["participant"], row.get("session", "")


def _find_onset(row: Row) -> float:
    """Find when a row came in its session: trials that were spoiled come again later, so their numbers do not say."""
    try:
        return float(row.get("onset_s") or math.inf)
    except ValueError:
        return math.inf


# The report.


def _read_results(report: Path) -> dict[str, Any] | None:
    try:
        content = json.loads(intake.read_bytes(report / "results.json"))
    except (OSError, ValueError, RecursionError):
        return None
    return content if isinstance(content, dict) else None


def _audit_inputs(study: StudyFolder) -> Iterator[str]:
    """Find which files that the report was made of are other ones now."""
    inputs = (_read_results(study.report) or {}).get("inputs")
    for role, path in {"ratings": study.ratings, "manifest": study.manifest}.items():
        if not isinstance(inputs, dict) or inputs.get(role) != path.name or not path.is_file():
            continue
        if (sha256 := inputs.get(f"{role}_sha256")) and digest_file(path) != sha256:
            text = f"was computed from another {path.name} than the one here"
            yield f"{study.report / 'results.json'}: {text}; compute it anew: feel321 analyze"


def _audit_page(report: Path) -> Iterator[str]:
    """Compare the page with what `results.json` says: its files, and the sentences that both hold."""
    path, page, anew = (
        report / "results.json",
        report / "index.html",
        "write it anew: feel321 analyze",
    )
    if not path.is_file():
        return
    content = _read_results(report)
    files = [] if content is None else content.get("files", [])
    if content is None or not isinstance(files, list):
        yield f"{path}: cannot be read; {anew}"
        return
    for name in files:
        if not (report / str(name)).is_file():
            yield f"{report / str(name)}: is gone, results.json lists it; {anew}"
    if page.is_file() and isinstance(headline := content.get("headline"), str):
        shown = " ".join(html.unescape(page.read_text(encoding="utf-8", errors="replace")).split())
        if " ".join(headline.split()) not in shown:
            yield f"{page}: does not show the headline of results.json; {anew}"
