"""A simulated participant who presses real keys, through X11's test extension.

The answers come from the participant of `observer`, so that the same person gives the same ratings (in whole points)
here as in `feel321 simulate`. The next key follows from what is on the screen alone, one key at a time: a key that got
lost is pressed again, and one too many is taken back.
"""

from collections.abc import Callable, Mapping
from math import copysign

from feel321.protocols.texts import Question
from feel321.protocols.trial import MATCHING, Part, Trial
from feel321.stimuli.sets.manifest import Stimulus
from feel321.study.keys import KEY_NAMES, PLAY, USUAL, KeysTable
from feel321.study.observer.model import Experience
from feel321.study.observer.simulated import Participant, feel_level
from feel321.study.screen.input import ENTER, LISTS, MOVES, Hand, View
from feel321.study.session.ports import Felt, Scaled, Tone

KEYSYMS = {name: name for name in KEY_NAMES[-10:]} | {
    "enter": "Return", "pageup": "Prior", "pagedown": "Next", "backspace": "BackSpace",
}  # fmt: skip
"""X11's names of keys, where they are not ours, beginning with a capital."""


class XKeyboard:
    """The keyboard of an X11 screen, through X11's test extension."""

    def __init__(self) -> None:
        try:
            from Xlib import XK, X
            from Xlib.display import Display
            from Xlib.error import DisplayError
        except ImportError:
            raise OSError(
                "simulated participant: python-xlib not found, which works on Linux with X11; install it: "
                "pip install python-xlib"
            ) from None
        self._events, self._find_keysym = (X.KeyRelease, X.KeyPress), XK.string_to_keysym
        try:
            self._display = Display()
        except DisplayError as error:
            raise OSError(
                f"simulated participant: {error}; set DISPLAY to the name of an X11 screen"
            ) from None

    def press(self, key: str, *, is_down: bool = True) -> None:
        """Press a key down, or release it."""
        name = KEYSYMS.get(key, key.capitalize() if len(key) > 1 else key)
        code = self._display.keysym_to_keycode(self._find_keysym(name))
        self._display.xtest_fake_input(self._events[is_down], code)
        self._display.sync()

    def close(self) -> None:
        """Leave the screen."""
        self._display.close()


RETRY_S, RETRIES = 2.0, 15  # pause before a failed device is tried again, and how often that is
THINKING_S = 0.3  # before the first key; answers in less than 0.2 s would count as too fast
SETTLING_FRAMES = 2  # frames after a key was released until the screen shows what it did


