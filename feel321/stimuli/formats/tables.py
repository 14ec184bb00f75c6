"""What a recording's file says: which columns are meant, their units; and text tables (CSV, TSV, TXT).

A reader raises ValueError with a bare sentence; `read_recording` adds the file's name. Which columns hold x, y, z and
time is settled by name or by number, never by guess. Tables are strict UTF-8, their delimiter is sniffed, pandas reads
the numbers, and the line of whatever is wrong is named.
"""

import csv
import io
import math
import re
from collections.abc import Container, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path

import numpy as np

from feel321 import files
from feel321.stimuli.recording import AXES, UNITS
from feel321.types import Samples

RATE_KEYS = ("rate_hz", "fs", "rate", "sample_rate", "samplerate", "sampling_rate", "fs_hz")
UNIT_KEYS = ("unit", "units")
"""What the rate and the unit are called, in archives and sidecars alike."""

ACCELERATION_SPELLINGS = {
    "m/s^2": "m/s^2", "m/s2": "m/s^2", "m/s²": "m/s^2", "m/s/s": "m/s^2", "m/s**2": "m/s^2",
    "ms^-2": "m/s^2", "ms-2": "m/s^2", "ms⁻²": "m/s^2", "m·s⁻²": "m/s^2", "m*s^-2": "m/s^2", "ms2": "m/s^2",
    "g": "g", "gn": "g", "g0": "g", "gee": "g", "gees": "g",
    "mg": "mg", "milli-g": "mg", "millig": "mg",
}  # fmt: skip
"""Accepted spellings of a unit of acceleration (case, blanks and underscores aside) and the unit meant."""

TIME_SPELLINGS = {
    "s": 1.0, "sec": 1.0, "secs": 1.0, "second": 1.0, "seconds": 1.0,
    "ms": 1e-3, "msec": 1e-3, "millis": 1e-3, "milliseconds": 1e-3,
    "us": 1e-6, "μs": 1e-6, "usec": 1e-6, "micros": 1e-6, "microseconds": 1e-6,
    "ns": 1e-9, "nsec": 1e-9, "nanoseconds": 1e-9,
}  # fmt: skip
"""Accepted spellings of a unit of time and its size in s."""

SENSOR = r"(?:a|acc|accel|acceleration|accelerometer)"
AXIS = re.compile(
    rf"(?:linear[\s_.-]*)?{SENSOR}?[\s_.-]*([xyz])[\s_.-]*(?:{SENSOR}|axis)?", re.IGNORECASE
)
TIME = re.compile(r"t|time|times|time[\s_]?stamps?", re.IGNORECASE)


@dataclass(frozen=True, slots=True, eq=False)
class Decoded:
    """The content of a file; first_line is the line of a text file that holds the first sample, from 1."""

    acceleration: Samples
    unit: str | None = None
    rate_hz: float | None = None
    time_s: Samples | None = None
    time_step_s: float = 0.0
    first_line: int | None = None
    notes: tuple[str, ...] = ()
    sources: tuple[Path, ...] = ()
    name: str = ""


@contextmanager
def foreign_errors(what: str) -> Iterator[None]:
    """Translate whatever a library raises at a damaged file."""
    try:
        yield
    except Exception as error:  # libraries raise anything at damaged files, even UnboundLocalError
        # The system's own; libraries raise theirs without a number.
        if isinstance(error, files.TooLargeError) or (isinstance(error, OSError) and error.errno):
            raise
        reason = (str(error).strip() or type(error).__name__).splitlines()[0]
        why = f"cannot be read as {what} ({reason}); it is damaged or of another kind"
        raise ValueError(f"{why}, copy or export it again") from error


def stack_axes(axes: Mapping[str, Samples]) -> Samples:
    """Stack three axes of equal length, (n,) each, to (3, n); never shorten one to fit."""
    if len(axes) < AXES:
        got = f"only the axes {', '.join(sorted(axes))}" if axes else "no axes"
        raise ValueError(f"the file must hold three axes x, y, z, got {got}")
    if len({axis.size for axis in axes.values()}) > 1:
        counts = ", ".join(f"{axis} {axes[axis].size}" for axis in "xyz")
        raise ValueError(f"the axes must be of equal length, got {counts} samples; cut them alike")
    return np.stack([axes[axis] for axis in "xyz"])


