"""Orders of trials: Williams squares, blocks, random orders, rehearsals, and how balanced the orders of people are."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain, groupby, pairwise
from math import gcd
from typing import TYPE_CHECKING, NamedTuple, TypeVar

from feel321.arguments import Registry, as_rng, check_name, describe
from feel321.protocols.tasks import PROTOCOLS, count_rows, make_task, williams_row
from feel321.protocols.trial import RATING_RANGE, Comparison, Item, Task, Trial, Trials

if TYPE_CHECKING:
    from numpy.random import Generator

    from feel321.types import Rng

    Groups = Mapping[str, Sequence[Comparison]]  # the comparisons of each recording
    Spot = tuple[str, int]  # a comparison, by its recording and its index there
    Row = tuple[int, ...]
    Blocks = tuple[tuple[Spot, ...], ...]
    Ends = tuple[int, int]

Thing = TypeVar("Thing")


@dataclass(frozen=True, slots=True)
class TaskTrials:
    """One task of a session, with the comparisons of its trials and of its training."""

    task: Task
    groups: Groups
    lessons: Groups

    def draft_trial(self, spot: Spot, *, turn: int, phase: str = "main") -> Trial:
        """Make a trial of a comparison, before it has a number, a block and a repeat."""
        recording, index = spot
        task, protocol = self.task, PROTOCOLS[self.task.protocol]
        groups = self.lessons if phase == "training" else self.groups
        turn += index + list(self.groups).index(recording)
        chosen = protocol.arrange(groups[recording][index], turn)
        # Right answers are known on the protocol's own scale only.
        asked = tuple(
            judgement if scale == protocol.name else replace(judgement, expected=None, scale=scale)
            for judgement in chosen.judgements
            for scale in task.scales or (protocol.name,)
        )
        names = (protocol.name, protocol.name, task.timing, recording)
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
            what = f"{task.protocol}: no stimulus of the set is to be judged"
            raise ValueError(f"{what}; build a set with reducers to test")
        lessons = {name: protocol.make_lessons(by_recording[name], task) for name in groups}
        yield TaskTrials(task, groups, lessons)


MIXABLE = 3  # fewest rows in a circle so that none begins with what the one before ended with


def _order_williams(rounds: Sequence[Groups], *, number: int, rng: Generator) -> Iterator[Blocks]:
    """Order recordings, and the comparisons of each, by rows of Williams squares.

    Rows move on by one per round; shuffled, a row never begins with what the row before it ended with, and nobody is
    given one out of turn, so that the balance over participants is exact in every round. Inside a block it also moves
    on by one per recording, and per participant by about as many rows as there are recordings: rows that one
    participant has used come up last for the next, and the positions of reducers are soon near balance.
    """
    sizes = [{len(groups) for groups in rounds}, {len(g) for own in rounds for g in own.values()}]
    # Sorted, so that the same state of the generator always gives the same rows.
    outer, inner = ({n: shuffle_rows(n, rng) for n in sorted(own)} for own in sizes)

    def take_row(n: int, rows: Sequence[int], start: int, *, turn: int, touching: bool) -> Row:
        # Where successive rows touch, two conditions can only come in the same order.
        moves = 0 if touching and len(rows) < MIXABLE else turn
        return williams_row(n, rows[(start + moves) % len(rows)])

    for turn, groups in enumerate(rounds):
        recordings, blocks, n = tuple(groups), [], len(groups)
        for place in take_row(n, outer[n], number, turn=turn, touching=True):
            own = recordings[place]
            size, n_rows = len(groups[own]), len(inner[len(groups[own])])
            # The stride nearest to the rows that were used, of those that reach all going round and round.
            strides = [step for step in range(1, n_rows + 1) if gcd(step, n_rows) == 1]
            away = [min((step - n) % n_rows, (n - step) % n_rows) for step in strides]
            start = place + number * strides[away.index(min(away))]
            row = take_row(size, inner[size], start, turn=turn, touching=n == 1)
            blocks.append(tuple((own, index) for index in row))
        yield tuple(blocks)


def shuffle_rows(n: int, rng: Generator) -> list[int]:
    """Shuffle the numbers of a square's rows so that no row ends with the condition that the next one begins with."""
    rows = [williams_row(n, number) for number in range(count_rows(n))]
    while True:
        order: list[int] = rng.permutation(len(rows)).tolist()
        # About e**-1 of all orders pass for even and e**-2 for odd n, so a few draws do.
        circle = pairwise((*order, order[0]))
        if len(order) < MIXABLE or all(rows[one][-1] != rows[after][0] for one, after in circle):
            return order


def _order_blocked(rounds: Sequence[Groups], *, number: int, rng: Generator) -> Iterator[Blocks]:
    """Shuffle the recordings, and the comparisons of each, anew for every participant and round."""
    own, last = _spawn_participant(rng, number), ("", 0)
    for groups in rounds:
        blocks: list[tuple[Spot, ...]] = []
        for recording in _shuffle_apart(list(groups), after=last[0], rng=own):
            spots = [(recording, index) for index in range(len(groups[recording]))]
            blocks.append(tuple(_shuffle_apart(spots, after=last, rng=own)))
            last = blocks[-1][-1]
        yield tuple(blocks)


