"""Simulated participants: answers, memory, and the presenter that gives them.

Every draw depends on seed, participant, trial and attempt alone, and the trial before can be recalled, so that an
interrupted session that is resumed gives the answers of an uninterrupted one.

Their clock adds up what stimuli, pages and answers take, so that a session of an hour is over in a second.
"""

from __future__ import annotations

from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from feel321.protocols.trial import RATING_RANGE
from feel321.study.observer.judging import (
    REAL,
    Experience,
    Location,
    ObserverModel,
    Touch,
    draw_rater,
    find_percept,
    find_sure_end,
    measure_distances,
)
from feel321.study.session.events import TrialRated
from feel321.study.session.ports import Confirm, Feel, Playback

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping

    import numpy as np

    from feel321.protocols.trial import Page, Part, Scale, Trial
    from feel321.stimuli.sets.manifest import Stimulus
    from feel321.study.observer.percepts import Percept
    from feel321.study.session.journal import Record
    from feel321.study.session.ports import Act, Place

MIDDLE = sum(RATING_RANGE) / 2
"""Percept of a trial that does not shift the answer to the next one, in points."""

FATIGUE_TRIALS = 100
"""Trials for which the size of fatigue is given."""


class Participant:
    """A simulated participant: what they answer to what they felt, and what they remember of it."""

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
        """Recall the trial that was answered last before a session was interrupted."""
        main = {trial.number: trial for trial in trials if trial.phase == "main"}
        rated = [record.data["trial"] for record in records if record.event == TrialRated.event]
        if answered := [main[number] for number in rated if number in main]:
            self.before = self.imagine(answered[-1], stimuli)

    def imagine(self, trial: Trial, stimuli: Mapping[str, Stimulus]) -> Experience:
        """Compute how all parts of a trial feel."""
        felt = {
            part.name: stimuli[part.stimulus_id] if part.stimulus_id else None
            for part in trial.parts
        }
        return Experience(
            trial, {name: self.touch.locate(stimulus) for name, stimulus in felt.items()}
        )

    def answer(
        self, experience: Experience, scale: Scale, place: Place
    ) -> tuple[dict[str, float | str], float]:
        """Answer a trial: the values by part, and the time that this took in s."""
        trial, model = experience.trial, self.touch.model
        rng = self._draw_from(trial.number, place.attempt)
        tired = place.done / FATIGUE_TRIALS
        growth = 1 + model.fatigue_noise * tired
        values: dict[str, float | str] = {}
        for judgement in trial.judgements:
            if scale.choices:
                distances = measure_distances(
                    experience, judgement, scale.choices, touch=self.touch
                )
                values[judgement.part] = self.rater.choose(distances, growth=growth, rng=rng)
            else:
                values[judgement.part] = self.rater.rate(
                    find_percept(experience, judgement, touch=self.touch),
                    sure=find_sure_end(trial),
                    shift=model.fatigue * tired - self._find_contrast(trial),
                    growth=growth,
                    rng=rng,
                )
        return values, len(values) * self.rater.draw_time(rng)

    def _find_contrast(self, trial: Trial) -> float:
        """Compute what the trial before takes away, in points; points on another scale take nothing."""
        before, order = self.before, self.touch.model.order
        if not order or before is None or trial.phase != "main":
            return 0.0
        if before.trial.scale != trial.scale:
            return 0.0
        percepts = [
            find_percept(before, judgement, touch=self.touch)
            for judgement in before.trial.judgements
        ]
        return order * (sum(percepts) / len(percepts) - MIDDLE)

    def _draw_from(self, trial: int, attempt: int) -> np.random.Generator:
        import numpy as np

        return np.random.default_rng([self._seed, self._number, trial, attempt])


STROKE_S = 3.0
"""Duration of a stroke over the real surface."""


class SimulatedObserver(Participant):
    """A presenter that needs no screen and no actuator: it answers by itself."""

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
        self._time_s = elapsed_s
        self._confirmed: Experience | None = None
        self._missed: tuple[str, ...] = ()

    def show_page(self, page: Page, place: Place) -> Confirm:  # noqa: ARG002 - the port's form
        """Read a page for as long as it must be shown."""
        self._pass_time(page.least_s)
        return Confirm(self._time_s, {}, page.least_s)

    def show_trial(self, trial: Trial, scale: Scale, place: Place) -> None:
        """Begin a trial."""
        self.before, self._confirmed = self._confirmed or self.before, None
        self._points: dict[str, Location] = {}
        self._acts = self._list_acts(Experience(trial, self._points), scale, place)

    def play(self, part: Part, stimulus: Stimulus, *, gap_s: float) -> Playback:
        """Feel a stimulus."""
        self._points[part.name] = self.touch.locate(stimulus)
        return self._pass_playback(gap_s, stimulus.duration_s)

    def prompt(self, part: Part) -> Playback:
        """Stroke the real surface."""
        self._points[part.name] = REAL
        return self._pass_playback(0.0, STROKE_S)

    def wait(self) -> Act:
        """Feel what can be felt at will, then confirm."""
        return next(self._acts)

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


def identify_observer(model: ObserverModel, *, seed: int) -> dict[str, Any]:
    """List what the answers of simulated participants depend on, for the header of their journals."""
    return {"simulated": True, "seed": seed, "observer": model.model_dump()}
