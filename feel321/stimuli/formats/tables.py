"""Recordings in text tables: separators, header, columns, samples."""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from decimal import Decimal
from typing import TYPE_CHECKING

import numpy as np

from feel321.stimuli.formats.common import (
    ACCELERATION_SPELLINGS,
    TIME_SPELLINGS,
    Decoded,
    already_reduced,
    parse_unit,
    split_unit,
)
from feel321.stimuli.recording import AXES

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from numpy.typing import NDArray

    from feel321.stimuli.formats.common import Request

# Text files: strict UTF-8, a sniffed delimiter, numbers by pandas, and the line of whatever is wrong.

BLANKS = r"\s+"
"""Stands for any run of blanks as the delimiter, as pandas spells it."""

COMMENT_MARKS = "#%"

HEAD_LINES = 50
"""Within so many lines the numbers must begin."""


@dataclass(frozen=True, slots=True)
class Table:
    """A delimited text, laid out but not yet converted.

    first_line: the line of the file on which `text` begins, from 1.
    """

    text: str
    first_line: int
    delimiter: str
    decimal: str
    labels: tuple[str, ...] | None
    n_columns: int


def read_text(path: Path) -> str:
    """Read a file as UTF-8 with or without byte-order mark, line ends made one."""
    content = path.read_bytes()
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        raise ValueError(
            f"got the byte 0x{content[error.start]:02x} on line {line}, not UTF-8 (perhaps Latin-1); "
            "save the file as UTF-8"
        ) from None
    return text.replace("\r\n", "\n").replace("\r", "\n")


def lay_out(text: str) -> Table:
    """Find the delimiter, the decimal sign, the header and the first row."""
    head = text.rstrip().split("\n", HEAD_LINES)
    above: list[str] = []
    for i, row in enumerate(head[:HEAD_LINES]):
        content = row.strip()
        if content and content[0] not in COMMENT_MARKS and _is_row(content):
            return _table("\n".join(head[i:]), content, line=i + 1, above=above)
        above += [content] if content else []
    raise ValueError(
        f"got no row of numbers in the first {HEAD_LINES} lines; export the file again"
    )


def read_numbers(table: Table, columns: Sequence[int]) -> NDArray[np.float64]:
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
        raise ValueError(
            f"got a row that cannot be split into cells ({error}); is it a table?"
        ) from None


def _sniff(row: str) -> tuple[str, str]:
    """Return delimiter and decimal sign of a row of numbers."""
    delimiter = next((mark for mark in ";\t," if mark in row), BLANKS)
    decimal = "," if delimiter in {";", "\t"} and "," in row else "."
    return delimiter, decimal


def _is_row(row: str) -> bool:
    delimiter, decimal = _sniff(row)
    numbers = [_number(cell, decimal) for cell in split_row(row, delimiter)]
    return any(number is not None for number in numbers)


def _number(cell: str, decimal: str) -> float | None:
    if "_" in cell or not cell.isascii():  # numbers to Python, not to pandas
        return None
    try:
        return float(cell.replace(decimal, "."))
    except ValueError:
        return None


def _table(text: str, row: str, *, line: int, above: list[str]) -> Table:
    delimiter, decimal = _sniff(row)
    n_columns = len(split_row(row, delimiter))
    labels = _labels(above, delimiter, n_columns=n_columns)
    if labels is not None and len(labels) != n_columns:
        raise ValueError(
            f"got {len(labels)} names in the header but {n_columns} cells on line {line}, allowed is one name per cell"
        )
    return Table(text, line, delimiter, decimal, labels, n_columns)


def _labels(above: list[str], delimiter: str, *, n_columns: int) -> tuple[str, ...] | None:
    headers = [content for content in above if content[0] not in COMMENT_MARKS]
    if len(headers) > 1:
        raise ValueError(
            f"got {len(headers)} lines of text above the numbers, allowed is one header line"
        )
    if headers:
        return tuple(split_row(headers[0], delimiter))
    # numpy.savetxt writes its header as a comment.
    comment = tuple(split_row(above[-1].lstrip(COMMENT_MARKS + " "), delimiter)) if above else ()
    return comment if len(comment) == n_columns else None


def _first_fault(table: Table, columns: Sequence[int]) -> ValueError | None:
    for line, row in enumerate(table.text.split("\n"), start=table.first_line):
        for fault in _faults(row, table=table, columns=columns):
            return ValueError(f"line {line}: {fault}")
    return None


def _faults(row: str, *, table: Table, columns: Sequence[int]) -> Iterator[str]:
    try:
        cells = split_row(row, table.delimiter)
    except ValueError as error:
        yield str(error)
        return
    if not row.strip():
        yield "got a blank line, allowed is one row per line; remove or mend it"
    elif len(cells) != table.n_columns:
        yield f"got {len(cells)} cells, allowed is {table.n_columns}; is the file truncated?"
    else:
        for i in columns:
            number = _number(cells[i], table.decimal)
            if number is None or not math.isfinite(number):
                label = f" {table.labels[i]!r}" if table.labels else ""
                yield f"got {cells[i]!r} in column {i}{label}, allowed is a finite number; mend the row"


