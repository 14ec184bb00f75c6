"""Simulated participants: who they are, what stimuli feel like to them, how they answer; and a presenter of them.

A stimulus is a point with two coordinates: its spectral match (the one that the model names, cut to 0..1) and its
temporal match. The original and the real surface are the point where nothing is lost.

- *Realism* is the weighted sum of the coordinates.
- *Distance* is the weighted sum of the differences (city block). A match is known to the original only: two that match
  equally well feel the same.
- *Similarity* is the top of the scale less the distance from the reference: what is identical is worth full marks.
- Of two, the one *more like the reference* is at the smaller distance from it, and the *preferred* one feels more real.

A *bonus*, for surprises that no metric knows, is the model's term for the stimulus's reducer, plus what the recording's
own slopes on the two matches (`slope_sd`) make of what the stimulus lacks of each. It is added to realism, and to
similarity with anything but itself; it is taken from the distance to the original and to the real surface. It leaves
the distance between two reduced stimuli as it is.

Answer of a careful one: sure + gain * (percept - sure) + bias + noise, cut to 0..100. Sure is the end of the slider
that means the same to everybody: the bottom, or the top (identical) where similarity is asked for. Bias, gain and size
of the noise are the participant's own. In a lapse any answer is as likely as another. Of the bad raters,

- a *straight-liner* leaves the marker about where they like it, or always makes the same choice;
- a *random clicker* answers anything, and fast;
- a *scale-reverser* takes the slider's ends for each other. A choice has no ends: there they are like anyone else.

Everybody has a detection threshold, by frequency: that of a curve of the literature, shifted by an amount of the
participant's own, half of whose variance is the same at all frequencies. It decides nothing but the threshold block.

Every draw depends on seed, participant, trial and attempt alone, so that a session that is resumed gives the answers of
an uninterrupted one. The participants' clock adds up what stimuli, pages and answers take.
"""

import hashlib
import math
import re
from bisect import bisect_right
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import accumulate
from typing import Annotated, Any
from zlib import crc32

import numpy as np

from feel321.protocols import threshold as blocks
from feel321.protocols.tasks import PROTOCOLS
from feel321.protocols.texts import Answer, Question
from feel321.protocols.threshold import DB_PER_POINT, INTERVALS, MIDDLE, SECOND
from feel321.protocols.trial import (
    MATCHING,
    RATING_RANGE,
    SURFACE,
    THRESHOLD,
    Judgement,
    Page,
    Part,
    Scale,
    Trial,
)
from feel321.stimuli.sets.manifest import Stimulus
from feel321.stimuli.sets.recipe import ORIGINAL
from feel321.stimuli.thresholds import CONTACTOR, THRESHOLDS, acceleration_threshold, to_db
from feel321.study.minutes import STROKE_S, UNHURRIED
from feel321.study.session import ports
from feel321.study.session.ports import Act, Confirm, Feel, Felt, Place, Playback, Scaled, Tone
from feel321.study.settings.fields import one_of
from feel321.study.settings.schema import ObserverTable, Settings

LOW, HIGH = RATING_RANGE

# Simulated raters: careful ones, each with their own way of using a slider, and bad ones.

NORMAL, STRAIGHT_LINER = "normal", "straight_liner"
RANDOM_CLICKER, SCALE_REVERSER = "random_clicker", "scale_reverser"
KINDS = (NORMAL, STRAIGHT_LINER, RANDOM_CLICKER, SCALE_REVERSER)
STRAIGHT_SD = 1.0  # in points, of the place to which a straight-liner returns
HASTY = (-0.7, 0.3)  # mean and sd of the logarithm of a hasty response time in s: a median of 0.5 s
SPECTRAL = ("spectral_match_bounded", "spectral_match")  # that participants may feel by
HALF = 0.5  # of the favourites of straight-liners, who then choose the first
NODES = 15  # of the quadrature over gains and over sizes of the noise
SIMULATED_TEXT = "simulated"  # the answer to a question that asks for a text


class ObserverModel(ObserverTable):
    """How simulated participants feel, and how they differ; `feel321 new --all-settings` explains every number."""

    spectral_metric: Annotated[str, one_of(SPECTRAL)] = SPECTRAL[0]  # counts as 0 where negative
    detection_curve: Annotated[str, one_of(THRESHOLDS)] = CONTACTOR  # mean of their thresholds


