"""A CSV file read strictly against a schema: text cells, line numbers kept, every oddity refused by name.

Cells stay text, so that a participant called ``NA`` or ``007`` stays who they are; numbers are read by
`read_numbers`, those that may be unknown by `read_known`, and yes/no cells by `read_flags`, which name the lines that
they cannot read.

Spreadsheets, compressed files and other encodings are named as what they are, so that whoever brings them knows what
to do; nothing is guessed or converted.
"""

from __future__ import annotations

import csv
import re
import unicodedata
import warnings
from collections import Counter
from typing import TYPE_CHECKING

from feel321.analysis.table.schema import list_needed
from feel321.analysis.words import tell_name
from feel321.protocols.abx import ABX
from feel321.protocols.dissimilarity import DISSIMILARITY

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence
    from pathlib import Path

    from pandas import DataFrame, Series

    from feel321.analysis.table.schema import Column

# A file looked at before it is read, whether it is comma-separated UTF-8 text at all, and whole.

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
    """Refuse a file that is no text."""
    with path.open("rb") as file:
        start = file.read(512)
    for mark, kind in FOREIGN.items():
        if start.startswith(mark):
            raise ValueError(f"{path.name}: got {kind}")
    if b"\0" in start:
        raise ValueError(
            f"{path.name}: got bytes that are no UTF-8 text (zeros); is it the right file? Save it as CSV"
        )
    _refuse_zeros(path)


def read_header(path: Path) -> list[str]:
    """Read the column names."""
    with path.open(encoding="utf-8-sig", newline="") as file:
        return next(csv.reader(file), [])


