"""What each reducer was rated: means per participant, their mean, and its interval.

Conventions: hidden reference and anchors have their place here (role tells them apart); repeats are averaged
first, then a participant's stimuli, then participants, so that nobody counts twice for having judged more.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from analysis.arrays import read_numbers
from analysis.resampling.bootstrap import CONFIDENCE
from analysis.table.reading import HIGHEST, LOWEST
from analysis.table.tidy import leave_rejected, open_ratings

if TYPE_CHECKING:
    from pandas import DataFrame

GROUP = ["scale", "level", "role", "reducer"]
"""What a profile is split by."""


def participant_means(ratings: DataFrame) -> DataFrame:
    """Mean rating that each participant gave each reducer.

    Parameters
    ----------
    ratings : DataFrame
        Tidy table: participant, stimulus_id, reducer, level, role, scale, rating; rejected rows are left out.

    Returns
    -------
    DataFrame
        scale, level, role, reducer, participant, rating; one row each, sorted by them.
    """
    ratings = _read_rows(ratings, [*GROUP, "participant", "stimulus_id"])
    cells = ratings.groupby([*GROUP, "participant", "stimulus_id"], observed=True)["rating"].mean()
    return cells.groupby([*GROUP, "participant"], observed=True).mean().reset_index()


def profile_reducers(ratings: DataFrame) -> DataFrame:
    """Mean rating of each reducer with its interval over participants.

    Parameters
    ----------
    ratings : DataFrame
        Tidy table: participant, stimulus_id, reducer, level, role, scale, rating; rejected rows are left out.

    Returns
    -------
    DataFrame
        scale, level, role, reducer, mean, low, high, n_participants, n_stimuli, n_ratings; one row each.

    Raises
    ------
    ValueError
        If a column is missing, or a row has no name or no finite rating.

    Notes
    -----
    The interval is mean ± t(.975, P - 1) SD / sqrt(P) over the P participants' means: it speaks of other
    participants judging these recordings, not of other recordings. It ends where the scale ends. NaN for a single
    participant, and where all means are alike, as at an end of the scale: that tells nothing of how people differ.
    """
    profile = _summarise(participant_means(ratings), GROUP)
    rows = _read_rows(ratings, GROUP).groupby(GROUP, observed=True)
    counts = rows.agg(n_stimuli=("stimulus_id", "nunique"), n_ratings=("rating", "size"))
    return profile.join(counts).reset_index()


def stimulus_means(ratings: DataFrame) -> DataFrame:
    """Mean rating of each stimulus with its interval over participants.

    Parameters
    ----------
    ratings : DataFrame
        Tidy table: participant, stimulus_id, recording, reducer, level, role, scale, rating; rejected rows
        are left out.

    Returns
    -------
    DataFrame
        scale, level, role, recording, reducer, stimulus_id, mean, low, high, n_participants; one row each.
    """
    key = ["scale", "level", "role", "recording", "reducer", "stimulus_id"]
    ratings = _read_rows(ratings, [*key, "participant"])
    cells = ratings.groupby([*key, "participant"], observed=True)["rating"].mean().reset_index()
    return _summarise(cells, key).reset_index()


def _read_rows(ratings: DataFrame, names: list[str]) -> DataFrame:
    """Leave out rejected rows; refuse what would drop out of a mean unseen."""
    ratings, wanted = open_ratings(ratings), [*names, "rating"]
    if missing := [name for name in wanted if name not in ratings]:
        raise ValueError(f"ratings: column {', '.join(missing)} is missing; needed are {', '.join(wanted)}")
    rows, _ = leave_rejected(ratings)
    values = read_numbers(rows["rating"], what="ratings, 'rating'")
    unnamed = rows[names].isna().any(axis=1)
    if unnamed.any() or not np.isfinite(values).all():
        n = int((unnamed | ~np.isfinite(values)).sum())
        raise ValueError(f"ratings: got {n} rows without {', '.join(names)} or a finite rating; leave them out")
    return rows.assign(rating=values)


def _summarise(means: DataFrame, key: list[str]) -> DataFrame:
    """Average participants' means; t interval over participants."""
    from scipy.stats import t

    table = means.groupby(key, observed=True)["rating"].agg(["mean", "std", "size", "nunique"])
    n = table["size"].to_numpy(np.float64)
    spread = table["std"].where(table["nunique"] > 1).to_numpy(np.float64)
    with np.errstate(invalid="ignore"):
        margin = t.ppf((1 + CONFIDENCE) / 2, n - 1) * spread / np.sqrt(n)
    table = table.rename(columns={"size": "n_participants"})
    low, high = (table["mean"] - margin).clip(lower=LOWEST), (table["mean"] + margin).clip(upper=HIGHEST)
    table = table.assign(low=low, high=high)
    return table[["mean", "low", "high", "n_participants"]]
