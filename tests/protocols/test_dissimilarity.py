from __future__ import annotations

from collections import Counter
from itertools import combinations
from typing import TYPE_CHECKING

import pytest
from hypothesis import given
from hypothesis import strategies as st

from feel321.protocols.tasks import PROTOCOLS, make_task

if TYPE_CHECKING:
    from collections.abc import Callable

    from feel321.protocols.trial import Comparison, Item

    MakeItems = Callable[..., list[Item]]

DISSIMILARITY = PROTOCOLS["dissimilarity"]
LEE_2022 = ("saz321", "soc321", "mag321", "dft321", "pca321", "original")
TASK = make_task("dissimilarity")


def order_of(comparison: Comparison) -> tuple[str | None, ...]:
    return tuple(part.stimulus_id for part in comparison.parts)


@given(n=st.integers(1, 12), n_levels=st.integers(1, 3))
def test_every_unordered_pair_comes_once_in_each_arm_and_one_identical_pair(
    n: int, n_levels: int, make_items: MakeItems
) -> None:
    names, levels = (
        (*(f"r{i}" for i in range(n)), "original"),
        [f"level{i}" for i in range(n_levels)],
    )
    comparisons = DISSIMILARITY.compare(make_items("tap", names, levels), TASK)
    pairs = Counter(frozenset(order_of(c)) for c in comparisons)
    assert pairs == Counter(
        frozenset(f"tap-{name}-{level}" for name in pair)
        for level in levels
        for pair in [*combinations(names, 2), ("original", "original")]
    )


def test_lee_2022_has_fifteen_pairs_and_the_catch(make_items: MakeItems) -> None:
    comparisons = DISSIMILARITY.compare(make_items("tap", LEE_2022), TASK)
    assert Counter(c.catch for c in comparisons) == {"": 15, "identical": 1}
    assert {c.catch: c.judgements[0].expected for c in comparisons} == {
        "": None,
        "identical": (0, 25),
    }


def test_anchors_take_no_part(make_items: MakeItems) -> None:
    with_anchors = make_items("tap", (*LEE_2022, "low", "mid"))
    assert DISSIMILARITY.compare(with_anchors, TASK) == DISSIMILARITY.compare(
        with_anchors[:6], TASK
    )


@pytest.mark.parametrize("turn", range(4))
def test_the_other_comes_first_on_odd_turns(turn: int, make_items: MakeItems) -> None:
    for comparison in DISSIMILARITY.compare(make_items("tap", LEE_2022), TASK):
        arranged = DISSIMILARITY.arrange(comparison, turn)
        assert order_of(arranged) == order_of(comparison)[:: -1 if turn % 2 else 1]
        (judgement,) = arranged.judgements
        assert (judgement.part, judgement.reference_id, judgement.stimulus_id) == (
            "second",
            *order_of(arranged),
        )
        assert [part.name for part in arranged.parts] == ["first", "second"]


def test_over_two_turns_every_stimulus_comes_first_as_often_as_second(
    make_items: MakeItems,
) -> None:
    arranged = [
        DISSIMILARITY.arrange(comparison, turn)
        for turn in (0, 1)
        for comparison in DISSIMILARITY.compare(make_items("tap", LEE_2022), TASK)
    ]
    first, second = (
        Counter(order_of(comparison)[place] for comparison in arranged) for place in (0, 1)
    )
    assert first == second
    assert len(first) == 6
