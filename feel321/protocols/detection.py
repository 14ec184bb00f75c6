"""The threshold block of a session: its trials, and what each of them presents.

A trial has two intervals, and the participant says which of them held the vibration. Plan and agenda know how many
trials there are, as of any task. Which interval vibrates, and how strongly, follows from the answers that counted so
far: a trial that was rejected is presented alike when it comes again, and a session that is resumed tells what its
journal holds and goes on with the same sequence.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from feel321.protocols.threshold import Presentation, Procedure, ThresholdPlan, resume
from feel321.protocols.trial import Judgement, Part, Trial

if TYPE_CHECKING:
    from collections.abc import Mapping

THRESHOLD = "threshold"
"""Protocol, scale and phase of the trials of the block; its practice has the phase of all practice."""

INTERVALS = ("first", "second")
"""Names of the two intervals, and of the answers."""

ASKED = "test"
"""Name of what the answer is about: the vibration, in whichever interval it was."""


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
        yield Trial(
            number=number,
            block=place + 1 if phase == THRESHOLD else 0,
            repeat=0,
            protocol=THRESHOLD,
            scale=THRESHOLD,
            timing="strict",
            recording=tone,
            parts=tuple(Part(name, tone) for name in INTERVALS),
            judgements=(Judgement(ASKED, tone),),
            phase=phase,
        )


@dataclass(slots=True)
class Detection:
    """A participant's threshold block: what comes next at each frequency, and what was answered."""

    block: ThresholdBlock
    _procedures: dict[str, Procedure] = field(init=False)

    def __post_init__(self) -> None:
        """Begin all procedures."""
        block = self.block
        self._procedures = {
            name_tone(frequency): resume(block.procedure, replace(block.plan, seed=seed))
            for frequency, seed in zip(block.frequencies_hz, block.seeds, strict=True)
        }

    def find_frequency(self, trial: Trial) -> float:
        """Find the frequency of a trial, in Hz."""
        named = {name_tone(frequency): frequency for frequency in self.block.frequencies_hz}
        return named[trial.recording]

    def present(self, trial: Trial) -> Presentation:
        """Return what a trial presents if it comes now."""
        if trial.phase == THRESHOLD:
            following = self._procedures[trial.recording].next()
            if following is None:
                raise ValueError(f"all trials of {trial.recording} are answered, got one more")
            return following
        import numpy as np

        rng = np.random.default_rng([self.block.seeds[0], trial.number])
        return Presentation(int(rng.integers(1, 3)), self.block.plan.start_db)

    def tell(self, trial: Trial, values: Mapping[str, float | str]) -> None:
        """Take an answer that counts; that of practice changes nothing."""
        if trial.phase == THRESHOLD:
            self._procedures[trial.recording].update(INTERVALS.index(str(values[ASKED])) + 1)

    def list_procedures(self) -> dict[float, Procedure]:
        """List the procedures by frequency in Hz, from the lowest."""
        return {
            frequency: self._procedures[name_tone(frequency)]
            for frequency in sorted(self.block.frequencies_hz)
        }
