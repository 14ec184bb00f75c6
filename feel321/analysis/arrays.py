"""Arrays of numbers, from whatever was given: the one place that says which cell is none."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray


def read_numbers(given: ArrayLike, *, what: str) -> NDArray[np.float64]:
    """Read numbers.

    Returns the same, NaN where missing.

    Examples
    --------
    >>> read_numbers([[1, 2], [None, 4]], what="table").tolist()
    [[1.0, 2.0], [nan, 4.0]]
    """
    try:
        return np.asarray(given, dtype=np.float64)
    except (TypeError, ValueError) as error:
        no_numbers = error
    try:
        return _to_numbers(np.asarray(given, dtype=object))
    except (TypeError, ValueError):
        raise ValueError(
            f"{what}: got {_find_odd(given)}, allowed are numbers; leave names out, as of rows or columns"
        ) from no_numbers


def check_labels(first: ArrayLike, second: ArrayLike, *, what: str) -> None:
    """Refuse two pandas tables or columns whose labels are the same ones in another order: rows go together by place.

    Examples
    --------
    >>> check_labels([1, 2], [3, 4], what="metric")
    """
    from pandas import DataFrame, Series

    if not (isinstance(first, DataFrame | Series) and isinstance(second, DataFrame | Series)):
        return
    one, other = first.index, second.index
    if one.is_unique and other.is_unique and not one.equals(other) and set(one) == set(other):
        raise ValueError(
            f"{what}: got the same labels in another order; bring both into one, as with reindex"
        )


def read_groups(given: ArrayLike, *, n: int, what: str) -> tuple[NDArray[np.intp], list[object]]:
    """Read what each target or item belongs to.

    given: (n,); returns number: (n,).

    Examples
    --------
    >>> number, names = read_groups(["tap", "drag", "tap"], n=3, what="item")
    >>> number.tolist(), names
    ([1, 0, 1], ['drag', 'tap'])
    """
    from pandas import factorize

    names = np.asarray(given)
    if names.shape != (n,):
        raise ValueError(
            f"groups: got shape {names.shape} for {n} {what}s, allowed is one group per {what}"
        )
    number, distinct = factorize(names, sort=True)
    if (number < 0).any():
        raise ValueError(
            f"groups: got {int((number < 0).sum())} {what}s without a group; name it or leave them out"
        )
    return number, distinct.tolist()


def _find_odd(given: ArrayLike) -> str:
    """Name what is no number."""
    uneven = "rows of different lengths"
    try:
        cells = np.asarray(given, dtype=object).ravel().tolist()
    except ValueError:
        return uneven
    odd: object = next((cell for cell in cells if not _is_number(cell)), [])
    return uneven if isinstance(odd, list | tuple | np.ndarray) else repr(odd)


def _is_number(cell: object) -> bool:
    one = np.empty(1, dtype=object)
    one[0] = cell
    try:
        _to_numbers(one)
    except (TypeError, ValueError):
        return False
    return True


def _to_numbers(cells: NDArray[np.object_]) -> NDArray[np.float64]:
    from pandas import isna

    return np.where(isna(cells), np.nan, cells).astype(np.float64)
