"""Blocks before the trials that are rated: detection thresholds, and strength matched by the participant.

Threshold: a trial has two intervals, and the participant says which of them held the vibration. Plan and agenda know
how many trials there are, as of any task. Which interval vibrates, and how strongly, follows from the answers that
counted so far: a trial that was rejected is presented alike when it comes again, and a session that is resumed tells
what its journal holds and goes on with the same sequence.

Matching (the method of adjustment): a check of stimuli that should be equally strong. A trial holds the recording
itself, `first`, and a stimulus that was made of it, `second`. The participant moves a marker and feels both again,
until the second is as strong as the first. The marker moves the level of the second by `DB_PER_POINT`, around a level
that is drawn for each trial, so that its place tells nothing. Both are played `ATTENUATION_DB` weaker than in the
study, which leaves room for the strongest second. The recording is matched with itself too: what is not 0 dB there is
how participants use the marker, and the error of time of the second interval.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

from feel321.protocols.compare import find_reference
from feel321.protocols.threshold import Presentation, Procedure, ThresholdPlan, resume
from feel321.protocols.trial import MATCHING, RATING_RANGE, THRESHOLD, Item, Judgement, Part, Trial

INTERVALS = FIRST, SECOND = ("first", "second")
"""Names of the parts: the two intervals, of which one is answered, and what is matched with what."""

ASKED = "test"
"""Name of what the answer to a threshold trial is about: the vibration, in whichever interval it was."""


@dataclass(frozen=True, slots=True)
class ThresholdBlock:
    """The settings of a threshold block; frequencies are measured one after the other, in this order.

    plan: of each of them, but for its seed. duration_s: of each interval. gap_s: silence before each interval.
    practice: trials at the starting level that do not count. seeds: one per frequency; none before a participant is
    planned.
    """

    procedure: str
    frequencies_hz: tuple[float, ...]
    plan: ThresholdPlan
    duration_s: float = 0.5
    gap_s: float = 0.5
    practice: int = 3
    seeds: tuple[int, ...] = ()


def draw_block(block: ThresholdBlock, *, seed: int, number: int) -> ThresholdBlock:
    """Draw the block of participant `number` (from 1): another frequency comes first each time."""
    import numpy as np

    turn = (number - 1) % len(block.frequencies_hz)
    order = block.frequencies_hz[turn:] + block.frequencies_hz[:turn]
    seeds = np.random.default_rng([seed, number, len(order)]).integers(2**31, size=len(order))
    return replace(block, frequencies_hz=order, seeds=tuple(seeds.tolist()))


def name_tone(frequency_hz: float) -> str:
    """Name the vibration of a frequency, where a trial names its stimulus.

    Examples
    --------
    >>> name_tone(62.5)
    '62.5 Hz'
    """
    return f"{frequency_hz:g} Hz"


def make_block(block: ThresholdBlock, *, first_number: int) -> Iterator[Trial]:
    """Make the trials of a block, practice first."""
    turns = [(0, "practice")] * block.practice
    for place in range(len(block.frequencies_hz)):
        turns += [(place, THRESHOLD)] * block.plan.presentations
    for number, (place, phase) in enumerate(turns, start=first_number):
        tone = name_tone(block.frequencies_hz[place])
        parts, judged = tuple(Part(name, tone) for name in INTERVALS), (Judgement(ASKED, tone),)
        own = place + 1 if phase == THRESHOLD else 0
        yield Trial(
            number, own, 0, THRESHOLD, THRESHOLD, "strict", tone, parts, judged, phase=phase
        )


class Detection:
    """A participant's threshold block: what comes next at each frequency, and what was answered."""

    def __init__(self, block: ThresholdBlock) -> None:
        self.block = block
        self._procedures = {
            frequency: resume(block.procedure, replace(block.plan, seed=seed))
            for frequency, seed in zip(block.frequencies_hz, block.seeds, strict=True)
        }

    def find_frequency(self, trial: Trial) -> float:
        """Find the frequency of a trial, in Hz."""
        return {name_tone(frequency): frequency for frequency in self._procedures}[trial.recording]

    def present(self, trial: Trial) -> Presentation:
        """Return what a trial presents if it comes now."""
        if trial.phase == THRESHOLD:
            following = self._procedures[self.find_frequency(trial)].next()
            if following is None:
                raise ValueError(f"all trials of {trial.recording} are answered, got one more")
            return following
        import numpy as np

        rng = np.random.default_rng([self.block.seeds[0], trial.number])
        return Presentation(int(rng.integers(1, 3)), self.block.plan.start_db)

    def tell(self, trial: Trial, values: Mapping[str, float | str]) -> None:
        """Take an answer that counts; that of practice changes nothing."""
        if trial.phase == THRESHOLD:
            answer = INTERVALS.index(str(values[ASKED])) + 1
            self._procedures[self.find_frequency(trial)].update(answer)

    def list_procedures(self) -> dict[float, Procedure]:
        """List the procedures by frequency in Hz, from the lowest."""
        return dict(sorted(self._procedures.items()))


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
    trials = []
    for number, place in enumerate(order, start=first_number):
        first, second = pairs[place]
        parts = (Part(FIRST, first.stimulus_id), Part(SECOND, second.stimulus_id))
        judged = (Judgement(SECOND, second.stimulus_id, first.stimulus_id),)
        names = (MATCHING, MATCHING, "replay", second.recording)
        trials.append(Trial(number, 1, 0, *names, parts, judged, phase=MATCHING))
    return replace(block, starts_db=tuple(starts.tolist())), tuple(trials)


def _list_pairs(block: MatchingBlock, items: Sequence[Item]) -> Iterator[tuple[Item, Item]]:
    """List reference and stimulus of every pair, the reference with itself among them."""
    for recording in dict.fromkeys(item.recording for item in items):
        own = [item for item in items if item.recording == recording]
        tests = [item for item in own if (item.role, item.level) == ("test", block.level)]
        if tests:
            reference = find_reference(tests[0], own)
            yield from ((reference, item) for item in (reference, *tests))


class Matching:
    """A participant's matching block: how much stronger than in the study each second is played."""

    def __init__(self, block: MatchingBlock, trials: Sequence[Trial]) -> None:
        own = [trial.number for trial in trials if trial.phase == MATCHING]
        self._starts = dict(zip(own, block.starts_db, strict=True))

    def find_offset(self, trial: int, points: float = MIDDLE) -> float:
        """Find how much stronger than in the study a second is with the marker in a place, in dB."""
        return self._starts[trial] + DB_PER_POINT * (points - MIDDLE)
