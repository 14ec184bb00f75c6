"""Input: keys, clicks and signals, each with its time, and what they mean on the page shown.

Python raises what Ctrl-C means wherever it happens to be: in the middle of a record of the journal, or in a callback
of the window system, where the exception is printed and lost. While a screen is open, the first signal waits until a
frame is over; the second one does what it does elsewhere, at once.
"""

from __future__ import annotations

import signal
import threading
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import count
from typing import TYPE_CHECKING, Any

from feel321.protocols.trial import RATING_RANGE
from feel321.study.screen.parts import find_points
from feel321.study.session.ports import Move

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from feel321.protocols.trial import Scale, Trial
    from feel321.study.screen.drawing import Target

# What reaches a window: keys by name, clicks in pixels from the top left, its own fate; each with its time.

REPEAT_S = 0.003
"""A key that goes down so soon after it went up never went up: X repeats held keys in this way."""

ALIASES = {"return": "enter", "page_up": "pageup", "page_down": "pagedown"}


@dataclass(frozen=True, slots=True)
class Press:
    """A key went down."""

    key: str
    time_s: float


@dataclass(frozen=True, slots=True)
class Release:
    """A key went up."""

    key: str
    time_s: float


@dataclass(frozen=True, slots=True)
class Click:
    """The mouse's button went down.

    x, y: where, in pixels from the upper left corner.
    """

    x: float
    y: float
    time_s: float


@dataclass(frozen=True, slots=True)
class Drag:
    """The mouse was moved with its button down.

    x, y: where to, in pixels from the upper left corner.
    """

    x: float
    y: float
    time_s: float


@dataclass(frozen=True, slots=True)
class Closed:
    """The window was closed, or is gone."""

    time_s: float


@dataclass(frozen=True, slots=True)
class Hidden:
    """The window was put away: it is still there, but nobody sees what is asked."""

    time_s: float


@dataclass(frozen=True, slots=True)
class Unfocused:
    """Keys go to another window from now on; those that are down are let go there."""

    time_s: float


Event = Press | Release | Click | Drag | Closed | Hidden | Unfocused


def name_key(symbol: str) -> str:
    """Name a key, the same on the main block and on the number block.

    Examples
    --------
    >>> [name_key(symbol) for symbol in ("RETURN", "NUM_7", "_7", "PAGEUP", "NUM_PAGE_UP", "R")]
    ['enter', '7', '7', 'pageup', 'pageup', 'r']
    """
    name = symbol.lower().removeprefix("num_").removeprefix("_")
    return ALIASES.get(name, name)


