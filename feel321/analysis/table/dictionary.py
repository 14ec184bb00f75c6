"""The data dictionary: type, unit, allowed values and meaning of every column of every CSV file.

`dictionary.csv` beside this module is the only list: its ``file`` is a pattern, and a row for one file goes before one
for all. Ends of intervals and tests (``slope_low``, ``slope_p``) follow from the column they belong to, metrics from
what they declare.
"""

from __future__ import annotations

import csv
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from fnmatch import fnmatch
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

from feel321.analysis.table.metrics import FURTHER, ROTATIONS, format_bounds
from feel321.types import METRIC_INFO, MetricInfo

if TYPE_CHECKING:
    from pandas import DataFrame, Series

DICTIONARY = "dictionary.csv"  # The file beside the tables that it describes
DERIVED: Mapping[str, tuple[str, str]] = {
    "low": ("lower end of the 95 % interval of {}", ""),
    "high": ("upper end of the 95 % interval of {}", ""),
    "se": ("standard error of {}", "0 or more"),
    "df": ("degrees of freedom of {}", "above 0"),
    "t": ("t statistic of {}", ""),
    "p": ("p of {}", "0 to 1"),
    "w": ("{} within recordings: less the mean over its recording's stimuli", ""),
    "b": ("{} between recordings: the mean over its recording's stimuli", ""),
    "step": ("{} within recordings, in steps (see slopes.csv)", ""),
}
"""Suffix of a column -> meaning of what stands for the rest of its name, and what is allowed."""

UNITLESS = {"df", "t", "p", "step"}


@dataclass(frozen=True, slots=True)
class Variable:
    """A column of a file, as the dictionary describes it."""

    file: str
    column: str
    type: str
    unit: str = ""
    allowed: str = ""
    meaning: str = ""


@cache
def read_dictionary() -> tuple[Variable, ...]:
    """Read the list; rows for one file first."""
    with Path(__file__).with_name(DICTIONARY).open(encoding="utf-8", newline="") as file:
        rows = [Variable(**row) for row in csv.DictReader(file)]
    rows.sort(key=lambda row: ("*" in row.column, row.file == "*", "*" in row.file))
    return tuple(rows)


def make_dictionary(
    tables: Mapping[str, DataFrame], info: Mapping[str, MetricInfo] | None = None
) -> DataFrame:
    """Describe the columns of tables by file, such as ``tradeoff/points.csv``; info: what further metrics declare."""
    import pandas as pd

    itself = pd.DataFrame([asdict(read_dictionary()[0])])
    rows = [
        describe_column(file, str(name), frame[name], info=info or {})
        for file, frame in {**tables, DICTIONARY: itself}.items()
        for name in frame
    ]
    return pd.DataFrame([asdict(row) for row in rows])


def describe_column(
    file: str, column: str, values: Series, *, info: Mapping[str, MetricInfo]
) -> Variable:
    """Describe a column; one that nothing is known of has no meaning, and the type of its values."""
    from pandas.api.types import is_bool_dtype, is_integer_dtype, is_numeric_dtype

    kinds = {"flag": is_bool_dtype, "integer": is_integer_dtype, "number": is_numeric_dtype}
    kind = next((name for name, is_kind in kinds.items() if is_kind(values)), "text")
    found = next(_find(file, column, info), Variable(file, column, kind))
    return replace(found, file=file.rsplit("/", 1)[-1], column=column)


@cache
def _read_rows(file: str) -> tuple[Variable, ...]:
    """Read the list's rows for a file."""
    names = (file, file.rsplit("/", 1)[-1])
    return tuple(row for row in read_dictionary() if any(fnmatch(one, row.file) for one in names))


def _find(file: str, column: str, info: Mapping[str, MetricInfo]) -> Iterator[Variable]:
    yield from (row for row in _read_rows(file) if fnmatch(column, row.column))
    if one := {**METRIC_INFO, **ROTATIONS, **info}.get(column):
        better = "larger is better" if one.higher == "better" else "smaller is better"
        told = f"metric: {one.label}; {better}"
        yield Variable(file, column, "number", one.unit, format_bounds(one), told)
    if column in FURTHER:
        yield Variable(file, column, "number", meaning=f"metric: {FURTHER[column]}")
    base, _, end = column.rpartition("_")
    for one_of in _find(file, base, info) if end in DERIVED else ():
        meaning, allowed = DERIVED[end]
        told = meaning.format(one_of.meaning.split(":")[-1].split(";")[0].strip() or base)
        unit = "" if end in UNITLESS else one_of.unit
        yield Variable(file, column, "number", unit, allowed, told)
