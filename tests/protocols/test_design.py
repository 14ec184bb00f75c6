from __future__ import annotations

import json
from collections import Counter
from itertools import combinations, pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from protocols.design import count_cycle, make_order, williams_square
from protocols.registry import PROTOCOLS
from protocols.trial import Item

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence
    from pathlib import Path

    from protocols.trial import Protocol, Trial

BOTH = tuple(PROTOCOLS.values())
REALISM = (PROTOCOLS["realism"],)


def order(
    items: list[Item],
    number: int = 1,
    repeats: int = 1,
    *,
    protocols: tuple[Protocol, ...] = BOTH,
    seed: int = 1,
) -> tuple[Trial, ...]:
    return make_order(items, protocols, number=number, repeats=repeats, rng=np.random.default_rng(seed))


def count_neighbours(rows: Iterable[Sequence[Any]]) -> Counter[tuple[Any, Any]]:
    return Counter(pair for row in rows for pair in pairwise(row))


@pytest.mark.parametrize("n", [5, 6])
def test_square_is_the_reference_table(n: int, shared_recordings: Path) -> None:
    oracle = shared_recordings.parent / "oracles" / "williams_design" / "expected.json"
    assert [list(row) for row in williams_square(n)] == json.loads(oracle.read_text())[f"example_n{n}"]


@pytest.mark.parametrize("n", range(2, 13))
def test_every_place_and_every_ordered_pair_comes_once_for_even_and_twice_for_odd_n(n: int) -> None:
    square, times = williams_square(n), 1 + n % 2
    assert len(square) == times * n
    places = Counter((place, condition) for row in square for place, condition in enumerate(row))
    assert set(places.values()) == {times}
    assert len(places) == n * n
    neighbours = count_neighbours(square)
    assert set(neighbours.values()) == {times}
    assert len(neighbours) == n * (n - 1)


@given(st.integers(1, 40))
def test_every_row_of_a_square_is_a_permutation(n: int) -> None:
    assert all(sorted(row) == list(range(n)) for row in williams_square(n))


def test_square_of_nothing_is_refused() -> None:
    with pytest.raises(ValueError, match="n: got 0, allowed is a number of conditions of at least 1"):
        williams_square(0)


def test_everything_is_judged_once_per_repeat_and_protocol(items: list[Item]) -> None:
    trials = order(items, repeats=3)
    counts = Counter((t.protocol, t.repeat, t.stimulus_id) for t in trials)
    assert set(counts.values()) == {1}
    assert len(counts) == 2 * 3 * len(items)
    assert [t.number for t in trials] == list(range(1, len(trials) + 1))


def test_a_block_is_one_recording_of_one_protocol_and_repeat(items: list[Item]) -> None:
    recording = {item.stimulus_id: item.recording for item in items}
    trials = order(items, repeats=2)
    blocks: dict[int, set[tuple[str, int, str]]] = {}
    for t in trials:
        blocks.setdefault(t.block, set()).add((t.protocol, t.repeat, recording[t.stimulus_id]))
    assert list(blocks) == list(range(1, 2 * 2 * 3 + 1))
    assert all(len(block) == 1 for block in blocks.values())
    assert [t.protocol for t in trials] == ["realism"] * 36 + ["similarity"] * 36


def test_a_full_cycle_of_participants_balances_place_and_carry_over_in_every_recording(items: list[Item]) -> None:
    orders = [order(items, number, protocols=REALISM) for number in range(1, 7)]
    for recording in ("bumps", "drag", "taps"):
        rows = [[t.stimulus_id for t in trials if t.stimulus_id.startswith(recording)] for trials in orders]
        neighbours = count_neighbours(rows)
        assert set(neighbours.values()) == {1}
        assert len(neighbours) == 6 * 5
        assert all(len({row[place] for row in rows}) == 6 for place in range(6))


def test_a_full_cycle_of_participants_balances_the_recordings(items: list[Item]) -> None:
    recording = {item.stimulus_id: item.recording for item in items}
    rows = [
        list(dict.fromkeys(recording[t.stimulus_id] for t in order(items, number, protocols=REALISM)))
        for number in range(1, 7)
    ]
    assert set(count_neighbours(rows).values()) == {2}


def list_blocks(items: list[Item], trials: Iterable[Trial]) -> dict[tuple[str, int, str], list[str]]:
    """Order of the stimuli, by what made them, per protocol, repeat and recording."""
    recording = {item.stimulus_id: item.recording for item in items}
    blocks: dict[tuple[str, int, str], list[str]] = {}
    for t in trials:
        name = recording[t.stimulus_id]
        blocks.setdefault((t.protocol, t.repeat, name), []).append(t.stimulus_id.removeprefix(f"{name}-"))
    return blocks


@pytest.mark.parametrize(("n_recordings", "n_stimuli", "cycle"), [(3, 4, 12), (2, 6, 6), (1, 5, 10), (1, 1, 1)])
def test_a_cycle_is_the_smallest_number_that_completes_every_square(
    n_recordings: int, n_stimuli: int, cycle: int
) -> None:
    items = [Item(f"{r}-{s}", str(r), "as_is", "test") for r in range(n_recordings) for s in range(n_stimuli)]
    assert count_cycle(order(items, repeats=2, protocols=REALISM)) == cycle


@pytest.mark.parametrize("number", range(1, 7))
def test_no_two_recordings_protocols_or_repeats_of_one_participant_share_an_order(
    items: list[Item], number: int
) -> None:
    blocks = list_blocks(items, order(items, number, repeats=2))
    for this, that in combinations(blocks, 2):
        if sum(a != b for a, b in zip(this, that, strict=True)) == 1:
            assert blocks[this] != blocks[that], (this, that)


@pytest.mark.parametrize("seed", range(4))
def test_no_recording_twice_in_a_row_across_rounds(items: list[Item], seed: int) -> None:
    for number in range(1, 7):
        blocks = list_blocks(items, order(items, number, repeats=3, seed=seed))
        assert all(a[2] != b[2] for a, b in pairwise(blocks))


@given(st.integers(1, 30), st.integers(1, 4), st.integers(1, 3), st.integers(2, 5), st.integers(0, 9))
def test_no_stimulus_twice_in_a_row_across_any_border(
    number: int, repeats: int, n_recordings: int, n_stimuli: int, seed: int
) -> None:
    items = [Item(f"{r}-{s}", str(r), "as_is", "test") for r in range(n_recordings) for s in range(n_stimuli)]
    trials = order(items, number, repeats, protocols=REALISM, seed=seed)
    assert all(a.stimulus_id != b.stimulus_id for a, b in pairwise(trials))


def test_a_lone_stimulus_may_follow_itself() -> None:
    trials = order([Item("tap", "tap", "as_is", "test")], repeats=2, protocols=REALISM)
    assert [t.stimulus_id for t in trials] == ["tap", "tap"]


def test_order_depends_on_seed_and_participant_and_on_nothing_else(items: list[Item]) -> None:
    assert order(items, 3) == order(items, 3)
    assert order(items, 3) != order(items, 4)
    assert len({order(items, 3, seed=seed) for seed in range(5)}) == 5


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"number": 0}, "number: got 0, allowed is a whole number of at least 1"),
        ({"repeats": 0}, "repeats: got 0, allowed"),
        ({"protocols": ()}, "protocols: got none"),
    ],
)
def test_orders_of_nothing_are_refused(items: list[Item], changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        order(items, **changes)


def test_no_items_are_refused() -> None:
    with pytest.raises(ValueError, match="items: got none, an order needs at least one"):
        order([])
