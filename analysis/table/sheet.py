"""A CSV file read strictly: text cells, line numbers kept, every oddity refused by name.

Cells stay text, so that a participant called ``NA`` or ``007`` stays who they are; numbers are read by
`read_numbers`, those that may be unknown by `read_known`, and yes/no cells by `read_flags`, which name the lines that
they cannot read.
"""

from __future__ import annotations

import csv
import re
import warnings
from typing import TYPE_CHECKING

from analysis.table.csvfile import number_lines, read_header, refuse_foreign, tell_separator
from analysis.table.schema import list_needed

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from pandas import DataFrame, Series

    from analysis.table.schema import Column

YES = frozenset({"true", "1", "yes"})
NO = frozenset({"false", "0", "no", ""})
CONTROL = re.compile(r"[\x00-\x1f\x7f-\x9f\u2028\u2029]")
LARGEST = 1e12
"""What no metric reaches in size; squares of much larger numbers are no numbers any more."""

LONGEST = 60
"""Characters of a cell that a message shows."""

BLAMED_LINES = 3
"""How many line numbers a message names before it only counts."""


def read_sheet(path: Path, schema: Mapping[str, Column]) -> tuple[DataFrame, list[str]]:
    """Read the columns of a CSV file that an analysis uses, as text.

    Parameters
    ----------
    path : Path
        RFC 4180 file, UTF-8 with or without a byte-order mark, comma-separated, first line the column names.
    schema : Mapping of str to Column
        The columns that it may have.

    Returns
    -------
    sheet : DataFrame
        The columns found that are used, text only, indexed by line number (the header is line 1); blank lines are no
        rows, and a column that need not be there and is empty throughout is as if it were not.
    notes : list of str
        Which columns are not used.

    Raises
    ------
    ValueError
        If the file is empty or no UTF-8 text, a column is missing, misspelt or doubled, or a line has too few or too
        many cells.
    OSError
        If the file cannot be opened.
    """
    import pandas as pd

    try:
        refuse_foreign(path)
        header = read_header(path)
        _check_header(header, path, schema)
        sheet = _read_cells(path, header, [name for name, column in schema.items() if column.used and name in header])
    except UnicodeDecodeError as error:
        place = f"{error.reason} at byte {error.start}"
        raise ValueError(f"{path.name}: not UTF-8 text ({place}); save it as CSV (UTF-8)") from None
    except (pd.errors.ParserError, pd.errors.ParserWarning, csv.Error) as error:
        reason = " ".join(str(error).split())
        raise ValueError(f"{path.name}: not a regular CSV file, mend lines or quotes ({reason})") from None
    filled = sheet != ""
    sheet = sheet[filled.any(axis=1)]
    if sheet.empty:
        raise ValueError(f"{path.name}: got no rows below the header; at least one is needed")
    bare = [name for name in map(str, sheet) if not schema[name].needed and not filled[name].any()]
    return sheet.drop(columns=bare), _note_unused(header, path.name, schema)


def _note_unused(header: Sequence[str], what: str, schema: Mapping[str, Column]) -> list[str]:
    strangers = [shorten(name) for name in dict.fromkeys(header) if name not in schema and name]
    return [f"{what}: columns that are not used: {', '.join(strangers)}."] if strangers else []


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
    refuse_lines(bad, what, why=f"in column '{cells.name}', allowed is a finite number; mend it or leave the row out")
    return numbers


def read_known(cells: Series, what: str) -> Series:
    """Read text cells as finite numbers where there is one.

    Parameters
    ----------
    cells : Series of str
        Indexed by line number, named by its column.
    what : str
        The file's name, for the message.

    Returns
    -------
    Series of float
        The same cells as numbers; NaN where they are empty.

    Raises
    ------
    ValueError
        If a cell holds anything else; names the lines.
    """
    return read_numbers(cells[cells != ""], what).reindex(cells.index)


