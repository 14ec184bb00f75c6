"""Signals that wait for the end of a frame.

Python raises what Ctrl-C means wherever it happens to be: in the middle of a record of the journal, or in a callback
of the window system, where the exception is printed and lost. While a screen is open, the first signal waits until a
frame is over; the second one does what it does elsewhere, at once.
"""

from __future__ import annotations

import signal
import threading
from contextlib import contextmanager
from itertools import count
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

HELD = (signal.SIGINT, signal.SIGTERM)


@contextmanager
def hold_signals() -> Iterator[Callable[[], None]]:
    """Hold Ctrl-C and the request to end until it is asked for them.

    Outside the main thread, which alone is told of signals, nothing is held.

    Yields
    ------
    callable
        Does what the signal that came would have done, if one came.
    """
    if threading.current_thread() is not threading.main_thread():
        yield lambda: None
        return
    before: dict[int, Any] = {number: signal.getsignal(number) for number in HELD if callable(signal.getsignal(number))}
    numbers, waiting = count(), list[int]()

    def hold(number: int, frame: object) -> None:
        if next(numbers) == 0:
            waiting.append(number)
        else:
            before[number](number, frame)

    def heed() -> None:
        if waiting:
            number = waiting.pop()
            before[number](number, None)

    for number in before:
        signal.signal(number, hold)
    try:
        yield heed
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
