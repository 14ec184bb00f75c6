"""Input: keys, clicks and signals, each with its time, and what they mean for the answer on the screen.

Python raises what Ctrl-C means wherever it happens to be: in the middle of a record of the journal, or in a callback
of the window system, where the exception is printed and lost. While a screen is open, the first signal waits until a
frame is over; the second one does what it does elsewhere, at once.
"""

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import count
from typing import Any, Literal

from feel321.protocols.texts import MOST_LETTERS, Question
from feel321.protocols.texts import Answer as QuestionAnswer
from feel321.protocols.trial import RATING_RANGE, Scale, Trial
from feel321.study.keys import PLAY, USUAL, KeysTable
from feel321.study.screen.sheet import Target
from feel321.study.session.ports import Move

MOVES = {"left": -1.0, "right": 1.0, "more": 10.0, "less": -10.0}
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


@dataclass(frozen=True, slots=True)
class Request:
    """What the participant wants to be done, by key or by mouse."""

    name: str
    time_s: float
    part: str = ""


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

DELAY_S = 0.4  # how long a key is held before it repeats
SPEEDS = ((0.0, 25.0), (1.0, 60.0))  # repeats per s, from when on: 100 points take 2.25 s
COARSE_SPEEDS = ((0.0, 6.0),)  # repeats per s of keys that move far
DIGITS_S = 0.8  # how long a number that could go on waits for its next digit
REST_S = 0.25  # how long a marker stands still before it has come to rest

FIRST = 50.0
"""Where the first arrow makes a marker appear. There is none before, so nobody can leave it where it happens to be. An
end would anchor: what lies far from it would be rated too close to it. The middle is as far from one end as from the
other, so its pull favours neither answer, and it is the same for all vibrations. By digit or mouse a marker appears
where it is put."""


def count_repeats(held_s: float, speeds: tuple[tuple[float, float], ...] = SPEEDS) -> int:
    """Count how often a key has repeated."""
    since_s = held_s - DELAY_S + 1e-9
    ends = (*(start for start, _ in speeds[1:]), float("inf"))
    parts = zip(speeds, ends, strict=True)
    return int(sum(max(0.0, min(since_s, end) - start) * speed for (start, speed), end in parts))


class Answer:
    """Markers and choices of one trial, and what keys and clicks do to them."""

    def __init__(self, trial: Trial, scale: Scale, keys: KeysTable = USUAL) -> None:
        self.kind = "rows" if trial.timing == "free" else "slider"
        self.kind = "choice" if scale.choices else "scales" if scale.further else self.kind
        self.rated = trial.judged
        self.markers: dict[str, float] = {}
        self.selected = self.rated[0]
        self.chosen = ""
        self.typed = ""
        """Digits that have not become a value yet."""
        self.felt: frozenset[str] = frozenset()
        self.loops = False
        self._parts = [part.name for part in trial.parts]
        self._choices, self._keys = scale.choices, keys
        self._restless: dict[str, float] = {}
        self._typed_s = 0.0
        self._held, self._held_s, self._repeats = "", 0.0, 0
        self._dragged: Target | None = None

    @property
    def values(self) -> dict[str, float | str]:
        """The answer as it stands, by the part that is rated."""
        if self.kind == "choice":
            return dict.fromkeys(self.rated, self.chosen) if self.chosen else {}
        return dict(self.markers)

    def settle(self, time_s: float, *, rest_s: float = REST_S) -> list[Move]:
        """List the markers that came to rest since the last call."""
        rested = [part for part, moved_s in self._restless.items() if time_s - moved_s >= rest_s]
        return [Move(self._restless.pop(part), part, self.markers[part]) for part in rested]

    def take(self, event: InputEvent, target: Target | None, *, can_answer: bool) -> Request | None:
        """Do what an event asks for, as far as it is about the answer."""
        match event.kind:
            case "release" if self._held == (self._keys.name_action(event.key) or event.key):
                self._held = ""
            case "unfocused":
                self._held = ""
            case "press":
                return self._press(event, can_answer=can_answer)
            case "click":
                return self._click(event, target)
            case "drag" if self._dragged and can_answer:
                value = self._dragged.find_points(event.x)
                self._set(self._dragged.part, value, event.time_s)
            case _:
                pass
        return None

    def tick(self, time_s: float, *, can_answer: bool) -> None:
        """Let time pass: the key that went down last repeats while it is held, typed digits become a value."""
        if self._held:
            speeds = COARSE_SPEEDS if self._held in FAR else SPEEDS
            before = self._repeats
            self._repeats = count_repeats(time_s - self._held_s, speeds)
            for _ in range(self._repeats - before if can_answer else 0):
                self._step(self._held, time_s)
        if time_s - self._typed_s >= DIGITS_S:
            self.finish_typing(time_s)

    def finish_typing(self, time_s: float) -> bool:
        """Turn digits into a value at once."""
        text, self.typed = self.typed, ""
        if text:
            self._set(self.selected, float(text), time_s)
        return bool(text)

    def go_to_open(self) -> bool:
        """Where a trial has several scales and one of them was answered, go to the next that was not."""
        if self.kind != "scales" or self.selected not in self.markers:
            return False
        after = self.rated.index(self.selected)
        order = [*self.rated[after:], *self.rated[:after]]
        still = next((key for key in order if key not in self.markers), None)
        self.selected = still or self.selected
        return still is not None

    def _press(self, event: InputEvent, *, can_answer: bool) -> Request | None:
        key, time_s = event.key, event.time_s
        action = self._keys.name_action(key)
        if action == "again":
            return self._feel_again(time_s)
        if action == "reference" or action.startswith(PLAY):
            others = [part for part in self._parts if part != "reference"]
            number = int(action.removeprefix(PLAY)) if action.startswith(PLAY) else 0
            known = 0 < number <= len(others)
            return self._feel_row(others[number - 1] if known else str(number or action), time_s)
        if action == "loop" and self.kind == "rows":
            self.loops = not self.loops
        if can_answer:
            self._held, self._held_s, self._repeats = action or key, time_s, 0
            self._step(action, time_s)
            if self.kind == "choice":
                self.chosen = key if key in self._choices and not action else self.chosen
            elif action == "type_values":
                self._type(key, time_s)
        return None

    def _type(self, digit: str, time_s: float) -> None:
        """Add a digit; the number is a value as soon as no other digit can follow."""
        highest = RATING_RANGE[1]
        is_over = float(self.typed + digit) > highest
        self.typed, self._typed_s = digit if is_over else self.typed + digit, time_s
        if float(self.typed) * 10 > highest or self.typed == "00":
            self.finish_typing(time_s)

    def _click(self, event: InputEvent, target: Target | None) -> Request | None:
        self._dragged = target if target and target.name == "mark" else None
        match target.name if target else "":
            case "feel" if target:
                return self._feel_row(target.part, event.time_s)
            case "again":
                return self._feel_again(event.time_s)
            case "choose" if target:
                self.chosen = target.part
            case "mark" if target:
                self.typed = ""  # What was typed before does not take the marker back.
                self._set(target.part, target.find_points(event.x), event.time_s)
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
            self.typed = ""
            value = self.markers.get(self.selected)
            self._set(self.selected, FIRST if value is None else value + step, time_s)
        elif self.kind in LISTS and action in ROW_STEPS:
            self.finish_typing(time_s)
            place = self.rated.index(self.selected) + ROW_STEPS[action]
            self.selected = self.rated[min(max(place, 0), len(self.rated) - 1)]

    def _set(self, part: str, value: float, time_s: float) -> None:
        """Put a marker somewhere; no vibration is rated before it was felt."""
        if part not in self.rated:
            return
        self.selected, (low, high) = part, RATING_RANGE
        value = min(max(value, low), high)
        is_felt = self.kind != "rows" or part in self.felt
        if is_felt and self.markers.get(part) != value:
            # A new mapping for every change: views hold the old one.
            self.markers = {**self.markers, part: value}
            self._restless[part] = time_s


