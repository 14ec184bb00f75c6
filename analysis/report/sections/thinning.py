"""More ratings than a mixed model can be fitted to in reasonable time and memory: whole people or recordings are drawn.

A random half of the people or of the recordings is a study of its own, whose model and intervals hold; only less is
known. Leaving out a spread instead, so that everything fits, would make intervals too narrow. Where several recordings
come from one source, copies go before sources: what is said of other recordings rests on how many sources there are.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from analysis.report.sections.parts import ITEM, split_parts
from analysis.table.sources import find_sources

if TYPE_CHECKING:
    from collections.abc import Iterator

    import numpy as np
    from pandas import DataFrame, Series

    from analysis.report.sections.choices import Choices
    from analysis.report.sections.parts import Part
    from analysis.table.reading import Table

WHO, SCENE = "participant", "recording"
MOST_DENSE = 1500
"""Random effects besides those of the largest group, which make a dense matrix."""

MOST_PRODUCTS = 40_000_000
"""Of those and the effects of the largest group: 320 MB."""

FEWEST = 8
"""People and recordings are not thinned below this."""


def thin_parts(table: Table, choices: Choices, *, n_slopes: int | None = None, matched: bool = True) -> Iterator[Part]:
    """Split the ratings of test stimuli into what one mixed model can carry.

    Parameters
    ----------
    table : Table
        What was rated.
    choices : Choices
        Seed.
    n_slopes : int, optional
        Effects that differ from person to person, besides their level; one per metric if left out.
    matched : bool
        As `split_parts` has it.

    Yields
    ------
    Part
        As `split_parts` gives them; too large ones thinned, and saying so.
    """
    size = len(table.metrics) if n_slopes is None else n_slopes
    for part in split_parts(table, matched=matched):
        rows, thinned = thin_rows(part.rows, n_slopes=size, rng=choices.make_rng("thin", *part.place))
        yield replace(part, rows=rows, thinned=thinned and f"{part.lead}: {thinned}")


def thin_rows(rows: DataFrame, *, n_slopes: int, rng: np.random.Generator) -> tuple[DataFrame, str]:
    """Draw people or recordings, whichever are more, by half until a mixed model can carry the rest.

    Parameters
    ----------
    rows : DataFrame
        One row per judgement: participant, recording, item; source, where several recordings come from one.
    n_slopes : int
        Slopes that differ from person to person.
    rng : Generator
        Source of randomness.

    Returns
    -------
    rows : DataFrame
        What is left.
    told : str
        What was done; empty if nothing was.
    """
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
    told = " and ".join(f"{left[name].nunique()} of {rows[name].nunique()} {name}s" for name in (WHO, SCENE))
    if not sources.is_unique:
        told += f" ({find_sources(left).nunique()} of {sources.nunique()} sources)"
    return left, f"mixed models rest on {told}, drawn at random: {len(rows)} ratings are too many for one fit."


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
