"""Input: keys, clicks and signals, each with its time, and what they mean on the page shown.

Python raises what Ctrl-C means wherever it happens to be: in the middle of a record of the journal, or in a callback
of the window system, where the exception is printed and lost. While a screen is open, the first signal waits until a
frame is over; the second one does what it does elsewhere, at once.
"""

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import count
from typing import Any, Literal

from feel321.protocols.trial import RATING_RANGE, Scale, Trial
from feel321.study.keys import PLAY, USUAL, KeysTable
from feel321.study.screen.drawing import Target, find_points
from feel321.study.session.ports import Move

FINE, COARSE = 1.0, 10.0

MOVES = {"left": -FINE, "right": FINE, "more": COARSE, "less": -COARSE}
"""How far actions move a marker, in points."""

LISTS = frozenset({"rows", "scales"})  # kinds of screens with more than one slider
ROW_STEPS = {"up": -1, "down": 1}  # how far actions move the selection, in rows
FAR = frozenset({"up", "down", "more", "less"})  # actions that move far; their keys repeat slowly

ALIASES = {
    "return": "enter",
    "page_up": "pageup",
    "page_down": "pagedown",
    "add": "plus",
    "subtract": "minus",
    "divide": "slash",
    "decimal": "period",
}


def name_key(symbol: str) -> str:
    """Name a key, the same on the main block and on the number block."""
    name = symbol.lower().removeprefix("num_").removeprefix("_")
    return ALIASES.get(name, name)


# What reaches a window.

REPEAT_S = 0.003  # shortest time between two presses: X repeats held keys faster


@dataclass(frozen=True, slots=True)
class InputEvent:
    """Something that was done to the window; x, y: pixels from its upper left corner.

    text: letters were typed, which are in key; `backspace` takes one back, again and again while it is held.

    closed: it was closed, or is gone. hidden: it is still there, but nobody sees what is asked. unfocused: keys go to
    another window from now on; those that are down are released there.
    """

    kind: Literal["press", "release", "text", "click", "drag", "closed", "hidden", "unfocused"]
    time_s: float
    key: str = ""
    x: float = 0.0
    y: float = 0.0


def drop_repeats(events: list[InputEvent]) -> list[InputEvent]:
    """Leave out the releases and presses that a held key makes up."""
    kept: list[InputEvent] = []
    for event in events:
        last = kept[-1] if kept else event
        is_pair = (last.kind, event.kind) == ("release", "press") and last.key == event.key
        if is_pair and event.time_s - last.time_s < REPEAT_S:
            kept.pop()
        else:
            kept.append(event)
    return kept


# Keys over time: held ones that repeat, digits that become a number, and one that must be pressed twice.

DELAY_S = 0.4  # how long a key is held before it repeats
SPEEDS = ((0.0, 25.0), (1.0, 60.0))  # repeats per s, from when on: 100 points take 2.25 s
COARSE_SPEEDS = ((0.0, 6.0),)  # repeats per s of keys that move far
DIGITS_S = 0.8  # how long a number that could go on waits for its next digit
TWICE_S = 1.0  # time within which a key counts as pressed twice


def count_repeats(held_s: float, speeds: tuple[tuple[float, float], ...] = SPEEDS) -> int:
    """Count how often a key has repeated."""
    since_s = held_s - DELAY_S + 1e-9
    ends = (*(start for start, _ in speeds[1:]), float("inf"))
    parts = zip(speeds, ends, strict=True)
    return int(sum(max(0.0, min(since_s, end) - start) * speed for (start, speed), end in parts))