@dataclass(frozen=True, slots=True)
class Rater:
    """One simulated participant."""

    kind: str
    bias: float  # in points
    gain: float
    noise_sd: float  # in points
    lapse_rate: float
    favourite: float

    def rate(self, percept: float, rng: np.random.Generator, *, sure: float = LOW) -> float:
        """Set a slider; percept: what was felt, in points."""
        guess, lapsed = rng.uniform(LOW, HIGH), rng.random() < self.lapse_rate
        points = sure + self.gain * (percept - sure) + self.bias + rng.normal(0, self.noise_sd)
        if self.kind == STRAIGHT_LINER:
            points = LOW + (HIGH - LOW) * self.favourite + rng.normal(0, STRAIGHT_SD)
        elif self.kind == RANDOM_CLICKER or lapsed:
            points = guess
        elif self.kind == SCALE_REVERSER:
            points = LOW + HIGH - points
        return round(min(max(points, LOW), HIGH), 1)

    def choose(self, distances: Mapping[str, float], rng: np.random.Generator) -> str:
        """Choose the candidate that feels most like the part asked about, from their distances in points.

        All are felt once and remembered with noise, and the nearest is chosen: the differencing model of ABX, with
        proportion correct Φ(d'/√2) Φ(d'/√6) + Φ(-d'/√2) Φ(-d'/√6) for d' = distance / noise (Macmillan and Creelman,
        Detection theory, 2005, chapter 9). The noise is that of a rating; bias and gain are habits with a slider.
        """
        names = list(distances)
        guess, is_blind = self._guess(names, rng)
        if is_blind:
            return guess
        asked, *felt = rng.normal(0, self.noise_sd, len(names) + 1)
        away = {
            name: abs(max(distances[name], 0.0) + noise - asked)
            for name, noise in zip(names, felt, strict=True)
        }
        nearest = min(names, key=away.__getitem__)
        # Where two are exactly as near, no difference was felt.
        return guess if away[guess] == away[nearest] else nearest

    def prefer(self, percepts: Mapping[str, float], rng: np.random.Generator) -> str:
        """Choose the candidate that feels most real, from their percepts in points, each remembered with noise."""
        names = list(percepts)
        guess, is_blind = self._guess(names, rng)
        noise = rng.normal(0, self.noise_sd, len(names))
        felt = {name: percepts[name] + own for name, own in zip(names, noise, strict=True)}
        most = max(names, key=felt.__getitem__)
        return guess if is_blind or felt[guess] == felt[most] else most

    def _guess(self, names: Sequence[str], rng: np.random.Generator) -> tuple[str, bool]:
        """Draw a choice that rests on nothing felt, and whether it is the one that is made."""
        guess, lapsed = names[int(rng.integers(len(names)))], rng.random() < self.lapse_rate
        if self.kind == STRAIGHT_LINER:
            return names[int(self.favourite * len(names))], True
        return guess, self.kind == RANDOM_CLICKER or lapsed

    def detect(self, chance: float, right: str, rng: np.random.Generator) -> str:
        """Choose the interval that vibrated; chance: share of right answers of a careful participant."""
        first, second = INTERVALS
        guess, is_right = INTERVALS[rng.integers(2)], rng.random() < chance
        if self.kind == STRAIGHT_LINER:
            return first if self.favourite < HALF else second
        if self.kind == RANDOM_CLICKER:
            return guess
        return right if is_right else second if right == first else first

    def draw_time(self, rng: np.random.Generator) -> float:
        """Draw a response time, in s."""
        return float(rng.lognormal(*(HASTY if self.kind == RANDOM_CLICKER else UNHURRIED)))


