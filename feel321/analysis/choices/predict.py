"""Count the choices that each metric predicts, and those that anything could predict."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from feel321.analysis.arrays import CONFIDENCE, Values
from feel321.analysis.choices.votes import Votes, cluster_products, gather_votes
from feel321.analysis.primary.model import adjust_holm
from feel321.records import Result

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from pandas import DataFrame

    from feel321.analysis.table.items import Table
    from feel321.types import Direction

CHANCE = 0.5
FEWEST = 3
"""Participants and recordings below which there is no interval."""


@dataclass(frozen=True, slots=True, repr=False, eq=False)
class VotePrediction(Result):
    """How many choices each metric predicts.

    Parameters
    ----------
    shares : DataFrame, indexed by metric
        ``share`` of choices predicted, 0 to 1, a tie counting half; ``low`` and ``high``, its 95 % two-way interval;
        ``p`` against chance (0.5), two-sided, and ``p_holm``, adjusted for the number of metrics; ``n_ties``.
    differences : DataFrame
        One row per pair of metrics: ``first``, ``second``, ``difference`` of their shares, its interval, ``p`` and
        ``p_holm``.
    others : float
        Share of choices that the majority of the other participants made of the same pair: what a person's choice can
        be predicted by, from below. NaN where too few pairs were judged by two people or more.
    others_low, others_high : float
        Its 95 % two-way interval.
    majority : float
        Share of choices that agree with the majority of all, themselves among them: no metric that gives everybody the
        same answer predicts more.
    n_votes, n_participants, n_recordings, n_pairs : int
        Choices between test stimuli, people, recordings (sources, where several come from one), and pairs.
    notes : tuple of str
        What is to be read with care.
    """

    shares: DataFrame
    differences: DataFrame
    others: float
    others_low: float
    others_high: float
    majority: float
    n_votes: int
    n_participants: int
    n_recordings: int
    n_pairs: int
    notes: tuple[str, ...] = ()

    def to_frame(self) -> DataFrame:
        """Return the shares as a table.

        Returns
        -------
        DataFrame
            A row per metric, with the columns of `shares`.
        """
        return self.shares.reset_index()


def predict_votes(
    ratings: Table | DataFrame,
    metrics: Sequence[str] | None = None,
    *,
    stimuli: DataFrame | None = None,
    scale: str | None = None,
    level: str | None = None,
    higher: Mapping[str, Direction] | None = None,
) -> VotePrediction:
    """Count how many choices between two stimuli each metric predicts.

    Parameters
    ----------
    ratings : Table or DataFrame
        Choices: a Table with triplets or preferences, or the columns ``participant``, ``stimulus_id`` (felt first),
        ``other_id`` and ``rating`` (100 where the first was chosen, 0 where the other was).
    metrics : sequence of str, optional
        Columns of the stimuli; the declared ones of a Table if left out.
    stimuli : DataFrame, optional
        With a DataFrame of choices: one row per ``stimulus_id`` with ``recording``, the metrics, and ``role`` and
        ``source`` where there are any.
    scale, level : str, optional
        Which choices; needed where there are several scales.
    higher : Mapping of str to {"better", "worse"}, optional
        Whether a larger value of a metric is better or worse; what a Table's metrics declare, else better.

    Returns
    -------
    VotePrediction
        Shares, differences and the ceiling.

    Raises
    ------
    ValueError
        If there is no choice between two test stimuli, or a metric is not a column of the stimuli.

    Notes
    -----
    A metric predicts the stimulus with its better value. Intervals hold for other people and other recordings: the
    variance is that of clustering by participants and by recordings [1]_, V_P + V_R - V_PR, each part multiplied by
    G / (G - 1) for G groups, and never less than V_P or V_R; 95 % t intervals with U - 1 degrees of freedom, U the
    smaller number of the two, of shares on the scale of log odds. Below 3 participants or recordings there is none.
    Choices are mostly noise, which a bootstrap of participants and recordings counts three times: in 300 simulated
    studies a metric without any effect was found at a nominal 5 % in 0 to 2 % by such a bootstrap, and in 1 to 5 % by
    this variance. Reducers are not drawn: another set of reducers may rank metrics differently.

    The ceiling is given from both sides, as for noise ceilings of representational models [2]_: by the majority of the
    others, and by the majority of all.

    References
    ----------
    .. [1] Cameron, A. C., Gelbach, J. B., & Miller, D. L. (2011). Robust inference with multiway clustering. Journal of
       Business & Economic Statistics, 29(2), 238-249. doi:10.1198/jbes.2010.07136
    .. [2] Nili, H., Wingfield, C., Walther, A., Su, L., Marslen-Wilson, W., & Kriegeskorte, N. (2014). A toolbox for
       representational similarity analysis. PLoS Computational Biology, 10(4), e1003553.
       doi:10.1371/journal.pcbi.1003553

    Examples
    --------
    >>> import pandas as pd
    >>> from feel321 import analysis
    >>> stimuli = pd.DataFrame({"stimulus_id": list("xyz"), "recording": "oak", "match": [0.9, 0.5, 0.1]})
    >>> votes = pd.DataFrame({"participant": list("aabb"), "stimulus_id": list("xyxz"), "other_id": list("yzzx"),
    ...     "rating": [100, 100, 0, 0]})
    >>> analysis.predict_votes(votes, ["match"], stimuli=stimuli).shares["share"].tolist()
    [0.75]
    """
    votes = gather_votes(ratings, stimuli, scale=scale, level=level, metrics=metrics, higher=higher)
    return predict(votes)


def predict(votes: Votes) -> VotePrediction:
    """Count how many votes each metric predicts."""
    import pandas as pd

    hits = score_metrics(votes)
    others, majority = agree_with_others(votes), agree_with_all(votes)
    names = pd.Index(votes.metrics, name="metric")
    rows = [infer_share(votes, column) for column in hits.T]
    shares = pd.DataFrame(rows, index=names).assign(n_ties=(hits == CHANCE).sum(axis=0))
    told = [
        {"first": names[one], "second": names[two], **infer_difference(votes, hits[:, [one, two]])}
        for one, two in combinations(range(len(names)), 2)
    ]
    differences = pd.DataFrame(told, columns=["first", "second", "difference", "low", "high", "p"])
    notes, is_known = list(votes.notes), np.isfinite(others).mean() >= CHANCE
    if votes.n_units < FEWEST:
        notes.append("Below 3 participants or 3 recordings there is no interval.")
    if not is_known:
        notes.append(
            "Fewer than half of the choices were also made by somebody else: how well people agree cannot be estimated."
        )
    alike = infer_share(votes, others if is_known else np.full(len(votes), np.nan))
    return VotePrediction(
        shares=_adjust(shares), differences=_adjust(differences),
        others=alike.share, others_low=alike.low, others_high=alike.high,
        majority=float(majority.mean()) if is_known else np.nan,
        n_votes=len(votes), n_participants=votes.n_participants, n_recordings=votes.n_sources,
        n_pairs=int(votes.pair.max()) + 1, notes=tuple(notes),
    )  # fmt: skip


def score_metrics(votes: Votes) -> Values:
    """Score every vote by every metric, (n_votes, n_metrics): 1 predicted, 0 not, 0.5 where the metric is the same."""
    chosen = np.where(votes.chose_first, 1.0, -1.0)[:, None]
    scores: Values = (1 + np.sign(votes.differences) * chosen) / 2
    return scores


def agree_with_others(votes: Votes) -> Values:
    """Score every vote by the majority of the other participants' votes on its pair: 0.5 for a draw, NaN for none."""
    for_low, cast = _tally(votes)
    own = np.unique(np.stack([votes.pair, votes.participant]), axis=1, return_inverse=True)[
        1
    ].ravel()
    voted = votes.chose_first != votes.turned
    mine = np.bincount(own, voted)[own], np.bincount(own)[own]
    rest, n_rest = for_low[votes.pair] - mine[0], cast[votes.pair] - mine[1]
    lead = np.sign(2 * rest - n_rest) * np.where(voted, 1, -1)
    return np.where(n_rest > 0, (1 + lead) / 2, np.nan)


