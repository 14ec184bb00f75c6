"""The primary model's cells and terms: which the data can carry, and in words which they cannot.

The full model has every spread that the design has. A term goes only where it cannot be told from another, never
because a test says that it may be zero.

A metric's part within recordings, ``_w``, is its value minus the mean over its recording's items; the part
between, ``_b``, is that mean. The claim that a metric predicts what is felt is about the part within: between
recordings, anything that differs with the scene goes along. Means are over the items that the table holds,
each counted once however often it was rated, so that nothing left out comes back through them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from feel321.analysis.arrays import read_numbers
from feel321.analysis.table.items import (
    choose_metrics,
    find_sources,
    leave_rejected,
    leave_untested,
    name_items,
    open_ratings,
    refuse_pooled,
)

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from numpy.typing import NDArray
    from pandas import DataFrame

    from feel321.types import Samples

WHO, SCENE, ITEM, RATING = "participant", "recording", "item", "rating"
SOURCE, REDUCER = "source", "reducer"
KEYS = (WHO, SCENE, ITEM)

ALIKE = f"{SOURCE}:{REDUCER}"
"""Stimuli of one source that were reduced alike."""

LEVEL = "level_db"
"""Level of a stimulus less the mean of its recording's: a term of the model, and no hypothesis."""

AMPLITUDE = "rms_m_s2"
LEVELS = ("sensation_level_db", AMPLITUDE, "level_difference")
"""Columns that hold the level of a stimulus, the best first: over threshold, amplitude, from its recording."""

LEAST_DB = 0.5
"""Levels within recordings that differ by less are alike: nobody feels it."""

FLAT = 1e-10
"""Share of a metric's size below which its spread is rounding."""

DEPENDENT = 1e-8
"""Share of a column's spread below which what others leave of it is rounding."""

MOST_LEVELS = 800
"""Levels beside those of participant x item up to which single ratings are fitted; the time grows with their cube."""

FEW_REDUCERS = 8
"""Fewer reducers than this get the boundary-avoiding penalty: their spread is estimated as 0 too often."""


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

    @property
    def has_level(self) -> bool:
        """Whether levels are known and differ within recordings."""
        return LEVEL in self.table

    def ignore_level(self) -> Cells:
        """Return the same cells as if no level were known."""
        return replace(self, table=self.table.drop(columns=LEVEL, errors="ignore"))

    def leave_out(self, column: str, *names: object) -> Cells:
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
        names = [*KEYS, *(name for name in (SOURCE, REDUCER) if name in self.table)]
        return {name: self.table[name].factorize()[0].astype(np.intp) for name in names}

    def count(self, *columns: str) -> int:
        """Count the combinations of columns that occur."""
        combined = np.zeros(len(self.table), dtype=np.intp)
        for name in columns:
            combined = combined * (len(self.table) + 1) + self._codes[name]
        return len(np.unique(combined))

    def varies(self, column: str) -> bool:
        """Check whether a metric's part differs between items, beyond rounding."""
        metric = column[:-2]
        size = float(np.abs(self.table[f"{metric}_w"] + self.table[f"{metric}_b"]).max())
        return float(np.ptp(self.table[column].to_numpy())) > FLAT * size


def make_cells(rows: DataFrame, metrics: Sequence[str]) -> Cells:
    """Average repeats where that loses nothing, and split the metrics.

    Notes
    -----
    With equally many repeats in every cell the means hold all there is to know about the slopes; otherwise
    cells would need weights, so rows are kept and the model gets a term for the cell. Beyond some hundred levels that
    takes minutes, and means are taken all the same (40 people, 20 recordings, 10 reducers, 10^5 ratings: 3 s instead
    of 132, slopes and standard errors within 0.1 % and 0.02 standard errors).
    """
    names = choose_metrics(rows, metrics)
    rows, notes = select_rows(rows)
    rows = _read_rows(rows, names)
    items = _gather_items(rows, names)
    cells = arrange_cells(rows[[*KEYS, RATING]], _add_level(items, rows), names, notes=notes)
    return replace(cells, notes=(*cells.notes, *_note_level(cells)))


def _add_level(items: DataFrame, rows: DataFrame) -> DataFrame:
    """Add the level of every stimulus by the first column that has one for each; none where a metric is one itself."""
    if set(LEVELS) & {*items}:
        return items
    for name in (name for name in LEVELS if name in rows):
        levels = rows.groupby(ITEM, observed=True)[name]
        if levels.nunique(dropna=False).max() > 1 or rows[name].dtype.kind not in "fiu":
            continue
        values = levels.first().astype(np.float64)
        if name == AMPLITUDE:
            values = values.where(values > 0).map(np.log10) * 20
        if np.isfinite(values).all():
            return items.assign(**{LEVEL: items[ITEM].map(values)})
    return items


