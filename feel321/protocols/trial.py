"""Trials: what is judged against what, the pages between them, and the protocols' common record.

A trial names its stimuli by id; what an id sounds like is known to the room above only.

- *identical*: the reference against itself is as good as the reference, 75 points or more;
- *hidden_reference*: the recording itself, judged by itself or against the real surface, is more real than not, 55
  points or more;
- *anchor*: a stimulus that was made to be rated badly is not more good than not, 50 points or less.

The limits say whether a task was understood, no more: the upper quarter of the scale is for what is as good as the
reference. No answer is right for both a reference and an anchor, nor are two that differ by less than 5 points, so
nobody passes who always answers the same. Raters are screened in the analysis, by the limits of BS.1534-3 (90
points) [1]_. The limit for anchors holds for the better of two and all the more for the worse, so none needs to be
known by its name.

References
----------
.. [1] ITU-R BS.1534-3, "Method for the subjective assessment of intermediate quality level of audio systems", 2015
   (post-screening of assessors).
"""

from __future__ import annotations

from dataclasses import dataclass
from math import prod
from types import MappingProxyType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

# The nouns of an experiment: what is felt, what is judged, in which trial, on which scale.

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
    """Find the judgements that a participant has not given yet."""
    return [judgement.part for judgement in trial.judgements if judgement.part not in answers]


# How a session goes besides its trials: pages, training, breaks, and what becomes of a bad trial.

FLAGS = ("underrun", "clipped", "device_error", "too_fast", "not_felt")
"""What can be wrong with an attempt at a trial."""


@dataclass(frozen=True, slots=True)
class Flow:
    """The rules of a session; they are part of the plan.

    Parameters
    ----------
    break_trials : int or None
        A break after so many trials; None for none.
    break_min : float or None
        A break after so many minutes; None for none.
    break_s, rest_s : float
        Least duration in s of a break, and of the rest without any stimulus that every session has.
    training_pass : float
        Share of expected answers at which training is passed, 0 to 1; what guessing gives does not count.
    training_rounds : int
        Rounds of training before the session goes on without.
    min_response_s : float
        Faster answers, in s, are too fast.
    max_attempts : int
        How often a trial is tried before it is given up; attempts that the device spoiled are not counted.
    reject : tuple of str
        The flags, of `FLAGS`, that make a trial bad: its rating does not count, and it is tried again. Where no
        answer could be given, because the device failed or what is felt once was cut short, it always is.
    gap_s : float
        Silence in s before each part of a trial.
    """

    break_trials: int | None = 60
    break_min: float | None = 10.0
    break_s: float = 30.0
    rest_s: float = 60.0
    training_pass: float = 0.75
    training_rounds: int = 3
    min_response_s: float = 0.2
    max_attempts: int = 3
    reject: tuple[str, ...] = ("underrun", "device_error", "too_fast", "not_felt")
    gap_s: float = 0.5


@dataclass(frozen=True, slots=True)
class Page:
    """A page that the participant reads, and during which nothing is felt.

    Parameters
    ----------
    key : str
        Its text in the catalogue.
    least_s : float
        How long, in s, it stands at least.
    by : str
        Who goes on from it: `participant` or `experimenter`.
    """

    key: str
    least_s: float = 0.0
    by: str = "participant"


PAGES = (
    "welcome",
    "consent",
    "instructions",
    "training",
    "expected",
    "unexpected",
    "training_passed",
    "training_again",
    "training_failed",
    "practice",
    "main",
    "break",
    "rest",
    "pause",
    "warm_up",
    "end",
)
"""Keys of all pages; that of `instructions` is followed by a dot and the protocol."""


# What a rating task declares, and what a study may decide about it. Each task is one module of this shape.

ORIGINAL = "original"
"""What a task calls the recording itself as reference."""


@dataclass(frozen=True, slots=True)
class Protocol:
    """A rating task.

    Parameters
    ----------
    name : str
        Name of the task, as in `study.toml` and `ratings.csv`.
    scale : str
        Name of the scale in the catalogue of texts.
    factors : tuple of str
        What differs between its trials.
    timings : tuple of str
        The forms that it has, of `TIMINGS`; the first unless a study says otherwise.
    references : tuple of str
        What it can be judged against: `original`, `surface`, `reducer` (any by name); none where it is absolute.
    compare : callable
        Takes all items of one recording and the task; gives the comparisons to judge, one trial each.
    teach : callable
        Takes the same; gives what training may show: the same comparisons in the same order, perhaps with more of
        the right answers known, then perhaps others.
    arrange : callable
        Takes a comparison and a turn, a whole number; gives the comparison in the arrangement whose turn it is,
        so that successive turns balance what stands where.
    score : callable
        Takes a judgement and the answer to it, with the ids of the parts by name; gives points, 0 to 100.
    choices : tuple of str
        Names of the parts between which the participant chooses; none where there is a slider.
    """

    name: str
    scale: str
    factors: tuple[str, ...]
    timings: tuple[str, ...]
    references: tuple[str, ...]
    compare: Callable[[Sequence[Item], Task], tuple[Comparison, ...]]
    teach: Callable[[Sequence[Item], Task], tuple[Comparison, ...]]
    arrange: Callable[[Comparison, int], Comparison]
    score: Callable[[Judgement, float | str, Mapping[str, str | None]], float]
    choices: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Task:
    """A protocol as a study uses it.

    Parameters
    ----------
    protocol : str
        Name of the protocol.
    timing : str
        One of the protocol's timings.
    reference : str
        What is judged against: `original`, `surface` or the name of a reducer.
    surface : bool
        Whether the real surface is felt first, where the judgement is absolute.
    training, practice : int
        Trials with feedback, and trials without that do not count, before the first that does.
    """

    protocol: str
    timing: str
    reference: str = ORIGINAL
    surface: bool = False
    training: int = 0
    practice: int = 0


