"""Expertise of raters: discrimination, reliability and agreement, each against a permutation null.

In the manner of Report ITU-R BS.2300 (Methods for assessor screening); the measures below are defined here, because
the data need not be balanced.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from analysis.screening.findings import tell_values

if TYPE_CHECKING:
    from numpy.typing import NDArray
    from pandas import DataFrame

    from analysis.screening.judgements import Judgements

    Values = NDArray[np.float64]

MEASURES = ("discrimination", "reliability", "agreement")

PERMUTATIONS = 499

FLOOR = 0.95
"""Share of permutations that an expert's measure exceeds."""


class _Trials(NamedTuple):
    """One rater's judgements of test stimuli, and what the panel made of the same stimuli."""

    item: NDArray[np.intp]
    rating: Values
    others: Values
    """Mean of the other raters per item; NaN where there is none."""
    panel_square: float
    """Mean square between items of the average rater."""


def gauge_raters(judgements: Judgements, *, permutations: int = PERMUTATIONS, rng: np.random.Generator) -> DataFrame:
    """Measure how expert each rater is.

    Parameters
    ----------
    judgements : Judgements
        All of them; test stimuli are looked at.
    permutations : int
        Times that each rater's ratings are shuffled over their trials.
    rng : Generator
        Source of randomness.

    Returns
    -------
    DataFrame
        participant, measure, value, floor (95 % point of the null), p (share of shuffles that do as well, the rater's
        own included). NaN where a measure is not defined: no repeats, or constant ratings.

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

    tests = judgements.of_kind("test")
    means = judgements.means()
    panel_square = _average_square(judgements)
    rows = []
    for participant, own in tests.groupby("participant", observed=True):
        items = range(int(tests["item"].max()) + 1)
        others = means.drop(index=participant).mean().reindex(items).to_numpy()
        trials = _Trials(own["item"].to_numpy(), own["rating"].to_numpy(), others, panel_square)
        rows += [{"participant": participant, **row} for row in _gauge(trials, permutations, rng=rng)]
    return pd.DataFrame(rows, columns=["participant", "measure", "value", "floor", "p"])


def judge_expertise(gauge: DataFrame, judgements: Judgements, limit: float) -> DataFrame:
    """Find raters who are no better than their own shuffled ratings.

    Parameters
    ----------
    gauge : DataFrame
        As `gauge_raters` gives it.
    judgements : Judgements
        The same ratings.
    limit : float
        Largest share of defined measures that may fail to exceed the null.

    Returns
    -------
    DataFrame
        As `tell_values`: count of measures that fail, of n that are defined.
    """
    defined = gauge[gauge["value"].notna()]
    failed = (defined["p"] > 1 - FLOOR).groupby(defined["participant"].to_numpy())
    count = failed.sum().reindex(judgements.participants, fill_value=0)
    n = failed.size().reindex(judgements.participants, fill_value=0)
    return tell_values(count, n, count / n.where(n > 0), limit=limit)


def _average_square(judgements: Judgements) -> float:
    tests = judgements.of_kind("test")
    squares = [
        _mean_squares(own["item"].to_numpy(), own["rating"].to_numpy()[None])[0][0]
        for _, own in tests.groupby("participant", observed=True)
    ]
    return float(np.nanmean(squares)) if np.isfinite(squares).any() else float("nan")


def _gauge(trials: _Trials, permutations: int, *, rng: np.random.Generator) -> list[dict[str, object]]:
    shuffled = rng.permuted(np.broadcast_to(trials.rating, (permutations, len(trials.rating))), axis=1)
    measured = _measure(trials, np.vstack([trials.rating, shuffled]))
    rows: list[dict[str, object]] = []
    for name, values in zip(MEASURES, measured, strict=True):
        null = values[1:][~np.isnan(values[1:])]
        defined = not np.isnan(values[0]) and len(null) > 0
        rows.append({
            "measure": name,
            "value": float(values[0]),
            "floor": float(np.quantile(null, FLOOR, method="higher")) if defined else float("nan"),
            "p": (1 + int((null >= values[0]).sum())) / (1 + len(null)) if defined else float("nan"),
        })
    return rows


def _measure(trials: _Trials, ratings: Values) -> tuple[Values, Values, Values]:
    """Discrimination, reliability and agreement of every row of ratings."""
    between, within = _mean_squares(trials.item, ratings)
    with np.errstate(invalid="ignore", divide="ignore"):
        return between / within, trials.panel_square / within, _agree(trials, ratings)


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


def _average_items(item: NDArray[np.intp], ratings: Values) -> tuple[Values, Values, NDArray[np.intp]]:
    _, place, counts = np.unique(item, return_inverse=True, return_counts=True)
    starts = np.cumsum(counts) - counts
    sums = np.add.reduceat(ratings[:, np.argsort(place, kind="stable")], starts, axis=1)
    return sums / counts, counts.astype(np.float64), place


def _agree(trials: _Trials, ratings: Values) -> Values:
    means = _average_items(trials.item, ratings)[0]
    others = trials.others[np.unique(trials.item)]
    shared = np.isfinite(others)
    if shared.sum() < 3:  # noqa: PLR2004 - two points always lie on a line
        return np.full(len(ratings), np.nan)
    own = means[:, shared] - means[:, shared].mean(axis=1, keepdims=True)
    other = others[shared] - others[shared].mean()
    scale = np.sqrt((own**2).sum(axis=1) * (other**2).sum())
    r: Values = np.divide((own * other).sum(axis=1), scale, out=np.full(len(own), np.nan), where=scale > 0)
    return r
