"""ABX: the participant feels a, b and x, and says which of the first two x was.

One of a and b is a stimulus, the other its reference; x is one of them again. 100 points mean right, 0 wrong, so that
the mean over trials is the percentage correct: 50 for someone who feels no difference. This is the task behind "not
perceptibly different" [1]_. An anchor is told from the reference by everyone who has understood.

References
----------
.. [1] Macmillan, N. A., & Creelman, C. D. (2005). Detection theory: A user's guide (2nd ed.), chapter 9.
   doi:10.4324/9781410611147
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from feel321.protocols.trial import (
    ORIGINAL,
    RATING_RANGE,
    Comparison,
    Judgement,
    Part,
    Protocol,
    find_catch,
    find_reference,
    split_arms,
)

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from feel321.protocols.trial import Item, Task

CHOICES = ("a", "b")
"""Names of the parts between which the participant chooses."""

WRONG, RIGHT = RATING_RANGE


def compare(items: Sequence[Item], task: Task) -> tuple[Comparison, ...]:
    """Tell every stimulus of a recording from the reference of its level arm."""
    return tuple(
        _compare_pair(item, reference)
        for arm in split_arms(items)
        for reference in [find_reference(arm[0], arm, reference=task.reference)]
        for item in arm
        if item != reference
    )


def teach(items: Sequence[Item], task: Task) -> tuple[Comparison, ...]:
    """Say of every comparison what is right: x was one of the two, however hard they are to tell apart."""
    return tuple(
        replace(
            comparison,
            judgements=tuple(replace(j, expected=(RIGHT, RIGHT)) for j in comparison.judgements),
        )
        for comparison in compare(items, task)
    )


def arrange(comparison: Comparison, turn: int) -> Comparison:
    """Take one of the four arrangements: which stimulus is a, and which of the two comes again as x."""
    (judgement,) = comparison.judgements
    pair = (judgement.stimulus_id, judgement.reference_id)[:: -1 if turn % 2 else 1]
    again = pair[turn // 2 % 2]
    parts = tuple(
        Part(name, stimulus_id)
        for name, stimulus_id in zip((*CHOICES, "x"), (*pair, again), strict=True)
    )
    return Comparison(parts, comparison.judgements, comparison.catch)


def score(judgement: Judgement, answer: float | str, parts: Mapping[str, str | None]) -> float:
    """Tell whether x was what the participant took it for."""
    if answer not in CHOICES:
        raise ValueError(f"answer: got {answer!r}, allowed: {', '.join(CHOICES)}")
    return RIGHT if parts[str(answer)] == parts[judgement.part] else WRONG


def _compare_pair(item: Item, reference: Item) -> Comparison:
    catch = find_catch(item, reference)
    expected = (RIGHT, RIGHT) if catch else None
    judgement = Judgement("x", item.stimulus_id, reference.stimulus_id, expected)
    return arrange(Comparison((), (judgement,), catch), 0)


ABX = Protocol(
    name="abx",
    scale="abx",
    factors=("recording", "reducer", "level"),
    timings=("replay", "strict"),
    references=(ORIGINAL, "reducer"),
    compare=compare,
    teach=teach,
    arrange=arrange,
    score=score,
    choices=CHOICES,
)
"""The protocol as it stands in the registry."""
