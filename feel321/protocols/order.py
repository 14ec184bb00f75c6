"""Orders of trials: Williams squares, blocks, random orders, rehearsals, and how balanced the orders of people are."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain, groupby, pairwise
from math import gcd
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

from feel321.doors import Registry, as_rng, check_name, describe
from feel321.protocols.compare import count_rows, williams_row
from feel321.protocols.tasks import PROTOCOLS, make_task
from feel321.protocols.trial import (
    RATING_RANGE,
    Comparison,
    Item,
    Task,
    Trial,
    Trials,
    ask_on_scales,
)

if TYPE_CHECKING:
    from numpy.random import Generator

    from feel321.types import Rng

    Groups = Mapping[str, Sequence[Comparison]]
    """The comparisons of each recording."""
    Spot = tuple[str, int]
    """A comparison, by its recording and its index there."""
    Blocks = tuple[tuple[Spot, ...], ...]

Thing = TypeVar("Thing")


@dataclass(frozen=True, slots=True)
class TaskTrials:
    """One task of a session, with the comparisons of its trials and of its training."""

    task: Task
    groups: Groups
    lessons: Groups
    places: Mapping[str, int]

    def draft_trial(self, spot: Spot, *, turn: int, phase: str = "main") -> Trial:
        """Make a trial of a comparison, before it has a number, a block and a repeat."""
        recording, index = spot
        task, protocol = self.task, PROTOCOLS[self.task.protocol]
        groups = self.lessons if phase == "training" else self.groups
        turn += index + self.places[recording]
        chosen = protocol.arrange(groups[recording][index], turn)
        names = (protocol.name, protocol.scale, task.timing, recording)
        asked = ask_on_scales(chosen.judgements, task.scales, own=protocol.scale)
        return Trial(0, 0, 0, *names, chosen.parts, asked, phase, chosen.catch)


def _gather_trials(items: Sequence[Item], tasks: Sequence[Task]) -> Iterator[TaskTrials]:
    for name, things in {"items": items, "tasks": tasks}.items():
        if not things:
            raise ValueError(f"{name} must be at least one for an order, got none")
    by_recording: dict[str, list[Item]] = {}
    for item in items:
        by_recording.setdefault(item.recording, []).append(item)
    for task in tasks:
        protocol = PROTOCOLS[task.protocol]
        compared = {name: protocol.compare(own, task) for name, own in by_recording.items()}
        groups = {name: comparisons for name, comparisons in compared.items() if comparisons}
        if not groups:
            raise ValueError(
                f"{task.protocol}: no stimulus of the set is to be judged; build a set with reducers to test"
            )
        lessons = {name: protocol.make_lessons(by_recording[name], task) for name in groups}
        places = {name: place for place, name in enumerate(groups)}
        yield TaskTrials(task, groups, lessons, places)


def _order_williams(rounds: Sequence[Groups], *, number: int, rng: Generator) -> Iterator[Blocks]:
    """Order recordings, and the comparisons of each, by rows of Williams squares.

    Rows move on by one per round, and they are shuffled so that a row never begins with what the row before
    it ended with: no recording comes twice in a row, and no comparison where there is only one recording.
    Nobody is given a row out of turn for that, so that the balance over participants is exact in every round.

    Inside a block, the row also moves on by one per recording, and per participant by about as many rows as
    there are recordings: rows that this participant has used come up last for the next. So the positions of
    reducers, pooled over recordings, are near balance after a few participants already.
    """
    sizes = [{len(groups) for groups in rounds}, {len(g) for own in rounds for g in own.values()}]
    # Sorted, so that the same state of the generator always gives the same rows.
    outer, inner = ({n: shuffle_rows(n, rng) for n in sorted(own)} for own in sizes)
    for turn, groups in enumerate(rounds):
        recordings, blocks, n = tuple(groups), [], len(groups)
        for place in _take_row(n, outer[n], number, turn=turn, touching=True):
            own = recordings[place]
            size = len(groups[own])
            start = place + number * _find_stride(len(inner[size]), n)
            row = _take_row(size, inner[size], start, turn=turn, touching=n == 1)
            blocks.append(tuple((own, index) for index in row))
        yield tuple(blocks)


MIXABLE = 3
"""Fewest rows that go in a circle so that none begins with the condition that the one before ended with."""


def _take_row(
    n: int, rows: Sequence[int], start: int, *, turn: int, touching: bool
) -> tuple[int, ...]:
    """Take the row whose turn it is. Where successive rows touch, two conditions can only come in the same order."""
    moves = 0 if touching and len(rows) < MIXABLE else turn
    return williams_row(n, rows[(start + moves) % len(rows)])


def _find_stride(n_rows: int, n_used: int) -> int:
    """Find the step next to `n_used` that reaches all rows, going round and round."""
    steps = (step for step in range(1, n_rows + 1) if gcd(step, n_rows) == 1)
    return min(steps, key=lambda step: min((step - n_used) % n_rows, (n_used - step) % n_rows))


def shuffle_rows(n: int, rng: Generator) -> list[int]:
    """Shuffle the numbers of a square's rows so that no row ends with the condition that the next one begins with."""
    middle = williams_row(n, 0)[-1]
    ends = [(shift, (middle + shift) % n) for shift in range(n)]
    ends += [end[::-1] for end in ends] if count_rows(n) > n else []
    while True:
        order: list[int] = rng.permutation(len(ends)).tolist()
        # About e**-1 of all orders pass for even and e**-2 for odd n, so a few draws do.
        if len(order) < MIXABLE or all(
            ends[this][1] != ends[after][0] for this, after in pairwise((*order, order[0]))
        ):
            return order


