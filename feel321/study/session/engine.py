"""The engine: one participant works through a plan, against ports only.

A session is resumed by replaying its journal: trials that were rated are done, all else is asked again.

Every event is in the journal before the next one may happen.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, fields, replace
from itertools import takewhile
from numbers import Real
from typing import TYPE_CHECKING, Any

from feel321.protocols.blocks import (
    ATTENUATION_DB,
    FIRST,
    INTERVALS,
    MIDDLE,
    SECOND,
    Detection,
    Matching,
)
from feel321.protocols.questions import Question, find_question
from feel321.protocols.tasks import PROTOCOLS
from feel321.protocols.texts import read_scales
from feel321.protocols.trial import (
    FREE,
    MATCHING,
    RATING_RANGE,
    THRESHOLD,
    Flow,
    Page,
    Part,
    Scale,
    Trial,
)
from feel321.records import Result
from feel321.study.session import events, ports
from feel321.study.session.codes import list_by_code
from feel321.study.session.pace import TIMED_OUT, TOLD_S, Schedule, find_gap
from feel321.study.session.plan import Plan, advance, recall_detection, replay
from feel321.study.session.ports import Place, Presenter

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from feel321.protocols.agenda import Agenda
    from feel321.stimuli.sets.manifest import Stimulus, StimulusSet
    from feel321.study.session.journal import Journal, Records

KeepAnswer = Callable[[str, int, float | str | None], str]
"""Keeps a personal answer (question, occasion, value) apart, and returns its salted digest."""

DEVICE_ERRORS = 2
"""Failures of the device in a row after which the experimenter is called: trials must not be used up on a dead one."""

DEVICE_FLAGS = frozenset({"device_error", "not_delivered"})
"""Flags of attempts in which the device failed."""


@dataclass(frozen=True, slots=True)
class Setup:
    """The setup of a session: the presenter, the stimuli by blind code, the scales, the journal and the rules.

    detection, matching: the blocks of thresholds and of matched strength, where there are any. keep: keeps personal
    answers apart from the journal.
    """

    presenter: Presenter
    stimuli: Mapping[str, Stimulus]
    scales: Mapping[str, Scale]
    journal: Journal
    flow: Flow
    detection: Detection | None = None
    matching: Matching | None = None
    questions: Sequence[Question] = ()
    pace: Schedule = field(default_factory=Schedule)
    keep: KeepAnswer | None = None


@dataclass(frozen=True, slots=True, repr=False, eq=False)
class Outcome(Result):
    """The end of a session.

    Parameters
    ----------
    done, total : int
        Trials of the main phase that are done, and all of them.
    stopped : str
        Reason why it ended before its end; empty if it did not.

    Examples
    --------
    >>> from feel321 import study
    >>> study.Outcome(12, 48, "had enough").done
    12
    """

    done: int
    total: int
    stopped: str = ""


BROKEN = "the device failed twice in a row; check it, then resume"
"""Reason of a session that ends while the experimenter is called."""


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
    on_step: Callable[[Place], None] | None = None,
    keep: Callable[[str, int, float | str | None], str] | None = None,
) -> Outcome:
    """Present all trials that are not done yet.

    Parameters
    ----------
    plan : Plan
        The plan.
    presenter : Presenter
        Shows, plays and passes on the acts of the participant.
    stimuli : StimulusSet
        The stimuli that the plan names by codes.
    journal : Journal
        The record of the session, open.
    scales : mapping of str to Scale, optional
        The texts by name of scale; English by default.
    on_step : callable, optional
        Called with the progress of the session, at its opening and after every page and trial.
    keep : callable, optional
        Keeps personal answers apart from the journal: takes question, occasion and value, returns a salted digest.

    Returns
    -------
    Outcome
        Whether it came to its end; if not, the same call goes on.
    """
    setup = Setup(
        presenter,
        list_by_code(stimuli, seed=plan.seed),
        read_scales() if scales is None else scales,
        journal,
        plan.flow,
        recall_detection(plan, journal.records),
        Matching(plan.matching, plan.trials) if plan.matching else None,
        plan.questions,
        Schedule({task.protocol: task for task in plan.tasks}),
        keep,
    )
    agenda = replay(plan, journal.records)
    try:
        trials = {trial.number: trial for trial in plan.trials}
        follow_agenda(setup, agenda, trials, on_step=on_step or (lambda _: None))
    except Stopped as stop:
        reason, time_s = stop.args
        journal.write(events.SessionAborted(reason, time_s))
        return Outcome(agenda.done, agenda.total, reason)
    except BaseException as error:
        if journal.is_open:
            words = f"{type(error).__name__}: {error}".removesuffix(": ")
            journal.write(events.SessionAborted(words, journal.records.find_elapsed()))
        raise
    return Outcome(agenda.done, agenda.total)


def follow_agenda(
    setup: Setup,
    agenda: Agenda,
    trials: Mapping[int, Trial],
    *,
    on_step: Callable[[Place], None] = lambda _: None,
) -> None:
    """Lead a participant from step to step to the end; some pages come in between, aside from the agenda."""
    journal, pace = setup.journal, setup.pace
    aside = Page("ready") if isinstance(agenda.ask(), Trial) and _is_back(journal.records) else None
    fault, failures = "", 0
    while True:
        place = Place(agenda.done, agenda.total, fault=fault)
        on_step(place)
        if (step := aside or agenda.ask()) is None:
            break
        if isinstance(step, Trial):
            place = replace(place, attempt=agenda.attempt(step.number), fault="")
            conduct_trial(step, place, setup)
        else:
            pace.restart()
            _conduct_page_or_question(step, replace(place, fault=""), setup, fault=fault)
            aside, fault = None, ""
        # The agenda is told what is on the disk, by the same words as when a session is resumed.
        event = journal.records[-1].content
        advance(agenda, event, trials, detection=setup.detection)
        if not isinstance(step, Trial):
            continue
        flags: Sequence[str] = getattr(event, "flags", ())
        pace.timed_out = TIMED_OUT in flags
        if pace.timed_out and not pace.is_fixed(step):
            aside = Page(TIMED_OUT, TOLD_S)
        failures = 0 if DEVICE_FLAGS.isdisjoint(flags) else failures + 1
        if failures >= DEVICE_ERRORS:  # once called, the experimenter is called after each one more
            aside, fault = Page("call_us", by="experimenter"), _find_device_fault(setup, flags)
            journal.write(events.DeviceFailed(fault, journal.records.find_elapsed()))
    if not journal.records.has(events.SessionFinished):
        journal.write(events.SessionFinished(agenda.done, agenda.given_up))


def _is_back(records: Records) -> bool:
    """Whether the session was resumed, and nothing was shown since."""
    opening = {kind.event for kind in (*events.OPENING, events.WarmUpBegun)}
    recent = takewhile(lambda record: record.event in opening, reversed(records))
    return any(record.event == events.SessionResumed.event for record in recent)


def _find_device_fault(setup: Setup, flags: Iterable[str]) -> str:
    """Find what was wrong with the last playback."""
    played = list(setup.journal.records.find(events.PartPlayed))
    last = played[-1] if played else None
    found = last and (last.error or last.fault or events.find_loss(last.delivered, setup.flow))
    return found or ", ".join(flags)


def _conduct_page_or_question(page: Page, place: Place, setup: Setup, *, fault: str) -> None:
    try:
        if question := find_question(setup.questions, page):
            conduct_question(question, place, setup)
        else:
            conduct_page(page, place, setup)
    except Stopped as stop:
        if fault:
            raise Stopped(BROKEN, stop.args[1]) from None
        raise


def conduct_page(page: Page, place: Place, setup: Setup) -> None:
    """Show a page until it is left, and at least as long as it must be shown."""
    act = _read_page(page, place, setup)
    setup.journal.write(events.PageRead(page.key, act.time_s, act.response_time_s))


def _read_page(page: Page, place: Place, setup: Setup) -> ports.Confirm:
    while True:
        act = setup.presenter.show_page(page, place)
        if isinstance(act, ports.Abort):
            raise Stopped(act.reason, act.time_s)
        if isinstance(act, ports.Pause):
            continue  # Nothing is felt on a page, so there is nothing to pause.
        if act.response_time_s >= page.least_s:
            return act
        setup.presenter.refuse("too_early", ())


def conduct_question(question: Question, place: Place, setup: Setup) -> None:
    """Show a question until it is answered, or left open where that is allowed."""
    asked = setup.journal.records.find(events.QuestionAnswered)
    occasion = 1 + sum(answered.question == question.name for answered in asked)
    place = replace(place, attempt=occasion)
    while True:
        act = setup.presenter.show_question(question, place)
        if isinstance(act, ports.Abort):
            raise Stopped(act.reason, act.time_s)
        if isinstance(act, ports.Pause):
            continue
        value = act.values.get(question.name)
        value = (value or None) if isinstance(value, str | None) else float(value)
        if not (fault := question.find_fault(value)):
            break
        parts = (question.describe_range(),) if fault == "out_of_range" else ()
        setup.presenter.refuse(fault, parts)
    answered = events.QuestionAnswered(
        question.name, occasion, value, question.personal, act.time_s, act.response_time_s
    )
    if question.personal and setup.keep:
        sha256 = setup.keep(question.name, occasion, value)
        answered = replace(answered, value=None, sha256=sha256)
    setup.journal.write(answered)


def conduct_trial(trial: Trial, place: Place, setup: Setup) -> None:
    """Run one attempt at a trial, and again after each pause."""
    while True:
        attempt = _Attempt(setup, trial, place.attempt)
        setup.presenter.show_trial(trial, find_scale(trial, setup.scales), place)
        setup.journal.write(events.TrialShown(*attempt.key))
        if setup.pace.timed_out:
            setup.presenter.refuse(TIMED_OUT, ())  # where no page may come between
        try:
            if trial.timing != FREE:
                attempt.begin()
            if not attempt.is_spoiled():
                attempt.answer()
        except _Paused as pause:
            setup.journal.write(events.TrialPaused(*attempt.key, pause.args[0]))
            setup.pace.restart()
            time_s = _read_page(Page("pause"), place, setup).time_s
            setup.journal.write(events.TrialContinued(*attempt.key, time_s))
        else:
            return


def find_choices(protocol: str) -> tuple[str, ...]:
    """Find what can be chosen in a trial; nothing where there is a slider."""
    own = {THRESHOLD: INTERVALS, MATCHING: ()}
    return own[protocol] if protocol in own else PROTOCOLS[protocol].choices


def find_scale(trial: Trial, scales: Mapping[str, Scale]) -> Scale:
    """Find the scale of a trial, with the others that it asks for."""
    further = tuple(scales[j.scale] for j in trial.judgements if j.scale)
    return replace(scales[trial.scale], further=further) if further else scales[trial.scale]


class _Attempt(events.Attempt):
    """One attempt at a trial, with the participant in front of it."""

    def __init__(self, setup: Setup, trial: Trial, number: int) -> None:
        super().__init__(trial, number)
        self._setup = setup
        self._time_s, self._marker = 0.0, MIDDLE

    def begin(self) -> None:
        """Play all parts for the first time, not before the trial is due."""
        pace = self._setup.pace
        if (due_s := pace.find_due(self.trial)) is not None:
            self._setup.journal.write(events.TrialScheduled(*self.key, due_s))
        self.play(self.trial.parts, due_s=due_s)
        first = self.parts.get(self.trial.parts[0].name)
        if first is not None:
            onset_s = first.requested_s if first.onset_s is None else first.onset_s
            pace.note_onset(self.trial, onset_s)

    def play(self, parts: Iterable[Part], *, due_s: float | None = None) -> None:
        """Play the parts in order, until one is cut short."""
        presenter, due = self._setup.presenter, {} if due_s is None else {"due_s": due_s}
        task = self._setup.pace.tasks.get(self.trial.protocol)
        gap_s = find_gap(self.trial, task, self._setup.flow)
        own: Mapping[str, ports.Tone | ports.Scaled] = {}
        if self._setup.detection and self.trial.protocol == THRESHOLD:
            gap_s, own = self._present(self._setup.detection)
        elif self._setup.matching and self.trial.protocol == MATCHING:
            own = self._scale(self._setup.matching)
        for part in parts:
            kind = events.PartPlayed
            if part.stimulus_id is None:
                playback, kind = presenter.prompt(part), events.SurfaceStroked
            else:
                stimulus = own.get(part.name) or self._setup.stimuli[part.stimulus_id]
                playback = presenter.play(part, stimulus, gap_s=gap_s, **due)
                due = {}
            felt: dict[str, Any] = {
                one.name: getattr(playback, one.name) for one in fields(events.Played)
            }
            played = kind(*self.key, part.name, **felt)
            self._setup.journal.write(played)
            self.follow(played)
            self._time_s = playback.requested_s if playback.onset_s is None else playback.onset_s
            _stop_or_pause(playback.act)
            is_lost = events.find_loss(played.delivered, self._setup.flow)
            if playback.error or not playback.completed or is_lost:
                return

    def _present(self, detection: Detection) -> tuple[float, dict[str, ports.Tone]]:
        """Decide what the intervals hold, and record it; the gap before each of them comes first."""
        block, shown = detection.block, detection.present(self.trial)
        frequency_hz = detection.find_frequency(self.trial)
        presented = events.TonePresented(*self.key, frequency_hz, shown.interval, shown.level_db)
        self._setup.journal.write(presented)
        levels = dict.fromkeys(INTERVALS) | {INTERVALS[shown.interval - 1]: shown.level_db}
        return block.gap_s, {
            name: ports.Tone(frequency_hz, block.duration_s, level)
            for name, level in levels.items()
        }

    def _scale(self, matching: Matching) -> dict[str, ports.Scaled]:
        """Set the second to the level of the marker."""
        offset_db = matching.find_offset(self.trial.number, self._marker)
        offsets_db = {FIRST: 0.0, SECOND: offset_db}
        return {
            part.name: ports.Scaled(
                self._setup.stimuli[part.stimulus_id], offsets_db[part.name] - ATTENUATION_DB
            )
            for part in self.trial.parts
            if part.stimulus_id is not None
        }

    def is_spoiled(self) -> bool:
        """Check whether the attempt can no longer be answered, and record its end if so."""
        flags = self.list_flags(flow=self._setup.flow)
        if events.ENDS_UNANSWERED.isdisjoint(flags):
            return False
        self._setup.journal.write(events.TrialSpoiled(*self.key, flags, self._time_s))
        return True

    def answer(self) -> None:
        """Wait for the answer, or for another end of the attempt."""
        limit_s = self._setup.pace.find_limit(self.trial)
        limit = {} if limit_s is None else {"limit_s": limit_s}
        while True:
            act = self._setup.presenter.wait(**limit)
            match act:
                case ports.Feel():
                    self._replay(act)
                    if self.is_spoiled():
                        return
                case ports.Move():
                    self._move(act)
                case ports.Confirm():
                    if self._accept(act):
                        return
                case ports.TimedOut():
                    flags = [*self.list_flags(flow=self._setup.flow), TIMED_OUT]
                    self._setup.journal.write(events.TrialSpoiled(*self.key, flags, act.time_s))
                    return
                case _:
                    _stop_or_pause(act)

    def _replay(self, act: ports.Feel) -> None:
        parts = [part for part in self.trial.parts if act.part in {"", part.name}]
        if self.trial.timing == "strict":
            self._refuse(act, "no_replay")
        elif not parts:
            self._refuse(act, "unknown_part", [act.part])
        else:
            if not {part.name for part in parts} & set(self.list_unfelt()):
                self._setup.journal.write(events.PartReplayed(*self.key, act.part, act.time_s))
            self.play(parts)

    def _move(self, act: ports.Move) -> None:
        if act.part in self.trial.judged and self._find_valid({act.part: act.value}):
            moved = events.MarkerMoved(*self.key, act.part, float(act.value), act.time_s)
            self._setup.journal.write(moved)
            self.follow(moved)
            self._marker = moved.value
        else:
            self._refuse(act, "unknown_part", [act.part])

    def _accept(self, act: ports.Confirm) -> bool:
        """Record the answer, unless something was not felt or not answered."""
        flow, valid = self._setup.flow, self._find_valid(act.values)
        if unfelt := self.list_unfelt():
            return self._refuse(act, "not_felt", unfelt)
        if missing := [part for part in self.trial.judged if part not in valid]:
            return self._refuse(act, "not_answered", missing)
        flags = self.list_flags(response_time_s=act.response_time_s, flow=flow)
        values = {part: act.values[part] for part in self.trial.judged}
        rated = events.TrialRated(
            *self.key,
            values={k: v if isinstance(v, str) else float(v) for k, v in values.items()},
            response_time_s=act.response_time_s,
            time_s=act.time_s,
            flags=flags,
            rejected=not set(flow.reject).isdisjoint(flags),
        )
        self._setup.journal.write(rated)
        return True

    def _find_valid(self, values: Mapping[str, float | str]) -> set[str]:
        choices, (low, high) = find_choices(self.trial.protocol), RATING_RANGE
        return {
            part
            for part, value in values.items()
            if (value in choices if choices else isinstance(value, Real) and low <= value <= high)
        }

    def _refuse(
        self, act: ports.Feel | ports.Move | ports.Confirm, reason: str, parts: Iterable[str] = ()
    ) -> bool:
        names = list(parts)
        self._setup.journal.write(events.ActRefused(*self.key, reason, names, act.time_s))
        self._setup.presenter.refuse(reason, tuple(names))
        return False


def _stop_or_pause(act: object) -> None:
    """End the attempt after a pause or an abort."""
    if isinstance(act, ports.Abort):
        raise Stopped(act.reason, act.time_s)
    if isinstance(act, ports.Pause):
        raise _Paused(act.time_s)
