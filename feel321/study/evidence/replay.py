"""The engine, run on what a journal says was done: where it would write something else, the journal is untrue."""

from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import fields
from itertools import islice, takewhile
from math import isclose, nan
from pathlib import Path
from typing import Any

from feel321.protocols.texts import Question
from feel321.protocols.trial import Page, Part, Scale, Trial
from feel321.study.session import events, ports
from feel321.study.session.engine import Session, find_choices
from feel321.study.session.journal import Journal, Record, utc_now
from feel321.study.session.plan import Plan

MALFORMED = (AttributeError, LookupError, TypeError, RecursionError, ArithmeticError)
"""Errors of reading a plan or record that holds other fields, or other types, than feel321 writes."""

_OPENING = (events.SessionBegun, events.SessionResumed)
_KEEPING = (  # events that begin the opening of a session, and that belong to it
    *events.REPAIRS, events.DeviceOpened, events.NoteTaken, events.RigAccepted, events.WarmUpBegun,
)  # fmt: skip

_ANY = (  # events that the engine does not decide on: one may come anywhere, and whatever was going on is over
    *_KEEPING, events.SessionResumed, events.SessionSuperseded, events.SessionReleased, events.SessionAborted,
)  # fmt: skip

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
"""The events that may follow at the start, and after each event that ends a session."""

_REPAIRS = {kind.event for kind in events.REPAIRS}
_OTHERS = {kind.event for kind in _ANY} - _REPAIRS
_PLAYED = [one.name for one in fields(events.Played)]


def audit_steps(records: Sequence[Record], plan: Plan) -> Iterator[str]:
    """Run a session again as its journal tells it; the first line that cannot have been is given."""
    paper = _Paper(records)
    try:
        _follow(paper, plan)
    except (*MALFORMED, ValueError) as error:
        is_said = isinstance(error, ValueError)
        text = str(error) if is_said else f"is not a record as feel321 writes it ({error!r})"
        place = "" if text.startswith("line ") else f"line {len(paper.records) + 1}: "
        yield f", {place}{text}"


def _follow(paper: "_Paper", plan: Plan) -> None:
    """Follow a journal to its end: the engine leads, and in between stands what others did."""
    answered = [one for one in paper.truth if one.event == events.QuestionAnswered.event]
    tape: Any = _Tape(paper)
    stimuli: Any = defaultdict(lambda: None)
    scales: Any = defaultdict(lambda: Scale("", "", "", ""))
    keep = tape.keep if any(one.data.get("sha256") for one in answered) else None
    session = Session(plan, tape, paper, stimuli=stimuli, scales=scales, keep=keep)
    state, is_open = "", False
    while paper.is_left:
        kind = events.find_kind(paper.truth[len(paper.records)].event)
        allowed, is_begun = _AFTER.get(state), kind is events.SessionBegun
        is_misplaced = is_begun if allowed is None else not issubclass(kind, allowed)
        if is_misplaced and not issubclass(kind, events.REPAIRS):
            place = f"after {state!r}" if state else "first"
            raise ValueError(f"holds {kind.event!r}, which cannot come {place}")
        if issubclass(kind, (events.SessionBegun, *_ANY)):
            event = paper.truth[len(paper.records)].content
            paper.take()
            session.take(event)
            is_open = issubclass(kind, _OPENING) or (is_open and issubclass(kind, _KEEPING))
        elif is_open:
            with suppress(_Over):
                session.lead()
            kind, is_open = events.find_kind(paper.records[-1].event), False
        else:
            raise ValueError(f"holds {kind.event!r}, and the session was not opened again")
        state = kind.event if kind.event in _AFTER or is_begun else state


class _Over(Exception):  # noqa: N818 - nothing went wrong
    """The session was broken off here, as it may be anywhere."""


class _Paper(Journal):
    """A journal in memory that takes only what the real one, `truth`, holds in that place."""

    __slots__ = ("truth",)

    def __init__(self, truth: Sequence[Record]) -> None:
        super().__init__(Path(), utc_now)
        self.truth = truth

    @property
    def is_left(self) -> bool:
        return len(self.records) < len(self.truth)

    def take(self) -> None:
        self.records.append(self.truth[len(self.records)])

    def look(self) -> events.SessionEvent:
        """Look at what comes next, unless the session was broken off here."""
        while self.is_left:
            record = self.truth[len(self.records)]
            if record.event in _OTHERS:
                break
            if record.event not in _REPAIRS:
                return record.content
            self.take()
        raise _Over

    def write(self, event: events.SessionEvent) -> None:
        """Compare what the engine writes with what stands there."""
        told = self.look()
        if type(told) is not type(event):
            due = repr(event.event)
            if isinstance(event, events.ActRefused):
                due = " ".join([f"{due}, for it is", event.reason, *event.parts])
            raise ValueError(f"holds {told.event!r}, by what came before it is {due}")
        for one in fields(told) if told != event else ():
            got, due = getattr(told, one.name), getattr(event, one.name)
            is_level = one.name == "level_db" and None not in {got, due}
            if got == due or (is_level and isclose(got, due, abs_tol=1e-6)):  # processors round
                continue
            if isinstance(told, events.DeviceFailed) and one.name == "reason":  # words for people
                continue
            place = f"{told.event!r} has {one.name} {got!r}"
            raise ValueError(f"{place}, by the plan and what came before it is {due!r}")
        self.take()


