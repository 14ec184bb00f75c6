"""Rehearsal: training with feedback, and practice, before the trials that count."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from typing import TYPE_CHECKING

from protocols.section import make_sections
from protocols.trial import RATING_RANGE

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from numpy.random import Generator

    from protocols.protocol import Task
    from protocols.section import Section, Spot
    from protocols.trial import Comparison, Item, Trial

TURNS = 2**16
"""So many turns to draw from: more than any trial has arrangements, so that all are about equally likely."""


def make_rehearsal(
    items: Sequence[Item], tasks: Sequence[Task], *, first_number: int, rng: Generator
) -> tuple[Trial, ...]:
    """Choose the trials of training and practice of each task.

    Training takes comparisons whose right answer is known, those for high and for low answers in equal parts
    as far as there are any, and others only when these run out. Practice takes what training left. Both are
    spread over recordings, and neither takes a comparison twice.

    Parameters
    ----------
    items : sequence of Item
        All stimuli of the set.
    tasks : sequence of Task
        The sections of the session, in order, with their numbers of training and practice trials.
    first_number : int
        Number of the first trial.
    rng : numpy.random.Generator
        Source of randomness. What is drawn comes from a child of it: the generator itself does not move on, so
        that an order drawn from it stays what it is.

    Returns
    -------
    tuple of Trial
        Training and practice of the first task, then of the next, numbered on; those of training with a known
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
    spots = [(recording, index) for recording, own in section.groups.items() for index in range(len(own))]
    sides = {(name, index): _find_side(section.groups[name][index]) for name, index in spots}
    unknown = {spot for spot in spots if not sides[spot]}
    training = _choose(spots, section.task.training, late=unknown, sides=sides, rng=rng)
    practice = _choose(spots, section.task.practice, late=set(training), sides={}, rng=rng)
    # Chosen turn about; shuffled, so that nobody can count on a low answer after a high one.
    known_first = sorted(_shuffle(training, rng), key=lambda spot: not sides[spot])
    phases = [("training", spot) for spot in known_first] + [("practice", spot) for spot in _shuffle(practice, rng)]
    for phase, spot in phases:
        yield replace(section.draft_trial(spot, turn=int(rng.integers(TURNS))), phase=phase)


def _find_side(comparison: Comparison) -> str:
    """Tell whether the right answers are high, low or both; empty where none is known."""
    middle = sum(RATING_RANGE) / 2
    known = [judgement.expected for judgement in comparison.judgements if judgement.expected]
    return "+".join(sorted({"high" if sum(expected) / 2 > middle else "low" for expected in known}))


def _choose(
    spots: Sequence[Spot], number: int, *, late: set[Spot], sides: Mapping[Spot, str], rng: Generator
) -> list[Spot]:
    """Choose so many, each time one whose side and recording came up least so far; late ones only after all others."""
    left = _shuffle(spots, rng)
    chosen: list[Spot] = []
    used: Counter[tuple[str, str]] = Counter()
    while left and len(chosen) < number:
        marks = {spot: (("side", sides.get(spot, "")), ("recording", spot[0])) for spot in left}
        best = min(left, key=lambda spot: (spot in late, *(used[mark] for mark in marks[spot])))
        left.remove(best)
        chosen.append(best)
        used.update(marks[best])
    return chosen


def _shuffle(spots: Sequence[Spot], rng: Generator) -> list[Spot]:
    return [spots[i] for i in rng.permutation(len(spots))]
