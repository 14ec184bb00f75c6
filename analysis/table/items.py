"""From a tidy table to arrays: what each participant gave each stimulus, and what each metric says of it.

Conventions: an item is a stimulus; a cell is the mean of a participant's repeated ratings of an item, NaN
where they gave none; only items with role ``test`` count, because the hidden reference and the anchors are
chosen to be far apart and would inflate every correlation.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from analysis.arrays import read_numbers
from analysis.table.sources import find_sources
from analysis.table.tidy import NAMING, leave_rejected, name_stimuli, open_ratings, refuse_pooled

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray
    from pandas import DataFrame


@dataclass(frozen=True, slots=True, eq=False)
class Items:
    """Ratings and metrics of the items of one scale.

    Parameters
    ----------
    names : tuple of str
        What the items are called, length n_items.
    ratings : ndarray, shape (n_participants, n_items)
        Mean rating per participant and item; NaN where there is none.
    metrics : ndarray, shape (n_metrics, n_items)
        Value of each metric asked for.
    recordings : ndarray of int, shape (n_items,)
        Number of the recording that each item was made from, counted from 0.
    sources : ndarray of int, shape (n_recordings,), optional
        Number of the source that each recording comes from, counted from 0: several may be one, turned, cut or edited.
        Each its own if left out.
    notes : tuple of str
        What was left out, one sentence each.
    """

    names: tuple[str, ...]
    ratings: NDArray[np.float64]
    metrics: NDArray[np.float64]
    recordings: NDArray[np.intp]
    sources: NDArray[np.intp] | None = None
    notes: tuple[str, ...] = ()

    @property
    def n_participants(self) -> int:
        """Number of participants."""
        return int(self.ratings.shape[0])

    @property
    def n_items(self) -> int:
        """Number of items."""
        return int(self.ratings.shape[1])

    @property
    def n_recordings(self) -> int:
        """Number of recordings."""
        return int(self.recordings.max()) + 1

    @property
    def of_source(self) -> NDArray[np.intp]:
        """Number of every recording's source."""
        return np.arange(self.n_recordings) if self.sources is None else self.sources

    @property
    def n_sources(self) -> int:
        """Number of sources: what is independent of each other among recordings."""
        return int(self.of_source.max()) + 1

    @property
    def n_missing(self) -> int:
        """Number of cells without a rating."""
        return int(np.isnan(self.ratings).sum())


def make_items(ratings: DataFrame, metrics: Sequence[str]) -> Items:
    """Gather a tidy table of one scale into arrays.

    Parameters
    ----------
    ratings : DataFrame
        One row per judgement: participant, recording, rating, the metrics' columns, and stimulus_id or reducer (and
        level, if there is one) or another name of the stimulus (`name_stimuli`); source, where several recordings
        come from one; rows whose role is not ``test``, and rejected ones, are left out.
    metrics : sequence of str
        Columns to gather as metrics.

    Returns
    -------
    Items
        Participants and items in alphabetical order, whatever the order of the rows.

    Raises
    ------
    ValueError
        If a column is missing, several scales or levels are mixed, no test stimulus is left, a name is missing, a
        number is not finite, or a metric or the recording differs between ratings of the same item.
    """
    ratings, notes = leave_rejected(name_stimuli(open_ratings(ratings)))
    keys = _check_columns(ratings, metrics)
    rows = ratings[ratings["role"] == "test"] if "role" in ratings else ratings
    if rows.empty:
        raise ValueError("ratings: got no row with role 'test'; an association needs rated test stimuli")
    refuse_pooled(rows, metrics=metrics)
    _check_names(rows, ["participant", "recording"])
    rows = rows.assign(**_read_values(rows, ["rating", *metrics]))
    # Sorting by rating too makes the sums below, and so the last digit of every result, independent of row
    # order.
    rows = rows.sort_values([*keys, "participant", "rating"])
    cells = rows.pivot_table("rating", index=keys, columns="participant", observed=True)
    items = rows.groupby(keys, observed=True)[["recording", *metrics]].agg(["first", "nunique"])
    _check_constant(items, ["recording", *metrics])
    return Items(
        names=tuple("/".join(map(str, key)) if isinstance(key, tuple) else str(key) for key in cells.index),
        ratings=cells.to_numpy(np.float64).T.copy(),
        metrics=np.array([items[name, "first"].to_numpy(np.float64) for name in metrics]),
        recordings=np.unique(items["recording", "first"].to_numpy(), return_inverse=True)[1],
        sources=_number_sources(rows) if "source" in rows else None,
        notes=notes,
    )


def _number_sources(rows: DataFrame) -> NDArray[np.intp]:
    from pandas import factorize

    return factorize(find_sources(rows).to_numpy(), sort=True)[0]


def _check_columns(ratings: DataFrame, metrics: Sequence[str]) -> list[str]:
    named = ["stimulus_id"] if "stimulus_id" in ratings else [name for name in NAMING if name in ratings]
    keys = named if named != ["recording"] else [*named, "reducer"]
    needed = dict.fromkeys(("participant", "recording", "rating", *keys, *metrics))
    missing = ", ".join(name for name in needed if name not in ratings)
    if missing:
        got = ", ".join(map(str, ratings.columns))
        raise ValueError(f"ratings: column {missing} is missing; got {got}")
    return keys


def _check_names(rows: DataFrame, names: Sequence[str]) -> None:
    for name in names:
        missing = int(rows[name].isna().sum())
        if missing:
            raise ValueError(f"ratings: got {missing} rows without a {name}; name it or leave them out")


def _read_values(rows: DataFrame, names: Sequence[str]) -> dict[str, NDArray[np.float64]]:
    found = {name: read_numbers(rows[name], what=f"ratings, {name!r}") for name in names}
    for name, values in found.items():
        if bad := int((~np.isfinite(values)).sum()):
            raise ValueError(f"ratings: got {bad} values of '{name}' that are not finite; leave them out")
    return found


def _check_constant(items: DataFrame, names: Sequence[str]) -> None:
    for name in names:
        varying = items.index[items[name, "nunique"] > 1]
        if len(varying):
            stimulus = varying[0]
            raise ValueError(f"ratings: '{name}' differs between rows of stimulus {stimulus}; it must not")
