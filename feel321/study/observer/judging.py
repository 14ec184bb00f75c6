"""How a simulated participant judges: perceived distances, rating habits, and kinds of bad raters.

A stimulus is a point with five coordinates: its spectral match (the one that the model names, cut to 0..1), its
temporal match, and the three of its `Percept`. The original and the real surface are the point where nothing is lost.

- *Realism* is the weighted sum of the coordinates.
- *Distance* is the weighted sum of five differences (city block). Those of a percept are between the two vibrations
  themselves, as they differ from each other. Level counts in both directions: what is stronger than the reference is as
  different as what is weaker by the same number of dB. A match is known to the original only: by its weight, stimuli
  lie on a line, not in a space, and two that match equally well feel the same.
- *Similarity* is the top of the scale less the distance from the reference: what is identical is worth full marks.

Answer of a careful one: sure + gain * (percept - sure) + bias + shift + noise, cut to 0..100. Sure is the end of the
slider that means the same to everybody: the bottom, or the top (identical) where similarity is asked for. The shift is
what order and fatigue do; bias, gain and size of the noise are the participant's own. In a lapse any answer is as
likely as another.

Of the bad raters,

- a *straight-liner* leaves the marker about where they like it, or always makes the same choice;
- a *random clicker* answers anything, and fast;
- a *scale-reverser* takes the slider's ends for each other. A choice has no ends: there they are like anyone else.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING

from feel321.protocols.trial import RATING_RANGE, SURFACE
from feel321.study.observer.percepts import Percept, compare_percepts

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    import numpy as np

    from feel321.protocols.trial import Judgement, Trial
    from feel321.stimuli.sets.manifest import Stimulus

# Who takes part in a simulated study: careful participants, each with a slider hand of their own, and bad raters.

NORMAL = "normal"
STRAIGHT_LINER = "straight_liner"
RANDOM_CLICKER = "random_clicker"
SCALE_REVERSER = "scale_reverser"
KINDS = (NORMAL, STRAIGHT_LINER, RANDOM_CLICKER, SCALE_REVERSER)
"""What kinds of raters there are."""

STRAIGHT_SD = 1.0
"""How exactly, in points, a straight-liner finds the same place again."""

UNHURRIED, HASTY = (0.7, 0.4), (-0.7, 0.3)
"""Mean and standard deviation of the logarithm of the time in s that an answer takes: medians of 2.0 s and 0.5 s."""

SPECTRAL = ("spectral_match_bounded", "spectral_match")
"""Spectral matches that simulated participants may feel by."""

NODES = 15
"""Of the quadrature over gains and over sizes of the noise."""

_SHARES = ("lapse_rate", "straight_liners", "random_clickers", "scale_reversers")
_SIZES = ("bias_sd", "gain_sd", "noise_sd", "noise_spread", "fatigue_noise")


@dataclass(frozen=True, slots=True)
class ObserverModel:
    """How simulated participants feel, and how they differ. A weight of 0 plants no effect.

    intercept: percept of a stimulus that matches in nothing, in points; spectral, temporal: what a
    perfect spectral or temporal match adds, in points; bias_sd: standard deviation of the
    participants' biases, in points; noise_sd: median size of their noise, in points;
    threshold_spectral: points lost per dB of threshold-weighted spectral distance from the
    original, or whatever the reference is; level: points per dB of felt level above that of the
    original; lapse_rate: share of answers that have nothing to do with what was felt, 0 to 1;
    straight_liners, random_clickers, scale_reversers: shares of the participants who are such bad
    raters, 0 to 1, and at most 1 together; spectral_metric: 1 counts as 0 where it is negative: a
    slope on it is planted from 0 to 1 only.
    """

    intercept: float
    spectral: float
    temporal: float
    bias_sd: float
    gain_sd: float
    noise_sd: float
    noise_spread: float
    threshold_spectral: float = 0.0
    envelope: float = 0.0
    level: float = 0.0
    lapse_rate: float = 0.0
    order: float = 0.0
    fatigue: float = 0.0
    fatigue_noise: float = 0.0
    straight_liners: float = 0.0
    random_clickers: float = 0.0
    scale_reversers: float = 0.0
    spectral_metric: str = SPECTRAL[0]

    def __post_init__(self) -> None:
        """Refuse numbers out of range."""
        if self.spectral_metric not in SPECTRAL:
            raise ValueError(
                f"spectral_metric: got {self.spectral_metric!r}, allowed is {' or '.join(SPECTRAL)}"
            )
        for name in _SHARES:
            if not 0 <= getattr(self, name) <= 1:
                raise ValueError(
                    f"{name}: got {getattr(self, name)}, allowed is a share from 0 to 1"
                )
        for name in _SIZES:
            if not getattr(self, name) >= 0:
                raise ValueError(f"{name}: got {getattr(self, name)}, allowed is 0 or more")
        bad = self.straight_liners + self.random_clickers + self.scale_reversers
        if bad > 1 + 1e-9:
            raise ValueError(
                f"straight_liners, random_clickers, scale_reversers: got {bad:g} together, allowed is up to 1"
            )

    @property
    def uses_percepts(self) -> bool:
        """Whether stimuli must be read and measured before this observer can feel them."""
        return any((self.threshold_spectral, self.envelope, self.level))


@dataclass(frozen=True, slots=True)
class Rater:
    """One simulated participant.

    bias, gain, noise_sd: how they use a scale: in points, as a factor, in points.
    """

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
        """Set a slider.

        percept: what was felt, in points; shift: what order and fatigue add, in points.
        """
        low, high = RATING_RANGE
        guess, lapsed = rng.uniform(low, high), rng.random() < self.lapse_rate
        points = (
            sure
            + self.gain * (percept - sure)
            + self.bias
            + shift
            + rng.normal(0, self.noise_sd * growth)
        )
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
        """Choose the part that feels most like the one asked about.

        distances: how far each candidate is from the part asked about, in points.

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
        guess, lapsed = names[rng.integers(len(names))], rng.random() < self.lapse_rate
        if self.kind == STRAIGHT_LINER:
            return names[int(self.favourite * len(names))]
        if self.kind == RANDOM_CLICKER or lapsed:
            return guess
        asked, *felt = rng.normal(0, self.noise_sd * growth, len(names) + 1)
        away = {
            name: abs(max(distances[name], 0.0) + noise - asked)
            for name, noise in zip(names, felt, strict=True)
        }
        nearest = min(away.values())
        # Where two are exactly as near, nothing was felt of a difference.
        return guess if away[guess] == nearest else min(names, key=away.__getitem__)

    def take_time(self, rng: np.random.Generator) -> float:
        """Take the time that an answer takes.

        Returns time in s.
        """
        return float(rng.lognormal(*(HASTY if self.kind == RANDOM_CLICKER else UNHURRIED)))