def as_three_axes(values: Samples) -> Samples:
    """Turn an array to (3, n_samples), or say why it is not three axes."""
    got, must = f"an array of shape {values.shape}", "must have the shape (3, n) or (n, 3)"
    if values.size == 0:
        raise ValueError(f"the array {must}, got {got}: it is empty")
    if values.ndim < 2 or (values.ndim == 2 and 1 in values.shape and AXES not in values.shape[:1]):  # noqa: PLR2004 - axes x samples
        raise refuse_reduced(got)
    if values.ndim > 2 or AXES not in values.shape:  # noqa: PLR2004 - axes x samples
        raise ValueError(f"the array {must}, exactly three axes; got {got}")
    return values if values.shape[0] == AXES else values.T


def refuse_reduced(got: str) -> ValueError:
    """Return the refusal of a signal with one axis."""
    what = "is one channel, so already reduced to one axis"
    return ValueError(f"{got} {what}; read the raw three-axis recording instead")


def normalise(text: str) -> str:
    """Strip case, blanks and underscores, and make both micro signs one."""
    return re.sub(r"[\s_]+", "", text).casefold()


def split_unit(label: str, spellings: Container[str]) -> tuple[str, str | None]:
    """Split a column's label, such as ``x_g``, ``acc x (m/s²)`` or ``time [µs]``, into its bare name and its unit."""
    label = label.strip()
    if bracketed := re.fullmatch(r"(.+?)[\s_]*[\[(](.*)[\])]", label):
        return bracketed[1], normalise(bracketed[2])
    for gap in re.finditer(r"[\s_]+", label):
        if normalise(label[gap.end() :]) in spellings:
            return label[: gap.start()], normalise(label[gap.end() :])
    return label, None


def parse_unit(text: str) -> str:
    """Return the unit of acceleration meant by a spelling."""
    try:
        return ACCELERATION_SPELLINGS[normalise(text)]
    except (KeyError, TypeError):
        raise ValueError(f"the unit must be one of {', '.join(UNITS)}; got {text!r}") from None


@dataclass(frozen=True, slots=True)
class Columns:
    """Column numbers, from 0, of x, y, z (or of all three together) and the time stamps, and their units."""

    axes: tuple[int, ...]
    time: int | None = None
    unit: str | None = None
    time_unit_s: float | None = None


def find_columns(labels: Sequence[str], *, wholes: Sequence[str] = ()) -> Columns:
    """Find x, y, z and time by their labels; wholes: what an array of all three axes is called."""
    found: dict[str, list[int]] = {"x": [], "y": [], "z": [], "time": [], "whole": []}
    for i, label in enumerate(labels):
        name = split_unit(label, ACCELERATION_SPELLINGS)[0]
        is_time = TIME.fullmatch(split_unit(label, TIME_SPELLINGS)[0])
        axis = AXIS.fullmatch(name)
        kind = "whole" if name.casefold() in wholes else axis[1].lower() if axis else "time"
        if axis or is_time or kind == "whole":
            found[kind].append(i)
    axes = _check_found(found, labels)
    for unit in filter(None, (split_unit(labels[i], ACCELERATION_SPELLINGS)[1] for i in axes)):
        parse_unit(unit)  # a bracket may say volts: only columns=... overrules it
    return _with_units(labels, axes, next(iter(found["time"]), None))


def _check_found(found: Mapping[str, list[int]], labels: Sequence[str]) -> tuple[int, ...]:
    """Refuse columns that are missing, or several that may be the same one; return those of the acceleration."""
    axes, whole = [found[axis][0] for axis in "xyz" if found[axis]], found["whole"]
    candidates = [*whole, *(axes if len(axes) == AXES else ())]
    if whole and len(candidates) > 1:
        several = ", ".join(labels[i] for i in candidates)
        how = f"say which, e.g. columns=({labels[whole[0]]!r},) or columns=(x, y, z)"
        raise ValueError(f"several arrays may be the acceleration ({several}); {how}")
    for what in ("time",) if whole else ("time", "x", "y", "z"):
        if len(found[what]) > 1:
            both = f"{what} ({', '.join(labels[i] for i in found[what])})"
            raise ValueError(f"several columns may be {both}; say which, columns=(time, x, y, z)")
    if not whole and len(axes) < AXES:
        header = files.clip(", ".join(labels), 200)
        if len(labels) - len(found["time"]) == 1:
            raise refuse_reduced(f"a table with the columns {header}")
        present = ", ".join(axis for axis in "xyz" if found[axis])
        got = f"only the axes {present}" if present else "no columns named x, y, z"
        how = f"got {got} ({header}); or say columns=(time, x, y, z)"
        raise ValueError(f"the header must name three axes, e.g. x, acc_y, az (m/s^2), {how}")
    return tuple(whole or axes)


