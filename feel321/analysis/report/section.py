"""Sections of a report: the record, what may be chosen, and what several sections share.

Every section is one function `compute_NAME(table, choices) -> Section`. One that the ratings do not allow is left out,
and its notes say why.
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass, field, replace
from itertools import chain
from typing import TYPE_CHECKING, Any

import numpy as np

from feel321.analysis.primary.model import FEW, fit_primary
from feel321.analysis.table.items import find_sources
from feel321.analysis.table.sheet import APART
from feel321.analysis.words import (
    SATTERTHWAITE,
    STUDENT,
    make_interval,
    make_number,
    name_path,
    tell_ends,
    tell_name,
    tell_number,
    tell_ratings,
)

if TYPE_CHECKING:
    from collections.abc import Hashable, Iterator, Mapping, Sequence

    from matplotlib.figure import Figure
    from pandas import DataFrame, Series

    from feel321.analysis.association.correlate import Panel
    from feel321.analysis.primary.model import Primary
    from feel321.analysis.table.reading import Table
    from feel321.analysis.words import Claim, Line, Number

# How a report was computed, told to its reader; part of ``results.json``.

PROFILES = (
    "Profiles: mean over participants of each participant's mean over stimuli, on a scale from 0 to 100; 95 % t "
    "intervals over participants, cut off at the ends of the scale, which speak of other people judging these "
    "recordings. Where all participants' means are alike there is no interval: they do not tell how people differ."
)


def tell_associations(draws: int) -> tuple[str, ...]:
    """Describe how correlations were computed."""
    return (
        "Ratings run from 0 to 100. A stimulus's rating is the mean over participants of each participant's mean "
        "over repeats. The hidden reference and the anchors are left out of every association, because stimuli "
        "chosen to be far apart inflate a correlation; they stand in the profile of ratings.",
        "Correlations are over test stimuli, separately per scale and level. Pearson's r measures how straight the "
        "relation is, Spearman's how monotone it is.",
        f"Two-way intervals: {draws} bootstrap draws of participants and, independently, of recordings with all "
        "their stimuli, both with replacement; "
        "tanh(atanh r ± t(.975, U − 1) sqrt(U / (U − 1)) SD(atanh r*)) with U the number of recordings or of "
        "participants, whichever is smaller (recordings of one source are drawn together and count as one): the fewer "
        "there are, the less is known of how they differ. Draws that "
        "give no correlation are left out and counted; with more than a tenth of them there is no interval. They say "
        "what other people and other recordings might give. Intervals over participants only treat these very stimuli "
        "as the only ones; they are far too narrow for a claim about the metric and are shown for comparison with the "
        "literature.",
        "Differences between metrics: both correlations are recomputed in every draw; the interval of the difference "
        "of Fisher's z is told as a difference of correlations about their mean z.",
        "Noise ceiling: sqrt(ICC(C,k)) from a two-way analysis of variance, the correlation that a perfect metric "
        "would be expected to reach with ratings as noisy as these; it rests on the stimuli that everyone rated and "
        "needs half of them. r / ceiling is for Pearson's r only, because the ceiling is that of a straight relation, "
        "and is left out where the ceiling rests on fewer stimuli than r; it may exceed 1 by chance.",
    )


# What every section of a report is made of; a number is shown only by being part of it.

VALUE, INTERVAL = "value", "interval"


@dataclass(frozen=True, slots=True)
class Cell:
    """A number's place in a table of the page."""

    number: Number
    kind: str = "correlation"
    part: str = VALUE

    def __str__(self) -> str:
        """Write it for the page."""
        value, interval = tell_ends(
            self.number.value, self.number.low, self.number.high, kind=self.kind
        )
        return interval if self.part == INTERVAL else value


@dataclass(frozen=True, slots=True)
class Grid:
    """A table of the page."""

    caption: str
    head: tuple[str, ...]
    rows: tuple[tuple[str | Cell, ...], ...]
    detail: bool = True

    @property
    def text_columns(self) -> frozenset[int]:
        """Numbers of the columns that hold words."""
        return frozenset(
            place
            for row in self.rows[:1]
            for place, cell in enumerate(row)
            if isinstance(cell, str)
        )

    def cells(self) -> Iterator[Cell]:
        """Yield every number's place."""
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


@dataclass(frozen=True, slots=True, eq=False)
class Picture:
    """A figure of the report."""

    name: str
    kind: str
    caption: str
    figure: Figure
    detail: bool = False


# What whoever analyses a study may choose, and where randomness comes from.