@dataclass(slots=True)
class Held:
    """The key that is down, if any, and how often it has repeated; only the last one repeats."""

    _key: str = ""
    _since_s: float = 0.0
    _given: int = 0

    def press(self, key: str, time_s: float) -> None:
        """Take account of a key that went down."""
        self._key, self._since_s, self._given = key, time_s, 0

    def release(self, key: str = "") -> None:
        """Take account of a key that went up, or of all."""
        if key in {self._key, ""}:
            self._key = ""

    def list_due(self, time_s: float, coarse: frozenset[str]) -> list[str]:
        """List the repeats that are due and have not been given."""
        if not self._key:
            return []
        speeds = COARSE_SPEEDS if self._key in coarse else SPEEDS
        before, self._given = self._given, count_repeats(time_s - self._since_s, speeds)
        return [self._key] * (self._given - before)


@dataclass(slots=True)
class Digits:
    """Digits that become a number of points as soon as no other digit can follow, or none has for a while."""

    text: str = field(default="", init=False)
    _time_s: float = field(default=0.0, init=False)

    def type(self, digit: str, time_s: float) -> float | None:
        """Add a digit; returns the number if it is complete."""
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
        """Take account of one time; returns whether it is the second."""
        is_second = self.is_armed(time_s)
        self._first_s = None if is_second else time_s
        return is_second

    def is_armed(self, time_s: float) -> bool:
        """Whether it was done once, a short time ago."""
        return self._first_s is not None and time_s - self._first_s <= TWICE_S


# Signals that wait for the end of a frame.

HELD = (signal.SIGINT, signal.SIGTERM)