def _order_blocked(rounds: Sequence[Groups], *, number: int, rng: Generator) -> Iterator[Blocks]:
    """Shuffle the recordings, and the comparisons of each, anew for every participant and round."""
    own = _spawn_participant(rng, number)
    last: Spot = ("", 0)
    for groups in rounds:
        blocks = []
        for recording in _shuffle_apart(list(groups), after=last[0], rng=own):
            spots = [(recording, index) for index in range(len(groups[recording]))]
            block = tuple(_shuffle_apart(spots, after=last, rng=own))
            blocks.append(block)
            last = block[-1]
        yield tuple(blocks)


def _spawn_participant(rng: Generator, number: int) -> Generator:
    import numpy as np

    return np.random.default_rng([int(rng.integers(2**63)), number])


def _shuffle_apart(things: Sequence[Thing], *, after: Thing, rng: Generator) -> list[Thing]:
    """Shuffle so that `after` does not come first; all other orders are equally likely."""
    order = _shuffle(things, rng)
    if order[0] == after and len(order) > 1:
        other = int(rng.integers(1, len(order)))
        order[0], order[other] = order[other], order[0]
    return order


def _shuffle(things: Sequence[Thing], rng: Generator) -> list[Thing]:
    return [things[i] for i in rng.permutation(len(things))]


# The random order: all recordings mixed, none twice in a row, references spread over the whole.

SPACED = frozenset({"identical", "hidden_reference"})
"""Catch trials that are spaced. Anchors are a third of some rounds: spacing them would let everybody foresee them."""

PATIENCE = 30
"""An order is drawn until it keeps the rules, or until so many draws were no better than the best."""


class _Card(NamedTuple):
    recording: str
    place: int
    is_spaced: bool


