"""The steps of a session, in order, against what the plan, the rules and the engine allow in that place."""

from __future__ import annotations

from numbers import Real
from typing import TYPE_CHECKING, Any

from protocols.agenda import Agenda
from protocols.flow import Page
from protocols.trial import Trial
from study.auditing.attempt import Attempt
from study.session.replay import tell

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from study.session.chain import Record
    from study.session.plan import Plan

MALFORMED = (AttributeError, LookupError, TypeError)
"""What reading a record raises that holds other fields, or other types, than feel321 writes."""

MENDING = frozenset({"clock_stepped", "recovered"})
"""What opening a journal may add at any place."""

_OF_ATTEMPT = frozenset({"played", "prompted"}) | {
    "replayed",
    "moved",
    "refused",
    "rated",
    "spoiled",
    "paused",
    "continued",
}
_OF_SESSION = frozenset({"page", "shown", "finished", "aborted", "resumed", "warm_up", "superseded", "released"}) | {
    "device"
}

_NEXT = {
    # A session whose header a crash prevented may be given up.
    "": frozenset({"begun", "released"}),
    "begun": _OF_ATTEMPT | _OF_SESSION,
    # A crash may keep the end from the ledger; then the lab is opened once more, and Ctrl-C may come.
    "finished": frozenset({"aborted", "device"}),
    # A crash may come before the next session is begun, and nobody come back.
    "superseded": frozenset({"released"}),
    "released": frozenset(),
}
"""What may follow after each event that changes what may."""


def audit_steps(records: Sequence[Record], plan: Plan) -> Iterator[str]:
    """Compare what happened, in order, with what the plan and the rules have in that place.

    Parameters
    ----------
    records : sequence of Record
        A journal's records.
    plan : Plan
        The plan.

    Yields
    ------
    str
        The first that does not fit; all that follows is out of step.
    """
    try:
        course = _Course(plan)
    except (*MALFORMED, ValueError) as error:
        yield f": its plan is none to work through ({error!r})"
        return
    for record in records:
        try:
            course.follow(record)
        except ValueError as error:
            yield f", line {record.sequence + 1}: {error}"
            return
        except MALFORMED:
            yield f", line {record.sequence + 1}: is no {record.event!r} record as feel321 writes them"
            return


class _Course:
    """A session, followed record by record."""

    def __init__(self, plan: Plan) -> None:
        self._agenda = Agenda(plan.trials, plan.flow)
        self._flow = plan.flow
        self._trials = {trial.number: trial for trial in plan.trials}
        self._attempt: Attempt | None = None
        self._state = ""

    def follow(self, record: Record) -> None:
        event, data = record.event, record.data
        if event in MENDING:
            return
        self._check_place(event)
        if not isinstance(data.get("time_s", 0.0), Real):
            raise TypeError(event)
        if event in _OF_ATTEMPT:
            self._follow_attempt(event, data)
        else:
            self._attempt = None  # Whatever was not answered by then never was.
            self._follow_session(event, data)
        tell(self._agenda, record, self._trials)

    def _check_place(self, event: str) -> None:
        if event not in _OF_ATTEMPT | _OF_SESSION | {"begun"}:
            raise ValueError(f"holds {event!r}, which no session writes")
        if event not in _NEXT[self._state]:
            place = f"after {self._state!r}" if self._state else "first"
            raise ValueError(f"holds {event!r}, which cannot come {place}")
        if event in _NEXT:
            self._state = event

    def _follow_attempt(self, event: str, data: Mapping[str, Any]) -> None:
        attempt = self._attempt
        if attempt is None or (data["trial"], data["attempt"]) != (attempt.trial.number, attempt.number):
            raise ValueError(f"{event!r} of trial {data['trial']}, attempt {data['attempt']}, which was not shown")
        match event:
            case "played" | "prompted":
                attempt.take(event, data)
            case "rated":
                attempt.check_rated(data, self._flow)
                self._attempt = None
            case "spoiled":
                attempt.check_spoiled(data)
                self._attempt = None
            case "paused":
                attempt.playbacks.clear()  # It is shown again before it goes on.

    def _follow_session(self, event: str, data: Mapping[str, Any]) -> None:
        step = self._agenda.ask()
        match event:
            case "shown":
                self._attempt = self._show(data)
            case "page" if isinstance(step, Page) and step.key == data["key"] and data["stood_s"] < step.least_s:
                raise ValueError(f"page {step.key!r} stood for {data['stood_s']:g} s, {step.least_s:g} s are due")
            case "finished":
                self._finish(data)

    def _show(self, data: Mapping[str, Any]) -> Attempt:
        step = self._agenda.ask()
        number = self._agenda.attempt(step.number) if isinstance(step, Trial) else 0
        if not isinstance(step, Trial) or (data["trial"], data["attempt"]) != (step.number, number):
            raise ValueError(f"shows trial {data['trial']}, attempt {data['attempt']}, which was not next")
        return Attempt(step, number)

    def _finish(self, data: Mapping[str, Any]) -> None:
        agenda = self._agenda
        if agenda.ask() is not None:
            raise ValueError(f"finished after {agenda.done} of {agenda.total} trials")
        if (data["trials"], data["given_up"]) != (agenda.done, agenda.given_up):
            raise ValueError(
                f"finished with {data['trials']} trials, {data['given_up']} of them given up; "
                f"the journal holds {agenda.done} and {agenda.given_up}"
            )
