"""One participant working through a plan: the loop, against ports only.

A session is resumed by replaying its journal: what was rated is done, all else is asked again.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from protocols.flow import Page
from study.session.conduct import Stage, Stopped, conduct_page, conduct_trial
from study.session.ports import Place
from study.session.replay import find_elapsed, has_event, replay, tell

if TYPE_CHECKING:
    from collections.abc import Callable

    from protocols.agenda import Agenda
    from study.session.plan import Plan

DEVICE_ERRORS = 2
"""Failures of the device in a row that end the session: trials must not be used up on a dead device."""


@dataclass(frozen=True, slots=True)
class Outcome:
    """How a session ended.

    Parameters
    ----------
    done, total : int
        Trials of the main phase that are done, and all of them.
    stopped : str
        Why it ended before its end; empty if it did not.
    """

    done: int
    total: int
    stopped: str = ""


def run_session(plan: Plan, stage: Stage, *, on_step: Callable[[Place], None] | None = None) -> Outcome:
    """Present all that is not done yet.

    Parameters
    ----------
    plan : Plan
        The plan.
    stage : Stage
        Who presents, what, and where it is recorded.
    on_step : callable, optional
        Called with how far the session has come, at its opening and after every page and trial.

    Returns
    -------
    Outcome
        Whether it came to its end; if not, the same call goes on.
    """
    agenda = replay(plan, stage.journal.records)
    try:
        _work_through(plan, agenda, stage, on_step=on_step)
    except Stopped as stop:
        reason, time_s = stop.args
        stage.journal.write("aborted", {"reason": reason, "time_s": time_s})
        return Outcome(agenda.done, agenda.total, reason)
    except BaseException as error:
        if stage.journal.is_open:
            words = f"{type(error).__name__}: {error}".removesuffix(": ")
            stage.journal.write("aborted", {"reason": words, "time_s": find_elapsed(stage.journal.records)})
        raise
    if not has_event(stage.journal.records, "finished"):
        stage.journal.write("finished", {"trials": agenda.done, "given_up": agenda.given_up})
    return Outcome(agenda.done, agenda.total)


def _work_through(
    plan: Plan, agenda: Agenda, stage: Stage, *, on_step: Callable[[Place], None] | None
) -> None:
    trials = {trial.number: trial for trial in plan.trials}
    failures = 0
    while True:
        if on_step is not None:
            on_step(Place(agenda.done, agenda.total))
        if (step := agenda.ask()) is None:
            return
        if isinstance(step, Page):
            conduct_page(step, Place(agenda.done, agenda.total), stage)
        else:
            conduct_trial(step, Place(agenda.done, agenda.total, agenda.attempt(step.number)), stage)
        # The agenda is told what is on the disk, by the same words as when a session is resumed.
        record = stage.journal.records[-1]
        tell(agenda, record, trials)
        failures = failures + 1 if "device_error" in record.data.get("flags", ()) else 0
        if failures == DEVICE_ERRORS:
            raise Stopped("the device failed twice in a row; see to it, then resume", record.data["time_s"])