def _note_level(cells: Cells) -> Iterator[str]:
    """Say why level is not in the model."""
    if LEVEL not in cells.items and not set(LEVELS) & set(cells.metrics):
        yield f"Level was not known (no column {', '.join(LEVELS)}): slopes may be those of level."


def arrange_cells(
    ratings: DataFrame, items: DataFrame, metrics: tuple[str, ...], *, notes: tuple[str, ...] = ()
) -> Cells:
    """Put ratings beside the metrics of their stimuli; those that nobody rated do not count."""
    if ratings.empty:
        raise ValueError("rows must hold a row per rating, got none")
    sizes = ratings.groupby([WHO, ITEM], observed=True).size()
    unequal, rough = bool(sizes.min() < sizes.max()), False
    if unequal:
        groups = ([WHO, SCENE], [ITEM], [WHO], [SCENE])
        rough = sum(len(ratings[keys].drop_duplicates()) for keys in groups) > MOST_LEVELS
    means, averaged = ratings, rough or bool(sizes.min() == sizes.max() > 1)
    if averaged:
        means = ratings.groupby(list(KEYS), observed=True)[RATING].mean().reset_index()
    items = items[items[ITEM].isin(ratings[ITEM].unique())]
    values, shared = items[list(metrics)], [name for name in (REDUCER, SOURCE) if name in items]
    centre = values.groupby(items[SCENE], observed=True).transform("mean")
    split = items[[SCENE, ITEM]].join([
        (values - centre).add_suffix("_w"), centre.add_suffix("_b"), items[shared]
    ])  # fmt: skip
    if LEVEL in items:
        levels = items[LEVEL] - items.groupby(SCENE, observed=True)[LEVEL].transform("mean")
        split = split.assign(**{LEVEL: levels}) if np.ptp(levels) >= LEAST_DB else split
    if SOURCE in split and split.drop_duplicates(SCENE)[SOURCE].is_unique:
        split = split.drop(columns=SOURCE)
    return Cells(
        table=means.merge(split, on=[SCENE, ITEM]), ratings=ratings if unequal else means, items=items,
        metrics=metrics, averaged=averaged, repeated=unequal and not rough, rough=rough, notes=notes,
    )  # fmt: skip


def select_rows(rows: DataFrame) -> tuple[DataFrame, tuple[str, ...]]:
    """Select valid ratings of test stimuli, each with the name of its item, and note what is left out."""
    rows, rejected = leave_rejected(name_items(open_ratings(rows, what="rows")))
    rows, untested = leave_untested(rows)
    return rows, (*rejected, *untested)


def _gather_items(rows: DataFrame, metrics: tuple[str, ...]) -> DataFrame:
    """Gather every stimulus: its metrics, its reducer, and the source of its recording where several have one."""
    items = rows[[SCENE, ITEM, *metrics]].drop_duplicates()
    if twice := items.loc[items[ITEM].duplicated(), ITEM].tolist():
        raise ValueError(
            f"rows must have one stimulus per item, got item {twice[0]!r} with two recordings or two values of a metric"
        )
    if REDUCER in rows:
        reducers = rows[[ITEM, REDUCER]].drop_duplicates().set_index(ITEM)[REDUCER]
        if not reducers.index.is_unique:
            twice = reducers.index[reducers.index.duplicated()].tolist()
            raise ValueError(
                f"rows must have one stimulus per item, got item {twice[0]!r} with two reducers"
            )
        items = items.assign(**{REDUCER: items[ITEM].map(reducers)})
    sources = find_sources(rows)
    if sources.is_unique:
        return items
    if REDUCER not in rows:
        raise ValueError(
            "rows must say which stimuli of a source were reduced alike, got "
            f"{len(sources)} recordings of {sources.nunique()} sources and no column 'reducer'; add it"
        )
    return items.assign(**{SOURCE: items[SCENE].map(sources)})


def _read_rows(rows: DataFrame, metrics: Sequence[str]) -> DataFrame:
    wanted = [*KEYS, RATING, *metrics]
    if missing := [name for name in wanted if name not in rows]:
        raise ValueError(
            f"rows must have the columns {', '.join(wanted)}; got no column {missing[0]!r}"
        )
    refuse_pooled(rows, metrics=metrics, what="rows")
    numbers = {
        name: read_numbers(rows[name], what=f"rows, {name!r}") for name in wanted[len(KEYS) :]
    }
    for name, values in numbers.items():
        if bad := int((~np.isfinite(values)).sum()):
            raise ValueError(
                f"rows must have finite numbers, got {bad} values of {name!r} not finite; leave such rows out"
            )
    if rows[list(KEYS)].isna().any(axis=None):
        raise ValueError(
            "rows must be complete, got one without participant, recording or item; leave it out"
        )
    return rows.assign(**numbers)


