"""Columns that tables may have, and tables read strictly against them: lines kept, every oddity refused by name.

Conventions: names are matched exactly. A column that is spelt almost like one of these is refused, because it would
otherwise be passed over; any other column is not used, and is named in the report's notes.

Names of tasks and columns that other layers define are repeated here as data; tests compare both. Those of reducers
and metrics come from their registries (`feel321.analysis.table.metrics`).

Cells are read as text, so that a participant called ``NA`` or ``007`` keeps that name; `read_column` then reads each as
the kind that its column is declared as, and names the lines that it cannot read. `refuse_lines` is the one form of such
a refusal. Spreadsheets, compressed files and other encodings are named as what they are, so that whoever brings them
knows what to do; nothing is guessed or converted.
"""

from __future__ import annotations

import csv
import re
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from pandas import DataFrame, Series


LOWEST, HIGHEST = 0.0, 100.0
"""The ends of every rating scale."""

LARGEST = 1e12
"""No metric is larger in size; squares of much larger numbers are no numbers any more."""

PAIRED, ANSWERED = "dissimilarity", "abx"
CHOSEN = ("triplet", "preference")
"""Scales on which one of two stimuli was chosen: 100 for the one named first, 0 for the other."""

APART = (PAIRED, ANSWERED, *CHOSEN)
"""Scales that enter no association: a metric describes one stimulus, and is larger or smaller."""

RECAST = "similarity_to_original"
"""Scale of dissimilarities from the original turned round: 100 less the dissimilarity is a rating of one stimulus."""

INTERACTION, SAMPLE = "interaction", "sample"
LABELS = (INTERACTION, SAMPLE)
"""What a recording is of, in the lab's words; maps of dissimilarities are made for each."""

ROLES = ("test", "reference", "anchor")
PAIR = "pair"
"""Role of a stimulus that is rated against another one than the reference."""

SURFACE = "surface"
"""Reference of a judgement that compares with the real surface."""

NAMING = ("recording", "reducer", "level")
"""Columns that together name a stimulus where there is no stimulus_id."""

IDENTITY = ("stimulus_id", "recording", "reducer")
AMPLITUDE, GAIN, SENSATION = "rms_m_s2", "gain", "sensation_level_db"
FACTS = (AMPLITUDE, GAIN, SENSATION)
"""Columns of a manifest that describe a stimulus and match it with nothing."""

ERROR, SOURCE = "level_error_db", "delivered_by"
"""Columns on what was delivered, beside the metrics."""

YES = frozenset({"true", "1", "yes"})
NO = frozenset({"false", "0", "no", ""})

PLANNED = ("spectral_match_bounded", "temporal_match")
"""Metrics of the primary analysis unless others are declared."""

STAND_INS = {"spectral_match_bounded": "spectral_match"}
"""Used for a planned metric that a manifest does not have."""


@dataclass(frozen=True, slots=True)
class ColumnInfo:
    """A column of a table; its kind is one of `feel321.analysis.table.schema.KINDS`, or empty for plain text."""

    meaning: str
    unit: str = ""
    kind: str = ""
    needed: bool = False
    used: bool = True


RATINGS: Mapping[str, ColumnInfo] = {
    "participant": ColumnInfo("who judged", kind="name", needed=True),
    "session": ColumnInfo("which visit of the participant"),
    "protocol": ColumnInfo("which task"),
    "block": ColumnInfo("which block of the session"),
    "trial": ColumnInfo("which trial of the block; with the stimulus, it occurs once", kind="name"),
    "repeat": ColumnInfo(
        "how many times the participant has judged it, counted from 1", kind="name"
    ),
    "stimulus_id": ColumnInfo("what was judged", kind="name", needed=True),
    "recording": ColumnInfo("as in the manifest"),
    "reducer": ColumnInfo("as in the manifest"),
    "level": ColumnInfo("as in the manifest"),
    "reference_id": ColumnInfo("what it was judged against: a stimulus, 'surface', or nothing"),
    "scale": ColumnInfo("what was asked, such as realism", kind="name", needed=True),
    "rating": ColumnInfo("the answer", "points from 0 to 100", kind="rating", needed=True),
    "response_time_s": ColumnInfo("from the end of playback to the answer", "s", kind="time"),
    "onset_s": ColumnInfo("start of playback, from the start of the session", "s", used=False),
    "underruns": ColumnInfo("interruptions of playback", "count", kind="count"),
    "rejected": ColumnInfo("whether the judgement does not count", "true or false", kind="flag"),
    "simulated": ColumnInfo("whether the participant is a program", "true or false", kind="flag"),
    ERROR: ColumnInfo("level of the vibration delivered, over that asked for", "dB", kind="error"),
    SOURCE: ColumnInfo("what the delivered metrics rest on: sensor, certificate, or nothing"),
    SENSATION: ColumnInfo("level over the participant's own threshold", "dB", used=False),
    "other_id": ColumnInfo(
        "the other stimulus of a choice (triplet, preference), felt after stimulus_id"
    ),
}
"""One row per judgement."""

