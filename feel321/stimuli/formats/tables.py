"""Recordings in text tables (CSV, TSV, TXT): separators, header, columns, samples.

Strict UTF-8, a sniffed delimiter, numbers by pandas, and the line of whatever is wrong. Which columns hold x, y, z and
time is settled by name or by number, never by guess.
"""

import csv
import io
import math
import re
from collections.abc import Iterator, Sequence
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


@dataclass(frozen=True, slots=True)
class TextTable:
    """A delimited text, split but not yet converted; `text` begins on line `first_line` of the file, from 1."""

    text: str
    first_line: int
    delimiter: str
    decimal: str
    labels: tuple[str, ...] | None
    n_columns: int


def read_text(path: Path) -> str:
    """Read a file as UTF-8 with or without byte-order mark, line ends made one."""
    content = intake.read_bytes(path, most=intake.read_limit() // intake.TEXT_SHARE)
    intake.check_lines(content)
    text = intake.decode(content, path.name)
    return text.replace("\r\n", "\n").replace("\r", "\n")


def split_table(text: str) -> TextTable:
    """Find the delimiter, the decimal sign, the header and the first row."""
    head = text.rstrip().split("\n", HEAD_LINES)
    above: list[str] = []
    for i, row in enumerate(head[:HEAD_LINES]):
        content = row.strip()
        if content and content[0] not in COMMENT_MARKS and _is_row(content):
            return _make_table("\n".join(head[i:]), content, line=i + 1, above=above)
        above += [content] if content else []
    raise ValueError(
        f"there is no row of numbers in the first {HEAD_LINES} lines; export the file again"
    )


def read_numbers(table: TextTable, columns: Sequence[int]) -> Samples:
    """Convert some columns of a table to numbers; every cell must be one.

    columns: the columns wanted, from 0; returns (len(columns), n_rows).
    """
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
        reason = str(error).splitlines()[0]
        raise _first_fault(table, columns) or ValueError(
            f"cannot be read as numbers ({reason})"
        ) from None
    if not np.isfinite(values).all() and (fault := _first_fault(table, columns)):
        raise fault
    return np.ascontiguousarray(values, dtype=np.float64)


def split_row(row: str, delimiter: str) -> list[str]:
    """Split one row into stripped cells."""
    if delimiter == BLANKS:
        return row.split()
    try:
        return [cell.strip() for cell in next(csv.reader([row], delimiter=delimiter), [])]
    except csv.Error as error:
        raise ValueError(f"the row cannot be split into cells ({error}); is it a table?") from None


def _sniff(row: str) -> tuple[str, str]:
    """Return delimiter and decimal sign of a row of numbers."""
    delimiter = next((mark for mark in ";\t," if mark in row), BLANKS)
    return delimiter, "," if delimiter in {";", "\t"} and "," in row else "."


def _is_row(row: str) -> bool:
    delimiter, decimal = _sniff(row)
    return any(_number(cell, decimal) is not None for cell in split_row(row, delimiter))


def _number(cell: str, decimal: str) -> float | None:
    if "_" in cell or not cell.isascii():  # numbers to Python, not to pandas
        return None
    try:
        return float(cell.replace(decimal, "."))
    except ValueError:
        return None


def _make_table(text: str, row: str, *, line: int, above: list[str]) -> TextTable:
    delimiter, decimal = _sniff(row)
    n_columns = len(split_row(row, delimiter))
    if n_columns > MOST_COLUMNS:
        raise ValueError(
            f"a table must have at most {MOST_COLUMNS} columns, got {n_columns}; one row is one sample"
        )
    labels = _labels(above, delimiter, n_columns=n_columns)
    if labels is not None and len(labels) != n_columns:
        raise ValueError(
            f"the header must name each cell, got {len(labels)} names but {n_columns} cells on line {line}"
        )
    return TextTable(text, line, delimiter, decimal, labels, n_columns)


def _labels(above: list[str], delimiter: str, *, n_columns: int) -> tuple[str, ...] | None:
    headers = [content for content in above if content[0] not in COMMENT_MARKS]
    if len(headers) > 1:
        raise ValueError(
            f"there must be at most one header line above the numbers, got {len(headers)}"
        )
    if headers:
        return tuple(split_row(headers[0], delimiter))
    # numpy.savetxt writes its header as a comment.
    comment = tuple(split_row(above[-1].lstrip(COMMENT_MARKS + " "), delimiter)) if above else ()
    return comment if len(comment) == n_columns else None


def _first_fault(table: TextTable, columns: Sequence[int]) -> ValueError | None:
    for line, row in enumerate(table.text.split("\n"), start=table.first_line):
        for fault in _faults(row, table=table, columns=columns):
            return ValueError(f"line {line}: {fault}")
    return None


def _faults(row: str, *, table: TextTable, columns: Sequence[int]) -> Iterator[str]:
    try:
        cells = split_row(row, table.delimiter)
    except ValueError as error:
        yield str(error)
        return
    if not row.strip():
        yield "the line is blank; remove or correct it"
    elif len(cells) != table.n_columns:
        yield f"there must be {table.n_columns} cells, got {len(cells)}; is the file truncated?"
    else:
        for i in columns:
            number = _number(cells[i], table.decimal)
            if number is None or not math.isfinite(number):
                label = f" {table.labels[i]!r}" if table.labels else ""
                yield f"column {i}{label} must be a finite number, got {intake.clip(cells[i])!r}; correct the row"


SENSOR = r"(?:a|acc|accel|acceleration|accelerometer)"
AXIS = re.compile(
    rf"(?:linear[\s_.-]*)?{SENSOR}?[\s_.-]*([xyz])[\s_.-]*(?:{SENSOR}|axis)?", re.IGNORECASE
)
TIME = re.compile(r"t|time|times|time[\s_]?stamps?", re.IGNORECASE)
WITH_TIME = AXES + 1


@dataclass(frozen=True, slots=True)
class Columns:
    """Column numbers, from 0, of x, y, z and the time stamps, and their units."""

    axes: tuple[int, ...]
    time: int | None = None
    unit: str | None = None
    time_unit_s: float | None = None


def find_columns(labels: Sequence[str]) -> Columns:
    """Find x, y, z and time by their labels."""
    time = find_time(labels)
    found: dict[str, list[int]] = {"x": [], "y": [], "z": []}
    for i, label in enumerate(labels):
        if match := AXIS.fullmatch(common.split_unit(label, common.ACCELERATION_SPELLINGS)[0]):
            found[match[1].lower()].append(i)
    for axis, places in found.items():
        _refuse_several(labels, what=axis, places=places)
    present = [axis for axis, places in found.items() if places]
    header = intake.clip(", ".join(labels), 200)
    if len(present) < AXES and len(labels) - (time is not None) == 1:
        raise common.refuse_reduced(f"a table with the columns {header}")
    if len(present) < AXES:
        got = f"only the axes {', '.join(present)}" if present else "no columns named x, y, z"
        raise ValueError(
            f"the header must name three axes, e.g. x, acc_y, az (m/s^2), got {got} ({header}); "
            "or say columns=(time, x, y, z)"
        )
    axes = (found["x"][0], found["y"][0], found["z"][0])
    return add_units(labels, axes=axes, time=time)


def find_time(labels: Sequence[str]) -> int | None:
    """Find the time stamps by their label."""
    names = [common.split_unit(label, common.TIME_SPELLINGS)[0] for label in labels]
    times = [i for i, name in enumerate(names) if TIME.fullmatch(name)]
    _refuse_several(labels, what="time", places=times)
    return times[0] if times else None


def add_units(labels: Sequence[str], *, axes: tuple[int, ...], time: int | None) -> Columns:
    """Add the units that the labels of the chosen columns name."""
    for i in axes:
        if unit := common.split_unit(labels[i], common.ACCELERATION_SPELLINGS)[1]:
            # A bracket that is no unit may say volts: only columns=... overrules it.
            common.parse_unit(unit)
    return _with_units(labels, axes=axes, time=time)


def count_columns(n_columns: int) -> Columns:
    """Take three unlabelled columns as x, y, z; refuse any other number."""
    if n_columns == AXES:
        return Columns((0, 1, 2))
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


def pick_columns(
    wanted: Sequence[str | int],
    *,
    labels: Sequence[str] | None,
    n_columns: int,
    whole: bool = False,
) -> Columns:
    """Take the columns that the caller names: (x, y, z) or (time, x, y, z), by label or by number from 0."""
    counts = {1, 2, AXES, WITH_TIME} if whole else {AXES, WITH_TIME}
    if isinstance(wanted, str) or not isinstance(wanted, Sequence) or len(wanted) not in counts:
        more = "(acceleration,), (time, acceleration), " if whole else ""
        raise ValueError(f"columns must be {more}(x, y, z) or (time, x, y, z), got {wanted!r}")
    places = tuple(_place(column, labels=labels, n_columns=n_columns) for column in wanted)
    if len(set(places)) < len(places):
        raise ValueError(f"columns must name each column once, got {tuple(wanted)!r}")
    time, axes = (places[0], places[1:]) if len(places) in {2, WITH_TIME} else (None, places)
    return _with_units(labels, axes=axes, time=time) if labels else Columns(axes, time)


def _place(column: str | int, *, labels: Sequence[str] | None, n_columns: int) -> int:
    names = [label.strip().casefold() for label in labels or ()]
    if isinstance(column, str) and names.count(column.strip().casefold()) == 1:
        return names.index(column.strip().casefold())
    # The command line knows text only, so a number may come as text.
    if str(column).isdecimal() and int(column) < n_columns:
        return int(column)
    known = f"{intake.clip(', '.join(labels), 200)}, or " if labels else ""
    raise ValueError(f"a column must be {known}a number from 0 to {n_columns - 1}, got {column!r}")


def _refuse_several(labels: Sequence[str], *, what: str, places: list[int]) -> None:
    if len(places) > 1:
        both = ", ".join(labels[i] for i in places)
        raise ValueError(
            f"several columns may be {what} ({both}); say which, columns=(time, x, y, z)"
        )


def _with_units(labels: Sequence[str], *, axes: tuple[int, ...], time: int | None) -> Columns:
    units = {common.split_unit(labels[i], common.ACCELERATION_SPELLINGS)[1] for i in axes}
    named = {common.ACCELERATION_SPELLINGS.get(unit or "") for unit in units}
    if len(named) > 1:
        header = ", ".join(labels[i] for i in axes)
        raise ValueError(f"the axes must be in one unit, got {header}")
    second = None if time is None else common.split_unit(labels[time], common.TIME_SPELLINGS)[1]
    if second is not None and second not in common.TIME_SPELLINGS:
        raise ValueError(f"the time column must be in s, ms, us or ns, got {labels[time or 0]!r}")
    return Columns(
        axes, time, named.pop(), None if second is None else common.TIME_SPELLINGS[second]
    )


CLUSTER_LABELS = ("time", "X", "Y", "Z")
CLUSTER_RATE_HZ = 6000.0
CLUSTER_NOTE = (
    "header and rate are those of the Cluster Haptic Texture Database: unit taken as g (unit=... "
    "says otherwise)"
)


def read_table(path: Path, request: common.ReadingOptions) -> common.Decoded:
    """Read three columns of acceleration, and time if there is a column for it."""
    table = split_table(read_text(path))
    if request.columns is not None:
        columns = pick_columns(request.columns, labels=table.labels, n_columns=table.n_columns)
    else:
        columns = find_columns(table.labels) if table.labels else count_columns(table.n_columns)
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


def _find_printed_step(table: TextTable, column: int) -> float:
    """Return the last printed decimal place of the time stamps, from the longest ones, at the end of the file."""
    rows = table.text.rsplit("\n", 100)[-100:]
    cells = [split_row(row, table.delimiter)[column].replace(table.decimal, ".") for row in rows]
    places = [Decimal(cell).as_tuple().exponent for cell in cells]
    return float(10.0 ** min(place for place in places if isinstance(place, int)))
