"""Rules about one participant at a time: none of them is in a standard, and each says so."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from analysis.resampling.bootstrap import FLAT
from analysis.screening.fences import tukey_fences
from analysis.screening.findings import tell_shares, tell_values
from analysis.screening.judgements import FEWEST_JUDGEMENTS, HIGHEST, SAME_POINTS

if TYPE_CHECKING:
    from pandas import DataFrame

    from analysis.screening.judgements import Judgements

ALL_BUT = 0.95
"""Share of ratings at one step from which on nobody is taken to have used the scale."""

ONE_SIDED = 1.6448536269514722
"""95 % point of the normal distribution."""

FASTEST_S = 0.5
"""Nobody feels, weighs and answers in less."""


def judge_straight_lining(judgements: Judgements, limit: float) -> DataFrame:
    """Find raters who leave the slider at one place.

    Parameters
    ----------
    judgements : Judgements
        All of them; only test stimuli are looked at, as the reference belongs at one place.
    limit : float
        Largest share of ratings within two points of the scale of each other. On a scale of few steps, where a
        lenient rater uses the top step often, it is half as far from 1; or Tukey's upper fence of all raters' shares,
        if that is higher, because they agree on one step; but at most 95 %.

    Returns
    -------
    DataFrame
        As `tell_shares`; count is the largest number of ratings at one place.
    """
    grouped = judgements.of_kind("test").groupby("participant", observed=True)["rating"]
    count = grouped.agg(_count_densest).reindex(judgements.participants, fill_value=0)
    n = grouped.size().reindex(judgements.participants, fill_value=0)
    share = count / n.where(n >= FEWEST_JUDGEMENTS)
    usual = tukey_fences(share.dropna())[1] if share.notna().any() else limit
    widened = max(limit, min(ALL_BUT, max((1 + limit) / 2, usual)))
    return tell_values(count, n, share, limit=np.where(judgements.rounding().to_numpy() > 0, widened, limit))


def _count_densest(ratings: object) -> int:
    ordered = np.sort(np.asarray(ratings, dtype=np.float64))
    return int((np.searchsorted(ordered, ordered + SAME_POINTS, side="right") - np.arange(len(ordered))).max())


def judge_test_retest(judgements: Judgements, limit: float) -> DataFrame:
    """Find raters whose second ratings do not go with their first: random clicking.

    Parameters
    ----------
    judgements : Judgements
        All of them; the first two ratings of each test stimulus are looked at.
    limit : float
        Smallest correlation of first and second ratings; where n pairs would show a smaller one to be above zero,
        tanh(1.645 / sqrt(n - 3)) at the 5 % level, that one. Stimuli that hardly differ make small correlations of
        careful raters, too. On a scale of few steps it is lowered by what rounding takes off a correlation, the
        factor 1 - step² / (12 variance).

    Returns
    -------
    DataFrame
        As `tell_values`: count and n are pairs, share is Pearson's r; NaN for fewer than 8 pairs, and where a
        participant's first or second ratings are all the same, which `judge_straight_lining` is about.
    """
    pairs = judgements.first_two()
    whose, times = pairs["participant"], pairs[["first", "second"]]
    centred = times - times.groupby(whose, observed=True).transform("mean")
    products = centred.assign(both=centred["first"] * centred["second"], first=centred["first"] ** 2)
    sums = products.assign(second=centred["second"] ** 2).groupby(whose, observed=True).sum()
    sums = sums.reindex(judgements.participants)
    n = whose.value_counts().reindex(judgements.participants, fill_value=0)
    constant = sums[["first", "second"]].min(axis=1) <= FLAT * HIGHEST**2 * n
    r = (sums["both"] / (sums["first"] * sums["second"]).mask(constant) ** 0.5).clip(-1, 1)
    variance = (sums[["first", "second"]].mean(axis=1) / n.where(n > 0)).mask(constant)
    left = (1 - judgements.rounding() / variance).clip(0, 1).fillna(1.0).to_numpy()
    shown = np.tanh(ONE_SIDED / np.sqrt(n.clip(lower=FEWEST_JUDGEMENTS).to_numpy() - 3))
    floor = np.minimum(limit, shown) * (left if limit > 0 else 1.0)
    return tell_values(n, n, r.where(n >= FEWEST_JUDGEMENTS), limit=floor, below=True)


def judge_repeat_sd(judgements: Judgements, limit: float) -> DataFrame:
    """Find raters who rate the same stimulus far apart: random clicking.

    Parameters
    ----------
    judgements : Judgements
        All of them; the first two ratings of each test stimulus are looked at.
    limit : float
        Largest within-rater standard deviation, as a share of the scale's 100 points; on a scale of few steps,
        whose rounding adds step² / 12 to the variance, that much more.

    Returns
    -------
    DataFrame
        As `tell_values`: count and n are pairs, share is sqrt(Σ d² / (2 n)) / 100, d the difference of a pair. Clicks
        spread evenly over the scale give 0.29.
    """
    pairs = judgements.first_two()
    squares = ((pairs["first"] - pairs["second"]) ** 2).groupby(pairs["participant"], observed=True)
    n = squares.size().reindex(judgements.participants, fill_value=0)
    share = np.sqrt(squares.mean().reindex(judgements.participants) / 2) / HIGHEST
    widened = np.sqrt(limit**2 + judgements.rounding().to_numpy() / HIGHEST**2)
    return tell_values(n, n, share.where(n >= FEWEST_JUDGEMENTS), limit=widened)


def judge_too_fast(judgements: Judgements, limit: float) -> DataFrame:
    """Find raters who answer faster than they can have felt.

    Parameters
    ----------
    judgements : Judgements
        All of them.
    limit : float
        Largest share of answers within half a second.

    Returns
    -------
    DataFrame
        As `tell_shares`; answers without a time do not count.
    """
    rows = judgements.rows
    timed = rows.iloc[:0].assign(response_time_s=0.0)
    if "response_time_s" in rows:
        timed = rows[rows["response_time_s"].notna()]
    fast = timed["response_time_s"] < FASTEST_S
    return tell_shares(fast, timed["participant"], participants=judgements.participants, limit=limit)
