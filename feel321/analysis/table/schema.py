"""Columns that tables may have, and tables read strictly against them: lines kept, every oddity refused by name.

Conventions: names are matched exactly. A column that is spelt almost like one of these is refused, because it would
otherwise be passed over; any other column is not used, and is named in the report's notes. What columns mean is in
`dictionary.csv`. Names of tasks and columns that other layers define are repeated here as data; tests compare both.

Cells are read as text, so that a participant called ``NA`` or ``007`` keeps that name; `read_column` then reads each as
the kind that its column is declared as, and names the lines that it cannot read. `refuse_lines` is the one form of such
a refusal. Spreadsheets, compressed files and other encodings are named as what they are; nothing is guessed.
"""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
from pandas import DataFrame, Series

from feel321.files import clip, decode, read_bytes

LOWEST, HIGHEST = 0.0, 100.0  # The ends of every rating scale
# No metric is larger in size; squares of much larger numbers are no numbers any more
LARGEST = 1e12
PAIRED, ANSWERED = "dissimilarity", "abx"
# Scales on which one of two stimuli was chosen: 100 for the one named first, 0 for the other
CHOSEN = ("triplet", "preference")
# Scales that enter no association: a metric describes one stimulus, and is larger or smaller
APART = (PAIRED, ANSWERED, *CHOSEN)
# Scale of dissimilarities from the original turned round: 100 less the dissimilarity is a rating of one stimulus
RECAST = "similarity_to_original"
ROLES = ("test", "reference", "anchor")
PAIR = "pair"  # Role of a stimulus that is rated against another one than the reference
SURFACE = "surface"  # Reference of a judgement that compares with the real surface
# Columns that together name a stimulus where there is no stimulus_id
NAMING = ("recording", "reducer", "level")
AMPLITUDE, GAIN, SENSATION = "rms_m_s2", "gain", "sensation_level_db"
# Columns of a manifest that describe a stimulus and match it with nothing
FACTS = (AMPLITUDE, GAIN, SENSATION)
# Columns on what was delivered, beside the metrics
ERROR, SOURCE = "level_error_db", "delivered_by"
YES = frozenset({"true", "1", "yes"})
NO = frozenset({"false", "0", "no", ""})
# Metrics of the primary analysis unless others are declared
PLANNED = ("spectral_match_bounded", "temporal_match")
# Used for a planned metric that a manifest does not have
STAND_INS = {"spectral_match_bounded": "spectral_match"}
# Kinds of columns, besides those that hold numbers (`NUMBERS`)
TEXT, NAME, FLAG, METRIC, UNUSED = "text", "name", "flag", "metric", "unused"
# Column of a table with a row per judgement -> its kind
RATINGS: Mapping[str, str] = {
    "participant": NAME, "session": TEXT, "protocol": TEXT, "block": TEXT, "trial": NAME, "repeat": NAME,
    "stimulus_id": NAME, **dict.fromkeys(NAMING, TEXT), "reference_id": TEXT, "scale": NAME, "rating": "rating",
    "response_time_s": "time", "onset_s": UNUSED, "underruns": "count", "rejected": FLAG, "simulated": FLAG,
    ERROR: "error", SOURCE: TEXT, SENSATION: UNUSED, "other_id": TEXT,
}  # fmt: skip
# Column of a table with a row per stimulus -> its kind
MANIFEST: Mapping[str, str] = {
    "stimulus_id": NAME, **dict.fromkeys(NAMING, NAME), "role": TEXT, "source": TEXT,
    AMPLITUDE: "amplitude", GAIN: "known", SENSATION: "known",
    **dict.fromkeys(("file", "rate_hz", "n_samples", "duration_s", "peak", "clipped"), UNUSED),
    **dict.fromkeys(("sha256", "recording_sha256", "band_high_hz"), UNUSED),
}  # fmt: skip
# Columns that ratings and a manifest must have
NEEDED = {"participant", "stimulus_id", "scale", "rating"}, {"stimulus_id", "recording", "reducer"}
MOSTLY = 0.5  # Share of a column's cells that are numbers where the column is meant to hold numbers
FOREIGN = {
    b"\x1f\x8b": "a gzip file; unpack it first",
    b"PK\x03\x04": "an Excel or other zipped file; save the sheet as CSV (UTF-8)",
    b"\xd0\xcf\x11\xe0": "an old Excel file; save the sheet as CSV (UTF-8)",
}  # first bytes of files that are often taken for CSV -> what they are
SEPARATORS = {";": "semicolons", "\t": "tabs", "|": "bars"}
CONTROL = r"[\x00-\x1f\x7f-\x9f\u2028\u2029]"
BLAMED_LINES = 3  # How many line numbers a message names before it only counts


