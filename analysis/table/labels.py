"""Groups of participants: what `participants.csv`, beside the ratings, says of who judged.

A study whose participants differ, in how they hold the tool for example, writes that table with a column for each such
factor. Its columns become columns of the judgements; no test compares groups of people.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from analysis.table.csvfile import read_header
from analysis.table.gaps import list_names
from analysis.table.schema import Column
from analysis.table.sheet import read_sheet, refuse_lines

if TYPE_CHECKING:
    from pathlib import Path

    from pandas import DataFrame

ROSTER_FILE = "participants.csv"
ROSTER = frozenset({
    "number",
    "simulated",
    "state",
    "sessions",
    "done",
    "total",
    "first_utc",
    "last_utc",
    "training_passed",
})
"""Columns that tell how far a participant has come; all others, but for the participant's name, are labels."""


def join_labels(rows: DataFrame, ratings_path: Path) -> tuple[DataFrame, list[str]]:
    """Add a column for each label of the participants.

    Parameters
    ----------
    rows : DataFrame
        Judgements: participant.
    ratings_path : Path
        Where they come from; the labels stand in ``participants.csv`` beside it, or nowhere.

    Returns
    -------
    rows : DataFrame
        The same, and a column per label; empty for participants that the other table does not list.
    notes : list of str
        Which labels there are, and how many participants have which.

    Raises
    ------
    ValueError
        If a participant is listed twice.
    """
    path = ratings_path.with_name(ROSTER_FILE)
    names = _list_labels(path, rows) if path.is_file() else []
    if not names:
        return rows, []
    schema = {"participant": Column("who", needed=True), **{name: Column("a label") for name in names}}
    sheet, _ = read_sheet(path, schema)
    doubled = sheet.loc[sheet["participant"].duplicated(), "participant"]
    refuse_lines(doubled, path.name, why="in column 'participant', but an earlier line lists it already; keep one")
    labels = sheet.set_index("participant")
    joined = rows.join(labels, on="participant").fillna(dict.fromkeys(labels, ""))
    return joined, [_tell_groups(joined, name) for name in names]


def _list_labels(path: Path, rows: DataFrame) -> list[str]:
    header = read_header(path)
    return [name for name in header if name and name not in ROSTER | {*rows, "participant"}]


def _tell_groups(rows: DataFrame, name: str) -> str:
    groups = rows.groupby(name)["participant"].nunique()
    told = ", ".join(f"{list_names([str(group)]) if group else 'unknown'} {count}" for group, count in groups.items())
    return f"Participants differ in {list_names([name])} ({ROSTER_FILE}; participants: {told}): no test compares them."
