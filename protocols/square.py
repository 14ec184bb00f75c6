"""Williams squares: sequences of conditions in which each follows each other one equally often.

References
----------
.. [1] Williams, E. J. (1949). Experimental designs balanced for the estimation of residual effects of
   treatments. Australian Journal of Scientific Research A, 2, 149-168. doi:10.1071/CH9490149
"""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from numpy.random import Generator

    Square = tuple[tuple[int, ...], ...]

MIXABLE = 3
"""Fewest rows that go in a circle so that none begins with the condition that the one before ended with."""


def williams_square(n: int) -> Square:
    """Sequences of n conditions in which each follows each other one equally often.

    Parameters
    ----------
    n : int
        Number of conditions, at least 1.

    Returns
    -------
    tuple of tuple of int
        n sequences for even n, 2 n for odd n. Each condition stands at each place, and each ordered pair
        of conditions stands side by side, once for even n and twice for odd n.

    Raises
    ------
    ValueError
        If n is below 1.

    Notes
    -----
    The first sequence zigzags 0, 1, n-1, 2, n-2, ...; the others add 1 modulo n [1]_. With odd n, the
    zigzag alone favours one direction of each pair, so every sequence is used backwards as well.

    References
    ----------
    .. [1] Williams, E. J. (1949). doi:10.1071/CH9490149

    Examples
    --------
    >>> williams_square(4)
    ((0, 1, 3, 2), (1, 2, 0, 3), (2, 3, 1, 0), (3, 0, 2, 1))
    """
    if n < 1:
        raise ValueError(f"n: got {n}, allowed is a number of conditions of at least 1")
    zigzag = [(place + 1) // 2 if place % 2 else -place // 2 for place in range(n)]
    rows = tuple(tuple((step + shift) % n for step in zigzag) for shift in range(n))
    backwards = tuple(row[::-1] for row in rows) if n % 2 and n > 1 else ()
    return rows + backwards


def shuffle_rows(square: Square, rng: Generator) -> Square:
    """Shuffle the rows of a square so that no row ends with the condition that the next one begins with.

    Parameters
    ----------
    square : tuple of tuple of int
        A Williams square.
    rng : numpy.random.Generator
        Source of the shuffle: all orders that are allowed are equally likely.

    Returns
    -------
    tuple of tuple of int
        The same rows. The first follows the last, so that rows may be taken round and round. A square of two
        conditions has no such order; there each row may only follow itself.
    """
    while True:
        rows = tuple(square[i] for i in rng.permutation(len(square)))
        # About e**-1 of all orders pass for even and e**-2 for odd n, so a few draws do.
        if len(rows) < MIXABLE or all(this[-1] != after[0] for this, after in pairwise((*rows, rows[0]))):
            return rows
