from __future__ import annotations

from collections import Counter, defaultdict
from dataclasses import asdict, replace
from itertools import combinations, pairwise, product
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from feel321.protocols.balance import count_rows, measure_balance
from feel321.protocols.order import ORDERS, arrange_sections, make_order, order_tasks
from feel321.protocols.tasks import PROTOCOLS, find_other, make_task
from feel321.protocols.trial import Item

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

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


@given(orders, numbers, st.integers(1, 5), st.integers(2, 7), seeds)
def test_no_stimulus_of_a_lone_recording_follows_itself(
    name: str, number: int, repeats: int, n_stimuli: int, seed: int
) -> None:
    trials = order(list_items(1, n_stimuli), number, repeats, order=name, seed=seed)
    assert all(get_stimulus(a) != get_stimulus(b) for a, b in pairwise(trials))


@pytest.mark.parametrize("name", ORDERS)
def test_a_lone_stimulus_may_follow_itself(name: str) -> None:
    trials = order([Item("tap", "tap", "dft321", "as_is", "test")], repeats=2, order=name)
    assert [get_stimulus(t) for t in trials] == ["tap", "tap"]


@pytest.mark.parametrize("name", ORDERS)
def test_order_depends_on_seed_and_participant_and_on_nothing_else(
    items: list[Item], name: str
) -> None:
    assert order(items, 3, order=name) == order(items, 3, order=name)
    assert order(items, 3, order=name) != order(items, 4, order=name)
    assert len({order(items, 3, seed=seed, order=name) for seed in range(5)}) == 5


@pytest.mark.parametrize("name", ["blocked", "random"])
def test_shuffled_orders_are_the_participants_own(items: list[Item], name: str) -> None:
    assert (
        len({
            tuple(map(get_stimulus, order(items, number, order=name))) for number in range(1, 101)
        })
        == 100
    )


@pytest.mark.parametrize("name", ["williams", "blocked"])
def test_a_block_is_one_recording_of_one_protocol_and_repeat(items: list[Item], name: str) -> None:
    trials = order(items, repeats=2, tasks=BOTH, order=name)
    blocks: dict[int, set[tuple[str, int, str]]] = defaultdict(set)
    for t in trials:
        blocks[t.block].add((t.protocol, t.repeat, t.recording))
    assert list(blocks) == list(range(1, 2 * 2 * 3 + 1))
    assert all(len(block) == 1 for block in blocks.values())


def test_a_random_block_is_a_round_of_all_recordings(items: list[Item]) -> None:
    trials = order(items, repeats=2, tasks=BOTH, order="random")
    assert Counter(t.block for t in trials) == dict.fromkeys(range(1, 5), len(items))


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


@pytest.mark.parametrize("number", range(1, 7))
def test_no_two_recordings_or_repeats_of_one_participant_share_an_order(
    items: list[Item], number: int
) -> None:
    blocks = list_blocks(order(items, number, repeats=2, tasks=BOTH))
    for this, that in combinations(blocks, 2):
        if sum(a != b for a, b in zip(this, that, strict=True)) == 1:
            assert blocks[this] != blocks[that], (this, that)


def test_two_conditions_change_their_order_from_repeat_to_repeat_where_other_recordings_stand_between() -> (
    None
):
    blocks = list_blocks(order(list_items(3, 2), repeats=2))
    assert all(blocks["realism", 1, str(r)] == blocks["realism", 2, str(r)][::-1] for r in range(3))


@given(st.integers(0, 40), st.integers(2, 5))
def test_either_of_a_pair_comes_first_equally_often_over_participants_and_over_repeats(
    start: int, n: int
) -> None:
    items = list_items(2, n)
    two_participants = [t for k in (1, 2) for t in order(items, start + k, tasks=["dissimilarity"])]
    for trials in (two_participants, order(items, start + 1, 2, tasks=["dissimilarity"])):
        came_first = defaultdict(set)
        for t in trials:
            came_first[name_comparison(t)].add(t.parts[0].stimulus_id)
        assert all(first == set(stimuli) for (_, _, stimuli), first in came_first.items())


@given(st.integers(0, 40))
def test_four_participants_meet_every_arrangement_of_abx_once(start: int) -> None:
    met = defaultdict(list)
    for number in range(start + 1, start + 5):
        for t in order(list_items(3, 5), number, tasks=["abx"]):
            a, b, x = (part.stimulus_id for part in t.parts)
            met[name_comparison(t)].append((a, x == a))
            assert x in {a, b}
    assert all(
        sorted(found) == sorted(product(stimuli, (False, True)))
        for (_, _, stimuli), found in met.items()
    )


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


def test_arrangements_of_abx_are_even_within_each_recording() -> None:
    met = defaultdict(set)
    for t in order(list_items(3, 5), tasks=["abx"]):
        a, b, x = (part.stimulus_id for part in t.parts)
        met[t.recording].add((str(a).endswith("-0"), x == a))
        assert a != b
    assert all(len(arrangements) == 4 for arrangements in met.values())


