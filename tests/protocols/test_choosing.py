"""Triplets and paired preference: which stimuli meet, what comes first, what is certain, and which of them won."""

from __future__ import annotations

from collections import Counter
from itertools import combinations
from typing import TYPE_CHECKING

import pytest
from hypothesis import given
from hypothesis import strategies as st

from feel321.protocols.compare import CHOICES, choose_pairs
from feel321.protocols.order import make_order
from feel321.protocols.tasks import PROTOCOLS, find_other, is_as_expected, make_task, score_trial
from feel321.protocols.texts import list_languages, read_scales

if TYPE_CHECKING:
    from collections.abc import Callable

    from feel321.protocols.trial import Comparison, Item

    MakeItems = Callable[..., list[Item]]

TESTS = ("sax321", "soc321", "dft321")
NAMES = (*TESTS, "original", "low", "mid")
both = pytest.mark.parametrize("name", ["triplet", "preference"])


def name_parts(comparison: Comparison) -> list[str | None]:
    """The reducers that are felt, in order; surfaces by their own name."""
    return [p.stimulus_id.split("-")[1] if p.stimulus_id else p.surface for p in comparison.parts]


def count_degrees(pairs: tuple[tuple[int, int], ...], n: int) -> list[int]:
    counts = Counter(place for pair in pairs for place in pair)
    return [counts[place] for place in range(n)]


def is_connected(pairs: tuple[tuple[int, int], ...], n: int) -> bool:
    reached, fresh = {0}, {0}
    while fresh:
        fresh = {b for pair in pairs for a, b in (pair, pair[::-1]) if a in fresh} - reached
        reached |= fresh
    return len(reached) == n


