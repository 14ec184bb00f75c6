"""What every section of a report is made of; a number is shown only by being part of it."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import chain
from typing import TYPE_CHECKING

from analysis.words import tell_ends

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from pandas import DataFrame

    from analysis.findings import Panel
    from analysis.numbers import Number
    from analysis.report.lines import Claim, Line
    from analysis.report.pictures import Picture

VALUE, INTERVAL = "value", "interval"


@dataclass(frozen=True, slots=True)
class Cell:
    """A number's place in a table of the page.

    Parameters
    ----------
    number : Number
        What is shown.
    kind : str
        A name of `analysis.words.PLACES`.
    part : str
        ``value`` or ``interval``.
    """

    number: Number
    kind: str = "correlation"
    part: str = VALUE

    def __str__(self) -> str:
        """Write it for the page."""
        value, interval = tell_ends(self.number.value, self.number.low, self.number.high, kind=self.kind)
        return interval if self.part == INTERVAL else value


@dataclass(frozen=True, slots=True)
class Grid:
    """A table of the page.

    Parameters
    ----------
    caption : str
        What each number is.
    head : tuple of str
        Column heads.
    rows : tuple of tuple of str or Cell
        Words, and numbers by their names.
    detail : bool
        Whether the page folds it away.
    """

    caption: str
    head: tuple[str, ...]
    rows: tuple[tuple[str | Cell, ...], ...]
    detail: bool = True

    @property
    def text_columns(self) -> frozenset[int]:
        """Numbers of the columns that hold words."""
        return frozenset(place for row in self.rows[:1] for place, cell in enumerate(row) if isinstance(cell, str))

    def cells(self) -> Iterator[Cell]:
        """Yield every number's place.

        Yields
        ------
        Cell
            Row by row.
        """
        for row in self.rows:
            yield from (cell for cell in row if isinstance(cell, Cell))


@dataclass(frozen=True, slots=True, eq=False)
class Section:
    """A part of a report, as data.

    Parameters
    ----------
    key : str
        Its name in paths and anchors.
    title : str
        Its heading.
    answers : tuple of str
        What it shows, in words; numbers in them are among its numbers.
    verdict : tuple of Line
        What it has to say where the report opens.
    grids : tuple of Grid
        Tables of the page.
    unseen : tuple of Number
        Numbers that are in words or figures only.
    tables : Mapping of str to DataFrame
        Files, by name without suffix.
    pictures : tuple of Picture
        Figures.
    notes : tuple of str
        What was left out or assumed, and why; one sentence each.
    how : tuple of str
        How it was computed.
    claims : tuple of Claim
        What it concludes, for a program.
    panels : tuple of Panel
        Correlations, to be held against the claims of other sections.
    """

    key: str
    title: str
    answers: tuple[str, ...] = ()
    verdict: tuple[Line, ...] = ()
    grids: tuple[Grid, ...] = ()
    unseen: tuple[Number, ...] = ()
    tables: Mapping[str, DataFrame] = field(default_factory=dict)
    pictures: tuple[Picture, ...] = ()
    notes: tuple[str, ...] = ()
    how: tuple[str, ...] = ()
    claims: tuple[Claim, ...] = ()
    panels: tuple[Panel, ...] = ()

    @property
    def numbers(self) -> tuple[Number, ...]:
        """Every number of the section, each once."""
        shown = (cell.number for cell in chain.from_iterable(grid.cells() for grid in self.grids))
        return tuple(dict.fromkeys(chain(shown, self.unseen)))

    @property
    def has_details(self) -> bool:
        """Whether the page folds something away."""
        return bool(self.summary)

    @property
    def summary(self) -> str:
        """What the fold is called; empty without one. What opens the report is told there at length."""
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