def tell_separator(header: Sequence[str]) -> str:
    """Say what separates the columns of a line that holds no comma.

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
    """Walk through a file and find the line that every row begins in."""
    with path.open(encoding="utf-8-sig", newline="") as file:
        reader, count, ended = csv.reader(file, strict=True), 0, 0
        for row in reader:
            count += 1
            if len(row) != width and row:
                raise ValueError(
                    _tell_cells(len(row), width, where=f"{path.name}, line {reader.line_num}")
                )
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
                raise ValueError(
                    f"{path.name}, line {line}: got a zero byte, allowed is text; is the file damaged?"
                )
            passed += block.count(b"\n")


def _tell_cells(got: int, width: int, *, where: str) -> str:
    advice = "put a cell that holds a comma in quotes" if got > width else "is the file cut off?"
    return f"{where}: got {got} cells, but the header has {width}; {advice}"


# A CSV file read strictly: text cells, line numbers kept, every oddity refused by name.

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
    """Read the columns of a CSV file that an analysis uses, as text."""
    import pandas as pd

    try:
        refuse_foreign(path)
        header = read_header(path)
        _check_header(header, path, schema)
        sheet = _read_cells(
            path,
            header,
            [name for name, column in schema.items() if column.used and name in header],
        )
    except UnicodeDecodeError as error:
        place = f"{error.reason} at byte {error.start}"
        raise ValueError(f"{path.name}: not UTF-8 text ({place}); save it as CSV (UTF-8)") from None
    except (pd.errors.ParserError, pd.errors.ParserWarning, csv.Error) as error:
        reason = " ".join(str(error).split())
        raise ValueError(
            f"{path.name}: not a regular CSV file, mend lines or quotes ({reason})"
        ) from None
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
    """Read text cells as finite numbers."""
    import numpy as np
    import pandas as pd

    numbers = pd.to_numeric(cells, errors="coerce").astype(np.float64)
    bad = cells[~np.isfinite(numbers)]
    refuse_lines(
        bad,
        what,
        why=f"in column '{cells.name}', allowed is a finite number; mend it or leave the row out",
    )
    return numbers


def read_known(cells: Series, what: str) -> Series:
    """Read text cells as finite numbers where there is one.

    Returns naN where they are empty.
    """
    return read_numbers(cells[cells != ""], what).reindex(cells.index)


def read_metric(cells: Series, what: str) -> Series:
    """Read text cells as a match metric where there is one.

    Returns naN where they are empty.
    """
    values = read_known(cells, what)
    huge = cells[values.abs() > LARGEST]
    refuse_lines(
        huge,
        what,
        why=f"in column '{cells.name}', allowed is 1 or less and no more than {LARGEST:g} in size",
    )
    return values


def read_flags(cells: Series, what: str) -> Series:
    """Read text cells as yes or no; an empty cell is a no."""
    words = cells.str.strip().str.lower()
    bad = cells[~words.isin(YES | NO)]
    refuse_lines(
        bad, what, why=f"in column '{cells.name}', allowed is true, false, 1, 0, yes, no or nothing"
    )
    return words.isin(YES)


def refuse_lines(bad: Series, what: str, *, why: str) -> None:
    """Raise ValueError naming the lines of the bad cells, if there are any."""
    if bad.empty:
        return
    named = ", ".join(str(line) for line in bad.index[:BLAMED_LINES])
    more = f" and {len(bad) - BLAMED_LINES} more" if len(bad) > BLAMED_LINES else ""
    lines = "line" if len(bad) == 1 else "lines"
    first = bad.iloc[0]
    got = shorten(first) if isinstance(first, str) else f"{first:g}"
    raise ValueError(f"{what}, {lines} {named}{more}: got {got} {why}")


def check_names(names: Series, what: str) -> None:
    """Refuse names that are empty, or that do not show what they are."""
    told = f"in column '{names.name}', which must not"
    refuse_lines(names[names == ""], what, why=f"{told} be empty; name it")
    each = list(names.unique())
    padded = names[names.isin([name for name in each if name != name.strip()])]
    refuse_lines(padded, what, why=f"{told} begin or end with a blank; remove it")
    broken = names[names.isin([name for name in each if CONTROL.search(name)])]
    refuse_lines(
        broken, what, why=f"{told} hold line breaks or other control characters; remove them"
    )


def shorten(text: str) -> str:
    r"""Quote a cell for a message that is to stay one line.

    Examples
    --------
    >>> shorten("a\nb"), shorten("x" * 100)
    ("'a\\nb'", "'xxxxxxxxxxxxxxxxxxxxxxxxxxxx...xxxxxxxxxxxxxxxxxxxxxxxxxxxx'")
    """
    return repr(
        text if len(text) <= LONGEST else f"{text[: LONGEST // 2 - 2]}...{text[2 - LONGEST // 2 :]}"
    )


def _read_cells(path: Path, header: Sequence[str], wanted: Sequence[str]) -> DataFrame:
    import pandas as pd

    starts = number_lines(path, width=len(header))
    places = sorted(header.index(name) for name in wanted)
    with warnings.catch_warnings():
        warnings.simplefilter("error", pd.errors.ParserWarning)
        # By place, because columns that are not used may share a name.
        sheet = pd.read_csv(
            path,
            header=0,
            names=range(len(header)),
            usecols=places,
            dtype=str,
            na_filter=False,
            skip_blank_lines=False,
            index_col=False,
            encoding="utf-8-sig",
        )
    sheet.index = pd.Index(starts, name="line")
    return sheet.set_axis([header[place] for place in places], axis=1)[list(wanted)]


def _check_header(header: Sequence[str], path: Path, schema: Mapping[str, Column]) -> None:
    needed = list_needed(schema)
    if not header:
        state = "line 1 is blank" if path.stat().st_size else "the file is empty"
        raise ValueError(
            f"{path.name}: {state}; its first line must name the columns {', '.join(needed)}"
        )
    _refuse_misspelt(header, path.name, schema)
    doubled = sorted({name for name in header if name in schema and header.count(name) > 1})
    if doubled:
        raise ValueError(
            f"{path.name}: column {', '.join(doubled)} appears more than once; keep one"
        )
    missing = [name for name in needed if name not in header]
    if missing:
        hint = tell_separator(header) or "add it, or rename the one that holds it"
        got = shorten(", ".join(header))
        raise ValueError(
            f"{path.name}, line 1: column {', '.join(missing)} is missing; got {got}; {hint}"
        )


def _refuse_misspelt(header: Sequence[str], what: str, schema: Mapping[str, Column]) -> None:
    # It would be passed over in silence, and with it what it says: that judgements are rejected, for example.
    plain = {_simplify(name): name for name in schema}
    for name in header:
        meant = plain.get(_simplify(name))
        if meant and name != meant:
            raise ValueError(
                f"{what}, line 1: got column {shorten(name)}, allowed is '{meant}'; rename or remove it"
            )


def _simplify(name: str) -> str:
    return re.sub(r"[\s_.-]+", "", name).casefold()


NAMING = ("recording", "reducer", "level")
"""Columns that together name a stimulus where there is no stimulus_id."""


# Scales that do not rate one stimulus by itself: what becomes of them, and what their points mean.

PAIRED, ANSWERED = DISSIMILARITY.scale, ABX.scale
APART = (PAIRED, ANSWERED)
"""Scales that enter no association: a metric speaks of one stimulus, and of more or less."""

PAIR = "pair"
"""Role of what is judged against another stimulus that is not the reference."""

SPACE = (
    "Where a map of the dissimilarities can be made, it stands under The space of what was felt."
)
MEASURES = {PAIRED: "dissimilarity from the reference", ANSWERED: "percentage correct"}


def tell_measure(scale: str) -> str:
    """Say what the points of a scale measure.

    Examples
    --------
    >>> tell_measure("realism"), tell_measure("abx")
    ('realism rating', 'percentage correct')
    """
    return MEASURES.get(scale, f"{tell_name(scale)} rating")


def note_apart(rows: DataFrame) -> Iterator[str]:
    """Say which scales enter no association, and why."""
    counts = rows["scale"].value_counts()
    lead = "Scale '{}': none of its {} judgements enters an association, because"
    if PAIRED in counts:
        pairs = int((rows["role"] == PAIR).sum())
        yield (
            f"{lead.format(PAIRED, counts[PAIRED])} a metric speaks of one stimulus and they compare two. The profile "
            f"holds the {counts[PAIRED] - pairs} that compare with the reference, and leaves out {pairs}. {SPACE}"
        )
    if ANSWERED in counts:
        yield (
            f"{lead.format(ANSWERED, counts[ANSWERED])} they are right (100) or wrong (0). The profile holds the "
            "percentage correct; guessing gives 50."
        )


# What a table of ratings lacks or may have confused: said in a note, never repaired.

NAMED = 3
"""How many names a note lists before it only counts."""

SHORT = 10
"""Points below which a scale's highest rating makes one doubt that it went to 100."""


