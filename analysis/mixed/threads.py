"""How many threads small matrices may have: one.

With a study's hundred or so levels, two threads spend most of their time waiting for each other: on two busy cores the
same fit took 10 times as long as with one, and 10 times as much work.

The limit of a linear algebra library holds for the whole process. Of fits that run at the same time in several threads
one sets it and restores it, the others leave it alone: each on its own would restore what another had set, and the
process would be left at one thread.
"""

from __future__ import annotations

from contextlib import contextmanager
from threading import Lock
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator

LARGE = 600
"""Rows of a dense matrix from which two threads are worth their while."""

HELD = Lock()
"""Taken by whoever set the limit; the process has one limit, and so has this module."""


@contextmanager
def hold_threads(size: int) -> Iterator[None]:
    """Keep linear algebra to one thread while in the context, if matrices are small and nobody else does.

    Parameters
    ----------
    size : int
        Rows of the largest dense matrix.

    Yields
    ------
    None
        Whoever set the limit restores the number of threads at the end.
    """
    from threadpoolctl import threadpool_limits

    if size >= LARGE or not HELD.acquire(blocking=False):
        yield
        return
    try:
        with threadpool_limits(1, user_api="blas"):
            yield
    finally:
        HELD.release()
