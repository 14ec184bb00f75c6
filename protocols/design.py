"""Designs: the main trials of each participant, in an order that balances or shuffles."""

from __future__ import annotations

from dataclasses import replace
from types import MappingProxyType
from typing import TYPE_CHECKING

from protocols.section import make_sections
from protocols.shuffled import order_blocked
from protocols.spaced import order_random
from protocols.williams import order_williams

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence

    from numpy.random import Generator

    from protocols.protocol import Task
    from protocols.section import Spot
    from protocols.trial import Item, Trial

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
    rounds = [(section, repeat) for section in make_sections(items, tasks) for repeat in range(1, repeats + 1)]
    ordered = ORDERS[order]([section.groups for section, _ in rounds], number=number, rng=rng)
    blocks = [(*turn, block) for turn, blocks in zip(rounds, ordered, strict=True) for block in blocks]
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
