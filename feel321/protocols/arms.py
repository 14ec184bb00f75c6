"""The stimuli of one recording: its level arms, the reference of each, and catch trials with their expected answers."""

from collections.abc import Mapping, Sequence
from types import MappingProxyType

from feel321.protocols.trial import ORIGINAL, Comparison, Item, select_items

Items = Sequence[Item]
Comparisons = tuple[Comparison, ...]

EXPECTED: Mapping[str, tuple[float, float]] = MappingProxyType({
    "identical": (75.0, 100.0),
    "hidden_reference": (55.0, 100.0),
    "anchor": (0.0, 50.0),
})
"""Catch trials: kind -> lowest and highest rating to expect, where 100 points mean that nothing is missing.

The reference against itself is *identical*, the recording judged by itself or against the real surface a *hidden
reference*; *anchors* should be rated 50 or lower, the better of two as well, so none needs to be known by name. The
limits say whether a task was understood, no more: the upper quarter of the scale is for what is as good as the
reference. No answer is right for both a reference and an anchor, nor are two that differ by less than 5 points, so
nobody passes who always answers the same. Raters are screened in the analysis, by the limits of BS.1534-3 (90 points).
"""


def find_catch(item: Item, reference: Item | None) -> str:
    """Find the kind of catch trial that a stimulus makes beside its reference; empty for none."""
    if item == reference:
        return "identical"
    if item.role == "reference" and reference is None:
        return "hidden_reference"
    return "anchor" if item.role == "anchor" else ""


def find_reference(item: Item, items: Items, *, reference: str) -> Item:
    """Find the reference of an item."""
    if reference == ORIGINAL:
        candidates = [other for other in items if other.role == "reference"]
    else:
        candidates = [o for o in items if o.reducer == reference and o.role == "test"]
    # A set may render its references once, or once per level arm; the arm's own comes first.
    own = [other for other in candidates if other.level == item.level] or candidates
    if len(own) != 1:
        raise ValueError(
            f"recording {item.recording!r}, level {item.level!r} must have exactly one stimulus for the reference "
            f"{reference!r}, got {len(own)}; build the stimulus set with it"
        )
    return own[0]


def split_arms(items: Items) -> tuple[tuple[Item, ...], ...]:
    """Split the stimuli of a recording into its level arms: they are compared with one another inside an arm only."""
    levels = dict.fromkeys(item.level for item in items if item.role == "test")
    if not levels:
        recordings = ", ".join(dict.fromkeys(repr(item.recording) for item in items)) or "unknown"
        raise ValueError(
            f"recording {recordings} must have at least one stimulus to test, got none; "
            "name reducers and build the stimulus set again"
        )
    return tuple(select_items(items, {"level": level}) for level in levels)
