"""The nouns of an experiment: what is judged, in which trial, on which scale, by which protocol.

A trial names its stimuli by id; what an id sounds like is known to the room above only.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

RATING_RANGE = (0.0, 100.0)
"""Lowest and highest rating of every scale, in points."""


@dataclass(frozen=True, slots=True)
class Scale:
    """A rating scale from 0 to 100 points with labelled ends.

    Parameters
    ----------
    name : str
        Short name, as in `ratings.csv`.
    question : str
        What the participant is asked.
    low_label, high_label : str
        What 0 and 100 points mean.
    """

    name: str
    question: str
    low_label: str
    high_label: str


@dataclass(frozen=True, slots=True)
class Item:
    """What a protocol needs to know of a stimulus in order to place it in trials.

    Parameters
    ----------
    stimulus_id : str
        The stimulus.
    recording : str
        The recording that it was made from.
    level : str
        The level arm that it belongs to.
    role : str
        `test`, `reference` or `anchor`.
    """

    stimulus_id: str
    recording: str
    level: str
    role: str


@dataclass(frozen=True, slots=True)
class Comparison:
    """What is judged against what.

    Parameters
    ----------
    stimulus_id : str
        The stimulus that is rated.
    reference_id : str or None
        The stimulus that is felt before it; None where the judgement is absolute.
    """

    stimulus_id: str
    reference_id: str | None = None


@dataclass(frozen=True, slots=True)
class Protocol:
    """A rating task.

    Parameters
    ----------
    name : str
        Name of the task, as in `study.toml` and `ratings.csv`.
    scale : str
        Name of the scale in the catalogue of texts.
    compare : callable
        Takes all items of one recording, gives the comparisons to judge, one trial each.
    """

    name: str
    scale: str
    compare: Callable[[Sequence[Item]], tuple[Comparison, ...]]


@dataclass(frozen=True, slots=True)
class Trial:
    """One judgement of one participant.

    Parameters
    ----------
    number : int
        Place in the plan, from 1.
    block : int
        Place of its block in the plan, from 1. A block holds one recording.
    repeat : int
        How often these stimuli have come round in this protocol, from 1.
    protocol : str
        Name of the protocol.
    scale : str
        Name of the scale.
    stimulus_id : str
        The stimulus that is rated.
    reference_id : str or None
        The stimulus that is felt before it, if any.
    """

    number: int
    block: int
    repeat: int
    protocol: str
    scale: str
    stimulus_id: str
    reference_id: str | None = None
