"""Orders of trials: Williams squares, blocks, random orders, and rehearsals."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace
from itertools import groupby, pairwise
from math import gcd
from types import MappingProxyType
from typing import TYPE_CHECKING, TypeVar

from feel321.protocols.balance import MIXABLE, shuffle_rows, williams_square
from feel321.protocols.tasks import PROTOCOLS
from feel321.protocols.trial import RATING_RANGE, Trial

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence

    from numpy.random import Generator

    from feel321.protocols.balance import Square
    from feel321.protocols.trial import Comparison, Item, Task

    Groups = Mapping[str, Sequence[Comparison]]
    """What is to be judged of each recording."""
    Spot = tuple[str, int]
    """A comparison, by its recording and its index there."""

# A section of a session: one task, with what is to be judged in it.


@dataclass(frozen=True, slots=True)
class Section:
    """One task of a session, with what is to be judged in it."""

    task: Task
    groups: Groups
    lessons: Groups

    def draft_trial(self, spot: Spot, *, turn: int, phase: str = "main") -> Trial:
        """Make a trial of a comparison, before it has a number, a block and a repeat."""
        recording, index = spot
        protocol = PROTOCOLS[self.task.protocol]
        comparisons = self.lessons if phase == "training" else self.groups
        chosen = protocol.arrange(
            comparisons[recording][index], turn + index + list(self.groups).index(recording)
        )
        return Trial(
            number=0,
            block=0,
            repeat=0,
            protocol=protocol.name,
            scale=protocol.scale,
            timing=self.task.timing,
            recording=recording,
            parts=chosen.parts,
            judgements=chosen.judgements,
            phase=phase,
            catch=chosen.catch,
        )


def make_sections(items: Sequence[Item], tasks: Sequence[Task]) -> tuple[Section, ...]:
    """Let each task say what it judges of the stimuli."""
    for name, things in {"items": items, "tasks": tasks}.items():
        if not things:
            raise ValueError(f"{name}: got none, an order needs at least one")
    by_recording: dict[str, list[Item]] = {}
    for item in items:
        by_recording.setdefault(item.recording, []).append(item)
    return tuple(_make_section(by_recording, task) for task in tasks)


def _make_section(by_recording: Mapping[str, Sequence[Item]], task: Task) -> Section:
    protocol = PROTOCOLS[task.protocol]
    compared = {name: protocol.compare(own, task) for name, own in by_recording.items()}
    if groups := {name: comparisons for name, comparisons in compared.items() if comparisons}:
        return Section(
            task, groups, {name: protocol.teach(by_recording[name], task) for name in groups}
        )
    raise ValueError(
        f"{task.protocol}: got stimuli of which none is to be judged; build a set with reducers to test"
    )


# The order by Williams squares: position and carry-over balance out over participants.


def order_williams(
    rounds: Sequence[Groups], *, number: int, rng: Generator
) -> Iterator[tuple[tuple[Spot, ...], ...]]:
    """Order recordings, and what is judged of each, by rows of Williams squares.

    number: the participant's number, from 1.

    Notes
    -----
    Rows move on by one per round, and they are shuffled so that a row never begins with what the row before
    it ended with: no recording comes twice in a row, and no comparison where there is only one recording.
    Nobody is given a row out of turn for that, so that the balance over participants is exact in every round.

    Inside a block, the row also moves on by one per recording, and per participant by about as many rows as
    there are recordings: rows that this participant has used come up last for the next. So the positions of
    reducers, pooled over recordings, are near balance after a few participants already.
    """
    outer = _draw_squares({len(groups) for groups in rounds}, rng)
    inner = _draw_squares({len(own) for groups in rounds for own in groups.values()}, rng)
    for turn, groups in enumerate(rounds):
        recordings, blocks = tuple(groups), []
        for place in _take_row(outer[len(recordings)], number, turn=turn, touching=True):
            own = recordings[place]
            square = inner[len(groups[own])]
            start = place + number * _find_stride(len(square), len(recordings))
            row = _take_row(square, start, turn=turn, touching=len(recordings) == 1)
            blocks.append(tuple((own, i) for i in row))
        yield tuple(blocks)


def _draw_squares(sizes: set[int], rng: Generator) -> dict[int, Square]:
    # Sorted, so that the same state of the generator always gives the same rows.
    return {size: shuffle_rows(williams_square(size), rng) for size in sorted(sizes)}


def _take_row(square: Square, start: int, *, turn: int, touching: bool) -> tuple[int, ...]:
    """Take the row whose turn it is. Where successive rows touch, two conditions can only come in the same order."""
    moves = 0 if touching and len(square) < MIXABLE else turn
    return square[(start + moves) % len(square)]


def _find_stride(n_rows: int, n_used: int) -> int:
    """Find the step next to `n_used` that reaches all rows, going round and round."""
    steps = (step for step in range(1, n_rows + 1) if gcd(step, n_rows) == 1)
    return min(steps, key=lambda step: min((step - n_used) % n_rows, (n_used - step) % n_rows))


# The blocked order: a participant's own shuffle of recordings, and of what is judged of each.

T = TypeVar("T")


def make_generator(rng: Generator, number: int) -> Generator:
    """Make a participant's own generator.

    number: the participant's number, from 1.
    """
    import numpy as np

    return np.random.default_rng([int(rng.integers(2**63)), number])


def order_blocked(
    rounds: Sequence[Groups], *, number: int, rng: Generator
) -> Iterator[tuple[tuple[Spot, ...], ...]]:
    """Shuffle the recordings, and what is judged of each, anew for every participant and round.

    number: the participant's number, from 1.
    """
    own = make_generator(rng, number)
    last: Spot = ("", 0)
    for groups in rounds:
        blocks = []
        for recording in _shuffle(list(groups), after=last[0], rng=own):
            spots = [(recording, index) for index in range(len(groups[recording]))]
            block = tuple(_shuffle(spots, after=last, rng=own))
            blocks.append(block)
            last = block[-1]
        yield tuple(blocks)


def _shuffle(things: Sequence[T], *, after: T, rng: Generator) -> list[T]:
    """Shuffle so that what came before does not come first; all other orders are equally likely."""
    order = [things[i] for i in rng.permutation(len(things))]
    if order[0] == after and len(order) > 1:
        other = int(rng.integers(1, len(order)))
        order[0], order[other] = order[other], order[0]
    return order


# The random order: all recordings mixed, none twice in a row, references spread over the whole.

SPACED = frozenset({"identical", "hidden_reference"})
"""Catch trials that are spaced. Anchors are a third of some rounds: spacing them would let everybody foresee them."""

PATIENCE = 30
"""An order is drawn until it keeps the rules, or until so many draws were no better than the best."""


@dataclass(frozen=True, slots=True)
class _Card:
    recording: str
    index: int
    is_spaced: bool


def order_random(
    rounds: Sequence[Groups], *, number: int, rng: Generator
) -> Iterator[tuple[tuple[Spot, ...], ...]]:
    """Mix all recordings anew for every participant and round.

    number: the participant's number, from 1.

    Notes
    -----
    A round, taken as a circle, is cut into as many equal stretches as it has trials in which the reference is
    judged. Each stretch gets one, at a place drawn from those that do not touch the last. The circle is opened
    anywhere, so that every place is as likely as any other. Then the places are filled from left to right, at
    random from the recordings that did not come just before; a recording that would be left over takes precedence.

    Where the rules cannot be kept, such as with a single recording, they are broken as rarely as possible,
    for a pilot must be able to run; `find_crowding` says how often.
    """
    own = make_generator(rng, number)
    last = _Card("", 0, is_spaced=False)
    for groups in rounds:
        cards = [
            _Card(recording, index, comparison.catch in SPACED)
            for recording, comparisons in groups.items()
            for index, comparison in enumerate(comparisons)
        ]
        order = _draw_best(cards, after=last, rng=own)
        last = order[-1]
        yield (tuple((card.recording, card.index) for card in order),)


def find_crowding(trials: Iterable[Trial]) -> list[str]:
    """Find where a mixed order could not keep its rules."""
    found = []
    main = (trial for trial in trials if trial.block)
    for protocol, group in groupby(main, key=lambda trial: trial.protocol):
        pairs = list(pairwise(group))
        if same := sum(this.recording == after.recording for this, after in pairs):
            found.append(
                f"{protocol}: {same} of {len(pairs) + 1} trials follow one of the same recording"
            )
        if touching := sum({this.catch, after.catch} <= SPACED for this, after in pairs):
            found.append(
                f"{protocol}: {touching} of {len(pairs) + 1} trials judge the reference right after another"
            )
    return found


def _draw_best(cards: Sequence[_Card], *, after: _Card, rng: Generator) -> list[_Card]:
    unavoidable = _count_unavoidable(cards, after=after)
    best = _draw_order(cards, after=after, rng=rng)
    fewest, in_vain = _count_crowding([after, *best]), 0
    while fewest > unavoidable and in_vain < PATIENCE:
        other = _draw_order(cards, after=after, rng=rng)
        crowding, in_vain = _count_crowding([after, *other]), in_vain + 1
        if crowding < fewest:
            best, fewest, in_vain = other, crowding, 0
    return best


def _draw_order(cards: Sequence[_Card], *, after: _Card, rng: Generator) -> list[_Card]:
    left, order = list(cards), [after]
    spaced_places = _draw_places(sum(card.is_spaced for card in cards), len(cards), rng=rng)
    for place in range(len(cards)):
        pool = _list_choices(left, order[-1], is_spaced=place in spaced_places)
        card = pool[int(rng.integers(len(pool)))]
        left.remove(card)
        order.append(card)
    return order[1:]


def _draw_places(count: int, n: int, *, rng: Generator) -> set[int]:
    """Draw a place of n for each spaced trial: one in each stretch, none next to another if there is room."""
    places: list[int] = []
    for stretch in range(count):
        start, end = stretch * n // count, (stretch + 1) * n // count
        if places:
            start = min(max(start, places[-1] + 2), end - 1)
        if places[:1] == [0] and end == n:
            end = max(end - 1, start + 1)  # the circle's last place touches its first
        places.append(int(rng.integers(start, end)))
    opening = int(rng.integers(n))
    return {(place + opening) % n for place in places}


def _list_choices(left: Sequence[_Card], last: _Card, *, is_spaced: bool) -> list[_Card]:
    """List what may come next, by the strictest rule that leaves anything."""
    of_kind = [card for card in left if card.is_spaced == is_spaced]
    fresh = [card for card in of_kind if card.recording != last.recording]
    ((most, count),) = Counter(card.recording for card in left).most_common(1)
    # With more than half of what is left, a recording must come at every other place from here on.
    urgent = [card for card in fresh if card.recording == most] if count > len(left) // 2 else []
    return urgent or fresh or [card for card in of_kind if card != last] or of_kind


def _count_crowding(order: Iterable[_Card]) -> int:
    """Count how often a recording, a spaced trial and one and the same comparison follow themselves."""
    return sum(
        (this.recording == after.recording) + (this.is_spaced and after.is_spaced) + (this == after)
        for this, after in pairwise(order)
    )


def _count_unavoidable(cards: Sequence[_Card], *, after: _Card) -> int:
    """Count what each rule alone cannot avoid: n things hold at most (n + 1) / 2 of a kind apart."""
    per_recording = Counter(card.recording for card in cards)
    same = max(
        2 * count + (recording == after.recording) for recording, count in per_recording.items()
    )
    spaced = 2 * sum(card.is_spaced for card in cards) + after.is_spaced
    return sum(max(0, doubled - 1 - len(cards)) for doubled in (same, spaced))


# Designs: the main trials of each participant, in an order that balances or shuffles.

ORDERS: Mapping[str, Callable[..., Iterable[tuple[tuple[Spot, ...], ...]]]] = MappingProxyType({
    "williams": order_williams,
    "blocked": order_blocked,
    "random": order_random,
})
"""Name -> order, the only list of names: called with the rounds of a session, `number` and `rng`, it gives the blocks
of each round."""


def make_order(
    items: Sequence[Item],
    tasks: Sequence[Task],
    *,
    number: int,
    repeats: int,
    order: str = "williams",
    rng: Generator,
) -> tuple[Trial, ...]:
    """Order the main trials of one participant.

    Each task is one section of the session, and each of its repeats one round. In orders by blocks, each block
    of a round is one recording. What stands where inside a trial moves on from participant to participant and
    from repeat to repeat.

    Parameters
    ----------
    items : sequence of Item
        All stimuli of the set.
    tasks : sequence of Task
        The sections of the session, in order.
    number : int
        The participant's number, from 1.
    repeats : int
        How often each comparison is judged, at least 1.
    order : str
        A name in `ORDERS`.
    rng : numpy.random.Generator
        The study's randomness. Must stand in the same state for every participant of a study: squares only
        balance over participants who share them. Shuffled orders are the participant's own even so, for they
        are drawn from the generator and the number together.

    Returns
    -------
    tuple of Trial
        Numbered from 1. In a section, no recording follows itself across blocks or rounds, and where there is
        only one recording, no comparison follows itself across rounds, unless it is alone as well.

    Raises
    ------
    ValueError
        If there is nothing to order, a number or count is below 1, or there is no such order.
    """
    _check_choice(order, number=number, repeats=repeats)
    rounds = [
        (section, repeat)
        for section in make_sections(items, tasks)
        for repeat in range(1, repeats + 1)
    ]
    ordered = ORDERS[order]([section.groups for section, _ in rounds], number=number, rng=rng)
    blocks = [
        (*turn, block) for turn, blocks in zip(rounds, ordered, strict=True) for block in blocks
    ]
    drafts = (
        replace(section.draft_trial(spot, turn=number + repeat - 1), block=place, repeat=repeat)
        for place, (section, repeat, block) in enumerate(blocks, start=1)
        for spot in block
    )
    return tuple(replace(draft, number=place) for place, draft in enumerate(drafts, start=1))


def _check_choice(order: str, *, number: int, repeats: int) -> None:
    for name, count in {"number": number, "repeats": repeats}.items():
        if count < 1:
            raise ValueError(f"{name}: got {count}, allowed is a whole number of at least 1")
    if order not in ORDERS:
        raise ValueError(f"order: got {order!r}, allowed: {', '.join(ORDERS)}")


# Rehearsal: training with feedback, and practice, before the trials that count.

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
    return tuple(
        replace(draft, number=number) for number, draft in enumerate(drafts, start=first_number)
    )


def _rehearse(section: Section, rng: Generator) -> Iterator[Trial]:
    lessons = {spot: section.lessons[spot[0]][spot[1]] for spot in _list_spots(section.lessons)}
    unclear = {spot for spot, comparison in lessons.items() if not _is_clear(comparison)}
    sides = {spot: _find_side(comparison) for spot, comparison in lessons.items()}
    training = _choose(
        list(lessons), _count_training(section.task), late=unclear, sides=sides, rng=rng
    )
    practice = _choose(
        _list_spots(section.groups), section.task.practice, late=set(training), sides={}, rng=rng
    )
    # Chosen turn about; shuffled, so that nobody can count on a low answer after a high one.
    clear_first = sorted(_shuffle_rehearsal(training, rng), key=lambda spot: spot in unclear)
    for phase, chosen in {
        "training": clear_first,
        "practice": _shuffle_rehearsal(practice, rng),
    }.items():
        for spot in chosen:
            yield section.draft_trial(spot, turn=int(rng.integers(TURNS)), phase=phase)


def _count_training(task: Task) -> int:
    return task.training * (2 if PROTOCOLS[task.protocol].choices else 1)


def _list_spots(groups: Groups) -> list[Spot]:
    return [(recording, index) for recording, own in groups.items() for index in range(len(own))]


def _is_clear(comparison: Comparison) -> bool:
    """Tell whether the right answer is known, and plain to anybody."""
    is_page = len(comparison.judgements) > 1  # no catch trial as a whole
    return bool(comparison.catch) or (
        is_page and any(judgement.expected for judgement in comparison.judgements)
    )


def _find_side(comparison: Comparison) -> str:
    """Tell whether the right answer is high or low; empty where none is known, or both are asked for."""
    middle = sum(RATING_RANGE) / 2
    known = [judgement.expected for judgement in comparison.judgements if judgement.expected]
    sides = {"high" if sum(expected) / 2 > middle else "low" for expected in known}
    return sides.pop() if len(sides) == 1 else ""


def _choose(
    spots: Sequence[Spot],
    number: int,
    *,
    late: set[Spot],
    sides: Mapping[Spot, str],
    rng: Generator,
) -> list[Spot]:
    """Choose so many: none of a side that leads if there is any other, then none that is late, then by recording."""
    left = _shuffle_rehearsal(spots, rng)
    chosen: list[Spot] = []
    sides_used: Counter[str] = Counter()
    recordings_used: Counter[str] = Counter()
    while left and len(chosen) < number:
        leading = {side for side, count in sides_used.items() if side and 2 * count > len(chosen)}
        best = min(
            left,
            key=lambda spot: (sides.get(spot) in leading, spot in late, recordings_used[spot[0]]),
        )
        left.remove(best)
        chosen.append(best)
        sides_used[sides.get(best, "")] += 1
        recordings_used[best[0]] += 1
    return chosen


def _shuffle_rehearsal(spots: Sequence[Spot], rng: Generator) -> list[Spot]:
    return [spots[i] for i in rng.permutation(len(spots))]
