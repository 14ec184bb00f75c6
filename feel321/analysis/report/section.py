"""What a report is made of: rows of one tidy frame, sections that declare how pages show them, parts of the ratings.

A row is one number: what it is (quantity), of what (scale, level, metric, ...), value, interval, p, n, and a note where
it is a word. ``results.json``, ``tables/*.csv`` and both pages are those rows, filtered. A section is one function
that computes rows and facts, and one template that holds its English: tables, sentences, methods.
"""

from __future__ import annotations

import hashlib
import math
import re
import tomllib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from feel321.analysis.table.dictionary import DICTIONARY
from feel321.analysis.table.items import Part, find_sources, split_tests
from feel321.analysis.table.metrics import Step, find_steps
from feel321.analysis.words import format_estimate, format_name, format_number

if TYPE_CHECKING:
    import numpy as np
    from matplotlib.figure import Figure
    from pandas import DataFrame

    from feel321.analysis.resampling import Choices
    from feel321.analysis.table.items import Table

Row = dict[Any, Any]
Names = Mapping[str, str] | Iterable[str]

NONE = math.nan
FIXED = ("quantity", "value", "low", "high", "p", "n", "interval", "note")
"""Columns of every row; all others say what the number is of."""

SIGNIFICANCE = 0.05


def make_row(quantity: str, value: Any = NONE, **more: Any) -> Row:  # noqa: ANN401 - keys are names and numbers
    """Make a row of the frame; more: low, high, p, n, interval, note, and its keys; a word or flag is its note.

    Examples
    --------
    >>> row = make_row("slope", 3.0, low=1.0, high=5.0, n=90, scale="realism")
    >>> row["scale"], row["quantity"], row["p"], make_row("best", True)["note"]
    ('realism', 'slope', nan, 'yes')
    """
    row: Row = dict.fromkeys(("quantity", "value", "low", "high", "p"), NONE)
    row |= {"quantity": quantity, "n": 0, "interval": "", "note": "", **more}
    if isinstance(value, str):
        row["note"] = value
    elif str(value) in {"True", "False"}:  # of Python or of NumPy
        row["note"] = "yes" if value else "no"
    else:
        row["value"] = value
    for name in ("value", "low", "high", "p"):
        row[name] = float(row[name]) if math.isfinite(row[name]) else NONE
    if math.isnan(row["low"] + row["high"]):
        row |= {"low": NONE, "high": NONE, "interval": ""}
    return row | {"n": int(row["n"])}


def list_rows(
    records: DataFrame | Iterable[Mapping[Any, Any]],
    quantities: Names,
    keys: Names = (),
    **fixed: Any,  # noqa: ANN401 - keys of all rows, and what their numbers share
) -> list[Row]:
    """Make a row of every quantity of every record.

    quantities: quantity -> names of its value, low, high and p in a record, a dash for none; or names of values that
    are called so.
    keys: key -> name in a record of what the row is of, or names that are called so.

    Examples
    --------
    >>> records = [{"metric": "a", "r": 0.5, "lo": 0.1, "hi": 0.8, "best": True}]
    >>> one, two = list_rows(records, {"r": "r lo hi", "best": "best"}, ["metric"], n=9)
    >>> one["low"], one["metric"], one["n"], two["note"]
    (0.1, 'a', 9, 'yes')
    """
    if hasattr(records, "to_dict"):
        records = records.to_dict("records")
    quantities, keys = (
        names if isinstance(names, Mapping) else dict(zip(names, names, strict=True))
        for names in (quantities, keys)
    )
    rows = []
    for record in records:
        own = fixed | {key: record[name] for key, name in keys.items()}
        for quantity, columns in quantities.items():
            ends = zip(("value", "low", "high", "p"), columns.split(), strict=False)
            numbers = {end: record[name] for end, name in ends if name != "-"}
            rows.append(make_row(quantity, **own, **numbers))
    return rows


