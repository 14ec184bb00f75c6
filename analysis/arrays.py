"""Arrays of numbers, from whatever was given: the one place that says which cell is none."""

from __future__ import annotations

from collections.abc import Sized
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray


def read_numbers(given: ArrayLike, *, what: str) -> NDArray[np.float64]:
    """Read numbers.

    Parameters
    ----------
    given : array_like
        Numbers in a list, an array, or a pandas table or column; None and pandas' NA are missing.
    what : str
        What the argument is called, for the message.

    Returns
    -------
    ndarray
        The same, NaN where missing.

    Raises
    ------
    ValueError
        If a cell is no number, or rows are of different lengths; names one.

    Examples
    --------
    >>> read_numbers([[1, 2], [None, 4]], what="table").tolist()
    [[1.0, 2.0], [nan, 4.0]]
    """
    from pandas import isna

    try:
        return np.asarray(given, dtype=np.float64)
    except (TypeError, ValueError):
        cells = np.asarray(given, dtype=object)
    try:
        return np.where(isna(cells), np.nan, cells).astype(np.float64)
    except (TypeError, ValueError) as error:
        odd = next(cell for cell in cells.ravel().tolist() if not _is_number(cell))
        got = "rows of different lengths" if isinstance(odd, Sized) and not isinstance(odd, str) else repr(odd)
        raise ValueError(f"{what}: got {got}, allowed are numbers; leave names out, as of rows or columns") from error


def read_groups(given: ArrayLike, *, n: int, what: str) -> tuple[NDArray[np.intp], list[object]]:
    """Read what each target or item belongs to.

    Parameters
    ----------
    given : array_like, shape (n,)
        Names: words or numbers.
    n : int
        How many there must be.
    what : str
        What they are one of, such as ``item``, for the message.

    Returns
    -------
    number : ndarray of int, shape (n,)
        Number of each one's group.
    names : list
        Names of the groups, by alphabet.

    Raises
    ------
    ValueError
        If there are more or fewer, or one has no group.

    Examples
    --------
    >>> number, names = read_groups(["tap", "drag", "tap"], n=3, what="item")
    >>> number.tolist(), names
    ([1, 0, 1], ['drag', 'tap'])
    """
    from pandas import factorize

    names = np.asarray(given)
    if names.shape != (n,):
        raise ValueError(f"groups: got shape {names.shape} for {n} {what}s, allowed is one group per {what}")
    number, distinct = factorize(names, sort=True)
    if (number < 0).any():
        raise ValueError(f"groups: got {int((number < 0).sum())} {what}s without a group; name it or leave them out")
    return number, distinct.tolist()


def _is_number(cell: object) -> bool:
    from pandas import isna

    if isna(cell) is True:  # type: ignore[call-overload]
        return True
    try:
        float(cell)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        return False
    return True
