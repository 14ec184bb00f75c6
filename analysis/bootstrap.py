"""Weighted correlations and the cluster bootstrap, all draws at once.

Drawing participants with replacement is the same as weighting each by how often they were drawn; the item
means of every draw are then one matrix product. Recordings are drawn likewise, all their stimuli together,
because stimuli of one recording resemble each other.
"""

from __future__ import annotations

from types import MappingProxyType
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from collections.abc import Mapping

    from analysis.items import Items

Values = NDArray[np.float64]


class Correlation(Protocol):
    """A correlation of weighted items."""

    def __call__(self, x: Values, y: Values, *, weights: Values) -> Values:
        """Correlate along the last axis."""
        ...


FLAT = 1e-24
"""Share of a sum of squares below which its centred part is rounding error: the values are all the same."""

PERFECT = 1 - 1e-12
"""From here on a correlation is perfect to rounding error."""

FEWEST_ITEMS = 3
"""Two points always lie on a line."""

MOST_UNDEFINED = 0.1
"""Share of draws that may be undefined; with more, those left over are not a fair sample of what could be."""

CONFIDENCE = 0.95


def weighted_pearson(x: Values, y: Values, *, weights: Values) -> Values:
    """Pearson's correlation along the last axis, each item counting as often as its weight says.

    Parameters
    ----------
    x, y : ndarray, shape (..., n_items)
        Values, broadcast against each other and the weights.
    weights : ndarray, shape (..., n_items)
        How often each item counts, 0 or more.

    Returns
    -------
    ndarray, shape (...)
        The correlation; NaN where x or y is constant.

    Examples
    --------
    >>> x, y = np.array([1.0, 2, 3]), np.array([1.0, 3, 2])
    >>> weighted_pearson(x, y, weights=np.ones(3)).round(3)
    np.float64(0.5)
    """
    x, y, weights = np.broadcast_arrays(_scale_down(x), _scale_down(y), weights)
    total = weights.sum(axis=-1, keepdims=True)
    with np.errstate(invalid="ignore", divide="ignore"):
        from_mean_x = x - (weights * x).sum(axis=-1, keepdims=True) / total
        from_mean_y = y - (weights * y).sum(axis=-1, keepdims=True) / total
        xx, yy = (weights * from_mean_x**2).sum(axis=-1), (weights * from_mean_y**2).sum(axis=-1)
        flat_x = xx <= FLAT * (weights * x**2).sum(axis=-1)
        flat_y = yy <= FLAT * (weights * y**2).sum(axis=-1)
        r = (weights * from_mean_x * from_mean_y).sum(axis=-1) / (np.sqrt(xx) * np.sqrt(yy))
    return np.where(flat_x | flat_y, np.nan, np.clip(r, -1, 1))


def _scale_down(values: Values) -> Values:
    """Divide by a power of two, which is exact, so that no square overflows."""
    exponent = np.frexp(np.abs(values).max(axis=-1, keepdims=True))[1]
    scaled: Values = np.ldexp(values, -exponent)
    return scaled


def weighted_spearman(x: Values, y: Values, *, weights: Values) -> Values:
    """Spearman's rank correlation along the last axis, each item counting as often as its weight says.

    Parameters
    ----------
    x, y : ndarray, shape (..., n_items)
        Values, broadcast against each other and the weights.
    weights : ndarray of whole numbers, shape (..., n_items)
        How often each item counts, 0 or more.

    Returns
    -------
    ndarray, shape (...)
        Pearson's correlation of the mid-ranks; NaN where x or y is constant.
    """
    return weighted_pearson(weighted_ranks(x, weights), weighted_ranks(y, weights), weights=weights)