class Rule(NamedTuple):
    """A rule for the numbers of a column: its words, its test, and what an empty cell counts as, if it may be empty."""

    must: str
    allows: Callable[[Series], Series]
    empty: float | None = float("nan")
    do: str = ""


# Kind of a column that holds numbers -> its rule
NUMBERS: Mapping[str, Rule] = {
    "rating": Rule(
        "be 0 to 100", lambda values: values.between(LOWEST, HIGHEST), None, "rescale what was asked on another scale"
    ),
    "time": Rule("be 0 or more, in seconds, or empty", lambda values: ~(values < 0)),
    "count": Rule("be a count (0, 1, 2, ...) or empty", lambda values: (values >= 0) & (values % 1 == 0), 0),
    "amplitude": Rule("be 0 or more, in m/s², or empty", lambda values: ~(values < 0)),
    METRIC: Rule(f"be no more than {LARGEST:g} in size", lambda values: ~(values.abs() > LARGEST)),
    "error": Rule("be a number or empty", lambda values: ~(values.abs() > LARGEST)),
    "known": Rule("be a number or empty", lambda values: values.notna()),
}  # fmt: skip


def read_sheet(
    source: Path | DataFrame, what: str, kinds: Mapping[str, str], *, needed: set[str]
) -> tuple[DataFrame, list[str]]:
    """Read the columns that an analysis uses, as text, from a CSV file or a table in memory; `what` names it.

    Columns that are empty throughout are left out unless they are needed.
    """
    ordered = [name for name in kinds if name in needed]
    try:
        if isinstance(source, Path):
            cells = _read_file(source, kinds, ordered)
        else:
            cells = read_cells(source)
            _check_header(list(map(str, cells)), what, kinds, needed=ordered)
    except ValueError as error:  # headers may hold anything
        line = "".join(c if c.isprintable() else repr(c)[1:-1] for c in str(error))
        raise ValueError(line) from error
    sheet = cells[[name for name, kind in kinds.items() if kind != UNUSED and name in cells]]
    filled = sheet != ""
    sheet = sheet[filled.any(axis=1)]
    if sheet.empty:
        raise ValueError(f"{what}: got no rows below the header; at least one is needed")
    strangers = [name for name in dict.fromkeys(map(str, cells)) if name not in kinds and name]
    listed = ", ".join(map(shorten, strangers))
    notes = [f"{what}: columns that are not used: {listed}."] if strangers else []
    bare = [name for name in map(str, sheet) if name not in needed and not filled[name].any()]
    return sheet.drop(columns=bare), notes


def read_cells(source: Path | DataFrame) -> DataFrame:
    """Read all columns as text, unchecked; what was put before texts so that no spreadsheet runs them is left out."""
    if isinstance(source, Path):
        cells = pd.read_csv(source, dtype=str, na_filter=False, encoding="utf-8-sig")
        return restore_cells(cells)
    cells = source.astype(object).where(source.notna(), "").astype(str)
    cells.index, cells.columns = pd.RangeIndex(len(cells), name="row"), list(map(str, source))
    return cells


def restore_cells(sheet: DataFrame) -> DataFrame:
    """Take back what was put before texts so that no spreadsheet runs them."""
    return sheet.replace(r"^'(?='*[=+@\t\r-])", "", regex=True)


def read_column(sheet: DataFrame, name: str, what: str, *, kind: str) -> None:
    """Read a column of text, if there is one, as the kind that it is declared as."""
    if name not in sheet:
        return
    cells = sheet[name]
    if kind == NAME:
        rules = (
            (cells == "", "not be empty", "name it"),
            (cells != cells.str.strip(), "not begin or end with a blank", "remove it"),
            (cells.str.contains(CONTROL), "not hold control characters", "remove them"),
        )
        for bad, must, do in rules:
            refuse_lines(cells[bad], what, must=must, do=do)
    elif kind == FLAG:
        words = cells.str.strip().str.lower()
        must = "be true, false, 1, 0, yes, no or empty"
        refuse_lines(cells[~words.isin(YES | NO)], what, must=must)
        sheet[name] = words.isin(YES)
    elif kind != TEXT:
        rule = NUMBERS[kind]
        filled = cells if rule.empty is None else cells[cells != ""]
        numbers = pd.to_numeric(filled, errors="coerce").astype(np.float64)
        do = "correct it or leave the row out"
        refuse_lines(filled[~np.isfinite(numbers)], what, must="be a finite number", do=do)
        refuse_lines(filled[~rule.allows(numbers)], what, must=rule.must, do=rule.do)
        sheet[name] = numbers.reindex(cells.index, fill_value=rule.empty)


