"""Keys over time: held ones that repeat, digits that become a number, and one that must be pressed twice."""

from __future__ import annotations

from dataclasses import dataclass, field

from protocols.trial import RATING_RANGE

DELAY_S = 0.4
"""How long a key is held before it repeats."""

SPEEDS = ((0.0, 25.0), (1.0, 60.0))
"""Repeats per s, from so many s of repeating on: 100 points take two and a quarter seconds."""

COARSE_SPEEDS = ((0.0, 6.0),)
"""Repeats per s of keys that move far."""

DIGITS_S = 0.8
"""How long a number that could go on waits for its next digit."""

TWICE_S = 1.0
"""Within which time a key counts as pressed twice."""


def count_repeats(held_s: float, speeds: tuple[tuple[float, float], ...] = SPEEDS) -> int:
    """Count how often a key has repeated.

    Parameters
    ----------
    held_s : float
        How long it is held, in s.
    speeds : tuple of tuple of float
        From so many s of repeating on, so many repeats per s.

    Returns
    -------
    int
        The repeats, without the press itself.

    Examples
    --------
    >>> [count_repeats(held_s) for held_s in (0.3, 0.5, 1.4, 2.4)]
    [0, 2, 25, 85]
    """
    since_s = held_s - DELAY_S + 1e-9
    ends = (*(start for start, _ in speeds[1:]), float("inf"))
    parts = zip(speeds, ends, strict=True)
    return int(sum(max(0.0, min(since_s, end) - start) * speed for (start, speed), end in parts))


@dataclass(slots=True)
class Held:
    """The keys that are down, and how often each has repeated."""

    _since_s: dict[str, float] = field(default_factory=dict)
    _given: dict[str, int] = field(default_factory=dict)

    def press(self, key: str, time_s: float) -> None:
        """Take note that a key went down; only the last one repeats.

        Parameters
        ----------
        key : str
            The key.
        time_s : float
            When.
        """
        self.clear()
        self._since_s[key], self._given[key] = time_s, 0

    def release(self, key: str) -> None:
        """Take note that a key went up.

        Parameters
        ----------
        key : str
            The key.
        """
        self._since_s.pop(key, None)

    def clear(self) -> None:
        """Forget all keys."""
        self._since_s.clear()

    def list_due(self, time_s: float, coarse: frozenset[str]) -> list[str]:
        """List the repeats that are due and have not been given.

        Parameters
        ----------
        time_s : float
            Now.
        coarse : frozenset of str
            Keys that move far, which repeat slowly.

        Returns
        -------
        list of str
            Each key as often as it repeated.
        """
        due: list[str] = []
        for key, since_s in self._since_s.items():
            count = count_repeats(time_s - since_s, COARSE_SPEEDS if key in coarse else SPEEDS)
            due += [key] * (count - self._given[key])
            self._given[key] = count
        return due


@dataclass(slots=True)
class Digits:
    """Digits that become a number of points as soon as no other digit can follow, or none has for a while."""

    text: str = field(default="", init=False)
    _time_s: float = field(default=0.0, init=False)

    def type(self, digit: str, time_s: float) -> float | None:
        """Take a digit.

        Parameters
        ----------
        digit : str
            The digit.
        time_s : float
            When.

        Returns
        -------
        float or None
            The number, if no other digit can follow.
        """
        if float(self.text + digit) > RATING_RANGE[1]:
            self.text = ""
        self.text, self._time_s = self.text + digit, time_s
        is_whole = float(self.text) * 10 > RATING_RANGE[1] or self.text == "00"
        return self.take() if is_whole else None

    def take(self) -> float | None:
        """Take the number as it stands.

        Returns
        -------
        float or None
            The number; None if no digit was typed.
        """
        text, self.text = self.text, ""
        return float(text) if text else None

    def take_if_due(self, time_s: float) -> float | None:
        """Take the number if it has waited long enough.

        Parameters
        ----------
        time_s : float
            Now.

        Returns
        -------
        float or None
            The number; None if there is none or it waits.
        """
        return self.take() if time_s - self._time_s >= DIGITS_S else None


@dataclass(slots=True)
class Twice:
    """Something that must be done twice in a short time."""

    _first_s: float | None = None

    def press(self, time_s: float) -> bool:
        """Take note of it.

        Parameters
        ----------
        time_s : float
            When.

        Returns
        -------
        bool
            Whether this was the second time.
        """
        is_second = self.is_armed(time_s)
        self._first_s = None if is_second else time_s
        return is_second

    def is_armed(self, time_s: float) -> bool:
        """Tell whether it was done once, a short time ago.

        Parameters
        ----------
        time_s : float
            Now.

        Returns
        -------
        bool
            Whether once more will do.
        """
        return self._first_s is not None and time_s - self._first_s <= TWICE_S