def expect_rating(model: ObserverModel, percepts: Sequence[float]) -> list[float]:
    """Compute the mean rating that careful participants give to percepts in points.

    Given gain and size of the noise, a rating is a normal variable cut to the scale, whose mean is known; over their
    lognormal distributions it is averaged by Gauss-Hermite quadrature.
    """
    from scipy.stats import norm

    nodes, weights = np.polynomial.hermite_e.hermegauss(NODES)
    weights /= weights.sum()
    gain = np.exp(model.gain_sd * nodes)[:, None, None]
    noise = model.noise_sd * np.exp(model.noise_spread * nodes)
    spread = np.hypot(model.bias_sd, noise)[None, :, None] + 1e-12
    mean = LOW + gain * (np.asarray(percepts, dtype=np.float64) - LOW)
    below, above = (LOW - mean) / spread, (HIGH - mean) / spread
    cut = LOW * norm.cdf(below) + HIGH * norm.sf(above) + mean * (norm.cdf(above) - norm.cdf(below))
    cut += spread * (norm.pdf(below) - norm.pdf(above))
    careful = np.einsum("i,j,ijk->k", weights, weights, cut)
    found: list[float] = (careful + model.lapse_rate * ((LOW + HIGH) / 2 - careful)).tolist()
    return found


def draw_rater(model: ObserverModel, rng: np.random.Generator) -> Rater:
    """Draw a participant."""
    bias, gain = rng.normal(0, model.bias_sd), rng.lognormal(0, model.gain_sd)
    noise_sd = model.noise_sd * rng.lognormal(0, model.noise_spread)
    shares = (model.straight_liners, model.random_clickers, model.scale_reversers)
    place = bisect_right(list(accumulate(shares)), rng.random())
    kind = (STRAIGHT_LINER, RANDOM_CLICKER, SCALE_REVERSER, NORMAL)[place]
    return Rater(kind, bias, gain, noise_sd, model.lapse_rate, favourite=rng.uniform(0.2, 0.8))


# What stimuli feel like to a simulated participant, and how different two of them feel.


@dataclass(frozen=True, slots=True)
class Location:
    """The coordinates of a stimulus for the sense of touch."""

    spectral: float  # matches, from 0 to 1
    temporal: float
    bonus: float = 0.0  # in points
    is_reduced: bool = True


REAL = Location(1.0, 1.0, is_reduced=False)  # the original and the real surface


@dataclass(frozen=True, slots=True)
class Experience:
    """A trial and what was felt in it: where each part lies, or which tone it was, or its first sensation level."""

    trial: Trial
    points: dict[str, Location] = field(default_factory=dict)
    tones: dict[str, Tone] = field(default_factory=dict)
    levels_db: dict[str, float] = field(default_factory=dict)

    def find_reference(self, judgement: Judgement) -> Location:
        """Find where the reference of a judgement lies."""
        felt = {part.stimulus_id: part.name for part in reversed(self.trial.parts)}
        if judgement.reference_id == SURFACE:
            return REAL
        if judgement.reference_id not in felt:
            raise ValueError(
                f"simulated observer: trial {self.trial.number}: the reference must be the stimulus of one of its "
                f"parts, got {judgement.reference_id!r}; add a part that plays it"
            )
        return self.points[felt[judgement.reference_id]]


@dataclass(frozen=True, slots=True)
class Touch:
    """The sense of touch that all simulated participants share; without a seed, recordings have the mean slopes."""

    model: ObserverModel
    seed: int | None = None

    def locate(self, stimulus: Stimulus | None) -> Location:
        """Find where a stimulus lies; None is the real surface."""
        if stimulus is None:
            return REAL
        match: float = getattr(stimulus, self.model.spectral_metric)
        if math.isnan(match):  # the bounded match may be unknown
            match = stimulus.spectral_match
        spectral, temporal = min(max(match, 0.0), 1.0), stimulus.temporal_match
        if stimulus.reducer == ORIGINAL:
            return Location(spectral, temporal, is_reduced=False)
        bonus = self.model.reducers.get(stimulus.reducer, 0.0)
        if self.seed is not None and self.model.slope_sd:
            rng = np.random.default_rng([self.seed, crc32(stimulus.recording.encode())])
            first, second = rng.normal(0, self.model.slope_sd, 2).tolist()
            # A perfect match feels the same in every recording.
            bonus += first * (spectral - 1)
            bonus += second * (temporal - 1)
        return Location(spectral, temporal, bonus)

    def feel(self, point: Location) -> float:
        """Compute how real something feels, in points, not cut to the scale."""
        model = self.model
        gained = model.intercept + model.spectral * point.spectral + model.temporal * point.temporal
        return gained + point.bonus

    def measure_distance(self, first: Location, second: Location) -> float:
        """Compute how different two feel, in points."""
        bonus = 0.0 if first.is_reduced and second.is_reduced else first.bonus + second.bonus
        spectral = self.model.spectral * abs(first.spectral - second.spectral)
        return spectral + self.model.temporal * abs(first.temporal - second.temporal) - bonus

    def measure_shortfall(self, point: Location, reference: Location) -> float:
        """Compute how far something falls short of a reference, in points; what is better than it is below 0."""
        is_judged = point.is_reduced and reference.is_reduced and point != reference
        return self.measure_distance(point, reference) - (point.bonus if is_judged else 0.0)

    def judge(self, experience: Experience, judgement: Judgement) -> float:
        """Compute the slider answer, uncut, of a participant without bias, noise or habit, in points."""
        sure, point = (
            PROTOCOLS[experience.trial.protocol].sure_end,
            experience.points[judgement.part],
        )
        if judgement.reference_id is None:
            return self.feel(point)
        reference = experience.find_reference(judgement)
        if sure == LOW:
            return self.measure_distance(point, reference)
        return sure - self.measure_shortfall(point, reference)

    def compare(
        self, experience: Experience, judgement: Judgement, choices: Sequence[str]
    ) -> dict[str, float]:
        """Compute how far each candidate is from the part asked about, or from the reference of a choice, in points."""
        is_candidate = judgement.part in choices
        measure = self.measure_shortfall if is_candidate else self.measure_distance
        find = (
            experience.find_reference if is_candidate else lambda one: experience.points[one.part]
        )
        return {name: measure(experience.points[name], find(judgement)) for name in choices}


