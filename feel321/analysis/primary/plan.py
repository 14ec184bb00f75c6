"""The primary model's cells and terms: which the data can carry, and in words which they cannot.

A metric's part within recordings, ``_w``, is its value minus the mean over its recording's items; the part
between, ``_b``, is that mean. The claim that a metric predicts what is felt is about the part within: between
recordings, anything that differs with the scene goes along. Means are over the items that the table holds,
each counted once however often it was rated, so that nothing left out comes back through them.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from pandas import DataFrame

from feel321.analysis.arrays import check_columns
from feel321.analysis.table.items import (
    choose_metrics,
    find_sources,
    leave_rejected,
    leave_untested,
    name_items,
    open_ratings,
    read_finite,
    refuse_pooled,
    refuse_unnamed,
)
from feel321.types import Samples

WHO, SCENE, ITEM, RATING = "participant", "recording", "item", "rating"
SOURCE, REDUCER = "source", "reducer"
KEYS = (WHO, SCENE, ITEM)
ALIKE = f"{SOURCE}:{REDUCER}"  # Stimuli of one source that were reduced alike
LEVEL = "level_db"  # Level of a stimulus less the mean of its recording's: a term of the model, and no hypothesis
AMPLITUDE = "rms_m_s2"
# Columns that hold the level of a stimulus, the best first: over threshold, amplitude, from its recording.
LEVELS = ("sensation_level_db", AMPLITUDE, "level_difference")
LEAST_DB = 0.5  # Levels within recordings that differ by less are alike: nobody feels it
FLAT = 1e-10  # Share of a metric's size below which its spread is rounding
DEPENDENT = 1e-8  # Share of a column's spread below which what others leave of it is rounding
MOST_LEVELS = 800  # Levels up to which single ratings are fitted; the time grows with their cube
FEW_REDUCERS = 8  # Fewer get the boundary-avoiding penalty: their spread is often estimated as 0


@dataclass(frozen=True)
class Cells:
    """What the primary model is fitted to.

    table: a row per cell, or per rating where repeats are unequal; ratings: the same without metrics, but never means
    of unequal repeats; items: a row per stimulus, with its metrics as they are.
    """

    table: DataFrame
    ratings: DataFrame
    items: DataFrame
    metrics: tuple[str, ...]
    averaged: bool
    repeated: bool
    rough: bool = False
    notes: tuple[str, ...] = ()

    def ignore_level(self) -> "Cells":
        """Return the same cells as if no level were known."""
        return replace(self, table=self.table.drop(columns=LEVEL, errors="ignore"))

    def leave_out(self, column: str, *names: object) -> "Cells":
        """Leave out participants, or stimuli by a column, and split the metrics anew over what is left."""
        units = self.ratings if column == WHO else self.items
        gone = units[column].isin(names)
        left = ~(gone if column == WHO else self.ratings[ITEM].isin(units.loc[gone, ITEM]))
        return arrange_cells(self.ratings[left], self.items, self.metrics)

    @property
    def shared(self) -> bool:
        """Whether several recordings come from one source."""
        return SOURCE in self.table

    @property
    def n_sources(self) -> int:
        """Number of sources: what is independent of each other among recordings."""
        return self.count(SOURCE if self.shared else SCENE)

    @cached_property
    def _codes(self) -> dict[str, NDArray[np.intp]]:
        names = (name for name in (*KEYS, SOURCE, REDUCER) if name in self.table)
        return {name: self.table[name].factorize()[0].astype(np.intp) for name in names}

    @cached_property
    def rated(self) -> DataFrame:
        """A row per stimulus that was rated, with its metrics split."""
        return self.table.iloc[np.unique(self._codes[ITEM], return_index=True)[1]]

    @cached_property
    def averages(self) -> tuple[DataFrame, Samples, Samples]:
        """Stimuli, their metrics within recordings, and their mean ratings, people's levels taken out."""
        level = self.table.groupby(WHO, observed=True)[RATING].transform("mean")
        means = (self.table[RATING] - level).groupby(self.table[ITEM], observed=True).mean()
        items = self.rated.reset_index(drop=True)
        within = items[[f"{name}_w" for name in self.metrics]].to_numpy(np.float64)
        return items, within, means.reindex(items[ITEM]).to_numpy(np.float64)

    def count(self, *columns: str) -> int:
        """Count the combinations of columns that occur; 0 where there is no such column."""
        if not set(columns) <= set(self._codes):
            return 0
        combined = np.zeros(len(self.table), dtype=np.intp)
        for name in columns:
            combined = combined * (len(self.table) + 1) + self._codes[name]
        return len(np.unique(combined))

    def mark(self, name: str, rows: NDArray[Any]) -> Samples:
        """Mark the level of some rows of the table: (n_rows, n_levels)."""
        codes = self._codes[name]
        marks: Samples = np.eye(int(codes.max()) + 1)[codes[rows]]
        return marks


