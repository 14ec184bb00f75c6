"""The outer cross-validation: every stimulus is predicted by what other people said of other recordings."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from analysis.refined.choice import choose, fit_candidate, leave_out, sum_moments
from analysis.refined.folds import average_groups
from analysis.resampling.bootstrap import FLAT

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from analysis.refined.candidates import Basis
    from analysis.refined.folds import Means, Split
    from analysis.table.items import Items

    Values = NDArray[np.float64]


class Data(NamedTuple):
    """What stays the same in every draw.

    Parameters
    ----------
    items : Items
        Ratings.
    basis : Basis
        Columns and candidates.
    split : Split
        Who is left out with whom.
    within : bool
        Whether only differences within recordings count.
    """

    items: Items
    basis: Basis
    split: Split
    within: bool


class Outcome(NamedTuple):
    """What came out, per draw.

    Parameters
    ----------
    chosen : ndarray of int, shape (draws, groups, folds)
        Place of the candidate that was chosen without each group and fold.
    fits : ndarray, shape (n_candidates, draws, groups, folds, m)
        Coefficients of every candidate, fitted without them.
    correlations, errors : ndarray, shape (1 + n_candidates, draws)
        Out of fold: correlation and root mean squared error; first of what was chosen, then of each candidate.
    as_it_is : ndarray, shape (n_candidates, draws)
        Correlation of the candidates of one column with nothing fitted, higher being better; NaN for the others.
    """

    chosen: NDArray[np.intp]
    fits: Values
    correlations: Values
    errors: Values
    as_it_is: Values


def score_draws(data: Data, *, people: Values, recordings: Values) -> Outcome:
    """Choose, fit and predict anew in every draw.

    Parameters
    ----------
    data : Data
        Ratings and candidates.
    people : ndarray, shape (draws, n_participants)
        How often each was drawn.
    recordings : ndarray, shape (draws, n_recordings)
        How often each was drawn.

    Returns
    -------
    Outcome
        Choices and out-of-fold scores.
    """
    items, basis, folds = data.items, data.basis, data.split.items
    means = average_groups(items, data.split, people, within=data.within)
    counts = recordings[:, items.recordings]
    moments = sum_moments(basis.columns, means.others, counts[:, None] * means.known, folds=folds)
    chosen = choose(moments, basis.candidates, nested=True)
    fits = np.array([fit_candidate(leave_out(moments), one) for one in basis.candidates])
    picked = np.take_along_axis(fits, chosen[None, ..., None], axis=0)
    scores = [_score(data, fit, means=means, counts=counts) for fit in (*picked, *fits)]
    correlations, errors = np.array(scores).transpose(1, 0, 2)
    plain = [
        _correlate(means, np.broadcast_to(basis.columns[:, one.columns[0]], means.own.shape), counts)
        if len(one.columns) == 1 else np.full(len(people), np.nan)
        for one in basis.candidates
    ]  # fmt: skip
    return Outcome(chosen, fits, correlations, errors, np.array(plain))


def join_draws(parts: Sequence[Outcome]) -> Outcome:
    """Join what came out of several blocks of draws.

    Parameters
    ----------
    parts : sequence of Outcome
        In order.

    Returns
    -------
    Outcome
        Of all draws.
    """
    return Outcome(
        chosen=np.concatenate([part.chosen for part in parts]),
        fits=np.concatenate([part.fits for part in parts], axis=1),
        correlations=np.concatenate([part.correlations for part in parts], axis=1),
        errors=np.concatenate([part.errors for part in parts], axis=1),
        as_it_is=np.concatenate([part.as_it_is for part in parts], axis=1),
    )


def _score(data: Data, fits: Values, *, means: Means, counts: Values) -> tuple[Values, Values]:
    """Correlate and compare what is predicted of each item without its fold and the group."""
    values = data.basis.columns
    combined = _combine(values, fits[..., 1:-1], data.split.items)
    spread = np.sqrt(((fits[..., 1:-1] @ (values.T @ values / len(values))) * fits[..., 1:-1]).sum(axis=-1))
    spread, level = spread[..., data.split.items], fits[..., 0][..., data.split.items]
    # A metric's unit is its own affair: without this, folds would be mixed in different units.
    metric = np.divide(combined, spread, out=np.zeros_like(combined), where=spread > 0)
    error = (means.share * (means.own - combined - level)).sum(axis=1)
    weights = counts * (means.share.sum(axis=1) > 0)
    mean_square = (weights * error**2).sum(axis=-1) / weights.sum(axis=-1)
    return _correlate(means, metric, counts), np.sqrt(mean_square)


def _combine(values: Values, weights: Values, folds: NDArray[np.intp]) -> Values:
    """Sum the columns of each item with the weights fitted without its fold."""
    combined = np.empty((*weights.shape[:-2], len(values)))
    for fold in range(weights.shape[-2]):
        combined[..., folds == fold] = weights[..., fold, :] @ values[folds == fold].T
    return combined


def _correlate(means: Means, metric: Values, counts: Values) -> Values:
    """Correlate each group's ratings with the metric that was made without them."""
    weights = counts * (means.share.sum(axis=1) > 0)
    total = weights.sum(axis=-1, keepdims=True)
    rated, valued = ((means.share * part).sum(axis=1) for part in (means.own, metric))
    middle_rated, middle_valued = ((weights * part).sum(axis=-1, keepdims=True) / total for part in (rated, valued))
    products = means.share * (means.own - middle_rated[:, None]) * (metric - middle_valued[:, None])
    covariance = (weights * products.sum(axis=1)).sum(axis=-1)
    squares_rated = (weights * (rated - middle_rated) ** 2).sum(axis=-1)
    # Of each group's own metric: where groups contradict each other, their mean would be next to nothing.
    squares_valued = (weights * (means.share * (metric - middle_valued[:, None]) ** 2).sum(axis=1)).sum(axis=-1)
    size = [(weights * part).sum(axis=-1) for part in (rated**2, (means.share * metric**2).sum(axis=1))]
    flat = (squares_rated <= FLAT * size[0]) | (squares_valued <= FLAT * size[1])
    below = np.sqrt(np.where(flat, 1.0, squares_rated * squares_valued))
    correlation: Values = np.where(flat, np.nan, np.clip(covariance / below, -1, 1))
    return correlation
