"""Recordings in text tables (CSV, TSV, TXT): separators, header, samples.

Strict UTF-8, a sniffed delimiter, numbers by pandas, and the line of whatever is wrong.
"""

import csv
import io
import math
from collections.abc import Sequence
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path

import numpy as np

from feel321 import intake
from feel321.stimuli.formats import common
from feel321.stimuli.recording import AXES
from feel321.types import Samples

BLANKS = r"\s+"
"""Stands for any run of blanks as the delimiter, as pandas spells it."""

COMMENT_MARKS = "#%"

HEAD_LINES = 50
"""Within so many lines the numbers must begin."""

MOST_COLUMNS = 1000

SLOWEST_HZ = 40.0
"""Twice the 20 Hz where the match metrics begin: below, milliseconds were taken for seconds."""

CLUSTER_LABELS = ("time", "X", "Y", "Z")
CLUSTER_RATE_HZ = 6000.0
CLUSTER_NOTE = (
    "header and rate are those of the Cluster Haptic Texture Database: unit taken as g (unit=... "
    "says otherwise)"
)


@dataclass(frozen=True, slots=True)
class TextTable:
    """A delimited text, split but not yet converted; `text` begins on line `first_line` of the file, from 1."""

    text: str
    first_line: int
    delimiter: str
    decimal: str
    labels: tuple[str, ...] | None
    n_columns: int


def read_table(path: Path, request: common.ReadingOptions) -> common.Decoded:
    """Read three columns of acceleration, and time if there is a column for it."""
    table = split_table(path)
    if request.columns is not None:
        columns = common.pick_columns(
            request.columns, labels=table.labels, n_columns=table.n_columns
        )
    elif table.labels:
        columns = common.find_columns(table.labels)
    else:
        columns = _count_columns(table.n_columns)
    if columns.time is None:
        return common.Decoded(
            read_numbers(table, columns.axes), columns.unit, first_line=table.first_line
        )
    values = read_numbers(table, (columns.time, *columns.axes))
    second = columns.time_unit_s or 1.0
    time_s = values[0] * second
    span_s = float(np.ptp(time_s))
    rate_hz = (time_s.size - 1) / span_s if span_s > 0 else np.inf
    unit, notes = columns.unit, []
    if columns.time_unit_s is None and rate_hz < SLOWEST_HZ:
        notes.append(
            f"the time column names no unit: taken as s, which gives {rate_hz:g} Hz; if it is ms, call it time_ms"
        )
    is_cluster = table.labels == CLUSTER_LABELS and abs(rate_hz / CLUSTER_RATE_HZ - 1) < 0.1  # noqa: PLR2004 - nominal, so a tenth either way
    if request.unit is None and unit is None and is_cluster:
        unit = "g"
        notes.append(CLUSTER_NOTE)
    return common.Decoded(
        values[1:],
        unit,
        time_s=time_s,
        time_step_s=second * _find_printed_step(table, columns.time),
        first_line=table.first_line,
        notes=tuple(notes),
    )


