"""Dissimilarity: the participant feels two stimuli and says how different they were; 0 points mean identical.

All pairs of the reducers and the recording itself are judged, so that multidimensional scaling can draw the space in
which they differ, as Lee et al. did [1]_. One more pair holds the recording itself twice: a participant who feels a
difference there gives themselves away. Anchors would stretch the space, and take no part but in training, where they
are what certainly differs from the recording. Which of the two comes first changes with every turn.

References
----------
.. [1] Lee, H., Tombak, G. I., Park, G., & Kuchenbecker, K. J. (2022). Perceptual space of algorithms for three-to-one
   dimensional reduction of realistic vibrations. IEEE Transactions on Haptics, 15(3). doi:10.1109/TOH.2022.3174229
"""

from __future__ import annotations

from itertools import combinations
from typing import TYPE_CHECKING

from feel321.protocols.trial import (
    EXPECTED,
    ORIGINAL,
    RATING_RANGE,
    Comparison,
    Judgement,
    Part,
    Protocol,
    find_reference,
    score_slider,
    split_arms,
)

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from feel321.protocols.trial import Item, Task


def compare(items: Sequence[Item], task: Task) -> tuple[Comparison, ...]:  # noqa: ARG001 - every task has this form
    """Judge all pairs of the reducers and the original of a recording, within each level arm."""
    return tuple(comparison for arm in split_arms(items) for comparison in _compare_arm(arm))


def teach(items: Sequence[Item], task: Task) -> tuple[Comparison, ...]:
    """Show also how the anchors differ from the original."""
    obvious = (
        _compare_pair(
            find_reference(item, arm, reference=ORIGINAL).stimulus_id,
            item.stimulus_id,
            catch="anchor",
        )
        for arm in split_arms(items)
        for item in arm
        if item.role == "anchor"
    )
    return (*compare(items, task), *obvious)


def arrange(comparison: Comparison, turn: int) -> Comparison:
    """Let the other stimulus come first on every odd turn."""
    first, second = (str(part.stimulus_id) for part in comparison.parts)
    return _compare_pair(second, first, catch=comparison.catch) if turn % 2 else comparison


def _compare_arm(arm: Sequence[Item]) -> Iterator[Comparison]:
    original = find_reference(arm[0], arm, reference=ORIGINAL)
    compared = [original, *(item for item in arm if item.role == "test")]
    for first, second in combinations(compared, 2):
        yield _compare_pair(first.stimulus_id, second.stimulus_id)
    yield _compare_pair(original.stimulus_id, original.stimulus_id, catch="identical")


def _compare_pair(first: str, second: str, *, catch: str = "") -> Comparison:
    return Comparison(
        parts=(Part("first", first), Part("second", second)),
        judgements=(
            Judgement("second", second, first, _turn_round(EXPECTED[catch]) if catch else None),
        ),
        catch=catch,
    )


def _turn_round(expected: tuple[float, float]) -> tuple[float, float]:
    """Say in points of difference what is expected in points of likeness."""
    lowest, highest = expected
    return sum(RATING_RANGE) - highest, sum(RATING_RANGE) - lowest


DISSIMILARITY = Protocol(
    name="dissimilarity",
    scale="dissimilarity",
    factors=("recording", "pair", "level"),
    timings=("replay", "strict"),
    references=(ORIGINAL,),
    compare=compare,
    teach=teach,
    arrange=arrange,
    score=score_slider,
)
"""The protocol as it stands in the registry."""
