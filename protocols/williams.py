"""The order by Williams squares: position and carry-over balance out over participants."""

from __future__ import annotations

from math import gcd
from typing import TYPE_CHECKING

from protocols.square import MIXABLE, shuffle_rows, williams_square

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.random import Generator

    from protocols.section import Groups, Spot
    from protocols.square import Square


def order_williams(rounds: Sequence[Groups], *, number: int, rng: Generator) -> Iterator[tuple[tuple[Spot, ...], ...]]:
    """Order recordings, and what is judged of each, by rows of Williams squares.

    Parameters
    ----------
    rounds : sequence of mapping of str to sequence of Comparison
        What is judged of each recording, in each round.
    number : int
        The participant's number, from 1.
    rng : numpy.random.Generator
        Shuffles the rows of the squares. Must stand in the same state for every participant of a study,
        else the rows that they take do not complete a square.

    Yields
    ------
    tuple of tuple of tuple of str and int
        The blocks of a round, one per recording, each with its comparisons in order.

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