def _spawn_participant(rng: Generator, number: int) -> Generator:
    import numpy as np  # not before it is needed: the command line answers at once

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

# Catch trials that are spaced. Anchors are a third of some rounds: spacing them would let everybody foresee them.
SPACED = frozenset({"identical", "hidden_reference"})
PATIENCE = 30  # draws no better than the best, after which an order need not keep the rules


class _Card(NamedTuple):
    recording: str
    place: int
    is_spaced: bool


def _order_random(rounds: Sequence[Groups], *, number: int, rng: Generator) -> Iterator[Blocks]:
    """Mix all recordings anew for every participant and round; rules are broken as rarely as possible."""
    own = _spawn_participant(rng, number)
    last = _Card("", 0, is_spaced=False)
    for groups in rounds:
        cards = [
            _Card(recording, place, comparison.catch in SPACED)
            for recording, comparisons in groups.items()
            for place, comparison in enumerate(comparisons)
        ]
        # What no order can avoid by each rule alone: n things hold at most (n + 1) / 2 of a kind apart.
        counts = Counter(card.recording for card in cards)
        same = max(2 * count + (name == last.recording) for name, count in counts.items())
        spaced = 2 * sum(card.is_spaced for card in cards) + last.is_spaced
        unavoidable = sum(max(0, doubled - 1 - len(cards)) for doubled in (same, spaced))
        best, fewest, in_vain = cards, 3 * len(cards) + 1, 0  # more than any order has
        while fewest > unavoidable and in_vain < PATIENCE:
            other = _draw_order(cards, after=last, rng=own)
            in_vain += 1
            # How often a recording, a spaced trial, and one and the same comparison follow themselves.
            crowding = sum(
                (one.recording == two.recording) + (one.is_spaced and two.is_spaced) + (one == two)
                for one, two in pairwise([last, *other])
            )
            if crowding < fewest:
                best, fewest, in_vain = other, crowding, 0
        last = best[-1]
        yield (tuple((card.recording, card.place) for card in best),)


def _draw_order(cards: Sequence[_Card], *, after: _Card, rng: Generator) -> list[_Card]:
    """Draw an order of a round.

    The round, taken as a circle that is opened anywhere, is cut into as many equal stretches as it has trials in which
    the reference is judged; each gets one, at a place drawn from those that do not touch the last. Other places are
    filled at random from the recordings that did not come just before; one that would be left over takes precedence.
    """
    places: list[int] = []
    n, count = len(cards), sum(card.is_spaced for card in cards)
    for stretch in range(count):
        start, end = stretch * n // count, (stretch + 1) * n // count
        if places:
            start = min(max(start, places[-1] + 2), end - 1)
        if places[:1] == [0] and end == n:
            end = max(end - 1, start + 1)  # the circle's last place touches its first
        places.append(int(rng.integers(start, end)))
    opening = int(rng.integers(n))
    spaced = {(place + opening) % n for place in places}
    left, order = list(cards), [after]
    for place in range(n):
        last = order[-1]
        of_kind = [card for card in left if card.is_spaced == (place in spaced)]
        fresh = [card for card in of_kind if card.recording != last.recording]
        # With more than half of what is left, a recording must come at every other place from here on.
        ((most, times),) = Counter(card.recording for card in left).most_common(1)
        is_urgent = 2 * times > len(left)
        urgent = [card for card in fresh if is_urgent and card.recording == most]
        pool = urgent or fresh or [card for card in of_kind if card != last] or of_kind
        order.append(pool[int(rng.integers(len(pool)))])
        left.remove(order[-1])
    return order[1:]


def find_crowding(trials: Iterable[Trial]) -> Iterator[str]:
    """Find where a random order could not keep its rules."""
    main = (trial for trial in trials if trial.block)
    for protocol, group in groupby(main, key=lambda trial: trial.protocol):
        pairs = list(pairwise(group))
        same = sum(one.recording == after.recording for one, after in pairs)
        touching = sum({one.catch, after.catch} <= SPACED for one, after in pairs)
        if same:
            yield f"{protocol}: {same} of {len(pairs) + 1} trials follow one of the same recording"
        if touching:
            yield f"{protocol}: {touching} of {len(pairs) + 1} trials judge the reference right after another"


ORDERS: Registry[Callable[..., Iterable[Blocks]]] = Registry(
    "order", {"williams": _order_williams, "blocked": _order_blocked, "random": _order_random}
)
"""Name -> order: gives the blocks of each round, of the rounds of a session, the participant's `number` and `rng`."""


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

    Each task is one section of the session, each of its repeats one round, and in orders by blocks each block one
    recording. Positions within a trial move on from participant to participant and from repeat to repeat.

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
        The study's randomness, the same for every participant: squares only balance those who share them. Shuffled
        orders are drawn from it and the number together.

    Returns
    -------
    Trials
        Numbered from 1. In a section, no recording follows itself across blocks or rounds, and where there is only one
        recording, no comparison follows itself across rounds, unless it is alone as well.

    Raises
    ------
    ValueError
        If there is nothing to order, a number or count is below 1, or there is no such order.

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

    All are given equally often, or once more: dealt out like cards, those of a round's last hand come last in the next.
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
        if lacking := count - len(hand):
            fresh = sorted(_shuffle(recordings, rng), key=set(hand).__contains__)
            hand, pile = hand + fresh[:lacking], fresh[lacking:]
    return tuple(item for item in items if item.recording in hand)


