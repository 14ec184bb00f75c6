"""Level arms: stimuli of one recording are compared with one another inside their arm only."""

from __future__ import annotations

from typing import TYPE_CHECKING

from protocols.groups import select_items

if TYPE_CHECKING:
    from collections.abc import Sequence

    from protocols.trial import Item


def split_arms(items: Sequence[Item]) -> tuple[tuple[Item, ...], ...]:
    """Split the stimuli of a recording into its level arms.

    Parameters
    ----------
    items : sequence of Item
        All stimuli of one recording.

    Returns
    -------
    tuple of tuple of Item
        The stimuli of each arm that has something to test, in the order of the set. A reference that the set
        has only once serves every arm.

    Raises
    ------
    ValueError
        If there is nothing to test.
    """
    levels = tuple(dict.fromkeys(item.level for item in items if item.role == "test"))
    if not levels:
        recordings = ", ".join(repr(name) for name in dict.fromkeys(item.recording for item in items))
        raise ValueError(
            f"recording {recordings or 'unknown'}: got no stimulus to test, allowed is one or more; "
            "name reducers and build the stimulus set again"
        )
    return tuple(select_items(items, {"level": level}) for level in levels)
