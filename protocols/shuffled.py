"""The blocked order: a participant's own shuffle of recordings, and of what is judged of each."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.random import Generator

    from protocols.section import Groups, Spot

T = TypeVar("T")


def make_generator(rng: Generator, number: int) -> Generator:
    """Make a participant's own generator.

    Parameters
    ----------
    rng : numpy.random.Generator
        The study's, in the same state for all participants. It moves on by one draw.
    number : int
        The participant's number, from 1.

    Returns
    -------
    numpy.random.Generator
        Another one for every number, the same one for the same number and state.
    """
    import numpy as np

    return np.random.default_rng([int(rng.integers(2**63)), number])


def order_blocked(rounds: Sequence[Groups], *, number: int, rng: Generator) -> Iterator[tuple[tuple[Spot, ...], ...]]:
    """Shuffle the recordings, and what is judged of each, anew for every participant and round.

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
        The blocks of a round, one per recording, each with its comparisons in order. No recording follows
        itself unless there is only one; then no comparison does, unless that is alone as well.
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