def expect_rating(
    model: ObserverModel, percepts: Sequence[float], *, sure: float = RATING_RANGE[0]
) -> list[float]:
    """Compute the mean rating that careful participants give to percepts, without order and fatigue.

    percepts: what is felt, in points.

    Notes
    -----
    Given gain and size of the noise, a rating is a normal variable cut to the scale, whose mean is known; over their
    lognormal distributions it is averaged by Gauss-Hermite quadrature.
    """
    import numpy as np
    from scipy.stats import norm

    low, high = RATING_RANGE
    nodes, weights = np.polynomial.hermite_e.hermegauss(NODES)
    weights /= weights.sum()
    gain = np.exp(model.gain_sd * nodes)[:, None, None]
    spread = (
        np.hypot(model.bias_sd, model.noise_sd * np.exp(model.noise_spread * nodes))[None, :, None]
        + 1e-12
    )
    mean = sure + gain * (np.asarray(percepts, dtype=np.float64) - sure)
    below, above = (low - mean) / spread, (high - mean) / spread
    inside = norm.cdf(above) - norm.cdf(below)
    cut = (
        low * norm.cdf(below)
        + high * norm.sf(above)
        + mean * inside
        + spread * (norm.pdf(below) - norm.pdf(above))
    )
    careful = np.einsum("i,j,ijk->k", weights, weights, cut)
    found: list[float] = (careful + model.lapse_rate * ((low + high) / 2 - careful)).tolist()
    return found


def draw_rater(model: ObserverModel, rng: np.random.Generator) -> Rater:
    """Draw a participant."""
    return Rater(
        bias=rng.normal(0, model.bias_sd),
        gain=rng.lognormal(0, model.gain_sd),
        noise_sd=model.noise_sd * rng.lognormal(0, model.noise_spread),
        kind=_draw_kind(model, rng.random()),
        favourite=rng.uniform(0.2, 0.8),
        lapse_rate=model.lapse_rate,
    )


def _draw_kind(model: ObserverModel, place: float) -> str:
    for kind, share in (
        (STRAIGHT_LINER, model.straight_liners),
        (RANDOM_CLICKER, model.random_clickers),
        (SCALE_REVERSER, model.scale_reversers),
    ):
        if place < share:
            return kind
        place -= share
    return NORMAL


# What a stimulus feels like to a simulated participant, and how far two are apart.


@dataclass(frozen=True, slots=True)
class Point:
    """Where a stimulus lies for the sense of touch.

    spectral, temporal: how well it matches its recording, 0 to 1.
    """

    spectral: float
    temporal: float
    percept: Percept


UNCHANGED = Percept(0.0, 0.0, 0.0)
"""The percept of the original."""

REAL = Point(1.0, 1.0, UNCHANGED)
"""The original and the real surface."""