def centre_twice(table: DataFrame, names: Sequence[str]) -> DataFrame:
    """Take out of metrics what their recording and their reducer give, over stimuli."""
    import pandas as pd

    items = table.drop_duplicates(ITEM).set_index(ITEM)
    dummies = pd.get_dummies(items[[SCENE, REDUCER]].astype(str)).to_numpy(np.float64)
    values = items[list(names)].to_numpy()
    left = values - dummies @ np.linalg.lstsq(dummies, values, rcond=None)[0]
    left *= np.abs(left).max(axis=0) > FLAT * np.abs(values).max(axis=0)
    known = pd.DataFrame(left, items.index, list(names))
    return table.assign(
        **{REDUCER: table[REDUCER].astype(str)},
        **{name: table[ITEM].map(known[name]).astype(np.float64) for name in names},
    )


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
    reductions: list[str] = []
    fixed = _plan_fixed(cells, reductions)
    slopes = [name for name in fixed if name.endswith("_w")]
    known = [name for name in fixed if name in {*slopes, LEVEL}]
    chosen = [
        *_plan_people(cells, slopes, bar="|" if correlated else "||"),
        *_plan_groups(cells, slopes),
        *_plan_sources(cells, slopes),
        *(_plan_reducers(cells, slopes, known) if reducers else ()),
    ]
    random = [term for term in chosen if term.startswith("(")]
    reductions += [reason for reason in chosen if not reason.startswith("(")]
    if cells.rough:
        reductions.append(
            "Means over unequal numbers of repeats, each counted as equally exact: single ratings have too many levels."
        )
    if not random:
        raise ValueError(
            "rows must hold more, got one participant and one recording; for these, use ordinary regression"
        )
    few = f"(1 | {REDUCER})" in random and cells.count(REDUCER) < FEW_REDUCERS
    # Of a single difference the penalised likelihood has no maximum: it grows with the spread as fast as it falls.
    penalty = (REDUCER,) if few and _count_free(cells, known) > 1 else ()
    return Terms(
        tuple(fixed), tuple(random), tuple(reductions), penalty, find_most_df(cells.n_sources)
    )


def find_most_df(recordings: int) -> float:
    """Find the most degrees of freedom that a slope has which differs between recordings, or sources of them.

    Satterthwaite's are those of the stimuli where slopes are estimated not to differ between recordings, although with
    few of these that is only unknown. Twice as many as recordings, less two, was chosen by simulation: with 3 to 7 of
    them it keeps false positives at .04 to .07 (.05 to .09 without), and power within 2 to 6 points.
    """
    return 2.0 * (recordings - 1) if recordings > 1 else math.inf


def _plan_fixed(cells: Cells, reductions: list[str]) -> list[str]:
    within = [f"{name}_w" for name in cells.metrics if cells.varies(f"{name}_w")]
    reductions += [
        f"No slope of {name}: it is the same for all stimuli of a recording."
        for name in cells.metrics
        if f"{name}_w" not in within
    ]
    within = _keep_independent(cells, within, reductions)
    if not within:
        raise ValueError(
            f"metrics must vary, got {', '.join(cells.metrics)}, none of which differs between stimuli of a recording"
        )
    *_, last = _keep_independent(cells, [*within, *([LEVEL] * cells.has_level)], reductions)
    level = [LEVEL] if last == LEVEL else []
    between = [f"{name}_b" for name in cells.metrics if cells.varies(f"{name}_b")]
    if cells.n_sources >= len(between) + 2 and between:
        return [*within, *_keep_independent(cells, between, reductions), *level]
    scenes = f"source{'s' if cells.n_sources > 1 else ''}" if cells.shared else "of them"
    reductions.append(
        f"No slopes between recordings: with {cells.n_sources} {scenes}, {len(cells.metrics)} such slopes "
        "cannot be told from the recordings themselves."
    )
    return [*within, *level]


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


# Each of the following yields terms, and the reason for every term that the data cannot carry.


def _plan_people(cells: Cells, slopes: list[str], *, bar: str) -> Iterator[str]:
    people, rows = cells.count(WHO), len(cells.table)
    if people == 1:
        yield "No spread between people: one participant only; nothing here speaks of others."
        return
    effects = 1 if bar == "||" else len(slopes) + 1
    if people * effects >= rows:
        yield f"No spread of people's slopes: {rows} rows for {people} participants are too few."
        slopes = []
    yield f"({' + '.join(['1', *map(_quote, slopes)])} {bar} {WHO})"