def keep_arrangement(comparison: Comparison, turn: int) -> Comparison:  # noqa: ARG001 - the form of all arrangers
    """Leave a comparison as it is: it has one arrangement only."""
    return comparison


def score_slider(
    judgement: Judgement,  # noqa: ARG001 - the form of all scores
    answer: float | str,
    parts: Mapping[str, str | None],  # noqa: ARG001 - the form of all scores
) -> float:
    """Take the points of a slider as they are."""
    return float(answer)


def find_reference(item: Item, items: Sequence[Item], *, reference: str) -> Item:
    """Find what an item is judged against."""
    if reference == ORIGINAL:
        candidates = [other for other in items if other.role == "reference"]
    else:
        candidates = [
            other for other in items if other.reducer == reference and other.role == "test"
        ]
    # A set may render its references once, or once per level arm; the arm's own comes first.
    own = [other for other in candidates if other.level == item.level] or candidates
    if len(own) != 1:
        raise ValueError(
            f"recording {item.recording!r}, level {item.level!r}: got {len(own)} stimuli for the reference "
            f"{reference!r}, allowed is exactly one; build the stimulus set with it"
        )
    return own[0]


# Catch trials: stimuli about which someone who has understood the task cannot be of any opinion.

EXPECTED: Mapping[str, tuple[float, float]] = MappingProxyType({
    "identical": (75.0, 100.0),
    "hidden_reference": (55.0, 100.0),
    "anchor": (0.0, 50.0),
})
"""Kind of catch -> lowest and highest rating to expect, where 100 points mean that nothing is missing."""


def find_catch(item: Item, reference: Item | None) -> str:
    """Tell whether, and why, the right answer about a stimulus is known.

    Examples
    --------
    >>> from feel321.protocols.trial import Item
    >>> original = Item("tap-original", "tap", "original", "as_is", "reference")
    >>> find_catch(original, original), find_catch(original, None)
    ('identical', 'hidden_reference')
    """
    if item == reference:
        return "identical"
    if item.role == "reference" and reference is None:
        return "hidden_reference"
    return "anchor" if item.role == "anchor" else ""


# Factors in which participants differ: who belongs to which group, and what is felt there.

CHOOSING = ("level", "protocol")
"""Factors that decide what is felt; any other is a label."""


def place_in_groups(
    between: Mapping[str, Sequence[str]], number: int
) -> tuple[dict[str, str], int]:
    """Tell which group a participant belongs to, and as which of it.

    number: the participant's number in the study, from 1; returns place: the participant's number
    within the group, from 1: it takes a row of the design.

    Examples
    --------
    >>> place_in_groups({"grip": ["pen", "power"]}, 4)
    ({'grip': 'power'}, 2)
    """
    place, turn = divmod(number - 1, prod(len(levels) for levels in between.values()))
    groups: dict[str, str] = {}
    for factor, levels in reversed(list(between.items())):  # the last factor changes fastest
        turn, level = divmod(turn, len(levels))
        groups[factor] = levels[level]
    return {factor: groups[factor] for factor in between}, place + 1


def select_items(items: Sequence[Item], groups: Mapping[str, str]) -> tuple[Item, ...]:
    """Keep the stimuli that a group feels."""
    if (level := groups.get("level")) is None:
        return tuple(items)
    own = [item for item in items if item.level == level]
    served = {item.recording for item in own if item.role == "reference"}
    shared = [item for item in items if item.role == "reference" and item.recording not in served]
    return tuple(own + shared)


def select_tasks(tasks: Sequence[Task], groups: Mapping[str, str]) -> tuple[Task, ...]:
    """Keep the tasks that a group has."""
    own = groups.get("protocol")
    return tuple(task for task in tasks if own in {None, task.protocol})


# Level arms: stimuli of one recording are compared with one another inside their arm only.


def split_arms(items: Sequence[Item]) -> tuple[tuple[Item, ...], ...]:
    """Split the stimuli of a recording into its level arms."""
    levels = tuple(dict.fromkeys(item.level for item in items if item.role == "test"))
    if not levels:
        recordings = ", ".join(
            repr(name) for name in dict.fromkeys(item.recording for item in items)
        )
        raise ValueError(
            f"recording {recordings or 'unknown'}: got no stimulus to test, allowed is one or more; "
            "name reducers and build the stimulus set again"
        )
    return tuple(select_items(items, {"level": level}) for level in levels)
