"""Balance of orders: Williams squares, and how balanced the orders of several participants are.

References
----------
.. [1] Williams, E. J. (1949). Experimental designs balanced for the estimation of residual effects of
   treatments. Australian Journal of Scientific Research A, 2, 149-168. doi:10.1071/CH9490149
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain, pairwise
from math import sqrt
from typing import TYPE_CHECKING, Any

from feel321.doors import describe
from feel321.protocols.trial import Trial
from feel321.records import Result

if TYPE_CHECKING:
    from numpy.random import Generator
    from pandas import DataFrame


class Counts(Mapping[tuple[str, Any], int]):
    """How often conditions met places, or each other; what never met counts 0 and takes no memory."""

    def __init__(
        self, seen: Mapping[tuple[str, Any], int], possible: Mapping[str, Collection[Any]]
    ) -> None:
        """Take the counts above 0, and what each condition may meet besides itself."""
        self.seen, self.possible = seen, possible
        self._size = sum(len(others) - (one in others) for one, others in possible.items())

    def __getitem__(self, cell: tuple[str, Any]) -> int:
        """Return a count."""
        condition, other = cell
        if condition == other or other not in self.possible.get(condition, ()):
            raise KeyError(cell)
        return self.seen.get(cell, 0)

    def __iter__(self) -> Iterator[tuple[str, Any]]:
        """Iterate over all that could meet."""
        return ((one, met) for one, others in self.possible.items() for met in others if met != one)

    def __len__(self) -> int:
        """Count what could meet."""
        return self._size

    def __repr__(self) -> str:
        """Say how much of what could meet has met."""
        return f"<{len(self.seen)} of {len(self)} met>"

    def find_ends(self) -> tuple[int, int]:
        """Find the lowest and the highest count; 0 where nothing could meet."""
        lowest = min(self.seen.values(), default=0) if len(self.seen) == len(self) else 0
        return lowest, max(self.seen.values(), default=0)

    def measure_variation(self) -> float:
        """Coefficient of variation, 0 where nothing was counted."""
        if not (total := sum(self.seen.values())):
            return 0.0
        mean, missing = total / len(self), len(self) - len(self.seen)
        squares = sum((count - mean) ** 2 for count in self.seen.values()) + missing * mean**2
        return sqrt(squares / len(self)) / mean


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

    positions: Counts
    carry_over: Counts
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
    named = [
        [entry if isinstance(entry, str) else entry.judgements[0].stimulus_id for entry in sequence]
        for sequence in sequences
    ]
    conditions = sorted(set(chain.from_iterable(named)))
    if not conditions:
        raise ValueError("sequences must hold at least one condition that was run, got none")
    places = range(1, max(map(len, named)) + 1)
    positions = Counter(spot for names in named for spot in zip(names, places, strict=False))
    neighbours = Counter(pair for names in named for pair in pairwise(names))
    repeats = sum(neighbours.pop((condition, condition), 0) for condition in conditions)
    carry_over = Counts(neighbours, dict.fromkeys(conditions, dict.fromkeys(conditions)))
    return _summarise(Counts(positions, dict.fromkeys(conditions, places)), carry_over, repeats)


def pool_balances(balances: Iterable[Balance]) -> Balance:
    """Pool the balances of several groups of conditions, such as those of each recording."""
    pooled = tuple(balances)
    if not pooled:
        raise ValueError("balances must be at least one, got none")
    positions = _pool([one.positions for one in pooled])
    carry_over = _pool([one.carry_over for one in pooled])
    return _summarise(positions, carry_over, sum(one.repeats for one in pooled))


def _pool(several: Sequence[Counts]) -> Counts:
    seen: Counter[tuple[str, Any]] = Counter()
    possible: dict[str, Collection[Any]] = {}
    for counts in several:
        seen.update(counts.seen)
        for one, others in counts.possible.items():
            known = possible.get(one)
            possible[one] = others if known is None else dict.fromkeys(chain(known, others))
    return Counts(seen, possible)


def _summarise(positions: Counts, carry_over: Counts, repeats: int) -> Balance:
    indices = (counts.measure_variation() for counts in (positions, carry_over))
    return Balance(positions, carry_over, repeats, *indices)


MIXABLE = 3
"""Fewest rows that go in a circle so that none begins with the condition that the one before ended with."""


def count_rows(n: int) -> int:
    """Count the sequences of a Williams square of n conditions: n for even n, 2 n for odd n."""
    if n < 1:
        raise ValueError(f"n must be a number of conditions from 1, got {n}")
    return 2 * n if n % 2 and n > 1 else n


def williams_row(n: int, number: int) -> tuple[int, ...]:
    """Make one sequence of a Williams square of n conditions [1]_; number: from 0 to `count_rows(n) - 1`.

    In all sequences together each condition is at each position, and each ordered pair of conditions is adjacent,
    once for even n and twice for odd n. The first sequence zigzags 0, 1, n-1, 2, n-2, ...; the others add 1 modulo n.
    With odd n, the zigzag alone favours one direction of each pair, so every sequence is used backwards as well.

    Examples
    --------
    >>> [williams_row(4, number) for number in range(count_rows(4))]
    [(0, 1, 3, 2), (1, 2, 0, 3), (2, 3, 1, 0), (3, 0, 2, 1)]
    """
    shift = number % n
    zigzag = ((place + 1) // 2 if place % 2 else -place // 2 for place in range(n))
    row = tuple((step + shift) % n for step in zigzag)
    return row[::-1] if number >= n else row


def shuffle_rows(n: int, rng: Generator) -> list[int]:
    """Shuffle the numbers of a square's rows so that no row ends with the condition that the next one begins with."""
    middle = williams_row(n, 0)[-1]
    ends = [(shift, (middle + shift) % n) for shift in range(n)]
    ends += [end[::-1] for end in ends] if count_rows(n) > n else []
    while True:
        order: list[int] = rng.permutation(len(ends)).tolist()
        # About e**-1 of all orders pass for even and e**-2 for odd n, so a few draws do.
        if len(order) < MIXABLE or all(
            ends[this][1] != ends[after][0] for this, after in pairwise((*order, order[0]))
        ):
            return order
