"""What people said of each reducer, to stand beside speed and match."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from analysis.contrasts.profile import profile_reducers
from analysis.resampling.bootstrap import CONFIDENCE, draw_counts
from analysis.table.reading import ROLES, order_reducers
from analysis.tradeoff.chart.records import Rated

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray
    from pandas import DataFrame

DRAWS = 2000
KEY = ["scale", "level", "reducer"]


def rate_reducers(ratings: DataFrame, *, seed: int, draws: int = DRAWS) -> list[Rated]:
    """Average the ratings of every reducer.

    Parameters
    ----------
    ratings : DataFrame
        Tidy table: participant, stimulus_id, recording, reducer, level, role, scale, rating.
    seed : int
        Of the bootstrap.
    draws : int
        Of participants and recordings.

    Returns
    -------
    list of Rated
        One per scale, level and reducer that was tested; references and anchors are left out.

    Notes
    -----
    The mean is that of the participants' means. The two-way interval draws participants and recordings with
    replacement, the same draws for all reducers, and takes the 2.5 % and 97.5 % quantiles of the mean.
    """
    tests = ratings[ratings["role"] == ROLES[0]]
    people, scenes = sorted(tests["participant"].unique()), sorted(tests["recording"].unique())
    rng = np.random.default_rng(seed)
    drawn = draw_counts(len(people), draws, rng=rng), draw_counts(len(scenes), draws, rng=rng)
    means = tests.groupby([*KEY, "participant", "recording"], observed=True)["rating"].mean().reset_index()
    tables = {
        key: own.pivot_table(index="participant", columns="recording", values="rating", observed=True)
        for key, own in means.groupby(KEY, observed=True)
    }
    profile = profile_reducers(tests).sort_values(["scale", "level"], kind="stable")
    found = []
    for row in profile.to_dict("records"):
        reducer, scale, level = row["reducer"], row["scale"], row["level"]
        table = tables[scale, level, reducer].reindex(index=people, columns=scenes)
        ends = draw_interval(table.to_numpy(np.float64), *drawn)
        low, high = _tell_ends(row["low"], row["high"])
        counts = int(row["n_participants"]), int(table.notna().any().sum())
        found.append(Rated(reducer, scale, level, float(row["mean"]), low, high, *ends, *counts))
    order = order_reducers(row.reducer for row in found)
    return sorted(found, key=lambda row: (row.scale, row.level, order.index(row.reducer)))


def draw_interval(
    table: NDArray[np.float64], people: NDArray[np.float64], scenes: NDArray[np.float64]
) -> tuple[float, float]:
    """Find the two-way interval of the mean of participants' means.

    Parameters
    ----------
    table : ndarray, shape (n_participants, n_recordings)
        Ratings; NaN where there is none.
    people : ndarray, shape (draws, n_participants)
        How often each participant was drawn.
    scenes : ndarray, shape (draws, n_recordings)
        How often each recording was drawn.

    Returns
    -------
    tuple of float
        Lower and upper end, between which 95 % of the draws lie.
    """
    seen = np.isfinite(table)
    sums, counts = scenes @ np.where(seen, table, 0.0).T, scenes @ seen.T.astype(np.float64)
    means = np.divide(sums, counts, out=np.zeros_like(sums), where=counts > 0)
    weights = people * (counts > 0)
    total = weights.sum(axis=1)
    drawn = (weights * means).sum(axis=1)[total > 0] / total[total > 0]
    low, high = np.quantile(drawn, [(1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2])
    return float(low), float(high)


def _tell_ends(*ends: float) -> Sequence[float | None]:
    """One participant, or participants who all agree, give no t interval."""
    return [float(end) if np.isfinite(end) else None for end in ends]
