"""Ratings split into what one model or one correlation is about: a scale and a level."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from analysis.table.scales import APART
from analysis.words import tell_name, tell_ratings

if TYPE_CHECKING:
    from collections.abc import Iterator

    from pandas import DataFrame

    from analysis.table.reading import Table

ITEM = "item"


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """Ratings of test stimuli on one scale and one level.

    Parameters
    ----------
    scale, level : str
        Which.
    rows : DataFrame
        One row per judgement, with a column ``item``.
    subject : str
        How to call it: the scale, and the level where there are several.
    thinned : str
        What was left out because there is too much of it; empty if nothing was.
    """

    scale: str
    level: str
    rows: DataFrame
    subject: str
    thinned: str = ""

    @property
    def ratings(self) -> str:
        """How to call it within a sentence."""
        return tell_ratings(self.subject)

    @property
    def place(self) -> tuple[str, str]:
        """What leads the path of its numbers."""
        return self.scale, self.level

    @property
    def lead(self) -> str:
        """What leads a note."""
        return f"{self.scale}, {self.level}"


def split_parts(table: Table, *, matched: bool = True) -> Iterator[Part]:
    """Split the ratings of test stimuli.

    Parameters
    ----------
    table : Table
        What was rated.
    matched : bool
        Whether only judgements count that the metrics speak of: not those against what a reducer made.

    Yields
    ------
    Part
        By alphabet; without the scales that do not rate one stimulus by itself.
    """
    rows = table.rows
    rated = rows[(rows["role"] == "test") & ~rows["scale"].isin(APART)]
    rated = rated[rated["matched"]] if matched and "matched" in rated else rated
    several = len(rated["level"].unique()) > 1
    for (scale, level), part in rated.groupby(["scale", "level"], observed=True):
        subject = tell_name(str(scale)) + (f" (level {tell_name(str(level))})" if several else "")
        yield Part(str(scale), str(level), part.assign(**{ITEM: part["stimulus_id"]}), subject)
