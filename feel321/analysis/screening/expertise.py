"""Expertise of raters: discrimination, reliability and agreement, each against a permutation null.

In the manner of Report ITU-R BS.2300 (Methods for assessor screening); the measures are defined here, because the data
need not be balanced.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from feel321.analysis.resampling import FEWEST_ITEMS
from feel321.analysis.screening.judgements import FLOOR

if TYPE_CHECKING:
    from numpy.typing import NDArray
    from pandas import DataFrame

    from feel321.analysis.screening.judgements import Judgements

    Values = NDArray[np.float64]

MEASURES = ("discrimination", "reliability", "agreement")

PERMUTATIONS = 499


class RaterTrials(NamedTuple):
    """One rater's judgements of test stimuli, and what the panel made of the same stimuli.

    others: mean of the other raters per item, NaN where there is none; panel_square: mean square between items of the
    average rater.
    """

    item: NDArray[np.intp]
    rating: Values
    others: Values
    panel_square: float


def gauge_raters(
    judgements: Judgements, *, permutations: int = PERMUTATIONS, rng: np.random.Generator
) -> DataFrame:
    """Measure how expert each rater is: participant, measure, value, floor (95 % of its null), p.

    Notes
    -----
    From one rater's one-way analysis of variance, items against repeats, with mean squares M_items and M_repeats:
    discrimination is M_items / M_repeats (do stimuli differ for this rater beyond the rater's own noise?), reliability
    is the panel's average M_items / M_repeats (is the noise small against what there is to hear or feel?), agreement
    is Pearson's r with the mean of the others over items. Shuffling ratings over trials keeps how a rater uses the
    scale and destroys everything else. Rarely use it to exclude: raters who differ are not thereby wrong.

    References
    ----------
    Lorho, Le Ray & Zacharov (2010), eGauge: a measure of assessor expertise in audio quality evaluations, AES 38th
    International Conference.
    """
    import pandas as pd

    tests, means = judgements.of_kind("test"), judgements.means()
    people = list(tests.groupby("participant", observed=True))
    between = [
        _mean_squares(own["item"].to_numpy(), own["rating"].to_numpy()[None])[0][0]
        for _, own in people
    ]
    panel_square = float(np.nanmean(between)) if np.isfinite(between).any() else float("nan")
    rows = []
    for participant, own in people:
        items = range(int(tests["item"].max()) + 1)
        others = means.drop(index=participant).mean().reindex(items).to_numpy()
        trials = RaterTrials(own["item"].to_numpy(), own["rating"].to_numpy(), others, panel_square)
        rows += [
            {"participant": participant, **row} for row in _gauge(trials, permutations, rng=rng)
        ]
    return pd.DataFrame(rows, columns=["participant", "measure", "value", "floor", "p"])


def _gauge(
    trials: RaterTrials, permutations: int, *, rng: np.random.Generator
) -> list[dict[str, object]]:
    shape = permutations, len(trials.rating)
    shuffled = rng.permuted(np.broadcast_to(trials.rating, shape), axis=1)
    ratings = np.vstack([trials.rating, shuffled])
    between, within = _mean_squares(trials.item, ratings)
    with np.errstate(invalid="ignore", divide="ignore"):
        measured = between / within, trials.panel_square / within, _agree(trials, ratings)
    rows: list[dict[str, object]] = []
    for name, values in zip(MEASURES, measured, strict=True):
        value, null = float(values[0]), values[1:][~np.isnan(values[1:])]
        floor = p = float("nan")
        if not np.isnan(value) and len(null):
            floor = float(np.quantile(null, FLOOR, method="higher"))
            p = (1 + int((null >= value).sum())) / (1 + len(null))
        rows.append({"measure": name, "value": value, "floor": floor, "p": p})
    return rows


def _mean_squares(item: NDArray[np.intp], ratings: Values) -> tuple[Values, Values]:
    means, counts, place = _average_items(item, ratings)
    n_items, spare = len(counts), len(item) - len(counts)
    nothing = np.full(len(ratings), np.nan)
    if n_items < 2 or not spare:  # noqa: PLR2004 - a variance needs two
        return nothing, nothing
    grand = ratings.mean(axis=1, keepdims=True)
    between = (counts * (means - grand) ** 2).sum(axis=1) / (n_items - 1)
    within = ((ratings - means[:, place]) ** 2).sum(axis=1) / spare
    constant = np.ptp(ratings, axis=1) == 0
    return np.where(constant, np.nan, between), np.where(constant, np.nan, within)


def _average_items(
    item: NDArray[np.intp], ratings: Values
) -> tuple[Values, Values, NDArray[np.intp]]:
    _, place, counts = np.unique(item, return_inverse=True, return_counts=True)
    starts = np.cumsum(counts) - counts
    sums = np.add.reduceat(ratings[:, np.argsort(place, kind="stable")], starts, axis=1)
    return sums / counts, counts.astype(np.float64), place


def _agree(trials: RaterTrials, ratings: Values) -> Values:
    means = _average_items(trials.item, ratings)[0]
    others = trials.others[np.unique(trials.item)]
    shared = np.isfinite(others)
    if shared.sum() < FEWEST_ITEMS:
        return np.full(len(ratings), np.nan)
    own = means[:, shared] - means[:, shared].mean(axis=1, keepdims=True)
    other = others[shared] - others[shared].mean()
    scale = np.sqrt((own**2).sum(axis=1) * (other**2).sum())
    r: Values = np.divide(
        (own * other).sum(axis=1), scale, out=np.full(len(own), np.nan), where=scale > 0
    )
    return r
