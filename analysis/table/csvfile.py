"""A file looked at before it is read, whether it is comma-separated UTF-8 text at all, and whole.

Spreadsheets, compressed files and other encodings are named as what they are, so that whoever brings them knows what
to do; nothing is guessed or converted.
"""

from __future__ import annotations

import csv
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

FOREIGN = {
    b"\x1f\x8b": "a gzip file, allowed is plain text; unpack it first",
    b"PK\x03\x04": "an Excel or other zipped file, allowed is plain text; save the sheet as CSV (UTF-8)",
    b"\xd0\xcf\x11\xe0": "an old Excel file, allowed is plain text; save the sheet as CSV (UTF-8)",
    b"\xff\xfe": "UTF-16 text, allowed is UTF-8; save it as CSV (UTF-8)",
    b"\xfe\xff": "UTF-16 text, allowed is UTF-8; save it as CSV (UTF-8)",
}
"""First bytes of files that are often taken for CSV -> what they are."""

BLOCK = 2**22
"""Bytes that are looked through at once."""

SEPARATORS = {";": "semicolons", "\t": "tabs", "|": "bars"}


def refuse_foreign(path: Path) -> None:
    """Refuse a file that is no text.

    Parameters
    ----------
    path : Path
        The file.

    Raises
    ------
    ValueError
        If it is of another kind, which its first bytes tell, or holds a zero byte.
    OSError
        If it cannot be opened.
    """
    with path.open("rb") as file:
        start = file.read(512)
    for mark, kind in FOREIGN.items():
        if start.startswith(mark):
            raise ValueError(f"{path.name}: got {kind}")
    if b"\0" in start:
        raise ValueError(f"{path.name}: got bytes that are no UTF-8 text (zeros); is it the right file? Save it as CSV")
    _refuse_zeros(path)


def read_header(path: Path) -> list[str]:
    """Read the column names.

    Parameters
    ----------
    path : Path
        The file.

    Returns
    -------
    list of str
        The cells of the first line; none if it is blank.
    """
    with path.open(encoding="utf-8-sig", newline="") as file:
        return next(csv.reader(file), [])


def tell_separator(header: Sequence[str]) -> str:
    """Say what separates the columns of a line that holds no comma.

    Parameters
    ----------
    header : sequence of str
        The first line, split at commas.

    Returns
    -------
    str
        A hint, or nothing where columns are separated by commas.

    Examples
    --------
    >>> tell_separator(["participant;rating"])
    'its columns are separated by semicolons: save it with commas, and with points as decimal signs'
    """
    if len(header) > 1:
        return ""
    found = max(SEPARATORS, key=header[0].count)
    if found not in header[0]:
        return "its first line must name the columns, separated by commas"
    return f"its columns are separated by {SEPARATORS[found]}: save it with commas, and with points as decimal signs"


def number_lines(path: Path, *, width: int) -> Sequence[int]:
    """Walk through a file and find the line that every row begins in.

    Parameters
    ----------
    path : Path
        The file.
    width : int
        Number of columns.

    Returns
    -------
    sequence of int
        Line of each row below the header; a cell in quotes may hold line breaks.

    Raises
    ------
    ValueError
        If a line has more or fewer cells than the header. pandas takes missing cells for empty ones: a file cut off
        while it was written would pass for a whole one.
    """
    with path.open(encoding="utf-8-sig", newline="") as file:
        reader, count, ended = csv.reader(file, strict=True), 0, 0
        for row in reader:
            count += 1
            if len(row) != width and row:
                raise ValueError(_tell_cells(len(row), width, where=f"{path.name}, line {reader.line_num}"))
        if reader.line_num == count:
            return range(2, count + 1)
        file.seek(0)
        reader, starts = csv.reader(file, strict=True), []
        for _ in reader:
            starts.append(ended + 1)
            ended = reader.line_num
    return starts[1:]


def _refuse_zeros(path: Path) -> None:
    passed = 0
    with path.open("rb") as file:
        while block := file.read(BLOCK):
            if (place := block.find(b"\0")) >= 0:
                line = passed + block.count(b"\n", 0, place) + 1
                raise ValueError(f"{path.name}, line {line}: got a zero byte, allowed is text; is the file damaged?")
            passed += block.count(b"\n")


def _tell_cells(got: int, width: int, *, where: str) -> str:
    advice = "put a cell that holds a comma in quotes" if got > width else "is the file cut off?"
    return f"{where}: got {got} cells, but the header has {width}; {advice}"