def test_the_slots_of_a_page_change_from_recording_to_recording() -> None:
    trials = order(list_items(6, 6), tasks=["mushra"])
    slots = {tuple(j.stimulus_id.split("-")[1] for j in t.judgements) for t in trials}
    assert len(slots) == 6


def test_trials_carry_what_the_protocol_and_the_task_say(
    make_items: Callable[..., list[Item]],
) -> None:
    task = make_task("similarity", timing="strict")
    items = make_items("tap", ("original", "dft321", "low"))
    trials = make_order(items, [task], number=1, repeats=1, rng=np.random.default_rng(1))
    assert {(t.protocol, t.scale, t.timing, t.recording) for t in trials} == {
        ("similarity", "similarity", "strict", "tap")
    }
    assert {get_stimulus(t).split("-")[1]: t.catch for t in trials} == {
        "original": "identical",
        "dft321": "",
        "low": "anchor",
    }


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


def test_no_items_are_refused() -> None:
    with pytest.raises(ValueError, match="items must be at least one"):
        order([])


def test_a_recording_without_anything_to_judge_is_left_out_and_a_task_without_any_is_refused() -> (
    None
):
    def order_abx(items: list[Item]) -> tuple[Trial, ...]:
        task = make_task("abx", reference="1")
        return make_order(items, [task], number=1, repeats=1, rng=np.random.default_rng(1))

    lone, pair = list_items(1, 2), [Item(f"tap-{s}", "tap", s, "as_is", "test") for s in "12"]
    assert {t.recording for t in order_abx(lone + pair)} == {"tap", "0"}
    only = [item for item in lone if item.role == "test"]
    assert {t.recording for t in order_abx(only + pair)} == {"tap"}
    with pytest.raises(
        ValueError, match="abx: no stimulus of the set is to be judged; build a set with reducers"
    ):
        order_abx(only)


def test_a_table_of_items_names_of_tasks_and_a_seed_give_the_same_order(items: list[Item]) -> None:
    table = pd.DataFrame([asdict(item) for item in items]).iloc[:, ::-1]
    trials = make_order(table, ["realism"], number=2, rng=1)
    assert trials == order(items, 2)
    assert list(trials.to_frame()["stimulus_id"]) == [get_stimulus(t) for t in trials]
    balance = measure_balance([make_order(table, ["realism"], number=n) for n in range(1, 7)])
    assert balance.to_frame().shape == (len(items), len(items))
    assert measure_balance(["AB", "BA"]) == measure_balance([["A", "B"], ["B", "A"]])


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda items: make_order(items, "realism", number=1), "tasks must be a list"),
        (lambda items: make_order(items, ["realism"], number=1, rng="x"), "rng must be a whole"),
        (
            lambda items: measure_balance(make_order(items, ["realism"], number=1)),
            "one sequence per",
        ),
        (lambda _: measure_balance("AB"), r"write \[sequence\]"),
    ],
)
def test_what_is_no_list_is_refused(items: list[Item], make: Any, message: str) -> None:
    with pytest.raises(TypeError, match=message):
        make(items)


TASKS = ("realism", "similarity", "dissimilarity", "abx")


@given(orders, numbers, repeat_counts, st.integers(1, 3), st.integers(1, 4), seeds)
def test_counterbalanced_tasks_are_a_permutation_of_the_sections_and_of_nothing_else(
    name: str, number: int, repeats: int, n_recordings: int, n_tasks: int, seed: int
) -> None:
    tasks = [make_task(protocol) for protocol in TASKS[:n_tasks]]
    fixed = order(
        list_items(n_recordings, 3), number, repeats, tasks=TASKS[:n_tasks], order=name, seed=seed
    )
    own = order_tasks(tasks, number=number)
    moved = arrange_sections(fixed, own)
    assert list(dict.fromkeys(t.protocol for t in moved)) == [task.protocol for task in own]
    assert [t.number for t in moved] == list(range(1, len(fixed) + 1))
    blocks = [t.block for t in moved]
    assert blocks == sorted(blocks)
    assert set(blocks) == {t.block for t in fixed}
    for task in tasks:  # inside a section, all is as it was
        before, after = (
            [replace(t, number=0, block=0) for t in trials if t.protocol == task.protocol]
            for trials in (fixed, moved)
        )
        assert before == after


@pytest.mark.parametrize("n_tasks", [1, 2, 3, 4])
def test_tasks_are_as_often_at_each_place_and_after_each_other(n_tasks: int) -> None:
    tasks = [make_task(protocol) for protocol in TASKS[:n_tasks]]
    rows = [
        [task.protocol for task in order_tasks(tasks, number=number)]
        for number in range(1, count_rows(n_tasks) + 1)
    ]
    balance = measure_balance(rows)
    assert (balance.position_index, balance.carry_over_index, balance.repeats) == (0, 0, 0)
    assert rows[0] == list(TASKS[:n_tasks]) or n_tasks > 2