def refuse_lines(bad: Series, what: str, *, must: str, do: str = "") -> None:
    """Raise ValueError naming the lines of the bad cells, if there are any."""
    if bad.empty:
        return
    place = str(bad.index.name or "row") + ("" if len(bad) == 1 else "s")
    named = ", ".join(str(line) for line in bad.index[:BLAMED_LINES])
    more = f" and {len(bad) - BLAMED_LINES} more" if len(bad) > BLAMED_LINES else ""
    first = bad.iloc[0]
    got = shorten(first) if isinstance(first, str) else f"{first:g}"
    advice = f"; {do}" if do else ""
    raise ValueError(f"{what}, {place} {named}{more}: {bad.name} must {must}, got {got}{advice}")


def refuse_doubled(sheet: DataFrame, name: str, what: str) -> None:
    """Refuse a table that lists something twice."""
    doubled = sheet.loc[sheet[name].duplicated(), name]
    refuse_lines(doubled, what, must="be listed once", do="keep one of the lines")


def shorten(text: str) -> str:
    """Quote a cell for a message that is to stay one line."""
    return repr(clip(text))


def _read_file(path: Path, kinds: Mapping[str, str], needed: Sequence[str]) -> DataFrame:
    """Read a file's cells; the index says in which line a row begins."""
    what, content = path.name, read_bytes(path)
    for mark, kind in FOREIGN.items():
        if content.startswith(mark):
            raise ValueError(f"{what}: must be plain UTF-8 text, got {kind}")
    reader = csv.reader(io.StringIO(decode(content, what), newline=""), strict=True)
    try:
        header, line, rows = next(reader, []), reader.line_num + 1, {}
        for row in reader:
            rows[line, reader.line_num] = row
            line = reader.line_num + 1
    except csv.Error as error:
        why = f"not a regular CSV file, correct lines or quotes ({error})"
        raise ValueError(f"{what}: {why}") from None
    if not header:
        state = "line 1 is blank" if content else "the file is empty"
        must = f"its first line must name the columns {', '.join(needed)}"
        raise ValueError(f"{what}: {state}; {must}")
    # A row of another length says most about a header that is no list of names.
    _check_header(header, f"{what}, line 1", kinds, needed=needed)
    kept = {place: row for place, row in rows.items() if row}
    for (_, end), row in kept.items():
        if len(row) != len(header):
            cut = len(row) < len(header)
            do = "is the file cut off?" if cut else "put a cell that holds a comma in quotes"
            must = f"must have {len(header)} cells like the header, got {len(row)}"
            raise ValueError(f"{what}, line {end}: {must}; {do}")
    index = pd.Index([start for start, _ in kept], name="line", dtype=int)
    return restore_cells(pd.DataFrame([*kept.values()], columns=header, index=index, dtype=str))


def _check_header(
    header: Sequence[str], where: str, kinds: Mapping[str, str], *, needed: Sequence[str]
) -> None:
    # A misspelt column would be passed over in silence, and with it what it says: that judgements are rejected, say.
    def simplify(name: str) -> str:
        return re.sub(r"[\s_.-]+", "", name).casefold()

    plain = {simplify(name): name for name in kinds}
    for name in header:
        meant = plain.get(simplify(name), name)
        if name != meant:
            must = f"must be spelt '{meant}'; rename or remove it"
            raise ValueError(f"{where}: column {shorten(name)} {must}")
    doubled = sorted({name for name in header if name in kinds and header.count(name) > 1})
    if doubled:
        raise ValueError(f"{where}: column {', '.join(doubled)} appears more than once; keep one")
    if missing := [name for name in needed if name not in header]:
        hint = "add it, or rename the one that holds it"
        if len(header) == 1:
            hint = "its first line must name the columns, separated by commas"
            found = max(SEPARATORS, key=header[0].count)
            if found in header[0]:
                do = "save it with commas, and with points as decimal signs"
                hint = f"its columns are separated by {SEPARATORS[found]}: {do}"
        got = shorten(", ".join(header))
        raise ValueError(f"{where}: column {', '.join(missing)} is missing; got {got}; {hint}")
