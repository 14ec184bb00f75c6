"""What each protocol compares: laws of all, then tables by hand; options of tasks, scales, and groups of a design."""

import re
from collections import Counter
from collections.abc import Iterable
from dataclasses import replace
from itertools import combinations, product
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from feel321.protocols import tasks
from feel321.protocols.order import make_order, make_rehearsal
from feel321.protocols.tasks import PROTOCOLS, find_other, make_task
from feel321.protocols.trial import (
    RATING_RANGE,
    SURFACE,
    TIMINGS,
    Comparison,
    Item,
    Judgement,
    Task,
    Trial,
    place_in_groups,
    select_group,
    select_items,
)

Drawn = dict[str, tuple[str, ...]]

REDUCERS = tuple(f"reducer{n}" for n in range(9))
TESTS = ("sax321", "soc321", "dft321")
NAMES = (*TESTS, "original", "low", "mid")
LEVELS = ("as_is", "equal_intensity")
SETS = st.fixed_dictionaries({
    "reducers": st.integers(1, 9).map(lambda n: REDUCERS[:n]),
    "anchors": st.sampled_from([(), ("low",), ("low", "mid")]),
    "levels": st.sampled_from([("as_is",), LEVELS]),
})


def name_items(
    recording: str, names: Iterable[str], levels: Iterable[str] = ("as_is",)
) -> list[Item]:
    """Stimuli of one recording, named `recording-name-level`: `original`, anchors `low` and `mid`, else reducers."""
    roles = {"original": "reference", "low": "anchor", "mid": "anchor"}
    return [
        Item(f"{recording}-{name}-{level}", recording, name, level, roles.get(name, "test"))
        for level in levels
        for name in names
    ]


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


def list_items(task: Task, drawn: Drawn) -> list[Item]:
    """A set; a triplet has two reducers to choose from besides the one that may be the reference."""
    least = 3 if task.protocol == "triplet" else 0
    reducers = REDUCERS[: max(least, len(drawn["reducers"]))]
    return name_items("tap", (*reducers, "original", *drawn["anchors"]), drawn["levels"])


def compare(name: str, items: list[Item], **options: Any) -> tuple[Comparison, ...]:
    return PROTOCOLS[name].compare(items, make_task(name, **options))


def name_parts(comparison: Comparison) -> list[str | None]:
    """The reducers that are felt, in order; surfaces by their own name."""
    return [p.stimulus_id.split("-")[1] if p.stimulus_id else p.surface for p in comparison.parts]


def list_expected(comparisons: tuple[Comparison, ...]) -> list[tuple[float, float] | None]:
    return [judgement.expected for c in comparisons for judgement in c.judgements]


NAMED = {f"{t.protocol}-{t.timing}-{t.reference}-{t.surface}": t for t in list_tasks()}
every_task = pytest.mark.parametrize("task", NAMED.values(), ids=NAMED)


def test_registry_lists_every_protocol_under_its_own_name() -> None:
    listed = "realism similarity dissimilarity mushra abx triplet preference"
    assert list(PROTOCOLS) == listed.split() == [one.name for one in PROTOCOLS.values()]
    assert {timing for one in PROTOCOLS.values() for timing in one.timings} == set(TIMINGS)


@every_task
@given(drawn=SETS, turn=st.integers(0, 50))
def test_every_comparison_is_whole_inside_one_arm_and_reveals_nothing(
    task: Task, drawn: Drawn, turn: int
) -> None:
    protocol = PROTOCOLS[task.protocol]
    comparisons = protocol.compare(list_items(task, drawn), task)
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
@given(drawn=SETS)
def test_no_comparison_comes_twice_and_a_catch_is_where_something_is_expected(
    task: Task, drawn: Drawn
) -> None:
    comparisons = PROTOCOLS[task.protocol].compare(list_items(task, drawn), task)
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
        assert comparison.catch in {"", *tasks.EXPECTED}
        assert len(comparison.judgements) > 1 or bool(expected) == bool(comparison.catch)
        assert all(low <= least <= most <= high for least, most in expected)


