"""Who the simulated participants of a study are: the same person whether a mind alone takes part, or with a hand."""

from __future__ import annotations

import hashlib
import re
from dataclasses import dataclass
from typing import TYPE_CHECKING

from study.observer.judging import Touch
from study.observer.percepts import read_percepts
from study.observer.raters import SPECTRAL, ObserverModel, expect_rating

if TYPE_CHECKING:
    from collections.abc import Mapping

    from stimuli.manifest import StimulusSet
    from study.observer.percepts import Percept
    from study.settings.tables import Settings

NUMBERED = re.compile(r"sim(\d+)")
"""Codes that hold the person's number."""


@dataclass(frozen=True, slots=True)
class Casting:
    """What makes the simulated participants of a study.

    Parameters
    ----------
    model : ObserverModel
        How participants feel.
    seed : int
        Seed of all draws.
    percepts : mapping of str to Percept
        Percept of each stimulus by its id; empty where the model uses none.
    """

    model: ObserverModel
    seed: int
    percepts: Mapping[str, Percept]


def find_planted(settings: Settings, stimuli: StimulusSet) -> dict[str, float]:
    """Compute the slopes that simulated participants plant in realism ratings, after the ends of the scale.

    Parameters
    ----------
    settings : Settings
        The study's settings.
    stimuli : StimulusSet
        What is felt.

    Returns
    -------
    dict of str to float
        Metric -> points per +0.1 within recordings, of the mean ratings of careful participants; empty where they feel
        more than the two matches, or realism is not rated.
    """
    import numpy as np

    model = _make_model(settings)
    tests = [stimulus for stimulus in stimuli.stimuli if stimulus.role == "test"]
    if model.uses_percepts or "realism" not in settings.session.protocols or not tests:
        return {}
    touch = Touch(model, {})
    points = [touch.locate(stimulus) for stimulus in tests]
    ratings = expect_rating(model, [touch.feel(point) for point in points])
    values = np.array([[point.spectral, point.temporal, rating] for point, rating in zip(points, ratings, strict=True)])
    arms = np.unique([f"{stimulus.recording}/{stimulus.level}" for stimulus in tests], return_inverse=True)[1]
    for arm in range(arms.max() + 1):
        values[arms == arm] -= values[arms == arm].mean(axis=0)
    slopes = np.linalg.lstsq(values[:, :2], values[:, 2], rcond=None)[0] / 10
    return dict(zip((model.spectral_metric, "temporal_match"), slopes.tolist(), strict=True))


def _make_model(settings: Settings) -> ObserverModel:
    declared = [name for name in settings.analysis.metrics if name in SPECTRAL]
    return ObserverModel(**settings.observer.model_dump(), spectral_metric=(declared or SPECTRAL)[0])


def cast_observers(settings: Settings, stimuli: StimulusSet, *, seed: int) -> Casting:
    """Read off from a study how its simulated participants feel: by the spectral match that it declares.

    Parameters
    ----------
    settings : Settings
        The study's settings.
    stimuli : StimulusSet
        What is felt.
    seed : int
        Seed of all draws.

    Returns
    -------
    Casting
        The participants.
    """
    model = _make_model(settings)
    return Casting(model, seed, read_percepts(stimuli) if model.uses_percepts else {})


def tell_person(participant: str) -> int:
    """Tell which person has a code; one code belongs to one person for ever, its number in the design may not.

    Parameters
    ----------
    participant : str
        The participant's code.

    Returns
    -------
    int
        The person's number.

    Examples
    --------
    >>> tell_person("sim007"), tell_person("p07") == tell_person("p07"), tell_person("p07") == tell_person("p08")
    (7, True, False)
    """
    if numbered := NUMBERED.fullmatch(participant):
        return int(numbered[1])
    return int.from_bytes(hashlib.sha256(participant.encode()).digest()[:8], "big")
