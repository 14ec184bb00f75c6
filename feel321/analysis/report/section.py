"""What a report is made of: rows of one tidy frame, and sections that declare how a page shows them.

A row is one number: what it is (quantity), of what (scale, level, metric, ...), value, interval, p, n, and a note where
it is a word. ``results.json``, ``tables/*.csv`` and both pages are those rows, filtered. A section is one function
that computes rows and facts, and one template that holds its English: tables, sentences, methods.
"""

from __future__ import annotations

import hashlib
import math
import re
import tomllib
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from feel321.analysis.table.dictionary import DICTIONARY
from feel321.analysis.words import capitalise, format_estimate, format_name, format_number

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence

    from matplotlib.figure import Figure
    from pandas import DataFrame

    from feel321.analysis.resampling import Choices
    from feel321.analysis.table.items import Table

Row = dict[Any, Any]

NONE = math.nan
FIXED = ("quantity", "value", "low", "high", "p", "n", "interval", "note")
"""Columns of every row; all others say what the number is of."""


def make_row(quantity: str, value: Any = NONE, **more: Any) -> Row:  # noqa: ANN401 - keys are names and numbers
    """Make a row of the frame; more: low, high, p, n, interval, note, and its keys.

    Examples
    --------
    >>> row = make_row("slope", 3.0, low=1.0, high=5.0, n=90, scale="realism")
    >>> row["scale"], row["quantity"], row["p"]
    ('realism', 'slope', nan)
    """
    row: Row = {"quantity": quantity, "value": float(value), "low": NONE, "high": NONE, "p": NONE}
    row |= {"n": 0, "interval": "", "note": "", **more}
    for name in ("value", "low", "high", "p"):
        row[name] = float(row[name]) if math.isfinite(row[name]) else NONE
    if math.isnan(row["low"] + row["high"]):
        row |= {"low": NONE, "high": NONE, "interval": ""}
    return row | {"n": int(row["n"])}


def count_rows(sizes: Mapping[str, float], **keys: Any) -> list[Row]:  # noqa: ANN401 - keys are names and numbers
    """Make a row for each count."""
    return [make_row(name, size, **keys) for name, size in sizes.items()]


NAMES = ("reducer", "second_reducer", "participant", "stimulus", "recording")
"""Keys that are names, shown as they are."""


class Column(NamedTuple):
    """A column of a page's table: a quantity, its heading, how it is rounded, and how it was computed.

    p: heading of a further column for its probability; kind "note": the row's words are shown.
    """

    quantity: str
    head: str
    kind: str = "correlation"
    meaning: str = ""
    p: str = ""


@dataclass(frozen=True, slots=True)
class TableForm:
    """A table: the name of its file, its caption, what identifies a row, and its columns.

    keys: key of the rows -> heading; one that is the same throughout is left out where it is optional ("?" before the
    heading). Keys and columns in `raw` are names that are shown as they are.
    """

    name: str
    caption: str
    keys: Mapping[str, str]
    columns: Sequence[Column]
    raw: frozenset[str]


@dataclass(frozen=True, slots=True)
class PageTable:
    """A table as a page shows it."""

    caption: str
    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    text_columns: frozenset[int] = frozenset()
    name: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class Picture:
    """A figure of a report: its file's name, its caption, and the figure or what draws it.

    detail: not on the first page.
    """

    name: str
    caption: str
    drawing: Figure | Callable[[], Figure]
    detail: bool = False

    @property
    def figure(self) -> Figure:
        """The figure, drawn."""
        return self.drawing() if callable(self.drawing) else self.drawing


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """What a section found: rows by table, facts for its words, figures, notes; verdicts and clauses for the front.

    facts: decisions and rows that the section's template puts into words. verdicts: one record per slope, for programs.
    clauses: what the headline says of it, where no verdict does. notes: what was left out or assumed.
    """

    rows: Mapping[str, Sequence[Row]] = field(default_factory=dict)
    facts: Mapping[str, Any] = field(default_factory=dict)
    pictures: Sequence[Picture] = ()
    notes: Sequence[str] = ()
    verdicts: Sequence[Row] = ()
    clauses: Sequence[str] = ()

    @property
    def is_empty(self) -> bool:
        """Whether there is nothing to be shown."""
        return not (any(self.rows.values()) or self.facts or self.pictures)


@dataclass(frozen=True, slots=True, eq=False)
class Section:
    """A section of the report, declared.

    key: its name in paths, anchors and of its template in ``templates/words``. question: key of the question that it
    answers. compute: takes all ratings and the choices. front: whether its first sentence stands on the first page.
    """

    key: str
    title: str
    question: str
    compute: Callable[[Table, Choices], Found]
    front: bool = True

    @property
    def tables(self) -> tuple[TableForm, ...]:
        """The tables that its template declares."""
        return read_tables(self.key)


TEMPLATES = Path(__file__).parents[1] / "templates" / "words"


@cache
def read_tables(key: str) -> tuple[TableForm, ...]:
    """Read the tables of a section from the TOML that opens its template."""
    head = (TEMPLATES / f"{key}.j2").read_text(encoding="utf-8").partition("#}")[0]
    declared = tomllib.loads(head.partition("\n")[2])
    return tuple(
        TableForm(
            name, one["caption"], one["keys"], tuple(Column(*column) for column in one["columns"]),
            frozenset(one.get("raw", NAMES)),
        )
        for name, one in declared.items()
    )  # fmt: skip


def show_tables(section: Section, found: Found) -> Iterator[PageTable]:
    """Show a section's rows as the tables that it declares."""
    for form in section.tables:
        if rows := found.rows.get(form.name):
            yield show_table(form, rows)