def make_cells(rows: DataFrame, metrics: Sequence[str]) -> Cells:
    """Average repeats where that loses nothing, and split the metrics.

    With equally many repeats in every cell the means hold all there is to know about the slopes; otherwise
    cells would need weights, so rows are kept and the model gets a term for the cell. Beyond some hundred levels that
    takes minutes, and means are taken all the same (40 people, 20 recordings, 10 reducers, 10^5 ratings: 3 s instead
    of 132, slopes and standard errors within 0.1 % and 0.02 standard errors).
    """
    names = choose_metrics(rows, metrics)
    rows, notes = select_rows(rows)
    check_columns(rows, [*KEYS, RATING, *names], "rows")
    refuse_pooled(rows, metrics=names, what="rows")
    rows = read_finite(rows, [RATING, *names], what="rows")
    refuse_unnamed(rows, KEYS, what="rows")
    # Names as categories, whose every use costs less.
    known = [name for name in (REDUCER,) if name in rows]
    rows = rows.assign(**{name: rows[name].astype("category") for name in (*KEYS, *known)})
    items = rows[[SCENE, ITEM, *names, *known]].drop_duplicates()
    if twice := items.loc[items[ITEM].duplicated(), ITEM].tolist():
        got = f"got item {twice[0]!r} with two recordings, two reducers or two values of a metric"
        raise ValueError(f"rows must have one stimulus per item, {got}")
    sources = find_sources(rows)
    if not sources.is_unique:
        if not known:
            got = f"got {len(sources)} recordings of {sources.nunique()} sources and no column 'reducer'"
            must = "rows must say which stimuli of a source were reduced alike"
            raise ValueError(f"{must}, {got}; add it")
        items = items.assign(**{SOURCE: sources.reindex(items[SCENE]).astype("category").array})
    items = _add_level(items, rows)
    if LEVEL not in items and not set(LEVELS) & set(names):
        lack = f"Level was not known (no column {', '.join(LEVELS)}): slopes may be those of level."
        notes = (*notes, lack)
    return arrange_cells(rows[[*KEYS, RATING]], items, names, notes=notes)


def select_rows(rows: DataFrame) -> tuple[DataFrame, tuple[str, ...]]:
    """Select valid ratings of test stimuli, each with the name of its item, and note what is left out."""
    rows, rejected = leave_rejected(name_items(open_ratings(rows, what="rows")))
    rows, untested = leave_untested(rows)
    return rows, (*rejected, *untested)


def _add_level(items: DataFrame, rows: DataFrame) -> DataFrame:
    """Add the level of every stimulus by the first column that has one for each; none where a metric is one itself."""
    for name in () if set(LEVELS) & {*items} else (name for name in LEVELS if name in rows):
        levels = rows.groupby(ITEM, observed=True)[name]
        if levels.nunique(dropna=False).max() > 1 or rows[name].dtype.kind not in "fiu":
            continue
        values = levels.first().astype(np.float64)
        if name == AMPLITUDE:
            values = values.where(values > 0).map(np.log10) * 20
        if np.isfinite(values).all():
            return items.assign(**{LEVEL: values.reindex(items[ITEM]).to_numpy()})
    return items


