from __future__ import annotations

import json
from collections import Counter, defaultdict
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from feel321.protocols.order import ORDERS, find_crowding, make_order, shuffle_rows
from feel321.protocols.tasks import PROTOCOLS, count_rows, find_other, make_task, williams_row
from feel321.protocols.trial import Item

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence
    from pathlib import Path

    from feel321.protocols.trial import Trial

REALISM = ("realism",)
BOTH = ("realism", "similarity")

numbers, seeds, repeat_counts = st.integers(1, 60), st.integers(0, 2**32), st.integers(1, 3)
orders = st.sampled_from(list(ORDERS))


def order(
    items: Sequence[Item],
    number: int = 1,
    repeats: int = 1,
    *,
    tasks: Iterable[str] = REALISM,
    **more: Any,
) -> tuple[Trial, ...]:
    rng = np.random.default_rng(more.pop("seed", 1))
    return make_order(
        items, [make_task(name) for name in tasks], number=number, repeats=repeats, rng=rng, **more
    )


def list_items(n_recordings: int, n_stimuli: int) -> list[Item]:
    """Original first; the rest are reducers."""
    return [
        Item(f"{r}-{s}", str(r), str(s), "as_is", "test" if s else "reference")
        for r in range(n_recordings)
        for s in range(n_stimuli)
    ]


def name_comparison(trial: Trial) -> tuple[str, str, tuple[str, ...]]:
    """What is compared, whatever its arrangement."""
    about = {name for j in trial.judgements for name in (j.stimulus_id, j.reference_id) if name}
    about |= {str(find_other(trial, trial.judgements[0]))} - {"None"}
    return trial.protocol, trial.recording, tuple(sorted(about))


def get_stimulus(trial: Trial) -> str:
    (judgement,) = trial.judgements
    return judgement.stimulus_id


def list_blocks(trials: Iterable[Trial]) -> dict[tuple[str, int, str], list[str]]:
    """Order of the reducers, per protocol, repeat and recording."""
    blocks: dict[tuple[str, int, str], list[str]] = defaultdict(list)
    for t in trials:
        blocks[t.protocol, t.repeat, t.recording].append(
            get_stimulus(t).removeprefix(f"{t.recording}-")
        )
    return blocks


def count_neighbours(rows: Iterable[Sequence[str]]) -> Counter[tuple[str, str]]:
    return Counter(pair for row in rows for pair in pairwise(row))


@given(orders, numbers, repeat_counts, st.integers(1, 4), st.integers(3, 5), seeds)
def test_every_order_is_a_permutation_of_what_is_to_be_judged(
    name: str, number: int, repeats: int, n_recordings: int, n_stimuli: int, seed: int
) -> None:
    items = list_items(n_recordings, n_stimuli)
    trials = order(items, number, repeats, tasks=PROTOCOLS, order=name, seed=seed)
    assert [t.number for t in trials] == list(range(1, len(trials) + 1))
    assert [t.protocol for t in trials] == sorted(
        (t.protocol for t in trials), key=list(PROTOCOLS).index
    )
    counts = Counter((name_comparison(t), t.repeat) for t in trials)
    pairs = n_stimuli * (n_stimuli - 1) // 2
    per_recording = 2 * n_stimuli + pairs + 1 + 1 + n_stimuli - 1
    per_recording += pairs - (n_stimuli - 1) + pairs  # triplets leave the original out
    assert set(counts.values()) == {1}
    assert len(counts) == repeats * n_recordings * per_recording
    assert {repeat for _, repeat in counts} == set(range(1, repeats + 1))
    assert {t.phase for t in trials} == {"main"}


@given(orders, numbers, st.integers(1, 4), st.integers(2, 4), st.integers(2, 5), seeds)
def test_no_recording_follows_itself_across_blocks_and_rounds(
    name: str, number: int, repeats: int, n_recordings: int, n_stimuli: int, seed: int
) -> None:
    trials = order(list_items(n_recordings, n_stimuli), number, repeats, order=name, seed=seed)
    assert all(a.recording != b.recording for a, b in pairwise(trials) if a.block != b.block)


@pytest.mark.parametrize("repeat", [1, 2, 3])
@pytest.mark.parametrize("seed", range(4))
def test_a_full_cycle_balances_place_and_carry_over_in_every_recording_and_round(
    items: list[Item], repeat: int, seed: int
) -> None:
    sessions = [list_blocks(order(items, number, 3, seed=seed)) for number in range(1, 7)]
    for recording in ("bumps", "drag", "taps"):
        rows = [blocks["realism", repeat, recording] for blocks in sessions]
        neighbours = count_neighbours(rows)
        assert set(neighbours.values()) == {1}
        assert len(neighbours) == 6 * 5
        assert all(len({row[place] for row in rows}) == 6 for place in range(6))