def drop_repeats(events: list[Event]) -> list[Event]:
    """Leave out the releases and presses that a held key makes up.

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


# Keys over time: held ones that repeat, digits that become a number, and one that must be pressed twice.

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
        """Take note that a key went down; only the last one repeats."""
        self.clear()
        self._since_s[key], self._given[key] = time_s, 0

    def release(self, key: str) -> None:
        """Take note that a key went up."""
        self._since_s.pop(key, None)

    def clear(self) -> None:
        """Forget all keys."""
        self._since_s.clear()

    def list_due(self, time_s: float, coarse: frozenset[str]) -> list[str]:
        """List the repeats that are due and have not been given."""
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
        """Take a digit."""
        if float(self.text + digit) > RATING_RANGE[1]:
            self.text = ""
        self.text, self._time_s = self.text + digit, time_s
        is_whole = float(self.text) * 10 > RATING_RANGE[1] or self.text == "00"
        return self.take() if is_whole else None

    def take(self) -> float | None:
        """Take the number as it stands."""
        text, self.text = self.text, ""
        return float(text) if text else None

    def take_if_due(self, time_s: float) -> float | None:
        """Take the number if it has waited long enough."""
        return self.take() if time_s - self._time_s >= DIGITS_S else None


@dataclass(slots=True)
class Twice:
    """Something that must be done twice in a short time."""

    _first_s: float | None = None

    def press(self, time_s: float) -> bool:
        """Take note of it."""
        is_second = self.is_armed(time_s)
        self._first_s = None if is_second else time_s
        return is_second

    def is_armed(self, time_s: float) -> bool:
        """Tell whether it was done once, a short time ago."""
        return self._first_s is not None and time_s - self._first_s <= TWICE_S


# Signals that wait for the end of a frame.

HELD = (signal.SIGINT, signal.SIGTERM)


@contextmanager
def hold_signals() -> Iterator[Callable[[], None]]:
    """Hold Ctrl-C and the request to end until it is asked for them.

    Outside the main thread, which alone is told of signals, nothing is held.
    """
    if threading.current_thread() is not threading.main_thread():
        yield lambda: None
        return
    before: dict[int, Any] = {
        number: signal.getsignal(number) for number in HELD if callable(signal.getsignal(number))
    }
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


# The answer to a trial as it takes shape under the participant's hand.

REST_S = 0.25
"""How long a marker stands still before it has come to rest."""

FIRST = 50.0
"""Where the first arrow makes a marker appear. There is none before, so nobody can leave it where it happens to be. An
end would anchor: what lies far from it would be rated too close to it. The middle is as far from one end as from the
other, so its pull favours neither answer, and it is the same for all vibrations. By digit or mouse a marker appears
where it is put."""

FINE, COARSE = 1.0, 10.0

STEPS = {
    "slider": {
        "left": -FINE,
        "right": FINE,
        "up": COARSE,
        "down": -COARSE,
        "pageup": COARSE,
        "pagedown": -COARSE,
    },
    "rows": {"left": -FINE, "right": FINE, "pageup": COARSE, "pagedown": -COARSE},
    "choice": {},
}
"""How far keys move the marker, in points, by kind of screen."""

FAR = frozenset({"up", "down", "pageup", "pagedown"})
"""Keys that move far, or from row to row."""


@dataclass(frozen=True, slots=True)
class Wish:
    """What the participant wants to be done, by key or by mouse."""

    name: str
    time_s: float
    part: str = ""


def find_kind(trial: Trial, scale: Scale) -> str:
    """Tell which kind of screen a trial takes."""
    if scale.choices:
        return "choice"
    return "rows" if trial.timing == "free" else "slider"


class Markers:
    """The markers of a trial, and which of them have not come to rest."""

    def __init__(self) -> None:
        self.values: dict[str, float] = {}
        self._restless: dict[str, float] = {}

    def put(self, part: str, value: float, time_s: float) -> None:
        """Put a marker somewhere."""
        low, high = RATING_RANGE
        value = min(max(value, low), high)
        if self.values.get(part) != value:
            # A new mapping for every change: views hold the old one.
            self.values = {**self.values, part: value}
            self._restless[part] = time_s

    def settle(self, time_s: float, *, rest_s: float = REST_S) -> list[Move]:
        """List the markers that came to rest since this was asked last."""
        rested = [part for part, moved_s in self._restless.items() if time_s - moved_s >= rest_s]
        return [Move(self._restless.pop(part), part, self.values[part]) for part in rested]


class Desk:
    """Markers and choices of one trial, and what keys and clicks do to them."""

    def __init__(self, trial: Trial, scale: Scale) -> None:
        self.kind = find_kind(trial, scale)
        self.judged = [judgement.part for judgement in trial.judgements]
        self.markers = Markers()
        self.selected = self.judged[0]
        self.chosen = ""
        self._parts = [part.name for part in trial.parts]
        self._choices = scale.choices
        self._held = Held()
        self._digits = Digits()
        self._dragged: Target | None = None

    @property
    def typed(self) -> str:
        """Digits that have not become a value yet."""
        return self._digits.text

    @property
    def values(self) -> dict[str, float | str]:
        """The answer as it stands, by the part that is judged."""
        if self.kind == "choice":
            return dict.fromkeys(self.judged, self.chosen) if self.chosen else {}
        return dict(self.markers.values)

    def take(self, event: Event, target: Target | None, *, can_answer: bool) -> Wish | None:
        """Do what an event asks for, as far as it is about the answer."""
        match event:
            case Release():
                self._held.release(event.key)
            case Unfocused():
                self._held.clear()
            case Press():
                return self._press(event, can_answer=can_answer)
            case Click():
                return self._click(event, target)
            case Drag() if self._dragged and self._dragged.track and can_answer:
                self._set(
                    self._dragged.part, find_points(self._dragged.track, event.x), event.time_s
                )
            case _:
                pass
        return None

    def tick(self, time_s: float, *, can_answer: bool) -> None:
        """Let time go on: held keys repeat, typed digits become a value."""
        for key in self._held.list_due(time_s, FAR):
            if can_answer:
                self._go(key, time_s)
        self._set(self.selected, self._digits.take_if_due(time_s), time_s)

    def finish_typing(self, time_s: float) -> bool:
        """Turn digits into a value at once."""
        value = self._digits.take()
        self._set(self.selected, value, time_s)
        return value is not None

    def _press(self, press: Press, *, can_answer: bool) -> Wish | None:
        key = press.key
        if self.kind == "rows" and key.isdigit():
            return self._feel_row(key, press.time_s)
        if key == "r":
            return Wish("feel", press.time_s, self.selected if self.kind == "rows" else "")
        if can_answer:
            self._held.press(key, press.time_s)
            self._go(key, press.time_s)
            if self.kind == "slider" and key.isdigit():
                self._set(self.selected, self._digits.type(key, press.time_s), press.time_s)
        return None

    def _click(self, click: Click, target: Target | None) -> Wish | None:
        self._dragged = target if target and target.name == "mark" else None
        if target is None:
            return None
        if target.name == "feel":
            return self._feel_row(target.part, click.time_s)
        if target.name == "again":
            return Wish("feel", click.time_s, self.selected if self.kind == "rows" else "")
        if target.name == "choose":
            self.chosen = target.part
        elif target.track is not None:
            self._digits.take()  # What was typed before does not take the marker back.
            self._set(target.part, find_points(target.track, click.x), click.time_s)
        return None

    def _feel_row(self, name: str, time_s: float) -> Wish:
        """Feel one part, and let the keys move its marker if it has one; 0 is the reference."""
        part = (
            next((part for part in self._parts if part not in self.judged), name)
            if name == "0"
            else name
        )
        if part in self.judged:
            self.selected = part
        return Wish("feel", time_s, part)

    def _go(self, key: str, time_s: float) -> None:
        """Move the marker, the row or the choice by one step."""
        if key in STEPS[self.kind]:
            self._digits.take()
            value = self.markers.values.get(self.selected)
            self._set(
                self.selected, FIRST if value is None else value + STEPS[self.kind][key], time_s
            )
        elif self.kind == "rows" and key in {"up", "down"}:
            place = self.judged.index(self.selected) + (1 if key == "down" else -1)
            self.selected = self.judged[min(max(place, 0), len(self.judged) - 1)]
        elif self.kind == "choice":
            self.chosen = _find_choice(key, self._choices) or self.chosen

    def _set(self, part: str, value: float | None, time_s: float) -> None:
        if part in self.judged and value is not None:
            self.selected = part
            self.markers.put(part, value, time_s)


def _find_choice(key: str, choices: Sequence[str]) -> str | None:
    """Tell what a key chooses: the arrows the first and the last, digits and letters any."""
    keys = {
        "left": choices[0],
        "right": choices[-1],
        **{str(n): name for n, name in enumerate(choices, 1)},
    }
    return key if key in choices else keys.get(key)
