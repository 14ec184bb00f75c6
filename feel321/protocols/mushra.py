"""MUSHRA: many stimuli on one page, each with a slider, and a reference that is named as such.

The participant switches freely between them and says how well each matches the reference; 100 points mean just like it.
Among them are, unnamed, the reference itself and two anchors that were made to be rated badly [1]_. What is low-passed
for audio is no anchor below 1 kHz, so a stimulus set brings haptic ones; Muschter et al. [2]_ brought the method to
vibrations. A page holds one level arm of one recording.

References
----------
.. [1] ITU-R BS.1534-3, "Method for the subjective assessment of intermediate quality level of audio systems", 2015.
.. [2] Muschter, E., et al. (2021). Perceptual quality assessment of compressed vibrotactile signals through comparative
   judgment. IEEE Transactions on Haptics, 14(2). doi:10.1109/TOH.2021.3077191
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from feel321.protocols.balance import williams_square
from feel321.protocols.trial import (
    EXPECTED,
    ORIGINAL,
    Comparison,
    Judgement,
    Part,
    Protocol,
    find_catch,
    find_reference,
    score_slider,
    split_arms,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    from feel321.protocols.trial import Item, Task

MOST = 12
"""Most stimuli on a page, the hidden reference and the anchors among them (BS.1534-3)."""


def compare(items: Sequence[Item], task: Task) -> tuple[Comparison, ...]:
    """Put each level arm of a recording on one page."""
    return tuple(_compare_arm(arm, reference=task.reference) for arm in split_arms(items))


def arrange(comparison: Comparison, turn: int) -> Comparison:
    """Put the stimuli of a page in the order of the row of a Williams square whose turn it is."""
    square = williams_square(len(comparison.judgements))
    return _fill_page(
        comparison.parts[0], [comparison.judgements[i] for i in square[turn % len(square)]]
    )


def _compare_arm(arm: Sequence[Item], *, reference: str) -> Comparison:
    if len(arm) > MOST:
        raise ValueError(
            f"recording {arm[0].recording!r}, level {arm[0].level!r}: got {len(arm)} stimuli for a page of mushra, "
            f"allowed are at most {MOST} with the hidden reference and the anchors; build a set of fewer reducers"
        )
    found = find_reference(arm[0], arm, reference=reference)
    return _fill_page(
        Part("reference", found.stimulus_id),
        [
            Judgement(
                "", item.stimulus_id, found.stimulus_id, EXPECTED.get(find_catch(item, found))
            )
            for item in arm
        ],
    )


def _fill_page(reference: Part, judgements: Sequence[Judgement]) -> Comparison:
    numbered = tuple(
        replace(judgement, part=str(place)) for place, judgement in enumerate(judgements, start=1)
    )
    parts = (Part(judgement.part, judgement.stimulus_id) for judgement in numbered)
    return Comparison((reference, *parts), numbered)


MUSHRA = Protocol(
    name="mushra",
    scale="mushra",
    factors=("recording", "level"),
    timings=("free",),
    references=(ORIGINAL, "reducer"),
    compare=compare,
    teach=compare,
    arrange=arrange,
    score=score_slider,
)
"""The protocol as it stands in the registry."""
