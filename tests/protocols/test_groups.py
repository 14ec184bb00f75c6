from __future__ import annotations

from itertools import product

from hypothesis import given
from hypothesis import strategies as st

from feel321.protocols.tasks import make_task
from feel321.protocols.trial import Item, place_in_groups, select_group, select_items


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


def test_combinations_are_counted_and_not_listed() -> None:
    between = {f"factor{n}": ["off", "on"] for n in range(80)}
    groups, place = place_in_groups(between, 2**80 + 2)
    assert (place, groups["factor79"], groups["factor78"]) == (2, "on", "off")


def test_a_group_has_its_own_levels_and_tasks_and_shared_references() -> None:
    items = [Item("t-x", "t", "dft321", "x", "test"), Item("t-y", "t", "dft321", "y", "test")]
    shared = Item("t-o", "t", "original", "x", "reference")
    tasks = [make_task("realism"), make_task("abx")]
    assert select_items([*items, shared], {"level": "y"}) == (items[1], shared)
    assert select_items([*items, shared], {"grip": "pen"}) == (*items, shared)
    own = select_group([*items, shared], tasks, {"protocol": "abx", "level": "y"})
    assert own == ((items[1], shared), (tasks[1],))
    assert select_group(items, tasks, {}) == (tuple(items), tuple(tasks))
