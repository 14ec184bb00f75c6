"""Simulated participants: what they answer and remember, and the presenter that needs no screen and no actuator."""

from __future__ import annotations

import math
from math import ceil, floor
from typing import TYPE_CHECKING
from zlib import crc32

from feel321.protocols.threshold import (
    ASKED,
    DB_PER_POINT,
    FIRST,
    INTERVALS,
    MIDDLE,
    SECOND,
    predict_correct,
)
from feel321.protocols.trial import MATCHING, RATING_RANGE, THRESHOLD, Page, Part, Scale, Trial
from feel321.stimuli.thresholds import acceleration_threshold, to_db
from feel321.study.minutes import STROKE_S
from feel321.study.observer.model import (
    HALF,
    RANDOM_CLICKER,
    REAL,
    STRAIGHT_LINER,
    Experience,
    Location,
    ObserverModel,
    Touch,
    draw_rater,
    find_sure_end,
)
from feel321.study.session.events import TrialRated
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
    from collections.abc import Iterable, Iterator, Mapping

    import numpy as np

    from feel321.protocols.texts import Answer, Question
    from feel321.stimuli.sets.manifest import Stimulus
    from feel321.study.session.journal import Record

SIMULATED_TEXT = "simulated"
"""The answer of simulated participants to a question that asks for a text."""

FATIGUE_TRIALS = 100  # trials for which the size of fatigue is given


class Participant:
    """A simulated participant: what they answer to what they felt, and what they remember of it.

    elapsed_s: time in s since their session began.
    """

    def __init__(
        self, model: ObserverModel, *, seed: int, number: int, elapsed_s: float = 0.0
    ) -> None:
        self._seed, self._number, self._time_s = seed, number, elapsed_s
        self.touch = Touch(model, seed)
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
        if trial.protocol == THRESHOLD:
            return {ASKED: self._detect(experience.tones, rng)}, self.rater.draw_time(rng)
        if trial.protocol == MATCHING:
            points = self._match(experience.levels_db, rng)
            return {SECOND: points}, self.rater.draw_time(rng)
        tired = place.done / FATIGUE_TRIALS
        growth = 1 + model.fatigue_noise * tired
        values: dict[str, float | str] = {}
        for judgement in trial.judgements:
            if judgement.part in scale.choices and judgement.reference_id is None:
                percepts = {name: self.touch.feel(experience.find(name)) for name in scale.choices}
                values[judgement.part] = self.rater.prefer(percepts, growth=growth, rng=rng)
            elif scale.choices:
                distances = self.touch.compare(experience, judgement, scale.choices)
                values[judgement.key] = self.rater.choose(distances, growth=growth, rng=rng)
            else:
                # Further scales have draws of their own, which leave those of the first as they are.
                own = self._draw_from(trial.number, place.attempt, crc32(judgement.scale.encode()))
                values[judgement.key] = self.rater.rate(
                    self.touch.judge(experience, judgement),
                    sure=find_sure_end(trial),
                    shift=model.fatigue * tired - self._find_contrast(trial),
                    growth=growth,
                    rng=own if judgement.scale else rng,
                )
        return values, len(values) * self.rater.draw_time(rng)

    def answer_question(self, question: Question, *, occasion: int) -> tuple[Answer, float]:
        """Answer a question page with anything that is an answer, and the time that this took in s."""
        rng = self._draw_from(0, 2, crc32(question.name.encode()), occasion)
        value: Answer = SIMULATED_TEXT
        if question.choices:
            value = question.choices[rng.integers(len(question.choices))]
        elif question.kind == "number":
            low, high = question.low, question.high
            low = (0.0 if high is None else min(0.0, high - 1)) if low is None else low
            high = low + 100.0 if high is None else high
            value = (
                low if ceil(low) > floor(high) else float(rng.integers(ceil(low), floor(high) + 1))
            )
        return value, self.rater.draw_time(rng)

    def find_threshold(self, frequency_hz: float) -> float:
        """Find the participant's own detection threshold, RMS at the hand in dB re 1 m/s²."""
        model = self.touch.model
        curve = acceleration_threshold(frequency_hz, threshold=model.detection_curve)
        shared, own = (
            self._draw_from(0, 1, *places).normal(0, model.detection_sd * math.sqrt(HALF))
            for places in ((), (round(1000 * frequency_hz),))
        )
        return to_db(float(curve) / math.sqrt(2)) + float(shared + own)

    def _detect(self, tones: Mapping[str, Tone], rng: np.random.Generator) -> str:
        """Choose the interval that vibrated; where neither did, the second is right as often as not."""
        right = next((n for n in tones if tones[n].level_db is not None), INTERVALS[-1])
        tone, chance = tones[right], HALF
        if tone.level_db is not None:
            chance = float(
                predict_correct(
                    tone.level_db,
                    threshold_db=self.find_threshold(tone.frequency_hz),
                    slope=self.touch.model.detection_slope,
                    lapse=self.rater.lapse_rate * HALF,  # a guess may be right
                )
            )
        return self.rater.detect(chance, right, rng=rng)

    def _match(self, levels_db: Mapping[str, float], rng: np.random.Generator) -> float:
        """Move the marker until the second is as strong as the first, but for an error of one's own."""
        guess, error_db = rng.uniform(*RATING_RANGE), rng.normal(0, self.touch.model.matching_sd)
        points = MIDDLE + (levels_db[FIRST] - levels_db[SECOND] + error_db) / DB_PER_POINT
        points = RATING_RANGE[1] if math.isnan(points) else points  # silence, which no marker helps
        if self.rater.kind == RANDOM_CLICKER or rng.random() < self.rater.lapse_rate:
            points = guess
        elif self.rater.kind == STRAIGHT_LINER:
            points = MIDDLE
        return round(min(max(points, RATING_RANGE[0]), RATING_RANGE[1]))

    def _find_contrast(self, trial: Trial) -> float:
        """Compute what the trial before takes away, in points; points on another scale take nothing."""
        before, order = self.before, self.touch.model.order
        if not order or before is None or trial.phase != "main":
            return 0.0
        if before.trial.scale != trial.scale:
            return 0.0
        percepts = [self.touch.judge(before, judged) for judged in before.trial.judgements]
        return order * (sum(percepts) / len(percepts) - MIDDLE)

    def _draw_from(self, trial: int, attempt: int, *places: int) -> np.random.Generator:
        import numpy as np

        return np.random.default_rng([self._seed, self._number, trial, attempt, *places])


def feel_level(scaled: Scaled) -> float:
    """Find how far a stimulus lies over the detection threshold at another level than the study's, in dB."""
    return scaled.stimulus.sensation_level_db + scaled.gain_db


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