def count_rows(sizes: Mapping[str, float], **keys: Any) -> list[Row]:  # noqa: ANN401 - keys are names and numbers
    """Make a row for each count."""
    return list_rows([sizes], list(sizes), **keys)


# Tables of a page.

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


class TableForm(NamedTuple):
    """A table: the name of its file, its caption, what identifies a row, its columns, and keys shown as they are.

    keys: key of the rows -> heading; one that is the same throughout is left out where it is optional ("?" before the
    heading).
    """

    name: str
    caption: str
    keys: Mapping[str, str]
    columns: Sequence[Column]
    raw: Iterable[str] = NAMES


TEMPLATES = Path(__file__).parents[1] / "templates" / "words"


@cache
def read_tables(key: str) -> tuple[TableForm, ...]:
    """Read the tables of a section from the TOML that opens its template."""
    head = (TEMPLATES / f"{key}.j2").read_text(encoding="utf-8").partition("#}")[0]
    declared = tomllib.loads(head.partition("\n")[2])
    return tuple(
        TableForm(name, **one | {"columns": [Column(*column) for column in one["columns"]]})
        for name, one in declared.items()
    )


def show_table(form: TableForm, rows: Sequence[Row]) -> dict[str, Any]:
    """Pivot rows: one line for each combination of keys, one column for each quantity, with interval and p beside.

    Examples
    --------
    >>> form = TableForm("r", "How well.", {"scale": "Ratings"}, [Column("r", "r", p="p")])
    >>> show_table(form, [make_row("r", 0.5, low=0.1, high=0.8, p=0.02, scale="mushra")])["rows"]
    [('MUSHRA', '0.50', '0.10 to 0.80', '0.020')]
    """
    known = {column.quantity for column in form.columns}
    rows = [row for row in rows if row["quantity"] in known]
    keys = {
        key: head.lstrip("?")
        for key, head in form.keys.items()
        if not head.startswith("?") or len({row.get(key, "") for row in rows}) > 1
    }
    lines: dict[tuple[str, ...], dict[str, Row]] = {}
    for row in rows:
        place = tuple(str(row.get(key, "")) for key in keys)
        lines.setdefault(place, {})[row["quantity"]] = row
    heads, texts = list(keys.values()), set(range(len(keys)))
    shown: list[tuple[Column, str]] = []
    for column in form.columns:
        own = [line[column.quantity] for line in lines.values() if column.quantity in line]
        if column.kind == "note":
            texts.add(len(heads))
        if own:
            heads.append(column.head)
            shown.append((column, "value"))
        if any(math.isfinite(row["low"]) for row in own):
            heads.append(f"{'90' if own[0]['interval'].startswith('90') else '95'} % interval")
            shown.append((column, "interval"))
        if own and column.p:
            heads.append(column.p)
            shown.append((column, "p"))
    body = [
        (
            *(name if key in form.raw else format_name(name) for key, name in zip(keys, place, strict=True)),
            *(_show_cell(line.get(column.quantity), column.kind, part) for column, part in shown),
        )
        for place, line in lines.items()
    ]  # fmt: skip
    return {"name": form.name, "caption": form.caption, "head": heads, "rows": body, "texts": texts}


def _show_cell(row: Row | None, kind: str, part: str) -> str:
    if row is None:
        return ""
    if kind == "note":
        return str(row["note"])
    if part == "p":
        return format_number(row["p"], kind="p")
    value, interval = format_estimate(row["value"], row["low"], row["high"], kind=kind)
    return value if part == "value" else interval


# Figures and sections.


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


SLUG_PART = 40
"""Characters of a name that a file's name keeps."""


def make_slug(*parts: str) -> str:
    """Make names readable in a file's name, on any file system; a digest follows one that this changes or cuts."""
    slugs = []
    for part in parts:
        short = re.sub(r"[^a-z0-9_-]+", "-", part.lower())[:SLUG_PART]
        digest = hashlib.sha256(part.encode()).hexdigest()[:6]
        slugs.append(short if short == part else f"{short}-{digest}")
    return "_".join(slugs)


