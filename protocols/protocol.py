"""What a rating task declares, and what a study may decide about it. Each task is one module of this shape."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from protocols.trial import Comparison, Item, Judgement

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
    """Leave a comparison as it is: it has one arrangement only.

    Parameters
    ----------
    comparison : Comparison
        The comparison.
    turn : int
        Whose turn it is.

    Returns
    -------
    Comparison
        The same.
    """
    return comparison


def score_slider(judgement: Judgement, answer: float | str, parts: Mapping[str, str | None]) -> float:  # noqa: ARG001 - the form of all scores
    """Take the points of a slider as they are.

    Parameters
    ----------
    judgement : Judgement
        What was judged.
    answer : float or str
        The slider's points.
    parts : mapping of str to str or None
        Stimulus of each part of the trial.

    Returns
    -------
    float
        The points.
    """
    return float(answer)


def find_reference(item: Item, items: Sequence[Item], *, reference: str) -> Item:
    """Find what an item is judged against.

    Parameters
    ----------
    item : Item
        What is judged.
    items : sequence of Item
        All stimuli of its recording.
    reference : str
        `original`, or the name of a reducer.

    Returns
    -------
    Item
        The reference, of the item's level arm if there is one per arm.

    Raises
    ------
    ValueError
        If there is none, or several could be meant.
    """
    if reference == ORIGINAL:
        candidates = [other for other in items if other.role == "reference"]
    else:
        candidates = [other for other in items if other.reducer == reference and other.role == "test"]
    # A set may render its references once, or once per level arm; the arm's own comes first.
    own = [other for other in candidates if other.level == item.level] or candidates
    if len(own) != 1:
        raise ValueError(
            f"recording {item.recording!r}, level {item.level!r}: got {len(own)} stimuli for the reference "
            f"{reference!r}, allowed is exactly one; build the stimulus set with it"
        )
    return own[0]
