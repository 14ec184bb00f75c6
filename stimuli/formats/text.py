"""Text files: strict UTF-8, a sniffed delimiter, numbers by pandas, and the line of whatever is wrong."""

from __future__ import annotations

import csv
import io
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

BLANKS = r"\s+"
"""Stands for any run of blanks as the delimiter, as pandas spells it."""

COMMENT_MARKS = "#%"

HEAD_LINES = 50
"""Within so many lines the numbers must begin."""


@dataclass(frozen=True, slots=True)
class Table:
    """A delimited text, laid out but not yet converted.

    Parameters
    ----------
    text : str
        The rows of numbers, without what stands above them.
    first_line : int
        The line of the file on which `text` begins, from 1.
    delimiter : str
        One character, or `BLANKS`.
    decimal : str
        ``.`` or ``,``.
    labels : tuple of str or None
        The header, if there is one.
    n_columns : int
        Cells in the first row.
    """

    text: str
    first_line: int
    delimiter: str
    decimal: str
    labels: tuple[str, ...] | None
    n_columns: int


def read_text(path: Path) -> str:
    """Read a file as UTF-8 with or without byte-order mark, line ends made one.

    Parameters
    ----------
    path : Path
        The file.

    Returns
    -------
    str
        The text, lines ended by a line feed.

    Raises
    ------
    ValueError
        If the bytes are not UTF-8; the line is named.
    """
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
    """Find the delimiter, the decimal sign, the header and the first row.

    Parameters
    ----------
    text : str
        Text with lines ended by a line feed. Lines that begin with ``#`` or ``%`` may stand above the table.

    Returns
    -------
    Table
        The layout.

    Raises
    ------
    ValueError
        If there are no rows of numbers, or header and rows do not match.
    """
    head = text.rstrip().split("\n", HEAD_LINES)
    above: list[str] = []
    for i, row in enumerate(head[:HEAD_LINES]):
        content = row.strip()
        if content and content[0] not in COMMENT_MARKS and _is_row(content):
            return _table("\n".join(head[i:]), content, line=i + 1, above=above)
        above += [content] if content else []
    raise ValueError(f"got no row of numbers in the first {HEAD_LINES} lines; export the file again")


def read_numbers(table: Table, columns: Sequence[int]) -> NDArray[np.float64]:
    """Convert some columns of a table to numbers; every cell must be one.

    Parameters
    ----------
    table : Table
        The layout.
    columns : sequence of int
        The columns wanted, from 0.

    Returns
    -------
    ndarray of float64, shape (len(columns), n_rows)
        The numbers.

    Raises
    ------
    ValueError
        If a cell is no finite number, or a row has too many or too few cells; the line is named.
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
        raise _first_fault(table, columns) or ValueError(f"cannot be read as numbers ({reason})") from None
    if not np.isfinite(values).all() and (fault := _first_fault(table, columns)):
        raise fault
    return np.ascontiguousarray(values, dtype=np.float64)


def split_row(row: str, delimiter: str) -> list[str]:
    """Split one row into stripped cells.

    Parameters
    ----------
    row : str
        A line of the file.
    delimiter : str
        One character, or `BLANKS`.

    Returns
    -------
    list of str
        The cells.

    Raises
    ------
    ValueError
        If it has a cell that is too long for a number.
    """
    if delimiter == BLANKS:
        return row.split()
    try:
        return [cell.strip() for cell in next(csv.reader([row], delimiter=delimiter), [])]
    except csv.Error as error:
        raise ValueError(f"got a row that cannot be split into cells ({error}); is it a table?") from None


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
        raise ValueError(f"got {len(headers)} lines of text above the numbers, allowed is one header line")
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