@every_task
@given(drawn=SETS, turn=st.integers(0, 50))
def test_arranging_moves_what_is_felt_and_changes_nothing_else(
    task: Task, drawn: Drawn, turn: int
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
    for comparison in protocol.compare(list_items(task, drawn), task):
        assert find_gist(protocol.arrange(comparison, turn)) == find_gist(comparison)


@every_task
@given(drawn=SETS)
def test_training_shows_what_is_judged_and_all_that_is_known_of_it(
    task: Task, drawn: Drawn
) -> None:
    items = list_items(task, drawn)
    judged = PROTOCOLS[task.protocol].compare(items, task)
    taught = PROTOCOLS[task.protocol].make_lessons(items, task)
    for comparison, lesson in zip(judged, taught, strict=False):
        assert (lesson.parts, lesson.catch) == (comparison.parts, comparison.catch)
        for judgement, told in zip(comparison.judgements, lesson.judgements, strict=True):
            assert told == replace(judgement, expected=told.expected)
            assert judgement.expected in {None, told.expected}
    assert len(taught) >= len(judged)
    assert all(lesson.judgements[0].expected for lesson in taught[len(judged) :])


def test_a_guess_is_right_on_every_slider_or_by_one_choice_of_all() -> None:
    chances = {}
    for name in PROTOCOLS:
        *_, last = compare(name, name_items("tap", NAMES))
        own = (name, name, "replay", "tap", last.parts, last.judgements)
        chances[name] = tasks.measure_chance(Trial(1, 0, 0, *own, "training"))
    others = {"dissimilarity": 0.25, "mushra": 0.25 * 0.5**2}
    assert chances == dict.fromkeys(PROTOCOLS, 0.5) | others


@pytest.mark.parametrize("name", PROTOCOLS)
def test_sets_that_lack_something_are_refused(name: str) -> None:
    protocol = PROTOCOLS[name]
    if protocol.references:
        with pytest.raises(ValueError, match=r"level .as_is. must have exactly one .* got 0"):
            compare(name, name_items("tap", ["dft321", "low"]))
    if name not in {"realism", "similarity"}:
        with pytest.raises(ValueError, match="recording 'tap' must have at least one stimulus to"):
            compare(name, name_items("tap", ["original", "low"]))
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
    name: str, options: Any, first: tuple[str], catches: dict[str, str]
) -> None:
    items = name_items("tap", NAMES, LEVELS)
    compared = compare(name, items, **options)
    assert [tuple(name_parts(c)) for c in compared] == [(*first, item.reducer) for item in items]
    caught = {"low": "anchor", "mid": "anchor", **catches}
    assert [c.catch for c in compared] == [caught.get(item.reducer, "") for item in items]
    limits = {"identical": (75, 100), "hidden_reference": (55, 100), "anchor": (0, 50)}
    assert list_expected(compared) == [limits.get(c.catch) for c in compared]
    for item, comparison in zip(items, compared, strict=True):
        (judgement,) = comparison.judgements
        about = SURFACE if first == ("tap",) else f"tap-{''.join(first)}-{item.level}"
        assert (judgement.part, judgement.stimulus_id) == ("test", item.stimulus_id)
        assert judgement.reference_id == (None if name == "realism" else about)


# Choices, by hand.


@pytest.mark.parametrize("reference", ["original", "dft321"])
def test_abx_tells_everything_from_the_reference_in_four_arrangements(reference: str) -> None:
    compared, abx = compare("abx", name_items("tap", NAMES), reference=reference), PROTOCOLS["abx"]
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
    pairs = tasks.choose_pairs(n, count, key=key)
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
    assert tasks.choose_pairs(5, None, key="oak") == tuple(combinations(range(5), 2))
    assert (
        len({tasks.choose_pairs(8, 7, key=name) for name in ("oak", "felt", "slate", "cork")}) == 4
    )


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
    name: str, options: Any, heads: list[str], pairs: Any, certain: str
) -> None:
    compared = compare(name, name_items("tap", NAMES), **options)
    assert [(name_parts(c), c.catch, c.judgements[0].expected) for c in compared] == [
        *(([*heads, *pair], "", None) for pair in combinations(pairs, 2)),
        ([*heads, certain, "low"], "anchor", (100, 100)),
        ([*heads, "mid", certain], "anchor", (0, 0)),
    ]
    about = {"tap": SURFACE}.get(heads[0], f"tap-{heads[0]}-as_is") if heads else None
    about = None if name == "preference" else about
    assert {c.judgements[0].reference_id for c in compared} == {about}


@pytest.mark.parametrize("name", ["triplet", "preference"])
def test_of_two_that_are_chosen_from_each_comes_first_as_often(name: str) -> None:
    items = [item for oak in ("oak", "tap") for item in name_items(oak, NAMES)]
    places: Counter[tuple[str, int]] = Counter()
    for number in (1, 2):
        for trial in make_order(items, [make_task(name)], number=number, repeats=2):
            places.update((str(trial.parts[place].stimulus_id), place) for place in (-2, -1))
    assert all(places[stimulus, -2] == places[stimulus, -1] for stimulus, _ in places)
    lone = name_items("tap", ["dft321", *["original"] * (name == "triplet")])
    with pytest.raises(ValueError, match=f"a {name} must have at least two .* got 1; build"):
        compare(name, lone)
    for other in PROTOCOLS.keys() - {"triplet", "preference"}:
        for trial in make_order(items, [make_task(other)], number=1):
            assert {find_other(trial, judgement) for judgement in trial.judgements} == {None}


# Options of tasks, several scales in a trial, and the groups of a design.

ITEMS = [
    Item("oak-original", "oak", "original", "as_is", "reference"),
    Item("oak-sax321", "oak", "sax321", "as_is", "test"),
    Item("oak-anchor", "oak", "anchor_low", "as_is", "anchor"),
]


