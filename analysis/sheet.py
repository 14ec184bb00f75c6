"""A CSV file read strictly: text cells, line numbers kept, every oddity refused by name.

Cells stay text, so that a participant called ``NA`` or ``007`` stays who they are; numbers are read by
`read_numbers` and yes/no cells by `read_flags`, which name the lines that they cannot read.
"""

from __future__ import annotations

import csv
import warnings
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from pandas import DataFrame, Series

YES = frozenset({"true", "1", "yes"})
NO = frozenset({"false", "0", "no", ""})
BLAMED_LINES = 3
"""How many line numbers a message names before it only counts."""


def read_sheet(path: Path, *, required: Sequence[str], optional: Sequence[str] = ()) -> DataFrame:
    """Read the named columns of a CSV file as text.

    Parameters
    ----------
    path : Path
        RFC 4180 file, UTF-8 with or without a byte-order mark, comma-separated, first line the column names.
    required : sequence of str
        Columns that must be there.
    optional : sequence of str
        Columns that are read if they are there; all others are ignored.

    Returns
    -------
    DataFrame
        The columns found, text only, indexed by line number (the header is line 1); blank lines are no rows.

    Raises
    ------
    ValueError
        If the file is empty or not UTF-8, a column is missing or doubled, or a line has too few or too
        many cells.
    OSError
        If the file cannot be opened.
    """
    import pandas as pd

    try:
        header = _read_header(path)
        wanted = [name for name in (*required, *optional) if name in header]
        _check_header(header, path, required=required)
        _refuse_cut_lines(path, width=len(header))
        sheet = _read_cells(path)
    except UnicodeDecodeError as error:
        place = f"{error.reason} at byte {error.start}"
        raise ValueError(f"{path.name}: not UTF-8 text ({place}); save it as UTF-8") from None
    except (pd.errors.ParserError, pd.errors.ParserWarning, csv.Error) as error:
        reason = " ".join(str(error).split())
        raise ValueError(f"{path.name}: not a regular CSV file, mend lines or quotes ({reason})") from None
    sheet.index = pd.RangeIndex(2, len(sheet) + 2, name="line")
    sheet = sheet.loc[(sheet != "").any(axis=1), wanted]
    if sheet.empty:
        raise ValueError(f"{path.name}: got no rows below the header; at least one is needed")
    return sheet


def read_numbers(cells: Series, what: str) -> Series:
    """Read text cells as finite numbers.

    Parameters
    ----------
    cells : Series of str
        Indexed by line number, named by its column.
    what : str
        The file's name, for the message.

    Returns
    -------
    Series of float
        The same cells as numbers.

    Raises
    ------
    ValueError
        If a cell is empty, not a number, or not finite; names the lines.
    """
    import numpy as np
    import pandas as pd

    numbers = pd.to_numeric(cells, errors="coerce").astype(np.float64)
    bad = cells[~np.isfinite(numbers)]
    refuse_lines(bad, what, why=f"in column '{cells.name}', allowed is a finite number")
    return numbers


def read_flags(cells: Series, what: str) -> Series:
    """Read text cells as yes or no; an empty cell is a no.

    Parameters
    ----------
    cells : Series of str
        Indexed by line number, named by its column.
    what : str
        The file's name, for the message.

    Returns
    -------
    Series of bool
        True for true, 1 and yes, in capitals or not.

    Raises
    ------
    ValueError
        If a cell is anything else; names the lines.
    """
    words = cells.str.strip().str.lower()
    bad = cells[~words.isin(YES | NO)]
    refuse_lines(bad, what, why=f"in column '{cells.name}', allowed is true, false, 1, 0, yes, no or nothing")
    return words.isin(YES)


def refuse_lines(bad: Series, what: str, *, why: str) -> None:
    """Raise ValueError naming the lines of the bad cells, if there are any.

    Parameters
    ----------
    bad : Series
        The offending cells, indexed by line number.
    what : str
        The file's name.
    why : str
        What is wrong with them and what is allowed.

    Raises
    ------
    ValueError
        If `bad` is not empty.
    """
    if bad.empty:
        return
    named = ", ".join(str(line) for line in bad.index[:BLAMED_LINES])
    more = f" and {len(bad) - BLAMED_LINES} more" if len(bad) > BLAMED_LINES else ""
    lines = "line" if len(bad) == 1 else "lines"
    first = bad.iloc[0]
    got = repr(first) if isinstance(first, str) else f"{first:g}"
    raise ValueError(f"{what}, {lines} {named}{more}: got {got} {why}")


def _read_header(path: Path) -> list[str]:
    with path.open(encoding="utf-8-sig", newline="") as file:
        return next(csv.reader(file), [])


def _refuse_cut_lines(path: Path, *, width: int) -> None:
    # pandas takes missing cells for empty ones: a file cut off while it was written would pass for a whole one.
    with path.open(encoding="utf-8-sig", newline="") as file:
        reader = csv.reader(file, strict=True)
        for row in reader:
            if 0 < len(row) < width:
                cells = f"got {len(row)} cells, but the header has {width}"
                raise ValueError(f"{path.name}, line {reader.line_num}: {cells}; is the file cut off?")


def _read_cells(path: Path) -> DataFrame:
    import pandas as pd

    with warnings.catch_warnings():
        warnings.simplefilter("error", pd.errors.ParserWarning)
        return pd.read_csv(
            path, dtype=str, na_filter=False, skip_blank_lines=False, index_col=False, encoding="utf-8-sig"
        )


def _check_header(header: Sequence[str], path: Path, *, required: Sequence[str]) -> None:
    if not header:
        state = "line 1 is blank" if path.stat().st_size else "the file is empty"
        names = ", ".join(required)
        raise ValueError(f"{path.name}: {state}; its first line must name the columns {names}")
    doubled = sorted({name for name in header if header.count(name) > 1})
    if doubled:
        raise ValueError(f"{path.name}: column {', '.join(doubled)} appears more than once; keep one")
    missing = [name for name in required if name not in header]
    if missing:
        hint = "; separate the columns by commas" if len(header) == 1 else ""
        got = ", ".join(header)
        raise ValueError(f"{path.name}: column {', '.join(missing)} is missing; got {got}{hint}")
