"""Tables as they were laid out before `section.build_table`; goes when all sections are converted."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from feel321.analysis.words import (
    SATTERTHWAITE,
    STUDENT,
    Number,
    make_interval,
    make_number,
    tell_ends,
)

if TYPE_CHECKING:
    from collections.abc import Hashable, Iterator, Mapping

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

    @property
    def numbers(self) -> tuple[Number, ...]:
        """Every number."""
        return tuple(cell.number for cell in self.cells())

    def cells(self) -> Iterator[Cell]:
        """Yield every number's place."""
        for row in self.rows:
            yield from (cell for cell in row if isinstance(cell, Cell))


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


MEAN = "rating, mean over participants of each participant's mean"


def name_mean(name: str, row: Mapping[Hashable, Any]) -> Number:
    """Name a mean over participants."""
    number = make_number(name, row["mean"], MEAN, n=row["n_participants"])
    return make_interval(number, row["low"], row["high"], uncertainty=STUDENT)
