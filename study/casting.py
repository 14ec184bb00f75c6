"""Who the simulated participants of a study are: the same person whether a mind alone takes part, or with a hand."""

from __future__ import annotations

import hashlib
import re
from dataclasses import dataclass
from typing import TYPE_CHECKING

from study.observer.percepts import read_percepts
from study.observer.raters import ObserverModel

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


def cast_observers(settings: Settings, stimuli: StimulusSet, *, seed: int) -> Casting:
    """Read off from a study how its simulated participants feel.

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
    model = ObserverModel(**settings.observer.model_dump())
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
