"""Pressing the keys of the real keyboard, as far as a program can tell: through X11's test extension."""

from __future__ import annotations

from typing import Protocol


class Fingers(Protocol):
    """Whatever keys can be pressed on."""

    def press(self, key: str) -> None:
        """Press a key down.

        Parameters
        ----------
        key : str
            Its name in X11, such as `Right`, `Return` or `7`.
        """

    def release(self, key: str) -> None:
        """Let a key go.

        Parameters
        ----------
        key : str
            Its name.
        """


class XFingers:
    """The keyboard of an X11 screen.

    Raises
    ------
    OSError
        If there is no such screen.
    """

    def __init__(self) -> None:
        try:
            from Xlib import XK, X
            from Xlib.display import Display
            from Xlib.error import DisplayError
        except ImportError:
            raise OSError(
                "simulated participant: got no python-xlib, allowed is Linux with X11; install: pip install python-xlib"
            ) from None
        self._down, self._up = X.KeyPress, X.KeyRelease
        self._name_key = XK.string_to_keysym
        try:
            self._display = Display()
        except DisplayError as error:
            raise OSError(f"simulated participant: {error}; allowed is an X11 screen, named by DISPLAY") from None

    def press(self, key: str) -> None:
        """Press a key down.

        Parameters
        ----------
        key : str
            Its name in X11.
        """
        self._send(self._down, key)

    def release(self, key: str) -> None:
        """Let a key go.

        Parameters
        ----------
        key : str
            Its name.
        """
        self._send(self._up, key)

    def close(self) -> None:
        """Leave the screen."""
        self._display.close()

    def _send(self, event: int, key: str) -> None:
        self._display.xtest_fake_input(event, self._display.keysym_to_keycode(self._name_key(key)))
        self._display.sync()
