"""Simulated participants: what stimuli feel like to them, how they answer, and what they remember.

A stimulus is a point with six coordinates: its spectral match (the one that the model names, cut to 0..1), its
temporal match, and the four of its `Percept`. The original and the real surface are the point where nothing is lost.

- *Realism* is the weighted sum of the coordinates.
- *Distance* is the weighted sum of six differences (city block). Those of a percept are between the two vibrations
  themselves, as they differ from each other. Level counts in both directions: what is stronger than the reference is as
  different as what is weaker by the same number of dB. A match is known to the original only: by its weight, stimuli
  lie on a line, not in a space, and two that match equally well feel the same.
- *Similarity* is the top of the scale less the distance from the reference: what is identical is worth full marks.
- Of two, the one *more like the reference* is at the smaller distance from it, and the *preferred* one feels more real.

A *bonus*, for surprises that no metric knows, is the model's term for the stimulus's reducer, plus the model's
`vector_magnitude` times how far the stimulus follows its recording's vector magnitude, plus what the recording's own
slopes on the two matches (`slope_sd`) make of what the stimulus lacks of each. It is added to realism, and to
similarity with anything but itself; it is taken from the distance to the original and to the real surface. It leaves
the distance between two reduced stimuli as it is. What comes out is cut to the scale only when it is answered.

Answer of a careful one: sure + gain * (percept - sure) + bias + shift + noise, cut to 0..100. Sure is the end of the
slider that means the same to everybody: the bottom, or the top (identical) where similarity is asked for. The shift is
what order and fatigue do; bias, gain and size of the noise are the participant's own. In a lapse any answer is as
likely as another.

Of the bad raters,

- a *straight-liner* leaves the marker about where they like it, or always makes the same choice;
- a *random clicker* answers anything, and fast;
- a *scale-reverser* takes the slider's ends for each other. A choice has no ends: there they are like anyone else.

Everybody has a detection threshold, by frequency: that of a curve of the literature, shifted by an amount of the
participant's own, half of whose variance is the same at all frequencies. Of two intervals they find the one that
vibrated by the psychometric function of `protocols.threshold`; nothing else that they answer depends on it.

Every draw depends on seed, participant, trial and attempt alone, and the trial before can be recalled, so that an
interrupted session that is resumed gives the answers of an uninterrupted one. The participants' clock adds up what
stimuli, pages and answers take, so that a session of an hour is over in a second.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from dataclasses import dataclass, field
from itertools import accumulate
from math import ceil, floor
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated, Any
from zlib import crc32

from feel321.protocols.detection import ASKED, INTERVALS, THRESHOLD
from feel321.protocols.matching import DB_PER_POINT, FIRST, MIDDLE, SECOND
from feel321.protocols.tasks import PROTOCOLS
from feel321.protocols.threshold import predict_correct
from feel321.protocols.trial import MATCHING, RATING_RANGE, SURFACE, Judgement, Scale, Trial
from feel321.stimuli.sets.anchors import to_db
from feel321.stimuli.sets.recipe import ORIGINAL
from feel321.stimuli.thresholds import CONTACTOR, THRESHOLDS, acceleration_threshold
from feel321.study.observer.percepts import Percept, compare_percepts
from feel321.study.session.events import TrialRated
from feel321.study.settings.fields import one_of
from feel321.study.settings.schema import ObserverTable

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    import numpy as np

    from feel321.protocols.questions import Answer, Question
    from feel321.stimuli.sets.manifest import Stimulus
    from feel321.study.session.journal import Record
    from feel321.study.session.ports import Place, Scaled, Tone

# Simulated raters: careful ones, each with their own way of using a slider, and bad ones.

NORMAL, STRAIGHT_LINER = "normal", "straight_liner"
RANDOM_CLICKER, SCALE_REVERSER = "random_clicker", "scale_reverser"
KINDS = (NORMAL, STRAIGHT_LINER, RANDOM_CLICKER, SCALE_REVERSER)  # kinds of raters
STRAIGHT_SD = 1.0  # standard deviation, in points, of the place to which a straight-liner returns

UNHURRIED, HASTY = (0.7, 0.4), (-0.7, 0.3)
"""Mean and standard deviation of the logarithm of a response time in s: medians of 2.0 s and 0.5 s."""

SPECTRAL = ("spectral_match_bounded", "spectral_match")  # that participants may feel by
HALF = 0.5  # of the favourites of straight-liners, who then choose the first
NODES = 15  # of the quadrature over gains and over sizes of the noise


class ObserverModel(ObserverTable):
    """How simulated participants feel, and how they differ; the template of `study.toml` explains every number.

    spectral_metric: counts as 0 where it is negative, so that a slope on it is planted from 0 to 1 only.
    detection_curve: of `THRESHOLDS`, the mean of the participants' detection thresholds.
    """

    spectral_metric: Annotated[str, one_of(SPECTRAL)] = SPECTRAL[0]
    detection_curve: Annotated[str, one_of(THRESHOLDS)] = CONTACTOR

    @property
    def uses_percepts(self) -> bool:
        """Whether stimuli must be read and measured before this observer can feel them."""
        weights = self.threshold_spectral, self.envelope, self.level, self.direction
        return any((*weights, self.vector_magnitude))


@dataclass(frozen=True, slots=True)
class Rater:
    """One simulated participant; bias, gain, noise_sd: in points, as a factor, in points."""

    kind: str
    bias: float
    gain: float
    noise_sd: float
    lapse_rate: float
    favourite: float

    def rate(
        self,
        percept: float,
        *,
        sure: float = RATING_RANGE[0],
        shift: float,
        growth: float,
        rng: np.random.Generator,
    ) -> float:
        """Set a slider; percept: what was felt, shift: what order and fatigue add, both in points."""
        low, high = RATING_RANGE
        guess, lapsed = rng.uniform(low, high), rng.random() < self.lapse_rate
        noise = rng.normal(0, self.noise_sd * growth)
        points = sure + self.gain * (percept - sure) + self.bias + shift + noise
        if self.kind == STRAIGHT_LINER:
            points = low + (high - low) * self.favourite + rng.normal(0, STRAIGHT_SD)
        elif self.kind == RANDOM_CLICKER or lapsed:
            points = guess
        elif self.kind == SCALE_REVERSER:
            points = low + high - points
        return round(min(max(points, low), high), 1)

    def choose(
        self, distances: Mapping[str, float], *, growth: float, rng: np.random.Generator
    ) -> str:
        """Choose the candidate that feels most like the part asked about, from their distances in points.

        Notes
        -----
        All are felt once and remembered with noise, and the nearest is chosen: the differencing model of ABX, with
        proportion correct Φ(d'/√2) Φ(d'/√6) + Φ(-d'/√2) Φ(-d'/√6) for d' = distance / noise [1]_. A comparison's
        noise is that of a rating; bias and gain are habits with a slider, and make nobody feel more.

        References
        ----------
        .. [1] N. A. Macmillan, C. D. Creelman, "Detection theory: a user's guide", 2nd ed., Lawrence Erlbaum, 2005,
           chapter 9. ISBN 0-8058-4230-6
        """
        names = list(distances)
        guess, is_blind = self._guess(names, rng)
        if is_blind:
            return guess
        asked, *felt = rng.normal(0, self.noise_sd * growth, len(names) + 1)
        away = {
            name: abs(max(distances[name], 0.0) + noise - asked)
            for name, noise in zip(names, felt, strict=True)
        }
        nearest = min(names, key=away.__getitem__)
        # Where two are exactly as near, no difference was felt.
        return guess if away[guess] == away[nearest] else nearest

    def prefer(
        self, percepts: Mapping[str, float], *, growth: float, rng: np.random.Generator
    ) -> str:
        """Choose the candidate that feels most real, from their percepts in points, each remembered with noise."""
        names = list(percepts)
        guess, is_blind = self._guess(names, rng)
        noise = rng.normal(0, self.noise_sd * growth, len(names))
        felt = {name: percepts[name] + own for name, own in zip(names, noise, strict=True)}
        most = max(names, key=felt.__getitem__)
        return guess if is_blind or felt[guess] == felt[most] else most

    def _guess(self, names: Sequence[str], rng: np.random.Generator) -> tuple[str, bool]:
        """Draw a choice that rests on nothing felt, and whether it is the one that is made."""
        guess, lapsed = names[int(rng.integers(len(names)))], rng.random() < self.lapse_rate
        if self.kind == STRAIGHT_LINER:
            return names[int(self.favourite * len(names))], True
        return guess, self.kind == RANDOM_CLICKER or lapsed

    def detect(self, chance: float, right: str, *, rng: np.random.Generator) -> str:
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


AT_ONCE = 256
"""Percepts whose quadrature is computed at once: 3 MB."""


def expect_rating(model: ObserverModel, percepts: Sequence[float]) -> list[float]:
    """Compute the mean rating that careful participants give to percepts in points, without order and fatigue.

    Notes
    -----
    Given gain and size of the noise, a rating is a normal variable cut to the scale, whose mean is known; over their
    lognormal distributions it is averaged by Gauss-Hermite quadrature.
    """
    import numpy as np
    from scipy.stats import norm

    if len(percepts) > AT_ONCE:
        parts = (percepts[start : start + AT_ONCE] for start in range(0, len(percepts), AT_ONCE))
        return [rating for part in parts for rating in expect_rating(model, part)]
    low, high = RATING_RANGE
    nodes, weights = np.polynomial.hermite_e.hermegauss(NODES)
    weights /= weights.sum()
    gain = np.exp(model.gain_sd * nodes)[:, None, None]
    noise = model.noise_sd * np.exp(model.noise_spread * nodes)
    spread = np.hypot(model.bias_sd, noise)[None, :, None] + 1e-12
    mean = low + gain * (np.asarray(percepts, dtype=np.float64) - low)
    below, above = (low - mean) / spread, (high - mean) / spread
    cut = (
        low * norm.cdf(below)
        + high * norm.sf(above)
        + mean * (norm.cdf(above) - norm.cdf(below))
        + spread * (norm.pdf(below) - norm.pdf(above))
    )
    careful = np.einsum("i,j,ijk->k", weights, weights, cut)
    found: list[float] = (careful + model.lapse_rate * ((low + high) / 2 - careful)).tolist()
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
    """The coordinates of a stimulus for the sense of touch; spectral, temporal: matches, 0 to 1; bonus: in points."""

    spectral: float
    temporal: float
    percept: Percept
    bonus: float = 0.0
    is_reduced: bool = True


UNCHANGED = Percept(0.0, 0.0, 0.0)  # the percept of the original
REAL = Location(1.0, 1.0, UNCHANGED, is_reduced=False)  # the original and the real surface


@dataclass(frozen=True, slots=True)
class Experience:
    """A trial and what was felt in it: where each part lies, or which tone it was, or its first sensation level."""

    trial: Trial
    points: Mapping[str, Location]
    tones: Mapping[str, Tone] = field(default_factory=dict)
    levels_db: Mapping[str, float] = field(default_factory=dict)

    def find(self, part: str) -> Location:
        """Find where a part lies."""
        if part not in self.points:
            raise ValueError(
                f"simulated observer: part {part!r} of trial {self.trial.number} was to be rated before it was felt; "
                "play it first"
            )
        return self.points[part]

    def find_reference(self, judgement: Judgement) -> Location:
        """Find where the reference of a judgement lies."""
        if judgement.reference_id == SURFACE:
            return REAL
        for part in self.trial.parts:
            if part.stimulus_id == judgement.reference_id:
                return self.find(part.name)
        raise ValueError(
            f"simulated observer: trial {self.trial.number}: the reference must be the stimulus of one of its parts, "
            f"got {judgement.reference_id!r}; add a part that plays it"
        )


@dataclass(frozen=True, slots=True)
class Touch:
    """The sense of touch that all simulated participants share; without a seed, recordings have the mean slopes."""

    model: ObserverModel
    percepts: Mapping[str, Percept]
    seed: int | None = None

    def locate(self, stimulus: Stimulus | None) -> Location:
        """Find where a stimulus lies; None is the real surface."""
        if stimulus is None:
            return REAL
        percept = self.percepts.get(stimulus.stimulus_id) if self.model.uses_percepts else UNCHANGED
        if percept is None:
            raise ValueError(
                f"stimulus {stimulus.stimulus_id}: its percept is missing, and the observer's weights need it; "
                "read the percepts of the whole set first"
            )
        match: float = getattr(stimulus, self.model.spectral_metric)
        if math.isnan(match):  # the bounded match may be unknown
            match = stimulus.spectral_match
        spectral, is_reduced = min(max(match, 0.0), 1.0), stimulus.reducer != ORIGINAL
        bonus = self.model.reducers.get(stimulus.reducer, 0.0)
        bonus += self.model.vector_magnitude * percept.vector_magnitude
        for slope, match in zip(
            self._draw_slopes(stimulus), (spectral, stimulus.temporal_match), strict=True
        ):
            bonus += slope * (match - 1)  # a perfect match feels the same in every recording
        return Location(
            spectral, stimulus.temporal_match, percept, bonus if is_reduced else 0.0, is_reduced
        )

    def _draw_slopes(self, stimulus: Stimulus) -> tuple[float, float]:
        """Draw how far a recording's slopes on the two matches differ from those of the model."""
        import numpy as np

        if self.seed is None or not self.model.slope_sd:
            return 0.0, 0.0
        rng = np.random.default_rng([self.seed, crc32(stimulus.recording.encode())])
        first, second = rng.normal(0, self.model.slope_sd, 2)
        return float(first), float(second)

    def feel(self, point: Location) -> float:
        """Compute how real something feels, in points, not cut to the scale."""
        model, lost = self.model, point.percept
        gained = model.intercept + model.spectral * point.spectral + model.temporal * point.temporal
        missed = model.threshold_spectral * lost.spectral_db + model.envelope * lost.envelope
        missed += model.direction * lost.direction
        return gained - missed + model.level * lost.level_db + point.bonus

    def measure_shortfall(self, point: Location, reference: Location) -> float:
        """Compute how far something falls short of a reference, in points; what is better than it is below 0."""
        is_judged = point.is_reduced and reference.is_reduced and point != reference
        return self.measure_distance(point, reference) - (point.bonus if is_judged else 0.0)

    def measure_distance(self, first: Location, second: Location) -> float:
        """Compute how different two feel, in points."""
        model, apart = self.model, compare_percepts(first.percept, second.percept)
        bonus = 0.0 if first.is_reduced and second.is_reduced else first.bonus + second.bonus
        return (
            model.spectral * abs(first.spectral - second.spectral)
            + model.temporal * abs(first.temporal - second.temporal)
            + model.threshold_spectral * apart.spectral_db
            + model.envelope * apart.envelope
            + abs(model.level * apart.level_db)
            + model.direction * apart.direction
            - bonus
        )