TASK_ORDERS = ("fixed", "counterbalanced")  # the same for all participants, or by a Williams square


def arrange_sections(
    trials: Iterable[Trial], tasks: Sequence[Task], *, number: int
) -> tuple[Trials, tuple[Task, ...]]:
    """Order sections, numbered anew, and tasks of participant `number` by successive rows of a Williams square."""
    row = williams_row(len(tasks), (number - 1) % count_rows(len(tasks)))
    places = [tasks[place].protocol for place in row]
    ordered = sorted(trials, key=lambda trial: places.index(trial.protocol))
    blocks = list(dict.fromkeys(trial.block for trial in ordered))
    numbered = (
        replace(trial, number=place, block=blocks.index(trial.block) + 1)
        for place, trial in enumerate(ordered, start=1)
    )
    return Trials(numbered), tuple(tasks[place] for place in row)


TURNS = 2**16  # to draw from: many more than any trial has arrangements


def make_rehearsal(
    items: Sequence[Item], tasks: Sequence[Task], *, first_number: int, rng: Generator
) -> Trials:
    """Choose the trials of training and practice of each task, numbered from `first_number`.

    Training takes comparisons whose right answer is known, and others only when these run out, or when those for high
    or for low answers would be more than half: nobody is to learn that one answer is right for all. Where an answer is
    a choice, training is twice as long. Practice takes what training left. Draws come from a child of `rng`, which does
    not move on, so that an order drawn from it stays what it is.
    """
    (own,) = rng.spawn(1)
    drafts = [one for section in _gather_trials(items, tasks) for one in _rehearse(section, own)]
    return Trials(replace(draft, number=n) for n, draft in enumerate(drafts, start=first_number))


def _rehearse(section: TaskTrials, rng: Generator) -> Iterator[Trial]:
    sides: dict[Spot, str] = {}  # whether the right answer is high or low, where it is one of these
    unclear: set[Spot] = set()  # the right answer is not known, or not obvious to anybody
    spots = [(name, index) for name, own in section.groups.items() for index in range(len(own))]
    lessons = [(name, index) for name, own in section.lessons.items() for index in range(len(own))]
    for spot in lessons:
        comparison = section.lessons[spot[0]][spot[1]]
        known = [judgement.expected for judgement in comparison.judgements if judgement.expected]
        ends = {"high" if sum(expected) > sum(RATING_RANGE) else "low" for expected in known}
        sides[spot] = ends.pop() if len(ends) == 1 else ""
        # A page is no catch trial as a whole.
        if not (comparison.catch or (known and len(comparison.judgements) > 1)):
            unclear.add(spot)
    task = section.task
    count = task.training * (2 if PROTOCOLS[task.protocol].choices else 1)
    training = _choose(lessons, count, late=unclear, sides=sides, rng=rng)
    practice = _choose(spots, task.practice, late=set(training), sides={}, rng=rng)
    # Chosen alternately; shuffled, so that nobody can count on a low answer after a high one.
    clear_first = sorted(_shuffle(training, rng), key=unclear.__contains__)
    for phase, chosen in {"training": clear_first, "practice": _shuffle(practice, rng)}.items():
        for spot in chosen:
            yield section.draft_trial(spot, turn=int(rng.integers(TURNS)), phase=phase)


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
    while left and len(chosen) < number:
        used = Counter(sides.get(spot) for spot in chosen)
        leading = {side for side, count in used.items() if side and 2 * count > len(chosen)}
        recordings = Counter(recording for recording, _ in chosen)
        ranks = [(sides.get(one) in leading, one in late, recordings[one[0]]) for one in left]
        chosen.append(left.pop(ranks.index(min(ranks))))
    return chosen


def measure_balance(groups: Iterable[Sequence[Sequence[str]]]) -> tuple[Ends, Ends]:
    """Find the lowest and the highest count of a condition at a position, and of one right after another.

    groups: the orders of participants who had the same conditions, such as those of each recording.

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
            others[one] = others[one] | conditions if one in others else conditions
        places.update(spot for own in orders for spot in zip(own, range(most), strict=False))
        neighbours.update(pair for own in orders for pair in pairwise(own) if pair[0] != pair[1])
    n_places, n_pairs = sum(longest.values()), sum(len(met) - 1 for met in others.values())
    # What never met is not among the counts, and counts 0.
    at, beside = list(places.values()), list(neighbours.values())
    return (
        (min(at, default=0) if len(at) == n_places else 0, max(at, default=0)),
        (min(beside, default=0) if len(beside) == n_pairs else 0, max(beside, default=0)),
    )
