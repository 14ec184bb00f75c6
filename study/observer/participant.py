"""The mind of a simulated participant: what they answer to what they felt, and what they remember of it.

Every draw depends on seed, participant, trial and attempt alone, and the trial before can be recalled, so that a
session that was broken off and resumed gives the answers of one that was not.
"""

from __future__ import annotations

from types import MappingProxyType
from typing import TYPE_CHECKING

from protocols.trial import RATING_RANGE
from study.observer.judging import Experience, Touch, compare, find_slider, judge
from study.observer.raters import draw_rater

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    import numpy as np

    from protocols.trial import Scale, Trial
    from stimuli.manifest import Stimulus
    from study.observer.percepts import Percept
    from study.observer.raters import ObserverModel
    from study.session.chain import Record
    from study.session.ports import Place

MIDDLE = sum(RATING_RANGE) / 2
"""The percept after which there is no contrast, in points."""

FATIGUE_TRIALS = 100
"""Trials for which the size of fatigue is given."""


class Participant:
    """A simulated participant.

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

    Attributes
    ----------
    rater : Rater
        How they use a scale.
    touch : Touch
        How things feel to them.
    before : Experience or None
        The trial of the main phase that they answered last.
    """

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
            self.before = Experience(trial, {name: self.touch.locate(stimulus) for name, stimulus in felt.items()})

    def answer(self, experience: Experience, scale: Scale, place: Place) -> tuple[dict[str, float | str], float]:
        """Answer a trial.

        Parameters
        ----------
        experience : Experience
            What was felt.
        scale : Scale
            The scale to answer on.
        place : Place
            How far the session has come.

        Returns
        -------
        values : dict of str to float or str
            Points, or the part that was chosen, by the part that is judged.
        response_s : float
            How long that took, in s.
        """
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
                values[judgement.part] = self.rater.rate(percept, sure=sure, shift=shift, growth=growth, rng=rng)
        return values, len(values) * self.rater.take_time(rng)

    def _contrast(self, trial: Trial) -> float:
        """Tell what the trial before takes away, in points; points on another scale take nothing."""
        before, order = self.before, self.touch.model.order
        if not order or before is None or trial.phase != "main" or before.trial.scale != trial.scale:
            return 0.0
        percepts = [judge(before, judgement, touch=self.touch) for judgement in before.trial.judgements]
        return order * (sum(percepts) / len(percepts) - MIDDLE)

    def _draw_from(self, trial: int, attempt: int) -> np.random.Generator:
        import numpy as np

        return np.random.default_rng([self._seed, self._number, trial, attempt])
