"""Balance of orders: Williams squares, and how balanced the orders of several participants are.

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

from feel321.doors import describe
from feel321.protocols.trial import Trial
from feel321.records import Result

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Mapping, Sequence

    from numpy.random import Generator
    from pandas import DataFrame

    Square = tuple[tuple[int, ...], ...]


@dataclass(frozen=True, slots=True, repr=False, eq=False)
class Balance(Result):
    """Balance of a design: how evenly conditions met positions, and each other.

    Parameters
    ----------
    positions : mapping of (str, int) to int
        Number of times that each condition was at each position, from 1.
    carry_over : mapping of (str, str) to int
        Number of times that each condition was followed at once by each other one.
    repeats : int
        Number of times that a condition followed itself.
    position_index, carry_over_index : float
        Coefficient of variation of the counts: 0 for perfect balance; about sqrt((m - 1) / k) for k random orders of
        m conditions.

    Examples
    --------
    >>> from feel321 import protocols
    >>> protocols.measure_balance(["AB", "BA"])
    Balance(repeats=0, position_index=0, carry_over_index=0)
    """

    positions: Mapping[tuple[str, int], int]
    carry_over: Mapping[tuple[str, str], int]
    repeats: int
    position_index: float
    carry_over_index: float

    def to_frame(self) -> DataFrame:
        """Return the counts of positions as a table.

        Returns
        -------
        DataFrame
            One row per condition, one column per position.
        """
        import pandas as pd

        rows = [(*spot, count) for spot, count in self.positions.items()]
        table = pd.DataFrame(rows, columns=["condition", "position", "count"])
        return table.pivot_table("count", "condition", "position", aggfunc="sum")


def measure_balance(sequences: Sequence[Sequence[str | Trial]]) -> Balance:
    """Measure the balance of conditions over sequences.

    Parameters
    ----------
    sequences : sequence of sequences of str or Trial
        The conditions of each participant, in the order in which they were run; the condition of a trial is the
        stimulus that it judges first. Sequences that broke off are shorter.

    Returns
    -------
    Balance
        Counts over all conditions and positions that occur; positions run to the end of the longest sequence.

    Raises
    ------
    ValueError
        If no condition was run.

    Examples
    --------
    >>> from feel321 import protocols
    >>> balance = protocols.measure_balance(["ABDC", "BCAD", "CDBA", "DACB"])
    >>> balance.position_index, balance.carry_over_index
    (0.0, 0.0)
    >>> protocols.measure_balance(["ABCD", "ABDC"]).carry_over["A", "B"]
    2
    """
    if isinstance(sequences, str) or any(isinstance(entry, Trial) for entry in sequences):
        raise TypeError(
            f"sequences must be one sequence per participant, got {describe(sequences)}; write [sequence]"
        )
    named = [[_name_condition(entry) for entry in sequence] for sequence in sequences]
    conditions = sorted(set(chain.from_iterable(named)))
    if not conditions:
        raise ValueError("sequences must hold at least one condition that was run, got none")
    places = range(1, max(map(len, named)) + 1)
    positions = Counter(spot for names in named for spot in zip(names, places, strict=False))
    neighbours = Counter(pair for names in named for pair in pairwise(names))
    return _summarise(
        {spot: positions[spot] for spot in product(conditions, places)},
        {pair: neighbours[pair] for pair in permutations(conditions, 2)},
        repeats=sum(neighbours[condition, condition] for condition in conditions),
    )


def _name_condition(entry: str | Trial) -> str:
    return entry if isinstance(entry, str) else entry.judgements[0].stimulus_id


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
        raise ValueError("balances must be at least one, got none")
    return _summarise(dict(positions), dict(carry_over), repeats=repeats)


def _summarise(
    positions: dict[tuple[str, int], int], carry_over: dict[tuple[str, str], int], *, repeats: int
) -> Balance:
    indices = (_measure_variation(counts.values()) for counts in (positions, carry_over))
    return Balance(positions, carry_over, repeats, *indices)


def _measure_variation(counts: Collection[int]) -> float:
    """Coefficient of variation, 0 where nothing was counted."""
    if not (total := sum(counts)):
        return 0.0
    mean = total / len(counts)
    return sqrt(sum((count - mean) ** 2 for count in counts) / len(counts)) / mean


MIXABLE = 3
"""Fewest rows that go in a circle so that none begins with the condition that the one before ended with."""


def williams_square(n: int) -> Square:
    """Make sequences of n conditions in which each follows each other one equally often.

    n sequences for even n, 2 n for odd n. Each condition is at each position, and each ordered pair of conditions
    is adjacent, once for even n and twice for odd n.

    The first sequence zigzags 0, 1, n-1, 2, n-2, ...; the others add 1 modulo n (Williams 1949). With odd n, the
    zigzag alone favours one direction of each pair, so every sequence is used backwards as well.

    Examples
    --------
    >>> williams_square(4)
    ((0, 1, 3, 2), (1, 2, 0, 3), (2, 3, 1, 0), (3, 0, 2, 1))
    """
    if n < 1:
        raise ValueError(f"n must be a number of conditions from 1, got {n}")
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