def _plan_groups(cells: Cells, slopes: list[str]) -> Iterator[str]:
    """Name the grouping factors besides people, as far as the design tells them apart."""
    several, people, rows = cells.count(SCENE) > 1, cells.count(WHO), len(cells.table)
    lone = "No spread between recordings: one recording only; nothing here speaks of others."
    own = [] if cells.shared and cells.n_sources > 1 else slopes
    yield _write_spread(SCENE, own) if several else lone
    known = cells.count(ITEM) < rows
    single = "No spread between stimuli: each has one row only, its spread is in the residual."
    yield f"(1 | {ITEM})" if known else single
    if several and people > 1:
        paired = cells.count(WHO, SCENE) < rows
        once = "No spread of people's recordings: each has one row only."
        yield f"(1 | {WHO}:{SCENE})" if paired else once
    if cells.repeated and people > 1:
        yield f"(1 | {WHO}:{ITEM})"


def _write_spread(group: str, slopes: list[str]) -> str:
    """Write the term for levels and slopes that differ between recordings, or between sources of them."""
    return f"({' + '.join(['1', *map(_quote, slopes)])} || {group})" if slopes else f"(1 | {group})"


def find_recording_slope(spreads: Mapping[tuple[str, str], float], metric: str) -> float:
    """Find how slopes differ between recordings, or between sources where several come from one."""
    return max(spreads.get((group, f"{metric}_w"), 0.0) for group in (SCENE, SOURCE))


def _plan_sources(cells: Cells, slopes: list[str]) -> Iterator[str]:
    """Name what recordings of one source share; without it each copy would count as evidence of its own.

    Slopes are of sources too: those of a recording and its copies are alike.
    """
    if cells.shared:
        lone = "No spread between sources: all recordings come from one; nothing here speaks of others."
        yield _write_spread(SOURCE, slopes) if cells.n_sources > 1 else lone
        if cells.count(SOURCE, REDUCER) < cells.count(ITEM):
            yield f"(1 | {ALIKE})"


def _plan_reducers(cells: Cells, slopes: list[str], known: list[str]) -> Iterator[str]:
    """Name what stimuli of one reducer share, for everyone and for one person, as far as recordings repeat reducers."""
    none = "No spread between reducers: "
    if REDUCER not in cells.table:
        yield none + "no column 'reducer' says which stimuli were reduced alike."
        return
    why = {cells.count(ITEM): "no reducer was used on several recordings", 1: "one reducer only"}
    number, lone = cells.count(REDUCER), cells.count(SCENE) == 1
    if lone or number in why:
        yield none + ("one recording only" if lone and number > 1 else why[number]) + "."
        return
    # Of one source, (1 | source:reducer) is this term.
    if not cells.shared or cells.n_sources > 1:
        few = none + "too few stimuli to tell it from the slopes."
        yield f"(1 | {REDUCER})" if _count_free(cells, known) else few
    if cells.count(WHO) > 1:
        few = "No spread of people's reducers: too few stimuli to tell it from the residual."
        yield f"(1 | {WHO}:{REDUCER})" if _has_residual(cells, slopes) else few


def _count_free(cells: Cells, slopes: list[str]) -> int:
    """Count the differences between reducers that neither recordings nor slopes account for."""
    items = cells.table.drop_duplicates(ITEM)
    others = np.hstack([_mark_levels(items, SCENE), _read_slopes(items, slopes)])
    both = np.hstack([others, _mark_levels(items, REDUCER)])
    return int(np.linalg.matrix_rank(both) - np.linalg.matrix_rank(others))


def _has_residual(cells: Cells, slopes: list[str]) -> bool:
    """Check whether anybody's ratings have a dimension besides their recordings, reducers and slopes."""
    rated = cells.table.drop_duplicates([WHO, ITEM])
    groups = (_mark_levels(rated, name) for name in (SCENE, REDUCER))
    columns = np.hstack([*groups, _read_slopes(rated, slopes)])
    places = rated.groupby(WHO, observed=True).indices.values()
    return any(np.linalg.matrix_rank(columns[place]) < len(place) for place in places)


def _mark_levels(table: DataFrame, name: str) -> Samples:
    codes, levels = table[name].factorize()
    marks: Samples = np.eye(len(levels))[codes]
    return marks


def _read_slopes(table: DataFrame, names: list[str]) -> Samples:
    """Read metrics within recordings, each in units of its spread so that none counts as rounding."""
    values = table[names].to_numpy(np.float64)
    scaled: Samples = values / values.std(axis=0)
    return scaled


def _quote(name: str) -> str:
    return name if name.isidentifier() else f"`{name}`"
