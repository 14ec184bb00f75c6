"""Catch trials: stimuli about which someone who has understood the task cannot be of any opinion.

- *identical*: the reference against itself is as good as the reference, 90 points or more;
- *hidden_reference*: the recording itself, judged by itself or against the real surface, is more real than not;
- *anchor*: a stimulus that was made to be rated badly is not as good as the reference, 90 points or less.

The two limits of 90 points are those by which BS.1534-3 excludes raters [1]_. It has one for the better of two anchors
only, so it holds for the worse one all the more, and no anchor needs to be known by its name.

References
----------
.. [1] ITU-R BS.1534-3, "Method for the subjective assessment of intermediate quality level of audio systems", 2015
   (post-screening of assessors).
"""

from __future__ import annotations

from types import MappingProxyType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Mapping

    from protocols.trial import Item

EXPECTED: Mapping[str, tuple[float, float]] = MappingProxyType(
    {"identical": (90.0, 100.0), "hidden_reference": (50.0, 100.0), "anchor": (0.0, 90.0)}
)
"""Kind of catch -> lowest and highest rating to expect, where 100 points mean that nothing is missing."""


def find_catch(item: Item, reference: Item | None) -> str:
    """Tell whether, and why, the right answer about a stimulus is known.

    Parameters
    ----------
    item : Item
        What is judged.
    reference : Item or None
        What it is judged against; None where that is the real surface, or where the judgement is absolute.

    Returns
    -------
    str
        A key of `EXPECTED`, or empty.

    Examples
    --------
    >>> from protocols.trial import Item
    >>> original = Item("tap-original", "tap", "original", "as_is", "reference")
    >>> find_catch(original, original), find_catch(original, None)
    ('identical', 'hidden_reference')
    """
    if item == reference:
        return "identical"
    if item.role == "reference" and reference is None:
        return "hidden_reference"
    return "anchor" if item.role == "anchor" else ""
