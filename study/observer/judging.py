"""What a stimulus feels like to a simulated participant, and how far two are apart.

A stimulus is a point with five coordinates: its spectral match (the one that the model names, cut to 0..1), its
temporal match, and the three of its `Percept`. The original and the real surface are the point where nothing is lost.

- *Realism* is the weighted sum of the coordinates.
- *Distance* is the weighted sum of five differences (city block). Those of a percept are between the two vibrations
  themselves, as they differ from each other. Level counts in both directions: what is stronger than the reference is as
  different as what is weaker by the same number of dB. A match is known to the original only: by its weight, stimuli
  lie on a line, not in a space, and two that match equally well feel the same.
- *Similarity* is the top of the scale less the distance from the reference: what is identical is worth full marks.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING

from protocols.trial import RATING_RANGE, SURFACE
from study.observer.percepts import Percept, compare_percepts

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from protocols.trial import Judgement, Trial
    from stimuli.manifest import Stimulus
    from study.observer.raters import ObserverModel


@dataclass(frozen=True, slots=True)
class Point:
    """Where a stimulus lies for the sense of touch.

    Parameters
    ----------
    spectral, temporal : float
        How well it matches its recording, 0 to 1.
    percept : Percept
        How far it is from the original.
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
    """A trial and what was felt in it.

    Parameters
    ----------
    trial : Trial
        The trial.
    points : mapping of str to Point
        Where each part that was felt lies, by its name.
    """

    trial: Trial
    points: Mapping[str, Point]

    def find(self, part: str) -> Point:
        """Find where a part lies.

        Parameters
        ----------
        part : str
            Its name.

        Returns
        -------
        Point
            Its place.

        Raises
        ------
        ValueError
            If it was not felt.
        """
        if part not in self.points:
            raise ValueError(
                f"simulated observer: was asked about part {part!r} of trial {self.trial.number} before it was felt; "
                "play it first"
            )
        return self.points[part]

    def find_reference(self, judgement: Judgement) -> Point:
        """Find where the reference of a judgement lies.

        Parameters
        ----------
        judgement : Judgement
            What is asked; not an absolute one.

        Returns
        -------
        Point
            Its place.

        Raises
        ------
        ValueError
            If no part of the trial is the reference, or it was not felt.
        """
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
    """The sense of touch that all simulated participants share.

    Parameters
    ----------
    model : ObserverModel
        How participants feel.
    percepts : mapping of str to Percept
        Percept of each stimulus by its id; only needed where the model uses them.
    """

    model: ObserverModel
    percepts: Mapping[str, Percept]

    def locate(self, stimulus: Stimulus | None) -> Point:
        """Find where a stimulus lies.

        Parameters
        ----------
        stimulus : Stimulus or None
            The stimulus; None for the real surface.

        Returns
        -------
        Point
            Its place.

        Raises
        ------
        ValueError
            If the model needs the stimulus's percept, and there is none.
        """
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

        Parameters
        ----------
        point : Point
            Where it lies.

        Returns
        -------
        float
            Percept in points, not cut to the scale.
        """
        model, lost = self.model, point.percept
        gained = model.intercept + model.spectral * point.spectral + model.temporal * point.temporal
        missed = model.threshold_spectral * lost.spectral_db + model.envelope * lost.envelope
        return gained - missed + model.level * lost.level_db

    def measure_distance(self, first: Point, second: Point) -> float:
        """Tell how different two feel.

        Parameters
        ----------
        first, second : Point
            Where they lie.

        Returns
        -------
        float
            Distance in points; not negative unless a weight is.
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

    Parameters
    ----------
    experience : Experience
        What was felt.
    judgement : Judgement
        What is asked.
    touch : Touch
        How it feels.

    Returns
    -------
    float
        Percept in points, not cut to the scale.

    Raises
    ------
    ValueError
        If the protocol is unknown, or something was not felt.
    """
    return find_slider(experience.trial).judge(experience, judgement, touch=touch)


def find_slider(trial: Trial) -> Slider:
    """Find how a trial's slider is understood.

    Parameters
    ----------
    trial : Trial
        A trial that is answered on a slider.

    Returns
    -------
    Slider
        What is felt of it, and which end is sure.

    Raises
    ------
    ValueError
        If the protocol is unknown.
    """
    if trial.protocol not in SLIDERS:
        allowed = ", ".join(SLIDERS)
        raise ValueError(
            f"simulated observer: got protocol {trial.protocol!r}, allowed with a slider is one of {allowed}"
        )
    return SLIDERS[trial.protocol]


def compare(experience: Experience, judgement: Judgement, choices: Sequence[str], *, touch: Touch) -> dict[str, float]:
    """Tell how far each candidate is from the part asked about.

    Parameters
    ----------
    experience : Experience
        What was felt.
    judgement : Judgement
        What is asked.
    choices : sequence of str
        The candidates, by the names of their parts.
    touch : Touch
        How it feels.

    Returns
    -------
    dict of str to float
        Distance in points of each.

    Raises
    ------
    ValueError
        If something was not felt.
    """
    asked = experience.find(judgement.part)
    return {name: touch.measure_distance(experience.find(name), asked) for name in choices}


def _judge_realism(experience: Experience, judgement: Judgement, *, touch: Touch) -> float:
    return touch.feel(experience.find(judgement.part))


def _judge_dissimilarity(experience: Experience, judgement: Judgement, *, touch: Touch) -> float:
    return touch.measure_distance(experience.find(judgement.part), experience.find_reference(judgement))


def _judge_similarity(experience: Experience, judgement: Judgement, *, touch: Touch) -> float:
    return RATING_RANGE[1] - _judge_dissimilarity(experience, judgement, touch=touch)


@dataclass(frozen=True, slots=True)
class Slider:
    """How a slider is understood.

    Parameters
    ----------
    judge : callable
        Takes an experience, a judgement and a sense of touch; gives the percept in points.
    sure : float
        The points that mean the same to everybody, about which their gains stretch the scale.
    """

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