def read_metric(cells: Series, what: str) -> Series:
    """Read text cells as a match metric where there is one.

    Parameters
    ----------
    cells : Series of str
        Indexed by line number, named by its column.
    what : str
        The file's name, for the message.

    Returns
    -------
    Series of float
        The same cells as numbers; NaN where they are empty.

    Raises
    ------
    ValueError
        If a cell holds anything else, or a number that no metric reaches; names the lines.
    """
    values = read_known(cells, what)
    huge = cells[values.abs() > LARGEST]
    refuse_lines(huge, what, why=f"in column '{cells.name}', allowed is 1 or less and no more than {LARGEST:g} in size")
    return values


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
    got = shorten(first) if isinstance(first, str) else f"{first:g}"
    raise ValueError(f"{what}, {lines} {named}{more}: got {got} {why}")


def check_names(names: Series, what: str) -> None:
    """Refuse names that are empty, or that do not show what they are.

    Parameters
    ----------
    names : Series of str
        Indexed by line number, named by its column.
    what : str
        The file's name, for the message.

    Raises
    ------
    ValueError
        If a name is empty, begins or ends with a blank, or holds a line break or another control character.
    """
    told = f"in column '{names.name}', which must not"
    refuse_lines(names[names == ""], what, why=f"{told} be empty; name it")
    each = list(names.unique())
    padded = names[names.isin([name for name in each if name != name.strip()])]
    refuse_lines(padded, what, why=f"{told} begin or end with a blank; remove it")
    broken = names[names.isin([name for name in each if CONTROL.search(name)])]
    refuse_lines(broken, what, why=f"{told} hold line breaks or other control characters; remove them")


def shorten(text: str) -> str:
    r"""Quote a cell for a message that is to stay one line.

    Parameters
    ----------
    text : str
        The cell.

    Returns
    -------
    str
        In quotes, control characters escaped, the middle of a long one left out.

    Examples
    --------
    >>> shorten("a\nb"), shorten("x" * 100)
    ("'a\\nb'", "'xxxxxxxxxxxxxxxxxxxxxxxxxxxx...xxxxxxxxxxxxxxxxxxxxxxxxxxxx'")
    """
    return repr(text if len(text) <= LONGEST else f"{text[: LONGEST // 2 - 2]}...{text[2 - LONGEST // 2 :]}")


def _read_cells(path: Path, header: Sequence[str], wanted: Sequence[str]) -> DataFrame:
    import pandas as pd

    starts = number_lines(path, width=len(header))
    places = sorted(header.index(name) for name in wanted)
    with warnings.catch_warnings():
        warnings.simplefilter("error", pd.errors.ParserWarning)
        # By place, because columns that are not used may share a name.
        sheet = pd.read_csv(
            path, header=0, names=range(len(header)), usecols=places, dtype=str, na_filter=False,
            skip_blank_lines=False, index_col=False, encoding="utf-8-sig",
        )  # fmt: skip
    sheet.index = pd.Index(starts, name="line")
    return sheet.set_axis([header[place] for place in places], axis=1)[list(wanted)]


def _check_header(header: Sequence[str], path: Path, schema: Mapping[str, Column]) -> None:
    needed = list_needed(schema)
    if not header:
        state = "line 1 is blank" if path.stat().st_size else "the file is empty"
        raise ValueError(f"{path.name}: {state}; its first line must name the columns {', '.join(needed)}")
    _refuse_misspelt(header, path.name, schema)
    doubled = sorted({name for name in header if name in schema and header.count(name) > 1})
    if doubled:
        raise ValueError(f"{path.name}: column {', '.join(doubled)} appears more than once; keep one")
    missing = [name for name in needed if name not in header]
    if missing:
        hint = tell_separator(header) or "add it, or rename the one that holds it"
        got = shorten(", ".join(header))
        raise ValueError(f"{path.name}, line 1: column {', '.join(missing)} is missing; got {got}; {hint}")


def _refuse_misspelt(header: Sequence[str], what: str, schema: Mapping[str, Column]) -> None:
    # It would be passed over in silence, and with it what it says: that judgements are rejected, for example.
    plain = {_simplify(name): name for name in schema}
    for name in header:
        meant = plain.get(_simplify(name))
        if meant and name != meant:
            raise ValueError(f"{what}, line 1: got column {shorten(name)}, allowed is '{meant}'; rename or remove it")


def _simplify(name: str) -> str:
    return re.sub(r"[\s_.-]+", "", name).casefold()