# Which columns hold x, y, z and time: by name, by number, never by guess.

SENSOR = r"(?:a|acc|accel|acceleration|accelerometer)"
AXIS = re.compile(
    rf"(?:linear[\s_.-]*)?{SENSOR}?[\s_.-]*([xyz])[\s_.-]*(?:{SENSOR}|axis)?", re.IGNORECASE
)
TIME = re.compile(r"t|time|times|time[\s_]?stamps?", re.IGNORECASE)
WITH_TIME = AXES + 1


@dataclass(frozen=True, slots=True)
class Columns:
    """Where the samples and the time stamps stand.

    axes: the columns of x, y, z, counted from 0.
    """

    axes: tuple[int, ...]
    time: int | None = None
    unit: str | None = None
    time_unit_s: float | None = None


def find_columns(labels: Sequence[str]) -> Columns:
    """Find x, y, z and time by their labels.

    Examples
    --------
    >>> find_columns(["t", "ax", "ay", "az"]).axes
    (1, 2, 3)
    """
    time = find_time(labels)
    found: dict[str, list[int]] = {"x": [], "y": [], "z": []}
    for i, label in enumerate(labels):
        if match := AXIS.fullmatch(split_unit(label, ACCELERATION_SPELLINGS)[0]):
            found[match[1].lower()].append(i)
    _check_axes_found(labels, found=found, time=time)
    axes = (found["x"][0], found["y"][0], found["z"][0])
    return name_units(labels, axes=axes, time=time)


def find_time(labels: Sequence[str]) -> int | None:
    """Find the time stamps by their label."""
    times = [
        i for i, label in enumerate(labels) if TIME.fullmatch(split_unit(label, TIME_SPELLINGS)[0])
    ]
    _refuse_several(labels, what="time", places=times)
    return times[0] if times else None


def name_units(labels: Sequence[str], *, axes: tuple[int, ...], time: int | None) -> Columns:
    """Add the units that the labels of the chosen columns name."""
    for i in axes:
        if unit := split_unit(labels[i], ACCELERATION_SPELLINGS)[1]:
            # A bracket that is no unit may say volts: only columns=... overrules it.
            parse_unit(unit)
    return _with_units(labels, axes=axes, time=time)


def count_columns(n_columns: int) -> Columns:
    """Take three unlabelled columns as x, y, z; refuse any other number."""
    if n_columns == AXES:
        return Columns((0, 1, 2))
    if n_columns == 1:
        raise already_reduced("one column without a header")
    if n_columns < AXES:
        raise ValueError(f"got {n_columns} columns without a header, allowed is three axes x, y, z")
    raise ValueError(
        f"got {n_columns} columns without a header, which is ambiguous; "
        "say which they are, e.g. columns=(0, 1, 2, 3) for time, x, y, z or columns=(0, 1, 2) for x, y, z"
    )


def pick_columns(
    wanted: Sequence[str | int],
    *,
    labels: Sequence[str] | None,
    n_columns: int,
    whole: bool = False,
) -> Columns:
    """Take the columns that the caller names.

    wanted: (x, y, z) or (time, x, y, z), by label or by number from 0.
    """
    counts = {1, 2, AXES, WITH_TIME} if whole else {AXES, WITH_TIME}
    if isinstance(wanted, str) or not isinstance(wanted, Sequence) or len(wanted) not in counts:
        more = "(acceleration,), (time, acceleration), " if whole else ""
        raise ValueError(f"got columns={wanted!r}, allowed is {more}(x, y, z) or (time, x, y, z)")
    places = tuple(_place(column, labels=labels, n_columns=n_columns) for column in wanted)
    if len(set(places)) < len(places):
        raise ValueError(
            f"got columns={tuple(wanted)!r}, which name one column twice; allowed is each one once"
        )
    time, axes = (places[0], places[1:]) if len(places) in {2, WITH_TIME} else (None, places)
    return _with_units(labels, axes=axes, time=time) if labels else Columns(axes, time)


def _place(column: str | int, *, labels: Sequence[str] | None, n_columns: int) -> int:
    names = [label.strip().casefold() for label in labels or ()]
    if isinstance(column, str) and names.count(column.strip().casefold()) == 1:
        return names.index(column.strip().casefold())
    # The command line knows text only, so a number may come as text.
    if str(column).isdecimal() and int(column) < n_columns:
        return int(column)
    known = f"{', '.join(labels)}, or " if labels else ""
    raise ValueError(
        f"got the column {column!r}, allowed is {known}a number from 0 to {n_columns - 1}"
    )


