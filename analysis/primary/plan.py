"""Which terms of the primary model the data can carry, and in words what they cannot.

The full model has every spread that the design has. A term goes only where it cannot be told from another, never
because a test says that it may be zero.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from analysis.primary.cells import ITEM, RATING, REDUCER, SCENE, SOURCE, WHO, Cells

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray
    from pandas import DataFrame

ALIKE = f"{SOURCE}:{REDUCER}"
"""Stimuli of one source that were reduced alike."""

FEW_REDUCERS = 8
"""Fewer reducers than this get the boundary-avoiding penalty: their spread is estimated as 0 too often."""

DEPENDENT = 1e-8
"""Share of a column's spread below which what others leave of it is rounding."""


@dataclass(frozen=True, slots=True)
class Plan:
    """Which terms the data can carry.

    Parameters
    ----------
    fixed : tuple of str
        Columns of the cells: metrics' parts within and between recordings.
    random : tuple of str
        Brackets in lme4's notation.
    reductions : tuple of str
        What the full model has and this one has not, and why, one sentence each.
    penalty : tuple of str
        Grouping factors whose spread is kept away from zero, because they have few levels.
    """

    fixed: tuple[str, ...]
    random: tuple[str, ...]
    reductions: tuple[str, ...]
    penalty: tuple[str, ...] = ()

    @property
    def formula(self) -> str:
        """The model, in lme4's notation."""
        return " + ".join([f"{RATING} ~ 1", *map(_quote, self.fixed), *self.random])


def plan_terms(cells: Cells, *, correlated: bool, reducers: bool) -> Plan:
    """Choose the terms of the primary model.

    Parameters
    ----------
    cells : Cells
        What it is to be fitted to.
    correlated : bool
        Whether people's slopes correlate.
    reducers : bool
        Whether reducers may differ for reasons that no metric knows.

    Returns
    -------
    Plan
        All terms that the design has, less those that these data cannot carry.

    Raises
    ------
    ValueError
        If no metric differs within recordings, or nothing is left to tell a spread by.
    """
    reductions: list[str] = []
    fixed = _plan_fixed(cells, reductions)
    slopes = [name for name in fixed if name.endswith("_w")]
    bar = "|" if correlated else "||"
    random = [
        *_plan_people(cells, slopes, reductions, bar=bar), *_plan_groups(cells, reductions),
        *_plan_sources(cells, reductions), *(_plan_reducers(cells, slopes, reductions) if reducers else ()),
    ]  # fmt: skip
    if cells.rough:
        reductions.append(
            "Means over unequal numbers of repeats, each counted as equally exact: single ratings have too many levels."
        )
    if not random:
        raise ValueError(
            "rows: got one participant and one recording, allowed is more of either; "
            "for one of each, use ordinary regression"
        )
    few = f"(1 | {REDUCER})" in random and cells.count(REDUCER) < FEW_REDUCERS
    # Of a single difference the penalised likelihood has no maximum: it grows with the spread as fast as it falls.
    penalty = (REDUCER,) if few and _count_free(cells, slopes) > 1 else ()
    return Plan(tuple(fixed), tuple(random), tuple(reductions), penalty)


def _plan_fixed(cells: Cells, reductions: list[str]) -> list[str]:
    within = [f"{name}_w" for name in cells.metrics]
    for name in [name for name in within if not cells.varies(name)]:
        within.remove(name)
        reductions.append(f"No slope of {name[:-2]}: it is the same for all stimuli of a recording.")
    within = _keep_independent(cells, within, reductions)
    if not within:
        raise ValueError(
            f"metrics: got {', '.join(cells.metrics)}, none of which differs between stimuli of a recording; "
            "allowed are metrics that do"
        )
    return [*within, *_plan_between(cells, reductions)]


def _plan_between(cells: Cells, reductions: list[str]) -> list[str]:
    between = [f"{name}_b" for name in cells.metrics if cells.varies(f"{name}_b")]
    scenes = f"source{'s' if cells.n_sources > 1 else ''}" if cells.shared else "of them"
    if cells.n_sources < len(between) + 2 or not between:
        reductions.append(
            f"No slopes between recordings: with {cells.n_sources} {scenes}, {len(cells.metrics)} such slopes "
            "cannot be told from the recordings themselves."
        )
        return []
    return _keep_independent(cells, between, reductions)


def _keep_independent(cells: Cells, columns: list[str], reductions: list[str]) -> list[str]:
    """Leave out metrics that are sums of those before them."""
    kept: list[str] = []
    for name in columns:
        values = cells.table[[*kept, name]].to_numpy()
        values = (values - values.mean(axis=0)) / values.std(axis=0)
        if np.abs(np.diag(np.linalg.qr(values, mode="r")))[-1] > DEPENDENT * np.sqrt(len(values)):
            kept.append(name)
        else:
            reductions.append(f"No term {name}: it is a sum of {', '.join(kept)}.")
    return kept


