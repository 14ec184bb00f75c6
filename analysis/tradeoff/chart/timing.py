"""Times that can be compared: everything is measured in turn, in one run, by a clock that is passed in."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    Clock = Callable[[], float]

FEWEST_ROUNDS = 3
"""Quartiles of fewer are the values themselves."""

FINE_S = 1e-6
"""A clock that moves in longer steps cannot time a short call."""


def choose_clock() -> tuple[str, Clock]:
    """Choose the clock that other programs disturb least.

    Returns
    -------
    name : str
        Of the function in `time`: thread_time counts the processor's time of this thread alone; where it is coarse,
        perf_counter counts all time.
    clock : callable
        Gives seconds.
    """
    fine = time.get_clock_info("thread_time").resolution < FINE_S
    return ("thread_time", time.thread_time) if fine else ("perf_counter", time.perf_counter)


def time_in_turn(
    tasks: Sequence[Callable[[], object]],
    *,
    rounds: int,
    clock: Clock,
    rng: np.random.Generator,
    done: Callable[[], None] | None = None,
) -> NDArray[np.float64]:
    """Time every task once per round, in a new order each round.

    A machine that slows down for a while slows all tasks alike, and none always runs behind the same other one. One
    round goes before, unmeasured, so that caches and plans are warm.

    Parameters
    ----------
    tasks : sequence of callable
        What is timed.
    rounds : int
        Measurements per task, at least 3.
    clock : callable
        Gives seconds.
    rng : numpy.random.Generator
        Source of the orders.
    done : callable, optional
        Called after every round, the unmeasured one included.

    Returns
    -------
    ndarray of float64, shape (rounds, n_tasks)
        Seconds.

    Raises
    ------
    ValueError
        If there are fewer than 3 rounds.

    Examples
    --------
    >>> ticks = iter(range(100))
    >>> time_in_turn([int, int], rounds=3, clock=lambda: next(ticks), rng=np.random.default_rng(0)).tolist()
    [[1.0, 1.0], [1.0, 1.0], [1.0, 1.0]]
    """
    if rounds < FEWEST_ROUNDS:
        raise ValueError(f"rounds: got {rounds}, allowed is {FEWEST_ROUNDS} or more: quartiles need them")
    seconds = np.empty((rounds + 1, len(tasks)))
    for number in range(rounds + 1):
        for which in rng.permutation(len(tasks)):
            begun = clock()
            tasks[which]()
            seconds[number, which] = clock() - begun
        if done is not None:
            done()
    return seconds[1:]