class _Tape:
    """A presenter that does what the journal says was done next."""

    def __init__(self, paper: "_Paper") -> None:
        self._paper = paper
        self._page = ""
        self._attempt: events.Attempt
        self._played = set[tuple[str, float, float | None]]()

    def _expect(self, kind: type[events.E], due: str) -> events.E:
        told = self._paper.look()
        if isinstance(told, kind):
            return told
        raise ValueError(f"holds {told.event!r} where {due} is due")

    def show_page(self, page: Page, _place: ports.Place) -> ports.Confirm:
        self._page = f"page {page.key!r}"
        if page.key == "pause":
            return ports.Confirm(self._expect(events.TrialContinued, self._page).time_s, {})
        told = self._expect(events.PageRead, self._page)
        return ports.Confirm(told.time_s, {}, told.stood_s)

    def show_question(self, question: Question, _place: ports.Place) -> ports.Confirm:
        """Give the answer that was given; of one that is kept apart, any that could be."""
        self._page = f"question {question.name!r}"
        told = self._expect(events.QuestionAnswered, self._page)
        value = told.value
        if told.sha256:
            ends = (question.low, question.high, 0.0)
            number = next(end for end in ends if end is not None)
            value = next(iter(question.choices), "x" if question.kind == "text" else number)
        answer: Any = {question.name: value}
        return ports.Confirm(told.time_s, answer, told.stood_s)

    def keep(self, *_: object) -> str:
        return str(getattr(self._paper.look(), "sha256", ""))

    def show_trial(self, trial: Trial, _scale: Scale, place: ports.Place) -> None:
        self._page, self._attempt = "", events.Attempt(trial, place.attempt)
        self._played.clear()

    def play(self, part: Part, *_: object, **__: object) -> ports.Playback:
        told = self._expect(events.PartPlayed, f"part {part.name!r}")
        key = told.part, told.requested_s, told.onset_s
        if key in self._played:
            raise ValueError(f"{told.event} part {told.part!r} twice at the same time")
        self._played.add(key)
        self._attempt.follow(told)
        known: dict[str, Any] = {name: getattr(told, name) for name in _PLAYED}
        later = list(islice(self._list_coming(), 2))
        paused = later[1] if len(later) > 1 else None
        act = ports.Pause(paused.time_s) if isinstance(paused, events.TrialPaused) else None
        return ports.Playback(**known, act=act)

    def prompt(self, part: Part) -> ports.Playback:
        return self.play(part)

    def _list_coming(self) -> Iterator[events.SessionEvent]:
        """List the playbacks that come next, and what follows on them."""
        for record in islice(self._paper.truth, len(self._paper.records), None):
            if record.event not in _REPAIRS:
                yield record.content
                if not isinstance(record.content, events.PartPlayed):
                    return

    def wait(self, limit_s: float | None = None) -> ports.Act:
        act: ports.Act | None = None
        match told := self._paper.look():
            case events.PartPlayed() | events.PartReplayed():
                act = self._feel(told)
            case events.MarkerMoved():
                self._attempt.follow(told)
                act = ports.Move(told.time_s, told.part, told.value)
            case events.TrialPaused():
                act = ports.Pause(told.time_s)
            case events.TrialSpoiled() if limit_s is not None:
                act = ports.TimedOut(told.time_s)
            case events.TrialRated():
                act = ports.Confirm(told.time_s, told.values, told.response_time_s)
            case events.ActRefused():
                act = self._refuse_again(told)
        if act is None:
            raise ValueError(f"holds {told.event!r} where an answer is due")
        return act

    def _feel(self, told: events.PartPlayed | events.PartReplayed) -> ports.Feel:
        """Ask for the part that was asked for, or for all, where the journal may only name those that were played."""
        if isinstance(told, events.PartReplayed):
            return ports.Feel(told.time_s, told.part)
        names = [part.name for part in self._attempt.trial.parts]
        coming = (one.part for one in self._list_coming() if isinstance(one, events.PartPlayed))
        pairs = takewhile(lambda pair: pair[0] == pair[1], zip(coming, names, strict=False))
        unfelt = self._attempt.list_unfelt()
        is_all = any(name not in unfelt for name, _ in pairs)
        return ports.Feel(told.requested_s, "" if is_all else told.part)

    def _refuse_again(self, told: events.ActRefused) -> ports.Act:
        """Do what is refused for the reason that stands there."""
        trial = self._attempt.trial
        if told.reason == "no_replay":
            return ports.Feel(told.time_s)
        if told.reason == "unknown_part":
            return ports.Move(told.time_s, next(iter(told.parts), ""), nan)
        sure = next(iter(find_choices(trial.protocol)), 50.0)
        given = {part: sure for part in trial.judged if part not in told.parts}
        return ports.Confirm(told.time_s, given)

    def refuse(self, reason: str, _parts: Iterable[str]) -> None:
        """Hear that an act is refused: what stands in the journal was taken."""
        if self._page:
            raise ValueError(f"leaves {self._page}, which is not left so ({reason})")