def weighted_ranks(values: Values, weights: Values) -> Values:
    """Mid-ranks along the last axis of a sample in which each item occurs as often as its weight says.

    Parameters
    ----------
    values : ndarray, shape (..., n_items)
        What to rank.
    weights : ndarray of whole numbers, shape (..., n_items)
        How often each item occurs; ties share the mean of their ranks.

    Returns
    -------
    ndarray, shape (..., n_items)
        Rank of each item, from 1.

    Examples
    --------
    >>> weighted_ranks(np.array([10.0, 30, 20]), np.array([1.0, 1, 2])).tolist()
    [1.0, 4.0, 2.5]
    """
    values, weights = np.broadcast_arrays(values, weights)
    order = np.argsort(values, axis=-1, kind="stable")
    ordered = np.take_along_axis(values, order, axis=-1)
    upto = np.cumsum(np.take_along_axis(weights, order, axis=-1), axis=-1)
    before = np.concatenate([np.zeros_like(upto[..., :1]), upto[..., :-1]], axis=-1)
    rises = np.diff(ordered, axis=-1) > 0
    ends = np.ones((*rises.shape[:-1], 1), dtype=bool)
    # Both counts only grow, so a running maximum carries a tie's start forward and a running minimum its end
    # back.
    start = np.maximum.accumulate(np.where(np.concatenate([ends, rises], axis=-1), before, 0), axis=-1)
    stop = np.where(np.concatenate([rises, ends], axis=-1), upto, np.inf)
    stop = np.minimum.accumulate(stop[..., ::-1], axis=-1)[..., ::-1]
    ranks = np.empty_like(upto)
    np.put_along_axis(ranks, order, (start + stop + 1) / 2, axis=-1)
    return ranks


METHODS: Mapping[str, Correlation] = MappingProxyType(
    {"pearson": weighted_pearson, "spearman": weighted_spearman}
)
"""The one list of correlations: name -> function of x, y and weights."""


def draw_counts(n_units: int, draws: int, *, rng: np.random.Generator) -> Values:
    """How often each unit occurs in each sample of as many units, drawn with replacement.

    Parameters
    ----------
    n_units : int
        Number of participants or recordings.
    draws : int
        Number of samples.
    rng : Generator
        Source of randomness.

    Returns
    -------
    ndarray, shape (draws, n_units)
        Whole numbers; every row adds up to n_units.
    """
    return rng.multinomial(n_units, np.full(n_units, 1 / n_units), size=draws).astype(np.float64)


def correlate_draws(items: Items, method: str, *, participants: Values, recordings: Values) -> Values:
    """Correlation of item means with every metric in every draw.

    Parameters
    ----------
    items : Items
        Ratings and metrics.
    method : str
        A name of `METHODS`.
    participants : ndarray, shape (draws, n_participants)
        How often each participant was drawn.
    recordings : ndarray, shape (draws, n_recordings)
        How often each recording was drawn.

    Returns
    -------
    ndarray, shape (n_metrics, draws)
        NaN where a draw leaves the metric or the means constant, or fewer than three different items.
    """
    seen = np.isfinite(items.ratings)
    votes = participants @ seen.astype(np.float64)
    sums = participants @ np.where(seen, items.ratings, 0.0)
    means = np.divide(sums, votes, out=np.zeros_like(sums), where=votes > 0)
    weights = recordings[:, items.recordings] * (votes > 0)
    drawn = np.array([METHODS[method](metric, means, weights=weights) for metric in items.metrics])
    return np.where((weights > 0).sum(axis=-1) < FEWEST_ITEMS, np.nan, drawn)


def fisher_z(correlation: Values) -> Values:
    """Fisher's transform; NaN for a perfect correlation, which has none.

    Parameters
    ----------
    correlation : ndarray
        Between -1 and 1, or NaN.

    Returns
    -------
    ndarray
        The inverse hyperbolic tangent.
    """
    z: Values = np.arctanh(np.where(np.abs(correlation) < PERFECT, correlation, np.nan))
    return z


def bootstrap_margin(drawn: Values, n_units: int) -> float:
    """Half width of the 95 % interval of a statistic, from its bootstrap draws.

    Parameters
    ----------
    drawn : ndarray, shape (draws,)
        The statistic in every draw, on a scale where it is about normal; NaN where it is not defined.
    n_units : int
        How many units of the scarcest kind were drawn from: recordings, or participants.

    Returns
    -------
    float
        t(.975, U - 1) sqrt(U / (U - 1)) SD; NaN if there is one unit only, or more than a tenth of the draws
        are undefined.

    Notes
    -----
    Resampling U units understates a variance by (U - 1) / U and knows it on U - 1 degrees of freedom only;
    with the eight or so recordings of a study both matter.
    """
    from scipy.stats import t

    defined = drawn[np.isfinite(drawn)]
    too_many = len(drawn) - len(defined) > MOST_UNDEFINED * len(drawn)
    if too_many or min(n_units, len(defined)) < 2:  # noqa: PLR2004 - a spread needs two
        return float("nan")
    quantile = float(t.ppf((1 + CONFIDENCE) / 2, n_units - 1))
    return quantile * float(np.sqrt(n_units / (n_units - 1)) * defined.std(ddof=1))
