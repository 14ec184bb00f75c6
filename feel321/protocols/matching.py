"""Strength matched by the participant: the method of adjustment, a check of stimuli that should be equally strong.

A trial holds the recording itself, `first`, and a stimulus that was made of it, `second`. The participant moves a
marker and feels both again, until the second is as strong as the first. The marker moves the level of the second by
`DB_PER_POINT`, around a level that is drawn for each trial, so that its place tells nothing. Both are played
`ATTENUATION_DB` weaker than in the study, which leaves room for the strongest second.

The recording is matched with itself too: what is not 0 dB there is how participants use the marker, and the error of
time of the second interval.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

from feel321.protocols.arms import find_reference
from feel321.protocols.trial import MATCHING, ORIGINAL, RATING_RANGE, Item, Judgement, Part, Trial

FIRST, SECOND = "first", "second"
"""Names of the parts; the answer is about the second."""

DB_PER_POINT = 0.15
MOST_START_DB = 4.5
"""The second begins up to so much weaker or stronger than as it is in the study."""

MIDDLE = sum(RATING_RANGE) / 2
"""Marker that leaves the second as it was at first."""

ATTENUATION_DB = MOST_START_DB + DB_PER_POINT * (RATING_RANGE[1] - MIDDLE)


@dataclass(frozen=True, slots=True)
class MatchingBlock:
    """The settings of a matching block.

    level: the level arm that is matched. repeats: of each pair. starts_db: how much stronger the second is at first, of
    each trial in order; none before a participant is planned.
    """

    level: str
    repeats: int = 1
    starts_db: tuple[float, ...] = ()


def draw_matching(
    block: MatchingBlock | None, items: Sequence[Item], *, first_number: int, key: Sequence[int]
) -> tuple[MatchingBlock | None, tuple[Trial, ...]]:
    """Draw the block of a participant, if there is one: trials in random order, and the levels at which they begin."""
    import numpy as np

    if block is None:
        return None, ()
    rng = np.random.default_rng(key)
    pairs = [pair for pair in _list_pairs(block, items) for _ in range(block.repeats)]
    order = rng.permutation(len(pairs)).tolist()
    starts = rng.uniform(-MOST_START_DB, MOST_START_DB, len(pairs)).round(2)
    trials = tuple(
        Trial(
            number=number,
            block=1,
            repeat=0,
            protocol=MATCHING,
            scale=MATCHING,
            timing="replay",
            recording=pairs[place][1].recording,
            parts=tuple(
                Part(name, item.stimulus_id)
                for name, item in zip((FIRST, SECOND), pairs[place], strict=True)
            ),
            judgements=(
                Judgement(SECOND, pairs[place][1].stimulus_id, pairs[place][0].stimulus_id),
            ),
            phase=MATCHING,
        )
        for number, place in enumerate(order, start=first_number)
    )
    return replace(block, starts_db=tuple(starts.tolist())), trials


def _list_pairs(block: MatchingBlock, items: Sequence[Item]) -> Iterator[tuple[Item, Item]]:
    """List reference and stimulus of every pair, the reference with itself among them."""
    for recording in dict.fromkeys(item.recording for item in items):
        own = [item for item in items if item.recording == recording]
        tests = [item for item in own if (item.role, item.level) == ("test", block.level)]
        if tests:
            reference = find_reference(tests[0], own, reference=ORIGINAL)
            yield from ((reference, item) for item in (reference, *tests))


class Matching:
    """A participant's matching block: how much stronger than in the study each second is played."""

    def __init__(self, block: MatchingBlock, trials: Sequence[Trial]) -> None:
        own = [trial.number for trial in trials if trial.phase == MATCHING]
        self._starts = dict(zip(own, block.starts_db, strict=True))

    def find_offset(self, trial: int, points: float = MIDDLE) -> float:
        """Find how much stronger than in the study a second is with the marker in a place, in dB."""
        return self._starts[trial] + DB_PER_POINT * (points - MIDDLE)