def _refuse_several(labels: Sequence[str], *, what: str, places: list[int]) -> None:
    if len(places) > 1:
        both = ", ".join(labels[i] for i in places)
        raise ValueError(
            f"got several columns for {what} ({both}); say which, columns=(time, x, y, z)"
        )


def _check_axes_found(
    labels: Sequence[str], *, found: dict[str, list[int]], time: int | None
) -> None:
    header = ", ".join(labels)
    for axis, places in found.items():
        _refuse_several(labels, what=axis, places=places)
    present = [axis for axis, places in found.items() if places]
    if len(present) == AXES:
        return
    if len(labels) - (time is not None) == 1:
        raise already_reduced(f"the columns {header}")
    missing = "no columns named x, y, z" if not present else f"only the axes {', '.join(present)}"
    raise ValueError(
        f"got {missing} in the header ({header}); allowed is three axes, named e.g. x, acc_y, az (m/s^2) "
        "or given as columns=(time, x, y, z)"
    )


def _with_units(labels: Sequence[str], *, axes: tuple[int, ...], time: int | None) -> Columns:
    units = {split_unit(labels[i], ACCELERATION_SPELLINGS)[1] for i in axes}
    named = {ACCELERATION_SPELLINGS.get(unit or "") for unit in units}
    if len(named) > 1:
        header = ", ".join(labels[i] for i in axes)
        raise ValueError(
            f"got axes in different units ({header}), allowed is one unit for all three"
        )
    time_unit_s = None if time is None else _time_unit(labels[time])
    return Columns(axes, time, named.pop(), time_unit_s)


def _time_unit(label: str) -> float | None:
    unit = split_unit(label, TIME_SPELLINGS)[1]
    if unit is None:
        return None
    if unit not in TIME_SPELLINGS:
        raise ValueError(f"got the time column {label!r}, allowed units are s, ms, us, ns")
    return TIME_SPELLINGS[unit]


# CSV, TSV and TXT tables: a header or column numbers, a time column or a given rate.

CLUSTER_LABELS = ("time", "X", "Y", "Z")
CLUSTER_RATE_HZ = 6000.0
CLUSTER_NOTE = (
    "header and rate are those of the Cluster Haptic Texture Database: unit taken as g (unit=... "
    "says otherwise)"
)


def read_table(path: Path, request: Request) -> Decoded:
    """Read three columns of acceleration, and time if there is a column for it."""
    table = lay_out(read_text(path))
    columns = choose_columns(table, request)
    if columns.time is None:
        return Decoded(read_numbers(table, columns.axes), columns.unit, first_line=table.first_line)
    values = read_numbers(table, (columns.time, *columns.axes))
    second = columns.time_unit_s or 1.0
    time_s = values[0] * second
    unit, notes = columns.unit, _time_notes(columns, time_s)
    if request.unit is None and unit is None and _is_cluster(table, time_s):
        unit, notes = "g", (*notes, CLUSTER_NOTE)
    return Decoded(
        values[1:],
        unit,
        time_s=time_s,
        time_step_s=second * _printed_step(table, columns.time),
        first_line=table.first_line,
        notes=notes,
    )


def choose_columns(table: Table, request: Request) -> Columns:
    """Choose the columns: as asked for, else by the header, else the only three."""
    if request.columns is not None:
        return pick_columns(request.columns, labels=table.labels, n_columns=table.n_columns)
    return find_columns(table.labels) if table.labels else count_columns(table.n_columns)


def _printed_step(table: Table, column: int) -> float:
    """Return the last printed place of the time stamps: where they are longest, at the end, many at once."""
    rows = table.text.rsplit("\n", 100)[-100:]
    cells = [split_row(row, table.delimiter)[column].replace(table.decimal, ".") for row in rows]
    places = [Decimal(cell).as_tuple().exponent for cell in cells]
    return float(10.0 ** min(place for place in places if isinstance(place, int)))


def _time_notes(columns: Columns, time_s: NDArray[np.float64]) -> tuple[str, ...]:
    """Notice milliseconds that pass for seconds: no vibration is sampled that slowly."""
    slowest_hz = 40.0  # twice the 20 Hz where the match metrics begin
    if columns.time_unit_s is not None or time_s.size < 2 or np.ptp(time_s) <= 0:  # noqa: PLR2004 - an interval
        return ()
    rate_hz = (time_s.size - 1) / float(np.ptp(time_s))
    if rate_hz >= slowest_hz:
        return ()
    note = f"the time column names no unit: taken as s, which gives {rate_hz:g} Hz; if it is ms, call it time_ms"
    return (note,)


def _is_cluster(table: Table, time_s: NDArray[np.float64]) -> bool:
    if table.labels != CLUSTER_LABELS or np.ptp(time_s) <= 0:
        return False
    rate_hz = (time_s.size - 1) / float(np.ptp(time_s))
    return abs(rate_hz / CLUSTER_RATE_HZ - 1) < 0.1  # noqa: PLR2004 - nominal, so a tenth either way
