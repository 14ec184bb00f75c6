import json
import tracemalloc
from collections import Counter, defaultdict
from collections.abc import Iterable, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from feel321.protocols.order import (
    ORDERS,
    find_crowding,
    make_order,
    make_rehearsal,
    measure_balance,
    select_share,
    shuffle_rows,
)  # fmt: skip
from feel321.protocols.tasks import (
    PROTOCOLS,
    count_rows,
    find_other,
    is_as_expected,
    make_task,
    williams_row,
)
from feel321.protocols.trial import Item, Trial

ROLES = {"original": "reference", "low": "anchor", "mid": "anchor"}
ITEMS = [
    Item(f"{recording}-{name}", recording, name, "as_is", ROLES.get(name, "test"))
    for recording in ("bumps", "drag", "taps")
    for name in ("sax321", "soc321", "dft321", "original", "low", "mid")
]
REALISM = ("realism",)

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


def list_blocks(trials: Iterable[Trial]) -> dict[tuple[str, int, str], list[str]]:
    """Order of the reducers, per protocol, repeat and recording."""
    blocks: dict[tuple[str, int, str], list[str]] = defaultdict(list)
    for t in trials:
        name = t.judgements[0].stimulus_id.removeprefix(f"{t.recording}-")
        blocks[t.protocol, t.repeat, t.recording].append(name)
    return blocks


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


@pytest.mark.parametrize("seed", range(4))
def test_a_full_cycle_balances_place_and_carry_over_in_every_recording_and_round(seed: int) -> None:
    sessions = [list_blocks(order(ITEMS, number, 3, seed=seed)) for number in range(1, 7)]
    for block in sessions[0]:
        assert measure_balance([[own[block] for own in sessions]]) == ((1, 1), (1, 1))


