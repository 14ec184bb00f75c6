"""Who takes part in a simulated study: careful participants, each with a slider hand of their own, and bad raters.

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

from dataclasses import dataclass
from typing import TYPE_CHECKING

from protocols.trial import RATING_RANGE

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    import numpy as np

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

    Parameters
    ----------
    intercept : float
        Percept of a stimulus that matches in nothing, in points.
    spectral, temporal : float
        What a perfect spectral or temporal match adds, in points; +0.1 of a match adds a tenth of it. Matches put
        stimuli on a line, not in a space: two that match equally well feel the same, however they differ; the next
        three weights tell them apart.
    bias_sd : float
        Standard deviation of the participants' biases, in points.
    gain_sd : float
        Standard deviation of the logarithms of their gains.
    noise_sd : float
        Median size of their noise, in points.
    noise_spread : float
        Standard deviation of the logarithms of its size.
    threshold_spectral : float
        Points lost per dB of threshold-weighted spectral distance from the original, or whatever the reference is.
    envelope : float
        Points lost per unit of distance between the envelopes.
    level : float
        Points per dB of felt level above that of the original; lost in either direction where two are compared.
    lapse_rate : float
        Share of answers that have nothing to do with what was felt, 0 to 1.
    order : float
        Contrast: points lost per point by which the percept before was above the middle of the scale.
    fatigue : float
        Points by which answers drift in 100 trials.
    fatigue_noise : float
        Share by which the noise grows in 100 trials.
    straight_liners, random_clickers, scale_reversers : float
        Shares of the participants who are such bad raters, 0 to 1, and at most 1 together.
    spectral_metric : str
        Which spectral match that is, one of `SPECTRAL`. The paper's eq. 1 counts as 0 where it is negative: a slope on
        it is planted from 0 to 1 only.

    Raises
    ------
    ValueError
        If a share is not one, a size is negative, or there is no such spectral match.
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
            raise ValueError(f"spectral_metric: got {self.spectral_metric!r}, allowed is {' or '.join(SPECTRAL)}")
        for name in _SHARES:
            if not 0 <= getattr(self, name) <= 1:
                raise ValueError(f"{name}: got {getattr(self, name)}, allowed is a share from 0 to 1")
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

    Parameters
    ----------
    kind : str
        One of `KINDS`.
    bias, gain, noise_sd : float
        How they use a scale: in points, as a factor, in points.
    lapse_rate : float
        Share of answers that have nothing to do with what was felt.
    favourite : float
        What a straight-liner prefers, as a share of the scale.
    """

    kind: str
    bias: float
    gain: float
    noise_sd: float
    lapse_rate: float
    favourite: float

    def rate(
        self, percept: float, *, sure: float = RATING_RANGE[0], shift: float, growth: float, rng: np.random.Generator
    ) -> float:
        """Set a slider.

        Parameters
        ----------
        percept : float
            What was felt, in points.
        sure : float
            The points that mean the same to everybody.
        shift : float
            What order and fatigue add, in points.
        growth : float
            Size of the noise today, as a multiple of the participant's own.
        rng : numpy.random.Generator
            Where chance comes from.

        Returns
        -------
        float
            Points, 0 to 100, in tenths.
        """
        low, high = RATING_RANGE
        guess, lapsed = rng.uniform(low, high), rng.random() < self.lapse_rate
        points = sure + self.gain * (percept - sure) + self.bias + shift + rng.normal(0, self.noise_sd * growth)
        if self.kind == STRAIGHT_LINER:
            points = low + (high - low) * self.favourite + rng.normal(0, STRAIGHT_SD)
        elif self.kind == RANDOM_CLICKER or lapsed:
            points = guess
        elif self.kind == SCALE_REVERSER:
            points = low + high - points
        return round(min(max(points, low), high), 1)

    def choose(self, distances: Mapping[str, float], *, growth: float, rng: np.random.Generator) -> str:
        """Choose the part that feels most like the one asked about.

        Parameters
        ----------
        distances : mapping of str to float
            How far each candidate is from the part asked about, in points; 0 for the one that is the same.
        growth : float
            As for `rate`.
        rng : numpy.random.Generator
            Where chance comes from.

        Returns
        -------
        str
            The candidate.

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
        away = {name: abs(max(distances[name], 0.0) + noise - asked) for name, noise in zip(names, felt, strict=True)}
        nearest = min(away.values())
        # Where two are exactly as near, nothing was felt of a difference.
        return guess if away[guess] == nearest else min(names, key=away.__getitem__)

    def take_time(self, rng: np.random.Generator) -> float:
        """Take the time that an answer takes.

        Parameters
        ----------
        rng : numpy.random.Generator
            Where chance comes from.

        Returns
        -------
        float
            Time in s.
        """
        return float(rng.lognormal(*(HASTY if self.kind == RANDOM_CLICKER else UNHURRIED)))


def expect_rating(model: ObserverModel, percepts: Sequence[float], *, sure: float = RATING_RANGE[0]) -> list[float]:
    """Compute the mean rating that careful participants give to percepts, without order and fatigue.

    Parameters
    ----------
    model : ObserverModel
        How participants differ.
    percepts : sequence of float
        What is felt, in points.
    sure : float
        The points that mean the same to everybody.

    Returns
    -------
    list of float
        Points: less far apart than the percepts, because the slider's ends cut bias and noise off, and lapses go to the
        middle. This is what is really planted.

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
    spread = np.hypot(model.bias_sd, model.noise_sd * np.exp(model.noise_spread * nodes))[None, :, None] + 1e-12
    mean = sure + gain * (np.asarray(percepts, dtype=np.float64) - sure)
    below, above = (low - mean) / spread, (high - mean) / spread
    inside = norm.cdf(above) - norm.cdf(below)
    cut = low * norm.cdf(below) + high * norm.sf(above) + mean * inside + spread * (norm.pdf(below) - norm.pdf(above))
    careful = np.einsum("i,j,ijk->k", weights, weights, cut)
    found: list[float] = (careful + model.lapse_rate * ((low + high) / 2 - careful)).tolist()
    return found


def draw_rater(model: ObserverModel, rng: np.random.Generator) -> Rater:
    """Draw a participant.

    Parameters
    ----------
    model : ObserverModel
        How participants differ.
    rng : numpy.random.Generator
        Where chance comes from.

    Returns
    -------
    Rater
        The participant.
    """
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
