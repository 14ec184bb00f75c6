"""What is on the screen in one frame, and what keys and clicks mean for the answer that stands there."""

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from feel321.protocols.texts import MOST_LETTERS, Question
from feel321.protocols.texts import Answer as QuestionAnswer
from feel321.protocols.trial import RATING_RANGE, Page, Scale, Trial
from feel321.study.keys import PLAY, USUAL, KeysTable, label_key, label_texts
from feel321.study.screen.sheet import Target
from feel321.study.session.ports import Act, Feel, Move, Place

LAST_PAGE = "end"  # the page after which there is nothing
LOOP = "⟳"
MOVES = {"left": -1.0, "right": 1.0, "more": 10.0, "less": -10.0}  # how far, in points
ROW_STEPS = {"up": -1, "down": 1}  # how far actions move the selection, in rows
LISTS = frozenset({"rows", "scales"})  # kinds of screens with more than one slider
FAR = frozenset({"up", "down", "more", "less"})  # actions that move far; their keys repeat slowly


@dataclass(frozen=True, slots=True)
class InputEvent:
    """Something that was done to the window; x, y: pixels from its upper left corner.

    text: letters in key were typed; `backspace` takes one back. closed: it was closed, or is gone. hidden: it is still
    there, but nobody sees what is asked. unfocused: keys go to another window, also the release of those that are down.
    """

    kind: Literal["press", "release", "text", "click", "drag", "closed", "hidden", "unfocused"]
    time_s: float
    key: str = ""
    x: float = 0.0
    y: float = 0.0


class Stop(Act):
    """The participant wants what plays to fall silent."""


@dataclass(frozen=True, slots=True)
class View:
    """What is on the screen in one frame; kind: "page", "slider", "rows" or "scales" of sliders, or "choice"."""

    kind: str
    state: str  # "reading", "feeling" or about to, "stroking" the real surface, "answering"
    screen: int
    place: Place
    page: Page | None = None
    question: Question | None = None
    trial: Trial | None = None
    scale: Scale | None = None
    playing: str = ""
    felt: frozenset[str] = frozenset()  # also a question's name, once it is answered
    markers: Mapping[str, float] = field(default_factory=dict)
    selected: str = ""
    chosen: str = ""
    typed: str = ""
    loops: bool = False
    left_s: int = 0
    notice: str = ""
    picture: Path | None = None
    sample: str = ""

    @property
    def unfelt(self) -> list[str]:
        """The parts of a trial that were not felt to their end."""
        parts = self.trial.parts if self.trial else ()
        return [part.name for part in parts if part.name not in self.felt]

    @property
    def can_answer(self) -> bool:
        """Whether the answer can be changed: once all was felt, or at once where parts are felt at will."""
        is_open = self.state == "answering" or not self.unfelt
        return self.trial is not None and (is_open or self.trial.timing == "free")

    def can_rate(self, part: str) -> bool:
        """Whether a part's own marker can be moved: where each part has one, once it was felt to its end."""
        return self.can_answer and (self.kind != "rows" or part in self.felt)

    @property
    def can_leave(self) -> bool:
        """Whether there is anything to pause or to end: not on the last page."""
        return self.page is None or self.page.key != LAST_PAGE


@dataclass(frozen=True, slots=True)
class ScreenTexts:
    """What participants read besides the scales, in their language."""

    pages: Mapping[str, Mapping[str, str]]  # title and text of each
    refusals: Mapping[str, str]
    prompts: Mapping[str, str]
    parts: Mapping[str, str]
    keys: Mapping[str, str]  # what they do, in words
    own_keys: KeysTable = USUAL
    questions: Mapping[str, str] = field(default_factory=dict)  # words on question pages

    def name_part(self, name: str) -> str:
        """Find the word for a part."""
        return self.parts.get(name, name)


def make_screen_texts(tables: Mapping[str, Any], keys: KeysTable = USUAL) -> ScreenTexts:
    """Pick the screen's texts from those of a language, with the names of the lab's own keys."""
    pages, lines, asked = tables["pages"], tables["keys"], tables["questions"]["prompts"]
    labelled, prompts = label_texts(keys, lines, tables["prompts"])
    labelled["confirm_typed"] = lines["confirm"]  # Enter, whatever key confirms elsewhere
    labelled["loop"] = f"{label_key(keys.loop[0], {})}  {LOOP}"
    refusals = {**tables["refusals"], **asked}
    return ScreenTexts(pages, refusals, prompts, tables["parts"], labelled, keys, asked)


# The answer to a trial while the participant works on it.

DELAY_S = 0.4  # how long a key is held before it repeats
SPEED, LATER_SPEED, FAR_SPEED = 25.0, 60.0, 6.0  # repeats per s: 100 points take 2.25 s
DIGITS_S = 0.8  # how long a number that could go on waits for its next digit
REST_S = 0.25  # how long a marker stands still before it has come to rest

FIRST = 50.0
"""Where the first arrow makes a marker appear; there is none before, so nobody can leave it where it happens to be. An
end would anchor, the middle favours neither answer."""