def arrange_cells(
    ratings: DataFrame, items: DataFrame, metrics: tuple[str, ...], *, notes: tuple[str, ...] = ()
) -> Cells:
    """Put ratings beside the metrics of their stimuli; those that nobody rated do not count."""
    if ratings.empty:
        raise ValueError("rows must hold a row per rating, got none")
    groups = ratings.groupby(list(KEYS), observed=True)[RATING]
    sizes = groups.size()
    units, unequal = ([WHO, SCENE], [ITEM], [WHO], [SCENE]), bool(sizes.min() < sizes.max())
    n_levels = sum(len(ratings[keys].drop_duplicates()) for keys in units) if unequal else 0
    rough = n_levels > MOST_LEVELS
    means, averaged = ratings, rough or bool(sizes.min() == sizes.max() > 1)
    if averaged:
        means = groups.mean().reset_index()
    items = items[items[ITEM].isin(ratings[ITEM].unique())]
    scenes = items[SCENE].factorize()[0]
    values = items[list(metrics)].to_numpy(np.float64)
    split = {name: items[name].array for name in (REDUCER, SOURCE) if name in items}
    if SOURCE in split and items.drop_duplicates(SCENE)[SOURCE].is_unique:
        del split[SOURCE]
    count = np.bincount(scenes)[:, None]
    marks = np.eye(len(count))[scenes]
    centre = (marks.T @ values / count)[scenes]
    split |= {f"{name}_w": one for name, one in zip(metrics, (values - centre).T, strict=True)}
    split |= {f"{name}_b": one for name, one in zip(metrics, centre.T, strict=True)}
    if LEVEL in items:
        levels = items[LEVEL].to_numpy(np.float64)
        levels = levels - (marks.T @ levels / count[:, 0])[scenes]
        split |= {LEVEL: levels} if np.ptp(levels) >= LEAST_DB else {}
    place = items.set_index(ITEM).index.get_indexer(means[ITEM].array)
    return Cells(
        table=means.assign(**{name: one[place] for name, one in split.items()}).reset_index(drop=True),
        ratings=ratings if unequal else means, items=items, metrics=metrics, averaged=averaged,
        repeated=unequal and not rough, rough=rough, notes=notes,
    )  # fmt: skip


def take_out(groups: DataFrame, values: Samples) -> Samples:
    """Take out of values what their groups give: what a regression on indicators of the groups leaves."""
    dummies = pd.get_dummies(groups.astype(str)).to_numpy(np.float64)
    left: Samples = values - dummies @ np.linalg.lstsq(dummies, values, rcond=None)[0]
    return left


@dataclass(frozen=True, slots=True)
class Terms:
    """Which terms the data can carry, and in words which they cannot."""

    fixed: tuple[str, ...]
    random: tuple[str, ...]
    reductions: tuple[str, ...]
    penalty: tuple[str, ...] = ()
    most_df: float = math.inf

    @property
    def formula(self) -> str:
        """The model, in lme4's notation."""
        return " + ".join([f"{RATING} ~ 1", *map(_quote, self.fixed), *self.random])


