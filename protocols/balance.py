"""Balance of a design as it was run: how evenly conditions met places, and each other.

Counts come from sequences that participants really went through, those of drop-outs included.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from itertools import chain, pairwise, permutations, product
from math import sqrt
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Mapping, Sequence


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
    positions = Counter(spot for sequence in sequences for spot in zip(sequence, places, strict=False))
    neighbours = Counter(pair for sequence in sequences for pair in pairwise(sequence))
    return _summarise(
        {spot: positions[spot] for spot in product(conditions, places)},
        {pair: neighbours[pair] for pair in permutations(conditions, 2)},
        repeats=sum(neighbours[condition, condition] for condition in conditions),
    )


def pool_balances(balances: Iterable[Balance]) -> Balance:
    """Pool the balances of several groups of conditions, such as those of each recording.

    Parameters
    ----------
    balances : iterable of Balance
        One per group. Conditions that go by the same name in several are taken for the same.

    Returns
    -------
    Balance
        Of all their counts. Conditions of different groups are not held against each other for never having met.

    Raises
    ------
    ValueError
        If there are none.
    """
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
    positions: Mapping[tuple[str, int], int], carry_over: Mapping[tuple[str, str], int], *, repeats: int
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
