"""A section of a session: one task, with what is to be judged in it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from protocols.registry import PROTOCOLS
from protocols.trial import Trial

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from protocols.protocol import Task
    from protocols.trial import Comparison, Item

    Groups = Mapping[str, Sequence[Comparison]]
    """What is to be judged of each recording."""

    Spot = tuple[str, int]
    """A comparison, by its recording and its index there."""


@dataclass(frozen=True, slots=True)
class Section:
    """One task of a session, with what is to be judged in it.

    Parameters
    ----------
    task : Task
        The task.
    groups : mapping of str to sequence of Comparison
        The comparisons of each recording. A recording without any is left out.
    lessons : mapping of str to sequence of Comparison
        The same, with what is known of them in training, then what comes in training only.
    """

    task: Task
    groups: Groups
    lessons: Groups

    def draft_trial(self, spot: Spot, *, turn: int, phase: str = "main") -> Trial:
        """Make a trial of a comparison, before it has a number, a block and a repeat.

        Parameters
        ----------
        spot : tuple of str and int
            The comparison, by its recording and its index there.
        turn : int
            Turn of the participant. The arrangement also moves on from comparison to comparison and from
            recording to recording, so that none keeps its arrangement throughout a session.
        phase : str
            What it is for: `training`, `practice` or `main`.

        Returns
        -------
        Trial
            The draft; its number, block and repeat are 0.
        """
        recording, index = spot
        protocol = PROTOCOLS[self.task.protocol]
        comparisons = self.lessons if phase == "training" else self.groups
        chosen = protocol.arrange(comparisons[recording][index], turn + index + list(self.groups).index(recording))
        return Trial(
            number=0,
            block=0,
            repeat=0,
            protocol=protocol.name,
            scale=protocol.scale,
            timing=self.task.timing,
            recording=recording,
            parts=chosen.parts,
            judgements=chosen.judgements,
            phase=phase,
            catch=chosen.catch,
        )


def make_sections(items: Sequence[Item], tasks: Sequence[Task]) -> tuple[Section, ...]:
    """Let each task say what it judges of the stimuli.

    Parameters
    ----------
    items : sequence of Item
        All stimuli of the set.
    tasks : sequence of Task
        The tasks, in order.

    Returns
    -------
    tuple of Section
        One per task.

    Raises
    ------
    ValueError
        If there are no stimuli or no tasks, or a task finds nothing to judge.
    """
    for name, things in {"items": items, "tasks": tasks}.items():
        if not things:
            raise ValueError(f"{name}: got none, an order needs at least one")
    by_recording: dict[str, list[Item]] = {}
    for item in items:
        by_recording.setdefault(item.recording, []).append(item)
    return tuple(_make_section(by_recording, task) for task in tasks)


def _make_section(by_recording: Mapping[str, Sequence[Item]], task: Task) -> Section:
    protocol = PROTOCOLS[task.protocol]
    compared = {name: protocol.compare(own, task) for name, own in by_recording.items()}
    if groups := {name: comparisons for name, comparisons in compared.items() if comparisons}:
        return Section(task, groups, {name: protocol.teach(by_recording[name], task) for name in groups})
    raise ValueError(f"{task.protocol}: got stimuli of which none is to be judged; build a set with reducers to test")