@pytest.mark.parametrize(
    ("name", "options", "message"),
    [
        ("loudness", {}, "protocol must be one of realism, similarity, dissimilarity, mushra, abx,"),
        ("mushra", {"timing": "strict"}, "tasks.mushra.timing must be one of free; got 'strict'"),
        ("realism", {"reference": "original"}, "tasks.realism.reference must not be set, got 'orig"),
        ("preference", {"reference": "original"}, "nothing is compared with a reference here"),
        ("abx", {"reference": "surface"}, "one of original, the name of a reducer; got 'surface'"),
        ("dissimilarity", {"reference": "dft321"}, "must be one of original; got 'dft321'"),
        ("similarity", {"reference": ""}, "original, surface, the name of a reducer; got ''"),
        ("similarity", {"surface": True}, "leave it out, or set reference = 'surface'"),
        ("abx", {"surface": True}, "nothing is judged by itself here; leave it out"),
        ("abx", {"training": -1}, "tasks.abx.training must be a whole number from 0, got -1"),
        ("triplet", {"pairs": 0}, "tasks.triplet.pairs must be a whole number from 1, got 0"),
        ("abx", {"pairs": 3}, "must not be set, got 3: only triplet and preference have it; leave"),
        ("abx", {"scales": ["abx", "sure"]}, "several scales are for tasks with one slider"),
        ("mushra", {"scales": ["mushra", "rough"]}, "several scales are for tasks with one slider"),
        ("realism", {"scales": ["roughness"]}, "must hold 'realism', the protocol's own, got"),
        ("realism", {"scales": ["realism", "rough", "rough"]}, "at most 4 names, each once"),
        ("realism", {"scales": ["realism", *"abcd"]}, "at most 4 names, each once"),
        ("realism", {"scales": ["realism", "abx", "mushra"]}, "another task, got 'abx', 'mushra'"),
        ("realism", {"scales": ["realism", "matching"]}, "another task, got 'matching'"),
        ("realism", {"gap_s": 31.0}, "tasks.realism.gap_s must be 0 to 30, got 31"),
        ("realism", {"answer_timeout_s": 0.1}, "answer_timeout_s must be 0.5 to 600, got 0.1"),
        ("realism", {"onset_s": 601.0}, "onset_s must be 0.5 to 600, got 601"),
        ("mushra", {"gap_s": 1.0}, "tasks.mushra.gap_s must not be set: parts are felt at will"),
        ("realism", {"surface": True, "onset_s": 5.0}, "onset_s must not be set where the real surface"),
        ("similarity", {"reference": "surface", "onset_s": 5.0}, "set where the real surface is touched"),
    ],
)  # fmt: skip
def test_what_a_protocol_does_not_have_is_refused(
    name: str, options: dict[str, Any], message: str
) -> None:
    with pytest.raises(ValueError, match=re.escape(message)) as refusal:
        make_task(name, **options)
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize("name", ["realism", "similarity", "dissimilarity"])
def test_each_judgement_is_asked_on_every_scale_in_order(name: str) -> None:
    plain = make_order(ITEMS, [make_task(name)], number=1)
    task = make_task(name, training=2, scales=["roughness", name])
    trials = make_order(ITEMS, [task], number=1)
    assert [trial.parts for trial in trials] == [trial.parts for trial in plain]
    assert trials.to_frame()["scale"].tolist() == ["roughness", name] * len(trials)
    for trial, former in zip(trials, plain, strict=True):
        (part,) = former.judged
        assert (trial.judged, trial.scale) == ([f"{part}:roughness", part], name)
        assert trial.judgements[1] == former.judgements[0]
        assert trial.judgements[0].expected is None
        values = {part: 80.0, f"{part}:roughness": 10.0}
        assert tasks.score_trial(trial, values) == values
        assert tasks.is_as_expected(trial, values) == tasks.is_as_expected(former, {part: 80.0})
    lessons = make_rehearsal(ITEMS, [task], first_number=1, rng=np.random.default_rng(1))
    assert [[bool(j.expected) for j in one.judgements] for one in lessons] == [[False, True]] * 2
    assert make_task(name, scales=[name]) == make_task(name)


@given(st.lists(st.integers(1, 4), max_size=4), st.integers(1, 600))
def test_successive_participants_go_through_all_combinations_in_order(
    sizes: list[int], number: int
) -> None:
    between = {f"factor{f}": [f"level{n}" for n in range(size)] for f, size in enumerate(sizes)}
    combinations = list(product(*between.values()))
    groups, place = place_in_groups(between, number)
    assert list(groups) == list(between)
    assert tuple(groups.values()) == combinations[(number - 1) % len(combinations)]
    assert place == (number - 1) // len(combinations) + 1


def test_a_group_has_its_own_levels_and_tasks_and_shared_references() -> None:
    items = [Item("t-x", "t", "dft321", "x", "test"), Item("t-y", "t", "dft321", "y", "test")]
    shared = Item("t-o", "t", "original", "x", "reference")
    both = [make_task("realism"), make_task("abx")]
    assert select_items([*items, shared], {"level": "y"}) == (items[1], shared)
    assert select_items([*items, shared], {"grip": "pen"}) == (*items, shared)
    own = select_group([*items, shared], both, {"protocol": "abx", "level": "y"})
    assert own == ((items[1], shared), (both[1],))
    assert select_group(items, both, {}) == (tuple(items), tuple(both))