@pytest.mark.parametrize("repeat", [1, 2, 3])
@pytest.mark.parametrize("n_recordings", [2, 3, 4, 5, 8])
def test_a_full_cycle_balances_the_recordings_in_every_round(
    n_recordings: int, repeat: int
) -> None:
    cycle = count_rows(n_recordings)
    sessions = [
        order(list_items(n_recordings, 2), number, 3, seed=n_recordings)
        for number in range(1, cycle + 1)
    ]
    rows = [
        list(dict.fromkeys(t.recording for t in trials if t.repeat == repeat))
        for trials in sessions
    ]
    neighbours = count_neighbours(rows)
    assert len(neighbours) == n_recordings * (n_recordings - 1)
    assert len(set(neighbours.values())) == 1
    assert all(len({row[place] for row in rows}) == n_recordings for place in range(n_recordings))


@pytest.mark.parametrize("n_participants", range(1, 13))
def test_places_of_reducers_pooled_over_recordings_are_near_balance_after_any_number_of_participants(
    n_participants: int,
) -> None:
    items = list_items(8, 12)
    rows = [
        row
        for number in range(1, n_participants + 1)
        for row in list_blocks(order(items, number)).values()
    ]
    places = Counter((name, place) for row in rows for place, name in enumerate(row))
    counts = [places[str(s), place] for s in range(12) for place in range(12)]
    # Rows that moved on by one per participant would give a range of up to 5.
    assert max(counts) - min(counts) <= 2