@dataclass(frozen=True, slots=True)
class Choices:
    """Choices that were made before the ratings were seen.

    Parameters
    ----------
    draws : int
        Bootstrap draws per interval and random pairings per permutation test, at least 2.
    margin : float or None
        Difference in points that does not matter; None: half the spread with which people repeat their ratings.
    seed : int
        Of all randomness.
    """

    draws: int = 2000
    margin: float | None = None
    seed: int = 0

    def __post_init__(self) -> None:
        """Refuse what cannot be."""
        if self.draws < 2:  # noqa: PLR2004 - a spread needs two
            raise ValueError(
                f"draws: got {self.draws}, allowed is 2 or more; use 2000 for results to be published"
            )
        if self.margin is not None and not 0 < self.margin < np.inf:
            raise ValueError(
                f"margin: got {self.margin}, allowed is above 0, in points of the scale, or none"
            )

    def make_rng(self, *names: str) -> np.random.Generator:
        """Make the source of randomness of one result.

        Parameters
        ----------
        *names : str
            What the result is called.

        Returns
        -------
        Generator
            Its own: a further metric or section does not change the intervals of the others.
        """
        return np.random.default_rng([self.seed, zlib.crc32(name_path(*names).encode())])


# Ratings split into what one model or one correlation is about: a scale and a level.

ITEM = "item"


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """Ratings of test stimuli on one scale and one level."""

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
    """Split the ratings of test stimuli."""
    rows = table.rows
    rated = rows[(rows["role"] == "test") & ~rows["scale"].isin(APART)]
    rated = rated[rated["matched"]] if matched and "matched" in rated else rated
    several = len(rated["level"].unique()) > 1
    for (scale, level), part in rated.groupby(["scale", "level"], observed=True):
        subject = tell_name(str(scale)) + (f" (level {tell_name(str(level))})" if several else "")
        yield Part(str(scale), str(level), part.assign(**{ITEM: part["stimulus_id"]}), subject)


# More ratings than a mixed model can be fitted to in reasonable time and memory: whole people or recordings are drawn.

WHO, SCENE = "participant", "recording"
MOST_DENSE = 1500
"""Random effects besides those of the largest group, which make a dense matrix."""

MOST_PRODUCTS = 40_000_000
"""Of those and the effects of the largest group: 320 MB."""

FEWEST = 8
"""People and recordings are not thinned below this."""


def thin_parts(
    table: Table, choices: Choices, *, n_slopes: int | None = None, matched: bool = True
) -> Iterator[Part]:
    """Split the ratings of test stimuli into what one mixed model can carry."""
    size = len(table.metrics) if n_slopes is None else n_slopes
    for part in split_parts(table, matched=matched):
        rows, thinned = thin_rows(
            part.rows, n_slopes=size, rng=choices.make_rng("thin", *part.place)
        )
        yield replace(part, rows=rows, thinned=thinned and f"{part.lead}: {thinned}")


def thin_rows(rows: DataFrame, *, n_slopes: int, rng: np.random.Generator) -> tuple[DataFrame, str]:
    """Draw people or recordings, whichever are more, by half until a mixed model can carry the rest."""
    sources, left = find_sources(rows), rows
    while _is_large(left, n_slopes):
        names = {name: sorted(left[name].unique()) for name in (WHO, SCENE)}
        longer = max((WHO, SCENE), key=lambda name: len(names[name]))
        if len(names[longer]) < 2 * FEWEST:
            break
        kept = _draw_half(names[longer], None if longer == WHO else sources, rng=rng)
        left = left[left[longer].isin(kept)]
    if len(left) == len(rows):
        return rows, ""
    told = " and ".join(
        f"{left[name].nunique()} of {rows[name].nunique()} {name}s" for name in (WHO, SCENE)
    )
    if not sources.is_unique:
        told += f" ({find_sources(left).nunique()} of {sources.nunique()} sources)"
    return (
        left,
        f"mixed models rest on {told}, drawn at random: {len(rows)} ratings are too many for one fit.",
    )


def _draw_half(names: list[str], sources: Series | None, *, rng: np.random.Generator) -> set[str]:
    """Draw half of people or recordings; of recordings, the first of every source before the second of any."""
    half = len(names) // 2
    if sources is None or sources.is_unique:
        return set(rng.choice(names, size=half, replace=False))
    shuffled = sources.loc[rng.permutation(names)]
    copy = shuffled.groupby(shuffled).cumcount()
    return set(copy.sort_values(kind="stable").index[:half])