def _order_random(rounds: Sequence[Groups], *, number: int, rng: Generator) -> Iterator[Blocks]:
    """Mix all recordings anew for every participant and round.

    A round, taken as a circle, is cut into as many equal stretches as it has trials in which the reference is
    judged. Each stretch gets one, at a place drawn from those that do not touch the last. The circle is opened
    anywhere, so that every place is as likely as any other. Then the places are filled from left to right, at
    random from the recordings that did not come just before; a recording that would be left over takes precedence.

    Where the rules cannot be kept, such as with a single recording, they are broken as rarely as possible,
    for a pilot must be able to run; `find_crowding` says how often.
    """
    own = _spawn_participant(rng, number)
    last = _Card("", 0, is_spaced=False)
    for groups in rounds:
        cards = [
            _Card(recording, place, comparison.catch in SPACED)
            for recording, comparisons in groups.items()
            for place, comparison in enumerate(comparisons)
        ]
        unavoidable = _count_unavoidable(cards, after=last)
        best = _draw_order(cards, after=last, rng=own)
        fewest, in_vain = _count_crowding([last, *best]), 0
        while fewest > unavoidable and in_vain < PATIENCE:
            other = _draw_order(cards, after=last, rng=own)
            crowding, in_vain = _count_crowding([last, *other]), in_vain + 1
            if crowding < fewest:
                best, fewest, in_vain = other, crowding, 0
        last = best[-1]
        yield (tuple((card.recording, card.place) for card in best),)


def find_crowding(trials: Iterable[Trial]) -> list[str]:
    """Find where a random order could not keep its rules."""
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


def _draw_order(cards: Sequence[_Card], *, after: _Card, rng: Generator) -> list[_Card]:
    left, order = list(cards), [after]
    spaced_places = _draw_places(sum(card.is_spaced for card in cards), len(cards), rng=rng)
    for place in range(len(cards)):
        pool = _list_candidates(left, order[-1], is_spaced=place in spaced_places)
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


def _list_candidates(left: Sequence[_Card], last: _Card, *, is_spaced: bool) -> list[_Card]:
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
    """Count what no order can avoid by each rule alone: n things hold at most (n + 1) / 2 of a kind apart."""
    per_recording = Counter(card.recording for card in cards)
    same = max(2 * count + (name == after.recording) for name, count in per_recording.items())
    spaced = 2 * sum(card.is_spaced for card in cards) + after.is_spaced
    return sum(max(0, doubled - 1 - len(cards)) for doubled in (same, spaced))


ORDERS: Registry[Callable[..., Iterable[Blocks]]] = Registry(
    "order", {"williams": _order_williams, "blocked": _order_blocked, "random": _order_random}
)
"""Name -> order, the only list of names: called with the rounds of a session, the participant's `number` from 1 and
`rng`, it gives the blocks of each round."""


def make_order(
    items: Sequence[Item],
    tasks: Sequence[Task | str],
    *,
    number: int,
    repeats: int = 1,
    order: str = "williams",
    rng: Rng = 0,
) -> Trials:
    """Order the main trials of one participant.

    Each task is one section of the session, and each of its repeats one round. In orders by blocks, each block
    of a round is one recording. Positions within a trial move on from participant to participant and from
    repeat to repeat.

    Parameters
    ----------
    items : sequence of Item
        All stimuli of the set.
    tasks : sequence of Task or str
        The sections of the session, in order: tasks, or names of protocols.
    number : int
        The participant's number, from 1.
    repeats : int
        Number of times that each comparison is judged, at least 1.
    order : str
        A name in `ORDERS`.
    rng : int or numpy.random.Generator
        The study's randomness: the same for every participant of a study, for squares only balance over
        participants who share them. Shuffled orders are the participant's own even so: they are drawn from
        the generator and the number together.

    Returns
    -------
    Trials
        Numbered from 1. In a section, no recording follows itself across blocks or rounds, and where there is
        only one recording, no comparison follows itself across rounds, unless it is alone as well.

    Raises
    ------
    ValueError
        If there is nothing to order, a number or count is below 1, or there is no such order.

    Notes
    -----
    Williams squares (`compare.williams_row`): participants 1, 2, ... take successive rows, in which each comparison
    follows each other one equally often.

    Examples
    --------
    >>> from feel321 import protocols
    >>> names = ["sax321", "dft321", "pca321"]
    >>> items = [protocols.Item(f"oak-{name}", "oak", name, "as_is", "test") for name in names]
    >>> trials = protocols.make_order(items, ["realism"], number=1, repeats=2, rng=5)
    >>> trials
    Trials(6 trials of realism)
    """
    for name, count in {"number": number, "repeats": repeats}.items():
        if count < 1:
            raise ValueError(f"{name} must be a whole number from 1, got {count}")
    check_name(order, ORDERS, "order")
    if isinstance(tasks, str | Task):
        raise TypeError(f"tasks must be a list, got {describe(tasks)}; write [{tasks!r}]")
    own = [make_task(task) if isinstance(task, str) else task for task in tasks]
    sections = _gather_trials(items, own)
    rounds = [(section, repeat) for section in sections for repeat in range(1, repeats + 1)]
    groups = [section.groups for section, _ in rounds]
    ordered = ORDERS[order](groups, number=number, rng=as_rng(rng))
    trials: list[Trial] = []
    place = 0
    for (section, repeat), blocks in zip(rounds, ordered, strict=True):
        for block in blocks:
            place += 1
            for spot in block:
                draft = section.draft_trial(spot, turn=number + repeat - 1)
                trials.append(replace(draft, number=len(trials) + 1, block=place, repeat=repeat))
    return Trials(trials)


