"""The tables that are derived from the journals, and the report, against what they are derived from.

A table may be older than the journals: it lacks what was recorded since, and nothing else. What it holds must be what
the journals say, row by row.
"""

import csv
import html
import json
import math
from collections import defaultdict
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from feel321 import intake
from feel321.files import digest_file, list_csv
from feel321.stimuli.sets.manifest import read_stimuli
from feel321.study import matches
from feel321.study.columns import RATING_COLUMNS
from feel321.study.folder import StudyFolder
from feel321.study.people import ROSTER_FILE, list_progress, list_roster
from feel321.study.persons import answers
from feel321.study.ratings import read_judgements
from feel321.study.session.plan import TOMBSTONE_FILE

ANEW = "derive it anew: feel321 analyze"

Row = Mapping[str, str]


@dataclass(frozen=True, slots=True)
class Derived:
    """A table as the journals give it; key: columns that name a row, lagging: columns that change as a session goes on.

    skipped: participants whose journals cannot be read, which is found elsewhere.
    """

    path: Path
    rows: Sequence[Row]
    key: tuple[str, ...]
    lagging: frozenset[str] = frozenset()
    skipped: frozenset[str] = frozenset()


def audit_tables(study: StudyFolder) -> tuple[list[str], list[str]]:
    """Compare all tables and the report with the journals; returns findings and remarks."""
    if study.is_rehearsal:
        return [], []
    found = _Comparison(study)
    for derived in derive_tables(study):
        if derived.path.is_file():
            found.compare(derived)
    return [*found.findings, *_audit_page(study.report)], [*found.remarks, *_audit_inputs(study)]


def derive_tables(study: StudyFolder) -> Iterator[Derived]:
    """Derive all tables anew, in memory."""
    roster = _derive_roster(study)
    if roster is not None:
        yield roster
    if not study.participants:
        return  # Ratings may come from elsewhere.
    try:
        stimuli = read_stimuli(study.stimuli)
    except (OSError, ValueError):
        return  # found by itself
    rated = ("participant", "session", "trial", "stimulus_id", "reference_id", "scale", "other_id")
    yield _derive(
        study, (study.ratings, RATING_COLUMNS, rated), lambda own: read_judgements(own, stimuli)
    )
    asked = ("participant", "session", "question", "occasion")
    place = study.path / answers.ANSWERS_FILE
    yield _derive(study, (place, answers.COLUMNS, asked), answers.read_answers)
    matched = ("participant", "trial", "stimulus_id")
    place = study.path / matches.MATCHES_FILE
    table = place, matches.COLUMNS, matched
    yield _derive(study, table, lambda own: matches.read_matches(own, stimuli))


def _derive(
    study: StudyFolder,
    table: tuple[Path, Sequence[str], tuple[str, ...]],
    read: Callable[[Path], Iterable[Mapping[str, Any]]],
) -> Derived:
    """Derive a table: its file, columns and key; read: makes the rows of a participant's folder."""
    path, columns, key = table
    rows: list[Mapping[str, Any]] = []
    skipped = set()
    for folder in study.participants if path.is_file() else ():
        try:
            rows += list(read(folder))
        except (OSError, ValueError, LookupError, TypeError, AttributeError):
            skipped.add(folder.name)
    lagging = frozenset({"rejected"})  # a session that was begun anew is rejected from then on
    return Derived(path, _as_written(columns, rows), key, lagging, frozenset(skipped))


def _derive_roster(study: StudyFolder) -> Derived | None:
    path = study.path / ROSTER_FILE
    if not path.is_file():
        return None
    try:
        everybody = list_progress(study)
    except (OSError, ValueError, LookupError, TypeError, AttributeError):
        return None
    broken = frozenset(one.participant for one in everybody if one.problem)
    columns, rows = list_roster(everybody)
    fixed = {"participant", "number", "simulated", "first_utc", "total"}
    lagging = frozenset(columns) - fixed
    return Derived(path, _as_written(columns, rows), ("participant",), lagging, broken)


def _as_written(columns: Sequence[str], rows: Iterable[Mapping[str, Any]]) -> list[Row]:
    """Make rows what a reader of the written table gets."""
    return list(csv.DictReader(list_csv(columns, rows)))


