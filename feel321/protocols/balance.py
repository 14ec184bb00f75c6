"""Balance of orders: Williams squares, and how balanced the orders of several participants are.

Counts come from sequences that participants really went through, those of drop-outs included.

References
----------
.. [1] Williams, E. J. (1949). Experimental designs balanced for the estimation of residual effects of
   treatments. Australian Journal of Scientific Research A, 2, 149-168. doi:10.1071/CH9490149
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from itertools import chain, pairwise, permutations, product
from math import sqrt
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Mapping, Sequence

    from numpy.random import Generator

    Square = tuple[tuple[int, ...], ...]

# Balance of a design as it was run: how evenly conditions met places, and each other.


@dataclass(frozen=True, slots=True)
class Balance:
    """How evenly conditions met places, and each other.

    Parameters
    ----------
    positions : mapping of (str, int) to int
        How often each condition stood at each place, from 1.
    carry_over : mapping of (str, str) to int
        How often each condition was followed at once by each other one.
    repeats : int
        How often a condition followed itself.
    position_index, carry_over_index : float
        Coefficient of variation of the counts: 0 for perfect balance; about sqrt((m - 1) / k) for k random orders of
        m conditions.
    """

    positions: Mapping[tuple[str, int], int]
    carry_over: Mapping[tuple[str, str], int]
    repeats: int
    position_index: float
    carry_over_index: float


def measure_balance(sequences: Sequence[Sequence[str]]) -> Balance:
    """Measure the balance of conditions over sequences.

    Parameters
    ----------
    sequences : sequence of sequence of str
        The conditions of each participant, in the order in which they were run. Sequences that broke off are shorter.

    Returns
    -------
    Balance
        Counts over all conditions and places that occur; places run to the end of the longest sequence.

    Raises
    ------
    ValueError
        If no condition was run.

    Examples
    --------
    >>> balance = measure_balance(["ABDC", "BCAD", "CDBA", "DACB"])
    >>> balance.position_index, balance.carry_over_index
    (0.0, 0.0)
    >>> measure_balance(["ABCD", "ABDC"]).carry_over["A", "B"]
    2
    """
    conditions = sorted(set(chain.from_iterable(sequences)))
    if not conditions:
        raise ValueError("sequences: got no condition, balance needs at least one that was run")
    places = range(1, max(map(len, sequences)) + 1)
    positions = Counter(
        spot for sequence in sequences for spot in zip(sequence, places, strict=False)
    )
    neighbours = Counter(pair for sequence in sequences for pair in pairwise(sequence))
    return _summarise(
        {spot: positions[spot] for spot in product(conditions, places)},
        {pair: neighbours[pair] for pair in permutations(conditions, 2)},
        repeats=sum(neighbours[condition, condition] for condition in conditions),
    )


def pool_balances(balances: Iterable[Balance]) -> Balance:
    """Pool the balances of several groups of conditions, such as those of each recording."""
    positions: Counter[tuple[str, int]] = Counter()
    carry_over: Counter[tuple[str, str]] = Counter()
    repeats = 0
    for balance in balances:
        positions.update(balance.positions)
        carry_over.update(balance.carry_over)
        repeats += balance.repeats
    if not positions:
        raise ValueError("balances: got none, a pool needs at least one")
    return _summarise(positions, carry_over, repeats=repeats)


def _summarise(
    positions: Mapping[tuple[str, int], int],
    carry_over: Mapping[tuple[str, str], int],
    *,
    repeats: int,
) -> Balance:
    return Balance(
        positions=dict(positions),
        carry_over=dict(carry_over),
        repeats=repeats,
        position_index=_measure_variation(positions.values()),
        carry_over_index=_measure_variation(carry_over.values()),
    )


def _measure_variation(counts: Collection[int]) -> float:
    """Coefficient of variation, 0 where nothing was counted."""
    if not (total := sum(counts)):
        return 0.0
    mean = total / len(counts)
    return sqrt(sum((count - mean) ** 2 for count in counts) / len(counts)) / mean


# Williams squares: sequences of conditions in which each follows each other one equally often.

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
    """Shuffle the rows of a square so that no row ends with the condition that the next one begins with."""
    while True:
        rows = tuple(square[i] for i in rng.permutation(len(square)))
        # About e**-1 of all orders pass for even and e**-2 for odd n, so a few draws do.
        if len(rows) < MIXABLE or all(
            this[-1] != after[0] for this, after in pairwise((*rows, rows[0]))
        ):
            return rows
