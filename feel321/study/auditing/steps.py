"""The steps of a session, in order, against what the plan, the rules and the engine allow in that place."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from math import isclose
from typing import Any

from feel321.protocols.agenda import Agenda
from feel321.protocols.detection import INTERVALS, THRESHOLD
from feel321.protocols.questions import PREFIX, find_question
from feel321.protocols.tasks import PROTOCOLS
from feel321.protocols.trial import ASIDE, MATCHING, RATING_RANGE, Page, Trial
from feel321.study.session import events
from feel321.study.session.journal import Record
from feel321.study.session.pace import TIMED_OUT, Schedule
from feel321.study.session.plan import Plan, advance, recall_detection

MALFORMED = (AttributeError, LookupError, TypeError)
"""Errors of reading a plan or record that holds other fields, or other types, than feel321 writes."""

_AFTER: Mapping[str, tuple[type[events.SessionEvent], ...]] = {
    # A session whose header a crash prevented may be given up.
    "": (events.SessionBegun, events.SessionReleased),
    # Simulated participants who finished may be led once more, and Ctrl-C may come.
    events.SessionFinished.event: (events.SessionAborted, events.DeviceOpened, events.NoteTaken),
    # A crash may come before the next session is begun, and nobody come back.
    events.SessionSuperseded.event: (events.SessionReleased, events.NoteTaken),
    # What becomes known later of a session is noted in its journal.
    events.SessionReleased.event: (events.NoteTaken,),
}
"""The events that may follow at the start, and after each event that ends a session; else all may but the header."""


def audit_steps(records: Sequence[Record], plan: Plan) -> Iterator[str]:
    """Compare the events, in order, with what the plan and the rules have in that place."""
    try:
        course = _Course(plan)
    except (*MALFORMED, ValueError) as error:
        yield f": its plan cannot be worked through ({error!r})"
        return
    for record in records:
        try:
            course.follow(record)
        except ValueError as error:
            yield f", line {record.sequence + 1}: {error}"
            return
        except MALFORMED:
            yield f", line {record.sequence + 1}: is not a {record.event!r} record as feel321 writes it"
            return


class _Course:
    """A session, followed record by record."""

    def __init__(self, plan: Plan) -> None:
        self._agenda = Agenda(plan.trials, plan.flow, plan.questions)
        self._pace = Schedule({task.protocol: task for task in plan.tasks})
        self._questions, self._asked = plan.questions, Counter[str]()
        self._flow = plan.flow
        self._trials = {trial.number: trial for trial in plan.trials}
        self._detection = recall_detection(plan, ())
        self._attempt: events.Attempt | None = None
        self._toned = (0, 0)
        self._played = set[tuple[str, float, float | None]]()
        self._state = ""
        self._aside = ""

    def follow(self, record: Record) -> None:
        kind = events.find_kind(record.event)
        if not issubclass(kind, events.REPAIRS):
            self._check_place(kind)
        event = events.read_event(record.event, record.data)
        if isinstance(event, events.REPAIRS):
            return
        if isinstance(event, events.AttemptEvent) and not isinstance(event, events.TrialShown):
            self._follow_attempt(event, record)
        else:
            self._attempt = None  # Whatever was not answered by then never was.
            self._follow_session(event)
        advance(self._agenda, event, self._trials, detection=self._detection)

    def _check_place(self, kind: type[events.SessionEvent]) -> None:
        allowed = _AFTER.get(self._state)
        if (kind is events.SessionBegun) if allowed is None else not issubclass(kind, allowed):
            place = f"after {self._state!r}" if self._state else "first"
            raise ValueError(f"holds {kind.event!r}, which cannot come {place}")
        if kind.event in _AFTER or kind is events.SessionBegun:
            self._state = kind.event

    def _follow_attempt(self, event: events.AttemptEvent, record: Record) -> None:
        attempt = self._attempt
        if attempt is None or (event.trial, event.attempt) != attempt.key:
            raise ValueError(
                f"{event.event!r} of trial {event.trial}, attempt {event.attempt}, which was not shown"
            )
        attempt.follow(event)
        match event:
            case events.TonePresented():
                self._check_tone(event, attempt.trial)
            case events.PartPlayed():
                self._check_part(event, attempt.trial)
            case events.TrialRated():
                self._check_rated(event, attempt, record.data["values"])
                self._attempt = None
            case events.TrialScheduled() if not self._pace.is_fixed(attempt.trial):
                raise ValueError(f"schedules trial {event.trial}, whose onset is not fixed")
            case events.TrialSpoiled():
                self._check_spoiled(event, attempt)
                self._attempt = None

    def _check_part(self, event: events.PartPlayed, trial: Trial) -> None:
        """Check that a stimulus was played, or the real surface stroked, where the trial has one; each time once."""
        part = next((part for part in trial.parts if part.name == event.part), None)
        is_surface = isinstance(event, events.SurfaceStroked)
        if part is None or is_surface != (part.stimulus_id is None):
            raise ValueError(
                f"{event.event} part {event.part!r}, which trial {trial.number} has not"
            )
        key = event.part, event.requested_s, event.onset_s
        if key in self._played:
            raise ValueError(
                f"{event.event} part {event.part!r} of trial {trial.number} twice at the same time"
            )
        self._played.add(key)

    def _check_spoiled(self, event: events.TrialSpoiled, attempt: events.Attempt) -> None:
        flags = attempt.list_flags(flow=self._flow)
        if TIMED_OUT in event.flags and self._pace.find_limit(attempt.trial) is not None:
            flags, self._aside = [*flags, TIMED_OUT], TIMED_OUT
        elif events.ENDS_UNANSWERED.isdisjoint(flags):
            raise ValueError(f"spoils trial {event.trial}, with which nothing was wrong")
        _check_flags(event.flags, flags)

    def _check_tone(self, event: events.TonePresented, trial: Trial) -> None:
        """Check that a trial of the threshold block presents what follows from the answers before it."""
        self._toned = event.trial, event.attempt
        if self._detection is None or trial.protocol != THRESHOLD:
            raise ValueError(f"presents a tone in trial {trial.number}, which has none")
        wanted = self._detection.present(trial)
        level = event.level_db
        is_same = level is wanted.level_db
        if level is not None and wanted.level_db is not None:
            is_same = isclose(level, wanted.level_db, abs_tol=1e-6)
        if event.interval != wanted.interval or not is_same:
            raise ValueError(
                f"presents {event.level_db} dB in interval {event.interval} of trial {trial.number}, by the answers "
                f"before it is {wanted.level_db} dB in interval {wanted.interval}"
            )

    def _check_rated(
        self, event: events.TrialRated, attempt: events.Attempt, values: Mapping[str, Any]
    ) -> None:
        """Check that an answer could be taken, and that it counts as the rules say."""
        if attempt.trial.protocol == THRESHOLD and self._toned != attempt.key:
            raise ValueError(f"rates trial {event.trial}, in which no level was presented")
        if unfelt := attempt.list_unfelt():
            raise ValueError(
                f"rates trial {event.trial}, of which {', '.join(unfelt)} was not felt to its end"
            )
        _check_values(values, attempt.trial)
        flags = attempt.list_flags(response_time_s=event.response_time_s, flow=self._flow)
        _check_flags(event.flags, flags)
        rejected = not set(self._flow.reject).isdisjoint(flags)
        if event.rejected is not rejected:
            raise ValueError(
                f"has rejected {event.rejected!r}, the rules of the plan say {rejected}"
            )

    def _follow_session(self, event: events.SessionEvent) -> None:
        agenda, step = self._agenda, self._agenda.ask()
        self._aside = _CALLING.get(type(event), self._aside)
        match event:
            case events.TrialShown():
                number = agenda.attempt(step.number) if isinstance(step, Trial) else 0
                if not isinstance(step, Trial) or (event.trial, event.attempt) != (
                    step.number,
                    number,
                ):
                    raise ValueError(
                        f"shows trial {event.trial}, attempt {event.attempt}, which was not next"
                    )
                self._attempt = events.Attempt(step, number)
                self._played.clear()
            case events.PageRead():
                self._check_page(event, step)
            case events.QuestionAnswered():
                self._check_answer(event)
            case events.SessionFinished():
                if step is not None:
                    raise ValueError(f"finished after {agenda.done} of {agenda.total} trials")
                if (event.trials, event.given_up) != (agenda.done, agenda.given_up):
                    raise ValueError(
                        f"finished with {event.trials} trials, {event.given_up} of them given up; "
                        f"the journal holds {agenda.done} and {agenda.given_up}"
                    )

    def _check_answer(self, event: events.QuestionAnswered) -> None:
        question = find_question(self._questions, f"{PREFIX}{event.question}")
        if question is None:
            raise ValueError(f"answers {event.question!r}, which the plan does not ask")
        self._asked[event.question] += 1
        if event.occasion != self._asked[event.question]:
            raise ValueError(
                f"answers {event.question!r} as occasion {event.occasion}, it is {self._asked[event.question]}"
            )
        is_odd = False if event.sha256 else question.find_fault(event.value)
        if is_odd or event.personal is not question.personal:
            raise ValueError(
                f"answers {event.question!r} against the plan: the value must be one that it offers, and marked "
                f"personal = {question.personal}"
            )

    def _check_page(self, event: events.PageRead, step: Page | Trial | None) -> None:
        if event.key in ASIDE and event.key != self._aside:
            raise ValueError(f"shows page {event.key!r}, for which there was no reason")
        least_s = step.least_s if isinstance(step, Page) and step.key == event.key else 0.0
        if event.stood_s < least_s:
            raise ValueError(
                f"page {event.key!r} was shown for {event.stood_s:g} s, {least_s:g} s are due"
            )


_CALLING: Mapping[type[events.SessionEvent], str] = {
    events.SessionResumed: "ready",
    events.DeviceFailed: "call_us",
    events.TrialShown: "",
}
"""The page aside from the plan that an event gives reason for, or takes it from."""


def _check_values(values: Mapping[str, Any], trial: Trial) -> None:
    if sorted(values) != sorted(trial.judged):
        got, asked = (", ".join(names) or "nothing" for names in (values, trial.judged))
        raise ValueError(f"rates {got}, trial {trial.number} asks for {asked}")
    choices, (low, high) = find_choices(trial.protocol), RATING_RANGE
    for part, value in values.items():
        is_points = isinstance(value, float) and low <= value <= high
        if not (value in choices if choices else is_points):
            allowed = f"one of {', '.join(choices)}" if choices else f"{low:g} to {high:g} points"
            raise ValueError(f"has {value!r} for {part}, which must be {allowed}")


def find_choices(protocol: str) -> tuple[str, ...]:
    """Find what can be chosen in a trial; nothing where there is a slider."""
    own = {THRESHOLD: INTERVALS, MATCHING: ()}
    return own[protocol] if protocol in own else PROTOCOLS[protocol].choices


def _check_flags(flags: Sequence[str], expected: Sequence[str]) -> None:
    if sorted(flags) != sorted(expected):
        raise ValueError(f"has flags {flags}, by what was felt and answered they are {expected}")
