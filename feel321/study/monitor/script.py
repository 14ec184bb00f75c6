"""Reconstruct a session from its journal: every screen with its time, and every stimulus that was played.

What the journal does not record is omitted: slider movement, digits being typed, the first of two presses of a key.
A stopped part, and a stroke, are taken to end at the next recorded event.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import singledispatchmethod
from math import ceil
from typing import TYPE_CHECKING

from feel321.protocols.detection import INTERVALS
from feel321.protocols.matching import ATTENUATION_DB, MIDDLE, SECOND, Matching
from feel321.protocols.trial import FREE, MATCHING, Page
from feel321.study.screen.input import Answer
from feel321.study.screen.view import ScreenTexts, View
from feel321.study.session import events
from feel321.study.session.engine import find_scale
from feel321.study.session.pace import TIMED_OUT, TOLD_S, find_gap
from feel321.study.session.plan import Plan, advance
from feel321.study.session.ports import Place, Scaled, Surface, Tone

if TYPE_CHECKING:
    from feel321.protocols.agenda import Agenda
    from feel321.protocols.trial import Scale, Trial
    from feel321.stimuli.sets.manifest import Stimulus
    from feel321.study.session.journal import Record, Records

SEEN_S = 0.5
"""How long an answer is shown of which the journal holds only when it was confirmed."""

BEGINNINGS = {events.PartPlayed.event, events.SurfaceStroked.event}


@dataclass(frozen=True, slots=True)
class Shot:
    """A screen of a session.

    at_s: when it comes in the replay, which never goes back; time_s: the session's own time, which may begin again
    where a crash lost some of it; sequence: the record that it follows from; heard: what begins to play.
    """

    at_s: float
    time_s: float
    view: View
    sequence: int
    heard: Stimulus | Tone | Scaled | None = None


@dataclass(frozen=True, slots=True)
class Cast:
    """Everything besides the journal that a screen shows: plan, texts, scales, stimuli by code, and surfaces.

    reading_s: least time for a page; simulated participants do not read.
    """

    plan: Plan
    texts: ScreenTexts
    scales: Mapping[str, Scale]
    stimuli: Mapping[str, Stimulus]
    surfaces: Mapping[str, Surface] = field(default_factory=dict)
    reading_s: float = 0.0


def make_shots(cast: Cast, records: Records, agenda: Agenda) -> list[Shot]:
    """List the screens of a session in order; agenda: that of the plan before anything was done."""
    stage = _Stage(cast, records, agenda)
    trials = {trial.number: trial for trial in cast.plan.trials}
    for record in records:
        stage.record = record
        stage.take(event := record.content)
        advance(agenda, event, trials)
    return stage.shots


class _Stage:
    """What is on the screen while a journal is read."""

    def __init__(self, cast: Cast, records: Records, agenda: Agenda) -> None:
        self._cast, self._records, self._agenda = cast, records, agenda
        self._trials = {trial.number: trial for trial in cast.plan.trials}
        self._tasks = {task.protocol: task for task in cast.plan.tasks}
        self._matching = (
            Matching(cast.plan.matching, cast.plan.trials) if cast.plan.matching else None
        )
        self._tones: dict[str, Tone] = {}
        self._view = View("page", "reading", 0, Place(0, 0))
        self._time_s = self._offset_s = self._possible_s = 0.0
        self.shots: list[Shot] = []
        self.record = records[0]

    def show(
        self, time_s: float, view: View, *, heard: Stimulus | Tone | Scaled | None = None
    ) -> None:
        last_s = self.shots[-1].at_s if self.shots else 0.0
        self._time_s = max(self._time_s, time_s)
        task = self._tasks.get(view.trial.protocol) if view.trial else None
        limit_s = task.answer_timeout_s if task else None
        if limit_s is not None and view.state == "answering":
            left_s = ceil(limit_s - time_s + self._possible_s)
            view = replace(view, left_s=max(1, left_s))
        at_s = max(last_s, time_s + self._offset_s)
        self.shots.append(Shot(at_s, time_s, view, self.record.sequence, heard))
        self._view = replace(view, notice="")

    def show_page(self, page: Page, began_s: float, ended_s: float) -> None:
        """Show a page; while it may not be left it counts the seconds down."""
        view = View("page", "reading", self._view.screen + 1, self._find_place(), page)
        self.show(began_s, replace(view, left_s=ceil(page.least_s)))
        for left_s in range(ceil(page.least_s) - 1, -1, -1):
            if (time_s := began_s + page.least_s - left_s) <= ended_s:
                self.show(time_s, replace(view, left_s=left_s))
        self._end_page(began_s, ended_s)

    @singledispatchmethod
    def take(self, event: events.SessionEvent) -> None:
        """Take an event; most change nothing on the screen."""

    @take.register
    def _(self, _event: events.SessionResumed) -> None:
        past = (
            r.data["time_s"] for r in self._records[: self.record.sequence] if "time_s" in r.data
        )
        self._time_s = max(past, default=0.0)
        last_s = self.shots[-1].at_s if self.shots else 0.0
        self._offset_s = max(self._offset_s, last_s - self._time_s)

    @take.register
    def _(self, event: events.PageRead) -> None:
        step = self._agenda.ask()
        page = step if isinstance(step, Page) and step.key == event.key else _make_aside(event.key)
        self.show_page(page, event.time_s - event.stood_s, event.time_s)

    @take.register
    def _(self, event: events.QuestionAnswered) -> None:
        asked = next(one for one in self._cast.plan.questions if one.name == event.question)
        began_s = event.time_s - event.stood_s
        place = replace(self._find_place(), attempt=event.occasion)
        view = View(
            "page", "reading", self._view.screen + 1, place, Page(asked.key), question=asked
        )
        self.show(began_s, view)
        if event.value is not None:
            felt, value, chosen = frozenset({asked.name}), event.value, ""
            typed = f"{value:g}" if isinstance(value, float) else str(value)
            if asked.choices:
                typed, chosen = "", str(asked.choices.index(value))
            seen_s = max(began_s, event.time_s - SEEN_S)
            self.show(seen_s, replace(view, felt=felt, typed=typed, chosen=chosen))
        self._end_page(began_s, event.time_s)

    @take.register
    def _(self, event: events.TrialShown) -> None:
        trial = self._trials[event.trial]
        scale = find_scale(trial, self._cast.scales)
        answer = Answer(trial, scale, self._cast.texts.own_keys)
        surface = self._cast.surfaces.get(trial.recording, Surface(None, None))
        self._tones = {}
        self._possible_s = self._time_s
        view = View(
            answer.kind,
            "answering" if trial.timing == FREE else "feeling",
            self._view.screen + 1,
            replace(self._find_place(), attempt=event.attempt),
            trial=trial,
            scale=scale,
            selected=answer.selected,
            picture=surface.picture,
            sample=surface.sample or "",
        )
        self.show(self._time_s, view)

    @take.register
    def _(self, event: events.TonePresented) -> None:
        block = self._cast.plan.threshold
        duration_s = block.duration_s if block else 0.0
        for place, name in enumerate(INTERVALS, start=1):
            level_db = event.level_db if place == event.interval else None
            self._tones[name] = Tone(event.frequency_hz, duration_s, level_db)

    @take.register
    def _(self, event: events.PartPlayed) -> None:
        trial = self._trials[event.trial]
        began_s = event.requested_s - find_gap(
            trial, self._tasks.get(trial.protocol), self._cast.plan.flow
        )
        is_first = self._view.state == "feeling" and not self._view.playing
        began_s = self._time_s if is_first else max(self._time_s, began_s)
        is_row = self._view.kind == "rows" and event.part in trial.judged
        selected = event.part if is_row else self._view.selected
        view = replace(self._view, state="feeling", playing=event.part, selected=selected)
        self.show(began_s, view)
        heard = self._find_heard(trial, event.part)
        onset_s = event.requested_s if event.onset_s is None else event.onset_s
        end_s = onset_s
        if heard is not None and not event.error:
            self.show(onset_s, self._view, heard=heard)
            end_s = onset_s + heard.duration_s
        self._end_part(event, end_s if event.completed else min(end_s, self._find_next(end_s)))

    @take.register
    def _(self, event: events.SurfaceStroked) -> None:
        self.show(event.requested_s, replace(self._view, state="stroking", playing=event.part))
        self._end_part(event, self._find_next(event.requested_s))

    @take.register
    def _(self, event: events.PartReplayed) -> None:
        self._time_s = max(self._time_s, event.time_s)

    @take.register
    def _(self, event: events.MarkerMoved) -> None:
        markers = {**self._view.markers, event.part: event.value}
        self.show(event.time_s, replace(self._view, markers=markers, selected=event.part))

    @take.register
    def _(self, event: events.ActRefused) -> None:
        trial = self._trials[event.trial]
        notice = self._cast.texts.explain(event.reason, event.parts, trial)
        self.show(event.time_s, replace(self._view, notice=notice))

    @take.register
    def _(self, event: events.TrialPaused) -> None:
        ended_s = self._find_next(event.time_s)
        self.show_page(Page("pause"), event.time_s, ended_s)

    @take.register
    def _(self, event: events.TrialRated) -> None:
        values = event.values
        chosen = next((value for value in values.values() if isinstance(value, str)), "")
        markers = {} if chosen else {key: float(value) for key, value in values.items()}
        view = replace(self._view, state="answering", playing="", chosen=chosen, markers=markers)
        if replace(view, left_s=0) != replace(self._view, left_s=0):
            self.show(max(self._time_s, event.time_s - SEEN_S), view)
        self._time_s = max(self._time_s, event.time_s)

    @take.register
    def _(self, event: events.TrialSpoiled) -> None:
        self._time_s = max(self._time_s, event.time_s)

    def _find_place(self) -> Place:
        return Place(self._agenda.done, self._agenda.total)

    def _end_page(self, began_s: float, ended_s: float) -> None:
        self._time_s = max(self._time_s, ended_s)
        self._offset_s += max(0.0, self._cast.reading_s - (ended_s - began_s))

    def _end_part(self, event: events.PartPlayed, end_s: float) -> None:
        """End a part; the screen changes at once unless another part follows."""
        is_felt = event.completed and not event.error
        felt = self._view.felt | ({event.part} if is_felt else set())
        self._view = replace(self._view, felt=felt, playing="")
        self._time_s = self._possible_s = max(self._time_s, end_s)
        following = self._records[self.record.sequence + 1 :]
        if following and following[0].event not in {*BEGINNINGS, events.TrialSpoiled.event}:
            self.show(self._time_s, replace(self._view, state="answering"))

    def _find_heard(self, trial: Trial, name: str) -> Stimulus | Tone | Scaled | None:
        part = next(part for part in trial.parts if part.name == name)
        if name in self._tones:
            return self._tones[name]
        stimulus = self._cast.stimuli.get(part.stimulus_id or "")
        if stimulus is None or self._matching is None or trial.protocol != MATCHING:
            return stimulus
        marker = self._view.markers.get(SECOND, MIDDLE)
        offset_db = self._matching.find_offset(trial.number, marker) if name == SECOND else 0.0
        return Scaled(stimulus, offset_db - ATTENUATION_DB)

    def _find_next(self, least_s: float) -> float:
        """Find the next time that the journal knows, at least as late as a given one."""
        for record in self._records[self.record.sequence + 1 :]:
            known_s = _find_start(record)
            if known_s is not None:
                return max(least_s, known_s)
        return least_s


def _make_aside(key: str) -> Page:
    """Make a page that no plan holds."""
    by = "experimenter" if key == "call_us" else "participant"
    return Page(key, TOLD_S if key == TIMED_OUT else 0.0, by)


def _find_start(record: Record) -> float | None:
    """Find when what a record tells began."""
    data = record.data
    if record.event in BEGINNINGS:
        return float(data["requested_s"])
    if "time_s" not in data:
        return None
    before_s = data.get("stood_s", data.get("response_time_s", 0.0))
    return float(data["time_s"] - before_s)
