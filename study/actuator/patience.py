"""How long somebody has waited, as far as they were there to see it."""

from __future__ import annotations

from time import perf_counter
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from threading import Thread

GLANCE_S = 0.25
"""So much at most counts between two looks: whoever was away for longer stood still, not what is waited for."""


class Patience:
    """Adds up the time between looks at something that is waited for.

    On a busy machine this process itself may stand still for seconds, and what it waits for could not do anything
    either: a device is not dead because nobody looked.
    """

    def __init__(self) -> None:
        self._looked_s = perf_counter()
        self._waited_s = 0.0

    def look(self) -> float:
        """Look, and tell how long was waited.

        Returns
        -------
        float
            Time in s.
        """
        now_s = perf_counter()
        self._waited_s += min(now_s - self._looked_s, GLANCE_S)
        self._looked_s = now_s
        return self._waited_s


def join(thread: Thread, *, patience_s: float) -> bool:
    """Wait for the end of a thread, as long as this process is there to wait.

    Parameters
    ----------
    thread : Thread
        The thread; it was started.
    patience_s : float
        How long to wait, in s.

    Returns
    -------
    bool
        Whether it has ended.
    """
    for _ in range(max(round(patience_s / GLANCE_S), 1)):
        thread.join(min(GLANCE_S, patience_s))
        if not thread.is_alive():
            return True
    return False