# The answer to a question.

ENTER, BACKSPACE = "enter", "backspace"
NUMBER_SIGNS = frozenset("0123456789.,-")
MOST_DIGITS = 12


class Form:
    """The answer to a question, and what keys and clicks do to it."""

    def __init__(self, question: Question, keys: KeysTable) -> None:
        self.question, self._keys = question, keys
        self.typed, self.chosen = "", ""

    @property
    def answer(self) -> QuestionAnswer:
        """The answer as it stands; None where there is none, text where it is no number yet."""
        if self.question.choices:
            return self.question.choices[int(self.chosen)] if self.chosen else None
        text = self.typed.strip()
        if self.question.kind == "text" or not text:
            return text or None
        try:
            return float(text.replace(",", "."))
        except ValueError:
            return text

    def check(self) -> tuple[str, dict[str, float | str]]:
        """Check the answer: what is wrong with it, and what it is by the name of the question."""
        answer = self.answer
        values = {} if answer is None else {self.question.name: answer}
        return self.question.find_fault(answer), values

    def name_action(self, key: str) -> str:
        """Name what a key does besides answering: where an answer is typed, Enter and keys that write nothing."""
        is_typed = not self.question.choices
        if is_typed and key == ENTER:
            return "next"
        writes = len(key) == 1 or key in {"space", "comma", "period", "minus", "plus", "slash"}
        return "" if is_typed and writes else self._keys.name_action(key)

    def take(self, event: InputEvent, target: Target | None) -> None:
        """Do what an event asks for."""
        is_choice = bool(self.question.choices)
        if event.kind == "click" and target is not None and target.name == "choose":
            self.chosen = target.part
        elif event.kind == "text" and not is_choice:
            self._type(event.key)
        elif event.kind == "press" and is_choice:
            self._choose(event.key)

    def _type(self, letters: str) -> None:
        if letters == BACKSPACE:
            self.typed = self.typed[:-1]
            return
        is_number = self.question.kind == "number"
        allowed = [
            one for one in letters if one.isprintable() and (not is_number or one in NUMBER_SIGNS)
        ]
        most = MOST_DIGITS if is_number else MOST_LETTERS
        self.typed = (self.typed + "".join(allowed))[:most]

    def _choose(self, key: str) -> None:
        last = len(self.question.choices) - 1
        action = self._keys.name_action(key)
        if action in {"", "type_values"}:
            if key.isdigit() and 0 < int(key) <= last + 1:
                self.chosen = str(int(key) - 1)
        elif (step := {"up": -1, "left": -1, "down": 1, "right": 1}.get(action)) is not None:
            place = (0 if step > 0 else last) if not self.chosen else int(self.chosen) + step
            self.chosen = str(min(max(place, 0), last))
