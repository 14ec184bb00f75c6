"""What a report is made of: rows of one tidy frame, and sections that compute them and declare how pages show them.

A row is one number: what it is (quantity), of what (scale, level, metric, ...), value, interval, p, n, and a note where
it is a word. ``results.json``, ``tables/*.csv`` and both pages are those rows, filtered. A section is one function
that decides, and one template, ``templates/words/KEY.j2``, that opens with TOML: its tables (quantities, and how a
page shows them) and its figures; then come the macros that hold its English.
"""

from __future__ import annotations

import hashlib
import math
import re
import tomllib
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, partial
from importlib import import_module
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

from feel321.analysis import figures
from feel321.analysis.table.columns import Step, find_steps
from feel321.analysis.table.items import Part, Table, find_sources, split_tests
from feel321.analysis.words import (
    INTERVALS,
    TEMPLATES,
    format_count,
    format_estimate,
    format_name,
    format_number,
    render_words,
)

if TYPE_CHECKING:
    import numpy as np
    from matplotlib.figure import Figure
    from pandas import DataFrame

    from feel321.analysis.resampling import Choices

    Records = DataFrame | Iterable[Mapping[Any, Any]]

Anything = TypeVar("Anything")
Row = dict[Any, Any]

NONE = math.nan
ENDS = ("value", "low", "high", "p")
# Columns of every row; all others say what the number is of
FIXED = ("quantity", *ENDS, "n", "interval", "note")
SIGNIFICANCE = 0.05


def make_row(quantity: str, value: Any = NONE, **more: Any) -> Row:  # noqa: ANN401 - keys are names and numbers
    """Make a row of the frame; more: low, high, p, n, interval, note, and its keys; a word or flag is its note."""
    row: Row = {"quantity": quantity, **dict.fromkeys(ENDS, NONE), "n": 0, "interval": "", "note": ""}  # fmt: skip
    row |= more
    if isinstance(value, str):
        row["note"] = value
    elif str(value) in {"True", "False"}:  # of Python or of NumPy
        row["note"] = "yes" if value else "no"
    else:
        row["value"] = value
    row |= {name: float(row[name]) if math.isfinite(row[name]) else NONE for name in ENDS}
    if math.isnan(row["low"] + row["high"]):
        row |= {"low": NONE, "high": NONE, "interval": ""}
    return row | {"n": int(row["n"])}


def find_row(rows: Iterable[Row], quantity: str, **keys: Any) -> Row | None:  # noqa: ANN401 - keys of a row
    """Find the row of a quantity by its keys."""
    wanted = {"quantity": quantity, **keys}.items()
    return next((row for row in rows if all(row.get(key) == one for key, one in wanted)), None)


def read_ends(record: Mapping[Any, Any], names: str = "value low high") -> dict[str, float]:
    """Read an estimate and the ends of its interval by their names in a record, for the words."""
    return {end: record[name] for end, name in zip(ENDS, names.split(), strict=False)}


def list_few(units: Mapping[str, int], least: int) -> list[str]:
    """List the units of which there are so few that a finding is no more than a hint: 3 recordings."""
    return [format_count(size, name) for name, size in units.items() if size < least]


# What a template declares: tables and figures.

# Keys that a page shows as they are; those of all others are put into words
RAW = frozenset({
    "reducer", "second_reducer", "participant", "stimulus", "recording", "role", "unit", "group", "term",
})  # fmt: skip


class Quantity(NamedTuple):
    """A quantity of a table: of what names in a record its row is made, and how a page shows it, if it has a heading.

    source: the names of value, low, high, p and note (a dash for none), and behind a bar the interval where it is
    another than the table's; "?" before them where records may lack the value; the quantity's own name if empty.
    kind: how it is rounded; "note": the row's words are shown. p: heading of a further column for its probability.
    """

    name: str
    source: str = ""
    head: str = ""
    kind: str = "correlation"
    meaning: str = ""
    p: str = ""

    def write(self, rows: Sequence[Row]) -> Iterator[tuple[str, list[str]]]:
        """Write the columns of a page: words, or value, intervals where there are any, and probability."""
        if self.kind == "note":
            yield self.head, [str(row.get("note", "")) for row in rows]
            return
        ends = [tuple(read_ends(row).values()) if row else () for row in rows]
        told = [format_estimate(*one, kind=self.kind) if one else ("", "") for one in ends]
        yield self.head, [value for value, _ in told]
        if kinds := [row["interval"] for row in rows if row and math.isfinite(row["low"])]:
            yield f"{kinds[0][:4]} interval", [interval for _, interval in told]
        if self.p:
            yield self.p, [format_number(row["p"], kind="p") if row else "" for row in rows]


