"""Realism: one stimulus is felt and rated by itself.

Every stimulus of a recording is judged once, the hidden reference and the anchors among them.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from protocols.trial import Comparison, Item, Protocol

if TYPE_CHECKING:
    from collections.abc import Sequence


def compare(items: Sequence[Item]) -> tuple[Comparison, ...]:
    """Every item of a recording, judged without a reference.

    Parameters
    ----------
    items : sequence of Item
        All stimuli of one recording.

    Returns
    -------
    tuple of Comparison
        One per item, in the same order.

    Examples
    --------
    >>> compare([Item("tap-dft321", "tap", "as_is", "test")])
    (Comparison(stimulus_id='tap-dft321', reference_id=None),)
    """
    return tuple(Comparison(item.stimulus_id) for item in items)


REALISM = Protocol(name="realism", scale="realism", compare=compare)
"""The protocol as it stands in the registry."""