# Who the simulated participants of a study are.


@dataclass(frozen=True, slots=True)
class Casting:
    """The simulated participants of a study: their model and seed."""

    model: ObserverModel
    seed: int

    @property
    def identity(self) -> dict[str, Any]:
        """What their answers depend on, for the header of their journals."""
        return {"simulated": True, "seed": self.seed, "observer": self.model.model_dump()}


def make_model(settings: Settings) -> ObserverModel:
    """Make the observers of a study, who feel by the spectral match that it declares."""
    declared = [name for name in settings.analysis.metrics if name in SPECTRAL]
    return ObserverModel(
        **settings.observer.model_dump(),
        spectral_metric=(declared or SPECTRAL)[0],
        detection_curve=settings.stimuli.threshold,
    )


NUMBERED = re.compile(r"sim(\d+)")  # codes that hold the number of a simulated person


def find_person(participant: str) -> int:
    """Find the simulated person of a code: always the same one, with or without a hand, whatever the design."""
    if numbered := NUMBERED.fullmatch(participant):
        return int(numbered[1])
    return int.from_bytes(hashlib.sha256(participant.encode()).digest()[:8], "big")


# What they answer, and the presenter that needs no screen and no actuator.


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
                percepts = {name: touch.feel(experience.points[name]) for name in scale.choices}
                values[judgement.part] = rater.prefer(percepts, rng)
            elif scale.choices:
                distances = touch.compare(experience, judgement, scale.choices)
                values[judgement.key] = rater.choose(distances, rng)
            else:
                # Further scales have draws of their own, which leave those of the first as they are.
                places = (trial.number, place.attempt, crc32(judgement.scale.encode()))
                own = self._draw_from(*places) if judgement.scale else rng
                percept, sure = (
                    touch.judge(experience, judgement),
                    PROTOCOLS[trial.protocol].sure_end,
                )
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
            first, last = math.ceil(low), math.floor(high)
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
            given: Any = {"threshold_db": own, "slope": slope, "lapse": lapse}
            chance = float(blocks.predict_correct(tone.level_db, **given))
        return self.rater.detect(chance, right, rng)

    def _match(self, levels_db: Mapping[str, float], rng: np.random.Generator) -> float:
        """Move the marker until the second is as strong as the first, but for an error of one's own."""
        (low, high), kind = RATING_RANGE, self.rater.kind
        guess, error_db = rng.uniform(low, high), rng.normal(0, self.touch.model.matching_sd)
        points = MIDDLE + (levels_db[blocks.FIRST] - levels_db[SECOND] + error_db) / DB_PER_POINT
        points = high if math.isnan(points) else points  # silence, which no marker helps
        if kind == RANDOM_CLICKER or rng.random() < self.rater.lapse_rate:
            points = guess
        elif kind == STRAIGHT_LINER:
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
