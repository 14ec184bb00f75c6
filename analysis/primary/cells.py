"""From rated rows to what the primary model takes: cells, and every metric in two parts.

A metric's part within recordings, ``_w``, is its value minus the mean over its recording's items; the part
between, ``_b``, is that mean. The claim that a metric predicts what is felt is about the part within: between
recordings, anything that differs with the scene goes along. Means are over the items that the table holds,
each counted once however often it was rated, so that nothing left out comes back through them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from analysis.arrays import read_numbers
from analysis.table.sources import find_sources
from analysis.table.tidy import leave_rejected, leave_untested, name_items, open_ratings, refuse_pooled

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pandas import DataFrame, Series

WHO, SCENE, ITEM, RATING = "participant", "recording", "item", "rating"
SOURCE, REDUCER = "source", "reducer"
KEYS = (WHO, SCENE, ITEM)
FLAT = 1e-10
"""Share of a metric's size below which its spread is rounding."""

MOST_LEVELS = 800
"""Levels beside those of participant x item up to which single ratings are fitted; the time grows with their cube."""


@dataclass(frozen=True, slots=True)
class Cells:
    """What the primary model is fitted to.

    Parameters
    ----------
    table : DataFrame
        participant, recording, item, rating, and two columns per metric, ``_w`` and ``_b``; reducer, if it is known;
        source, where several recordings come from one.
    metrics : tuple of str
        Their names.
    averaged : bool
        Whether a row is the mean over repeats; if not, it is a single rating.
    repeated : bool
        Whether rows are single ratings, some of which share participant and item.
    rough : bool
        Whether the means rest on unequal numbers of ratings, because single ratings would be too many.
    notes : tuple of str
        What was left out, one sentence each.
    """

    table: DataFrame
    metrics: tuple[str, ...]
    averaged: bool
    repeated: bool
    rough: bool = False
    notes: tuple[str, ...] = ()

    @property
    def shared(self) -> bool:
        """Whether several recordings come from one source."""
        return SOURCE in self.table

    @property
    def n_sources(self) -> int:
        """Number of sources: what is independent of each other among recordings."""
        return self.count(SOURCE if self.shared else SCENE)

    def count(self, *columns: str) -> int:
        """Count the combinations of columns that occur.

        Parameters
        ----------
        *columns : str
            Names in the table.

        Returns
        -------
        int
            Different rows of these columns.
        """
        return len(self.table[list(columns)].drop_duplicates())

    def varies(self, column: str) -> bool:
        """Tell whether a metric's part differs between items, beyond rounding.

        Parameters
        ----------
        column : str
            Name in the table.

        Returns
        -------
        bool
            False where it is constant.
        """
        metric = column[:-2]
        size = float(np.abs(self.table[f"{metric}_w"] + self.table[f"{metric}_b"]).max())
        return float(np.ptp(self.table[column].to_numpy())) > FLAT * size


def make_cells(rows: DataFrame, metrics: Sequence[str]) -> Cells:
    """Average repeats where that loses nothing, and split the metrics.

    Parameters
    ----------
    rows : DataFrame
        One row per rating: participant, recording, item, rating and a column per metric; source (`find_sources`)
        where several recordings come from one, and then reducer. Without item, stimulus_id or recording and reducer
        name it (`name_items`). Rejected rows, and those whose role is not ``test``, are left out.
    metrics : sequence of str
        One or more.

    Returns
    -------
    Cells
        Means over repeats if every participant rated each of their items equally often, or if there are too many
        levels for anything else; otherwise the rows.

    Raises
    ------
    ValueError
        If columns are missing, several scales or levels are mixed, values are not finite, or an item has two
        recordings, two reducers or two values of a metric, or a recording two sources.

    Notes
    -----
    With equally many repeats in every cell the means hold all there is to know about the slopes; otherwise
    cells would need weights, so rows are kept and the model gets a term for the cell. Beyond some hundred levels that
    takes minutes, and means are taken all the same (40 people, 20 recordings, 10 reducers, 10^5 ratings: 3 s instead
    of 132, slopes and standard errors within 0.1 % and 0.02 standard errors).
    """
    if not metrics or isinstance(metrics, str):
        raise ValueError(f"metrics: got {metrics!r}, allowed is one name or more, in a list")
    metrics = tuple(dict.fromkeys(metrics))
    rows, notes = leave_rejected(name_items(open_ratings(rows, what="rows")))
    rows, untested = leave_untested(rows)
    rows = _read_rows(rows, metrics)
    items = _list_items(rows, metrics)
    sizes = rows.groupby([WHO, ITEM], observed=True).size()
    unequal = bool(sizes.min() < sizes.max())
    rough = unequal and _count_levels(rows) > MOST_LEVELS
    averaged = rough or bool(sizes.min() == sizes.max() > 1)
    table = rows[[*KEYS, RATING]]
    if averaged:
        table = table.groupby(list(KEYS), observed=True)[RATING].mean().reset_index()
    table = table.merge(_split(items, metrics), on=[SCENE, ITEM])
    return Cells(
        _add_sources(table, rows), metrics, averaged, repeated=unequal and not rough, rough=rough,
        notes=(*notes, *untested),
    )  # fmt: skip


