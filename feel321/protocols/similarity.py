"""Similarity: the participant feels a reference, then a stimulus, and says how similar the second was to the first.

100 points mean identical. The reference is the recording itself, the real surface, or what a reducer made of the
recording, as in the study of seven reducers by Park and Kuchenbecker [1]_. The reference is judged against itself too:
a participant who feels a difference there gives themselves away. Nothing is identical to the real surface; there the
recording itself takes the place of the hidden reference.

Parts may be felt again unless a study asks for strict timing, in which Muschter et al. [2]_ presented theirs.

References
----------
.. [1] Park, G., & Kuchenbecker, K. J. (2019). Objective and subjective assessment of algorithms for reducing
   three-axis vibrations to one-axis vibrations. IEEE World Haptics Conference. doi:10.1109/WHC.2019.8816148
.. [2] Muschter, E., et al. (2021). Perceptual quality assessment of compressed vibrotactile signals through comparative
   judgment. IEEE Transactions on Haptics, 14(2). doi:10.1109/TOH.2021.3077191
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from feel321.protocols.trial import (
    EXPECTED,
    ORIGINAL,
    SURFACE,
    Comparison,
    Judgement,
    Part,
    Protocol,
    find_catch,
    find_reference,
    keep_arrangement,
    score_slider,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    from feel321.protocols.trial import Item, Task


def compare(items: Sequence[Item], task: Task) -> tuple[Comparison, ...]:
    """Judge every stimulus of a recording against the recording's reference of the same level arm."""
    return tuple(_compare_one(item, items, reference=task.reference) for item in items)


def _compare_one(item: Item, items: Sequence[Item], *, reference: str) -> Comparison:
    found = None if reference == SURFACE else find_reference(item, items, reference=reference)
    catch = find_catch(item, found)
    first = (
        Part("reference", found.stimulus_id) if found else Part("reference", surface=item.recording)
    )
    judgement = Judgement(
        "test", item.stimulus_id, first.stimulus_id or SURFACE, EXPECTED.get(catch)
    )
    return Comparison((first, Part("test", item.stimulus_id)), (judgement,), catch)


SIMILARITY = Protocol(
    name="similarity",
    scale="similarity",
    factors=("recording", "reducer", "level"),
    timings=("replay", "strict"),
    references=(ORIGINAL, SURFACE, "reducer"),
    compare=compare,
    teach=compare,
    arrange=keep_arrangement,
    score=score_slider,
)
"""The protocol as it stands in the registry."""