def select_share(
    items: Sequence[Item], count: int | None, *, number: int, seed: int
) -> tuple[Item, ...]:
    """Select the stimuli of as many recordings as each participant feels, for participant `number` (from 1).

    After any number of participants, the recordings have been given equally often, or once more: shuffled anew, they
    are dealt out like cards, and those that the last hand of a round holds already come last in the next.
    """
    import numpy as np

    recordings = list(dict.fromkeys(item.recording for item in items))
    if count is None or count >= len(recordings):
        return tuple(items)
    rng = np.random.default_rng([seed, count])
    hand: list[str] = []
    pile: list[str] = []
    for _ in range(number):
        hand, pile = pile[:count], pile[count:]
        if (lacking := count - len(hand)) > 0:
            held = set(hand)
            fresh = sorted(_shuffle(recordings, rng), key=held.__contains__)
            hand, pile = hand + fresh[:lacking], fresh[lacking:]
    own = set(hand)
    return tuple(item for item in items if item.recording in own)


TASK_ORDERS = ("fixed", "counterbalanced")
"""Whether all participants have the tasks in the same order, or in those of a Williams square."""


def order_tasks(tasks: Sequence[Task], *, number: int) -> tuple[Task, ...]:
    """Order the tasks of participant `number` (from 1) by successive rows of a Williams square."""
    n = len(tasks)
    return tuple(tasks[place] for place in williams_row(n, (number - 1) % count_rows(n)))


def arrange_sections(trials: Iterable[Trial], tasks: Sequence[Task]) -> Trials:
    """Put the sections of a session into the order of tasks, and number trials and blocks anew.

    What is inside a section stays as it is, so that its balance over participants does not depend on its place.
    """
    places = {task.protocol: place for place, task in enumerate(tasks)}
    ordered = sorted(trials, key=lambda trial: places[trial.protocol])
    blocks = {
        block: place for place, block in enumerate(dict.fromkeys(t.block for t in ordered), 1)
    }
    return Trials(
        replace(trial, number=number, block=blocks[trial.block])
        for number, trial in enumerate(ordered, start=1)
    )


TURNS = 2**16
"""So many turns to draw from: more than any trial has arrangements, so that all are about equally likely."""


def make_rehearsal(
    items: Sequence[Item], tasks: Sequence[Task], *, first_number: int, rng: Generator
) -> Trials:
    """Choose the trials of training and practice of each task, numbered from `first_number`.

    Training takes comparisons whose right answer is known, and others only when these run out, or when those
    for high or for low answers would be more than half: nobody is to learn that one answer is right for all.
    Where an answer is a choice, training is twice as long, for half of the guesses are right. Practice takes what
    training left. Both are spread over recordings, and neither takes a comparison twice.

    Where only one kind of answer is known, as without anchors, training shows that the task is understood at that
    end of the scale; whoever always answers there passes. Anchors in the stimulus set are what prevents it.

    Draws come from a child of `rng`, which does not move on, so that an order drawn from it stays what it is.
    """
    (own,) = rng.spawn(1)
    drafts = (
        draft for section in _gather_trials(items, tasks) for draft in _rehearse(section, own)
    )
    return Trials(replace(draft, number=n) for n, draft in enumerate(drafts, start=first_number))


