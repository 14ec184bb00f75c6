"""Rules about the hidden reference and the anchors: ITU-R BS.1534-3, and one extension of it.

References
----------
.. [1] Recommendation ITU-R BS.1534-3 (2015), Method for the subjective assessment of intermediate quality level of
   audio systems, on post-screening of assessors.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from analysis.screening.findings import tell_shares

if TYPE_CHECKING:
    from pandas import DataFrame, Series

    from analysis.screening.judgements import Judgements

EXCELLENT = 90.0
"""The hidden reference is to be rated at least this, the mid anchor at most."""

MOST_RATERS = 0.25
"""If a larger share of raters puts the mid anchor above `EXCELLENT`, the excerpt was hardly degraded by it."""

MIDDLE = 50.0
"""What the low anchor may be rated at most, in the extension."""


def share_undegraded(judgements: Judgements) -> Series:
    """Share of raters who put the mid anchor of each excerpt above 90, repeats averaged.

    Parameters
    ----------
    judgements : Judgements
        All of them.

    Returns
    -------
    Series
        By number of the excerpt; those without a mid anchor are absent. Above 25 % the excerpt does not count.
    """
    mid = judgements.of_kind("mid")
    means = mid.groupby(["excerpt", "participant"], observed=True)["rating"].mean()
    return (means > EXCELLENT).groupby("excerpt").mean()


def judge_hidden_reference(judgements: Judgements, limit: float) -> DataFrame:
    """Find raters who put the hidden reference below 90 too often (BS.1534-3).

    Parameters
    ----------
    judgements : Judgements
        All of them.
    limit : float
        Largest share of its presentations, excerpts that do not count left aside.

    Returns
    -------
    DataFrame
        As `tell_shares`.
    """
    rows = _select_counted(judgements, "reference")
    return tell_shares(
        rows["rating"] < EXCELLENT, rows["participant"], participants=judgements.participants, limit=limit
    )


def judge_mid_anchor(judgements: Judgements, limit: float) -> DataFrame:
    """Find raters who put the mid anchor above 90 too often (BS.1534-3).

    Parameters
    ----------
    judgements : Judgements
        All of them.
    limit : float
        Largest share of its presentations, excerpts that do not count left aside.

    Returns
    -------
    DataFrame
        As `tell_shares`.
    """
    rows = _select_counted(judgements, "mid")
    return tell_shares(
        rows["rating"] > EXCELLENT, rows["participant"], participants=judgements.participants, limit=limit
    )


def judge_low_anchor(judgements: Judgements, limit: float) -> DataFrame:
    """Find raters who put the low anchor above the middle of the scale too often (an extension, not BS.1534-3).

    Parameters
    ----------
    judgements : Judgements
        All of them.
    limit : float
        Largest share of its presentations.

    Returns
    -------
    DataFrame
        As `tell_shares`.
    """
    rows = judgements.of_kind("low")
    return tell_shares(rows["rating"] > MIDDLE, rows["participant"], participants=judgements.participants, limit=limit)


def _select_counted(judgements: Judgements, kind: str) -> DataFrame:
    rows, shares = judgements.of_kind(kind), share_undegraded(judgements)
    return rows[~rows["excerpt"].isin(shares.index[shares > MOST_RATERS])]