class Answer:
    """Markers and choices of one trial, and what keys and clicks do to them; typed: digits that are no value yet."""

    def __init__(self, trial: Trial, scale: Scale, keys: KeysTable = USUAL) -> None:
        self.kind = "rows" if trial.timing == "free" else "slider"
        self.kind = "choice" if scale.choices else "scales" if scale.further else self.kind
        self.rated, self.selected = trial.judged, trial.judged[0]
        self.markers: dict[str, float] = {}
        self.chosen = self.typed = ""
        self.felt, self.loops = frozenset[str](), False
        self._parts = [part.name for part in trial.parts]
        self._choices, self._keys = scale.choices, keys
        self._restless: dict[str, float] = {}
        self._held, self._held_s, self._repeats, self._typed_s = "", 0.0, 0, 0.0
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

    def take(self, event: InputEvent, target: Target | None, *, can_answer: bool) -> Feel | None:
        """Do what an event asks for, as far as it is about the answer."""
        match event.kind:
            case "press":
                return self._press(event.key, event.time_s, can_answer=can_answer)
            case "click":
                return self._click(event, target)
            case "drag" if self._dragged and can_answer:
                self._set(self._dragged.part, self._dragged.find_points(event.x), event.time_s)
            case "unfocused":
                self._held = ""
            case "release" if self._held == (self._keys.name_action(event.key) or event.key):
                self._held = ""
        return None

    def tick(self, time_s: float, *, can_answer: bool) -> None:
        """Let time pass: the key that went down last repeats while it is held, typed digits become a value."""
        if self._held:
            since_s = max(0.0, time_s - self._held_s - DELAY_S + 1e-9)
            steady = SPEED * min(since_s, 1.0) + LATER_SPEED * max(since_s - 1.0, 0.0)
            repeats = int(FAR_SPEED * since_s if self._held in FAR else steady)
            before, self._repeats = self._repeats, repeats
            for _ in range(repeats - before if can_answer else 0):
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
        still = [k for k in (*self.rated[after:], *self.rated[:after]) if k not in self.markers]
        self.selected = still[0] if still else self.selected
        return bool(still)

    def _press(self, key: str, time_s: float, *, can_answer: bool) -> Feel | None:
        action = self._keys.name_action(key)
        if action == "again":
            return self._feel(time_s)
        if action == "reference" or action.startswith(PLAY):
            others = ["reference", *(part for part in self._parts if part != "reference")]
            number = int(action.removeprefix(PLAY)) if action.startswith(PLAY) else 0
            return self._feel(time_s, others[number] if number < len(others) else str(number))
        if action == "loop" and self.kind == "rows":
            self.loops = not self.loops
        if can_answer:
            self._held, self._held_s, self._repeats = action or key, time_s, 0
            self._step(action, time_s)
            if self.kind == "choice":
                self.chosen = key if key in self._choices and not action else self.chosen
            elif action == "type_values":
                # The number is a value as soon as no other digit can follow.
                longer, highest = self.typed + key, RATING_RANGE[1]
                self.typed, self._typed_s = key if float(longer) > highest else longer, time_s
                if float(self.typed) * 10 > highest or self.typed == "00":
                    self.finish_typing(time_s)
        return None

    def _click(self, event: InputEvent, target: Target | None) -> Feel | None:
        name, part = (target.name, target.part) if target else ("", "")
        self._dragged = target if name == "mark" else None
        if name in {"feel", "again"}:
            return self._feel(event.time_s, part)
        if name == "choose":
            self.chosen = part
        elif self._dragged:
            self.typed = ""  # What was typed before does not take the marker back.
            self._set(part, self._dragged.find_points(event.x), event.time_s)
        return None

    def _feel(self, time_s: float, part: str = "") -> Feel:
        """Feel one part, and let the keys move its marker if it has one; without one, feel again."""
        if self.kind == "rows" and part in self.rated:
            self.selected = part
        return Feel(time_s, part or (self.selected if self.kind == "rows" else ""))

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
        if self.question.kind == "number":
            with suppress(ValueError):
                return float(text.replace(",", "."))
        return text or None

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
        last, is_number = len(self.question.choices) - 1, self.question.kind == "number"
        if event.kind == "click" and target is not None and target.name == "choose":
            self.chosen = target.part
        elif event.kind == "text" and event.key == BACKSPACE:
            self.typed = self.typed[:-1]
        elif event.kind == "text" and last < 0:
            letters = filter(NUMBER_SIGNS.__contains__ if is_number else str.isprintable, event.key)
            most = MOST_DIGITS if is_number else MOST_LETTERS
            self.typed = (self.typed + "".join(letters))[:most]
        elif event.kind == "press" and last >= 0:
            action = self._keys.name_action(event.key)
            step = {"up": -1, "left": -1, "down": 1, "right": 1}.get(action, 0)
            if action in {"", "type_values"} and event.key.isdigit():
                is_there = 0 < int(event.key) <= last + 1
                self.chosen = str(int(event.key) - 1) if is_there else self.chosen
            elif step:
                place = (0 if step > 0 else last) if not self.chosen else int(self.chosen) + step
                self.chosen = str(min(max(place, 0), last))
