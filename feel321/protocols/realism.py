"""Realism: the participant feels one stimulus and says how real it felt, from not at all to like the real surface.

Where the lab has the real surface at hand, it is stroked before each stimulus. Every stimulus of a recording is judged
by itself, the recording's own vibration and the anchors among them.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from feel321.protocols.trial import (
    EXPECTED,
    SURFACE,
    Comparison,
    Judgement,
    Part,
    Protocol,
    find_catch,
    keep_arrangement,
    score_slider,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    from feel321.protocols.trial import Item, Task


def compare(items: Sequence[Item], task: Task) -> tuple[Comparison, ...]:
    """Judge every stimulus of a recording by itself."""
    return tuple(_compare_one(item, surface=task.surface) for item in items)


def _compare_one(item: Item, *, surface: bool) -> Comparison:
    felt_first = (Part(SURFACE, surface=item.recording),) if surface else ()
    catch = find_catch(item, None)
    return Comparison(
        parts=(*felt_first, Part("test", item.stimulus_id)),
        judgements=(Judgement("test", item.stimulus_id, expected=EXPECTED.get(catch)),),
        catch=catch,
    )


REALISM = Protocol(
    name="realism",
    scale="realism",
    factors=("recording", "reducer", "level"),
    timings=("replay", "strict"),
    references=(),
    compare=compare,
    teach=compare,
    arrange=keep_arrangement,
    score=score_slider,
)
"""The protocol as it stands in the registry."""
