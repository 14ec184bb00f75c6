"""Similarity: the reference of a recording is felt first, then a stimulus that is rated against it.

The reference is judged against itself too: a rater who hears a difference there gives themselves away.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from protocols.trial import Comparison, Item, Protocol

if TYPE_CHECKING:
    from collections.abc import Sequence


def compare(items: Sequence[Item]) -> tuple[Comparison, ...]:
    """Every item of a recording, judged against the recording's reference of the same level arm.

    Parameters
    ----------
    items : sequence of Item
        All stimuli of one recording.

    Returns
    -------
    tuple of Comparison
        One per item, in the same order.

    Raises
    ------
    ValueError
        If an item's recording has no reference, or several that could be meant.

    Examples
    --------
    >>> reference = Item("tap-original", "tap", "as_is", "reference")
    >>> compare([Item("tap-dft321", "tap", "as_is", "test"), reference])[0]
    Comparison(stimulus_id='tap-dft321', reference_id='tap-original')
    """
    return tuple(Comparison(item.stimulus_id, _find_reference(item, items)) for item in items)


def _find_reference(item: Item, items: Sequence[Item]) -> str:
    references = [other for other in items if other.role == "reference"]
    # A set may render its references once, or once per level arm; the arm's own comes first.
    own = [other for other in references if other.level == item.level] or references
    if len(own) != 1:
        raise ValueError(
            f"recording {item.recording!r}, level {item.level!r}: got {len(own)} reference stimuli, "
            "similarity needs exactly one; build the stimulus set with a reference"
        )
    return own[0].stimulus_id


SIMILARITY = Protocol(name="similarity", scale="similarity", compare=compare)
"""The protocol as it stands in the registry."""
