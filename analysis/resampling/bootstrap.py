"""Weighted correlations and the cluster bootstrap, all draws at once.

Drawing participants with replacement is the same as weighting each by how often they were drawn; the item
means of every draw are then one matrix product. Recordings are drawn likewise, all their stimuli together,
because stimuli of one recording resemble each other.
"""

from __future__ import annotations

from types import MappingProxyType
from typing import TYPE_CHECKING, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from analysis.resampling.concordance import weighted_kendall

if TYPE_CHECKING:
    from collections.abc import Mapping

    from analysis.table.items import Items

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

STILL = 1e-12
"""Spread of draws up to which they are all the same but for rounding error."""

FEWEST_ITEMS = 3
"""Two points always lie on a line."""

TIED = 40
"""Binary digits of a mean rating that count for its rank; the others, below 1e-12 of it, are rounding error."""

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


class Method(NamedTuple):
    """How items are correlated.

    Parameters
    ----------
    correlation : Correlation
        Function of x, y and weights.
    ranked : bool
        Whether only the order of values counts.
    within : bool
        Whether recordings are correlated one by one, and averaged.
    """

    correlation: Correlation
    ranked: bool
    within: bool


METHODS: Mapping[str, Method] = MappingProxyType({
    "pearson": Method(weighted_pearson, ranked=False, within=False),
    "spearman": Method(weighted_spearman, ranked=True, within=False),
    "kendall": Method(weighted_kendall, ranked=True, within=False),
    "within": Method(weighted_pearson, ranked=False, within=True),
    "within_spearman": Method(weighted_spearman, ranked=True, within=True),
    "within_kendall": Method(weighted_kendall, ranked=True, within=True),
})
"""The one list of correlations: name -> how; ``within`` is Pearson's."""


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
    how = METHODS[method]
    means, rated = _average(items, participants, how=how)
    if how.within:
        parts = [_correlate_recordings(items, metric, means, rated=rated, how=how) for metric in items.metrics]
        return np.array([average_recordings(*part, counts=recordings) for part in parts])
    weights = recordings[:, items.recordings] * rated
    drawn = np.array([how.correlation(metric, means, weights=weights) for metric in items.metrics])
    return np.where((weights > 0).sum(axis=-1) < FEWEST_ITEMS, np.nan, drawn)


def _average(items: Items, participants: Values, *, how: Method) -> tuple[Values, NDArray[np.bool_]]:
    """Average each item's ratings over the participants drawn; also tell whether it has any."""
    seen = np.isfinite(items.ratings)
    votes = participants @ seen.astype(np.float64)
    sums = participants @ np.where(seen, items.ratings, 0.0)
    means = np.divide(sums, votes, out=np.zeros_like(sums), where=votes > 0)
    return _tie_rounded(means) if how.ranked else means, votes > 0


def _tie_rounded(means: Values) -> Values:
    """Make means that differ by rounding error only the same; whole numbers, of use for their order only."""
    exponent = np.frexp(np.abs(means).max(axis=-1, keepdims=True))[1]
    whole: Values = np.rint(np.ldexp(means, TIED - exponent))
    return whole


def _correlate_recordings(
    items: Items, metric: Values, means: Values, *, rated: NDArray[np.bool_], how: Method
) -> tuple[Values, Values]:
    """Correlate within each recording; also count the items that did: both of shape (draws, n_recordings)."""
    members = [np.flatnonzero(items.recordings == number) for number in range(items.n_recordings)]
    sizes = np.stack([rated[:, own].sum(axis=-1) for own in members], axis=-1).astype(np.float64)
    found = [how.correlation(metric[own], means[:, own], weights=rated[:, own].astype(np.float64)) for own in members]
    return np.where(sizes < FEWEST_ITEMS, np.nan, np.stack(found, axis=-1)), sizes


def correlate_each(items: Items, method: str) -> Values:
    """Correlation of item means with every metric within each recording, no draw taken.

    Parameters
    ----------
    items : Items
        Ratings and metrics.
    method : str
        A name of `METHODS`; ``pearson`` and ``within`` are the same here.

    Returns
    -------
    ndarray, shape (n_metrics, n_recordings)
        NaN where a recording has fewer than three rated items, or the metric or the means are constant in it.
    """
    everyone = np.ones((1, items.n_participants))
    means, rated = _average(items, everyone, how=METHODS[method])
    each = [_correlate_recordings(items, row, means, rated=rated, how=METHODS[method])[0] for row in items.metrics]
    return np.concatenate(each)


def average_recordings(correlations: Values, sizes: Values, *, counts: Values) -> Values:
    """Average the correlations of recordings over Fisher's z.

    Parameters
    ----------
    correlations : ndarray, shape (draws, n_recordings)
        Correlation within each recording; those that are not defined (NaN) do not count.
    sizes : ndarray, shape (draws, n_recordings)
        Number of items that each rests on.
    counts : ndarray, shape (draws, n_recordings)
        How often each recording was drawn.

    Returns
    -------
    ndarray, shape (draws,)
        tanh of the mean z; 1 or -1 where all recordings say so; NaN where none is defined.

    Notes
    -----
    A perfect correlation has no z, yet among few items one by ranks is common and must neither be left out nor
    outweigh all others. One of n items counts as 1 - 6 / (n (n² - 1)), half way to the next lower correlation of ranks.

    Examples
    --------
    >>> one, n = np.ones((1, 2)), np.full((1, 2), 9.0)
    >>> average_recordings(np.array([[0.2, 0.6]]), n, counts=one).round(3)
    array([0.42])
    """
    defined = np.isfinite(correlations)
    weights = counts * defined
    total = weights.sum(axis=-1)
    signs = np.where(np.abs(correlations) < PERFECT, 0.0, np.sign(correlations))
    with np.errstate(invalid="ignore", divide="ignore"):
        held = np.where(signs == 0, correlations, signs * (1 - 6 / (sizes * (sizes**2 - 1))))
        z = (weights * np.where(defined, np.arctanh(held), 0.0)).sum(axis=-1) / total
        mean_sign = (weights * np.where(defined, signs, 0.0)).sum(axis=-1) / total
    return np.where(np.abs(mean_sign) == 1, mean_sign, np.tanh(z))


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
        t(.975, U - 1) sqrt(U / (U - 1)) SD; NaN if there is one unit only, more than a tenth of the draws are
        undefined, or all draws are the same, as ranks may be: that is no sign of certainty.

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
    if np.ptp(defined) <= STILL:
        return float("nan")
    quantile = float(t.ppf((1 + CONFIDENCE) / 2, n_units - 1))
    return quantile * float(np.sqrt(n_units / (n_units - 1)) * defined.std(ddof=1))
