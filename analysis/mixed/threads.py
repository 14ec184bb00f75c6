"""How many threads small matrices may have: one.

With a study's hundred or so levels, two threads spend most of their time waiting for each other: on two busy cores the
same fit took 10 times as long as with one, and 10 times as much work.
"""

from __future__ import annotations

from contextlib import nullcontext
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from contextlib import AbstractContextManager

LARGE = 600
"""Rows of a dense matrix from which two threads are worth their while."""


def hold_threads(size: int) -> AbstractContextManager[object]:
    """Keep linear algebra to one thread while in the context, if matrices are small.

    Parameters
    ----------
    size : int
        Rows of the largest dense matrix.

    Returns
    -------
    AbstractContextManager
        Restores the number of threads at its end.
    """
    from threadpoolctl import threadpool_limits

    return threadpool_limits(1, user_api="blas") if size < LARGE else nullcontext()
