from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from feel321.protocols.tasks import PROTOCOLS, make_task
from feel321.protocols.trial import SURFACE, Part

if TYPE_CHECKING:
    from collections.abc import Callable

    from feel321.protocols.trial import Item

    MakeItems = Callable[..., list[Item]]

SIMILARITY = PROTOCOLS["similarity"]
NAMES = ("sax321", "dft321", "original", "low", "mid")


def test_every_stimulus_is_felt_after_the_original_and_judged_against_it(
    make_items: MakeItems,
) -> None:
    tap = make_items("tap", NAMES)
    comparisons = SIMILARITY.compare(tap, make_task("similarity"))
    assert [c.parts for c in comparisons] == [
        (Part("reference", "tap-original-as_is"), Part("test", item.stimulus_id)) for item in tap
    ]
    assert [(j.part, j.stimulus_id, j.reference_id) for c in comparisons for j in c.judgements] == [
        ("test", item.stimulus_id, "tap-original-as_is") for item in tap
    ]


@pytest.mark.parametrize(
    ("reference", "catches"),
    [
        ("original", ["", "", "identical", "anchor", "anchor"]),
        ("dft321", ["", "identical", "", "anchor", "anchor"]),
        (SURFACE, ["", "", "hidden_reference", "anchor", "anchor"]),
    ],
)
def test_catches_follow_from_the_reference(
    reference: str, catches: list[str], make_items: MakeItems
) -> None:
    comparisons = SIMILARITY.compare(
        make_items("tap", NAMES), make_task("similarity", reference=reference)
    )
    assert [c.catch for c in comparisons] == catches
    expected = {"": None, "identical": (75, 100), "hidden_reference": (55, 100), "anchor": (0, 50)}
    assert [c.judgements[0].expected for c in comparisons] == [expected[catch] for catch in catches]


def test_the_real_surface_can_be_the_reference(make_items: MakeItems) -> None:
    comparison = SIMILARITY.compare(
        make_items("tap", ["dft321"]), make_task("similarity", reference=SURFACE)
    )[0]
    assert comparison.parts == (Part("reference", surface="tap"), Part("test", "tap-dft321-as_is"))
    assert comparison.judgements[0].reference_id == SURFACE


@pytest.mark.parametrize("reference", ["original", "dft321"])
def test_the_reference_is_of_the_items_own_level(reference: str, make_items: MakeItems) -> None:
    own = make_items("tap", NAMES, ["as_is", "equal_intensity"])
    comparisons = SIMILARITY.compare(own, make_task("similarity", reference=reference))
    assert [c.judgements[0].reference_id for c in comparisons] == [
        f"tap-{reference}-{item.level}" for item in own
    ]


def test_falls_back_on_the_only_reference(make_items: MakeItems) -> None:
    shared = [*make_items("tap", ["dft321"], ["equal_intensity"]), *make_items("tap", ["original"])]
    comparisons = SIMILARITY.compare(shared, make_task("similarity"))
    assert [c.judgements[0].reference_id for c in comparisons] == ["tap-original-as_is"] * 2


def test_two_references_of_other_arms_are_refused(make_items: MakeItems) -> None:
    unclear = [
        *make_items("tap", ["dft321"], ["loud"]),
        *make_items("tap", ["original"], ["as_is", "soft"]),
    ]
    with pytest.raises(
        ValueError,
        match="level 'loud' must have exactly one stimulus for the reference 'original', got 2",
    ):
        SIMILARITY.compare(unclear, make_task("similarity"))


def test_a_reducer_that_the_set_does_not_have_is_refused(make_items: MakeItems) -> None:
    with pytest.raises(ValueError, match="exactly one stimulus for the reference 'pca321', got 0"):
        SIMILARITY.compare(make_items("tap", NAMES), make_task("similarity", reference="pca321"))
