from __future__ import annotations

import tracemalloc
from collections import Counter
from itertools import pairwise
from math import sqrt
from typing import TYPE_CHECKING

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from feel321.protocols.order import measure_balance, pool_balances, select_share
from feel321.protocols.trial import Item

if TYPE_CHECKING:
    from feel321.protocols.order import Counts

N_RECORDINGS, N_STIMULI, CYCLE = 8, 12, 24

letters = st.lists(st.text("ABCDE", max_size=8), min_size=1, max_size=6)


def expand(counts: Counts) -> dict[tuple[str, object], int]:
    """Every pair that could meet, with its count."""
    pairs = [(one, met) for one, others in counts.possible.items() for met in others if met != one]
    return {pair: counts.seen[pair] for pair in pairs}


def test_counts_by_hand() -> None:
    balance = measure_balance(["ABC", "BA", "AAC"])
    rows = {"A": (2, 2, 0), "B": (1, 1, 0), "C": (0, 0, 2)}
    assert expand(balance.positions) == {
        (name, place): count for name, row in rows.items() for place, count in enumerate(row, 1)
    }
    pairs = {"AB": 1, "AC": 1, "BA": 1, "BC": 1, "CA": 0, "CB": 0}
    assert expand(balance.carry_over) == {tuple(pair): count for pair, count in pairs.items()}
    assert balance.repeats == 1
    # Positions: mean 8/9, squares sum to 14, so the variance is 14/9 - 64/81.
    assert balance.positions.measure_variation() == pytest.approx(sqrt(14 / 9 - 64 / 81) / (8 / 9))
    assert balance.carry_over.measure_variation() == pytest.approx(sqrt(4 / 6 - 16 / 36) / (4 / 6))


def test_pooled_groups_add_up_and_are_not_held_against_each_other() -> None:
    pooled = pool_balances([measure_balance(["AB", "BA"]), measure_balance(["CD", "DC", "CC"])])
    assert ("A", "C") not in expand(pooled.carry_over)
    assert (pooled.positions.seen["A", 1], pooled.positions.seen["C", 1]) == (1, 2)
    assert pooled.repeats == 1
    again = pool_balances([measure_balance(["AB"]), measure_balance(["BA"])])
    assert expand(again.positions) == expand(measure_balance(["AB", "BA"]).positions)


def test_nothing_run_is_refused() -> None:
    with pytest.raises(ValueError, match="sequences must hold at least one condition that was run"):
        measure_balance([[], []])


def count_every_cell(groups: list[list[str]]) -> tuple[dict[tuple[str, int], int], ...]:
    """Count by going through every cell of every group, as long as there are few."""
    positions: dict[tuple[str, int], int] = {}
    carry_over: dict[tuple[str, str], int] = {}
    for rows in groups:
        names = sorted(set("".join(rows)))
        for name in names:
            for place in range(max(map(len, rows))):
                found = sum(row[place : place + 1] == name for row in rows)
                positions[name, place + 1] = positions.get((name, place + 1), 0) + found
            for other in set(names) - {name}:
                found = sum((name, other) == pair for row in rows for pair in pairwise(row))
                carry_over[name, other] = carry_over.get((name, other), 0) + found
    return positions, carry_over


def vary(counts: dict[tuple[str, int], int]) -> float:
    values = np.array(list(counts.values()), float)
    return float(values.std() / values.mean()) if values.any() else 0.0


@given(st.lists(letters.filter(any), min_size=1, max_size=3))
def test_counts_are_those_of_every_cell_also_of_groups_that_overlap(
    groups: list[list[str]],
) -> None:
    pooled = pool_balances(map(measure_balance, groups))
    for counts, cells in zip(
        (pooled.positions, pooled.carry_over), count_every_cell(groups), strict=True
    ):
        assert expand(counts) == cells
        assert counts.find_ends() == (
            min(cells.values(), default=0),
            max(cells.values(), default=0),
        )
        assert counts.measure_variation() == pytest.approx(vary(cells), rel=1e-12)


def measure_peak(n: int) -> int:
    """Memory that the balance of one participant who felt n conditions takes at most, in bytes."""
    names = [f"stimulus {number}" for number in range(n)]
    measure_balance([names])
    tracemalloc.start()
    balance = measure_balance([names])
    balance.carry_over.find_ends()
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return peak


def test_memory_grows_with_the_conditions_not_with_their_pairs() -> None:
    assert measure_peak(800) < 6 * measure_peak(200)


@given(st.integers(1, 12), st.integers(1, 12), st.integers(0, 99))
def test_shares_hold_every_recording_equally_often(n: int, count: int, seed: int) -> None:
    items = [Item(f"{r}-{s}", str(r), str(s), "as_is", "test") for r in range(n) for s in range(2)]
    felt = Counter(dict.fromkeys(map(str, range(n)), 0))
    for number in range(1, 8):
        share = select_share(items, count, number=number, seed=seed)
        assert share == select_share(items, count, number=number, seed=seed)
        own = {item.recording for item in share}
        assert (len(own), len(share)) == (min(count, n), 2 * min(count, n))
        felt.update(own)
        assert max(felt.values()) - min(felt.values()) <= 1
    assert select_share(items, None, number=1, seed=seed) == tuple(items)
