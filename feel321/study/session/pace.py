"""The pace of trials, where a task has its own: silence before parts, time for an answer, and fixed onsets."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from feel321.protocols.trial import FREE

if TYPE_CHECKING:
    from collections.abc import Mapping

    from feel321.protocols.trial import Flow, Task, Trial

TIMED_OUT = "timed_out"
"""Flag of an attempt that was not answered in time, and key of the page that says so."""

TOLD_S = 1.0
"""How long that page stays at least: a key that came just too late for the answer must not take it away unread."""

LATE_S = 0.1
"""A trial that begins so much after it was due moves the schedule; what is less does not add up."""


def find_gap(trial: Trial, task: Task | None, flow: Flow) -> float:
    """Find the silence before each part of a trial, in s."""
    if trial.timing == FREE:
        return 0.0
    return flow.gap_s if task is None or task.gap_s is None else task.gap_s


@dataclass(slots=True)
class Schedule:
    """The schedule of a session; tasks: of the plan, by protocol.

    Onsets are fixed from one trial to the next of a task; a page, a pause or a resumed session begins a new schedule.
    """

    tasks: Mapping[str, Task] = field(default_factory=dict)
    timed_out: bool = False
    _due_s: float | None = None
    _protocol: str = ""

    def find_limit(self, trial: Trial) -> float | None:
        """Find the time for an answer, in s; None for any."""
        task = self.tasks.get(trial.protocol)
        return task.answer_timeout_s if task else None

    def is_fixed(self, trial: Trial) -> bool:
        """Whether trials of this task have fixed onsets."""
        task = self.tasks.get(trial.protocol)
        return bool(task and task.onset_s)

    def find_due(self, trial: Trial) -> float | None:
        """Find when a trial is due to begin, in s since the session began; None if it may begin at once."""
        return self._due_s if trial.protocol == self._protocol else None

    def note_onset(self, trial: Trial, onset_s: float) -> None:
        """Take the onset of a trial, from which the next one is due."""
        task, due_s = self.tasks.get(trial.protocol), self.find_due(trial)
        if task is None or task.onset_s is None:
            return
        begun_s = onset_s if due_s is None or onset_s > due_s + LATE_S else due_s
        self._protocol, self._due_s = trial.protocol, begun_s + task.onset_s

    def restart(self) -> None:
        """Begin a new schedule with the next trial."""
        self._due_s, self.timed_out = None, False
