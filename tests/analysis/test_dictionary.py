"""The data dictionary: every column of every CSV file that a study writes is in it, and is what it says."""

import csv
import json
import re
from pathlib import Path

import pandas as pd
import pytest

from feel321.analysis.report.folder import write_flags
from feel321.analysis.table.columns import describe_column, make_dictionary, read_dictionary
from feel321.analysis.tradeoff.measure import COLUMNS as TRADEOFF
from feel321.study.folder import LAST_PARTICIPANT_COLUMNS, PARTICIPANT_COLUMNS, RATING_COLUMNS
from feel321.study.participants.answers import COLUMNS as ANSWERS
from feel321.study.ratings import MATCH_COLUMNS as MATCHES
from feel321.types import METRIC_INFO, MetricInfo

KINDS = {
    "flag": re.compile("TRUE|FALSE"),
    "integer": re.compile(r"-?\d+(\.0+)?(e\+\d+)?"),
    "number": re.compile(r"-?(\d+(\.\d+)?(e[+-]?\d+)?|inf)"),
    "text": re.compile(".*", re.DOTALL),
}
RESERVED = {"if", "else", "repeat", "while", "function", "for", "next", "break", "in"}


def read_strictly(path: Path) -> list[dict[str, str]]:
    """Read a CSV file as R does without options: plain names, no name twice, as many cells as names."""
    text = path.read_bytes().decode("utf-8")
    assert not text.startswith("\ufeff")
    head, *rows = csv.reader(text.splitlines(), strict=True)
    assert len(set(head)) == len(head)
    for name in head:
        assert re.fullmatch(r"[A-Za-z][A-Za-z0-9_.]*", name), (path.name, name)
        assert name not in RESERVED, (path.name, name)
    assert {len(row) for row in rows} <= {len(head)}, path.name
    return [dict(zip(head, row, strict=True)) for row in rows]


def hold_to_dictionary(folder: Path) -> None:
    """Read every table of a folder, and hold each cell to the type that its column is said to have."""
    said = {(row["file"], row["column"]): row for row in read_strictly(folder / "dictionary.csv")}
    tables = {path.name: read_strictly(path) for path in sorted(folder.glob("*.csv"))}
    assert {file for file, _ in said} == set(tables)
    cells = ((file, *cell) for file, rows in tables.items() for row in rows for cell in row.items())
    for file, name, cell in cells:
        told = said[file, name]
        assert told["meaning"], f"{file}: column {name} is not explained"
        assert cell in {"", "NA"} or KINDS[told["type"]].fullmatch(cell), (file, name, cell)


def test_every_table_of_a_report_is_explained(report: Path) -> None:
    hold_to_dictionary(report / "tables")
    files = json.loads((report / "results.json").read_text(encoding="utf-8"))["files"]
    assert "tables/dictionary.csv" in files


@pytest.mark.parametrize(
    ("file", "columns"),
    [
        ("ratings.csv", RATING_COLUMNS),
        ("participants.csv", (*PARTICIPANT_COLUMNS, *LAST_PARTICIPANT_COLUMNS)),
        ("participants.csv", ("threshold_slope_low_200hz", "threshold_catch_trials_200hz")),
        ("answers.csv", ANSWERS),
        ("matches.csv", MATCHES),
        ("manifest.csv", tuple(METRIC_INFO)),
        ("tradeoff/measures.csv", TRADEOFF),
    ],
)
def test_every_declared_column_is_explained(file: str, columns: tuple[str, ...]) -> None:
    for name in columns:
        found = describe_column(file, name, pd.Series([1.0]), info={})
        assert (found.column, found.file) == (name, file.rsplit("/", 1)[-1])
        assert found.meaning, f"{file}: {name}"


def test_what_follows_from_another_column() -> None:
    low = describe_column("slopes.csv", "tenth_low", pd.Series([1.0]), info={})
    assert (
        low.meaning
        == "lower end of the 95 % interval of change of the rating per +0.1 of the metric"
    )
    assert low.unit == "points"
    own = {"ratio": MetricInfo("ratio of peaks", "worse", low=0.0, unit="dB")}
    found = describe_column("manifest.csv", "ratio", pd.Series([1.0]), info=own)
    assert (found.unit, found.allowed) == ("dB", "0 or more")
    assert found.meaning == "metric: ratio of peaks; smaller is better"
    assert describe_column("a.csv", "mine", pd.Series([True]), info={}).type == "flag"


def test_each_row_is_whole_and_occurs_once() -> None:
    rows = read_dictionary()
    assert len({(row.file, row.column) for row in rows}) == len(rows)
    assert {row.type for row in rows} == set(KINDS)
    assert all(row.meaning for row in rows)


def test_flags_are_those_of_r() -> None:
    frame = pd.DataFrame({"a": [True, False], "b": [True, None], "c": ["True", "x"], "d": [1, 0]})
    written = write_flags(frame)
    assert written.fillna("").to_dict("list") == {
        "a": ["TRUE", "FALSE"], "b": ["TRUE", ""], "c": ["True", "x"], "d": [1, 0],
    }  # fmt: skip
    assert len(make_dictionary({"a.csv": frame})) == 4 + 6