def _add_sources(table: DataFrame, rows: DataFrame) -> DataFrame:
    """Say of every cell what its stimulus shares with those of other recordings: its reducer, and a source, if any."""
    sources = find_sources(rows)
    if REDUCER in rows:
        table = table.assign(**{REDUCER: table[ITEM].map(_find_reducers(rows))})
    if sources.is_unique:
        return table
    if REDUCER not in rows:
        raise ValueError(
            f"rows: got {len(sources)} recordings of {sources.nunique()} sources and no column 'reducer', allowed "
            "is one that tells which stimuli of a source were reduced alike"
        )
    return table.assign(**{SOURCE: table[SCENE].map(sources)})


def _find_reducers(rows: DataFrame) -> Series:
    reducers = rows[[ITEM, REDUCER]].drop_duplicates().set_index(ITEM)[REDUCER]
    if not reducers.index.is_unique:
        twice = reducers.index[reducers.index.duplicated()].tolist()[0]
        raise ValueError(f"rows: got item {twice!r} with two reducers, allowed is one; an item is one stimulus")
    return reducers


def _count_levels(rows: DataFrame) -> int:
    return sum(len(rows[list(names)].drop_duplicates()) for names in ((WHO, SCENE), (ITEM,), (WHO,), (SCENE,)))


def _read_rows(rows: DataFrame, metrics: Sequence[str]) -> DataFrame:
    wanted = [*KEYS, RATING, *metrics]
    if missing := [name for name in wanted if name not in rows]:
        raise ValueError(f"rows: got no column {missing[0]!r}, allowed is a table with {', '.join(wanted)}")
    if rows.empty:
        raise ValueError("rows: got none, allowed is one per rating")
    refuse_pooled(rows, metrics=metrics, what="rows")
    numbers = {name: read_numbers(rows[name], what=f"rows, {name!r}") for name in (RATING, *metrics)}
    for name, values in numbers.items():
        if bad := int((~np.isfinite(values)).sum()):
            raise ValueError(f"rows: got {bad} values of {name!r} not finite, allowed are numbers; leave such rows out")
    if rows[list(KEYS)].isna().any(axis=None):
        raise ValueError("rows: got a row without participant, recording or item, allowed is each in every row")
    return rows.assign(**numbers)


def _list_items(rows: DataFrame, metrics: Sequence[str]) -> DataFrame:
    items = rows[[SCENE, ITEM, *metrics]].drop_duplicates()
    if twice := items.loc[items[ITEM].duplicated(), ITEM].tolist():
        raise ValueError(
            f"rows: got item {twice[0]!r} with two recordings or two values of a metric, "
            "allowed is one of each; an item is one stimulus"
        )
    return items


def _split(items: DataFrame, metrics: Sequence[str]) -> DataFrame:
    means = items.groupby(SCENE, observed=True)[list(metrics)].transform("mean")
    within = (items[list(metrics)] - means).add_suffix("_w")
    return items[[SCENE, ITEM]].join(within).join(means.add_suffix("_b"))


def centre_twice(table: DataFrame, names: Sequence[str]) -> DataFrame:
    """Take out of metrics what their recording and their reducer give, over stimuli.

    Parameters
    ----------
    table : DataFrame
        Cells with a column of reducers.
    names : sequence of str
        Columns of metrics.

    Returns
    -------
    DataFrame
        The same table with what is left of the metrics, exactly 0 where that is rounding; reducers as words.
    """
    import pandas as pd

    items = table.drop_duplicates(ITEM).set_index(ITEM)
    dummies = pd.get_dummies(items[[SCENE, REDUCER]].astype(str)).to_numpy(np.float64)
    values = items[list(names)].to_numpy()
    left = values - dummies @ np.linalg.lstsq(dummies, values, rcond=None)[0]
    left *= np.abs(left).max(axis=0) > FLAT * np.abs(values).max(axis=0)
    known = pd.DataFrame(left, items.index, list(names))
    return table.assign(
        **{REDUCER: table[REDUCER].astype(str)}, **{name: table[ITEM].map(known[name]) for name in names}
    )