def plan_terms(cells: Cells, *, correlated: bool, reducers: bool) -> Terms:
    """Choose the terms of the primary model."""
    fixed, reductions = _plan_fixed(cells)
    slopes = [name for name in fixed if name.endswith("_w")]
    free = 0  # Differences between reducers that neither recordings nor slopes account for
    if REDUCER in cells.table:
        rows = cells.rated.index.to_numpy()
        values = cells.rated[[name for name in fixed if name in {*slopes, LEVEL}]].to_numpy(float)
        # Each in units of its spread, so that none counts as rounding.
        others = np.hstack([cells.mark(SCENE, rows), values / values.std(axis=0)])
        both = np.hstack([others, cells.mark(REDUCER, rows)])
        free = int(np.linalg.matrix_rank(both) - np.linalg.matrix_rank(others))
    chosen = [
        *_plan_units(cells, slopes, bar="|" if correlated else "||"),
        *(_plan_reducers(cells, slopes, free) if reducers else ()),
    ]
    random = tuple(term for term, lack in chosen if not lack)
    reductions += [lack for _, lack in chosen if lack]
    if cells.rough:
        why = "each counted as equally exact: single ratings have too many levels"
        reductions.append(f"Means over unequal numbers of repeats, {why}.")
    if not random:
        do = "for these, use ordinary regression"
        raise ValueError(f"rows must hold more, got one participant and one recording; {do}")
    few = f"(1 | {REDUCER})" in random and cells.count(REDUCER) < FEW_REDUCERS
    # Of a single difference the penalised likelihood has no maximum: it grows with the spread as fast as it falls.
    penalty = (REDUCER,) if few and free > 1 else ()
    return Terms(tuple(fixed), random, tuple(reductions), penalty, find_most_df(cells.n_sources))


def find_most_df(recordings: int) -> float:
    """Find the most degrees of freedom that a slope has which differs between recordings, or sources of them.

    Satterthwaite's are those of the stimuli where slopes are estimated not to differ between recordings, although with
    few of these that is only unknown. Twice as many as recordings, less two, was chosen by simulation: with 3 to 7 of
    them it keeps false positives at .04 to .07 (.05 to .09 without), and power within 2 to 6 points.
    """
    return 2.0 * (recordings - 1) if recordings > 1 else math.inf


def _plan_fixed(cells: Cells) -> tuple[list[str], list[str]]:
    """Choose the fixed effects: metrics within recordings, between them, and level; also say which are left out."""
    names = [f"{name}{part}" for part in ("_w", "_b") for name in cells.metrics]
    names += [LEVEL] * (LEVEL in cells.table)
    values = dict(zip(names, cells.rated[names].to_numpy(np.float64).T, strict=True))
    reductions: list[str] = []

    def varies(name: str) -> bool:
        size = float(np.abs(values[f"{name[:-2]}_w"] + values[f"{name[:-2]}_b"]).max())
        return float(np.ptp(values[name])) > FLAT * size

    def keep_independent(names: list[str]) -> list[str]:
        """Leave out what is a sum of those before it."""
        kept: list[str] = []
        for name in names:
            columns = np.stack([values[one] for one in (*kept, name)], axis=1)
            columns = (columns - columns.mean(axis=0)) / columns.std(axis=0)
            left = np.abs(np.diag(np.linalg.qr(columns, mode="r")))[-1]
            if left > DEPENDENT * np.sqrt(len(columns)):
                kept.append(name)
            else:
                reductions.append(f"No term {name}: it is a sum of {', '.join(kept)}.")
        return kept

    flat = [name for name in cells.metrics if not varies(f"{name}_w")]
    alike = "it is the same for all stimuli of a recording"
    reductions += [f"No slope of {name}: {alike}." for name in flat]
    within = keep_independent([f"{name}_w" for name in cells.metrics if name not in flat])
    if not within:
        none = "none of which differs between stimuli of a recording"
        raise ValueError(f"metrics must vary, got {', '.join(cells.metrics)}, {none}")
    level = keep_independent([*within, *[LEVEL] * (LEVEL in values)])[len(within) :]
    between = [f"{name}_b" for name in cells.metrics if varies(f"{name}_b")]
    if not between or cells.n_sources < len(between) + 2:
        scenes = f"source{'s' if cells.n_sources > 1 else ''}" if cells.shared else "of them"
        why = f"{len(cells.metrics)} such slopes cannot be told from the recordings themselves"
        reductions.append(f"No slopes between recordings: with {cells.n_sources} {scenes}, {why}.")
        between = []
    return [*within, *keep_independent(between), *level], reductions


