"""The answer to a trial as it takes shape under the participant's hand."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from protocols.trial import RATING_RANGE
from study.screen.answers import find_points
from study.screen.events import Click, Drag, Press, Release, Unfocused
from study.screen.keyboard import Digits, Held
from study.session.ports import Move

if TYPE_CHECKING:
    from collections.abc import Sequence

    from protocols.trial import Scale, Trial
    from study.screen.events import Event
    from study.screen.shapes import Target

REST_S = 0.25
"""How long a marker stands still before it has come to rest."""

FIRST = 50.0
"""Where the first arrow makes a marker appear. There is none before, so nobody can leave it where it happens to be. An
end would anchor: what lies far from it would be rated too close to it. The middle is as far from one end as from the
other, so its pull favours neither answer, and it is the same for all vibrations. By digit or mouse a marker appears
where it is put."""

FINE, COARSE = 1.0, 10.0

STEPS = {
    "slider": {"left": -FINE, "right": FINE, "up": COARSE, "down": -COARSE, "pageup": COARSE, "pagedown": -COARSE},
    "rows": {"left": -FINE, "right": FINE, "pageup": COARSE, "pagedown": -COARSE},
    "choice": {},
}
"""How far keys move the marker, in points, by kind of screen."""

FAR = frozenset({"up", "down", "pageup", "pagedown"})
"""Keys that move far, or from row to row."""


@dataclass(frozen=True, slots=True)
class Wish:
    """What the participant wants to be done, by key or by mouse.

    Parameters
    ----------
    name : str
        `confirm`, `feel`, `stop`, `pause` or `close`.
    time_s : float
        When.
    part : str
        The part to feel; empty for all.
    """

    name: str
    time_s: float
    part: str = ""


def find_kind(trial: Trial, scale: Scale) -> str:
    """Tell which kind of screen a trial takes.

    Parameters
    ----------
    trial : Trial
        The trial.
    scale : Scale
        What it is answered on.

    Returns
    -------
    str
        One of `study.screen.views.KINDS`.
    """
    if scale.choices:
        return "choice"
    return "rows" if trial.timing == "free" else "slider"


class Markers:
    """The markers of a trial, and which of them have not come to rest."""

    def __init__(self) -> None:
        self.values: dict[str, float] = {}
        self._restless: dict[str, float] = {}

    def put(self, part: str, value: float, time_s: float) -> None:
        """Put a marker somewhere.

        Parameters
        ----------
        part : str
            The part whose marker it is.
        value : float
            Points; the nearest end where they lie beyond it.
        time_s : float
            When.
        """
        low, high = RATING_RANGE
        value = min(max(value, low), high)
        if self.values.get(part) != value:
            # A new mapping for every change: views hold the old one.
            self.values = {**self.values, part: value}
            self._restless[part] = time_s

    def settle(self, time_s: float, *, rest_s: float = REST_S) -> list[Move]:
        """List the markers that came to rest since this was asked last.

        Parameters
        ----------
        time_s : float
            Now.
        rest_s : float
            How long they must have stood still.

        Returns
        -------
        list of Move
            The moves, in order.
        """
        rested = [part for part, moved_s in self._restless.items() if time_s - moved_s >= rest_s]
        return [Move(self._restless.pop(part), part, self.values[part]) for part in rested]


class Desk:
    """Markers and choices of one trial, and what keys and clicks do to them.

    Parameters
    ----------
    trial : Trial
        The trial.
    scale : Scale
        What it is answered on.
    """

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
        """Do what an event asks for, as far as it is about the answer.

        Parameters
        ----------
        event : Event
            What was done.
        target : Target or None
            What lies under the mouse.
        can_answer : bool
            Whether the answer can be changed now.

        Returns
        -------
        Wish or None
            What else the participant wants.
        """
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
                self._set(self._dragged.part, find_points(self._dragged.track, event.x), event.time_s)
            case _:
                pass
        return None

    def tick(self, time_s: float, *, can_answer: bool) -> None:
        """Let time go on: held keys repeat, typed digits become a value.

        Parameters
        ----------
        time_s : float
            Now.
        can_answer : bool
            Whether the answer can be changed now.
        """
        for key in self._held.list_due(time_s, FAR):
            if can_answer:
                self._go(key, time_s)
        self._set(self.selected, self._digits.take_if_due(time_s), time_s)

    def finish_typing(self, time_s: float) -> bool:
        """Turn digits into a value at once.

        Parameters
        ----------
        time_s : float
            Now.

        Returns
        -------
        bool
            Whether there were any.
        """
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
        part = next((part for part in self._parts if part not in self.judged), name) if name == "0" else name
        if part in self.judged:
            self.selected = part
        return Wish("feel", time_s, part)

    def _go(self, key: str, time_s: float) -> None:
        """Move the marker, the row or the choice by one step."""
        if key in STEPS[self.kind]:
            self._digits.take()
            value = self.markers.values.get(self.selected)
            self._set(self.selected, FIRST if value is None else value + STEPS[self.kind][key], time_s)
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
    keys = {"left": choices[0], "right": choices[-1], **{str(n): name for n, name in enumerate(choices, 1)}}
    return key if key in choices else keys.get(key)