@dataclass(frozen=True, slots=True)
class _Comparison:
    """Tables against what the journals give."""

    study: StudyFolder
    findings: list[str] = field(default_factory=list)
    remarks: list[str] = field(default_factory=list)

    def compare(self, derived: Derived) -> None:
        """Compare a table, row by row."""
        try:
            with intake.open_text(derived.path) as file:
                table = csv.DictReader(file)
                written = [(table.line_num, row) for row in table]
        except (ValueError, csv.Error) as error:
            self.findings.append(f"{derived.path}: cannot be read ({error}); {ANEW}")
            return
        left: dict[tuple[str, ...], list[Row]] = defaultdict(list)
        for row in derived.rows:
            left[_name(row, derived.key)].append(row)
        known, others = set(left), []
        for line, row in written:  # A trial that was rejected comes again, under the same number.
            same = (
                own for own in left[_name(row, derived.key)] if not _find_wrong(row, own, derived)
            )
            if (own := next(same, None)) is not None:
                left[_name(row, derived.key)].remove(own)
            elif row.get("participant") not in derived.skipped:
                others.append((line, row))
        for line, row in others:
            wrong = self._judge(row, left[_name(row, derived.key)], derived, known=known)
            remedy = "" if "restore" in wrong else f"; {ANEW}"
            self.findings.append(f"{derived.path}, line {line}: {wrong}{remedy}")
        there = {_name(row, derived.key) for _, row in written}
        self._find_missing(derived, [own for owns in left.values() for own in owns], there)

    def _judge(
        self, row: Row, own: list[Row], derived: Derived, *, known: Collection[tuple[str, ...]]
    ) -> str:
        """Say what is wrong with a row that is not as the journals give it."""
        if own:
            return _find_wrong(row, own.pop(0), derived)
        if (name := _name(row, derived.key)) in known:
            return f"{' '.join(filter(None, name))} occurs once more often than in the journals"
        return _find_nobody(self.study, row.get("participant") or "")

    def _find_missing(
        self, derived: Derived, left: Sequence[Row], there: Collection[tuple[str, ...]]
    ) -> None:
        """Find rows that are not there: those at the end may be newer, one amid others was left out."""
        last: dict[tuple[str, str], float] = defaultdict(lambda: -math.inf)
        for row in derived.rows:
            if _name(row, derived.key) in there and math.isfinite(onset := _find_onset(row)):
                last[_find_session(row)] = max(last[_find_session(row)], onset)
        late = [row for row in left if _find_onset(row) >= last[_find_session(row)]]
        for row in (row for row in left if row not in late):
            name = ", ".join(f"{k} {row[k]}" for k in derived.key if row[k])
            text = f"lacks the row of {name}, which the journals have"
            self.findings.append(f"{derived.path}: {text}; {ANEW}")
        if late:
            count = "a row" if len(late) == 1 else f"{len(late)} rows"
            self.remarks.append(
                f"{derived.path}: lacks {count} that the journals have; unless they are newer, it was edited; {ANEW}"
            )


def _find_session(row: Row) -> tuple[str, str]:
    return row["participant"], row.get("session", "")


def _find_onset(row: Row) -> float:
    """Find when a row came in its session: trials that were spoiled come again later, so their numbers do not say."""
    try:
        return float(row.get("onset_s") or math.inf)
    except ValueError:
        return math.inf


def _name(row: Row, key: Sequence[str]) -> tuple[str, ...]:
    return tuple(row.get(name) or "" for name in key)


def _find_nobody(study: StudyFolder, who: str) -> str:
    if (study.sessions / who / TOMBSTONE_FILE).is_file():
        return f"holds data of {who}, who withdrew"
    if who and (study.sessions / who).is_dir():
        return f"a row of {who} that is in no journal"
    return f"a row of {who or 'nobody'}, of whom there is no journal; restore sessions/ from a copy"


def _find_wrong(row: Row, own: Row, derived: Derived) -> str:
    """Find the first cell that the journals contradict."""
    is_old = "last_utc" in own and row.get("last_utc") != own["last_utc"]
    if is_old and (row.get("last_utc") or "") > own["last_utc"]:
        return f"last_utc is {row['last_utc']}, the journals end at {own['last_utc']}"
    is_old |= own.get("rejected") == "true" and row.get("rejected") == "false"
    for name, value in own.items():
        got = row.get(name, value)  # an earlier version wrote fewer columns
        if got != value and not (is_old and name in derived.lagging):
            return f"{name} is {got!r}, the journals say {value!r}"
    return ""


# The report.


def _audit_inputs(study: StudyFolder) -> Iterator[str]:
    """Find which files that the report was made of are other ones now."""
    content = _read_results(study.report)
    inputs = content.get("inputs", {}) if content else {}
    own = {"ratings": study.ratings, "manifest": study.manifest}
    for role, path in own.items():
        sha256 = inputs.get(f"{role}_sha256") if isinstance(inputs, dict) else None
        if (
            sha256
            and inputs.get(role) == path.name
            and path.is_file()
            and digest_file(path) != sha256
        ):
            yield (
                f"{study.report / 'results.json'}: was computed from another {path.name} than the one here; compute it "
                "anew: feel321 analyze"
            )


def _read_results(report: Path) -> dict[str, Any] | None:
    try:
        content = json.loads(intake.read_bytes(report / "results.json"))
    except (OSError, ValueError, RecursionError):
        return None
    return content if isinstance(content, dict) else None


def _audit_page(report: Path) -> Iterator[str]:
    """Compare the page with what `results.json` says: its files, and the sentences that both hold."""
    path = report / "results.json"
    if not path.is_file():
        return
    content = _read_results(report)
    if content is None:
        yield f"{path}: cannot be read; write it anew: feel321 analyze"
        return
    for name in content.get("files", ()):
        if not (report / str(name)).is_file():
            yield f"{report / str(name)}: is gone, results.json lists it; write it anew: feel321 analyze"
    page = report / "index.html"
    if page.is_file() and isinstance(headline := content.get("headline"), str):
        shown = " ".join(html.unescape(page.read_text(encoding="utf-8", errors="replace")).split())
        if " ".join(headline.split()) not in shown:
            yield f"{page}: does not show the headline of results.json; write it anew: feel321 analyze"