def _plan_people(cells: Cells, slopes: list[str], reductions: list[str], *, bar: str) -> Iterator[str]:
    people, rows = cells.count(WHO), len(cells.table)
    if people == 1:
        reductions.append("No spread between people: one participant only; nothing here speaks of others.")
        return
    effects = 1 if bar == "||" else len(slopes) + 1
    if people * effects >= rows:
        reductions.append(f"No spread of people's slopes: {rows} rows for {people} participants are too few.")
        slopes = []
    yield f"({' + '.join(['1', *map(_quote, slopes)])} {bar} {WHO})"


def _plan_groups(cells: Cells, reductions: list[str]) -> Iterator[str]:
    """Name the grouping factors besides people, as far as the design tells them apart."""
    recordings, rows, items = cells.count(SCENE), len(cells.table), cells.count(ITEM)
    if recordings > 1:
        yield f"(1 | {SCENE})"
    else:
        reductions.append("No spread between recordings: one recording only; nothing here speaks of others.")
    if items < rows:
        yield f"(1 | {ITEM})"
    else:
        reductions.append("No spread between stimuli: each has one row only, its spread is in the residual.")
    pairs = cells.count(WHO, SCENE)
    if recordings > 1 and cells.count(WHO) > 1:
        if pairs < rows:
            yield f"(1 | {WHO}:{SCENE})"
        else:
            reductions.append("No spread of people's recordings: each has one row only.")
    if cells.repeated and cells.count(WHO) > 1:
        yield f"(1 | {WHO}:{ITEM})"


def _plan_sources(cells: Cells, reductions: list[str]) -> Iterator[str]:
    """Name what recordings of one source share; without it each copy would count as evidence of its own."""
    if not cells.shared:
        return
    if cells.n_sources > 1:
        yield f"(1 | {SOURCE})"
    else:
        reductions.append("No spread between sources: all recordings come from one; nothing here speaks of others.")
    if cells.count(SOURCE, REDUCER) < cells.count(ITEM):
        yield f"(1 | {ALIKE})"


def _plan_reducers(cells: Cells, slopes: list[str], reductions: list[str]) -> Iterator[str]:
    """Name what stimuli of one reducer share, for everyone and for one person, as far as recordings repeat reducers."""
    if REDUCER not in cells.table:
        reductions.append("No spread between reducers: no column 'reducer' says which stimuli were reduced alike.")
        return
    number = cells.count(REDUCER)
    if cells.count(SCENE) == 1 or number in {1, cells.count(ITEM)}:
        why = "one recording only" if cells.count(SCENE) == 1 else "no reducer was used on several recordings"
        reductions.append(f"No spread between reducers: {'one reducer only' if number == 1 else why}.")
        return
    # Of one source, (1 | source:reducer) is this term.
    if not cells.shared or cells.n_sources > 1:
        if _count_free(cells, slopes):
            yield f"(1 | {REDUCER})"
        else:
            reductions.append("No spread between reducers: too few stimuli to tell it from the slopes.")
    if cells.count(WHO) == 1:
        return
    if _has_residual(cells, slopes):
        yield f"(1 | {WHO}:{REDUCER})"
    else:
        reductions.append("No spread of people's reducers: too few stimuli to tell it from the residual.")


def _count_free(cells: Cells, slopes: list[str]) -> int:
    """Count the differences between reducers that neither recordings nor slopes account for."""
    items = cells.table.drop_duplicates(ITEM)
    others = np.hstack([_mark_levels(items, SCENE), _read_slopes(items, slopes)])
    both = np.hstack([others, _mark_levels(items, REDUCER)])
    return int(np.linalg.matrix_rank(both) - np.linalg.matrix_rank(others))


def _has_residual(cells: Cells, slopes: list[str]) -> bool:
    """Tell whether anybody's ratings have a dimension besides their recordings, reducers and slopes."""
    rated = cells.table.drop_duplicates([WHO, ITEM])
    groups = (_mark_levels(rated, name) for name in (SCENE, REDUCER))
    columns = np.hstack([*groups, _read_slopes(rated, slopes)])
    places = rated.groupby(WHO, observed=True).indices.values()
    return any(np.linalg.matrix_rank(columns[place]) < len(place) for place in places)


def _mark_levels(table: DataFrame, name: str) -> NDArray[np.float64]:
    codes, levels = table[name].factorize()
    marks: NDArray[np.float64] = np.eye(len(levels))[codes]
    return marks


def _read_slopes(table: DataFrame, names: list[str]) -> NDArray[np.float64]:
    """Read metrics within recordings, each in units of its spread so that none counts as rounding."""
    values = table[names].to_numpy(np.float64)
    scaled: NDArray[np.float64] = values / values.std(axis=0)
    return scaled


def _quote(name: str) -> str:
    return name if name.isidentifier() else f"`{name}`"
