"""The tables of a dataset and what each of their columns means."""

from __future__ import annotations

import csv
import io
import json
import math
from collections import defaultdict
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from feel321.records import to_json_value
from feel321.study.columns import RATING_COLUMNS

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from feel321.protocols.questions import Question
    from feel321.study.export.people import Person
    from feel321.types import MetricInfo

MISSING = "n/a"
"""What BIDS writes in a cell without a value."""

YES_NO = {"true": "yes", "false": "no"}
FLAGS = {"rejected", "simulated", "training_passed"}

OWN = {
    "participant_id": "participant of this dataset; numbers are unrelated to the order of participation",
    "state": "how the session ended: finished, or running if it was interrupted",
    "done": "trials judged",
    "total": "trials planned",
    "age_band": "age in years, in bands of five years; 80 or more as one",
    "rig": "rig of the sessions, numbered",
    "calibration": "certificate of calibration of the rig, numbered",
    "training_passed": "whether the training criterion was met",
}
"""Meanings of columns that the data dictionary lacks or defines differently."""

SHOWN = ("participant_id", "simulated", "state", "sessions", "done", "total")
LAST = ("training_passed", "rig", "calibration")


@dataclass(frozen=True, slots=True)
class DataSheet:
    """A table: its columns, its rows as texts, and what each column means.

    meanings: column -> what a BIDS sidecar says of it.
    """

    columns: tuple[str, ...]
    rows: tuple[Mapping[str, str], ...]
    meanings: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)

    def to_tsv(self) -> bytes:
        """Write it as BIDS does, without quotes."""
        lines = [
            self.columns,
            *([row.get(name, "") or MISSING for name in self.columns] for row in self.rows),
        ]
        for line in lines:
            if bad := next((cell for cell in line if any(one in cell for one in "\t\r\n\0")), None):
                raise ValueError(
                    f"a cell of a TSV table must hold no tab and no line feed, got {bad[:60]!r}; rename it in the study"
                )
        return "".join("\t".join(line) + "\n" for line in lines).encode()

    def to_csv(self) -> bytes:
        """Write it as CSV; a missing value is an empty cell."""
        text = io.StringIO(newline="")
        table = csv.DictWriter(
            text, self.columns, restval="", extrasaction="ignore", lineterminator="\n"
        )
        table.writeheader()
        table.writerows(self.rows)
        return text.getvalue().encode()

    def to_sidecar(self) -> dict[str, Any]:
        """Give what a sidecar says of the columns."""
        return {name: dict(self.meanings[name]) for name in self.columns if name in self.meanings}


