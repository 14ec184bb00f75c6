"""What reaches a window: keys by name, clicks in pixels from the top left, its own fate; each with its time."""

from __future__ import annotations

from dataclasses import dataclass

REPEAT_S = 0.003
"""A key that goes down so soon after it went up never went up: X repeats held keys in this way."""

ALIASES = {"return": "enter", "page_up": "pageup", "page_down": "pagedown"}


@dataclass(frozen=True, slots=True)
class Press:
    """A key went down.

    Parameters
    ----------
    key : str
        Its name, as `name_key` gives it.
    time_s : float
        When.
    """

    key: str
    time_s: float


@dataclass(frozen=True, slots=True)
class Release:
    """A key went up.

    Parameters
    ----------
    key : str
        Its name.
    time_s : float
        When.
    """

    key: str
    time_s: float


@dataclass(frozen=True, slots=True)
class Click:
    """The mouse's button went down.

    Parameters
    ----------
    x, y : float
        Where, in pixels from the upper left corner.
    time_s : float
        When.
    """

    x: float
    y: float
    time_s: float


@dataclass(frozen=True, slots=True)
class Drag:
    """The mouse was moved with its button down.

    Parameters
    ----------
    x, y : float
        Where to, in pixels from the upper left corner.
    time_s : float
        When.
    """

    x: float
    y: float
    time_s: float


@dataclass(frozen=True, slots=True)
class Closed:
    """The window was closed, or is gone.

    Parameters
    ----------
    time_s : float
        When.
    """

    time_s: float


@dataclass(frozen=True, slots=True)
class Hidden:
    """The window was put away: it is still there, but nobody sees what is asked.

    Parameters
    ----------
    time_s : float
        When.
    """

    time_s: float


@dataclass(frozen=True, slots=True)
class Unfocused:
    """Keys go to another window from now on; those that are down are let go there.

    Parameters
    ----------
    time_s : float
        When.
    """

    time_s: float


Event = Press | Release | Click | Drag | Closed | Hidden | Unfocused


def name_key(symbol: str) -> str:
    """Name a key, the same on the main block and on the number block.

    Parameters
    ----------
    symbol : str
        What the window system calls it, in pyglet's spelling.

    Returns
    -------
    str
        Its name.

    Examples
    --------
    >>> [name_key(symbol) for symbol in ("RETURN", "NUM_7", "_7", "PAGEUP", "NUM_PAGE_UP", "R")]
    ['enter', '7', '7', 'pageup', 'pageup', 'r']
    """
    name = symbol.lower().removeprefix("num_").removeprefix("_")
    return ALIASES.get(name, name)


def drop_repeats(events: list[Event]) -> list[Event]:
    """Leave out the releases and presses that a held key makes up.

    Parameters
    ----------
    events : list of Event
        In order.

    Returns
    -------
    list of Event
        What was really done.

    Examples
    --------
    >>> drop_repeats([Release("left", 1.0), Press("left", 1.001), Press("r", 1.002)])
    [Press(key='r', time_s=1.002)]
    """
    kept: list[Event] = []
    for event in events:
        last = kept[-1] if kept else None
        if isinstance(event, Press) and isinstance(last, Release) and _is_repeat(last, event):
            kept.pop()
        else:
            kept.append(event)
    return kept


def _is_repeat(release: Release, press: Press) -> bool:
    return release.key == press.key and press.time_s - release.time_s < REPEAT_S
