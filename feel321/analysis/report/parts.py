"""Ratings split into what one model or one correlation is about, and what several sections compute of them."""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from feel321.analysis.primary.model import CENTRED, FEW, fit_slopes
from feel321.analysis.table.items import find_sources, recast_pairs
from feel321.analysis.table.metrics import TENTH, Step, find_steps
from feel321.analysis.table.schema import APART
from feel321.analysis.words import format_name, format_number, format_ratings, join_words

if TYPE_CHECKING:
    from pandas import DataFrame, Series

    from feel321.analysis.primary.plan import Cells
    from feel321.analysis.resampling import Choices
    from feel321.analysis.table.items import Table

ITEM, SIGNIFICANCE = "item", 0.05


@dataclass(frozen=True, slots=True, eq=False)
class RatingsPart:
    """Ratings of test stimuli on one scale and one level."""

    scale: str
    level: str
    rows: DataFrame
    subject: str
    thinned: str = ""

    @property
    def ratings(self) -> str:
        """How to call it within a sentence."""
        return format_ratings(self.subject)

    @property
    def place(self) -> tuple[str, str]:
        """What leads the path of its numbers."""
        return self.scale, self.level

    @property
    def lead(self) -> str:
        """What leads a note, and its name in a table."""
        return f"{self.scale}, {self.level}"

    @property
    def keys(self) -> dict[str, str]:
        """What a row of a table says of it."""
        return {"scale": self.scale, "level": self.level, "_ratings": self.lead}


def split_parts(table: Table, *, matched: bool = True) -> Iterator[RatingsPart]:
    """Split the ratings of test stimuli by scale and level."""
    rated = select_tests(table, matched=matched)
    several = len(rated["level"].unique()) > 1
    for scale, level, part in split_arms(rated):
        subject = format_name(scale) + (f" (level {format_name(level)})" if several else "")
        rows = part.assign(**{ITEM: part["stimulus_id"]})
        yield RatingsPart(scale, level, rows, subject)


def split_arms(rows: DataFrame) -> Iterator[tuple[str, str, DataFrame]]:
    """Split rows by scale, in their order, and level, by name."""
    arms = dict(tuple(rows.groupby(["scale", "level"], observed=True)))
    order = {scale: place for place, scale in enumerate(rows["scale"].unique())}
    for scale, level in sorted(arms, key=lambda arm: (order[arm[0]], arm[1])):
        yield str(scale), str(level), arms[scale, level]


def select_tests(table: Table, *, matched: bool = True) -> DataFrame:
    """Select the ratings of single test stimuli, with metrics where asked for."""
    rows = recast_pairs(table.rows)
    rated = rows[(rows["role"] == "test") & ~rows["scale"].isin(APART)]
    return rated[rated["matched"]] if matched and "matched" in rated else rated


# More ratings than a mixed model can be fitted to in reasonable time and memory.

WHO, SCENE = "participant", "recording"
MOST_DENSE = 1500
"""Random effects besides those of the largest group, which make a dense matrix."""

MOST_PRODUCTS = 40_000_000
"""Of those and the effects of the largest group: 320 MB."""

FEWEST = 8
"""Participants and recordings are not thinned below this."""


def thin_parts(
    table: Table, choices: Choices, *, n_slopes: int | None = None, matched: bool = True
) -> Iterator[RatingsPart]:
    """Split the ratings of test stimuli into parts that a mixed model can be fitted to."""
    size = len(table.metrics) if n_slopes is None else n_slopes
    for part in split_parts(table, matched=matched):
        rng = choices.make_rng("thin", *part.place)
        rows, thinned = thin_rows(part.rows, n_slopes=size, rng=rng)
        yield replace(part, rows=rows, thinned=thinned and f"{part.lead}: {thinned}")


def thin_rows(rows: DataFrame, *, n_slopes: int, rng: np.random.Generator) -> tuple[DataFrame, str]:
    """Subsample participants or recordings so that the model fits in memory, and note it."""
    sources, left = find_sources(rows), rows
    while is_large(left, n_slopes):
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
    why = f"{len(rows)} ratings are too many for one fit"
    return left, f"mixed models use {told}, drawn at random: {why}."


