"""Factors in which participants differ: who belongs to which group, and what is felt there."""

from __future__ import annotations

from math import prod
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from protocols.protocol import Task
    from protocols.trial import Item

CHOOSING = ("level", "protocol")
"""Factors that decide what is felt; any other is a label."""


def place_in_groups(between: Mapping[str, Sequence[str]], number: int) -> tuple[dict[str, str], int]:
    """Tell which group a participant belongs to, and as which of it.

    Parameters
    ----------
    between : mapping of str to sequence of str
        Levels of each factor.
    number : int
        The participant's number in the study, from 1.

    Returns
    -------
    groups : dict of str to str
        The participant's level of each factor. Successive participants go to successive groups.
    place : int
        The participant's number within the group, from 1: it takes a row of the design.

    Examples
    --------
    >>> place_in_groups({"grip": ["pen", "power"]}, 4)
    ({'grip': 'power'}, 2)
    """
    place, turn = divmod(number - 1, prod(len(levels) for levels in between.values()))
    groups: dict[str, str] = {}
    for factor, levels in reversed(list(between.items())):  # the last factor changes fastest
        turn, level = divmod(turn, len(levels))
        groups[factor] = levels[level]
    return {factor: groups[factor] for factor in between}, place + 1


def select_items(items: Sequence[Item], groups: Mapping[str, str]) -> tuple[Item, ...]:
    """Keep the stimuli that a group feels.

    Parameters
    ----------
    items : sequence of Item
        All stimuli.
    groups : mapping of str to str
        The group's level of each factor.

    Returns
    -------
    tuple of Item
        Those of its level arm, references without an arm of their own among them; all where levels do not differ
        between groups.
    """
    if (level := groups.get("level")) is None:
        return tuple(items)
    own = [item for item in items if item.level == level]
    served = {item.recording for item in own if item.role == "reference"}
    shared = [item for item in items if item.role == "reference" and item.recording not in served]
    return tuple(own + shared)


def select_tasks(tasks: Sequence[Task], groups: Mapping[str, str]) -> tuple[Task, ...]:
    """Keep the tasks that a group has.

    Parameters
    ----------
    tasks : sequence of Task
        All tasks.
    groups : mapping of str to str
        The group's level of each factor.

    Returns
    -------
    tuple of Task
        Its own; all where tasks do not differ between groups.
    """
    own = groups.get("protocol")
    return tuple(task for task in tasks if own in {None, task.protocol})
