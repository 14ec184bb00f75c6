"""Simulated participants: what they answer, and the presenter that needs no screen and no actuator."""

import math
from collections.abc import Iterator, Mapping
from functools import partial
from math import ceil, floor
from zlib import crc32

import numpy as np

from feel321.protocols import threshold as blocks
from feel321.protocols.texts import Answer, Question
from feel321.protocols.threshold import DB_PER_POINT, INTERVALS, MIDDLE, SECOND
from feel321.protocols.trial import MATCHING, RATING_RANGE, THRESHOLD, Page, Part, Scale, Trial
from feel321.stimuli.thresholds import acceleration_threshold, to_db
from feel321.study.minutes import STROKE_S
from feel321.study.observer import model as models
from feel321.study.observer.model import HALF, Experience, ObserverModel, Touch, draw_rater
from feel321.study.session import ports
from feel321.study.session.ports import Act, Confirm, Feel, Felt, Place, Playback, Scaled, Tone

SIMULATED_TEXT = "simulated"  # the answer to a question that asks for a text


class Participant:
    """A simulated participant: what they answer to what they felt."""

    def __init__(self, model: ObserverModel, *, seed: int, number: int) -> None:
        self._seed, self._number = seed, number
        self.touch = Touch(model, seed)
        self.rater = draw_rater(model, self._draw_from(0, 0))

    def begin(self, trial: Trial) -> None:
        """Begin a trial, of which nothing was felt."""
        self._felt = Experience(trial)

    def feel(self, part: Part, stimulus: Felt | None) -> None:
        """Feel a part; None is the real surface. Of a level that changes, the first is remembered."""
        if isinstance(stimulus, Scaled):
            level_db = stimulus.stimulus.sensation_level_db + stimulus.gain_db
            self._felt.levels_db.setdefault(part.name, level_db)
        elif isinstance(stimulus, Tone):
            self._felt.tones[part.name] = stimulus
        else:
            self._felt.points[part.name] = self.touch.locate(stimulus)

    def answer(self, scale: Scale, place: Place) -> tuple[dict[str, float | str], float]:
        """Answer the trial that was felt: the values by part, and the time that this took in s."""
        experience, trial, touch, rater = self._felt, self._felt.trial, self.touch, self.rater
        rng = self._draw_from(trial.number, place.attempt)
        if trial.protocol == THRESHOLD:
            return {blocks.ASKED: self._detect(experience.tones, rng)}, rater.draw_time(rng)
        if trial.protocol == MATCHING:
            return {SECOND: self._match(experience.levels_db, rng)}, rater.draw_time(rng)
        values: dict[str, float | str] = {}
        for judgement in trial.judgements:
            if judgement.part in scale.choices and judgement.reference_id is None:
                percepts = {name: touch.feel(experience.find(name)) for name in scale.choices}
                values[judgement.part] = rater.prefer(percepts, rng)
            elif scale.choices:
                distances = touch.compare(experience, judgement, scale.choices)
                values[judgement.key] = rater.choose(distances, rng)
            else:
                # Further scales have draws of their own, which leave those of the first as they are.
                places = (trial.number, place.attempt, crc32(judgement.scale.encode()))
                own = self._draw_from(*places) if judgement.scale else rng
                percept, sure = touch.judge(experience, judgement), models.find_sure_end(trial)
                values[judgement.key] = rater.rate(percept, own, sure=sure)
        return values, len(values) * rater.draw_time(rng)

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
            first, last = ceil(low), floor(high)
            value = low if first > last else float(rng.integers(first, last + 1))
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
            own = self.find_threshold(tone.frequency_hz)
            slope, lapse = self.touch.model.detection_slope, self.rater.lapse_rate * HALF
            predict = partial(blocks.predict_correct, slope=slope, lapse=lapse)
            chance = float(predict(tone.level_db, threshold_db=own))
        return self.rater.detect(chance, right, rng)

    def _match(self, levels_db: Mapping[str, float], rng: np.random.Generator) -> float:
        """Move the marker until the second is as strong as the first, but for an error of one's own."""
        (low, high), kind = RATING_RANGE, self.rater.kind
        guess, error_db = rng.uniform(low, high), rng.normal(0, self.touch.model.matching_sd)
        points = MIDDLE + (levels_db[blocks.FIRST] - levels_db[SECOND] + error_db) / DB_PER_POINT
        points = high if math.isnan(points) else points  # silence, which no marker helps
        if kind == models.RANDOM_CLICKER or rng.random() < self.rater.lapse_rate:
            points = guess
        elif kind == models.STRAIGHT_LINER:
            points = MIDDLE
        return round(min(max(points, low), high))

    def _draw_from(self, trial: int, attempt: int, *places: int) -> np.random.Generator:
        return np.random.default_rng([self._seed, self._number, trial, attempt, *places])


class SimulatedObserver(Participant):
    """A presenter that needs no screen and no actuator: it answers by itself; elapsed_s: of its session, in s."""

    def __init__(
        self, model: ObserverModel, *, seed: int, number: int, elapsed_s: float = 0.0
    ) -> None:
        super().__init__(model, seed=seed, number=number)
        self._time_s, self._missed = elapsed_s, tuple[str, ...]()

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
        self.begin(trial)
        self._shown_s, self._acts = self._time_s, self._list_acts(trial, scale, place)

    def play(
        self, part: Part, stimulus: Felt, *, gap_s: float, due_s: float | None = None
    ) -> Playback:
        """Feel a stimulus to its end."""
        self.feel(part, stimulus)
        gap_s = gap_s if due_s is None else max(gap_s, due_s - self._time_s)
        return self._pass_playback(gap_s, stimulus.duration_s)

    def prompt(self, part: Part) -> Playback:
        """Stroke the real surface."""
        self.feel(part, None)
        return self._pass_playback(0.0, STROKE_S)

    def wait(self, limit_s: float | None = None) -> Act:
        """Feel what can be felt at will, then confirm, if there is time for that."""
        act = next(self._acts)
        if limit_s is None or not isinstance(act, Confirm) or act.response_time_s <= limit_s:
            return act
        self._time_s = round(self._time_s - act.response_time_s + limit_s, 3)
        return ports.TimedOut(self._time_s)

    def refuse(self, reason: str, parts: tuple[str, ...]) -> None:
        """Feel what was not felt before the same answer is given again."""
        self._missed = parts if reason == "not_felt" else ()

    def _list_acts(self, trial: Trial, scale: Scale, place: Place) -> Iterator[Act]:
        if trial.timing == "free":
            for part in trial.parts:
                yield Feel(self._time_s, part.name)
        values, response_s = self.answer(scale, place)
        asked_s = self._time_s
        self._pass_time(response_s)
        if trial.protocol == MATCHING:
            # As early as the trial: an attempt that is broken off takes none of a simulated participant's time.
            yield ports.Move(self._shown_s, SECOND, float(values[SECOND]))
            yield Feel(self._time_s)
        while True:
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