@contextmanager
def hold_signals() -> Iterator[Callable[[], None]]:
    """Hold Ctrl-C and the request to end until the function that this gives is called.

    Outside the main thread, which alone receives signals, nothing is held.
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

    def deliver() -> None:
        if waiting:
            number = waiting.pop()
            before[number](number, None)

    for number in before:
        signal.signal(number, hold)
    try:
        yield deliver
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


# The answer to a trial while the participant works on it.

REST_S = 0.25  # how long a marker stands still before it has come to rest

FIRST = 50.0
"""Where the first arrow makes a marker appear. There is none before, so nobody can leave it where it happens to be. An
end would anchor: what lies far from it would be rated too close to it. The middle is as far from one end as from the
other, so its pull favours neither answer, and it is the same for all vibrations. By digit or mouse a marker appears
where it is put."""


@dataclass(frozen=True, slots=True)
class Request:
    """What the participant wants to be done, by key or by mouse."""

    name: str
    time_s: float
    part: str = ""


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
        """List the markers that came to rest since the last call."""
        rested = [part for part, moved_s in self._restless.items() if time_s - moved_s >= rest_s]
        return [Move(self._restless.pop(part), part, self.values[part]) for part in rested]


class Answer:
    """Markers and choices of one trial, and what keys and clicks do to them."""

    def __init__(self, trial: Trial, scale: Scale, keys: KeysTable = USUAL) -> None:
        self.kind = "rows" if trial.timing == "free" else "slider"
        self.kind = "choice" if scale.choices else "scales" if scale.further else self.kind
        self.rated = trial.judged
        self.markers = Markers()
        self.selected = self.rated[0]
        self.chosen = ""
        self.felt: frozenset[str] = frozenset()
        self.loops = False
        self._parts = [part.name for part in trial.parts]
        self._choices, self._keys = scale.choices, keys
        self._held, self._digits = Held(), Digits()
        self._dragged: Target | None = None

    @property
    def typed(self) -> str:
        """Digits that have not become a value yet."""
        return self._digits.text

    @property
    def values(self) -> dict[str, float | str]:
        """The answer as it stands, by the part that is rated."""
        if self.kind == "choice":
            return dict.fromkeys(self.rated, self.chosen) if self.chosen else {}
        return dict(self.markers.values)

    def take(self, event: InputEvent, target: Target | None, *, can_answer: bool) -> Request | None:
        """Do what an event asks for, as far as it is about the answer."""
        match event.kind:
            case "release":
                self._held.release(self._keys.name_action(event.key) or event.key)
            case "unfocused":
                self._held.release()
            case "press":
                return self._press(event, can_answer=can_answer)
            case "click":
                return self._click(event, target)
            case "drag" if self._dragged and self._dragged.track and can_answer:
                value = find_points(self._dragged.track, event.x)
                self._set(self._dragged.part, value, event.time_s)
            case _:
                pass
        return None

    def tick(self, time_s: float, *, can_answer: bool) -> None:
        """Let time pass: held keys repeat, typed digits become a value."""
        for key in self._held.list_due(time_s, FAR):
            if can_answer:
                self._step(key, time_s)
        self._set(self.selected, self._digits.take_if_due(time_s), time_s)

    def finish_typing(self, time_s: float) -> bool:
        """Turn digits into a value at once."""
        value = self._digits.take()
        self._set(self.selected, value, time_s)
        return value is not None

    def go_to_open(self) -> bool:
        """Where a trial has several scales and one of them was answered, go to the next that was not."""
        if self.kind != "scales" or self.selected not in self.markers.values:
            return False
        after = self.rated.index(self.selected)
        order = [*self.rated[after:], *self.rated[:after]]
        still = next((key for key in order if key not in self.markers.values), None)
        self.selected = still or self.selected
        return still is not None

    def _press(self, event: InputEvent, *, can_answer: bool) -> Request | None:
        key, time_s = event.key, event.time_s
        action = self._keys.name_action(key)
        if action == "again":
            return self._feel_again(time_s)
        if action == "reference" or action.startswith(PLAY):
            return self._feel_row(self._find_part(action), time_s)
        if action == "loop" and self.kind == "rows":
            self.loops = not self.loops
        if can_answer:
            self._held.press(action or key, time_s)
            self._step(action, time_s)
            if self.kind == "choice":
                self.chosen = key if key in self._choices and not action else self.chosen
            elif action == "type_values":
                self._set(self.selected, self._digits.type(key, time_s), time_s)
        return None

    def _find_part(self, action: str) -> str:
        """Find the part that an action plays: the reference, or one of the others in their order."""
        others = [part for part in self._parts if part != "reference"]
        number = int(action.removeprefix(PLAY)) if action.startswith(PLAY) else 0
        return others[number - 1] if 0 < number <= len(others) else str(number or action)

    def _click(self, event: InputEvent, target: Target | None) -> Request | None:
        self._dragged = target if target and target.name == "mark" else None
        match target.name if target else "":
            case "feel" if target:
                return self._feel_row(target.part, event.time_s)
            case "again":
                return self._feel_again(event.time_s)
            case "choose" if target:
                self.chosen = target.part
            case "mark" if target and target.track:
                self._digits.take()  # What was typed before does not take the marker back.
                self._set(target.part, find_points(target.track, event.x), event.time_s)
        return None

    def _feel_again(self, time_s: float) -> Request:
        return Request("feel", time_s, self.selected if self.kind == "rows" else "")

    def _feel_row(self, part: str, time_s: float) -> Request:
        """Feel one part, and let the keys move its marker if it has one."""
        if self.kind == "rows" and part in self.rated:
            self.selected = part
        return Request("feel", time_s, part)

    def _step(self, action: str, time_s: float) -> None:
        """Move the marker, the row or the choice by one step."""
        if self.kind == "choice":
            ends = {"left": self._choices[0], "right": self._choices[-1]}
            self.chosen = ends.get(action, self.chosen)
        elif (step := MOVES.get(action)) is not None:
            self._digits.take()
            value = self.markers.values.get(self.selected)
            self._set(self.selected, FIRST if value is None else value + step, time_s)
        elif self.kind in LISTS and action in ROW_STEPS:
            self.finish_typing(time_s)
            place = self.rated.index(self.selected) + ROW_STEPS[action]
            self.selected = self.rated[min(max(place, 0), len(self.rated) - 1)]

    def _set(self, part: str, value: float | None, time_s: float) -> None:
        if part in self.rated and value is not None:
            self.selected = part
            if self.kind != "rows" or part in self.felt:  # no vibration is rated before it was felt
                self.markers.put(part, value, time_s)
