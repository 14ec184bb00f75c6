"""Simulated participants: a presenter without screen and actuators, who answers by known rules.

How stimuli feel stands in `judging`, who the participants are in `raters`. Every draw depends on seed, participant,
trial and attempt alone, and what came before a break can be recalled, so that a session that was broken off and
resumed gives the answers of one that was not.
"""

from __future__ import annotations

from dataclasses import asdict
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from protocols.trial import RATING_RANGE
from study.judging import REAL, Experience, Point, Touch, compare, judge
from study.ports import Confirm, Feel, Move, Playback
from study.raters import ObserverModel, draw_rater

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping

    import numpy as np

    from protocols.flow import Page
    from protocols.trial import Part, Scale, Trial
    from stimuli.manifest import Stimulus
    from study.chain import Record
    from study.percepts import Percept
    from study.ports import Act, Place

__all__ = ["ObserverModel", "SimulatedObserver", "identify_observer"]

STROKE_S = 3.0
"""How long the real surface is stroked."""

MIDDLE = sum(RATING_RANGE) / 2
"""The percept after which there is no contrast, in points."""

FATIGUE_TRIALS = 100
"""Trials for which the size of fatigue is given."""


class SimulatedObserver:
    """A participant who needs no screen and no actuator.

    Parameters
    ----------
    model : ObserverModel
        How participants feel.
    seed : int
        Seed of all draws.
    number : int
        The participant's number.
    percepts : mapping of str to Percept
        Percept of each stimulus by its id; needed where the model uses them.
    elapsed_s : float
        Where the participant's clock stands: 0, or where a session that is resumed was broken off.

    Attributes
    ----------
    rater : Rater
        Who it is.
    reports_moves : bool
        Whether it says where it left each slider before it confirms; every report is one more record on the disk.
    """

    def __init__(
        self,
        model: ObserverModel,
        *,
        seed: int,
        number: int,
        percepts: Mapping[str, Percept] = MappingProxyType({}),
        elapsed_s: float = 0.0,
    ) -> None:
        self._touch, self._seed, self._number = Touch(model, percepts), seed, number
        self.rater = draw_rater(model, self._draw_from(0, 0))
        self.reports_moves = False
        self._time_s = elapsed_s
        self._before: Experience | None = None
        self._confirmed: Experience | None = None
        self._missed: tuple[str, ...] = ()

    def recall(self, records: Iterable[Record], trials: Iterable[Trial], *, stimuli: Mapping[str, Stimulus]) -> None:
        """Recall the trial that was answered last before a session was broken off.

        Parameters
        ----------
        records : iterable of Record
            The session's journal.
        trials : iterable of Trial
            The session's trials.
        stimuli : mapping of str to Stimulus
            The stimuli by the names that they have in the trials.
        """
        main = {trial.number: trial for trial in trials if trial.phase == "main"}
        rated = [record.data["trial"] for record in records if record.event == "rated" and record.data["trial"] in main]
        if rated:
            trial = main[rated[-1]]
            felt = {part.name: stimuli[part.stimulus_id] if part.stimulus_id else None for part in trial.parts}
            self._before = Experience(trial, {name: self._touch.locate(stimulus) for name, stimulus in felt.items()})

    def show_page(self, page: Page, place: Place) -> Confirm:  # noqa: ARG002 - the port's form
        """Read a page for as long as it must stand.

        Parameters
        ----------
        page : Page
            The page.
        place : Place
            How far the session has come.

        Returns
        -------
        Confirm
            At the first moment at which that can be done.
        """
        self._pass(page.least_s)
        return Confirm(self._time_s, {})

    def show_trial(self, trial: Trial, scale: Scale, place: Place) -> None:
        """Take note of the trial.

        Parameters
        ----------
        trial : Trial
            The trial that begins.
        scale : Scale
            The scale that it will be answered on.
        place : Place
            How far the session has come.
        """
        self._before, self._confirmed = self._confirmed or self._before, None
        self._points: dict[str, Point] = {}
        self._acts = self._take_part(Experience(trial, self._points), scale, place)

    def play(self, part: Part, stimulus: Stimulus, *, gap_s: float) -> Playback:
        """Feel a stimulus.

        Parameters
        ----------
        part : Part
            The part that it is.
        stimulus : Stimulus
            What to feel.
        gap_s : float
            Silence before it, in s.

        Returns
        -------
        Playback
            Without fault.
        """
        self._points[part.name] = self._touch.locate(stimulus)
        return self._spend(gap_s, stimulus.duration_s)

    def prompt(self, part: Part) -> Playback:
        """Stroke the real surface.

        Parameters
        ----------
        part : Part
            The part that it is.

        Returns
        -------
        Playback
            Without fault.
        """
        self._points[part.name] = REAL
        return self._spend(0.0, STROKE_S)

    def wait(self) -> Act:
        """Do the next thing: feel what can be felt at will, move the sliders, confirm.

        Returns
        -------
        Feel, Move or Confirm
            What was done.
        """
        return next(self._acts)

    def refuse(self, reason: str, parts: tuple[str, ...]) -> None:
        """Hear that an answer was not accepted: what was not felt is felt before the same answer is given again.

        Parameters
        ----------
        reason : str
            Why.
        parts : tuple of str
            What is missing.
        """
        self._missed = parts if reason == "not_felt" else ()
        self._confirmed = None

    def _take_part(self, experience: Experience, scale: Scale, place: Place) -> Iterator[Act]:
        trial = experience.trial
        if trial.timing == "free":
            for part in trial.parts:
                yield Feel(self._time_s, part.name)
        values, response_s = self._decide(experience, scale, place)
        asked_s = self._time_s
        moves = [(name, value) for name, value in values.items() if self.reports_moves and isinstance(value, float)]
        for name, points in moves:
            self._pass(response_s / (len(moves) + 1))
            yield Move(self._time_s, name, points)
        self._pass(response_s / (len(moves) + 1))
        while True:
            if trial.phase == "main":
                self._confirmed = experience
            yield Confirm(self._time_s, values, round(self._time_s - asked_s, 3))
            for name in self._missed:
                yield Feel(self._time_s, name)

    def _decide(self, experience: Experience, scale: Scale, place: Place) -> tuple[dict[str, float | str], float]:
        """Draw the answers to a trial, and the time in s that they take."""
        trial = experience.trial
        rng = self._draw_from(trial.number, place.attempt)
        tired = place.done / FATIGUE_TRIALS
        growth = 1 + self._touch.model.fatigue_noise * tired
        values: dict[str, float | str] = {}
        if scale.choices:
            for judgement in trial.judgements:
                distances = compare(experience, judgement, scale.choices, touch=self._touch)
                values[judgement.part] = self.rater.choose(distances, growth=growth, rng=rng)
        else:
            shift = self._touch.model.fatigue * tired - self._contrast(trial)
            for judgement in trial.judgements:
                percept = judge(experience, judgement, touch=self._touch)
                values[judgement.part] = self.rater.rate(percept, shift=shift, growth=growth, rng=rng)
        return values, len(values) * self.rater.take_time(rng)

    def _contrast(self, trial: Trial) -> float:
        """Tell what the trial before takes away, in points; points on another scale take nothing."""
        before, order = self._before, self._touch.model.order
        if not order or before is None or trial.phase != "main" or before.trial.scale != trial.scale:
            return 0.0
        percepts = [judge(before, judgement, touch=self._touch) for judgement in before.trial.judgements]
        return order * (sum(percepts) / len(percepts) - MIDDLE)

    def _spend(self, gap_s: float, duration_s: float) -> Playback:
        self._pass(gap_s)
        onset_s = self._time_s
        self._pass(duration_s)
        return Playback(requested_s=onset_s, onset_s=onset_s)

    def _pass(self, duration_s: float) -> None:
        # What is reported is what the clock reads, or a resumed session would drift from an uninterrupted one.
        self._time_s = round(self._time_s + duration_s, 3)

    def _draw_from(self, trial: int, attempt: int) -> np.random.Generator:
        import numpy as np

        return np.random.default_rng([self._seed, self._number, trial, attempt])


def identify_observer(model: ObserverModel, *, seed: int) -> dict[str, Any]:
    """Say what the answers of simulated participants depend on, for the header of their journals.

    Parameters
    ----------
    model : ObserverModel
        How participants feel.
    seed : int
        Seed of all draws.

    Returns
    -------
    dict
        Everything, as JSON can hold it.
    """
    return {"simulated": True, "seed": seed, "observer": asdict(model)}