class TableForm(NamedTuple):
    """A table: the name of its file, its quantities, and what a record's rows are of; on no page without caption.

    keys: key of the rows -> heading; one that is the same throughout is left out where it is optional ("?" before the
    heading). of: key of a row -> its name in a record, where that is another or no page shows the key.
    """

    name: str
    caption: str = ""
    keys: Mapping[str, str] = {}
    quantities: Sequence[Quantity] = ()
    of: Mapping[str, str] = {}
    interval: str = ""

    def make_rows(self, records: Records, **fixed: Any) -> Iterator[Row]:  # noqa: ANN401 - keys, numbers
        """Make a row of every quantity of every record."""
        named = {key: self.of.get(key, key) for key in (*self.keys, *self.of) if key not in fixed}
        for record in records.to_dict("records") if hasattr(records, "to_dict") else records:
            own = fixed | {key: record[name] for key, name in named.items()}
            for quantity in self.quantities:
                names, _, interval = (quantity.source or quantity.name).partition(" | ")
                pairs = zip((*ENDS, "note"), names.removeprefix("?").split(), strict=False)
                ends = {end: name for end, name in pairs if name != "-"}
                value = record.get(ends.get("value"))
                if names.startswith("?") and str(value) in {"None", "nan"}:
                    continue
                interval = interval or self.interval
                row = {"interval": INTERVALS.get(interval, interval), **own}
                yield make_row(quantity.name, **row | {end: record[ends[end]] for end in ends})

    def show(self, rows: Sequence[Row]) -> dict[str, Any]:
        """Pivot rows: one line for each combination of keys, one column for each quantity, interval and p beside."""
        shown = {one.name: one for one in self.quantities if one.head}
        rows = [row for row in rows if row["quantity"] in shown]
        keys = [key for key, head in self.keys.items()
                if not head.startswith("?") or len({row.get(key, "") for row in rows}) > 1]  # fmt: skip
        lines: dict[tuple[str, ...], dict[str, Row]] = {}
        for row in rows:
            place = tuple(str(row.get(key, "")) for key in keys)
            lines.setdefault(place, {})[row["quantity"]] = row
        columns, texts = list[tuple[str, Sequence[str]]](), set(range(len(keys)))
        for key, names in zip(keys, zip(*lines, strict=True), strict=False):
            told = names if key in RAW else [format_name(name) for name in names]
            columns.append((self.keys[key].lstrip("?"), told))
        for quantity in shown.values():
            own = [line.get(quantity.name, {}) for line in lines.values()]
            texts |= {len(columns)} if quantity.kind == "note" else set()
            columns += quantity.write(own) if any(own) else ()
        heads, cells = zip(*columns, strict=True)
        known = {"name": self.name, "caption": self.caption, "head": heads, "texts": texts}
        return known | {"rows": list(zip(*cells, strict=True))}


@cache
def read_declared(key: str) -> tuple[Mapping[str, TableForm], Mapping[str, Mapping[str, Any]]]:
    """Read the tables and the figures of a section from the TOML that opens its template."""
    head = (TEMPLATES / "words" / f"{key}.j2").read_text(encoding="utf-8").partition("#}")[0]
    declared = tomllib.loads(head.partition("\n")[2])
    figures = declared.pop("figures", {})
    tables = {}
    for name, own in declared.items():
        one = {**declared.get(own.get("like", ""), {}), **own}
        quantities = [Quantity(key, *row) for key, row in one.items() if isinstance(row, list)]
        quantities += [Quantity(key.lstrip("?"), key) for key in one.get("unshown", "").split()]
        known = {key: one[key] for key in ("caption", "keys", "of", "interval") if key in one}
        tables[name] = TableForm(name, quantities=quantities, **known)
    return tables, figures


@dataclass(frozen=True, slots=True, eq=False)
class Picture:
    """A figure of a report: its file's name, its caption, itself or what draws it; detail: not on the first page."""

    name: str
    caption: str
    drawing: Figure | Callable[[], Figure]
    detail: bool = False

    @property
    def figure(self) -> Figure:
        """The figure, drawn."""
        return self.drawing() if callable(self.drawing) else self.drawing


SLUG_PART = 40  # Characters of a name that a file's name keeps


def make_slug(*parts: str) -> str:
    """Make names readable in a file's name, on any file system; a digest follows one that this changes or cuts."""
    slugs = []
    for part in parts:
        short = re.sub(r"[^a-z0-9_-]+", "-", part.lower())[:SLUG_PART]
        digest = hashlib.sha256(part.encode()).hexdigest()[:6]
        slugs.append(short if short == part else f"{short}-{digest}")
    return "_".join(slugs)