SURE_ENDS = {name: task.sure_end for name, task in PROTOCOLS.items() if not task.choices}
"""Protocol -> the end of its slider that means the same to everybody."""


def find_sure_end(trial: Trial) -> float:
    """Find the end of a trial's slider that means the same to everybody."""
    protocol = PROTOCOLS.get(trial.protocol)
    if protocol is None or protocol.choices:
        raise ValueError(
            f"simulated observer: the protocol of a slider must be one of {', '.join(SURE_ENDS)}; "
            f"got {trial.protocol!r}"
        )
    return protocol.sure_end


def find_percept(experience: Experience, judgement: Judgement, *, touch: Touch) -> float:
    """Compute the slider answer, uncut, of a participant without bias, noise or habit, in points."""
    sure, point = find_sure_end(experience.trial), experience.find(judgement.part)
    if judgement.reference_id is None:
        return touch.feel(point)
    reference = experience.find_reference(judgement)
    if sure == RATING_RANGE[0]:
        return touch.measure_distance(point, reference)
    return sure - touch.measure_shortfall(point, reference)


def measure_distances(
    experience: Experience, judgement: Judgement, choices: Sequence[str], *, touch: Touch
) -> dict[str, float]:
    """Compute how far each candidate is from the part asked about, or from the reference of a choice, in points."""
    of_reference = judgement.part in choices
    measure = touch.measure_shortfall if of_reference else touch.measure_distance
    asked = (
        experience.find_reference(judgement) if of_reference else experience.find(judgement.part)
    )
    return {name: measure(experience.find(name), asked) for name in choices}


