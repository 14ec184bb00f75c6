"""What holds for every rating task, whatever it asks."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from typing import TYPE_CHECKING

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from feel321.protocols.compare import EXPECTED
from feel321.protocols.tasks import PROTOCOLS, make_task, measure_chance
from feel321.protocols.texts import list_languages, read_scales
from feel321.protocols.trial import RATING_RANGE, SURFACE, TIMINGS, Judgement, Trial

if TYPE_CHECKING:
    from collections.abc import Callable

    from feel321.protocols.trial import Comparison, Item, Task

    Drawn = dict[str, tuple[str, ...]]
    MakeItems = Callable[..., list[Item]]

REDUCERS = tuple(f"reducer{n}" for n in range(9))
SETS = st.fixed_dictionaries({
    "reducers": st.integers(1, 9).map(lambda n: REDUCERS[:n]),
    "anchors": st.sampled_from([(), ("low",), ("low", "mid")]),
    "levels": st.sampled_from([("as_is",), ("as_is", "equal_intensity")]),
})


def all_tasks() -> list[Task]:
    """Every form of every protocol."""
    return [
        make_task(name, timing=timing, reference=reference, surface=surface)
        for name, protocol in PROTOCOLS.items()
        for timing in protocol.timings
        for reference in [
            kind if kind != "reducer" else REDUCERS[0] for kind in protocol.references
        ]
        or [None]
        for surface in ([False] if protocol.references else [False, True])
    ]


def describe(task: Task) -> str:
    return f"{task.protocol}-{task.timing}-{task.reference}" + "-surface" * task.surface


def draw_comparisons(task: Task, drawn: Drawn, make_items: MakeItems) -> tuple[Comparison, ...]:
    return PROTOCOLS[task.protocol].compare(
        make_items("tap", list_names(task, drawn), drawn["levels"]), task
    )


def list_names(task: Task, drawn: Drawn) -> tuple[str, ...]:
    """The stimuli of a set; a triplet has two reducers to choose from besides the one that may be the reference."""
    reducers = (
        drawn["reducers"]
        if task.protocol != "triplet"
        else REDUCERS[: max(3, len(drawn["reducers"]))]
    )
    return (*reducers, "original", *drawn["anchors"])


def find_winner(comparison: Comparison) -> str | None:
    """The stimulus that must be chosen, if any must."""
    (judgement,) = comparison.judgements
    felt = {part.name: part.stimulus_id for part in comparison.parts}
    assert felt["a"] == judgement.stimulus_id
    return felt["ab"[judgement.expected[0] == 0]] if judgement.expected else None


every_task = pytest.mark.parametrize("task", all_tasks(), ids=describe)
few = settings(max_examples=25)  # there are 54 sets


def test_registry_lists_every_protocol_under_its_own_name() -> None:
    assert list(PROTOCOLS) == [
        "realism",
        "similarity",
        "dissimilarity",
        "mushra",
        "abx",
        "triplet",
        "preference",
    ]
    assert all(name == protocol.name == protocol.scale for name, protocol in PROTOCOLS.items())
    with pytest.raises(TypeError, match="does not support item assignment"):
        PROTOCOLS["realism"] = PROTOCOLS["abx"]  # type: ignore[index] - that it is refused is the point


@pytest.mark.parametrize("name", PROTOCOLS)
def test_what_a_protocol_declares_is_known(name: str) -> None:
    protocol = PROTOCOLS[name]
    assert set(protocol.timings) <= set(TIMINGS)
    assert {"recording", "level"} <= set(protocol.factors)


@every_task
@few
@given(drawn=SETS, turn=st.integers(0, 50))
def test_every_part_and_every_judgement_is_whole(
    task: Task, drawn: Drawn, turn: int, make_items: MakeItems
) -> None:
    for comparison in draw_comparisons(task, drawn, make_items):
        arranged = PROTOCOLS[task.protocol].arrange(comparison, turn)
        parts = {part.name: part for part in arranged.parts}
        assert len(parts) == len(arranged.parts)
        assert all((part.stimulus_id is None) != (part.surface is None) for part in arranged.parts)
        felt = {part.stimulus_id for part in arranged.parts}
        about = {SURFACE if part.surface else part.stimulus_id for part in arranged.parts} | {None}
        assert arranged.judgements
        for judgement in arranged.judgements:
            assert judgement.part in parts
            assert judgement.stimulus_id in felt
            assert judgement.reference_id in about


@every_task
@few
@given(drawn=SETS)
def test_what_is_judged_against_something_was_felt_beside_it(
    task: Task, drawn: Drawn, make_items: MakeItems
) -> None:
    absolute = not PROTOCOLS[task.protocol].references
    for comparison in draw_comparisons(task, drawn, make_items):
        assert {judgement.reference_id is None for judgement in comparison.judgements} == {absolute}
        if task.reference == SURFACE or task.surface:
            assert comparison.parts[0].surface == "tap"
        else:
            assert not any(part.surface for part in comparison.parts)


@every_task
@few
@given(drawn=SETS)
def test_names_of_parts_reveal_nothing(task: Task, drawn: Drawn, make_items: MakeItems) -> None:
    comparisons = draw_comparisons(task, drawn, make_items)
    assert len({tuple(part.name for part in comparison.parts) for comparison in comparisons}) == 1
    words = {"original", "hidden", "low", "mid", "anchor", *REDUCERS}
    assert not words & {part.name for comparison in comparisons for part in comparison.parts}


@every_task
@few
@given(drawn=SETS)
def test_nothing_is_judged_across_level_arms(
    task: Task, drawn: Drawn, make_items: MakeItems
) -> None:
    for comparison in draw_comparisons(task, drawn, make_items):
        assert (
            len({
                part.stimulus_id.rpartition("-")[2] for part in comparison.parts if part.stimulus_id
            })
            == 1
        )


@every_task
@few
@given(drawn=SETS)
def test_no_comparison_comes_twice(task: Task, drawn: Drawn, make_items: MakeItems) -> None:
    comparisons = draw_comparisons(task, drawn, make_items)
    # The same three stimuli make three triplets, each with another reference.
    felt = Counter(
        (
            c.judgements[0].reference_id,
            frozenset(Counter(part.stimulus_id for part in c.parts).items()),
        )
        if PROTOCOLS[task.protocol].choices
        else frozenset(Counter(part.stimulus_id for part in c.parts).items())
        for c in comparisons
    )
    assert set(felt.values()) == {1}


@every_task
@few
@given(drawn=SETS, turn=st.integers(0, 50))
def test_arranging_moves_what_is_felt_and_changes_nothing_else(
    task: Task, drawn: Drawn, turn: int, make_items: MakeItems
) -> None:
    def gist(comparison: Comparison) -> tuple[list[str], set[str | None], Counter[object], str]:
        pairs: Counter[object] = Counter(
            (frozenset({judgement.stimulus_id, judgement.reference_id}), judgement.expected)
            if judgement.part not in PROTOCOLS[task.protocol].choices
            else (judgement.reference_id, find_winner(comparison))
            for judgement in comparison.judgements
        )
        felt = {part.stimulus_id for part in comparison.parts}
        return [part.name for part in comparison.parts], felt, pairs, comparison.catch

    for comparison in draw_comparisons(task, drawn, make_items):
        assert gist(PROTOCOLS[task.protocol].arrange(comparison, turn)) == gist(comparison)


@every_task
@few
@given(drawn=SETS)
def test_a_catch_is_where_something_is_expected(
    task: Task, drawn: Drawn, make_items: MakeItems
) -> None:
    for comparison in draw_comparisons(task, drawn, make_items):
        expected = [judgement.expected for judgement in comparison.judgements if judgement.expected]
        assert comparison.catch in {"", *EXPECTED}
        if len(comparison.judgements) == 1:
            assert bool(expected) == bool(comparison.catch)
        low, high = RATING_RANGE
        assert all(low <= least <= most <= high for least, most in expected)


@every_task
@few
@given(drawn=SETS)
def test_training_shows_what_is_judged_and_all_that_is_known_of_it(
    task: Task, drawn: Drawn, make_items: MakeItems
) -> None:
    names = list_names(task, drawn)
    judged = draw_comparisons(task, drawn, make_items)
    taught = PROTOCOLS[task.protocol].make_lessons(make_items("tap", names, drawn["levels"]), task)
    for comparison, lesson in zip(judged, taught, strict=False):
        assert (lesson.parts, lesson.catch) == (comparison.parts, comparison.catch)
        for judgement, told in zip(comparison.judgements, lesson.judgements, strict=True):
            assert told == replace(judgement, expected=told.expected)
            assert judgement.expected in {None, told.expected}
    assert len(taught) >= len(judged)
    assert all(lesson.judgements[0].expected for lesson in taught[len(judged) :])


def test_a_guess_is_right_on_every_slider_or_by_one_choice_of_all(make_items: MakeItems) -> None:
    chances = {}
    for name, protocol in PROTOCOLS.items():
        *_, last = protocol.compare(
            make_items("tap", ("sax321", "dft321", "original", "low", "mid")), make_task(name)
        )
        chances[name] = measure_chance(
            Trial(1, 0, 0, name, name, "replay", "tap", last.parts, last.judgements, "training")
        )
    assert chances == {
        "realism": 0.5,
        "similarity": 0.5,
        "dissimilarity": 0.25,
        "mushra": 0.25 * 0.5**2,
        "abx": 0.5,
        "triplet": 0.5,
        "preference": 0.5,
    }


@pytest.mark.parametrize(
    "name", [name for name, protocol in PROTOCOLS.items() if not protocol.choices]
)
def test_a_slider_gives_its_points(name: str) -> None:
    assert PROTOCOLS[name].score(Judgement("test", "tap"), 62.5, {"test": "tap"}) == 62.5


@pytest.mark.parametrize("name", ["dissimilarity", "mushra", "abx", "triplet", "preference"])
def test_a_recording_without_anything_to_test_is_refused(name: str, make_items: MakeItems) -> None:
    with pytest.raises(
        ValueError,
        match="recording 'tap' must have at least one stimulus to test, got none; name reducers",
    ):
        PROTOCOLS[name].compare(make_items("tap", ["original", "low"]), make_task(name))


@pytest.mark.parametrize(
    "name", [name for name, protocol in PROTOCOLS.items() if protocol.references]
)
def test_a_recording_without_its_reference_is_refused(name: str, make_items: MakeItems) -> None:
    with pytest.raises(
        ValueError,
        match="level 'as_is' must have exactly one stimulus for the reference 'original', got 0; bui",
    ):
        PROTOCOLS[name].compare(make_items("tap", ["dft321", "low"]), make_task(name))


@pytest.mark.parametrize("name", ["dissimilarity", "mushra", "abx"])
def test_a_reference_that_the_set_has_once_serves_every_arm(
    name: str, make_items: MakeItems
) -> None:
    shared = [
        *make_items("tap", ["original"]),
        *make_items("tap", ["dft321"], ["as_is", "equal_intensity"]),
    ]
    comparisons = PROTOCOLS[name].compare(shared, make_task(name))
    arms = [
        {part.stimulus_id for part in comparison.parts}
        for comparison in comparisons
        if comparison.catch != "identical"
    ]
    assert arms == [
        {"tap-original-as_is", f"tap-dft321-{level}"} for level in ("as_is", "equal_intensity")
    ]


@pytest.mark.parametrize("language", list_languages())
def test_every_language_has_every_scale(language: str) -> None:
    scales = read_scales(language)
    assert {protocol.scale for protocol in PROTOCOLS.values()} <= set(scales)
    assert all(scale.question and scale.low_label != scale.high_label for scale in scales.values())
