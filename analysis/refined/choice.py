"""The inner cross-validation: which candidate, judged by recordings that none of them was fitted to.

Every least-squares fit and every squared error is made of sums over items. These are taken once per fold of
recordings; leaving a fold out is then a subtraction, and all draws are worked on at once.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from analysis.refined.candidates import Candidate

    Values = NDArray[np.float64]

RIDGE = 1e-9
"""Share of the mean square that keeps fits defined where metrics are the same: they then share the weight."""


def sum_moments(basis: Values, ratings: Values, weights: Values, *, folds: NDArray[np.intp]) -> Values:
    """Sum the products of 1, the columns and the rating over the items of each fold.

    Parameters
    ----------
    basis : ndarray, shape (n_items, n_columns)
        Columns.
    ratings, weights : ndarray, shape (..., n_items)
        Mean ratings, and how often each item counts.
    folds : ndarray of int, shape (n_items,)
        Fold of each item.

    Returns
    -------
    ndarray, shape (..., n_folds, n_columns + 2, n_columns + 2)
        Symmetric; the rating comes last.
    """
    known = np.column_stack([np.ones(len(basis)), basis])
    size, n_folds = known.shape[1], int(folds.max()) + 1
    moments = np.empty((*ratings.shape[:-1], n_folds, size + 1, size + 1))
    for fold in range(n_folds):
        own = known[folds == fold]
        weight, rating = weights[..., folds == fold], ratings[..., folds == fold]
        squares = (own[:, :, None] * own[:, None, :]).reshape(len(own), -1)
        moments[..., fold, :-1, :-1] = (weight @ squares).reshape(*weight.shape[:-1], size, size)
        moments[..., fold, -1, :-1] = moments[..., fold, :-1, -1] = (weight * rating) @ own
        moments[..., fold, -1, -1] = (weight * rating**2).sum(axis=-1)
    return moments


def fit_candidate(moments: Values, candidate: Candidate) -> Values:
    """Fit intercept and weights by least squares.

    Parameters
    ----------
    moments : ndarray, shape (..., m, m)
        Sums over the items to fit to.
    candidate : Candidate
        Which columns.

    Returns
    -------
    ndarray, shape (..., m)
        Coefficients of 1 and of every column, and -1 for the rating: its product with a row is the error.
    """
    coefficients = np.zeros(moments.shape[:-1])
    coefficients[..., _list_used(candidate)] = _fit(_take(moments, candidate))
    return coefficients


def _list_used(candidate: Candidate) -> list[int]:
    return [0, *(column + 1 for column in candidate.columns), -1]


def _take(moments: Values, candidate: Candidate) -> Values:
    used = _list_used(candidate)
    return np.ascontiguousarray(moments[..., used, :][..., used])


def _fit(moments: Values) -> Values:
    total, sums = moments[..., :1, 0], moments[..., 0, 1:]
    means = np.divide(sums, total, out=np.zeros_like(sums), where=total > 0)
    centred = moments[..., 1:, 1:] - means[..., :, None] * sums[..., None, :]
    matrix, product = centred[..., :-1, :-1], centred[..., :-1, -1:]
    size = np.trace(matrix, axis1=-2, axis2=-1)[..., None, None] / matrix.shape[-1]
    steady = matrix + RIDGE * np.eye(matrix.shape[-1]) * np.where(size > 0, size, 1.0)
    # Most candidates have one column, and a division takes a twentieth of a solution's time.
    weights = (product / steady if matrix.shape[-1] == 1 else np.linalg.solve(steady, product))[..., 0]
    level = means[..., -1:] - (means[..., :-1] * weights).sum(axis=-1, keepdims=True)
    return np.concatenate([level, weights, np.full_like(level, -1.0)], axis=-1)


def leave_out(moments: Values) -> Values:
    """Sum the moments of all folds but one, for each.

    Parameters
    ----------
    moments : ndarray, shape (..., n_folds, m, m)
        Of each fold.

    Returns
    -------
    ndarray, shape (..., n_folds, m, m)
        Of all others.
    """
    others: Values = moments.sum(axis=-3, keepdims=True) - moments
    return others


def choose(moments: Values, candidates: Sequence[Candidate], *, nested: bool = False) -> NDArray[np.intp]:
    """Choose the simplest candidate whose error is within one standard error of the least.

    Parameters
    ----------
    moments : ndarray, shape (..., n_folds, m, m)
        Of each fold; a fold of nothing does not count.
    candidates : sequence of Candidate
        What may be chosen.
    nested : bool
        Choose without each fold in turn, rather than once from all.

    Returns
    -------
    ndarray of int, shape (...) or, if nested, (..., n_folds)
        Place of the choice; of equally simple ones, that with the least error.

    Notes
    -----
    Each candidate is fitted without a fold and its squared error on the fold taken. The standard error is that of
    the difference from the least over folds: what makes a recording hard for all candidates cancels out (the
    rule of Breiman et al. 1984, for paired errors).
    """
    errors = np.array([_cross_validate(_take(moments, one), nested=nested) for one in candidates])
    sizes = _nest(moments[..., :1, :1])[..., 0, 0] if nested else moments[..., 0, 0]
    least = errors.sum(axis=-1).argmin(axis=0)
    excess = errors - np.take_along_axis(errors, least[None, ..., None], axis=0)
    simple = np.array([one.parameters for one in candidates]).reshape(-1, *[1] * least.ndim)
    close = excess.sum(axis=-1) <= _standard_error(excess, sizes)
    near = close & (simple == np.where(close, simple, np.inf).min(axis=0))
    chosen: NDArray[np.intp] = np.where(near, errors.sum(axis=-1), np.inf).argmin(axis=0)
    return chosen


def _nest(moments: Values) -> Values:
    """Repeat the folds once per fold, that one emptied."""
    n_folds = moments.shape[-3]
    nested: Values = moments[..., None, :, :, :] * (1 - np.eye(n_folds))[:, :, None, None]
    return nested


def _cross_validate(moments: Values, *, nested: bool) -> Values:
    """Sum the squared errors of every fold, fitted to all others."""
    folds = _nest(moments) if nested else moments
    coefficients = _fit(leave_out(folds))
    errors: Values = np.einsum("...i,...ij,...j->...", coefficients, folds, coefficients)
    return errors


def _standard_error(excess: Values, sizes: Values) -> Values:
    """Give the standard error of the sum of an excess over folds of unequal size."""
    n, total = (sizes > 0).sum(axis=-1), sizes.sum(axis=-1)
    mean = np.divide(excess.sum(axis=-1), total, out=np.zeros(excess.shape[:-1]), where=total > 0)
    left = excess - sizes * mean[..., None]
    error: Values = np.sqrt((left**2).sum(axis=-1) * n / np.maximum(n - 1, 1))
    return error
