"""The engine: one participant works through a plan, against ports only; nothing else knows the rules of a session.

A session is resumed by replaying its journal: trials that were rated are done, all else is asked again. Every event is
in the journal before the next one may happen. An audit runs the same engine on what a journal says was done.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import KW_ONLY, dataclass, fields, replace
from functools import partial
from itertools import takewhile
from numbers import Real
from typing import TYPE_CHECKING, Any

from feel321.protocols.tasks import PROTOCOLS
from feel321.protocols.texts import Question, find_question, read_scales
from feel321.protocols.threshold import ATTENUATION_DB, INTERVALS, MIDDLE, SECOND, Matching
from feel321.protocols.trial import FREE, MATCHING, RATING_RANGE, THRESHOLD, Page, Scale, Trial
from feel321.study.session import events, ports
from feel321.study.session.events import TIMED_OUT
from feel321.study.session.plan import Plan, advance, list_by_code, recall_detection, replay
from feel321.study.session.ports import Place, Presenter

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from feel321.protocols.trial import Flow, Part, Task
    from feel321.stimuli.sets.manifest import Stimulus, StimulusSet
    from feel321.study.session.journal import Journal

Keep = Callable[[str, int, float | str | None], str]
"""Keeps a personal answer (question, occasion, value) apart, and returns its salted digest."""

LOST_IN_A_ROW = 2  # trials lost by the device, after which, and after each more, we are called
BROKEN = "the device failed twice in a row; check it, then resume"
TOLD_S = 1.0  # that the page *time is up* stays: a key that came too late must not take it away
LATE_S = 0.1  # a trial that begins so much after it was due moves the schedule


class Stopped(Exception):  # noqa: N818 - nothing went wrong
    """The session ends here for today; reason and time are the arguments."""


class _Paused(Exception):  # noqa: N818 - nothing went wrong
    """The participant paused; the time is the argument."""


def run_session(  # noqa: PLR0913 - all that a session needs besides its plan
    plan: Plan,
    presenter: Presenter,
    *,
    stimuli: StimulusSet,
    journal: Journal,
    scales: Mapping[str, Scale] | None = None,
    on_step: Callable[[Place], None] = lambda _: None,
    keep: Keep | None = None,
) -> Place:
    """Present all trials that are not done yet; where the session was broken off, the same call goes on.

    scales: texts by name of scale, English by default. on_step: called with the progress at the opening and after every
    page and trial. keep: keeps personal answers apart. Returns how far it came, and why it ended early.
    """
    scales = read_scales() if scales is None else scales
    by_code, stopped = list_by_code(stimuli, seed=plan.seed), ""
    own = partial(Session, stimuli=by_code, scales=scales, keep=keep, on_step=on_step)
    session = own(plan, presenter, journal)
    try:
        session.lead()
    except Stopped as stop:
        stopped, time_s = stop.args
        journal.write(events.SessionAborted(stopped, time_s))
    except BaseException as error:
        if journal.is_open:
            words = f"{type(error).__name__}: {error}".removesuffix(": ")
            journal.write(events.SessionAborted(words, journal.records.find_elapsed()))
        raise
    return replace(session.find_place(), stopped=stopped)


def find_choices(protocol: str) -> tuple[str, ...]:
    """Find what can be chosen in a trial; nothing where there is a slider."""
    own = {THRESHOLD: INTERVALS, MATCHING: ()}
    return own[protocol] if protocol in own else PROTOCOLS[protocol].choices


def find_gap(trial: Trial, task: Task | None, flow: Flow) -> float:
    """Find the silence before each part of a trial, in s."""
    if trial.timing == FREE:
        return 0.0
    return flow.gap_s if task is None or task.gap_s is None else task.gap_s


@dataclass
class Session:
    """A session under way: the agenda, the blocks and the schedule, as the journal so far leaves them."""

    plan: Plan
    presenter: Presenter
    journal: Journal
    _: KW_ONLY
    stimuli: Mapping[str, Stimulus]  # by blind code
    scales: Mapping[str, Scale]
    keep: Keep | None = None
    on_step: Callable[[Place], None] = lambda _: None

    def __post_init__(self) -> None:
        """Take up the session where the journal leaves it."""
        plan, records = self.plan, self.journal.records
        self.flow, self.agenda = plan.flow, replay(plan, records)
        self.detection = recall_detection(plan, records)
        self.trials = {trial.number: trial for trial in plan.trials}
        self.tasks = {task.protocol: task for task in plan.tasks}
        self.matching = Matching(plan.matching, plan.trials) if plan.matching else None
        # Onsets are fixed from one trial to the next of a task; a page, a pause or an opening begins a new schedule.
        self._due_s: float | None = None
        self._paced, self._is_late, self._told = "", False, set[str]()

    def find_place(self) -> Place:
        """Find how far the session has come."""
        return Place(self.agenda.answered, self.agenda.total, given_up=self.agenda.given_up)

    def take(self, event: events.SessionEvent) -> None:
        """Take an event of the journal: what comes next follows from it."""
        advance(self.agenda, event, self.trials, detection=self.detection)

    def lead(self) -> None:
        """Lead the participant from step to step to the end; some pages come in between, aside from the agenda."""
        agenda, records, fault, notice = self.agenda, self.journal.records, "", ""
        opening = {kind.event for kind in (*events.OPENING, events.WarmUpBegun)}
        recent = takewhile(lambda record: record.event in opening, reversed(records))
        is_back = any(record.event == events.SessionResumed.event for record in recent)
        aside = Page("ready") if is_back and isinstance(agenda.ask(), Trial) else None
        while True:
            place = self.find_place()
            self.on_step(replace(place, fault=fault, notice=notice))
            notice = ""
            if (step := aside or agenda.ask()) is None:
                break
            if isinstance(step, Trial):
                place = replace(place, attempt=agenda.attempt(step.number))
                aside, fault, notice = self._conduct_trial(step, place)
                continue
            try:
                self._conduct_page(step, place)
            except Stopped as stop:
                raise Stopped(BROKEN if fault else stop.args[0], stop.args[1]) from None
            self.take(records[-1].content)
            aside, fault = None, ""
        if not records.has(events.SessionFinished):
            self.journal.write(events.SessionFinished(agenda.done, agenda.given_up))

    # Pages.

    def _conduct_page(self, page: Page, place: Place) -> None:
        """Show a page or a question until it is left, and record that."""
        self._due_s, self._is_late = None, False
        if (question := find_question(self.plan.questions, page)) is not None:
            self._ask(question, place)
        else:
            act = self._read_page(page, place)
            self.journal.write(events.PageRead(page.key, act.time_s, act.response_time_s))

    def _read_page(self, page: Page, place: Place) -> ports.Confirm:
        while True:
            act = self.presenter.show_page(page, place)
            if isinstance(act, ports.Abort):
                raise Stopped(act.reason, act.time_s)
            if isinstance(act, ports.Confirm):
                if act.response_time_s >= page.least_s:
                    return act
                self.presenter.refuse("too_early", ())

    def _ask(self, question: Question, place: Place) -> None:
        """Show a question until it is answered, or left open where that is allowed."""
        asked = self.journal.records.find(events.QuestionAnswered)
        occasion = 1 + sum(answered.question == question.name for answered in asked)
        while True:
            act = self.presenter.show_question(question, replace(place, attempt=occasion))
            if isinstance(act, ports.Abort):
                raise Stopped(act.reason, act.time_s)
            if isinstance(act, ports.Pause):
                continue
            value = act.values.get(question.name)
            value = (value or None) if isinstance(value, str | None) else float(value)
            if not (fault := question.find_fault(value)):
                break
            parts = (question.describe_range(),) if fault == "out_of_range" else ()
            self.presenter.refuse(fault, parts)
        sha256 = ""
        if question.personal and self.keep:
            sha256, value = self.keep(question.name, occasion, value), None
        told = (question.name, occasion, value, question.personal, act.time_s, act.response_time_s)
        self.journal.write(events.QuestionAnswered(*told, sha256))

    # Trials.

    def _conduct_trial(self, trial: Trial, place: Place) -> tuple[Page | None, str, str]:
        """Run an attempt at a trial; returns the page before the next step, what the device says, and what is new."""
        attempt = self._run_attempt(trial, place)
        new = events.find_notices(attempt.parts.values())
        notice = "; ".join(said[0] for key, said in new.items() if key not in self._told)
        self._told |= new.keys()
        # The agenda is told what is on the disk, by the same words as when a session is resumed.
        event: Any = self.journal.records[-1].content
        self.take(event)
        self._is_late = TIMED_OUT in event.flags
        if self.agenda.lost_in_a_row >= LOST_IN_A_ROW:
            fault = attempt.describe_faults(self.flow)
            self.journal.write(events.DeviceFailed(fault, self.journal.records.find_elapsed()))
            return Page("call_us", by="experimenter"), fault, ""
        task = self.tasks.get(trial.protocol)
        is_fixed = task is not None and task.onset_s is not None
        return (Page(TIMED_OUT, TOLD_S) if self._is_late and not is_fixed else None), "", notice

    def _run_attempt(self, trial: Trial, place: Place) -> events.Attempt:
        """Run one attempt at a trial, and again after each pause."""
        further = tuple(self.scales[j.scale] for j in trial.judgements if j.scale)
        scale = self.scales[trial.scale]
        scale = replace(scale, further=further) if further else scale
        while True:
            attempt = _Attempt(trial, place.attempt, self)
            self.presenter.show_trial(trial, scale, place)
            attempt.write(events.TrialShown)
            if self._is_late:
                self.presenter.refuse(TIMED_OUT, ())  # where no page may come between
            try:
                if trial.timing != FREE:
                    self._begin(attempt)
                if not attempt.is_spoiled():
                    attempt.answer()
            except _Paused as pause:
                attempt.write(events.TrialPaused, pause.args[0])
                self._due_s, self._is_late = None, False
                time_s = self._read_page(Page("pause"), place).time_s
                attempt.write(events.TrialContinued, time_s)
            else:
                return attempt

    def _begin(self, attempt: _Attempt) -> None:
        """Play all parts for the first time, not before the trial is due, and note when the next one is."""
        trial, task = attempt.trial, self.tasks.get(attempt.trial.protocol)
        due_s = self._due_s if trial.protocol == self._paced else None
        if due_s is not None:
            attempt.write(events.TrialScheduled, due_s)
        attempt.play(trial.parts, due_s=due_s)
        first = attempt.parts.get(trial.parts[0].name)
        if first is None or task is None or task.onset_s is None:
            return
        onset_s = first.requested_s if first.onset_s is None else first.onset_s
        begun_s = onset_s if due_s is None or onset_s > due_s + LATE_S else due_s
        self._paced, self._due_s = trial.protocol, begun_s + task.onset_s


class _Attempt(events.Attempt):
    """One attempt at a trial, with the participant in front of it."""

    def __init__(self, trial: Trial, number: int, session: Session) -> None:
        super().__init__(trial, number)
        self._session, self._presenter, self._flow = session, session.presenter, session.flow
        self._task = session.tasks.get(trial.protocol)
        self._time_s, self._marker = 0.0, MIDDLE

    def write(self, kind: type[events.AttemptEvent], *told: Any) -> None:  # noqa: ANN401 - its fields
        """Record an event of this attempt, and take it."""
        event = kind(self.trial.number, self.number, *told)
        self._session.journal.write(event)
        self.follow(event)

    def play(self, parts: Iterable[Part], *, due_s: float | None = None) -> None:
        """Play the parts in order, until one is cut short."""
        due = {} if due_s is None else {"due_s": due_s}
        gap_s, own = self._prepare()
        for part in parts:
            kind = events.PartPlayed
            if part.stimulus_id is None:
                playback, kind = self._presenter.prompt(part), events.SurfaceStroked
            else:
                stimulus = own.get(part.name) or self._session.stimuli[part.stimulus_id]
                playback = self._presenter.play(part, stimulus, gap_s=gap_s, **due)
                due = {}
            felt = (getattr(playback, one.name) for one in fields(events.Played))
            self.write(kind, part.name, *felt)
            self._time_s = playback.requested_s if playback.onset_s is None else playback.onset_s
            _stop_or_pause(playback.act)
            faults = events.find_faults(playback, self._flow)
            if not playback.completed or not events.UNANSWERABLE.isdisjoint(faults):
                return

    def _prepare(self) -> tuple[float, dict[str, ports.Tone | ports.Scaled]]:
        """Find the silence before each part, and what parts hold that are no stimuli of the set as they are."""
        session, trial = self._session, self.trial
        gap_s = find_gap(trial, self._task, self._flow)
        own: dict[str, ports.Tone | ports.Scaled] = {}
        if session.detection and trial.protocol == THRESHOLD:
            block, shown = session.detection.block, session.detection.present(trial)
            frequency_hz, gap_s = session.detection.find_frequency(trial), block.gap_s
            self.write(events.TonePresented, frequency_hz, shown.interval, shown.level_db)
            for place, name in enumerate(INTERVALS, start=1):
                level_db = shown.level_db if place == shown.interval else None
                own[name] = ports.Tone(frequency_hz, block.duration_s, level_db)
        elif session.matching and trial.protocol == MATCHING:
            offset_db = session.matching.find_offset(trial.number, self._marker)
            for part in trial.parts:
                gain_db = (offset_db if part.name == SECOND else 0.0) - ATTENUATION_DB
                own[part.name] = ports.Scaled(session.stimuli[str(part.stimulus_id)], gain_db)
        return gap_s, own

    def is_spoiled(self) -> bool:
        """Check whether the attempt can no longer be answered, and record its end if so."""
        flags = self.list_flags(self._flow)
        if events.UNANSWERABLE.isdisjoint(flags):
            return False
        self.write(events.TrialSpoiled, flags, self._time_s)
        return True

    def answer(self) -> None:
        """Wait for the answer, or for another end of the attempt."""
        limit_s = self._task.answer_timeout_s if self._task else None
        limit = {} if limit_s is None else {"limit_s": limit_s}
        is_over = False
        while not is_over:
            act = self._presenter.wait(**limit)
            reason, parts = self._find_refusal(act)
            if reason:
                self.write(events.ActRefused, reason, parts, act.time_s)
                self._presenter.refuse(reason, tuple(parts))
            else:
                is_over = self._accept(act)

    def _find_refusal(self, act: ports.Act) -> tuple[str, list[str]]:
        """Find why an act is not accepted, and the parts that this is about; nothing if it is."""
        choices, (low, high) = find_choices(self.trial.protocol), RATING_RANGE

        def is_answer(value: float | str | None) -> bool:
            if choices:
                return value in choices
            return isinstance(value, Real) and low <= float(value) <= high

        match act:
            case ports.Feel() if self.trial.timing == "strict":
                return "no_replay", []
            case ports.Feel() if act.part not in {"", *(part.name for part in self.trial.parts)}:
                return "unknown_part", [act.part]
            case ports.Move() if act.part not in self.trial.judged or not is_answer(act.value):
                return "unknown_part", [act.part]
            case ports.Confirm():
                if unfelt := self.list_unfelt():
                    return "not_felt", unfelt
                judged = self.trial.judged
                missing = [part for part in judged if not is_answer(act.values.get(part))]
                return "not_answered" if missing else "", missing
        return "", []

    def _accept(self, act: ports.Act) -> bool:
        """Do what is asked; returns whether the attempt is over."""
        match act:
            case ports.Feel():
                wanted = [part for part in self.trial.parts if act.part in {"", part.name}]
                if not {part.name for part in wanted} & set(self.list_unfelt()):
                    self.write(events.PartReplayed, act.part, act.time_s)
                self.play(wanted)
                return self.is_spoiled()
            case ports.Move():
                self._marker = float(act.value)
                self.write(events.MarkerMoved, act.part, self._marker, act.time_s)
            case ports.Confirm():
                given = {part: act.values[part] for part in self.trial.judged}
                values = {k: v if isinstance(v, str) else float(v) for k, v in given.items()}
                flags = self.list_flags(self._flow, response_time_s=act.response_time_s)
                rejected = not set(self._flow.reject).isdisjoint(flags)
                times = (act.response_time_s, act.time_s)
                self.write(events.TrialRated, values, *times, flags, rejected)
                return True
            case ports.TimedOut():
                flags = [*self.list_flags(self._flow), TIMED_OUT]
                self.write(events.TrialSpoiled, flags, act.time_s)
                return True
            case _:
                _stop_or_pause(act)
        return False


def _stop_or_pause(act: ports.Act | None) -> None:
    """End the attempt after a pause or an abort."""
    if isinstance(act, ports.Abort):
        raise Stopped(act.reason, act.time_s)
    if isinstance(act, ports.Pause):
        raise _Paused(act.time_s)
