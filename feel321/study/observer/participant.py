"""A simulated participant: answers, memory, and the presenter that gives them.

Every draw depends on seed, participant, trial and attempt alone, and the trial before can be recalled, so that a
session that was broken off and resumed gives the answers of one that was not.

Their clock is what stimuli, pages and answers take, so that a session of an hour is over in a second.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from feel321.protocols.trial import RATING_RANGE
from feel321.study.observer.judging import (
    REAL,
    Experience,
    ObserverModel,
    Point,
    Touch,
    compare,
    draw_rater,
    find_slider,
    judge,
)
from feel321.study.session.ports import Confirm, Feel, Playback

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping

    import numpy as np

    from feel321.protocols.trial import Page, Part, Scale, Trial
    from feel321.stimuli.sets.manifest import Stimulus
    from feel321.study.observer.percepts import Percept
    from feel321.study.session.journal import Record
    from feel321.study.session.ports import Act, Place

# The mind of a simulated participant: what they answer to what they felt, and what they remember of it.

MIDDLE = sum(RATING_RANGE) / 2
"""The percept after which there is no contrast, in points."""

FATIGUE_TRIALS = 100
"""Trials for which the size of fatigue is given."""


class Participant:
    """A simulated participant."""

    def __init__(
        self,
        model: ObserverModel,
        *,
        seed: int,
        number: int,
        percepts: Mapping[str, Percept] = MappingProxyType({}),
    ) -> None:
        self._seed, self._number = seed, number
        self.touch = Touch(model, percepts)
        self.rater = draw_rater(model, self._draw_from(0, 0))
        self.before: Experience | None = None

    def recall(
        self, records: Iterable[Record], trials: Iterable[Trial], *, stimuli: Mapping[str, Stimulus]
    ) -> None:
        """Recall the trial that was answered last before a session was broken off."""
        main = {trial.number: trial for trial in trials if trial.phase == "main"}
        rated = [
            record.data["trial"]
            for record in records
            if record.event == "rated" and record.data["trial"] in main
        ]
        if rated:
            trial = main[rated[-1]]
            felt = {
                part.name: stimuli[part.stimulus_id] if part.stimulus_id else None
                for part in trial.parts
            }
            self.before = Experience(
                trial, {name: self.touch.locate(stimulus) for name, stimulus in felt.items()}
            )

    def answer(
        self, experience: Experience, scale: Scale, place: Place
    ) -> tuple[dict[str, float | str], float]:
        """Answer a trial."""
        trial = experience.trial
        rng = self._draw_from(trial.number, place.attempt)
        tired = place.done / FATIGUE_TRIALS
        growth = 1 + self.touch.model.fatigue_noise * tired
        values: dict[str, float | str] = {}
        if scale.choices:
            for judgement in trial.judgements:
                distances = compare(experience, judgement, scale.choices, touch=self.touch)
                values[judgement.part] = self.rater.choose(distances, growth=growth, rng=rng)
        else:
            sure = find_slider(trial).sure
            shift = self.touch.model.fatigue * tired - self._contrast(trial)
            for judgement in trial.judgements:
                percept = judge(experience, judgement, touch=self.touch)
                values[judgement.part] = self.rater.rate(
                    percept, sure=sure, shift=shift, growth=growth, rng=rng
                )
        return values, len(values) * self.rater.take_time(rng)

    def _contrast(self, trial: Trial) -> float:
        """Tell what the trial before takes away, in points; points on another scale take nothing."""
        before, order = self.before, self.touch.model.order
        if (
            not order
            or before is None
            or trial.phase != "main"
            or before.trial.scale != trial.scale
        ):
            return 0.0
        percepts = [
            judge(before, judgement, touch=self.touch) for judgement in before.trial.judgements
        ]
        return order * (sum(percepts) / len(percepts) - MIDDLE)

    def _draw_from(self, trial: int, attempt: int) -> np.random.Generator:
        import numpy as np

        return np.random.default_rng([self._seed, self._number, trial, attempt])


# Simulated participants: a presenter without screen and actuators.

__all__ = ["ObserverModel", "SimulatedObserver", "identify_observer"]

STROKE_S = 3.0
"""How long the real surface is stroked."""


class SimulatedObserver(Participant):
    """A participant who needs no screen and no actuator."""

    def __init__(
        self,
        model: ObserverModel,
        *,
        seed: int,
        number: int,
        percepts: Mapping[str, Percept] = MappingProxyType({}),
        elapsed_s: float = 0.0,
    ) -> None:
        super().__init__(model, seed=seed, number=number, percepts=percepts)
        self._clock = _Clock(elapsed_s)
        self._confirmed: Experience | None = None
        self._missed: tuple[str, ...] = ()

    def show_page(self, page: Page, place: Place) -> Confirm:  # noqa: ARG002 - the port's form
        """Read a page for as long as it must stand."""
        self._clock.spend(page.least_s)
        return Confirm(self._clock.time_s, {}, page.least_s)

    def show_trial(self, trial: Trial, scale: Scale, place: Place) -> None:
        """Take note of the trial."""
        self.before, self._confirmed = self._confirmed or self.before, None
        self._points: dict[str, Point] = {}
        self._acts = self._take_part(Experience(trial, self._points), scale, place)

    def play(self, part: Part, stimulus: Stimulus, *, gap_s: float) -> Playback:
        """Feel a stimulus."""
        self._points[part.name] = self.touch.locate(stimulus)
        return self._clock.play(gap_s, stimulus.duration_s)

    def prompt(self, part: Part) -> Playback:
        """Stroke the real surface."""
        self._points[part.name] = REAL
        return self._clock.play(0.0, STROKE_S)

    def wait(self) -> Act:
        """Do the next thing: feel what can be felt at will, confirm."""
        return next(self._acts)

    def refuse(self, reason: str, parts: tuple[str, ...]) -> None:
        """Hear that an answer was not accepted: what was not felt is felt before the same answer is given again."""
        self._missed = parts if reason == "not_felt" else ()
        self._confirmed = None

    def _take_part(self, experience: Experience, scale: Scale, place: Place) -> Iterator[Act]:
        trial = experience.trial
        if trial.timing == "free":
            for part in trial.parts:
                yield Feel(self._clock.time_s, part.name)
        values, response_s = self.answer(experience, scale, place)
        asked_s = self._clock.time_s
        self._clock.spend(response_s)
        while True:
            if trial.phase == "main":
                self._confirmed = experience
            yield Confirm(self._clock.time_s, values, round(self._clock.time_s - asked_s, 3))
            for name in self._missed:
                yield Feel(self._clock.time_s, name)


@dataclass(slots=True)
class _Clock:
    """The participant's own time, in s; what is reported is what it reads, in ms."""

    time_s: float

    def spend(self, duration_s: float) -> None:
        self.time_s = round(self.time_s + duration_s, 3)

    def play(self, gap_s: float, duration_s: float) -> Playback:
        self.spend(gap_s)
        onset_s = self.time_s
        self.spend(duration_s)
        return Playback(requested_s=onset_s, onset_s=onset_s)


def identify_observer(model: ObserverModel, *, seed: int) -> dict[str, Any]:
    """Say what the answers of simulated participants depend on, for the header of their journals."""
    return {"simulated": True, "seed": seed, "observer": asdict(model)}