def split_table(path: Path) -> TextTable:
    """Find the delimiter, the decimal sign, the header and the first row."""
    content = intake.read_bytes(path, most=intake.read_limit() // intake.TEXT_SHARE)
    intake.check_lines(content)
    text = intake.decode(content, path.name).replace("\r\n", "\n").replace("\r", "\n")
    head = text.rstrip().split("\n", HEAD_LINES)
    above: list[str] = []
    for i, row in enumerate(head[:HEAD_LINES]):
        content_of_row = row.strip()
        if not content_of_row:
            continue
        delimiter = next((mark for mark in ";\t," if mark in content_of_row), BLANKS)
        decimal = "," if delimiter in {";", "\t"} and "," in content_of_row else "."
        if content_of_row[0] not in COMMENT_MARKS:
            cells = _split_row(content_of_row, delimiter)
            if any(_number(cell, decimal) is not None for cell in cells):
                labels = _find_labels(above, delimiter, n_columns=len(cells), line=i + 1)
                return TextTable("\n".join(head[i:]), i + 1, delimiter, decimal, labels, len(cells))
        above.append(content_of_row)
    raise ValueError(
        f"there is no row of numbers in the first {HEAD_LINES} lines; export the file again"
    )


def _find_labels(
    above: list[str], delimiter: str, *, n_columns: int, line: int
) -> tuple[str, ...] | None:
    """Find the names of the columns in the lines above the numbers."""
    if n_columns > MOST_COLUMNS:
        raise ValueError(
            f"a table must have at most {MOST_COLUMNS} columns, got {n_columns}; one row is one sample"
        )
    headers = [content for content in above if content[0] not in COMMENT_MARKS]
    if len(headers) > 1:
        raise ValueError(
            f"there must be at most one header line above the numbers, got {len(headers)}"
        )
    if headers:
        labels = tuple(_split_row(headers[0], delimiter))
        if len(labels) != n_columns:
            raise ValueError(
                f"the header must name each cell, got {len(labels)} names but {n_columns} cells on line {line}"
            )
        return labels
    # numpy.savetxt writes its header as a comment.
    comment = tuple(_split_row(above[-1].lstrip(COMMENT_MARKS + " "), delimiter)) if above else ()
    return comment if len(comment) == n_columns else None


def _count_columns(n_columns: int) -> common.Columns:
    """Take three unlabelled columns as x, y, z; refuse any other number."""
    if n_columns == AXES:
        return common.Columns((0, 1, 2))
    if n_columns == 1:
        raise common.refuse_reduced("one column without a header")
    if n_columns < AXES:
        raise ValueError(
            f"there must be three axes x, y, z, got {n_columns} columns without a header"
        )
    raise ValueError(
        f"{n_columns} columns without a header are ambiguous; "
        "say which they are, e.g. columns=(0, 1, 2, 3) for time, x, y, z or columns=(0, 1, 2) for x, y, z"
    )


def read_numbers(table: TextTable, columns: Sequence[int]) -> Samples:
    """Convert some columns of a table, from 0, to numbers, (len(columns), n_rows); every cell must be one."""
    import pandas as pd

    try:
        frame = pd.read_csv(
            io.StringIO(table.text),
            sep=table.delimiter,
            decimal=table.decimal,
            header=None,
            dtype={i: np.float64 if i in columns else str for i in range(table.n_columns)},
            skip_blank_lines=False,
        )
        values = frame[list(columns)].to_numpy().T
    except ValueError as error:
        _refuse_fault(table, columns)
        raise ValueError(f"cannot be read as numbers ({str(error).splitlines()[0]})") from None
    if not np.isfinite(values).all():
        _refuse_fault(table, columns)
    return np.ascontiguousarray(values, dtype=np.float64)


def _refuse_fault(table: TextTable, columns: Sequence[int]) -> None:
    """Find the first line that is wrong, and refuse it."""
    for line, row in enumerate(table.text.split("\n"), start=table.first_line):
        place = f"line {line}:"
        if not row.strip():
            raise ValueError(f"{place} the line is blank; remove or correct it")
        try:
            cells = _split_row(row, table.delimiter)
        except ValueError as error:
            raise ValueError(f"{place} {error}") from None
        if len(cells) != table.n_columns:
            raise ValueError(
                f"{place} there must be {table.n_columns} cells, got {len(cells)}; is the file truncated?"
            )
        for i in columns:
            number = _number(cells[i], table.decimal)
            if number is None or not math.isfinite(number):
                label = f" {table.labels[i]!r}" if table.labels else ""
                raise ValueError(
                    f"{place} column {i}{label} must be a finite number, got {intake.clip(cells[i])!r}; correct the row"
                )


def _split_row(row: str, delimiter: str) -> list[str]:
    """Split one row into stripped cells."""
    if delimiter == BLANKS:
        return row.split()
    try:
        return [cell.strip() for cell in next(csv.reader([row], delimiter=delimiter), [])]
    except csv.Error as error:
        raise ValueError(f"the row cannot be split into cells ({error}); is it a table?") from None


def _number(cell: str, decimal: str) -> float | None:
    if "_" in cell or not cell.isascii():  # numbers to Python, not to pandas
        return None
    try:
        return float(cell.replace(decimal, "."))
    except ValueError:
        return None


def _find_printed_step(table: TextTable, column: int) -> float:
    """Return the last printed decimal place of the time stamps, from the longest ones, at the end of the file."""
    rows = table.text.rsplit("\n", 100)[-100:]
    cells = [_split_row(row, table.delimiter)[column].replace(table.decimal, ".") for row in rows]
    places = [Decimal(cell).as_tuple().exponent for cell in cells]
    return float(10.0 ** min(place for place in places if isinstance(place, int)))