MANIFEST: Mapping[str, ColumnInfo] = {
    **{name: ColumnInfo("what it is", kind="name", needed=True) for name in IDENTITY},
    "level": ColumnInfo("how its gain was chosen", kind="name"),
    "role": ColumnInfo("test, reference or anchor"),
    AMPLITUDE: ColumnInfo("root mean square as played", "m/s^2", kind="amplitude"),
    GAIN: ColumnInfo("m/s^2 played per m/s^2 recorded", kind="known"),
    SENSATION: ColumnInfo("over the detection threshold, as played", "dB", kind="known"),
    **{
        name: ColumnInfo("not used", used=False)
        for name in (
            "file", "rate_hz", "n_samples", "duration_s", "peak", "clipped", "sha256", "recording_sha256",
            "band_high_hz",
        )
    },
    "source": ColumnInfo(
        "what the recording was made from, where several are one and the same, turned, cut or edited"
    ),
    INTERACTION: ColumnInfo("what the tool did, such as tap or drag"),
    SAMPLE: ColumnInfo("the surface that was recorded"),
}  # fmt: skip
"""One row per stimulus."""

NOT_METRICS = frozenset({
    *IDENTITY, *LABELS, "level", "role", "source", "file", "sha256", "recording_sha256"
})  # fmt: skip

MOSTLY = 0.5
"""Share of a column's cells that are numbers where the column is meant to hold numbers."""

FOREIGN = {
    b"\x1f\x8b": "a gzip file; unpack it first",
    b"PK\x03\x04": "an Excel or other zipped file; save the sheet as CSV (UTF-8)",
    b"\xd0\xcf\x11\xe0": "an old Excel file; save the sheet as CSV (UTF-8)",
    b"\xff\xfe": "UTF-16 text; save it as CSV (UTF-8)",
    b"\xfe\xff": "UTF-16 text; save it as CSV (UTF-8)",
}
"""First bytes of files that are often taken for CSV -> what they are."""

BLOCK = 2**22
"""Bytes that are looked through at once."""

SEPARATORS = {";": "semicolons", "\t": "tabs", "|": "bars"}

CONTROL = r"[\x00-\x1f\x7f-\x9f\u2028\u2029]"

LONGEST = 60
"""Characters of a cell that a message shows."""

BLAMED_LINES = 3
"""How many line numbers a message names before it only counts."""


class Kind(NamedTuple):
    """A rule for the numbers of a column: its words, its test, and what an empty cell counts as, if it may be empty."""

    must: str
    do: str
    allows: Callable[[Series], Series]
    empty: float | None = float("nan")


KINDS: Mapping[str, Kind] = {
    "rating": Kind(
        "be 0 to 100", "rescale what was asked on another scale",
        lambda values: values.between(LOWEST, HIGHEST), None,
    ),
    "time": Kind("be 0 or more, in seconds, or empty", "", lambda values: ~(values < 0)),
    "count": Kind(
        "be a count (0, 1, 2, ...) or empty", "", lambda values: (values >= 0) & (values % 1 == 0), 0
    ),
    "amplitude": Kind("be 0 or more, in m/s², or empty", "", lambda values: ~(values < 0)),
    "metric": Kind(
        f"be no more than {LARGEST:g} in size", "",
        lambda values: ~(values.abs() > LARGEST),
    ),
    "error": Kind("be a number or empty", "", lambda values: ~(values.abs() > LARGEST)),
    "known": Kind("be a number or empty", "", lambda values: values.notna()),
}  # fmt: skip
"""Kinds of columns that hold numbers; others are ``name``, ``flag``, and plain text."""


