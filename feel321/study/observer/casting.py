"""Who the simulated participants of a study are: a model, a seed, and the number of each person."""

from __future__ import annotations

import hashlib
import re
from dataclasses import dataclass
from typing import TYPE_CHECKING

from feel321.study.observer.participant import SPECTRAL, ObserverModel
from feel321.study.observer.percepts import Percept, read_percepts

if TYPE_CHECKING:
    from collections.abc import Mapping

    from feel321.stimuli.sets.manifest import StimulusSet
    from feel321.study.settings.schema import Settings

NUMBERED = re.compile(r"sim(\d+)")
"""Codes that hold the number of a simulated person."""


@dataclass(frozen=True, slots=True)
class Casting:
    """The simulated participants of a study: their model, seed and percepts."""

    model: ObserverModel
    seed: int
    percepts: Mapping[str, Percept]


def make_model(settings: Settings) -> ObserverModel:
    """Make the observers of a study, who feel by the spectral match that it declares."""
    declared = [name for name in settings.analysis.metrics if name in SPECTRAL]
    return ObserverModel(
        **settings.observer.model_dump(),
        spectral_metric=(declared or SPECTRAL)[0],
        detection_curve=settings.stimuli.threshold,
    )


def cast_observers(settings: Settings, stimuli: StimulusSet, *, seed: int) -> Casting:
    """Set the observer parameters of a study's simulated participants, by the spectral match that it declares."""
    model = make_model(settings)
    return Casting(model, seed, read_percepts(stimuli) if model.uses_percepts else {})


def find_person(participant: str) -> int:
    """Find the simulated person of a code: always the same one, with or without a hand, whatever the design.

    Examples
    --------
    >>> find_person("sim007"), find_person("p07") == find_person("p07"), find_person("p07") == find_person("p08")
    (7, True, False)
    """
    if numbered := NUMBERED.fullmatch(participant):
        return int(numbered[1])
    return int.from_bytes(hashlib.sha256(participant.encode()).digest()[:8], "big")