def pick_columns(
    wanted: Sequence[str | int], *, labels: Sequence[str], n_columns: int, whole: bool = False
) -> Columns:
    """Take the columns that the caller names: (x, y, z) or (time, x, y, z), by label or by number from 0."""
    counts = {1, 2, AXES, AXES + 1} if whole else {AXES, AXES + 1}
    if isinstance(wanted, str) or not isinstance(wanted, Sequence) or len(wanted) not in counts:
        more = "(acceleration,), (time, acceleration), " if whole else ""
        raise ValueError(f"columns must be {more}(x, y, z) or (time, x, y, z), got {wanted!r}")
    names = [label.strip().casefold() for label in labels]
    places: list[int] = []
    for column in wanted:
        name = str(column).strip().casefold()
        if isinstance(column, str) and names.count(name) == 1:
            places.append(names.index(name))
        elif name.isdecimal() and int(name) < n_columns:  # the command line knows text only
            places.append(int(name))
        else:
            known = f"{files.clip(', '.join(labels), 200)}, or " if labels else ""
            must = f"{known}a number from 0 to {n_columns - 1}"
            raise ValueError(f"a column must be {must}, got {column!r}")
    if len(set(places)) < len(places):
        raise ValueError(f"columns must name each column once, got {tuple(wanted)!r}")
    time = places.pop(0) if len(places) in {2, AXES + 1} else None
    return _with_units(labels, tuple(places), time) if labels else Columns(tuple(places), time)


def _with_units(labels: Sequence[str], axes: tuple[int, ...], time: int | None) -> Columns:
    """Add the units that the labels of the chosen columns name."""
    units = (split_unit(labels[i], ACCELERATION_SPELLINGS)[1] for i in axes)
    named = {ACCELERATION_SPELLINGS.get(unit or "") for unit in units}
    if len(named) > 1:
        header = ", ".join(labels[i] for i in axes)
        raise ValueError(f"the axes must be in one unit, got {header}")
    second = None if time is None else split_unit(labels[time], TIME_SPELLINGS)[1]
    if second is not None and second not in TIME_SPELLINGS:
        raise ValueError(f"the time column must be in s, ms, us or ns, got {labels[time or 0]!r}")
    return Columns(axes, time, named.pop(), None if second is None else TIME_SPELLINGS[second])


BLANKS = r"\s+"  # any run of blanks as the delimiter, as pandas spells it
COMMENT_MARKS = "#%"
HEAD_LINES = 50  # within so many lines the numbers must begin
MOST_COLUMNS = 1000


@dataclass(frozen=True, slots=True)
class TextTable:
    """A delimited text, split but not yet converted; `text` begins on line `first_line` of the file, from 1."""

    text: str
    first_line: int
    delimiter: str
    decimal: str
    labels: tuple[str, ...]
    n_columns: int


def read_table(path: Path, wanted: Sequence[str | int] | None) -> Decoded:
    """Read three columns of acceleration, and time if there is a column for it; wanted: (time,) x, y, z, if given."""
    table = split_table(path)
    n_columns, first = table.n_columns, table.first_line
    if wanted is not None:
        columns = pick_columns(wanted, labels=table.labels, n_columns=n_columns)
    elif table.labels:
        columns = find_columns(table.labels)
    elif n_columns == 1:
        raise refuse_reduced("one column without a header")
    elif n_columns < AXES:
        raise ValueError(f"there must be three axes x, y, z, got {n_columns} columns, no header")
    elif n_columns > AXES:
        do = "say which, e.g. columns=(0, 1, 2, 3) for time, x, y, z or columns=(0, 1, 2) for x, y, z"
        raise ValueError(f"{n_columns} columns without a header are ambiguous; {do}")
    else:
        columns = Columns((0, 1, 2))
    if columns.time is None:
        return Decoded(read_numbers(table, columns.axes), columns.unit, first_line=first)
    values, second = read_numbers(table, (columns.time, *columns.axes)), columns.time_unit_s or 1.0
    # The last printed decimal place of the time stamps: of the longest ones, at the end of the file.
    rows = table.text.rsplit("\n", 100)[-100:]
    cells = [_split_row(row, table.delimiter)[columns.time] for row in rows]
    places = [Decimal(cell.replace(table.decimal, ".")).as_tuple().exponent for cell in cells]
    step_s = second * float(10.0 ** min(place for place in places if isinstance(place, int)))
    time_s = values[0] * second
    return Decoded(values[1:], columns.unit, time_s=time_s, time_step_s=step_s, first_line=first)


