"""What each protocol compares: laws of all of them, then tables by hand of each."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from itertools import combinations, product
from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from feel321.protocols.order import make_order
from feel321.protocols.tasks import (
    EXPECTED,
    PROTOCOLS,
    choose_pairs,
    find_other,
    make_task,
    measure_chance,
)
from feel321.protocols.trial import RATING_RANGE, SURFACE, TIMINGS, Judgement, Trial

if TYPE_CHECKING:
    from collections.abc import Callable

    from feel321.protocols.trial import Comparison, Item, Task

    Drawn = dict[str, tuple[str, ...]]
    MakeItems = Callable[..., list[Item]]

REDUCERS = tuple(f"reducer{n}" for n in range(9))
TESTS = ("sax321", "soc321", "dft321")
NAMES = (*TESTS, "original", "low", "mid")
LEVELS = ("as_is", "equal_intensity")
SETS = st.fixed_dictionaries({
    "reducers": st.integers(1, 9).map(lambda n: REDUCERS[:n]),
    "anchors": st.sampled_from([(), ("low",), ("low", "mid")]),
    "levels": st.sampled_from([("as_is",), LEVELS]),
})


def list_tasks() -> list[Task]:
    """Every form of every protocol."""
    return [
        make_task(name, timing=timing, reference=reference, surface=surface)
        for name, protocol in PROTOCOLS.items()
        for timing in protocol.timings
        for reference in [
            REDUCERS[0] if kind == "reducer" else kind for kind in protocol.references
        ]
        or [None]
        for surface in ([False] if protocol.references else [False, True])
    ]


def describe(task: Task) -> str:
    return f"{task.protocol}-{task.timing}-{task.reference}" + "-surface" * task.surface


def list_items(task: Task, drawn: Drawn, make_items: MakeItems) -> list[Item]:
    """A set; a triplet has two reducers to choose from besides the one that may be the reference."""
    least = 3 if task.protocol == "triplet" else 0
    reducers = REDUCERS[: max(least, len(drawn["reducers"]))]
    return make_items("tap", (*reducers, "original", *drawn["anchors"]), drawn["levels"])


def compare(name: str, items: list[Item], **options: Any) -> tuple[Comparison, ...]:
    return PROTOCOLS[name].compare(items, make_task(name, **options))


def name_parts(comparison: Comparison) -> list[str | None]:
    """The reducers that are felt, in order; surfaces by their own name."""
    return [p.stimulus_id.split("-")[1] if p.stimulus_id else p.surface for p in comparison.parts]


def list_expected(comparisons: tuple[Comparison, ...]) -> list[tuple[float, float] | None]:
    return [judgement.expected for c in comparisons for judgement in c.judgements]


every_task = pytest.mark.parametrize("task", list_tasks(), ids=describe)
few = settings(max_examples=25)  # there are 54 sets


def test_registry_lists_every_protocol_under_its_own_name() -> None:
    assert list(PROTOCOLS) == [
        "realism", "similarity", "dissimilarity", "mushra", "abx", "triplet", "preference",
    ]  # fmt: skip
    for name, protocol in PROTOCOLS.items():
        assert name == protocol.name
        assert set(protocol.timings) <= set(TIMINGS)
    with pytest.raises(TypeError, match="does not support item assignment"):
        PROTOCOLS["realism"] = PROTOCOLS["abx"]  # type: ignore[index] - that it is refused is the point


@every_task
@few
@given(drawn=SETS, turn=st.integers(0, 50))
def test_every_comparison_is_whole_inside_one_arm_and_reveals_nothing(
    task: Task, drawn: Drawn, turn: int, make_items: MakeItems
) -> None:
    protocol = PROTOCOLS[task.protocol]
    comparisons = protocol.compare(list_items(task, drawn, make_items), task)
    assert len({tuple(part.name for part in one.parts) for one in comparisons}) == 1
    words = {"original", "hidden", "low", "mid", "anchor", *REDUCERS}
    for comparison in comparisons:
        arranged = protocol.arrange(comparison, turn)
        parts = {part.name: part for part in arranged.parts}
        assert len(parts) == len(arranged.parts)
        assert not words & parts.keys()
        assert all((part.stimulus_id is None) != (part.surface is None) for part in arranged.parts)
        felt = {part.stimulus_id for part in arranged.parts} - {None}
        assert len({str(stimulus).rpartition("-")[2] for stimulus in felt}) == 1
        about = {SURFACE if part.surface else part.stimulus_id for part in arranged.parts} | {None}
        assert arranged.judgements
        for judgement in arranged.judgements:
            assert judgement.part in parts
            assert judgement.stimulus_id in felt
            assert judgement.reference_id in about
            assert (judgement.reference_id is None) != bool(protocol.references)
        touched = [part.surface for part in comparison.parts if part.surface]
        assert touched == ["tap"] * (task.reference == SURFACE or task.surface)


@every_task
@few
@given(drawn=SETS)
def test_no_comparison_comes_twice_and_a_catch_is_where_something_is_expected(
    task: Task, drawn: Drawn, make_items: MakeItems
) -> None:
    comparisons = PROTOCOLS[task.protocol].compare(list_items(task, drawn, make_items), task)
    # The same three stimuli make three triplets, each with another reference.
    felt = Counter(
        (
            c.judgements[0].reference_id if PROTOCOLS[task.protocol].choices else None,
            frozenset(Counter(part.stimulus_id for part in c.parts).items()),
        )
        for c in comparisons
    )
    assert set(felt.values()) == {1}
    low, high = RATING_RANGE
    for comparison in comparisons:
        expected = [ends for ends in list_expected((comparison,)) if ends]
        assert comparison.catch in {"", *EXPECTED}
        assert len(comparison.judgements) > 1 or bool(expected) == bool(comparison.catch)
        assert all(low <= least <= most <= high for least, most in expected)


@every_task
@few
@given(drawn=SETS, turn=st.integers(0, 50))
def test_arranging_moves_what_is_felt_and_changes_nothing_else(
    task: Task, drawn: Drawn, turn: int, make_items: MakeItems
) -> None:
    def find_gist(comparison: Comparison) -> tuple[object, ...]:
        felt = {part.name: part.stimulus_id for part in comparison.parts}
        gists: Counter[object] = Counter()
        for judgement in comparison.judgements:
            met, expected = {judgement.stimulus_id, judgement.reference_id}, judgement.expected
            if judgement.part in PROTOCOLS[task.protocol].choices:
                assert felt["a"] == judgement.stimulus_id
                met = {judgement.reference_id, expected and felt["ab"[expected[0] == 0]]}
                expected = None
            gists[frozenset(met), expected] += 1
        return list(felt), set(felt.values()), gists, comparison.catch

    protocol = PROTOCOLS[task.protocol]
    for comparison in protocol.compare(list_items(task, drawn, make_items), task):
        assert find_gist(protocol.arrange(comparison, turn)) == find_gist(comparison)


@every_task
@few
@given(drawn=SETS)
def test_training_shows_what_is_judged_and_all_that_is_known_of_it(
    task: Task, drawn: Drawn, make_items: MakeItems
) -> None:
    items = list_items(task, drawn, make_items)
    judged = PROTOCOLS[task.protocol].compare(items, task)
    taught = PROTOCOLS[task.protocol].make_lessons(items, task)
    for comparison, lesson in zip(judged, taught, strict=False):
        assert (lesson.parts, lesson.catch) == (comparison.parts, comparison.catch)
        for judgement, told in zip(comparison.judgements, lesson.judgements, strict=True):
            assert told == replace(judgement, expected=told.expected)
            assert judgement.expected in {None, told.expected}
    assert len(taught) >= len(judged)
    assert all(lesson.judgements[0].expected for lesson in taught[len(judged) :])


def test_a_guess_is_right_on_every_slider_or_by_one_choice_of_all(make_items: MakeItems) -> None:
    chances = {}
    for name in PROTOCOLS:
        *_, last = compare(name, make_items("tap", NAMES))
        names = (name, name, "replay", "tap")
        chances[name] = measure_chance(
            Trial(1, 0, 0, *names, last.parts, last.judgements, "training")
        )
    assert chances == dict.fromkeys(PROTOCOLS, 0.5) | {
        "dissimilarity": 0.25,
        "mushra": 0.25 * 0.5**2,
    }


@pytest.mark.parametrize("name", PROTOCOLS)
def test_sets_that_lack_something_are_refused(name: str, make_items: MakeItems) -> None:
    protocol = PROTOCOLS[name]
    if protocol.references:
        with pytest.raises(
            ValueError, match=r"level .as_is. must have exactly one stimulus .* got 0"
        ):
            compare(name, make_items("tap", ["dft321", "low"]))
    if name not in {"realism", "similarity"}:
        with pytest.raises(ValueError, match="recording 'tap' must have at least one stimulus to"):
            compare(name, make_items("tap", ["original", "low"]))
    if not protocol.choices:
        assert protocol.score(Judgement("test", "tap"), 62.5, {"test": "tap"}) == 62.5


# Sliders, by hand.


@pytest.mark.parametrize(
    ("name", "options", "first", "catches"),
    [
        ("realism", {}, (), {"original": "hidden_reference"}),
        ("realism", {"surface": True}, ("tap",), {"original": "hidden_reference"}),
        ("similarity", {}, ("original",), {"original": "identical"}),
        ("similarity", {"reference": "dft321"}, ("dft321",), {"dft321": "identical"}),
        ("similarity", {"reference": SURFACE}, ("tap",), {"original": "hidden_reference"}),
    ],
)
def test_one_stimulus_after_its_reference(
    name: str,
    options: dict[str, Any],
    first: tuple[str],
    catches: dict[str, str],
    make_items: MakeItems,
) -> None:
    items = make_items("tap", NAMES, LEVELS)
    compared = compare(name, items, **options)
    assert [tuple(name_parts(c)) for c in compared] == [(*first, item.reducer) for item in items]
    caught = {"low": "anchor", "mid": "anchor", **catches}
    assert [c.catch for c in compared] == [caught.get(item.reducer, "") for item in items]
    limits = {"identical": (75, 100), "hidden_reference": (55, 100), "anchor": (0, 50)}
    assert list_expected(compared) == [limits.get(c.catch) for c in compared]
    for item, comparison in zip(items, compared, strict=True):
        (judgement,) = comparison.judgements
        about = (
            None
            if name == "realism"
            else SURFACE
            if first == ("tap",)
            else f"tap-{first[0]}-{item.level}"
        )
        assert (judgement.part, judgement.stimulus_id) == ("test", item.stimulus_id)
        assert judgement.reference_id == about


# Choices, by hand.


@pytest.mark.parametrize("reference", ["original", "dft321"])
def test_abx_tells_everything_from_the_reference_in_four_arrangements(
    reference: str, make_items: MakeItems
) -> None:
    compared, abx = compare("abx", make_items("tap", NAMES), reference=reference), PROTOCOLS["abx"]
    assert [c.judgements[0].stimulus_id.split("-")[1] for c in compared] == [
        name for name in NAMES if name != reference
    ]
    assert [c.catch for c in compared] == ["", "", "", "anchor", "anchor"]
    assert list_expected(compared)[2:] == [None, (100, 100), (100, 100)]
    for comparison, start in product(compared, range(5)):
        arranged = [abx.arrange(comparison, turn) for turn in range(start, start + 4)]
        one, other = comparison.judgements[0].stimulus_id, f"tap-{reference}-as_is"
        assert Counter(tuple(p.stimulus_id for p in c.parts) for c in arranged) == Counter(
            (a, b, x) for a, b in [(one, other), (other, one)] for x in (a, b)
        )
        assert abx.arrange(arranged[3], start) == arranged[0]  # whatever came before


@given(st.integers(2, 14), st.integers(1, 91), st.text(max_size=5))
def test_some_pairs_are_spread_evenly_and_connect_everything(n: int, count: int, key: str) -> None:
    pairs = choose_pairs(n, count, key=key)
    assert len(set(pairs)) == len(pairs) == min(count, n * (n - 1) // 2)
    assert set(pairs) <= set(combinations(range(n), 2))
    counts = Counter(place for pair in pairs for place in pair)
    degrees = [counts[place] for place in range(n)]
    assert max(degrees) - min(degrees) <= 1
    reached = fresh = {0}
    while fresh:
        fresh = {b for pair in pairs for a, b in (pair, pair[::-1]) if a in fresh} - reached
        reached |= fresh
    assert (len(reached) == n) == (len(pairs) >= n - 1)


def test_without_a_number_there_are_all_pairs_and_keys_give_different_ones() -> None:
    assert choose_pairs(5, None, key="oak") == tuple(combinations(range(5), 2))
    assert len({choose_pairs(8, 7, key=name) for name in ("oak", "felt", "slate", "cork")}) == 4


@pytest.mark.parametrize(
    ("name", "options", "heads", "pairs", "certain"),
    [
        ("triplet", {}, ["original"], TESTS, "original"),
        ("triplet", {"reference": SURFACE}, ["tap"], TESTS, "original"),
        ("triplet", {"reference": "soc321"}, ["soc321"], ("sax321", "dft321"), "soc321"),
        ("preference", {}, [], ("original", *TESTS), "original"),
        ("preference", {"surface": True}, ["tap"], ("original", *TESTS), "original"),
    ],
)
def test_pairs_of_reducers_and_two_catches(
    name: str,
    options: dict[str, Any],
    heads: list[str],
    pairs: tuple[str, ...],
    certain: str,
    make_items: MakeItems,
) -> None:
    compared = compare(name, make_items("tap", NAMES), **options)
    assert [(name_parts(c), c.catch, c.judgements[0].expected) for c in compared] == [
        *(([*heads, *pair], "", None) for pair in combinations(pairs, 2)),
        ([*heads, certain, "low"], "anchor", (100, 100)),
        ([*heads, "mid", certain], "anchor", (0, 0)),
    ]
    about = {"tap": SURFACE}.get(heads[0], f"tap-{heads[0]}-as_is") if heads else None
    about = None if name == "preference" else about
    assert {c.judgements[0].reference_id for c in compared} == {about}


@pytest.mark.parametrize("name", ["triplet", "preference"])
def test_of_two_that_are_chosen_from_each_comes_first_as_often(
    name: str, make_items: MakeItems
) -> None:
    items = [item for oak in ("oak", "tap") for item in make_items(oak, NAMES)]
    places: Counter[tuple[str, int]] = Counter()
    for number in (1, 2):
        for trial in make_order(items, [make_task(name)], number=number, repeats=2):
            places.update((str(trial.parts[place].stimulus_id), place) for place in (-2, -1))
    assert all(places[stimulus, -2] == places[stimulus, -1] for stimulus, _ in places)
    lone = make_items("tap", ["dft321", *["original"] * (name == "triplet")])
    with pytest.raises(
        ValueError, match=f"a {name} must have at least two stimuli .* got 1; build"
    ):
        compare(name, lone)
    for other in PROTOCOLS.keys() - {"triplet", "preference"}:
        for trial in make_order(items, [make_task(other)], number=1):
            assert {find_other(trial, judgement) for judgement in trial.judgements} == {None}
