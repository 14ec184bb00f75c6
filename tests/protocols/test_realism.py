from __future__ import annotations

from typing import TYPE_CHECKING

from feel321.protocols.tasks import PROTOCOLS, make_task
from feel321.protocols.trial import Part

if TYPE_CHECKING:
    from feel321.protocols.trial import Item

REALISM = PROTOCOLS["realism"]


def test_every_stimulus_is_judged_by_itself(items: list[Item]) -> None:
    comparisons = REALISM.compare(items, make_task("realism"))
    assert [c.parts for c in comparisons] == [(Part("test", item.stimulus_id),) for item in items]
    assert [c.judgements[0].stimulus_id for c in comparisons] == [
        item.stimulus_id for item in items
    ]


def test_the_real_surface_of_the_recording_is_felt_first_where_the_lab_has_it(
    items: list[Item],
) -> None:
    comparisons = REALISM.compare(items, make_task("realism", surface=True))
    assert [c.parts for c in comparisons] == [
        (Part("surface", surface=item.recording), Part("test", item.stimulus_id)) for item in items
    ]
    assert {c.judgements[0].part for c in comparisons} == {"test"}


def test_the_recording_itself_is_more_real_than_not_and_an_anchor_is_not(items: list[Item]) -> None:
    comparisons = REALISM.compare(items[:6], make_task("realism"))
    assert [(c.catch, c.judgements[0].expected) for c in comparisons] == [("", None)] * 4 + [
        ("hidden_reference", (55, 100)),
        ("anchor", (0, 50)),
    ]


def test_nothing_has_to_change_place(items: list[Item]) -> None:
    comparison = REALISM.compare(items, make_task("realism"))[0]
    assert REALISM.arrange(comparison, 7) == comparison