class PressingHand(Hand):
    """A simulated participant before a real screen; clock: gives the time in s."""

    def __init__(
        self,
        mind: Participant,
        keyboard: XKeyboard,
        *,
        stimuli: Mapping[str, Stimulus],
        clock: Callable[[], float],
        keys: KeysTable = USUAL,
    ) -> None:
        self._mind, self._keyboard, self._stimuli = mind, keyboard, stimuli
        self._clock, self._keys = clock, keys
        self._task, self._since_s = (-1, ""), 0.0
        self._values: Mapping[str, float | str] = {}
        self._tones: dict[str, Tone] = {}
        self._levels_db: dict[str, float] = {}
        self._seen: Mapping[str, float] = {}
        self._felt: Mapping[str, float] = {}
        self._held, self._settling, self._retries = "", 0, 0

    def watch(self, view: View) -> None:
        """Look at what is on the screen, and press or release a key."""
        self._seen = view.markers
        if view.screen != self._task[0]:
            self._values, self._tones, self._levels_db = {}, {}, {}
        if (task := (view.screen, view.state)) != self._task:
            self._task, self._since_s = task, self._clock()
        wait_s = RETRY_S if view.page is not None and view.page.key == "call_us" else THINKING_S
        if self._held:
            self._keyboard.press(self._held, is_down=False)
            self._held, self._settling = "", SETTLING_FRAMES
        elif self._settling:
            self._settling -= 1
        elif self._clock() - self._since_s >= wait_s and (act := self._choose_act(view)):
            self._held = self._keys.find_key(act) or act  # letters are typed as they are
            self._keyboard.press(self._held)

    def feel(self, part: Part, stimulus: Felt) -> None:
        """Feel a tone or a level; what stimuli of a set feel like is known to the participant by their names."""
        self._felt = self._seen
        if isinstance(stimulus, Tone):
            self._tones[part.name] = stimulus
        elif isinstance(stimulus, Scaled):
            self._levels_db.setdefault(part.name, feel_level(stimulus))

    def _choose_act(self, view: View) -> str:
        """Choose what to do with the next key: an action, or a letter to type; empty to wait."""
        if view.question is not None:
            return self._answer_question(view, view.question)
        if view.state == "reading" and view.page is not None and not view.left_s:
            if view.page.key == "call_us":
                self._retries += 1
                return "pause" if self._retries > RETRIES else "experimenter"
            return "experimenter" if view.page.by == "experimenter" else "next"
        if view.state == "answering" and view.trial is not None:
            return self._answer(view, view.trial)
        return "next" if view.state == "stroking" else ""

    def _answer_question(self, view: View, question: Question) -> str:
        """Type or choose, one key at a time, then confirm."""
        value, _ = self._mind.answer_question(question, occasion=view.place.attempt)
        if question.choices:
            target = question.choices.index(value)
            if view.chosen == str(target):
                return "next"
            return "down" if not view.chosen or int(view.chosen) < target else "up"
        text = f"{value:g}" if isinstance(value, float) else str(value)
        if view.typed == text:
            return ENTER  # whatever key confirms elsewhere, it may be one that types
        key = text[len(view.typed)] if text.startswith(view.typed) else "backspace"
        return {"-": "minus", ".": "period"}.get(key, key)

    def _answer(self, view: View, trial: Trial) -> str:
        """Feel what was not felt, answer what was not answered, confirm; empty to wait."""
        if unfelt := [part.name for part in trial.parts if part.name not in view.felt]:
            # Its own key where parts are felt at will, elsewhere all are felt again.
            action = f"{PLAY}{unfelt[0]}" if unfelt[0].isdigit() else "reference"
            if view.kind != "rows" or (
                view.selected == unfelt[0] and not self._keys.find_key(action)
            ):
                return "again"
            return action if self._keys.find_key(action) else _go_to_row(view, unfelt[0])
        if not self._values and view.scale is not None:
            own = Experience(trial, {}, self._tones, self._levels_db)
            is_own = bool(self._tones or self._levels_db)
            felt = own if is_own else self._mind.imagine(trial, self._stimuli)
            self._values, _ = self._mind.answer(felt, view.scale, view.place)
        for key, value in self._values.items():
            if isinstance(value, str) and view.scale is not None and view.chosen != value:
                return "left" if value == view.scale.choices[0] else "right"
            if not isinstance(value, str) and view.markers.get(key) != round(value):
                return self._move_marker(view, key, round(value))
        # After a marker was moved, it is another vibration.
        return "again" if trial.protocol == MATCHING and self._felt != view.markers else "next"

    def _move_marker(self, view: View, part: str, target: int) -> str:
        """Find what brings a marker nearer to a value."""
        if view.kind in LISTS and view.selected != part:
            return _go_to_row(view, part)
        if (marker := view.markers.get(part)) is None:
            return "right"  # Where the first key puts a marker is the screen's business.
        apart = target - marker
        steps = {action: copysign(1, apart) * step for action, step in MOVES.items()}
        near = (action for action in steps if 0 < steps[action] <= abs(apart))
        return max(near, key=steps.__getitem__, default="")


def _go_to_row(view: View, part: str) -> str:
    rows = view.trial.judged if view.trial else []
    return (
        "up" if view.selected in rows and rows.index(part) < rows.index(view.selected) else "down"
    )