def note_gaps(rows: DataFrame, manifest: DataFrame) -> Iterator[str]:
    """Say which stimuli nobody rated, and which scales have no test stimulus."""
    rated = set(rows["stimulus_id"].unique()) | set(
        rows.loc[rows["scale"].isin(APART), "reference_id"].unique()
    )
    unrated = [str(name) for name in manifest.index if name not in rated]
    if unrated:
        yield f"{len(unrated)} of {len(manifest)} stimuli of the manifest were rated by nobody: {list_names(unrated)}."
    tested = set(rows.loc[rows["role"] == "test", "scale"].unique())
    for scale in sorted(set(rows["scale"].unique()) - tested - set(APART)):
        yield f"Scale {list_names([scale])} was rated on references and anchors only: it has no association."


def note_lost(participants: Series, rejected: Series) -> Iterator[str]:
    """Say of whom nothing is left."""
    lost = sorted(set(participants.unique()) - set(participants[~rejected].unique()))
    if lost:
        yield f"Participants without a valid judgement, who do not count: {list_names(lost)}."


def note_lookalikes(rows: DataFrame) -> Iterator[str]:
    """Say which names look alike."""
    for column in ("participant", "stimulus_id", "recording", "reducer", "level", "scale"):
        names = sorted(rows[column].unique())
        looks = [_look_at(name) for name in names]
        times = Counter(looks)
        alike = [name for name, look in zip(names, looks, strict=True) if times[look] > 1]
        if alike:
            told = f"Names in column '{column}' that differ in capitals, accents or blanks only are taken as different"
            yield f"{told}: {list_names(alike)}."


def note_alike(sheet: DataFrame, key: Sequence[str]) -> Iterator[str]:
    """Say how many judgements repeat another without saying so."""
    count = int(sheet.duplicated(list(key)).sum())
    if count:
        yield f"{count} judgements differ from an earlier one in their trial only: each counts as a further repeat."


def note_scales(sheet: DataFrame) -> Iterator[str]:
    """Say which scales may have had other ends, and which were judged in several tasks."""
    ends = sheet.groupby("scale")["rating"].agg(["min", "max"])
    for scale, low, high in ends.itertuples():
        if low < high <= SHORT:
            name, told = list_names([scale]), f"run from {low:g} to {high:g}"
            yield f"Ratings of scale {name} {told}: if 100 was not its upper end, rescale them to 0 to 100."
    if "protocol" not in sheet:
        return
    for scale, tasks in sheet.groupby("scale")["protocol"].unique().items():
        if len(tasks) > 1:
            name, told = list_names([str(scale)]), f"was judged in {len(tasks)} protocols"
            yield f"Scale {name} {told}, which are taken together: {list_names(sorted(tasks))}."


def note_underruns(sheet: DataFrame) -> Iterator[str]:
    """Say how many judgements were made on an interrupted playback."""
    broken = sheet.loc[sheet["underruns"] > 0, "participant"]
    if len(broken):
        told = f"{len(broken)} judgements of {broken.nunique()} participants were made on an interrupted playback"
        yield f"{told} (underruns): they count; mark them as rejected to leave them out."


def list_names(names: Sequence[str]) -> str:
    """List names for a note.

    Examples
    --------
    >>> list_names(["a", "b", "c", "d", "e"])
    "'a', 'b', 'c' and 2 more"
    """
    more = f" and {len(names) - NAMED} more" if len(names) > NAMED else ""
    return ", ".join(shorten(name) for name in names[:NAMED]) + more


def _look_at(name: str) -> str:
    """Leave out what the eye does not see: format characters, kinds of blanks, how accents are stored, capitals."""
    seen = "".join(
        letter
        for letter in unicodedata.normalize("NFKC", name)
        if unicodedata.category(letter) != "Cf"
    )
    return " ".join(seen.split()).casefold()
