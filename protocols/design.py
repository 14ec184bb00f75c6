"""Orders of trials that balance position and carry-over over participants.

References
----------
.. [1] Williams, E. J. (1949). Experimental designs balanced for the estimation of residual effects of
   treatments. Australian Journal of Scientific Research A, 2, 149-168. doi:10.1071/CH9490149
"""

from __future__ import annotations

from collections import Counter
from itertools import product
from math import lcm
from typing import TYPE_CHECKING

from protocols.trial import Trial

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence

    from numpy.random import Generator

    from protocols.trial import Comparison, Item, Protocol

    Square = tuple[tuple[int, ...], ...]
    Part = dict[str, tuple[Comparison, ...]]


def williams_square(n: int) -> Square:
    """Sequences of n conditions in which each follows each other one equally often.

    Parameters
    ----------
    n : int
        Number of conditions, at least 1.

    Returns
    -------
    tuple of tuple of int
        n sequences for even n, 2 n for odd n. Each condition stands at each place, and each ordered pair
        of conditions stands side by side, once for even n and twice for odd n.

    Raises
    ------
    ValueError
        If n is below 1.

    Notes
    -----
    The first sequence zigzags 0, 1, n-1, 2, n-2, ...; the others add 1 modulo n [1]_. With odd n, the
    zigzag alone favours one direction of each pair, so every sequence is used backwards as well.

    References
    ----------
    .. [1] Williams, E. J. (1949). doi:10.1071/CH9490149

    Examples
    --------
    >>> williams_square(4)
    ((0, 1, 3, 2), (1, 2, 0, 3), (2, 3, 1, 0), (3, 0, 2, 1))
    """
    if n < 1:
        raise ValueError(f"n: got {n}, allowed is a number of conditions of at least 1")
    zigzag = [(place + 1) // 2 if place % 2 else -place // 2 for place in range(n)]
    rows = tuple(tuple((step + shift) % n for step in zigzag) for shift in range(n))
    backwards = tuple(row[::-1] for row in rows) if n % 2 and n > 1 else ()
    return rows + backwards


def make_order(
    items: Sequence[Item], protocols: Sequence[Protocol], *, number: int, repeats: int, rng: Generator
) -> tuple[Trial, ...]:
    """Order all trials of one participant.

    Each protocol is one part of the session. In each of its repeats the recordings come as blocks, in the
    order of a row of a Williams square over recordings; inside a block the comparisons come in the order of
    a row of a Williams square over them. Successive participant numbers take successive rows.

    Parameters
    ----------
    items : sequence of Item
        All stimuli of the set.
    protocols : sequence of Protocol
        The parts of the session, in order.
    number : int
        The participant's number, from 1.
    repeats : int
        How often each comparison is judged, at least 1.
    rng : numpy.random.Generator
        Shuffles the rows of the squares. Must stand in the same state for every participant of a study,
        else the rows that they take do not complete a square.

    Returns
    -------
    tuple of Trial
        Numbered from 1. No stimulus is rated twice in a row, unless there is only one.

    Raises
    ------
    ValueError
        If there is nothing to order, or a number or count is below 1.
    """
    _check_order(items, protocols, number=number, repeats=repeats)
    rounds = list(product(protocols, range(1, repeats + 1)))
    parts = {protocol: _compare_by_recording(items, protocol) for protocol in protocols}
    blocks = _order_blocks(rounds, parts, squares=_shuffle_squares(parts.values(), rng), turn=number)
    judgements = (
        (block, protocol, repeat, pair)
        for block, (protocol, repeat, pairs) in enumerate(blocks, start=1)
        for pair in pairs
    )
    return tuple(
        Trial(place, block, repeat, protocol.name, protocol.scale, pair.stimulus_id, pair.reference_id)
        for place, (block, protocol, repeat, pair) in enumerate(judgements, start=1)
    )


def count_cycle(trials: Sequence[Trial]) -> int:
    """Count the participants over whom an order comes full circle.

    Parameters
    ----------
    trials : sequence of Trial
        The trials of one of them.

    Returns
    -------
    int
        Successive participants, this many or a multiple, take each row of all squares equally often.

    Examples
    --------
    >>> count_cycle([Trial(n, 1, 1, "realism", "realism", f"s{n}") for n in (1, 2, 3)])
    6
    """
    comparisons = Counter(trial.block for trial in trials)
    rounds = Counter((protocol, repeat) for _, protocol, repeat in {(t.block, t.protocol, t.repeat) for t in trials})
    return lcm(*(len(williams_square(size)) for size in {*comparisons.values(), *rounds.values()}))


def _order_blocks(
    rounds: Sequence[tuple[Protocol, int]],
    parts: Mapping[Protocol, Part],
    *,
    squares: Mapping[int, Square],
    turn: int,
) -> Iterator[tuple[Protocol, int, list[Comparison]]]:
    """Yield the blocks of a session: protocol, repeat, and the comparisons of one recording in order."""
    recording, stimulus_id = "", ""
    for this_turn, (protocol, repeat) in enumerate(rounds, start=turn):
        recordings = tuple(parts[protocol])
        for place in _take_row(recordings, squares, turn=this_turn, after=recording):
            recording = recordings[place]
            pairs = parts[protocol][recording]
            # The row moves on from recording to recording, so that nobody meets one fixed order.
            row = _take_row(
                [pair.stimulus_id for pair in pairs], squares, turn=this_turn + place, after=stimulus_id
            )
            stimulus_id = pairs[row[-1]].stimulus_id
            yield protocol, repeat, [pairs[i] for i in row]


def _check_order(items: Sequence[Item], protocols: Sequence[Protocol], *, number: int, repeats: int) -> None:
    for name, count in {"number": number, "repeats": repeats}.items():
        if count < 1:
            raise ValueError(f"{name}: got {count}, allowed is a whole number of at least 1")
    for name, things in {"items": items, "protocols": protocols}.items():
        if not things:
            raise ValueError(f"{name}: got none, an order needs at least one")


def _compare_by_recording(items: Sequence[Item], protocol: Protocol) -> Part:
    by_recording: dict[str, list[Item]] = {}
    for item in items:
        by_recording.setdefault(item.recording, []).append(item)
    return {recording: protocol.compare(own) for recording, own in by_recording.items()}


def _shuffle_squares(parts: Iterable[Part], rng: Generator) -> dict[int, Square]:
    sizes = {len(group) for part in parts for group in (part, *part.values())}
    # Sorted, so that the same state of the generator always gives the same rows.
    squares = {size: williams_square(size) for size in sorted(sizes)}
    return {
        size: tuple(square[i] for i in rng.permutation(len(square))) for size, square in squares.items()
    }


def _take_row(
    conditions: Sequence[str], squares: Mapping[int, Square], *, turn: int, after: str
) -> tuple[int, ...]:
    """Take the row whose turn it is, or the next that does not begin with the condition that came last."""
    square = squares[len(conditions)]
    rows = [square[(turn + shift) % len(square)] for shift in range(len(square))]
    return next((row for row in rows if conditions[row[0]] != after), rows[0])