@given(st.integers(2, 14), st.integers(1, 91), st.text(max_size=5))
def test_some_pairs_are_spread_evenly_and_connect_everything(n: int, count: int, key: str) -> None:
    pairs = choose_pairs(n, count, key=key)
    assert len(set(pairs)) == len(pairs) == min(count, n * (n - 1) // 2)
    assert set(pairs) <= set(combinations(range(n), 2))
    assert max(degrees := count_degrees(pairs, n)) - min(degrees) <= 1
    assert is_connected(pairs, n) == (len(pairs) >= n - 1)


def test_without_a_number_there_are_all_pairs_and_keys_give_different_ones() -> None:
    assert choose_pairs(5, None, key="oak") == tuple(combinations(range(5), 2))
    assert len({choose_pairs(8, 7, key=name) for name in ("oak", "felt", "slate", "cork")}) == 4


def test_a_triplet_is_a_pair_of_reducers_after_their_reference(make_items: MakeItems) -> None:
    compared = PROTOCOLS["triplet"].compare(make_items("tap", NAMES), make_task("triplet"))
    assert [(name_parts(c), c.catch, c.judgements[0].expected) for c in compared] == [
        *((["original", *pair], "", None) for pair in combinations(TESTS, 2)),
        (["original", "original", "low"], "anchor", (100, 100)),
        (["original", "mid", "original"], "anchor", (0, 0)),
    ]
    assert {c.judgements[0].reference_id for c in compared} == {"tap-original-as_is"}


@pytest.mark.parametrize(
    ("reference", "about", "pairs"),
    [
        ("surface", "surface", list(combinations(TESTS, 2))),
        ("soc321", "tap-soc321-as_is", [("sax321", "dft321")]),
    ],
)
def test_a_triplet_may_be_about_the_surface_or_about_a_reducer(
    reference: str, about: str, pairs: list[tuple[str, str]], make_items: MakeItems
) -> None:
    task = make_task("triplet", reference=reference)
    compared = PROTOCOLS["triplet"].compare(make_items("tap", NAMES), task)
    assert {c.judgements[0].reference_id for c in compared} == {about}
    assert [tuple(name_parts(c)[1:]) for c in compared if not c.catch] == pairs
    certain = "original" if reference == "surface" else reference
    assert [set(name_parts(c)[1:]) for c in compared if c.catch] == [
        {certain, "low"},
        {certain, "mid"},
    ]


def test_the_recording_itself_may_be_preferred_and_is_preferred_to_anchors(
    make_items: MakeItems,
) -> None:
    compared = PROTOCOLS["preference"].compare(make_items("tap", NAMES), make_task("preference"))
    assert [(name_parts(c), c.catch) for c in compared] == [
        *((list(pair), "") for pair in combinations(("original", *TESTS), 2)),
        (["original", "low"], "anchor"),
        (["mid", "original"], "anchor"),
    ]
    bare = PROTOCOLS["preference"].compare(make_items("tap", TESTS), make_task("preference"))
    assert [name_parts(c) for c in bare] == [list(pair) for pair in combinations(TESTS, 2)]


def test_every_stimulus_may_be_the_reference_in_turn(make_items: MakeItems) -> None:
    task = make_task("triplet", reference="every")
    compared = PROTOCOLS["triplet"].compare(make_items("tap", NAMES), task)
    felt = ("original", *TESTS)
    expected = {
        (head, pair) for head in felt for pair in combinations([n for n in felt if n != head], 2)
    }
    asked = [name_parts(c) for c in compared if not c.catch]
    assert {(str(head), tuple(pair)) for head, *pair in asked} == expected
    assert len(asked) == len(expected) == 4 * 3
    assert [name_parts(c)[0] for c in compared if c.catch] == ["original", "original"]
    some = make_task("triplet", reference="every", pairs=2)
    heads = Counter(
        name_parts(c)[0]
        for c in PROTOCOLS["triplet"].compare(make_items("tap", NAMES), some)
        if not c.catch
    )
    assert heads == dict.fromkeys(felt, 2)


@both
def test_one_stimulus_is_nothing_to_choose_from(name: str, make_items: MakeItems) -> None:
    items = [item for item in make_items("tap", ["dft321", "original"]) if name == "triplet"]
    with pytest.raises(
        ValueError, match=f"a {name} must have at least two stimuli .* got 1; build"
    ):
        PROTOCOLS[name].compare(items or make_items("tap", ["dft321"]), make_task(name))


@both
def test_the_first_changes_with_every_turn_and_the_points_follow_it(
    name: str, make_items: MakeItems
) -> None:
    protocol = PROTOCOLS[name]
    for comparison in protocol.compare(make_items("tap", NAMES), make_task(name)):
        turned = protocol.arrange(comparison, 3)
        assert name_parts(turned)[-2:] == name_parts(comparison)[-2:][::-1]
        assert protocol.arrange(turned, 1) == comparison == protocol.arrange(comparison, 2)
        assert turned.judgements[0].stimulus_id == turned.parts[-2].stimulus_id


@both
@given(number=st.integers(1, 40), pairs=st.integers(1, 6))
def test_a_row_names_both_stimuli_and_who_won(
    name: str, number: int, pairs: int, make_items: MakeItems
) -> None:
    trials = make_order(
        make_items("tap", NAMES), [make_task(name, pairs=pairs)], number=number, repeats=2
    )
    assert len(trials) == 2 * (min(pairs, 3 if name == "triplet" else 6) + 2)
    for trial in trials:
        (judgement,) = trial.judgements
        felt = {part.name: part.stimulus_id for part in trial.parts}
        assert (judgement.stimulus_id, find_other(trial, judgement)) == (felt["a"], felt["b"])
        assert score_trial(trial, {"a": "a"}) == {"a": 100.0}
        assert score_trial(trial, {"a": "b"}) == {"a": 0.0}
        if trial.catch:
            choices = {choice: is_as_expected(trial, {"a": choice}) for choice in CHOICES}
            assert choices == {choice: "original" in str(felt[choice]) for choice in CHOICES}


@both
def test_each_stimulus_comes_first_as_often_as_second(name: str, make_items: MakeItems) -> None:
    items = [item for oak in ("oak", "tap") for item in make_items(oak, NAMES)]
    firsts: Counter[tuple[str, str]] = Counter()
    for number in (1, 2):
        for trial in make_order(items, [make_task(name)], number=number, repeats=2):
            firsts[str(trial.parts[-2].stimulus_id), "a"] += 1
            firsts[str(trial.parts[-1].stimulus_id), "b"] += 1
    assert all(firsts[stimulus, "a"] == firsts[stimulus, "b"] for stimulus, _ in firsts)


def test_other_tasks_have_no_other_stimulus(make_items: MakeItems) -> None:
    for name in (name for name in PROTOCOLS if name not in {"triplet", "preference"}):
        for trial in make_order(make_items("tap", NAMES), [make_task(name)], number=1):
            assert {find_other(trial, judgement) for judgement in trial.judgements} == {None}


@pytest.mark.parametrize("language", list_languages())
@both
def test_the_catalogue_offers_the_choices_that_are_scored(name: str, language: str) -> None:
    assert read_scales(language)[name].choices == CHOICES