# What they answer and remember.

STROKE_S = 3.0  # duration of a stroke over the real surface

SIMULATED_TEXT = "simulated"
"""The answer of simulated participants to a question that asks for a text."""

FATIGUE_TRIALS = 100  # trials for which the size of fatigue is given


class Participant:
    """A simulated participant: what they answer to what they felt, and what they remember of it.

    elapsed_s: time in s since their session began.
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
        self._seed, self._number, self._time_s = seed, number, elapsed_s
        self.touch = Touch(model, percepts, seed)
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
                distances = measure_distances(
                    experience, judgement, scale.choices, touch=self.touch
                )
                values[judgement.key] = self.rater.choose(distances, growth=growth, rng=rng)
            else:
                # Further scales have draws of their own, which leave those of the first as they are.
                own = self._draw_from(trial.number, place.attempt, crc32(judgement.scale.encode()))
                values[judgement.key] = self.rater.rate(
                    find_percept(experience, judgement, touch=self.touch),
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
        percepts = [
            find_percept(before, judgement, touch=self.touch)
            for judgement in before.trial.judgements
        ]
        return order * (sum(percepts) / len(percepts) - MIDDLE)

    def _draw_from(self, trial: int, attempt: int, *places: int) -> np.random.Generator:
        import numpy as np

        return np.random.default_rng([self._seed, self._number, trial, attempt, *places])


def feel_level(scaled: Scaled) -> float:
    """Find how far a stimulus lies over the detection threshold at another level than the study's, in dB."""
    return scaled.stimulus.sensation_level_db + scaled.gain_db


def identify_observer(model: ObserverModel, *, seed: int) -> dict[str, Any]:
    """List what the answers of simulated participants depend on, for the header of their journals."""
    return {"simulated": True, "seed": seed, "observer": model.model_dump()}
