"""What a report is made of: sections, each a record of declared tables, figures, sentences and claims; and its page.

A table is declared once, as columns: `build_table` makes of them and of the rows what the page shows and the numbers
of ``results.json``; the rows themselves are the CSV file. A section is one function `compute_NAME(table, choices)`
that returns a `Section`; one that the ratings do not allow has nothing but notes, which say why. A page is one
HTML file from a template, with its drawings inside.
"""

from __future__ import annotations

import hashlib
import re
import tomllib
from collections import Counter
from dataclasses import dataclass, field, replace
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any

from feel321.analysis.words import (
    COUNT,
    SATTERTHWAITE,
    STUDENT,
    Claim,
    Line,
    Number,
    count_number,
    format_estimate,
    format_name,
    make_interval,
    make_number,
    name_path,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence

    from matplotlib.figure import Figure
    from pandas import DataFrame

    from feel321.analysis.association.correlate import Panel
    from feel321.analysis.table.metrics import Step

    Record = Mapping[Any, Any]


TEXT, NAME = "text", "name"
"""Kinds of columns that hold no number: words made of a name, and names as they are."""

KEY = r"\{(\w+)\}"
"""A key of a row in the path of its numbers."""

BOTH, VALUE, INTERVAL = "both", "value", "interval"
"""What of a number the page shows: with an interval, two columns, the second headed "Interval"."""


@dataclass(frozen=True, slots=True)
class Column:
    """A column of a table: where its value comes from, how the page shows it, what ``results.json`` calls it.

    head: header on the page; a number without one is in ``results.json`` only. key: of the value in a row. kind:
    `TEXT`, `NAME`, or how a number is rounded, a key of `words.PLACES`; a count without a method is a whole number.
    end: what the number's dotted name has after the row's own. method: how it was computed; may hold the row's keys in
    braces. interval: what its interval is; ends: what comes before "low" and "high" in the keys of its ends. show: of
    a number with an interval, both in two columns (the second headed head_interval), or one of them. n: key of how
    many stimuli, participants or judgements it is based on, if not the table's.
    """

    head: str
    key: str
    kind: str = "correlation"
    end: str = ""
    method: str = ""
    interval: str = ""
    ends: str = ""
    show: str = BOTH
    head_interval: str = "Interval"
    n: str = ""

    @property
    def heads(self) -> tuple[str, ...]:
        """Headers on the page."""
        if not self.head or self.show == INTERVAL or not self.interval or self.show == VALUE:
            return (self.head,) if self.head else ()
        return self.head, self.head_interval

    def make_number(self, row: Record, *, path: str, n: str) -> Number:
        """Make the number that a row holds; path: of the table, the row's keys in braces."""
        own, count = _fill(path, row), int(row[self.n or n])
        name = f"{own}.{self.end}" if self.end else own
        # A number has a method of its own: how it was computed.
        named = {
            key: "coefficient" if key == "method" else key.lstrip("_")
            for key in re.findall(KEY, path)
        }
        keys = tuple((name, str(row[key])) for key, name in named.items())
        if self.kind == COUNT and not self.method:
            number = count_number(name, row[self.key], n=count)
        else:
            number = make_number(name, row[self.key], self.method.format_map(row), n=count)
        number = replace(number, statistic=self.end or "value", keys=keys)
        if not self.interval:
            return number
        low, high = row[f"{self.ends}low"], row[f"{self.ends}high"]
        return make_interval(number, low, high, uncertainty=self.interval)

    def show_number(self, number: Number) -> tuple[str, ...]:
        """Write a number for the page."""
        value, interval = format_estimate(number.value, number.low, number.high, kind=self.kind)
        if not self.head:
            return ()
        if self.show == INTERVAL:
            return (interval,)
        return (value, interval) if len(self.heads) > 1 else (value,)


def estimate(head: str, key: str, method: str, **more: str) -> Column:
    """Declare an estimate of a mixed model with its t interval; its kind is "slope" if no other is given."""
    return Column(head, key, method=method, interval=SATTERTHWAITE, **{"kind": "slope", **more})


DF = Column("df", "df", "df", "df", "Satterthwaite's degrees of freedom")
P = Column("p", "p", "p", "p", "two-sided t test")
P_HOLM = Column(
    "p (Holm)", "p_holm", "p", "p_holm", "two-sided t test, Holm's adjustment over its table"
)
RATINGS = Column("Ratings", "_ratings", TEXT)
MEAN = Column(
    "Mean", "mean", "rating", method="rating, mean over participants of each participant's mean", interval=STUDENT,
    n="n_participants",
)  # fmt: skip
METRIC = Column("Metric", "metric", TEXT)


@dataclass(frozen=True, slots=True)
class PageTable:
    """A table of the page, in words, and its numbers."""

    caption: str
    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    numbers: tuple[Number, ...] = ()
    text_columns: frozenset[int] = frozenset()
    detail: bool = True


@dataclass(frozen=True, slots=True)
class TableForm:
    """A declared table: its caption, its columns, and the dotted name of a row's numbers, the row's keys in braces.

    n: key of how many stimuli, participants or judgements a row is based on. detail: folded away on the page.

    Examples
    --------
    >>> columns = (Column("Scale", "scale", TEXT), Column("r", "r", method="Pearson's r"))
    >>> table = TableForm("How well.", columns, path="r.{scale}").build([{"scale": "v1.0", "r": 0.5, "n": 9}])
    >>> table.rows, table.numbers[0].name
    ((('v1.0', '0.50'),), 'r.v1%2E0')
    """

    caption: str
    columns: Sequence[Column]
    path: str
    n: str = "n"
    detail: bool = True

    def build(self, rows: Iterable[Record], *, caption: str = "") -> PageTable:
        """Build the table of rows, with a caption of its own if that is given."""
        shown: list[tuple[str, ...]] = []
        numbers: list[Number] = []
        for row in rows:
            cells: list[str] = []
            for column in self.columns:
                if column.kind in {TEXT, NAME}:
                    value = str(row[column.key])
                    cells.append(format_name(value) if column.kind == TEXT else value)
                    continue
                numbers.append(column.make_number(row, path=self.path, n=self.n))
                cells += column.show_number(numbers[-1])
            shown.append(tuple(cells))
        kinds = [column.kind for column in self.columns for _ in column.heads]
        head = tuple(name for column in self.columns for name in column.heads)
        words = frozenset(i for i, kind in enumerate(kinds) if kind in {TEXT, NAME})
        caption = caption or self.caption
        return PageTable(caption, head, tuple(shown), tuple(numbers), words, self.detail)


def word_steps(form: TableForm, steps: Mapping[str, Step]) -> TableForm:
    """Word a table of slopes for metrics whose steps differ from +0.1: the step then has a column."""
    if {step.per for step in steps.values()} <= {"+0.1"}:
        return form
    columns: list[Column] = []
    for column in form.columns:
        if "+0.1" in column.head:
            columns.append(Column("Step", "_per", NAME))
        columns.append(replace(column, head=column.head.replace("+0.1", "step")))
    return replace(form, columns=columns, caption=form.caption.replace("+0.1", "step"))


def _fill(path: str, row: Record) -> str:
    """Fill a path's keys in; a point in a value is escaped, because points separate."""
    return re.sub(KEY, lambda match: name_path(str(row[match[1]])), path)


@dataclass(frozen=True, slots=True, eq=False)
class Picture:
    """A figure of a report: its file's name, its caption, and the figure or what draws it.

    drawing: a `Figure`, or a function without arguments (a `functools.partial` that can be pickled), which is called
    only when the figure is needed and may then run beside other work.
    """

    name: str
    caption: str
    drawing: Figure | Callable[[], Figure]
    detail: bool = False

    @property
    def figure(self) -> Figure:
        """The figure, drawn."""
        return self.drawing() if callable(self.drawing) else self.drawing


SLUG_PART = 40
"""Characters of a name that a file's name keeps."""


def make_slug(*parts: str) -> str:
    """Make names readable in a file's name; a digest follows one that this changes or cuts, to tell it from others."""
    return "_".join(map(_make_part, parts))


def _make_part(part: str) -> str:
    short = re.sub(r"[^A-Za-z0-9_-]+", "-", part)[:SLUG_PART]
    return short if short == part else f"{short}-{_digest(part)}"


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()[:6]


def name_pictures(pictures: Iterable[Picture]) -> Iterator[Picture]:
    """Make figures' names unique on any file system: those that differ by case only end with a digest.

    A figure keeps its name when others come or go.
    """
    pictures = tuple(pictures)
    times = Counter(picture.name.casefold() for picture in pictures)
    for picture in pictures:
        alike = times[picture.name.casefold()] > 1
        digest = _digest(picture.name + picture.caption)
        yield replace(picture, name=f"{picture.name}-{digest}") if alike else picture


@dataclass(frozen=True, slots=True, eq=False)
class Section:
    """A part of a report, as data; what is empty in it is left out.

    key: its name in paths and anchors. answers: what it shows, in words; numbers in them are among its numbers.
    verdict: what it has to say where the report opens. grids: tables of the page. unseen: numbers that are in words or
    figures only. tables: CSV files by name, each a frame or a list of rows (keys that begin with an underscore are for
    the page only, and tuples are joined). notes: what was left out or assumed, and why. how: how it was computed.
    claims: what it concludes, for a program. panels: correlations, to be compared with the claims of other sections.
    points: of the scatters, as JSON for the page's script.
    """

    key: str
    title: str
    answers: Sequence[str] = ()
    verdict: Sequence[Line] = ()
    grids: Sequence[Any] = ()
    unseen: Sequence[Number] = ()
    tables: Mapping[str, Any] = field(default_factory=dict)
    pictures: Sequence[Picture] = ()
    notes: Sequence[str] = ()
    how: Sequence[str] = ()
    claims: Sequence[Claim] = ()
    panels: Sequence[Panel] = ()
    points: str = ""

    def __post_init__(self) -> None:
        """Leave out what is empty, make frames of rows, and tuples of lists."""
        frames = {name: rows for name, rows in self.tables.items() if len(rows)}
        if any(isinstance(rows, list) for rows in frames.values()):
            import pandas as pd

            frames = {
                name: pd.DataFrame(list(map(_clean, rows)) if isinstance(rows, list) else rows)
                for name, rows in frames.items()
            }
        lists = {name: tuple(getattr(self, name)) for name in ("answers", "verdict", "pictures")}
        lists |= {
            "grids": tuple(grid for grid in self.grids if grid.rows), "unseen": tuple(self.unseen),
            "notes": tuple(dict.fromkeys(self.notes)), "claims": tuple(self.claims),
        }  # fmt: skip
        for name, value in {**lists, "tables": frames}.items():
            object.__setattr__(self, name, value)
        object.__setattr__(self, "how", () if self.is_empty else tuple(self.how))

    @property
    def numbers(self) -> tuple[Number, ...]:
        """Every number of the section, each once."""
        shown = chain.from_iterable(grid.numbers for grid in self.grids)
        return tuple(dict.fromkeys(chain(shown, self.unseen)))

    @property
    def summary(self) -> str:
        """What the fold is called; empty without one. What opens the report is given there at length."""
        kinds = {
            "in words": bool(self.verdict) and self.answers != tuple(map(str, self.verdict)),
            "tables": any(grid.detail for grid in self.grids),
            "further figures": any(picture.detail for picture in self.pictures),
        }
        return ", ".join(name for name, folded in kinds.items() if folded).capitalize()

    @property
    def is_empty(self) -> bool:
        """Whether there is nothing to be shown."""
        return not (self.grids or self.pictures or self.answers)


def read_methods(key: str, **numbers: float) -> tuple[str, ...]:
    """Read how a section is computed, paragraph by paragraph, from ``methods.toml``."""
    texts = tomllib.loads((Path(__file__).parent / "methods.toml").read_text(encoding="utf-8"))
    return tuple(text.format(**numbers) for text in texts[key])


def _clean(row: Record) -> dict[Any, Any]:
    return {
        key: " ".join(map(str, value)) if isinstance(value, tuple) else value
        for key, value in row.items()
        if not key.startswith("_")
    }


def stack(frames: Iterable[tuple[Mapping[str, Any], DataFrame]]) -> Any:  # noqa: ANN401 - a frame, or nothing
    """Stack frames, each with further columns; empty ones are left out."""
    import pandas as pd

    own = [frame.assign(**more) for more, frame in frames if len(frame)]
    return pd.concat(own, ignore_index=True) if own else []