def agree_with_all(votes: Votes) -> Values:
    """Score every vote by the majority of all votes on its pair, itself among them; 0.5 for a draw."""
    for_low, cast = _tally(votes)
    lead = np.sign(2 * for_low - cast)[votes.pair]
    scores: Values = (1 + lead * np.where(votes.chose_first != votes.turned, 1, -1)) / 2
    return scores


def _tally(votes: Votes) -> tuple[Values, Values]:
    """Count the votes for the stimulus of each pair that is first by name, and all of its votes."""
    voted = (votes.chose_first != votes.turned).astype(np.float64)
    for_low = np.bincount(votes.pair, voted).astype(np.float64)
    return for_low, np.bincount(votes.pair).astype(np.float64)


class ShareInterval(NamedTuple):
    """A share with its 95 % interval and the probability of one as far from chance."""

    share: float
    low: float
    high: float
    p: float


def infer_share(votes: Votes, scores: Values) -> ShareInterval:
    """Give the mean of scores, (n_votes,), its interval on the scale of log odds; NaN scores are left out."""
    from scipy.special import expit, logit

    known = np.isfinite(scores)
    share = float(scores[known].mean()) if known.any() else np.nan
    if not 0 < share < 1:
        return ShareInterval(share, np.nan, np.nan, np.nan)
    influence = np.where(known, scores - share, 0.0) / known.sum()
    error = _measure_error(votes, influence) / (share * (1 - share))
    centre = float(logit(share))
    margin, p = _judge(centre, error, votes.n_units)
    return ShareInterval(share, float(expit(centre - margin)), float(expit(centre + margin)), p)


def infer_difference(votes: Votes, scores: Values) -> dict[str, float]:
    """Give the difference of the means of two columns of scores, (n_votes, 2), its interval and p."""
    each = scores[:, 0] - scores[:, 1]
    difference = float(each.mean())
    error = _measure_error(votes, (each - difference) / len(each))
    margin, p = _judge(difference, error, votes.n_units)
    return {
        "difference": difference, "low": difference - margin, "high": difference + margin, "p": p,
    }  # fmt: skip


def _measure_error(votes: Votes, influence: Values) -> float:
    """Measure the standard error of a mean from the influence of each vote, (n_votes,), by two-way clustering."""
    one, other, both = (float(part[0, 0]) for part in cluster_products(votes, influence[:, None]))
    error = float(np.sqrt(max(one + other - both, one, other)))
    return error if votes.n_units >= FEWEST and error > 0 else float("nan")


def _judge(value: float, error: float, units: int) -> tuple[float, float]:
    """Compute the margin of the 95 % interval, and the two-sided p."""
    from scipy.stats import t

    if not np.isfinite(error):
        return np.nan, np.nan
    margin = float(t.ppf((1 + CONFIDENCE) / 2, units - 1)) * error
    return margin, float(2 * t.sf(abs(value) / error, units - 1))


def _adjust(table: DataFrame) -> DataFrame:
    """Adjust p for the number of rows, by Holm."""
    return table.assign(p_holm=adjust_holm(table["p"].tolist()))