Planned = Iterator[tuple[str, str]]  # Terms, and why the data cannot carry it, empty where they can


def _write(group: str, slopes: Sequence[str], bar: str = "||") -> str:
    effects = " + ".join(["1", *map(_quote, slopes)])
    return f"({effects} {bar if slopes else '|'} {group})"


def _plan_units(cells: Cells, slopes: list[str], *, bar: str) -> Planned:
    """Name the grouping factors besides reducers, as far as the design tells them apart.

    Slopes are of sources, where several recordings come from one: those of a recording and its copies are alike.
    Without the last term each copy would count as evidence of its own.
    """
    several, people, rows = cells.count(SCENE) > 1, cells.count(WHO), len(cells.table)
    is_poor = people > 1 and people * (1 if bar == "||" else len(slopes) + 1) >= rows
    if is_poor:
        few = f"{rows} rows for {people} participants are too few"
        yield "", f"No spread of people's slopes: {few}."
    lone = "No spread between people: one participant only; nothing here speaks of others."
    yield _write(WHO, [] if is_poor else slopes, bar), lone if people == 1 else ""
    lone = "No spread between recordings: one recording only; nothing here speaks of others."
    own = [] if cells.shared and cells.n_sources > 1 else slopes
    yield _write(SCENE, own), "" if several else lone
    single = "No spread between stimuli: each has one row only, its spread is in the residual."
    yield f"(1 | {ITEM})", "" if cells.count(ITEM) < rows else single
    if several and people > 1:
        once = "No spread of people's recordings: each has one row only."
        yield f"(1 | {WHO}:{SCENE})", "" if cells.count(WHO, SCENE) < rows else once
    if cells.repeated and people > 1:
        yield f"(1 | {WHO}:{ITEM})", ""
    if cells.shared:
        one = "all recordings come from one; nothing here speaks of others"
        lone = f"No spread between sources: {one}."
        yield _write(SOURCE, slopes), "" if cells.n_sources > 1 else lone
        if cells.count(SOURCE, REDUCER) < cells.count(ITEM):
            yield f"(1 | {ALIKE})", ""


def _plan_reducers(cells: Cells, slopes: list[str], free: int) -> Planned:
    """Name what stimuli of one reducer share, for everyone and for one person, as far as recordings repeat reducers."""
    number = cells.count(REDUCER)
    reasons = {
        "no column 'reducer' says which stimuli were reduced alike": REDUCER not in cells.table,
        "one reducer only": number == 1,
        "one recording only": cells.count(SCENE) == 1,
        "no reducer was used on several recordings": number == cells.count(ITEM),
    }
    if why := next((reason for reason, holds in reasons.items() if holds), ""):
        yield "", f"No spread between reducers: {why}."
        return
    # Of one source, (1 | source:reducer) is this term.
    if not cells.shared or cells.n_sources > 1:
        few = "No spread between reducers: too few stimuli to tell it from the slopes."
        yield f"(1 | {REDUCER})", "" if free else few
    if cells.count(WHO) > 1:
        few = "No spread of people's reducers: too few stimuli to tell it from the residual."
        yield f"(1 | {WHO}:{REDUCER})", "" if _has_residual(cells, slopes) else few


def _has_residual(cells: Cells, slopes: list[str]) -> bool:
    """Check whether anybody's ratings have a dimension besides their recordings, reducers and slopes."""
    values = cells.table[slopes].to_numpy(np.float64)
    values = values / values.std(axis=0)
    firsts = cells.table.drop_duplicates([WHO, ITEM])
    for own in firsts.groupby(WHO, observed=True).indices.values():
        rows = firsts.index.to_numpy()[own]
        columns = np.hstack([cells.mark(SCENE, rows), cells.mark(REDUCER, rows), values[rows]])
        if np.linalg.matrix_rank(columns) < len(rows):
            return True
    return False


def _quote(name: str) -> str:
    return name if name.isidentifier() else f"`{name}`"