def _draw_half(names: list[str], sources: Series | None, *, rng: np.random.Generator) -> set[str]:
    """Draw half of the names; of recordings, the first of every source before the second of any."""
    half = len(names) // 2
    if sources is None or sources.is_unique:
        return set(rng.choice(names, size=half, replace=False))
    shuffled = sources.loc[rng.permutation(names)]
    copy = shuffled.groupby(shuffled).cumcount()
    return set(copy.sort_values(kind="stable").index[:half])


def is_large(rows: DataFrame, n_slopes: int) -> bool:
    """Check whether a mixed model of these ratings would take gigabytes, or hours."""
    cells = rows.groupby([WHO, ITEM], observed=True).size()
    levels = [
        rows[WHO].nunique() * (1 + n_slopes), rows[SCENE].nunique(), rows[ITEM].nunique(),
        len(rows[[WHO, SCENE]].drop_duplicates()),
    ]  # fmt: skip
    # Unequal repeats bring a spread of their own.
    levels += [len(cells)] if cells.min() < cells.max() else []
    dense = sum(levels) - max(levels)
    return dense > MOST_DENSE or dense * max(levels) > MOST_PRODUCTS


# Steps by which slopes are reported: +0.1 of a match, +10 of a level in dB.


def find_table_steps(table: Table) -> dict[str, Step]:
    """Find the step of every metric of the primary analysis; one for all scales and levels."""
    tests = table.rows[table.rows["role"] == "test"].drop_duplicates("stimulus_id")
    return find_steps(tests, table.metrics, table.info)


def add_step(row: Mapping[Any, Any], step: Step) -> dict[Any, Any]:
    """Give a row the slope per step, and how the step is written, beside the slope per 0.1."""
    share = step.size / TENTH
    ends = {f"_step{end}": row[f"tenth{end}"] * share for end in ("", "_low", "_high")}
    return {**row, **ends, "_per": step.per, "_size": step.size}


def join_steps(steps: Mapping[str, Step]) -> str:
    """Write the steps of several metrics: the one that they share, or a word."""
    told = {step.per for step in steps.values()}
    return told.pop() if len(told) == 1 else "step"


# What several sections compute and say of a part.


def fit_rest(cells: Cells, out: Iterable[Hashable], *, people: int) -> DataFrame:
    """Fit the slopes without the raters that a rule flags, of so many people."""
    rest = cells.leave_out(WHO, *out)
    if rest.count(WHO) == 1 < people:
        raise ValueError(
            f"One rater of {people} is left: an interval would not know how people differ."
        )
    slopes = fit_slopes(rest).table
    return slopes.assign(**dict.fromkeys(CENTRED.values(), np.nan))


def count_units(rows: DataFrame) -> dict[str, int]:
    """Count what is independent of each other: participants, and recordings or their sources."""
    sources = find_sources(rows)
    scene = SCENE if sources.is_unique else "source"
    return {WHO: rows[WHO].nunique(), scene: sources.nunique()}


def describe_hint(few: Sequence[str]) -> str:
    """Say that a finding is a hint, by the units of which there are few.

    Examples
    --------
    >>> describe_hint(["4 reducers"]), describe_hint([])
    (' (with 4 reducers, a hint rather than a result)', '')
    """
    return f" (with {join_words(few)}, a hint rather than a result)" if few else ""


def describe_reach(sizes: Mapping[str, int], *, claimed: bool = True) -> str:
    """Say what a claim does not reach, or hardly, by the number of what was drawn.

    Examples
    --------
    >>> describe_reach({"participant": 1, "recording": 9}), describe_reach({"participant": 9, "recording": 4})
    (', about this one participant only', ', a hint rather than a result with so few recordings')
    """
    alone = [name for name, count in sizes.items() if count == 1]
    few = [f"{name}s" for name, count in sizes.items() if 1 < count < FEW]
    told = f", about this one {' and this one '.join(alone)} only" if alone else ""
    hint = f", a hint rather than a result with so few {' and '.join(few)}"
    return told + hint * bool(few and claimed)


def format_p(p: float) -> str:
    """Write a probability that was adjusted by Holm's method.

    Examples
    --------
    >>> format_p(0.0123)
    'p (Holm) = 0.012'
    """
    told = format_number(p, kind="p")
    return f"p (Holm) {told if told.startswith('<') else f'= {told}'}"
