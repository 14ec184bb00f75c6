"""Catch trials: stimuli about which someone who has understood the task cannot be of any opinion.

- *identical*: the reference against itself is as good as the reference, 75 points or more;
- *hidden_reference*: the recording itself, judged by itself or against the real surface, is more real than not, 55
  points or more;
- *anchor*: a stimulus that was made to be rated badly is not more good than not, 50 points or less.

The limits say whether a task was understood, no more: the upper quarter of the scale is for what is as good as the
reference. No answer is right for both a reference and an anchor, nor are two that differ by less than 5 points, so
nobody passes who always answers the same. Raters are screened in the analysis, by the limits of BS.1534-3 (90
points) [1]_. The limit for anchors holds for the better of two and all the more for the worse, so none needs to be
known by its name.

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

EXPECTED: Mapping[str, tuple[float, float]] = MappingProxyType({
    "identical": (75.0, 100.0),
    "hidden_reference": (55.0, 100.0),
    "anchor": (0.0, 50.0),
})
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
