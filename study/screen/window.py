"""The window that PsychoPy opens. The only module that knows PsychoPy; it is imported when the window is opened."""

from __future__ import annotations

from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator


class Window:
    """A window of PsychoPy."""

    def close(self) -> None:
        """Close the window."""


@contextmanager
def open_screen(
    *,
    clock: Callable[[], float],
    windowed: bool = False,
    size: tuple[int, int] | None = None,
    screen: int = 0,
) -> Iterator[Window]:
    """Open the window that participants look at, and close it whatever happens.

    Parameters
    ----------
    clock : callable
        Gives the time in s since the session began; keys are stamped by it.
    windowed : bool
        A window with a frame instead of the whole screen.
    size : tuple of int, optional
        Width and height of a window, in pixels.
    screen : int
        Which screen, from 0.

    Yields
    ------
    Window
        The window.

    Raises
    ------
    OSError
        If there is no display.
    """
    raise NotImplementedError
    yield Window()
