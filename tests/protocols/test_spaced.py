from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from protocols.design import make_order
from protocols.rehearsal import make_rehearsal
from protocols.spaced import find_crowding
from protocols.tasks import make_task
from protocols.trial import Item

if TYPE_CHECKING:
    from collections.abc import Sequence

    from protocols.trial import Trial

CATCHES = ("reference", "anchor")


def list_items(stimuli: Sequence[tuple[int, int]]) -> list[Item]:
    """For each recording, so many reducers and so many stimuli that are catch trials of realism."""
    return [
        Item(f"{r}-{s}", str(r), str(s), "as_is", "test" if s < n_tests else CATCHES[s % 2])
        for r, (n_tests, n_catches) in enumerate(stimuli)
        for s in range(n_tests + n_catches)
    ]


def order(items: list[Item], *, number: int = 1, repeats: int = 1, seed: int = 1) -> tuple[Trial, ...]:
    rng = np.random.default_rng(seed)
    return make_order(items, [make_task("realism")], number=number, repeats=repeats, order="random", rng=rng)


@given(
    st.integers(2, 6), st.integers(2, 6), st.integers(0, 2), st.integers(1, 40), st.integers(1, 3), st.integers(0, 999)
)
def test_recordings_and_catch_trials_never_come_twice_in_a_row(
    n_recordings: int, n_tests: int, n_catches: int, number: int, repeats: int, seed: int
) -> None:
    # Two recordings that take turns, of which every other trial is a catch trial, would leave all these to one of them.
    assume(n_recordings > 2 or n_tests > n_catches)
    items = list_items([(n_tests, n_catches)] * n_recordings)
    trials = order(items, number=number, repeats=repeats, seed=seed)
    assert all(a.recording != b.recording for a, b in pairwise(trials))
    assert not any(a.catch and b.catch for a, b in pairwise(trials))
    assert find_crowding(trials) == []


@given(st.integers(2, 8), st.integers(3, 6), st.integers(1, 3), st.integers(0, 999))
def test_every_equal_stretch_of_a_round_has_one_catch_trial(
    n_recordings: int, n_tests: int, n_catches: int, seed: int
) -> None:
    trials = order(list_items([(n_tests, n_catches)] * n_recordings), seed=seed)
    places = [place for place, trial in enumerate(trials) if trial.catch]
    starts = [stretch * len(trials) // len(places) for stretch in range(len(places) + 1)]
    assert all(start <= place < end for place, (start, end) in zip(places, pairwise(starts), strict=True))


def test_catch_trials_stand_at_every_place_of_a_stretch() -> None:
    items = list_items([(3, 1)] * 4)
    orders = [order(items, number=number) for number in range(1, 60)]
    assert {place % 4 for trials in orders for place, trial in enumerate(trials) if trial.catch} == {0, 1, 2, 3}


@given(st.integers(0, 999))
def test_a_recording_with_more_than_its_share_is_mixed_in_as_long_as_that_is_possible(seed: int) -> None:
    # 21 of 41 can only stand at every other place; nobody hits on that by drawing again and again.
    trials = order(list_items([(21, 0), (10, 0), (10, 0)]), seed=seed)
    assert [trial.recording == "0" for trial in trials] == [True, False] * 20 + [True]


@pytest.mark.parametrize(
    ("stimuli", "expected"),
    [
        ([(6, 0)], ["realism: 5 of 6 trials follow one of the same recording"]),
        ([(7, 0), (3, 0)], ["realism: 3 of 10 trials follow one of the same recording"]),
        ([(1, 2), (1, 2)], ["realism: 1 of 6 trials are catch trials right after another"]),
    ],
)
def test_rules_that_cannot_be_kept_are_broken_as_rarely_as_possible_and_it_is_said(
    stimuli: list[tuple[int, int]], expected: list[str]
) -> None:
    for seed in range(20):
        assert find_crowding(order(list_items(stimuli), seed=seed)) == expected


def test_sections_and_rehearsal_are_not_held_against_each_other() -> None:
    items = list_items([(2, 1), (2, 1), (2, 1)])
    tasks = [make_task("realism", training=9), make_task("realism")]
    trials = make_order(items, tasks[:1], number=1, repeats=1, order="random", rng=np.random.default_rng(1))
    rehearsal = make_rehearsal(items, tasks[:1], first_number=10, rng=np.random.default_rng(1))
    assert any(a.catch and b.catch for a, b in pairwise(rehearsal))
    assert find_crowding((*trials, *rehearsal)) == []
