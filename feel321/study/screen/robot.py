"""A simulated participant before a real screen: looks at every frame and presses the keys that a person would.

The answers come from the participant of `observer`, so that the same person gives the same ratings (in whole points)
here as in `feel321 simulate`. The next key follows from what is on the screen alone.
"""

from collections.abc import Callable, Mapping, Sequence
from math import copysign

from feel321.protocols.texts import Question
from feel321.protocols.trial import MATCHING, Part, Trial
from feel321.study.keys import PLAY, USUAL, KeysTable
from feel321.study.observer import Participant
from feel321.study.screen.input import BACKSPACE, ENTER, LISTS, MOVES, Hand, InputEvent, View
from feel321.study.session.ports import Felt

RETRY_S, RETRIES = 2.0, 15  # pause before a failed device is tried again, and how often that is
THINKING_S = 0.3  # before the first key; answers in less than 0.2 s would count as too fast
TYPED = "text:"  # what an act begins with that types what follows


class PressingHand(Hand):
    """A simulated participant before a real screen; clock: gives the time in s since the session began."""

    def __init__(
        self, mind: Participant, *, clock: Callable[[], float], keys: KeysTable = USUAL
    ) -> None:
        self._mind, self._clock, self._keys = mind, clock, keys
        self._task, self._since_s, self._retries = (-1, ""), 0.0, 0
        self._values: Mapping[str, float | str] = {}
        self._seen: Mapping[str, float] = {}
        self._felt: Mapping[str, float] = {}

    def watch(self, view: View) -> Sequence[InputEvent]:
        """Look at what is on the screen, and press and release a key."""
        time_s, self._seen = self._clock(), view.markers
        if view.screen != self._task[0] and view.trial is not None:
            self._values = {}
            self._mind.begin(view.trial)
        if (task := (view.screen, view.state)) != self._task:
            self._task, self._since_s = task, time_s
        wait_s = RETRY_S if view.page is not None and view.page.key == "call_us" else THINKING_S
        if time_s - self._since_s < wait_s or not (act := self._choose_act(view)):
            return ()
        if act.startswith(TYPED):
            return (InputEvent("text", time_s, act.removeprefix(TYPED)),)
        key = self._keys.find_key(act) or act
        return InputEvent("press", time_s, key), InputEvent("release", time_s, key)

    def feel(self, part: Part, stimulus: Felt | None) -> None:
        """Feel what is played; None is the real surface."""
        self._felt = self._seen
        self._mind.feel(part, stimulus)

    def _choose_act(self, view: View) -> str:
        """Choose what to do next: an action, or what to type; empty to wait."""
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
        value, _ = self._mind.answer_question(question, occasion=view.place.attempt)
        if question.choices:
            target = question.choices.index(value)
            if view.chosen == str(target):
                return "next"
            return "down" if not view.chosen or int(view.chosen) < target else "up"
        text = f"{value:g}" if isinstance(value, float) else str(value)
        return ENTER if view.typed == text else f"{TYPED}{BACKSPACE if view.typed else text}"

    def _answer(self, view: View, trial: Trial) -> str:
        """Feel what was not felt, answer what was not answered, confirm."""
        if unfelt := [part.name for part in trial.parts if part.name not in view.felt]:
            # Its own key where parts are felt at will, elsewhere all are felt again.
            action = f"{PLAY}{unfelt[0]}" if unfelt[0].isdigit() else "reference"
            has_key = bool(self._keys.find_key(action))
            if view.kind != "rows" or (view.selected == unfelt[0] and not has_key):
                return "again"
            return action if has_key else _go_to_row(view, unfelt[0])
        if not self._values and view.scale is not None:
            self._values, _ = self._mind.answer(view.scale, view.place)
        for key, value in self._values.items():
            if isinstance(value, str) and view.scale is not None and view.chosen != value:
                return "left" if value == view.scale.choices[0] else "right"
            if not isinstance(value, str) and view.markers.get(key) != round(value):
                return self._move_marker(view, key, round(value))
        # After a marker was moved, it is another vibration.
        return "again" if trial.protocol == MATCHING and self._felt != view.markers else "next"

    def _move_marker(self, view: View, part: str, target: int) -> str:
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
    is_above = view.selected in rows and rows.index(part) < rows.index(view.selected)
    return "up" if is_above else "down"