def write_cell(value: object) -> str:
    """Write a value so that it reads back the same; NaN is a missing value."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return ""
    return repr(value) if isinstance(value, float) else str(value)


def write_json(entry: object) -> bytes:
    """Write JSON whose bytes follow from the content alone."""
    text = json.dumps(to_json_value(entry), indent=2, ensure_ascii=False, allow_nan=False)
    return f"{text}\n".encode()


def describe(
    file: str, columns: Iterable[str], info: Mapping[str, MetricInfo] | None = None
) -> dict[str, dict[str, Any]]:
    """Describe columns for a sidecar, by the data dictionary."""
    import pandas as pd

    from feel321.analysis.table.dictionary import describe_column

    empty, found = pd.Series([], dtype=object), {}
    for name in columns:
        known = describe_column(file, name, empty, info=info or {})
        entry: dict[str, Any] = {"Description": OWN.get(name, known.meaning) or f"column {name}"}
        if known.unit and name not in OWN:
            entry["Units"] = known.unit
        if name in FLAGS:
            entry["Levels"] = YES_NO
        found[name] = entry
    return found


def make_judgements(
    people: Sequence[Person], info: Mapping[str, MetricInfo]
) -> dict[tuple[str, int, str], DataSheet]:
    """Make a sheet of judgements for every participant, session and task."""
    columns = RATING_COLUMNS[1:]
    meanings = describe("ratings.csv", columns, info)
    parts: dict[tuple[str, int, str], list[dict[str, str]]] = defaultdict(list)
    for person in people:
        for row in person.rows:
            key = (person.label, int(row["session"]), str(row["protocol"]))
            parts[key].append({name: write_cell(row[name]) for name in columns})
    return {key: DataSheet(columns, tuple(rows), meanings) for key, rows in parts.items()}


def make_roster(people: Sequence[Person], renamed: Mapping[str, Mapping[str, str]]) -> DataSheet:
    """Make the sheet of participants; without days, design numbers and names of rigs."""
    factors = list(dict.fromkeys(name for one in people for name in one.progress.groups))
    measured = list(dict.fromkeys(name for one in people for name in one.progress.thresholds))
    columns = (*SHOWN, *factors, *LAST, *measured)
    rows = []
    for one in people:
        own: dict[str, Any] = {name: getattr(one.progress, name, "") for name in (*SHOWN, *LAST)}
        own |= {"participant_id": one.name, "sessions": len({row["session"] for row in one.rows})}
        own |= {name: renamed[name][own[name]] for name in renamed}
        own |= {**one.progress.groups, **one.progress.thresholds}
        rows.append({name: write_cell(own.get(name)) for name in columns})
    meanings = describe("participants.csv", columns)
    group = {"Description": "group of the participant, a factor in which participants differ"}
    return DataSheet(columns, tuple(rows), {**meanings, **dict.fromkeys(factors, group)})


def make_answers(people: Sequence[Person], questions: Sequence[Question]) -> DataSheet | None:
    """Make the sheet of answers that may be passed on, a column per question and occasion, if there are any."""
    known = {question.name: question for question in questions}
    found = sorted({name for one in people for name in one.answers}, key=_order(known))
    if not found:
        return None
    meanings: dict[str, dict[str, Any]] = describe("participants.csv", ["participant_id"])
    for name in found:
        stem = name.rpartition("_")[0]
        question = known.get(name) or known.get(stem)
        own = OWN.get(name) or OWN.get(stem)
        meanings[name] = {"Description": own or (question.question if question else name)}
        if question and question.kind == "likert":
            points = enumerate(question.options, start=1)
            meanings[name]["Levels"] = {
                str(point): text or f"point {point}" for point, text in points
            }
        elif question and question.kind == "choice":
            meanings[name]["Levels"] = {text: text for text in question.options}
    rows = tuple({"participant_id": one.name, **one.answers} for one in people)
    return DataSheet(("participant_id", *found), rows, meanings)


def _order(known: Mapping[str, Question]) -> Any:  # noqa: ANN401 - a key for sorting
    """Order columns as the questions come, then by occasion."""
    places = {name: place for place, name in enumerate(known)}

    def find(name: str) -> tuple[int, int, str]:
        stem, _, number = name.rpartition("_")
        if name in places or not number.isdigit():
            return places.get(name, -1), 0, name
        return places.get(stem, -1), int(number), name

    return find


def make_stimuli(
    header: Sequence[str], rows: Iterable[Mapping[str, str]], *, further: Mapping[str, Mapping[str, str]],
    info: Mapping[str, MetricInfo],
) -> DataSheet:  # fmt: skip
    """Make the sheet of stimuli, as the manifest has them; further: column -> value by recording."""
    added = [name for name in further if name not in header]
    columns = (*header, *added)
    full = tuple(
        {**row, **{name: further[name].get(row["recording"], "") for name in added}} for row in rows
    )
    return DataSheet(columns, full, describe("stimuli/manifest.csv", columns, info))


def list_variables(sheets: Sequence[DataSheet]) -> list[dict[str, Any]]:
    """List the columns of all data files as schema.org describes variables."""
    found: dict[str, dict[str, Any]] = {}
    for sheet in sheets:
        for name in sheet.columns:
            known = sheet.meanings.get(name, {})
            entry = {
                "@type": "PropertyValue",
                "name": name,
                "description": known.get("Description"),
            }
            units = {"unitText": known["Units"]} if "Units" in known else {}
            found.setdefault(name, {**entry, **units})
    return list(found.values())