def read_sheet(
    source: Path | DataFrame, what: str, schema: Mapping[str, ColumnInfo]
) -> tuple[DataFrame, list[str]]:
    """Read the columns that an analysis uses, as text, from a CSV file or a table in memory; `what` names it."""
    try:
        sheet, header = (
            _read_file(source, schema)
            if isinstance(source, Path)
            else _read_frame(source, what, schema)
        )
    except ValueError as error:  # headers may hold anything
        line = "".join(c if c.isprintable() else repr(c)[1:-1] for c in str(error))
        raise ValueError(line) from error
    filled = sheet != ""
    sheet = sheet[filled.any(axis=1)]
    if sheet.empty:
        raise ValueError(f"{what}: got no rows below the header; at least one is needed")
    bare = [name for name in map(str, sheet) if not schema[name].needed and not filled[name].any()]
    strangers = [shorten(name) for name in dict.fromkeys(header) if name not in schema and name]
    notes = [f"{what}: columns that are not used: {', '.join(strangers)}."] if strangers else []
    return sheet.drop(columns=bare), notes


def read_cells(source: Path | DataFrame) -> DataFrame:
    """Read all columns as text, unchecked."""
    import pandas as pd

    if isinstance(source, Path):
        return restore_cells(pd.read_csv(source, dtype=str, na_filter=False, encoding="utf-8-sig"))
    cells = source.astype(object).where(source.notna(), "").astype(str)
    return cells.set_axis(pd.RangeIndex(len(cells), name="row")).set_axis(
        list(map(str, source)), axis=1
    )


def restore_cells(sheet: DataFrame) -> DataFrame:
    """Take back what was put before texts so that no spreadsheet runs them."""
    for name in sheet:
        if sheet[name].str.startswith("'").any():
            sheet[name] = sheet[name].str.replace(r"^'(?='*[=+@\t\r-])", "", regex=True)
    return sheet


def read_header(path: Path) -> list[str]:
    """Read the column names."""
    with path.open(encoding="utf-8-sig", newline="") as file:
        return next(csv.reader(file), [])


def read_column(sheet: DataFrame, name: str, what: str, *, kind: str) -> None:
    """Read a column of text, if there is one, as the kind that it is declared as."""
    if name not in sheet or not kind:
        return
    if kind == "name":
        _check_names(sheet[name], what)
    elif kind == "flag":
        words = sheet[name].str.strip().str.lower()
        bad = sheet.loc[~words.isin(YES | NO), name]
        refuse_lines(bad, what, must="be true, false, 1, 0, yes, no or empty")
        sheet[name] = words.isin(YES)
    else:
        sheet[name] = _read_numbers(sheet[name], what, KINDS[kind])


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
    r"""Quote a cell for a message that is to stay one line.

    Examples
    --------
    >>> shorten("a\nb"), shorten("x" * 100)
    ("'a\\nb'", "'xxxxxxxxxxxxxxxxxxxxxxxxxxxx...xxxxxxxxxxxxxxxxxxxxxxxxxxxx'")
    """
    half = LONGEST // 2 - 2
    return repr(text if len(text) <= LONGEST else f"{text[:half]}...{text[-half:]}")


def _check_names(names: Series, what: str) -> None:
    """Refuse names that are empty, or that do not show what they are."""
    refuse_lines(names[names == ""], what, must="not be empty", do="name it")
    padded = names[names != names.str.strip()]
    refuse_lines(padded, what, must="not begin or end with a blank", do="remove it")
    broken = names[names.str.contains(CONTROL)]
    must = "not hold line breaks or other control characters"
    refuse_lines(broken, what, must=must, do="remove them")


def _read_numbers(cells: Series, what: str, kind: Kind) -> Series:
    import numpy as np
    import pandas as pd

    filled = cells if kind.empty is None else cells[cells != ""]
    numbers = pd.to_numeric(filled, errors="coerce").astype(np.float64)
    do = "correct it or leave the row out"
    refuse_lines(filled[~np.isfinite(numbers)], what, must="be a finite number", do=do)
    refuse_lines(filled[~kind.allows(numbers)], what, must=kind.must, do=kind.do)
    return numbers.reindex(cells.index, fill_value=kind.empty)


