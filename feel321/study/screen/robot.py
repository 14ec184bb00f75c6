"""A simulated participant who presses real keys, through X11's test extension.

What is answered comes from the mind in `participant`, so that the same person gives the same ratings (in whole
points) here as in `feel321 simulate`. What is pressed next follows from what is on the screen alone, one key at a
time: a key that got lost is pressed again, and one too many is taken back.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

from feel321.study.observer.judging import REAL, Experience
from feel321.study.screen.parts import Hand

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from feel321.protocols.trial import Part
    from feel321.stimuli.sets.manifest import Stimulus
    from feel321.study.observer.participant import Participant
    from feel321.study.screen.parts import View

# Pressing the keys of the real keyboard, as far as a program can tell: through X11's test extension.


class Fingers(Protocol):
    """Whatever keys can be pressed on."""

    def press(self, key: str) -> None:
        """Press a key down."""

    def release(self, key: str) -> None:
        """Let a key go."""


class XFingers:
    """The keyboard of an X11 screen."""

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
            raise OSError(
                f"simulated participant: {error}; allowed is an X11 screen, named by DISPLAY"
            ) from None

    def press(self, key: str) -> None:
        """Press a key down."""
        self._send(self._down, key)

    def release(self, key: str) -> None:
        """Let a key go."""
        self._send(self._up, key)

    def close(self) -> None:
        """Leave the screen."""
        self._display.close()

    def _send(self, event: int, key: str) -> None:
        self._display.xtest_fake_input(event, self._display.keysym_to_keycode(self._name_key(key)))
        self._display.sync()


# The hand of a simulated participant: it watches the screen and presses real keys, as people do.

THINKING_S = 0.3
"""How long a screen is looked at before the first key; answers in less than 0.2 s would count as too fast."""

SETTLING_FRAMES = 2
"""Frames after a key was let go until the screen is believed to show what it did."""

COARSE = 10
"""Points by which the coarse keys move a marker."""

REFERENCE_KEY = "0"
"""What feels the reference where every vibration has its digit."""


class PressingHand(Hand):
    """A simulated participant before a real screen.

    clock: gives the time in s.
    """

    def __init__(
        self,
        mind: Participant,
        keyboard: Fingers,
        *,
        stimuli: Mapping[str, Stimulus],
        clock: Callable[[], float],
    ) -> None:
        self._mind, self._keyboard, self._stimuli, self._clock = mind, keyboard, stimuli, clock
        self._scene: tuple[int, str] = (-1, "")
        self._since_s = 0.0
        self._values: Mapping[str, float | str] = {}
        self._experience: Experience | None = None
        self._confirmed: Experience | None = None
        self._held = ""
        self._settling = 0

    def watch(self, view: View) -> None:
        """Look at what is on the screen, and press or let go of a key."""
        self._notice(view)
        if self._held:
            self._keyboard.release(self._held)
            self._held, self._settling = "", SETTLING_FRAMES
        elif self._settling:
            self._settling -= 1
        elif self._clock() - self._since_s >= THINKING_S and (key := self._choose_key(view)):
            self._keyboard.press(key)
            self._held = key

    def _notice(self, view: View) -> None:
        """Notice what has changed: another page or trial, or what is to be done there."""
        if view.screen != self._scene[0]:
            self._experience, self._values = None, {}
            self._mind.before, self._confirmed = self._confirmed or self._mind.before, None
        if (scene := (view.screen, view.state)) != self._scene:
            self._scene, self._since_s = scene, self._clock()

    def _choose_key(self, view: View) -> str:
        match view.state:
            case "reading":
                return (
                    ""
                    if view.left_s
                    else "Return"
                    if view.page is None or view.page.by == "participant"
                    else "F12"
                )
            case "stroking":
                return "Return"
            case "answering":
                return self._go_on(view)
        return ""

    def _go_on(self, view: View) -> str:
        """Feel what was not felt, answer what was not answered, confirm."""
        trial = view.trial
        if trial is None:
            return ""
        if unfelt := [part for part in trial.parts if part.name not in view.felt]:
            self._confirmed = None
            return _name_part_key(view, unfelt[0])
        for judgement in trial.judgements:
            if (key := self._answer(view, judgement.part)) is not None:
                return key
        if trial.phase == "main":
            self._confirmed = self._experience
        return "Return"

    def _answer(self, view: View, part: str) -> str | None:
        """Choose the key that brings an answer nearer, none to wait; None if it stands as it should."""
        value = self._make_up_mind(view)[part]
        if isinstance(value, str):
            return None if view.chosen == value else _name_choice_key(view, value)
        return _find_marker_key(view, part, round(value))

    def _make_up_mind(self, view: View) -> Mapping[str, float | str]:
        if self._experience is None and view.trial is not None and view.scale is not None:
            touch = self._mind.touch
            felt = {part.name: part.stimulus_id for part in view.trial.parts}
            points = {
                name: touch.locate(self._stimuli[code]) if code else REAL
                for name, code in felt.items()
            }
            self._experience = Experience(view.trial, points)
            self._values, _ = self._mind.answer(self._experience, view.scale, view.place)
        return self._values


def _name_part_key(view: View, part: Part) -> str:
    """Name the key that plays a part: its digit where parts are felt at will, elsewhere all are felt again."""
    if view.kind != "rows":
        return "r"
    return part.name if part.name.isdigit() else REFERENCE_KEY


def _name_choice_key(view: View, choice: str) -> str:
    choices = view.scale.choices if view.scale else ()
    return str(choices.index(choice) + 1)


def _find_marker_key(view: View, part: str, target: int) -> str | None:
    """Choose the key that brings a marker nearer to a value; None if it stands there."""
    marker = view.markers.get(part)
    if marker == target and not view.typed:
        return None
    if view.kind == "rows":
        return _find_row_key(view, part) or _find_step_key(marker, target, coarse=("Next", "Prior"))
    # Every other trial by digits, so that both ways are gone.
    if view.trial is not None and view.trial.number % 2:
        return _find_digit_key(view.typed, str(target))
    return _find_step_key(marker, target, coarse=("Down", "Up"))


def _find_row_key(view: View, part: str) -> str:
    """Choose the key that brings the selection nearer to a row."""
    rows = [judgement.part for judgement in view.trial.judgements] if view.trial else []
    if view.selected == part:
        return ""
    return (
        "Up" if view.selected in rows and rows.index(view.selected) > rows.index(part) else "Down"
    )


def _find_step_key(marker: float | None, target: int, *, coarse: tuple[str, str]) -> str:
    if marker is None:
        return "Right"  # Where the first key puts a marker is the screen's business.
    lower, higher = coarse if abs(target - marker) >= COARSE else ("Left", "Right")
    return higher if target > marker else lower


def _find_digit_key(typed: str, text: str) -> str:
    """Choose the next digit; none while those that were typed wait to become a value."""
    return text[len(typed)] if typed != text and text.startswith(typed) else ""
