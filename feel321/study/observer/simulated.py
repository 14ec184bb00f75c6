"""The presenter of simulated participants: it needs no screen and no actuator, and answers by itself."""

from __future__ import annotations

from typing import TYPE_CHECKING

from feel321.protocols.matching import SECOND
from feel321.protocols.trial import MATCHING, Page, Part, Scale, Trial
from feel321.study.observer.participant import (
    REAL,
    STROKE_S,
    Experience,
    Location,
    Participant,
    feel_level,
)
from feel321.study.session.ports import (
    Act,
    Confirm,
    Feel,
    Move,
    Place,
    Playback,
    Scaled,
    TimedOut,
    Tone,
)

if TYPE_CHECKING:
    from collections.abc import Iterator

    from feel321.protocols.questions import Question
    from feel321.stimuli.sets.manifest import Stimulus


class SimulatedObserver(Participant):
    """A presenter that needs no screen and no actuator: it answers by itself."""

    _confirmed: Experience | None = None
    _missed: tuple[str, ...] = ()

    def show_page(self, page: Page, place: Place) -> Confirm:  # noqa: ARG002 - the port's form
        """Read a page for as long as it must be shown."""
        self._pass_time(page.least_s)
        return Confirm(self._time_s, {}, page.least_s)

    def show_question(self, question: Question, place: Place) -> Confirm:
        """Answer a question page."""
        value, response_s = self.answer_question(question, occasion=place.attempt)
        self._pass_time(response_s)
        values = {} if value is None else {question.name: value}
        return Confirm(self._time_s, values, round(response_s, 3))

    def show_trial(self, trial: Trial, scale: Scale, place: Place) -> None:
        """Begin a trial."""
        self.before, self._confirmed = self._confirmed or self.before, None
        self._points: dict[str, Location] = {}
        self._tones: dict[str, Tone] = {}
        self._levels_db: dict[str, float] = {}
        self._shown_s = self._time_s
        felt = Experience(trial, self._points, self._tones, self._levels_db)
        self._acts = self._list_acts(felt, scale, place)

    def play(
        self,
        part: Part,
        stimulus: Stimulus | Tone | Scaled,
        *,
        gap_s: float,
        due_s: float | None = None,
    ) -> Playback:
        """Feel a stimulus."""
        gap_s = gap_s if due_s is None else max(gap_s, due_s - self._time_s)
        if isinstance(stimulus, Scaled):
            self._levels_db.setdefault(part.name, feel_level(stimulus))
            return self._pass_playback(gap_s, stimulus.duration_s)
        if isinstance(stimulus, Tone):
            self._tones[part.name] = stimulus
            return self._pass_playback(gap_s, stimulus.duration_s)
        self._points[part.name] = self.touch.locate(stimulus)
        return self._pass_playback(gap_s, stimulus.duration_s)

    def prompt(self, part: Part) -> Playback:
        """Stroke the real surface."""
        self._points[part.name] = REAL
        return self._pass_playback(0.0, STROKE_S)

    def wait(self, limit_s: float | None = None) -> Act:
        """Feel what can be felt at will, then confirm, if there is time for that."""
        act = next(self._acts)
        if limit_s is None or not isinstance(act, Confirm) or act.response_time_s <= limit_s:
            return act
        self._confirmed = None
        self._time_s = round(self._time_s - act.response_time_s + limit_s, 3)
        return TimedOut(self._time_s)

    def refuse(self, reason: str, parts: tuple[str, ...]) -> None:
        """Feel what was not felt before the same answer is given again."""
        self._missed = parts if reason == "not_felt" else ()
        self._confirmed = None

    def _list_acts(self, experience: Experience, scale: Scale, place: Place) -> Iterator[Act]:
        trial = experience.trial
        if trial.timing == "free":
            for part in trial.parts:
                yield Feel(self._time_s, part.name)
        values, response_s = self.answer(experience, scale, place)
        asked_s = self._time_s
        self._pass_time(response_s)
        if trial.protocol == MATCHING:
            # As early as the trial: an attempt that is broken off takes none of a simulated participant's time.
            yield Move(self._shown_s, SECOND, float(values[SECOND]))
            yield Feel(self._time_s)
        while True:
            if trial.phase == "main":
                self._confirmed = experience
            yield Confirm(self._time_s, values, round(self._time_s - asked_s, 3))
            for name in self._missed:
                yield Feel(self._time_s, name)

    def _pass_playback(self, gap_s: float, duration_s: float) -> Playback:
        self._pass_time(gap_s)
        onset_s = self._time_s
        self._pass_time(duration_s)
        return Playback(requested_s=onset_s, onset_s=onset_s)

    def _pass_time(self, duration_s: float) -> None:
        self._time_s = round(self._time_s + duration_s, 3)  # read in whole ms