def _read_file(path: Path, schema: Mapping[str, ColumnInfo]) -> tuple[DataFrame, list[str]]:
    import pandas as pd

    what = path.name
    try:
        _refuse_foreign(path)
        header = read_header(path)
        if not header:
            state = "line 1 is blank" if path.stat().st_size else "the file is empty"
            needed = ", ".join(name for name, column in schema.items() if column.needed)
            raise ValueError(f"{what}: {state}; its first line must name the columns {needed}")
        _check_header(header, f"{what}, line 1", schema)
        starts = _number_lines(path, width=len(header))
        wanted = [name for name, column in schema.items() if column.used and name in header]
        places = sorted(header.index(name) for name in wanted)
        with warnings.catch_warnings():
            warnings.simplefilter("error", pd.errors.ParserWarning)
            # By place, because columns that are not used may share a name.
            sheet = pd.read_csv(
                path, header=0, names=range(len(header)), usecols=places, dtype=str, na_filter=False,
                skip_blank_lines=False, index_col=False, encoding="utf-8-sig",
            )  # fmt: skip
    except UnicodeDecodeError as error:
        place = f"{error.reason} at byte {error.start}"
        raise ValueError(f"{what}: not UTF-8 text ({place}); save it as CSV (UTF-8)") from None
    except (pd.errors.ParserError, pd.errors.ParserWarning, csv.Error) as error:
        reason = " ".join(str(error).split())
        raise ValueError(
            f"{what}: not a regular CSV file, correct lines or quotes ({reason})"
        ) from None
    sheet = restore_cells(sheet)
    sheet.index = pd.Index(starts, name="line")
    return sheet.set_axis([header[place] for place in places], axis=1)[wanted], header


def _read_frame(
    frame: DataFrame, what: str, schema: Mapping[str, ColumnInfo]
) -> tuple[DataFrame, list[str]]:
    header = list(map(str, frame))
    _check_header(header, what, schema)
    wanted = [name for name, column in schema.items() if column.used and name in header]
    return read_cells(frame)[wanted], header


def _check_header(header: Sequence[str], where: str, schema: Mapping[str, ColumnInfo]) -> None:
    # A misspelt column would be passed over in silence, and with it what it says: that judgements are rejected, say.
    plain = {_simplify(name): name for name in schema}
    for name in header:
        meant = plain.get(_simplify(name))
        if meant and name != meant:
            raise ValueError(
                f"{where}: column {shorten(name)} must be spelt '{meant}'; rename or remove it"
            )
    doubled = sorted({name for name in header if name in schema and header.count(name) > 1})
    if doubled:
        raise ValueError(f"{where}: column {', '.join(doubled)} appears more than once; keep one")
    missing = [name for name, column in schema.items() if column.needed and name not in header]
    if missing:
        hint = _explain_separator(header) or "add it, or rename the one that holds it"
        got = shorten(", ".join(header))
        raise ValueError(f"{where}: column {', '.join(missing)} is missing; got {got}; {hint}")


def _explain_separator(header: Sequence[str]) -> str:
    """Say what separates the columns of a line that holds no comma."""
    if len(header) > 1:
        return ""
    found = max(SEPARATORS, key=header[0].count)
    if found not in header[0]:
        return "its first line must name the columns, separated by commas"
    return f"its columns are separated by {SEPARATORS[found]}: save it with commas, and with points as decimal signs"


def _simplify(name: str) -> str:
    return re.sub(r"[\s_.-]+", "", name).casefold()


def _refuse_foreign(path: Path) -> None:
    """Refuse a file that is not text."""
    if path.exists() and not (path.is_file() or path.is_dir()):
        raise ValueError(
            f"{path.name}: must be a regular file, got a pipe or device; copy its content into a file"
        )
    with path.open("rb") as file:
        start, passed = file.read(512), 0
        for mark, kind in FOREIGN.items():
            if start.startswith(mark):
                raise ValueError(f"{path.name}: must be plain UTF-8 text, got {kind}")
        if b"\0" in start:
            raise ValueError(
                f"{path.name}: must be UTF-8 text, got other bytes (zeros); is it the right file? Save it as CSV"
            )
        file.seek(0)
        while block := file.read(BLOCK):
            if (place := block.find(b"\0")) >= 0:
                line = passed + block.count(b"\n", 0, place) + 1
                raise ValueError(
                    f"{path.name}, line {line}: must be text, got a zero byte; is the file damaged?"
                )
            passed += block.count(b"\n")


def _number_lines(path: Path, *, width: int) -> Sequence[int]:
    """Walk through a file and find the line that every row begins in."""
    with path.open(encoding="utf-8-sig", newline="") as file:
        reader, ends = csv.reader(file, strict=True), [0]
        for row in reader:
            ends.append(reader.line_num)
            if len(row) != width and row:
                advice = (
                    "put a cell that holds a comma in quotes"
                    if len(row) > width
                    else "is the file cut off?"
                )
                raise ValueError(
                    f"{path.name}, line {ends[-1]}: must have {width} cells like the header, got {len(row)}; {advice}"
                )
    return [end + 1 for end in ends[1:-1]]
