from __future__ import annotations

from collections import Counter
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from feel321.protocols import order as spaced
from feel321.protocols.order import find_crowding, make_order, make_rehearsal
from feel321.protocols.tasks import make_task
from feel321.protocols.trial import Item

if TYPE_CHECKING:
    from collections.abc import Sequence

    from feel321.protocols.trial import Trial


def list_items(stimuli: Sequence[tuple[int, int]]) -> list[Item]:
    """For each recording, so many reducers and so many references, which are hidden ones in realism."""
    return [
        Item(f"{r}-{s}", str(r), str(s), "as_is", "test" if s < n_tests else "reference")
        for r, (n_tests, n_catches) in enumerate(stimuli)
        for s in range(n_tests + n_catches)
    ]


def order(
    items: list[Item], *, number: int = 1, repeats: int = 1, seed: int = 1
) -> tuple[Trial, ...]:
    rng = np.random.default_rng(seed)
    return make_order(
        items, [make_task("realism")], number=number, repeats=repeats, order="random", rng=rng
    )


@given(st.integers(1, 12), st.integers(0, 30), st.integers(0, 999))
def test_places_of_references_do_not_touch_where_there_is_room(
    count: int, more: int, seed: int
) -> None:
    n = 3 * count + more
    places = spaced._draw_places(count, n, rng=np.random.default_rng(seed))
    assert len(places) == count
    assert count == 1 or not places & {(place + 1) % n for place in places}


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
    items = list_items([(n_tests, n_catches)] * n_recordings)
    trials = order(items, number=number, repeats=repeats, seed=seed)
    assert all(a.recording != b.recording for a, b in pairwise(trials))
    assert not any(a.catch and b.catch for a, b in pairwise(trials))
    assert find_crowding(trials) == []


@given(st.integers(2, 8), st.integers(3, 6), st.integers(1, 3), st.integers(0, 999))
def test_references_are_spread_over_the_round(
    n_recordings: int, n_tests: int, n_catches: int, seed: int
) -> None:
    assume(n_recordings > 2 or n_tests > n_catches)
    trials = order(list_items([(n_tests, n_catches)] * n_recordings), seed=seed)
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
    return [order(items, number=number) for number in range(1, 1501)]


@pytest.mark.parametrize(
    ("catch", "share"), [("hidden_reference", 3 / 27), ("anchor", 6 / 27), ("", 18 / 27)]
)
def test_what_a_trial_is_cannot_be_told_from_its_place(
    catch: str, share: float, mixed: list[tuple[Trial, ...]]
) -> None:
    shares = np.mean([[trial.catch == catch for trial in trials] for trials in mixed], axis=0)
    error = np.sqrt(share * (1 - share) / len(mixed))
    assert np.abs(shares - share).max() < 4 * error


def test_after_a_catch_trial_another_is_as_likely_as_anywhere(
    mixed: list[tuple[Trial, ...]],
) -> None:
    after = [
        bool(second.catch) for trials in mixed for first, second in pairwise(trials) if first.catch
    ]
    # A reference after a reference is what the rules leave out, one of eight catch trials in nine.
    assert np.mean(after) == pytest.approx(9 / 27, abs=0.04)


def test_references_stand_at_no_fixed_distance(mixed: list[tuple[Trial, ...]]) -> None:
    places = [
        [place for place, trial in enumerate(trials) if trial.catch == "hidden_reference"]
        for trials in mixed
    ]
    gaps = Counter(after - place for own in places for place, after in pairwise(own))
    assert set(range(2, 17)) <= set(gaps)
    assert max(gaps.values()) < 0.15 * gaps.total()


def test_nobody_waits_for_what_cannot_be_better(monkeypatch: pytest.MonkeyPatch) -> None:
    draws: Counter[str] = Counter()
    draw = spaced._draw_order
    monkeypatch.setattr(
        spaced, "_draw_order", lambda *args, **named: draws.update(["draw"]) or draw(*args, **named)
    )
    # Each round is better drawn than this bound can tell: every recording has its reference at every other place.
    order(list_items([(1, 1), (1, 1)]), repeats=20)
    assert 20 <= draws.total() < 20 * 3 * spaced.PATIENCE


@given(st.integers(0, 999))
def test_a_recording_with_more_than_its_share_is_mixed_in_as_long_as_that_is_possible(
    seed: int,
) -> None:
    # 21 of 41 can only stand at every other place; nobody hits on that by drawing again and again.
    trials = order(list_items([(21, 0), (10, 0), (10, 0)]), seed=seed)
    assert [trial.recording == "0" for trial in trials] == [True, False] * 20 + [True]


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
        assert find_crowding(order(list_items(stimuli), seed=seed)) == expected


def test_sections_and_rehearsal_are_not_held_against_each_other() -> None:
    items = list_items([(2, 1), (2, 1), (2, 1)])
    tasks = [make_task("realism", training=9), make_task("realism")]
    trials = make_order(
        items, tasks[:1], number=1, repeats=1, order="random", rng=np.random.default_rng(1)
    )
    rehearsal = make_rehearsal(items, tasks[:1], first_number=10, rng=np.random.default_rng(1))
    assert any(a.catch and b.catch for a, b in pairwise(rehearsal))
    assert find_crowding((*trials, *rehearsal)) == []
