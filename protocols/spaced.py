"""The random order: all recordings mixed, none twice in a row, references spread over the whole."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from itertools import groupby, pairwise
from typing import TYPE_CHECKING

from protocols.shuffled import make_generator

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from numpy.random import Generator

    from protocols.section import Groups, Spot
    from protocols.trial import Trial

SPACED = frozenset({"identical", "hidden_reference"})
"""Catch trials that are spaced. Anchors are a third of some rounds: spacing them would let everybody foresee them."""

PATIENCE = 30
"""An order is drawn until it keeps the rules, or until so many draws were no better than the best."""


@dataclass(frozen=True, slots=True)
class _Card:
    recording: str
    index: int
    is_spaced: bool


def order_random(rounds: Sequence[Groups], *, number: int, rng: Generator) -> Iterator[tuple[tuple[Spot, ...], ...]]:
    """Mix all recordings anew for every participant and round.

    Parameters
    ----------
    rounds : sequence of mapping of str to sequence of Comparison
        What is judged of each recording, in each round.
    number : int
        The participant's number, from 1.
    rng : numpy.random.Generator
        Source of randomness, together with the number.

    Yields
    ------
    tuple of tuple of tuple of str and int
        The one block of a round, with the comparisons of all recordings in order.

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
    """Find where a mixed order could not keep its rules.

    Parameters
    ----------
    trials : iterable of Trial
        The trials of one participant, ordered by `order_random`.

    Returns
    -------
    list of str
        Per protocol and rule that was broken, one line on how often; none if all is well.
    """
    found = []
    main = (trial for trial in trials if trial.block)
    for protocol, group in groupby(main, key=lambda trial: trial.protocol):
        pairs = list(pairwise(group))
        if same := sum(this.recording == after.recording for this, after in pairs):
            found.append(f"{protocol}: {same} of {len(pairs) + 1} trials follow one of the same recording")
        if touching := sum({this.catch, after.catch} <= SPACED for this, after in pairs):
            found.append(f"{protocol}: {touching} of {len(pairs) + 1} trials judge the reference right after another")
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
    same = max(2 * count + (recording == after.recording) for recording, count in per_recording.items())
    spaced = 2 * sum(card.is_spaced for card in cards) + after.is_spaced
    return sum(max(0, doubled - 1 - len(cards)) for doubled in (same, spaced))
