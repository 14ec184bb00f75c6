from __future__ import annotations

import tracemalloc
from collections import Counter
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from feel321.protocols.order import measure_balance, select_share
from feel321.protocols.tasks import count_rows, williams_row
from feel321.protocols.trial import Item

letters = st.lists(st.text("ABCDE", max_size=8), min_size=1, max_size=6)


@pytest.mark.parametrize("n", range(2, 13))
def test_a_square_is_in_perfect_balance_and_no_longer_without_a_row(n: int) -> None:
    square = [[str(i) for i in row] for row in (williams_row(n, k) for k in range(count_rows(n)))]
    each = 1 + n % 2
    assert measure_balance([square]) == ((each, each), (each, each))
    assert measure_balance([square[1:]]) == ((each - 1, each), (each - 1, each))


def count_every_cell(groups: list[list[str]]) -> tuple[dict[tuple[str, int], int], ...]:
    """Count by going through every cell of every group, as long as there are few."""
    positions: dict[tuple[str, int], int] = {}
    carry_over: dict[tuple[str, str], int] = {}
    for rows in groups:
        names = sorted(set("".join(rows)))
        for name in names:
            for place in range(max(map(len, rows))):
                found = sum(row[place : place + 1] == name for row in rows)
                positions[name, place] = positions.get((name, place), 0) + found
            for other in set(names) - {name}:
                found = sum((name, other) == pair for row in rows for pair in pairwise(row))
                carry_over[name, other] = carry_over.get((name, other), 0) + found
    return positions, carry_over


@given(st.lists(letters.filter(any), min_size=1, max_size=3))
def test_ends_are_those_of_every_cell_also_of_groups_that_overlap(groups: list[list[str]]) -> None:
    found = measure_balance(groups)
    for ends, cells in zip(found, count_every_cell(groups), strict=True):
        assert ends == (min(cells.values(), default=0), max(cells.values(), default=0))


def measure_peak(n: int) -> int:
    """Memory that the balance of one participant who felt n conditions takes at most, in bytes."""
    names = [f"stimulus {number}" for number in range(n)]
    measure_balance([[names]])
    tracemalloc.start()
    measure_balance([[names]])
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
        own = {item.recording for item in share}
        assert (len(own), len(share)) == (min(count, n), 2 * min(count, n))
        felt.update(own)
        assert max(felt.values()) - min(felt.values()) <= 1
    assert select_share(items, None, number=1, seed=seed) == tuple(items)
