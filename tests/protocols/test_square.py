from __future__ import annotations

import json
from collections import Counter
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from feel321.protocols.balance import count_rows, shuffle_rows, williams_row

if TYPE_CHECKING:
    from pathlib import Path


def williams_square(n: int) -> list[tuple[int, ...]]:
    return [williams_row(n, number) for number in range(count_rows(n))]


@pytest.mark.parametrize("n", [5, 6])
def test_square_is_the_reference_table(n: int, shared_recordings: Path) -> None:
    oracle = shared_recordings.parent / "oracles" / "williams_design" / "expected.json"
    assert [list(row) for row in williams_square(n)] == json.loads(oracle.read_text())[
        f"example_n{n}"
    ]


@pytest.mark.parametrize("n", range(2, 13))
def test_every_place_and_every_ordered_pair_comes_once_for_even_and_twice_for_odd_n(n: int) -> None:
    square, times = williams_square(n), 1 + n % 2
    assert len(square) == times * n
    places = Counter((place, condition) for row in square for place, condition in enumerate(row))
    assert set(places.values()) == {times}
    assert len(places) == n * n
    neighbours = Counter(pair for row in square for pair in pairwise(row))
    assert set(neighbours.values()) == {times}
    assert len(neighbours) == n * (n - 1)


@given(st.integers(1, 40))
def test_every_row_of_a_square_is_a_permutation(n: int) -> None:
    assert all(sorted(row) == list(range(n)) for row in williams_square(n))


def test_square_of_nothing_is_refused() -> None:
    with pytest.raises(ValueError, match="n must be a number of conditions from 1, got 0"):
        williams_square(0)


@given(st.integers(1, 24), st.integers(0, 2**32))
def test_shuffled_rows_are_the_same_rows(n: int, seed: int) -> None:
    square = williams_square(n)
    assert sorted(shuffle_rows(n, np.random.default_rng(seed))) == list(range(len(square)))


@given(st.integers(3, 24), st.integers(0, 2**32))
def test_no_shuffled_row_begins_with_what_the_one_before_ended_with_all_round(
    n: int, seed: int
) -> None:
    rows = [williams_row(n, k) for k in shuffle_rows(n, np.random.default_rng(seed))]
    assert all(this[-1] != after[0] for this, after in pairwise((*rows, rows[0])))


def test_all_orders_of_rows_that_are_allowed_come_up_about_equally_often() -> None:
    rng = np.random.default_rng(1)
    counts = Counter(tuple(shuffle_rows(4, rng)) for _ in range(4000))
    # Of the six circles of four rows, two keep to the rule; each can begin with any row.
    assert len(counts) == 8
    assert max(counts.values()) < 1.3 * min(counts.values())