def show_table(form: TableForm, rows: Sequence[Row]) -> PageTable:
    """Pivot rows: one line for each combination of keys, one column for each quantity, with interval and p beside.

    Examples
    --------
    >>> form = TableForm("r", "How well.", {"scale": "Ratings"}, [Column("r", "r", p="p")], frozenset())
    >>> show_table(form, [make_row("r", 0.5, low=0.1, high=0.8, p=0.02, scale="mushra")]).rows
    (('MUSHRA', '0.50', '0.10 to 0.80', '0.020'),)
    """
    keys = {key: head for key, head in form.keys.items() if _is_shown(key, head, rows)}
    lines: dict[tuple[str, ...], dict[str, Row]] = {}
    for row in rows:
        place = tuple(str(row.get(key, "")) for key in keys)
        lines.setdefault(place, {})[row["quantity"]] = row
    columns = [one for one in form.columns if any(one.quantity in line for line in lines.values())]
    heads, texts = [head.lstrip("?") for head in keys.values()], set(range(len(keys)))
    shows: list[tuple[Column, str]] = []
    for column in columns:
        own = [line[column.quantity] for line in lines.values() if column.quantity in line]
        if column.kind == "note":
            texts.add(len(heads))
        heads.append(column.head)
        shows.append((column, "value"))
        if any(math.isfinite(row["low"]) for row in own):
            heads.append("95 % interval" if "90" not in own[0]["interval"][:3] else "90 % interval")
            shows.append((column, "interval"))
        if column.p:
            heads.append(column.p)
            shows.append((column, "p"))
    body = [
        (
            *(name if key in form.raw else format_name(name) for key, name in zip(keys, place, strict=True)),
            *(_show_cell(line.get(column.quantity), column.kind, part) for column, part in shows),
        )
        for place, line in lines.items()
    ]  # fmt: skip
    return PageTable(form.caption, tuple(heads), tuple(body), frozenset(texts), form.name)


def _is_shown(key: str, head: str, rows: Sequence[Row]) -> bool:
    return not head.startswith("?") or len({row.get(key, "") for row in rows}) > 1


def _show_cell(row: Row | None, kind: str, part: str) -> str:
    if row is None:
        return ""
    if kind == "note":
        return str(row["note"])
    if part == "p":
        return format_number(row["p"], kind="p")
    value, interval = format_estimate(row["value"], row["low"], row["high"], kind=kind)
    return value if part == "value" else interval


SLUG_PART = 40
"""Characters of a name that a file's name keeps."""


def make_slug(*parts: str) -> str:
    """Make names readable in a file's name; a digest follows one that this changes or cuts, to tell it from others."""
    return "_".join(map(_make_part, parts))


def _make_part(part: str) -> str:
    short = re.sub(r"[^A-Za-z0-9_-]+", "-", part)[:SLUG_PART]
    return short if short == part else f"{short}-{hashlib.sha256(part.encode()).hexdigest()[:6]}"


def name_pictures(pictures: Iterable[Picture]) -> Iterator[Picture]:
    """Make figures' names unique on any file system, where two differ by case only."""
    pictures = tuple(pictures)
    folded = [picture.name.casefold() for picture in pictures]
    for picture in pictures:
        digest = hashlib.sha256((picture.name + picture.caption).encode()).hexdigest()[:6]
        alike = folded.count(picture.name.casefold()) > 1
        yield replace(picture, name=f"{picture.name}-{digest}") if alike else picture


def name_ratings(scale: str, level: str) -> str:
    """Name the ratings of a scale, and of a level where there are several (else it is "").

    Examples
    --------
    >>> name_ratings("realism", "as_is"), name_ratings("mushra", "")
    ('realism ratings (level as is)', 'MUSHRA ratings')
    """
    return f"{format_name(scale)} ratings" + (f" (level {format_name(level)})" if level else "")


def name_subject(scale: str, level: str) -> str:
    """Name a scale and level at the head of a line."""
    return capitalise(format_name(scale)) + (f" (level {format_name(level)})" if level else "")


FIELDS = {
    "quantity": "what the number is",
    "value": "the number",
    "low": "lower end of the interval",
    "high": "upper end of the interval",
    "p": "probability, adjusted where the quantity says so",
    "n": "how many judgements, stimuli or participants it rests on",
    "interval": "kind of interval",
    "note": "a word in the place of a number, or what is unusual",
    "status": "confirmatory or exploratory",
}


KINDS = dict.fromkeys(("value", "low", "high", "p"), "number") | {"n": "integer"}
DESCRIBED = {
    "file": "file that the column is in",
    "column": "name of the column",
    "quantity": "in the column value: the quantity that is described",
    "type": "number, integer or text",
    "meaning": "what the column holds",
}
"""The dictionary's own columns."""


def describe_tables(sections: Sequence[Section], frames: Mapping[str, DataFrame]) -> DataFrame:
    """Describe every column and every quantity of every table."""
    import pandas as pd

    forms = {form.name: form for section in sections for form in section.tables}
    rows = []
    for name, frame in frames.items():
        heads = forms[name].keys if name in forms else {}
        known = {one.quantity: one.meaning for one in forms[name].columns} if name in forms else {}
        for column in map(str, frame):
            kind = KINDS.get(column, "text")
            meaning = FIELDS.get(
                column, heads.get(column, column.replace("_", " ")).lstrip("?").lower()
            )
            rows.append([f"{name}.csv", column, "", kind, meaning])
        for quantity in frame["quantity"].unique():
            meaning = known.get(quantity) or quantity.replace("_", " ")
            rows.append([f"{name}.csv", "value", quantity, "number", meaning])
    rows += [[DICTIONARY, column, "", "text", meaning] for column, meaning in DESCRIBED.items()]
    return pd.DataFrame(rows, columns=list(DESCRIBED))