@given(st.integers(0, 40), st.integers(2, 7))
def test_every_stimulus_stands_in_every_slot_of_a_page_equally_often(start: int, n: int) -> None:
    cycle = count_rows(n)
    slots = Counter(
        (j.stimulus_id, j.part)
        for number in range(start + 1, start + 1 + cycle)
        for t in order(list_items(2, n), number, tasks=["mushra"])
        for j in t.judgements
    )
    assert len(slots) == 2 * n * n
    assert set(slots.values()) == {cycle // n}


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"number": 0}, "number must be a whole number from 1, got 0"),
        ({"repeats": 0}, "repeats must be a whole number from 1, got 0"),
        ({"tasks": ()}, "tasks must be at least one for an order, got none"),
        ({"order": "latin"}, "order must be one of williams, blocked, random; got 'latin'"),
    ],
)
def test_orders_of_nothing_are_refused(
    items: list[Item], changes: dict[str, Any], message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        order(items, **changes)
    with pytest.raises(ValueError, match="items must be at least one"):
        order([])


TASKS = ("realism", "similarity", "dissimilarity", "abx")


# Williams squares.


def make_square(n: int) -> list[tuple[int, ...]]:
    return [williams_row(n, number) for number in range(count_rows(n))]


@pytest.mark.parametrize("n", [5, 6])
def test_square_is_the_reference_table(n: int, shared_recordings: Path) -> None:
    oracle = shared_recordings.parent / "oracles" / "williams_design" / "expected.json"
    assert [list(row) for row in make_square(n)] == json.loads(oracle.read_text())[f"example_n{n}"]


@pytest.mark.parametrize("n", range(2, 13))
def test_every_place_and_every_ordered_pair_comes_once_for_even_and_twice_for_odd_n(n: int) -> None:
    square, times = make_square(n), 1 + n % 2
    assert len(square) == times * n
    places = Counter((place, condition) for row in square for place, condition in enumerate(row))
    assert set(places.values()) == {times}
    assert len(places) == n * n
    neighbours = Counter(pair for row in square for pair in pairwise(row))
    assert set(neighbours.values()) == {times}
    assert len(neighbours) == n * (n - 1)


def test_square_of_nothing_is_refused() -> None:
    with pytest.raises(ValueError, match="n must be a number of conditions from 1, got 0"):
        count_rows(0)


@given(st.integers(1, 24), st.integers(0, 2**32))
def test_shuffled_rows_are_the_same_rows_and_none_begins_with_what_the_one_before_ended_with(
    n: int, seed: int
) -> None:
    order = shuffle_rows(n, np.random.default_rng(seed))
    assert sorted(order) == list(range(count_rows(n)))
    rows = [williams_row(n, number) for number in order]
    assert n < 3 or all(this[-1] != after[0] for this, after in pairwise((*rows, rows[0])))


def test_all_orders_of_rows_that_are_allowed_come_up_about_equally_often() -> None:
    rng = np.random.default_rng(1)
    counts = Counter(tuple(shuffle_rows(4, rng)) for _ in range(4000))
    # Of the six circles of four rows, two keep to the rule; each can begin with any row.
    assert len(counts) == 8
    assert max(counts.values()) < 1.3 * min(counts.values())


# Random orders: references apart, and nothing to be told from a place.


def list_mixed(stimuli: Sequence[tuple[int, int]]) -> list[Item]:
    """For each recording, so many reducers and so many references, which are hidden ones in realism."""
    return [
        Item(f"{r}-{s}", str(r), str(s), "as_is", "test" if s < n_tests else "reference")
        for r, (n_tests, n_catches) in enumerate(stimuli)
        for s in range(n_tests + n_catches)
    ]


def mix(
    items: list[Item], *, number: int = 1, repeats: int = 1, seed: int = 1
) -> tuple[Trial, ...]:
    return make_order(items, ["realism"], number=number, repeats=repeats, order="random", rng=seed)


@given(
    st.integers(2, 6),
    st.integers(2, 6),
    st.integers(0, 2),
    st.integers(1, 40),
    st.integers(1, 3),
    st.integers(0, 999),
)
def test_recordings_and_references_never_come_twice_in_a_row(
    n_recordings: int, n_tests: int, n_catches: int, number: int, repeats: int, seed: int
) -> None:
    # Two recordings that take turns, every other trial with a reference, would leave all these to one of them.
    assume(n_recordings > 2 or n_tests > n_catches)
    items = list_mixed([(n_tests, n_catches)] * n_recordings)
    trials = mix(items, number=number, repeats=repeats, seed=seed)
    assert all(a.recording != b.recording for a, b in pairwise(trials))
    assert not any(a.catch and b.catch for a, b in pairwise(trials))
    assert find_crowding(trials) == []


@given(st.integers(2, 8), st.integers(3, 6), st.integers(1, 3), st.integers(0, 999))
def test_references_are_spread_over_the_round(
    n_recordings: int, n_tests: int, n_catches: int, seed: int
) -> None:
    assume(n_recordings > 2 or n_tests > n_catches)
    trials = mix(list_mixed([(n_tests, n_catches)] * n_recordings), seed=seed)
    places = [place for place, trial in enumerate(trials) if trial.catch]
    stretch = len(trials) / len(places)
    gaps = [after - place for place, after in pairwise(places)]
    assert all(2 <= gap <= 2 * stretch + 1 for gap in gaps)


@pytest.fixture(scope="module")
def mixed() -> list[tuple[Trial, ...]]:
    """Many participants' orders of three recordings with six reducers, a reference and two anchors each."""
    roles = [*["test"] * 6, "reference", "anchor", "anchor"]
    items = [
        Item(f"{r}-{s}", r, str(s), "as_is", role) for r in "abc" for s, role in enumerate(roles)
    ]
    return [mix(items, number=number) for number in range(1, 1501)]


@pytest.mark.parametrize(
    ("catch", "share"), [("hidden_reference", 3 / 27), ("anchor", 6 / 27), ("", 18 / 27)]
)
def test_what_a_trial_is_cannot_be_told_from_its_place(
    catch: str, share: float, mixed: list[tuple[Trial, ...]]
) -> None:
    shares = np.mean([[trial.catch == catch for trial in trials] for trials in mixed], axis=0)
    error = np.sqrt(share * (1 - share) / len(mixed))
    assert np.abs(shares - share).max() < 4 * error


@pytest.mark.parametrize(
    ("stimuli", "expected"),
    [
        ([(6, 0)], ["realism: 5 of 6 trials follow one of the same recording"]),
        ([(7, 0), (3, 0)], ["realism: 3 of 10 trials follow one of the same recording"]),
        ([(1, 2), (1, 2)], ["realism: 1 of 6 trials judge the reference right after another"]),
    ],
)
def test_rules_that_cannot_be_kept_are_broken_as_rarely_as_possible_and_it_is_said(
    stimuli: list[tuple[int, int]], expected: list[str]
) -> None:
    for seed in range(20):
        assert find_crowding(mix(list_mixed(stimuli), seed=seed)) == expected
