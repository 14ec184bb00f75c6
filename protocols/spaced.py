"""The random order: all recordings mixed, none twice in a row, catch trials spread over the whole."""

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

DRAWS = 100
"""How often an order is drawn until it keeps the rules; if none does, the one that breaks them least stands."""


@dataclass(frozen=True, slots=True)
class _Card:
    recording: str
    index: int
    is_catch: bool


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
    A round is cut into as many equal stretches as it has catch trials, and each stretch gets one, at a place
    drawn from those that do not touch the last. Then the places are filled from left to right, at random from
    the recordings that did not come just before; a recording that would be left over takes precedence.

    Where the rules cannot be kept, such as with a single recording, they are broken as rarely as possible,
    for a pilot must be able to run; `find_crowding` says how often.
    """
    own = make_generator(rng, number)
    last = _Card("", 0, is_catch=False)
    for groups in rounds:
        cards = [
            _Card(recording, index, bool(comparison.catch))
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
        if catches := sum(bool(this.catch and after.catch) for this, after in pairs):
            found.append(f"{protocol}: {catches} of {len(pairs) + 1} trials are catch trials right after another")
    return found


def _draw_best(cards: Sequence[_Card], *, after: _Card, rng: Generator) -> list[_Card]:
    best = _draw_order(cards, after=after, rng=rng)
    for _ in range(DRAWS - 1):
        if _count_crowding([after, *best]) <= _count_unavoidable(cards, after=after):
            break
        other = _draw_order(cards, after=after, rng=rng)
        best = min(best, other, key=lambda order: _count_crowding([after, *order]))
    return best


def _draw_order(cards: Sequence[_Card], *, after: _Card, rng: Generator) -> list[_Card]:
    left, order = list(cards), [after]
    catch_places = _draw_places(sum(card.is_catch for card in cards), len(cards), after=after, rng=rng)
    for place in range(len(cards)):
        pool = _list_choices(left, order[-1], is_catch=place in catch_places)
        card = pool[int(rng.integers(len(pool)))]
        left.remove(card)
        order.append(card)
    return order[1:]


def _draw_places(count: int, n: int, *, after: _Card, rng: Generator) -> set[int]:
    """Draw a place for each catch trial, one in each stretch of the round and none next to another if there is room."""
    places: set[int] = set()
    last = -1 if after.is_catch else -2
    for stretch in range(count):
        start, end = stretch * n // count, (stretch + 1) * n // count
        start = min(max(start, last + 2), end - 1)
        last = int(rng.integers(start, end))
        places.add(last)
    return places


def _list_choices(left: Sequence[_Card], last: _Card, *, is_catch: bool) -> list[_Card]:
    """List what may come next, by the strictest rule that leaves anything."""
    of_kind = [card for card in left if card.is_catch == is_catch]
    fresh = [card for card in of_kind if card.recording != last.recording]
    ((most, count),) = Counter(card.recording for card in left).most_common(1)
    # With more than half of what is left, a recording must come at every other place from here on.
    urgent = [card for card in fresh if card.recording == most] if count > len(left) // 2 else []
    return urgent or fresh or [card for card in of_kind if card != last] or of_kind


def _count_crowding(order: Iterable[_Card]) -> int:
    """Count how often a recording, a catch trial and one and the same comparison follow themselves."""
    return sum(
        (this.recording == after.recording) + (this.is_catch and after.is_catch) + (this == after)
        for this, after in pairwise(order)
    )


def _count_unavoidable(cards: Sequence[_Card], *, after: _Card) -> int:
    """Count what each rule alone cannot avoid: n things hold at most (n + 1) / 2 of a kind apart."""
    per_recording = Counter(card.recording for card in cards)
    same = max(2 * count + (recording == after.recording) for recording, count in per_recording.items())
    catches = 2 * sum(card.is_catch for card in cards) + after.is_catch
    return sum(max(0, doubled - 1 - len(cards)) for doubled in (same, catches))
