"""Which methods are worth having: those that no other one beats in every respect."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray


def find_front(costs: ArrayLike) -> NDArray[np.bool_]:
    """Find the points that no other point dominates.

    Parameters
    ----------
    costs : array_like, shape (n_points, n_objectives)
        Smaller is better in every column; infinite is the worst.

    Returns
    -------
    ndarray of bool, shape (n_points,)
        True where no other point is at most as costly in every column and less in one; of equal points all count.

    Raises
    ------
    ValueError
        If a cost is not a number: such a point cannot be compared.

    Examples
    --------
    >>> find_front([[1, 3], [2, 2], [2, 3], [3, 1]]).tolist()
    [True, True, False, True]
    """
    return np.asarray(~dominates(costs).any(axis=0))


def dominates(costs: ArrayLike) -> NDArray[np.bool_]:
    """Tell which point dominates which.

    Parameters
    ----------
    costs : array_like, shape (n_points, n_objectives)
        Smaller is better in every column.

    Returns
    -------
    ndarray of bool, shape (n_points, n_points)
        True where the row's point dominates the column's.

    Raises
    ------
    ValueError
        If a cost is not a number.
    """
    table = np.asarray(costs, dtype=np.float64)
    if np.isnan(table).any():
        raise ValueError("costs: got NaN, allowed are numbers; a point without a value cannot be compared")
    no_worse = (table[:, None, :] <= table[None, :, :]).all(axis=-1)
    better = (table[:, None, :] < table[None, :, :]).any(axis=-1)
    return np.asarray(no_worse & better)
