"""Rehearsal: training with feedback, and practice, before the trials that count."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from typing import TYPE_CHECKING

from protocols.registry import PROTOCOLS
from protocols.section import make_sections
from protocols.trial import RATING_RANGE

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from numpy.random import Generator

    from protocols.protocol import Task
    from protocols.section import Groups, Section, Spot
    from protocols.trial import Comparison, Item, Trial

TURNS = 2**16
"""So many turns to draw from: more than any trial has arrangements, so that all are about equally likely."""


def make_rehearsal(
    items: Sequence[Item], tasks: Sequence[Task], *, first_number: int, rng: Generator
) -> tuple[Trial, ...]:
    """Choose the trials of training and practice of each task.

    Training takes comparisons whose right answer is known, and others only when these run out, or when those
    for high or for low answers would be more than half: nobody is to learn that one answer is right for all.
    Practice takes what training left. Both are spread over recordings, and neither takes a comparison twice.

    Where only one kind of answer is known, as without anchors, training shows that the task is understood at that
    end of the scale; whoever always answers there passes. Anchors in the stimulus set are what prevents it.

    Parameters
    ----------
    items : sequence of Item
        All stimuli of the set.
    tasks : sequence of Task
        The sections of the session, in order, with their numbers of training and practice trials. Training has
        twice as many where the answer is a choice, for half of the guesses are right.
    first_number : int
        Number of the first trial.
    rng : numpy.random.Generator
        Source of randomness. What is drawn comes from a child of it: the generator itself does not move on, so
        that an order drawn from it stays what it is.

    Returns
    -------
    tuple of Trial
        Training and practice of the first task, then of the next, numbered on; those of training with a plain
        answer come first. Fewer than asked for where there are fewer comparisons.

    Raises
    ------
    ValueError
        If there is nothing to rehearse.
    """
    (own,) = rng.spawn(1)
    drafts = (draft for section in make_sections(items, tasks) for draft in _rehearse(section, own))
    return tuple(replace(draft, number=number) for number, draft in enumerate(drafts, start=first_number))


def _rehearse(section: Section, rng: Generator) -> Iterator[Trial]:
    lessons = {spot: section.lessons[spot[0]][spot[1]] for spot in _list_spots(section.lessons)}
    unclear = {spot for spot, comparison in lessons.items() if not _is_clear(comparison)}
    sides = {spot: _find_side(comparison) for spot, comparison in lessons.items()}
    training = _choose(list(lessons), _count_training(section.task), late=unclear, sides=sides, rng=rng)
    practice = _choose(_list_spots(section.groups), section.task.practice, late=set(training), sides={}, rng=rng)
    # Chosen turn about; shuffled, so that nobody can count on a low answer after a high one.
    clear_first = sorted(_shuffle(training, rng), key=lambda spot: spot in unclear)
    for phase, chosen in {"training": clear_first, "practice": _shuffle(practice, rng)}.items():
        for spot in chosen:
            yield section.draft_trial(spot, turn=int(rng.integers(TURNS)), phase=phase)


def _count_training(task: Task) -> int:
    return task.training * (2 if PROTOCOLS[task.protocol].choices else 1)


def _list_spots(groups: Groups) -> list[Spot]:
    return [(recording, index) for recording, own in groups.items() for index in range(len(own))]


def _is_clear(comparison: Comparison) -> bool:
    """Tell whether the right answer is known, and plain to anybody."""
    is_page = len(comparison.judgements) > 1  # no catch trial as a whole
    return bool(comparison.catch) or (is_page and any(judgement.expected for judgement in comparison.judgements))


def _find_side(comparison: Comparison) -> str:
    """Tell whether the right answer is high or low; empty where none is known, or both are asked for."""
    middle = sum(RATING_RANGE) / 2
    known = [judgement.expected for judgement in comparison.judgements if judgement.expected]
    sides = {"high" if sum(expected) / 2 > middle else "low" for expected in known}
    return sides.pop() if len(sides) == 1 else ""


def _choose(
    spots: Sequence[Spot], number: int, *, late: set[Spot], sides: Mapping[Spot, str], rng: Generator
) -> list[Spot]:
    """Choose so many: none of a side that leads if there is any other, then none that is late, then by recording."""
    left = _shuffle(spots, rng)
    chosen: list[Spot] = []
    sides_used: Counter[str] = Counter()
    recordings_used: Counter[str] = Counter()
    while left and len(chosen) < number:
        leading = {side for side, count in sides_used.items() if side and 2 * count > len(chosen)}
        best = min(left, key=lambda spot: (sides.get(spot) in leading, spot in late, recordings_used[spot[0]]))
        left.remove(best)
        chosen.append(best)
        sides_used[sides.get(best, "")] += 1
        recordings_used[best[0]] += 1
    return chosen


def _shuffle(spots: Sequence[Spot], rng: Generator) -> list[Spot]:
    return [spots[i] for i in rng.permutation(len(spots))]
