from __future__ import annotations

from collections import Counter
from itertools import pairwise
from typing import TYPE_CHECKING

import pytest

from feel321.protocols.compare import MUSHRA_MOST
from feel321.protocols.tasks import PROTOCOLS, make_task
from feel321.protocols.trial import Part

if TYPE_CHECKING:
    from collections.abc import Callable

    from feel321.protocols.trial import Comparison, Item

    MakeItems = Callable[..., list[Item]]

MUSHRA = PROTOCOLS["mushra"]
NAMES = ("sax321", "dft321", "original", "low", "mid")


def name_pages(n: int) -> tuple[str, ...]:
    """A page of n stimuli: the hidden reference, two anchors, else reducers."""
    return (*(f"r{i}" for i in range(n - 3)), "original", "low", "mid")


def slots_of(page: Comparison) -> list[str | None]:
    assert [part.name for part in page.parts] == [
        "reference",
        *(str(n) for n in range(1, len(page.parts))),
    ]
    assert [(j.part, j.stimulus_id) for j in page.judgements] == [
        (p.name, p.stimulus_id) for p in page.parts[1:]
    ]
    return [part.stimulus_id for part in page.parts[1:]]


def test_a_page_holds_one_arm_of_one_recording_and_names_its_reference(
    make_items: MakeItems,
) -> None:
    levels = ("as_is", "equal_intensity")
    pages = MUSHRA.compare(make_items("tap", NAMES, levels), make_task("mushra"))
    assert [page.parts[0] for page in pages] == [
        Part("reference", f"tap-original-{level}") for level in levels
    ]
    assert [slots_of(page) for page in pages] == [
        [f"tap-{name}-{level}" for name in NAMES] for level in levels
    ]
    assert {j.reference_id for j in pages[1].judgements} == {"tap-original-equal_intensity"}


def test_the_hidden_reference_and_the_anchors_are_expected_where_the_standard_puts_them(
    make_items: MakeItems,
) -> None:
    (page,) = MUSHRA.compare(make_items("tap", NAMES), make_task("mushra"))
    assert [j.expected for j in page.judgements] == [None, None, (75, 100), (0, 50), (0, 50)]


def test_what_a_reducer_made_can_be_the_reference(make_items: MakeItems) -> None:
    (page,) = MUSHRA.compare(make_items("tap", NAMES), make_task("mushra", reference="dft321"))
    assert page.parts[0] == Part("reference", "tap-dft321-as_is")
    assert [j.expected for j in page.judgements] == [None, (75, 100), None, (0, 50), (0, 50)]


@pytest.mark.parametrize("n", [5, 6, 12])
def test_over_a_cycle_of_turns_the_slots_are_balanced(n: int, make_items: MakeItems) -> None:
    (page,) = MUSHRA.compare(make_items("tap", name_pages(n)), make_task("mushra"))
    times = 1 + n % 2
    rows = [slots_of(MUSHRA.arrange(page, turn)) for turn in range(times * n)]
    assert all(sorted(map(str, row)) == sorted(map(str, slots_of(page))) for row in rows)
    places = Counter((place, stimulus_id) for row in rows for place, stimulus_id in enumerate(row))
    assert (len(places), set(places.values())) == (n * n, {times})
    neighbours = Counter(pair for row in rows for pair in pairwise(row))
    assert (len(neighbours), set(neighbours.values())) == (n * (n - 1), {times})
    assert MUSHRA.arrange(page, times * n) == MUSHRA.arrange(page, 0)


def test_what_is_expected_moves_with_its_stimulus(make_items: MakeItems) -> None:
    (page,) = MUSHRA.compare(make_items("tap", NAMES), make_task("mushra"))
    for turn in range(10):
        expected = {j.stimulus_id: j.expected for j in MUSHRA.arrange(page, turn).judgements}
        assert expected == {j.stimulus_id: j.expected for j in page.judgements}


def test_twelve_fill_a_page_and_thirteen_are_refused(make_items: MakeItems) -> None:
    (page,) = MUSHRA.compare(make_items("tap", name_pages(MUSHRA_MOST)), make_task("mushra"))
    assert len(page.judgements) == 12
    with pytest.raises(
        ValueError,
        match=r"a page of mushra must have at most 12 stimuli .* got 13; build a set of fewer reducers",
    ):
        MUSHRA.compare(make_items("tap", name_pages(MUSHRA_MOST + 1)), make_task("mushra"))
