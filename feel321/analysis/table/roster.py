"""`participants.csv` beside the ratings: labels of the participants, and rigs where they differ."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from feel321.analysis.table import notes as remarks
from feel321.analysis.table import schema

if TYPE_CHECKING:
    from pandas import DataFrame

ROSTER_FILE = "participants.csv"
RIG = {"rig": "rig", "calibration": "certificate of calibration"}
"""Columns on what the participants felt the stimuli on, and what they are in words."""
ROSTER = frozenset({
    "number", "simulated", "state", "sessions", "done", "total", "first_utc", "last_utc", "training_passed", *RIG,
})  # fmt: skip
"""Columns on the progress of a participant; all others, but for the participant's name, are labels."""


def join_labels(rows: DataFrame, ratings: Path | DataFrame) -> tuple[DataFrame, list[str]]:
    """Add a column for each label of the participants, from the table beside the ratings."""
    path = ratings.with_name(ROSTER_FILE) if isinstance(ratings, Path) else None
    if path is None or not path.is_file():
        return rows, []
    known = ROSTER | {*rows, "participant"}
    names = [name for name in schema.read_header(path) if name and name not in known]
    if not names:
        return rows, []
    columns = {"participant": schema.ColumnInfo("who", needed=True)} | dict.fromkeys(
        names, schema.ColumnInfo("a label")
    )
    sheet, _ = schema.read_sheet(path, path.name, columns)
    schema.refuse_doubled(sheet, "participant", path.name)
    labels = sheet.set_index("participant")  # without columns that are empty throughout
    joined = rows.join(labels, on="participant").fillna(dict.fromkeys(labels, ""))
    notes = []
    for name in map(str, labels):
        groups = joined.groupby(name)["participant"].nunique()
        sizes = ", ".join(
            f"{remarks.list_names([str(group)]) if group else 'unknown'} {count}"
            for group, count in groups.items()
        )
        notes.append(
            f"Participants differ in {remarks.list_names([name])} ({ROSTER_FILE}; participants: {sizes}): "
            "no test compares them."
        )
    return joined, notes


def join_rigs(rows: DataFrame, ratings: Path | DataFrame) -> tuple[DataFrame, list[str]]:
    """Add the participants' rig and certificate, from the table beside the ratings, where they differ."""
    path = ratings.with_name(ROSTER_FILE) if isinstance(ratings, Path) else None
    if path is None or not path.is_file():
        return rows, []
    header = schema.read_header(path)
    columns = {"participant": schema.ColumnInfo("who", needed=True)}
    columns |= {name: schema.ColumnInfo("a rig") for name in RIG if name in header}
    sheet, _ = schema.read_sheet(path, path.name, columns)
    sheet = sheet[sheet["participant"].isin(rows["participant"])].set_index("participant")
    notes = []
    for name in (name for name in sheet if len(sheet[name].unique()) > 1):
        rows = rows.join(sheet[name], on="participant").fillna({name: ""})
        sizes = ", ".join(
            f"{key or 'unknown'} {n}" for key, n in sheet[name].value_counts().items()
        )
        notes.append(
            f"Participants differ in {RIG[str(name)]} ({ROSTER_FILE}; participants: {sizes}): see Robustness to other "
            "choices."
        )
    return rows, notes