def _rehearse(section: TaskTrials, rng: Generator) -> Iterator[Trial]:
    lessons = {
        (recording, index): comparison
        for recording, own in section.lessons.items()
        for index, comparison in enumerate(own)
    }
    sides = {spot: _find_side(comparison) for spot, comparison in lessons.items()}
    unclear = {spot for spot, comparison in lessons.items() if not _is_clear(comparison)}
    task = section.task
    count = task.training * (2 if PROTOCOLS[task.protocol].choices else 1)
    training = _choose(list(lessons), count, late=unclear, sides=sides, rng=rng)
    spots = [(name, index) for name, own in section.groups.items() for index in range(len(own))]
    practice = _choose(spots, task.practice, late=set(training), sides={}, rng=rng)
    # Chosen alternately; shuffled, so that nobody can count on a low answer after a high one.
    clear_first = sorted(_shuffle(training, rng), key=lambda spot: spot in unclear)
    for phase, chosen in {"training": clear_first, "practice": _shuffle(practice, rng)}.items():
        for spot in chosen:
            yield section.draft_trial(spot, turn=int(rng.integers(TURNS)), phase=phase)


def _is_clear(comparison: Comparison) -> bool:
    """Check whether the right answer is known, and obvious to anybody; a page is no catch trial as a whole."""
    is_page = len(comparison.judgements) > 1
    return bool(comparison.catch) or (
        is_page and any(judgement.expected for judgement in comparison.judgements)
    )


def _find_side(comparison: Comparison) -> str:
    """Find whether the right answer is high or low; empty where none is known, or both are asked for."""
    known = [judgement.expected for judgement in comparison.judgements if judgement.expected]
    sides = {"high" if sum(expected) > sum(RATING_RANGE) else "low" for expected in known}
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
    left = _shuffle(spots, rng)
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


# How balanced the orders of several participants are.

Ends = tuple[int, int]


def measure_balance(groups: Iterable[Sequence[Sequence[str]]]) -> tuple[Ends, Ends]:
    """Find the lowest and the highest count of a condition at a position, and of one right after another.

    groups: the orders of participants who had the same conditions, such as those of each recording; conditions of
    different groups could not meet. Orders that broke off are shorter.

    Examples
    --------
    >>> measure_balance([["ABDC", "BCAD", "CDBA", "DACB"]])
    ((1, 1), (1, 1))
    """
    places: Counter[tuple[str, int]] = Counter()
    neighbours: Counter[tuple[str, str]] = Counter()
    longest: dict[str, int] = {}
    others: dict[str, frozenset[str]] = {}
    for orders in groups:
        conditions = frozenset(chain.from_iterable(orders))
        most = max(map(len, orders))
        for one in conditions:
            longest[one] = max(longest.get(one, 0), most)
            known = others.get(one)
            others[one] = conditions if known is None else known | conditions
        places.update(spot for own in orders for spot in zip(own, range(most), strict=False))
        neighbours.update(pair for own in orders for pair in pairwise(own) if pair[0] != pair[1])
    n_pairs = sum(len(met) - 1 for met in others.values())
    return _find_ends(places, sum(longest.values())), _find_ends(neighbours, n_pairs)


def _find_ends(counts: Counter[Any], size: int) -> Ends:
    """Find the ends of counts; what never met is not among them, and counts 0."""
    lowest = min(counts.values(), default=0) if len(counts) == size else 0
    return lowest, max(counts.values(), default=0)
