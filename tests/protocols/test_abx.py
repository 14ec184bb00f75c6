from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING

import pytest

from feel321.protocols.compare import CHOICES
from feel321.protocols.tasks import PROTOCOLS, make_task
from feel321.protocols.texts import list_languages, read_scales

if TYPE_CHECKING:
    from collections.abc import Callable

    from feel321.protocols.trial import Comparison, Item

    MakeItems = Callable[..., list[Item]]

ABX = PROTOCOLS["abx"]
NAMES = ("sax321", "dft321", "original", "low")
TEST, REFERENCE = "tap-dft321-as_is", "tap-original-as_is"


def compare(make_items: MakeItems, reference: str | None = None) -> tuple[Comparison, ...]:
    return ABX.compare(make_items("tap", NAMES), make_task("abx", reference=reference))


def stimuli_of(comparison: Comparison) -> dict[str, str | None]:
    return {part.name: part.stimulus_id for part in comparison.parts}


@pytest.mark.parametrize("reference", ["original", "dft321"])
def test_everything_but_the_reference_is_told_from_it(
    reference: str, make_items: MakeItems
) -> None:
    judged = [
        judgement
        for comparison in compare(make_items, reference)
        for judgement in comparison.judgements
    ]
    assert [j.stimulus_id for j in judged] == [
        f"tap-{name}-as_is" for name in NAMES if name != reference
    ]
    assert {(j.part, j.reference_id) for j in judged} == {("x", f"tap-{reference}-as_is")}


def test_four_successive_turns_give_each_arrangement_once(make_items: MakeItems) -> None:
    comparison = compare(make_items)[1]
    for start in range(5):
        arranged = [ABX.arrange(comparison, turn) for turn in range(start, start + 4)]
        assert Counter(tuple(stimuli_of(c).items()) for c in arranged) == Counter(
            (("a", a), ("b", b), ("x", x))
            for a, b in [(TEST, REFERENCE), (REFERENCE, TEST)]
            for x in (a, b)
        )


def test_an_arrangement_does_not_depend_on_the_one_before(make_items: MakeItems) -> None:
    comparison = compare(make_items)[1]
    for before in range(4):
        for turn in range(4):
            assert ABX.arrange(ABX.arrange(comparison, before), turn) == ABX.arrange(
                comparison, turn
            )


def score_four(comparison: Comparison, answer: Callable[[dict[str, str | None]], str]) -> float:
    """Mean score over the four arrangements of someone who answers by what they felt."""
    arranged = [ABX.arrange(comparison, turn) for turn in range(4)]
    scores = [ABX.score(c.judgements[0], answer(stimuli_of(c)), stimuli_of(c)) for c in arranged]
    assert set(scores) <= {0, 100}
    return sum(scores) / 4


def test_who_feels_the_difference_scores_100_and_who_does_not_50(make_items: MakeItems) -> None:
    for comparison in compare(make_items):
        assert score_four(comparison, lambda felt: "a" if felt["a"] == felt["x"] else "b") == 100
        assert score_four(comparison, lambda felt: "b" if felt["a"] == felt["x"] else "a") == 0
        assert score_four(comparison, lambda _: "a") == 50
        assert score_four(comparison, lambda _: "b") == 50
        assert score_four(comparison, lambda felt: "a" if felt["a"] == REFERENCE else "b") == 50


@pytest.mark.parametrize("answer", ["x", "c", 50.0])
def test_an_answer_that_is_no_choice_is_refused(answer: str | float, make_items: MakeItems) -> None:
    comparison = compare(make_items)[0]
    with pytest.raises(ValueError, match=f"answer must be one of a, b; got {str(answer)!r}"):
        ABX.score(comparison.judgements[0], answer, stimuli_of(comparison))


def test_only_an_anchor_must_be_told_from_the_reference(make_items: MakeItems) -> None:
    comparisons = compare(make_items)
    assert [(c.catch, c.judgements[0].expected) for c in comparisons] == [
        ("", None),
        ("", None),
        ("anchor", (100, 100)),
    ]


@pytest.mark.parametrize("language", list_languages())
def test_the_catalogue_offers_the_choices_that_are_scored(language: str) -> None:
    assert read_scales(language)["abx"].choices == CHOICES