def split_table(path: Path) -> TextTable:
    """Find the delimiter, the decimal sign, the header and the first row."""
    content = files.read_bytes(path, most=files.read_limit() // files.TEXT_SHARE)
    files.check_lines(content)
    text = files.decode(content, path.name).replace("\r\n", "\n").replace("\r", "\n")
    head = text.rstrip().split("\n", HEAD_LINES)
    above: list[str] = []
    for i, line in enumerate(head[:HEAD_LINES]):
        if not (row := line.strip()):
            continue
        delimiter = next((mark for mark in ";\t," if mark in row), BLANKS)
        decimal = "," if delimiter in {";", "\t"} and "," in row else "."
        cells = [] if row[0] in COMMENT_MARKS else _split_row(row, delimiter)
        if any(_number(cell, decimal) is not None for cell in cells):
            labels = _find_labels(above, delimiter, n_columns=len(cells), line=i + 1)
            return TextTable("\n".join(head[i:]), i + 1, delimiter, decimal, labels, len(cells))
        above.append(row)
    raise ValueError(f"there is no row of numbers in the first {HEAD_LINES} lines; export it again")


def _find_labels(above: list[str], delimiter: str, *, n_columns: int, line: int) -> tuple[str, ...]:
    """Find the names of the columns, if there are any, in the lines above the numbers."""
    if n_columns > MOST_COLUMNS:
        raise ValueError(f"a table must have at most {MOST_COLUMNS} columns, got {n_columns}")
    headers = [content for content in above if content[0] not in COMMENT_MARKS]
    if len(headers) > 1:
        must = "there must be at most one header line above the numbers"
        raise ValueError(f"{must}, got {len(headers)}")
    # numpy.savetxt writes its header as a comment.
    comments = [content.lstrip(COMMENT_MARKS + " ") for content in above[-1:]]
    labels = tuple(_split_row(one, delimiter) for one in headers or comments)
    if headers and len(labels[0]) != n_columns:
        got = f"got {len(labels[0])} names but {n_columns} cells on line {line}"
        raise ValueError(f"the header must name each cell, {got}")
    return tuple(labels[0]) if labels and len(labels[0]) == n_columns else ()


def read_numbers(table: TextTable, columns: Sequence[int]) -> Samples:
    """Convert some columns of a table, from 0, to numbers, (len(columns), n_rows); every cell must be one."""
    import pandas as pd

    kinds = {i: np.float64 if i in columns else str for i in range(table.n_columns)}
    text, mark, sign = io.StringIO(table.text), table.delimiter, table.decimal
    reason = "a number is not finite"
    try:
        frame = pd.read_csv(
            text, sep=mark, decimal=sign, header=None, dtype=kinds, skip_blank_lines=False
        )
        values = np.ascontiguousarray(frame[list(columns)].to_numpy().T, dtype=np.float64)
    except ValueError as error:
        values, reason = np.full(1, math.nan), str(error).splitlines()[0]
    if not np.isfinite(values).all():
        _refuse_fault(table, columns)
        raise ValueError(f"cannot be read as numbers ({reason})")
    return values


def _refuse_fault(table: TextTable, columns: Sequence[int]) -> None:
    """Refuse the first line that is wrong."""
    for line, row in enumerate(table.text.split("\n"), start=table.first_line):
        place = f"line {line}:"
        if not row.strip():
            raise ValueError(f"{place} the line is blank; remove or correct it")
        try:
            cells = _split_row(row, table.delimiter)
        except ValueError as error:
            raise ValueError(f"{place} {error}") from None
        if len(cells) != table.n_columns:
            must = f"there must be {table.n_columns} cells, got {len(cells)}"
            raise ValueError(f"{place} {must}; is the file truncated?")
        for i in columns:
            number = _number(cells[i], table.decimal)
            if number is None or not math.isfinite(number):
                column = f"column {i} {table.labels[i]!r}" if table.labels else f"column {i}"
                got = f"got {files.clip(cells[i])!r}; correct the row"
                raise ValueError(f"{place} {column} must be a finite number, {got}")


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
