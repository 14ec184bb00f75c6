"""The nouns of an experiment: what is felt, what is judged, in which trial, on which scale.

A trial names its stimuli by id; what an id sounds like is known to the room above only.
"""

from __future__ import annotations

from dataclasses import dataclass

RATING_RANGE = (0.0, 100.0)
"""Lowest and highest rating of every scale, in points."""

TIMINGS = ("strict", "replay", "free")
"""How the parts of a trial are felt: once in order; in order and again at will; at will from the start."""

SURFACE = "surface"
"""What stands for the id of a stimulus where the real surface is felt."""


@dataclass(frozen=True, slots=True)
class Scale:
    """What a participant answers on: a slider from 0 to 100 points, or a choice between parts.

    Parameters
    ----------
    name : str
        Short name, as in `ratings.csv`.
    question : str
        What the participant is asked.
    low_label, high_label : str
        What 0 and 100 points mean.
    anchors : tuple of str
        Words that stand along the slider, evenly spaced from 0 to 100; may be none.
    choices : tuple of str
        Names of the parts between which the participant chooses; none where there is a slider.
    """

    name: str
    question: str
    low_label: str
    high_label: str
    anchors: tuple[str, ...] = ()
    choices: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Item:
    """What a protocol needs to know of a stimulus in order to place it in trials.

    Parameters
    ----------
    stimulus_id : str
        The stimulus.
    recording : str
        The recording that it was made from.
    reducer : str
        What it was made by.
    level : str
        The level arm that it belongs to.
    role : str
        `test`, `reference` or `anchor`.
    """

    stimulus_id: str
    recording: str
    reducer: str
    level: str
    role: str


@dataclass(frozen=True, slots=True)
class Part:
    """Something that is felt in a trial: a stimulus, or the real surface.

    Parameters
    ----------
    name : str
        Its name within the trial, such as `reference`, `test`, `a` or `3`; it reveals nothing.
    stimulus_id : str or None
        The stimulus; None where the real surface is stroked.
    surface : str or None
        The recording whose surface is stroked; None where a stimulus is played.
    """

    name: str
    stimulus_id: str | None = None
    surface: str | None = None


@dataclass(frozen=True, slots=True)
class Judgement:
    """One answer that a trial asks for; it becomes one row of `ratings.csv`.

    Parameters
    ----------
    part : str
        The part that is judged.
    stimulus_id : str
        The stimulus that the judgement is about.
    reference_id : str or None
        What it is judged against: a stimulus, `surface`, or None where the judgement is absolute.
    expected : tuple of float, or None
        Lowest and highest rating that a participant who has understood gives; None where any will do.
    """

    part: str
    stimulus_id: str
    reference_id: str | None = None
    expected: tuple[float, float] | None = None


@dataclass(frozen=True, slots=True)
class Comparison:
    """What is felt and judged together, before it has a place in a session.

    Parameters
    ----------
    parts : tuple of Part
        What is felt, in order.
    judgements : tuple of Judgement
        What is judged.
    catch : str
        `identical`, `hidden_reference` or `anchor` where the right answer is known; empty elsewhere.
    """

    parts: tuple[Part, ...]
    judgements: tuple[Judgement, ...]
    catch: str = ""


@dataclass(frozen=True, slots=True)
class Trial:
    """One comparison at its place in the session of one participant.

    Parameters
    ----------
    number : int
        Its number in the plan. Trials of the main phase are numbered from 1 in their order, others follow.
    block : int
        Place of its block in the plan, from 1; 0 outside the main phase.
    repeat : int
        How often this comparison has come round in this protocol, from 1; 0 outside the main phase.
    protocol : str
        Name of the protocol.
    scale : str
        Name of the scale.
    timing : str
        How its parts are felt, one of `TIMINGS`.
    recording : str
        The recording that it is about.
    parts : tuple of Part
        What is felt, in order. Each must be felt to its end before an answer is taken.
    judgements : tuple of Judgement
        What is judged.
    phase : str
        What it is for: `training`, `practice` or `main`; only trials of the last are results.
    catch : str
        As in `Comparison`.
    """

    number: int
    block: int
    repeat: int
    protocol: str
    scale: str
    timing: str
    recording: str
    parts: tuple[Part, ...]
    judgements: tuple[Judgement, ...]
    phase: str = "main"
    catch: str = ""


def find_missing(trial: Trial, answers: set[str]) -> list[str]:
    """Find the judgements that a participant has not given yet.

    Parameters
    ----------
    trial : Trial
        The trial.
    answers : set of str
        Names of the parts that were judged.

    Returns
    -------
    list of str
        Names of the parts that were not.
    """
    return [judgement.part for judgement in trial.judgements if judgement.part not in answers]