@dataclass(frozen=True, slots=True)
class Experience:
    """A trial and what was felt in it."""

    trial: Trial
    points: Mapping[str, Point]

    def find(self, part: str) -> Point:
        """Find where a part lies."""
        if part not in self.points:
            raise ValueError(
                f"simulated observer: was asked about part {part!r} of trial {self.trial.number} before it was felt; "
                "play it first"
            )
        return self.points[part]

    def find_reference(self, judgement: Judgement) -> Point:
        """Find where the reference of a judgement lies."""
        if judgement.reference_id == SURFACE:
            return REAL
        for part in self.trial.parts:
            if part.stimulus_id == judgement.reference_id:
                return self.find(part.name)
        raise ValueError(
            f"simulated observer: trial {self.trial.number}: got reference {judgement.reference_id!r}, allowed is "
            "what a part of the trial holds; a reference must be felt"
        )


@dataclass(frozen=True, slots=True)
class Touch:
    """The sense of touch that all simulated participants share."""

    model: ObserverModel
    percepts: Mapping[str, Percept]

    def locate(self, stimulus: Stimulus | None) -> Point:
        """Find where a stimulus lies."""
        if stimulus is None:
            return REAL
        percept = self.percepts.get(stimulus.stimulus_id) if self.model.uses_percepts else UNCHANGED
        if percept is None:
            raise ValueError(
                f"stimulus {stimulus.stimulus_id}: got no percept, the observer's weights need one; "
                "read the percepts of the whole set first"
            )
        return Point(self._match_spectra(stimulus), stimulus.temporal_match, percept)

    def _match_spectra(self, stimulus: Stimulus) -> float:
        """Give the spectral match that counts; a set that was built before the bounded one existed has only eq. 1."""
        value: float = getattr(stimulus, self.model.spectral_metric)
        return min(max(stimulus.spectral_match if math.isnan(value) else value, 0.0), 1.0)

    def feel(self, point: Point) -> float:
        """Tell how real something feels.

        Returns percept in points, not cut to the scale.
        """
        model, lost = self.model, point.percept
        gained = model.intercept + model.spectral * point.spectral + model.temporal * point.temporal
        missed = model.threshold_spectral * lost.spectral_db + model.envelope * lost.envelope
        return gained - missed + model.level * lost.level_db

    def measure_distance(self, first: Point, second: Point) -> float:
        """Tell how different two feel.

        Returns distance in points.
        """
        model, apart = self.model, compare_percepts(first.percept, second.percept)
        return (
            model.spectral * abs(first.spectral - second.spectral)
            + model.temporal * abs(first.temporal - second.temporal)
            + model.threshold_spectral * apart.spectral_db
            + model.envelope * apart.envelope
            + abs(model.level * apart.level_db)
        )


def judge(experience: Experience, judgement: Judgement, *, touch: Touch) -> float:
    """Tell what a participant without bias, noise or habit would answer on a slider.

    Returns percept in points, not cut to the scale.
    """
    return find_slider(experience.trial).judge(experience, judgement, touch=touch)


def find_slider(trial: Trial) -> Slider:
    """Find how a trial's slider is understood."""
    if trial.protocol not in SLIDERS:
        allowed = ", ".join(SLIDERS)
        raise ValueError(
            f"simulated observer: got protocol {trial.protocol!r}, allowed with a slider is one of {allowed}"
        )
    return SLIDERS[trial.protocol]


def compare(
    experience: Experience, judgement: Judgement, choices: Sequence[str], *, touch: Touch
) -> dict[str, float]:
    """Tell how far each candidate is from the part asked about.

    Returns distance in points of each.
    """
    asked = experience.find(judgement.part)
    return {name: touch.measure_distance(experience.find(name), asked) for name in choices}


def _judge_realism(experience: Experience, judgement: Judgement, *, touch: Touch) -> float:
    return touch.feel(experience.find(judgement.part))


def _judge_dissimilarity(experience: Experience, judgement: Judgement, *, touch: Touch) -> float:
    return touch.measure_distance(
        experience.find(judgement.part), experience.find_reference(judgement)
    )


def _judge_similarity(experience: Experience, judgement: Judgement, *, touch: Touch) -> float:
    return RATING_RANGE[1] - _judge_dissimilarity(experience, judgement, touch=touch)


@dataclass(frozen=True, slots=True)
class Slider:
    """How a slider is understood."""

    judge: Callable[..., float]
    sure: float


_LOW, _HIGH = RATING_RANGE

SLIDERS: Mapping[str, Slider] = MappingProxyType({
    "realism": Slider(_judge_realism, sure=_LOW),
    "similarity": Slider(_judge_similarity, sure=_HIGH),
    "dissimilarity": Slider(_judge_dissimilarity, sure=_LOW),
    "mushra": Slider(_judge_similarity, sure=_HIGH),
})
"""Protocol -> how its slider is understood."""