def _is_large(rows: DataFrame, n_slopes: int) -> bool:
    cells = rows.groupby([WHO, ITEM], observed=True).size()
    levels = [
        rows[WHO].nunique() * (1 + n_slopes), rows[SCENE].nunique(), rows[ITEM].nunique(),
        len(rows[[WHO, SCENE]].drop_duplicates()),
    ]  # fmt: skip
    # Unequal repeats bring a spread of their own.
    levels += [len(cells)] if cells.min() < cells.max() else []
    dense = sum(levels) - max(levels)
    return dense > MOST_DENSE or dense * max(levels) > MOST_PRODUCTS


# Estimates of mixed models as numbers and cells, the same in every section.

SIGNIFICANCE = 0.05


def fit_rest(rows: DataFrame, metrics: Sequence[str], *, people: int) -> Primary:
    """Fit the primary model to the raters whom a rule leaves."""
    left = rows["participant"].nunique()
    if left == 1 < people:
        raise ValueError(
            f"One rater of {people} is left: an interval would not know how people differ."
        )
    return fit_primary(rows, metrics, explain=False)


def name_estimate(
    name: str, row: Mapping[Hashable, Any], method: str, *, n: int, prefix: str = ""
) -> Number:
    """Name an estimate with its t interval."""
    lead = f"{prefix}_" if prefix else ""
    number = make_number(name, row[prefix or "estimate"], method, n=n)
    return make_interval(number, row[f"{lead}low"], row[f"{lead}high"], uncertainty=SATTERTHWAITE)


def name_tests(name: str, row: Mapping[Hashable, Any], *, n: int) -> tuple[Number, ...]:
    """Name the degrees of freedom and the probabilities of an estimate."""
    return (
        make_number(f"{name}.df", row["df"], "Satterthwaite's degrees of freedom", n=n),
        make_number(f"{name}.p", row["p"], "two-sided t test", n=n),
        make_number(
            f"{name}.p_holm",
            row["p_holm"],
            "two-sided t test, Holm's adjustment over its table",
            n=n,
        ),
    )


def lay_estimate(number: Number, kind: str) -> tuple[Cell, Cell]:
    """Lay an estimate and its interval out."""
    return Cell(number, kind), Cell(number, kind, INTERVAL)


def tell_estimate(number: Number, *, kind: str) -> str:
    """Tell an estimate and its interval in words.

    Returns such as ``1.83 points, 95 % interval 1.75 to 1.92``.
    """
    value, interval = tell_ends(number.value, number.low, number.high, kind=kind)
    return f"{value} points, 95 % interval {interval}"


def tell_reach(sizes: Mapping[str, int], *, claimed: bool = True) -> str:
    """Say what a claim does not reach, or hardly.

    sizes: what was drawn -> how many.

    Examples
    --------
    >>> tell_reach({"participant": 1, "recording": 9}), tell_reach({"participant": 9, "recording": 4})
    (', about this one participant only', ', a hint rather than a result with so few recordings')
    """
    alone = [name for name, count in sizes.items() if count == 1]
    few = [f"{name}s" for name, count in sizes.items() if 1 < count < FEW]
    told = f", about this one {' and this one '.join(alone)} only" if alone else ""
    return (
        f"{told}, a hint rather than a result with so few {' and '.join(few)}"
        if few and claimed
        else told
    )


def count_units(rows: DataFrame) -> dict[str, int]:
    """Count what is independent of each other: participants, and recordings or their sources."""
    sources = find_sources(rows)
    scene = "recording" if sources.is_unique else "source"
    return {"participant": rows["participant"].nunique(), scene: sources.nunique()}


def tell_p(p: float) -> str:
    """Tell a probability in words."""
    told = tell_number(p, kind="p")
    return f"p (Holm) {told if told.startswith('<') else f'= {told}'}"


def find_repeat_sd(rows: DataFrame) -> tuple[float, int]:
    """Find the standard deviation with which people repeat their ratings of a stimulus.

    Returns sd: naN without repeats.
    """
    cells = rows.groupby(["participant", ITEM], observed=True)["rating"]
    repeated = cells.transform("size") > 1
    freedom = int(repeated.sum()) - len(
        rows[repeated].groupby(["participant", ITEM], observed=True)
    )
    left = (rows["rating"] - cells.transform("mean"))[repeated]
    return (float(np.sqrt((left**2).sum() / freedom)) if freedom else float("nan")), int(
        repeated.sum()
    )


# Mean ratings as numbers.

MEAN = "rating, mean over participants of each participant's mean"


def name_mean(name: str, row: Mapping[Hashable, Any]) -> Number:
    """Name a mean over participants."""
    number = make_number(name, row["mean"], MEAN, n=row["n_participants"])
    return make_interval(number, row["low"], row["high"], uncertainty=STUDENT)