@pytest.mark.parametrize("n", [2, 3, 4, 5, 8])
def test_a_full_cycle_balances_the_recordings_in_every_round(n: int) -> None:
    items, cycle = list_items(n, 2), count_rows(n)
    sessions = [order(items, number, 3, seed=n) for number in range(1, cycle + 1)]
    each = (cycle // n, cycle // n)
    for repeat in (1, 2, 3):
        rows = [dict.fromkeys(t.recording for t in own if t.repeat == repeat) for own in sessions]
        assert measure_balance([[list(row) for row in rows]]) == (each, each)


@pytest.mark.parametrize("n_participants", range(1, 13))
def test_places_of_reducers_pooled_over_recordings_are_near_balance_after_any_number_of_participants(
    n_participants: int,
) -> None:
    items = list_items(8, 12)
    sessions = [list_blocks(order(items, number)) for number in range(1, n_participants + 1)]
    (fewest, most), _ = measure_balance([[row for own in sessions for row in own.values()]])
    # Rows that moved on by one per participant would give a range of up to 5.
    assert most - fewest <= 2


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
def test_orders_of_nothing_are_refused(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        order(ITEMS, **changes)
    with pytest.raises(ValueError, match="items must be at least one"):
        order([])
    with pytest.raises(ValueError, match="n must be a number of conditions from 1, got 0"):
        count_rows(0)


# Williams squares.


@pytest.mark.parametrize("n", [5, 6])
def test_square_is_the_reference_table(n: int, shared_recordings: Path) -> None:
    oracle = shared_recordings.parent / "oracles" / "williams_design" / "expected.json"
    square = [list(williams_row(n, number)) for number in range(count_rows(n))]
    assert square == json.loads(oracle.read_text())[f"example_n{n}"]


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
    assert list(find_crowding(trials)) == []


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
        assert list(find_crowding(mix(list_mixed(stimuli), seed=seed))) == expected


# Balance, and shares of the recordings.

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


def test_memory_grows_with_the_conditions_not_with_their_pairs() -> None:
    peaks = []
    for n in (200, 200, 800):  # the first time, for what is made once
        names = [f"stimulus {number}" for number in range(n)]
        tracemalloc.start()
        measure_balance([[names]])
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[2] < 6 * peaks[1]


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


# Training and practice.


def rehearse(
    *names: str, seed: int = 1, items: list[Item] = ITEMS, **counts: Any
) -> tuple[Trial, ...]:
    tasks = [make_task(name, **counts) for name in names]
    return make_rehearsal(items, tasks, first_number=50, rng=np.random.default_rng(seed))


@given(st.integers(0, 30), st.integers(0, 30), st.integers(0, 999))
def test_each_task_has_its_training_then_its_practice_and_never_more_than_there_is(
    training: int, practice: int, seed: int
) -> None:
    trials = rehearse(*PROTOCOLS, training=training, practice=practice, seed=seed)
    n_comparisons = dict(zip(PROTOCOLS, (18, 18, 21, 3, 15, 15, 24), strict=True))
    asked = {"training": training, "practice": practice}
    expected = {
        (name, phase): min(n, asked[phase]) for name, n in n_comparisons.items() for phase in asked
    }
    # Anchors are felt in training only.
    expected["dissimilarity", "training"] = min(21 + 6, training)
    for name in ("abx", "triplet", "preference"):  # half of the guesses are right
        expected[name, "training"] = min(n_comparisons[name], 2 * training)
    assert Counter((t.protocol, t.phase) for t in trials) == Counter(expected)
    assert list(dict.fromkeys((t.protocol, t.phase) for t in trials)) == [
        key for key, n in expected.items() if n
    ]
    assert [t.number for t in trials] == list(range(50, 50 + len(trials)))
    assert {(t.block, t.repeat) for t in trials} <= {(0, 0)}


@given(st.integers(1, 18), st.integers(0, 999))
def test_trials_with_a_known_answer_come_first_and_no_answer_is_right_for_most(
    training: int, seed: int
) -> None:
    rehearsed = rehearse("similarity", training=training, seed=seed)
    expected = [trial.judgements[0].expected for trial in rehearsed]
    sides = ["" if one is None else "high" if sum(one) > 100 else "low" for one in expected]
    n_known = sum(map(bool, sides))
    assert all(sides[:n_known])
    assert n_known >= min(training, 7)
    assert max(sides.count("high"), sides.count("low")) <= (training + 1) // 2


@given(st.integers(0, 999))
def test_anchors_are_what_differs_from_the_original_in_the_training_of_dissimilarity(
    seed: int,
) -> None:
    trials = rehearse("dissimilarity", training=4, practice=21, seed=seed)
    training = [t for t in trials if t.phase == "training"]
    assert Counter((t.catch, t.judgements[0].expected) for t in training) == {
        ("identical", (0, 25)): 2,
        ("anchor", (50, 100)): 2,
    }
    practised = {part.stimulus_id for t in trials if t.phase == "practice" for part in t.parts}
    assert not {item.stimulus_id for item in ITEMS if item.role == "anchor"} & practised


@given(st.integers(1, 8), st.booleans(), st.integers(0, 999))
def test_every_choice_in_training_is_right_or_wrong_and_the_plainest_come_first(
    training: int, with_anchors: bool, seed: int
) -> None:
    items = ITEMS if with_anchors else [item for item in ITEMS if item.role != "anchor"]
    trials = rehearse("abx", training=training, practice=2, seed=seed, items=items)
    assert {t.judgements[0].expected for t in trials if t.phase == "training"} == {(100, 100)}
    plain = [t.catch == "anchor" for t in trials if t.phase == "training"]
    assert plain == sorted(plain, reverse=True)
    assert sum(plain) == (min(2 * training, 6) if with_anchors else 0)
    assert {t.judgements[0].expected for t in trials if t.phase == "practice"} <= {None, (100, 100)}


@pytest.mark.parametrize("name", ["realism", "similarity", "dissimilarity", "mushra"])
@given(training=st.integers(2, 12), points=st.floats(0, 100), seed=st.integers(0, 999))
def test_nobody_passes_training_who_always_answers_the_same(
    name: str, training: int, points: float, seed: int
) -> None:
    rounds = [t for t in rehearse(name, training=training, seed=seed) if t.phase == "training"]
    met = [is_as_expected(t, {j.part: points for j in t.judgements}) for t in rounds]
    right = [understood for understood in met if understood is not None]
    assert sum(right) < 0.75 * len(right)