@dataclass(slots=True, eq=False)
class Found:
    """What a section finds: rows by table, facts for its words, figures, notes; verdicts and clauses for the front.

    facts: decisions and rows that the section's template puts into words. verdicts: one record per slope, for programs.
    clauses: what the headline says of it, where no verdict does. notes: what was left out or assumed.
    """

    rows: dict[str, list[Row]] = field(default_factory=lambda: defaultdict(list))
    facts: dict[str, Any] = field(default_factory=dict)
    pictures: list[Picture] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    verdicts: list[Row] = field(default_factory=list)
    clauses: list[str] = field(default_factory=list)
    key: str = ""

    @property
    def is_empty(self) -> bool:
        """Whether there is nothing to be shown."""
        return not (any(self.rows.values()) or any(self.facts.values()) or self.pictures)

    def add(self, table: str, records: Records, **fixed: Any) -> None:  # noqa: ANN401 - keys, and what numbers share
        """Add the rows of records to a table, as the section's template declares it."""
        self.rows[table] += read_declared(self.key)[0][table].make_rows(records, **fixed)

    def draw(self, figure: str, slug: str, *data: object, says: Row, **options: Any) -> None:  # noqa: ANN401 - of the kind
        """Add a figure that the template declares, to be drawn of data; says: what its caption needs to know."""
        declared = {**read_declared(self.key)[1][figure], **options}
        draw, detail = f"draw_{declared.pop('kind')}", declared.pop("detail", False)
        (caption,) = render_words(self.key, figure, **says)
        drawing = partial(getattr(figures, draw), *data, **declared)
        self.pictures.append(Picture(slug, caption, drawing, detail))

    def tell(self, *, claims: bool = False, **facts: object) -> None:
        """Add the facts of a part, such as a scale and level, for the words; claims: for the headline too."""
        self.facts.setdefault("parts", []).append(facts)
        if claims:
            self.claim(one=facts)

    def claim(self, **facts: object) -> None:
        """Add what the headline says, as the section's template puts it."""
        self.clauses += render_words(self.key, "clause", **facts)

    def attempt(
        self, lead: str, compute: Callable[..., Anything], *given: Any, **options: Any  # noqa: ANN401 - what it takes
    ) -> Anything | None:  # fmt: skip
        """Compute something of what is given, or note behind a lead why it cannot be."""
        try:
            return compute(*given, **options)
        except ValueError as error:
            self.notes.append(f"{lead} {error}")
        return None


@dataclass(frozen=True, slots=True)
class Section:
    """A section of the report, declared.

    key: its name in paths, anchors and of its template. question: key of the question that it answers. place: module
    and function, which takes all ratings and the choices. scales: it is about these only; all if empty.
    """

    key: str
    title: str
    question: str
    place: str
    scales: Sequence[str] = ()

    @property
    def tables(self) -> Mapping[str, TableForm]:
        """The tables that its template declares."""
        return read_declared(self.key)[0]

    def compute(self, table: Table, choices: Choices) -> Found:
        """Compute it, unless it is about nothing that was rated; its module is imported only then."""
        if self.scales and not table.rows["scale"].isin(self.scales).any():
            return Found(key=self.key)
        module, _, name = self.place.partition(":")
        compute = getattr(import_module(f"feel321.analysis.report.{module}"), name)
        found: Found = compute(table, choices)
        return found


# Scales and levels that a figure of the first page shows, so that it can be read on paper; the others follow
FRONT = 4


def split_front(name: str, drawn: Sequence[Anything]) -> Iterator[tuple[str, Sequence[Anything]]]:
    """Split what is drawn into a figure for the first page and one for the details, if it takes two."""
    pairs = ((name, drawn[:FRONT]), (f"{name}_more", drawn[FRONT:]))
    return (pair for pair in pairs if pair[1])


def find_table_steps(table: Table) -> dict[str, Step]:
    """Find the step of every metric of the primary analysis; one for all scales and levels."""
    tests = table.rows[table.rows["role"] == "test"].drop_duplicates("stimulus_id")
    return find_steps(tests, table.metrics, table.info)


# More ratings than a mixed model can be fitted to in reasonable time and memory.

# Random effects besides those of the largest group, which make a dense matrix; of those and the largest group's
MOST_DENSE, MOST_PRODUCTS = 1500, 40_000_000
FEWEST = 8  # Participants and recordings are not thinned below this


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
    sources, left, sides = find_sources(rows), rows, ("participant", "recording")
    while is_large(left, n_slopes):
        longer = max(sides, key=lambda name: left[name].nunique())
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
    counts = (f"{left[name].nunique()} of {rows[name].nunique()} {name}s" for name in sides)
    told = " and ".join(counts)
    return left, f"mixed models use {told}, drawn at random: {len(rows)} ratings are too many for one fit."  # fmt: skip


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