MEANINGS = {
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
        form = forms.get(name, TableForm(name, "", {}, ()))
        heads = {key: head.lstrip("?").lower() for key, head in form.keys.items()} | MEANINGS
        known = {one.quantity: one.meaning for one in form.columns}
        for column in map(str, frame):
            meaning = heads.get(column, column.replace("_", " "))
            rows.append([f"{name}.csv", column, "", KINDS.get(column, "text"), meaning])
        for quantity in frame["quantity"].unique():
            meaning = known.get(quantity) or quantity.replace("_", " ")
            rows.append([f"{name}.csv", "value", quantity, "number", meaning])
    rows += [[DICTIONARY, column, "", "text", meaning] for column, meaning in DESCRIBED.items()]
    return pd.DataFrame(rows, columns=list(DESCRIBED))


def find_table_steps(table: Table) -> dict[str, Step]:
    """Find the step of every metric of the primary analysis; one for all scales and levels."""
    tests = table.rows[table.rows["role"] == "test"].drop_duplicates("stimulus_id")
    return find_steps(tests, table.metrics, table.info)


# More ratings than a mixed model can be fitted to in reasonable time and memory.

MOST_DENSE, MOST_PRODUCTS = 1500, 40_000_000
"""Random effects besides those of the largest group, which make a dense matrix; of those and the largest group's."""

FEWEST = 8
"""Participants and recordings are not thinned below this."""


def thin_parts(
    table: Table, choices: Choices, *, n_slopes: int | None = None, matched: bool = True
) -> Iterator[Part]:
    """Split the ratings of test stimuli into parts that a mixed model can be fitted to."""
    size = len(table.metrics) if n_slopes is None else n_slopes
    for part in split_tests(table, matched=matched):
        rng = choices.make_rng("thin", *part.place)
        rows, thinned = thin_rows(part.rows, n_slopes=size, rng=rng)
        yield replace(part, rows=rows, thinned=thinned and f"{part.lead}: {thinned}")


def thin_rows(rows: DataFrame, *, n_slopes: int, rng: np.random.Generator) -> tuple[DataFrame, str]:
    """Subsample participants or recordings so that the model fits in memory, and note it.

    Of recordings, the first of every source is kept before the second of any.
    """
    sources, left = find_sources(rows), rows
    while is_large(left, n_slopes):
        longer = max(("participant", "recording"), key=lambda name: left[name].nunique())
        names = sorted(left[longer].unique())
        half = len(names) // 2
        if half < FEWEST:
            break
        kept = list(rng.choice(names, size=half, replace=False))
        if longer == "recording" and not sources.is_unique:
            shuffled = sources.loc[rng.permutation(names)]
            copy = shuffled.groupby(shuffled).cumcount()
            kept = list(copy.sort_values(kind="stable").index[:half])
        left = left[left[longer].isin(kept)]
    if len(left) == len(rows):
        return rows, ""
    told = " and ".join(
        f"{left[name].nunique()} of {rows[name].nunique()} {name}s"
        for name in ("participant", "recording")
    )
    why = f"{len(rows)} ratings are too many for one fit"
    return left, f"mixed models use {told}, drawn at random: {why}."


def is_large(rows: DataFrame, n_slopes: int) -> bool:
    """Check whether a mixed model of these ratings would take gigabytes, or hours."""
    cells = rows.groupby(["participant", "item"], observed=True).size()
    levels = [
        rows["participant"].nunique() * (1 + n_slopes), rows["recording"].nunique(), rows["item"].nunique(),
        len(rows[["participant", "recording"]].drop_duplicates()),
    ]  # fmt: skip
    # Unequal repeats bring a spread of their own.
    levels += [len(cells)] if cells.min() < cells.max() else []
    dense = sum(levels) - max(levels)
    return dense > MOST_DENSE or dense * max(levels) > MOST_PRODUCTS
