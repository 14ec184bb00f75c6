"""Ratings split into what one model or one correlation is about."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from feel321.analysis.report.section import name_ratings, name_subject
from feel321.analysis.table.items import find_sources, recast_pairs
from feel321.analysis.table.metrics import Step, find_steps
from feel321.analysis.table.schema import APART

if TYPE_CHECKING:
    import numpy as np
    from pandas import DataFrame, Series

    from feel321.analysis.resampling import Choices
    from feel321.analysis.table.items import Table

ITEM, WHO, SCENE = "item", "participant", "recording"
SIGNIFICANCE = 0.05


@dataclass(frozen=True, slots=True, eq=False)
class RatingsPart:
    """Ratings of test stimuli on one scale and one level; several: whether there are other levels."""

    scale: str
    level: str
    rows: DataFrame
    several: bool = False
    thinned: str = ""

    @property
    def ratings(self) -> str:
        """How to call it within a sentence."""
        return name_ratings(self.scale, self.level * self.several)

    @property
    def subject(self) -> str:
        """How to call it at the head of a line."""
        return name_subject(self.scale, self.level * self.several)

    @property
    def place(self) -> tuple[str, str]:
        """Scale and level."""
        return self.scale, self.level

    @property
    def lead(self) -> str:
        """What leads a note."""
        return f"{self.scale}, {self.level}"

    @property
    def keys(self) -> dict[str, str]:
        """What a row says of it."""
        return {"scale": self.scale, "level": self.level}


def split_parts(table: Table, *, matched: bool = True) -> Iterator[RatingsPart]:
    """Split the ratings of test stimuli by scale and level."""
    rated = select_tests(table, matched=matched)
    several = len(rated["level"].unique()) > 1
    for scale, level, part in split_arms(rated):
        yield RatingsPart(scale, level, part.assign(**{ITEM: part["stimulus_id"]}), several)


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


def find_table_steps(table: Table) -> dict[str, Step]:
    """Find the step of every metric of the primary analysis; one for all scales and levels."""
    tests = table.rows[table.rows["role"] == "test"].drop_duplicates("stimulus_id")
    return find_steps(tests, table.metrics, table.info)


def join_steps(steps: Mapping[str, Step]) -> str:
    """Write the steps of several metrics: the one that they share, or a word."""
    told = {step.per for step in steps.values()}
    return told.pop() if len(told) == 1 else "step"


def count_units(rows: DataFrame) -> dict[str, int]:
    """Count what is independent of each other: participants, and recordings or their sources."""
    sources = find_sources(rows)
    scene = SCENE if sources.is_unique else "source"
    return {WHO: rows[WHO].nunique(), scene: sources.nunique()}


# More ratings than a mixed model can be fitted to in reasonable time and memory.

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
