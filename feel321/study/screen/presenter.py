"""The presenter: a screen, a keyboard, a mouse and an output for vibrations.

It shows, plays and passes on what the participant does; the engine decides what is accepted. Also a simulated
participant before that screen, who presses the keys that a person would.
"""

from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from math import ceil, copysign, inf

from feel321.protocols.texts import Question
from feel321.protocols.trial import MATCHING, Page, Part, Scale, Trial
from feel321.study.actuator.output import Output
from feel321.study.keys import PLAY, USUAL, KeysTable
from feel321.study.observer import Participant
from feel321.study.screen import input as inputs
from feel321.study.screen.input import Answer, Form, InputEvent, ScreenTexts, Stop, View
from feel321.study.screen.layout import compose
from feel321.study.screen.sheet import Sheet
from feel321.study.screen.window import Window
from feel321.study.session import ports
from feel321.study.session.ports import Abort, Act, Confirm, Feel, Pause, Place, Playback, Surface

DOUBLE_S = 0.4  # a second click within this time is half of a double one: it leaves no page
TWICE_S = 1.0  # time within which a key counts as pressed twice
LEFT = "the participant ended it for today"
LOOP_S = 60.0  # how long a vibration goes on and on at most, until it is asked for again
LOOP_PAUSE_S = 0.1  # before it begins again, so that the limit of the rig counts from 0
SILENCE_S = 1.0  # longest wait for an output to fall silent before it is asked what happened


class ScreenPresenter:
    """Shows, plays and passes on what the participant does; clock: in s since the session began."""

    def __init__(
        self,
        window: Window,
        output: Output,
        texts: ScreenTexts,
        *,
        clock: Callable[[], float],
        surfaces: Mapping[str, Surface],
        hand: "PressingHand | None" = None,
    ) -> None:
        self._window, self._output, self._texts, self._clock = window, output, texts, clock
        self._surfaces, self._hand = surfaces, hand
        self._view = View("page", "reading", 0, Place(0, 0))
        self._composed: tuple[View, Sheet] = (self._view, Sheet(0, 0))
        self._answer: Answer  # to the trial on the screen
        self._form: Form | None = None
        self._notice, self._paused_s, self._confirmed_s = "", -inf, -inf
        self._events: deque[InputEvent] = deque()
        self._acts: deque[Act] = deque()
        self._possible_s = self._asked_s = 0.0
        self._is_switching = self._goes_round = False

    # Frames, and what is done in them.

    def _bring_up(self, view: View, form: Form | None = None) -> None:
        """Begin a screen: nothing of the last one is left, no key that was pressed on it counts for this one."""
        self._view, self._notice, self._form, self._paused_s = view, "", form, -inf
        self._events.clear()
        self._show_frame()

    def _listen(self) -> Iterator[Act]:
        """Show a frame, and list what the participant wants; what is left of a frame waits for the next call."""
        self._show_frame()
        while self._events:
            event = self._events.popleft()
            if event.kind in {"press", "click"}:
                self._notice = ""
            wish = self._interpret(event)
            if isinstance(wish, Confirm) and event.kind == "click":
                if event.time_s - self._confirmed_s < DOUBLE_S:
                    continue  # the other half of a double one
                self._confirmed_s = event.time_s
            if wish:
                yield wish
        if self._view.trial is not None:
            self._answer.tick(self._clock(), can_answer=self._view.can_answer)

    def _show_frame(self) -> None:
        """Show what is to be on the screen for a frame, and keep what is done in it."""
        view = replace(self._view, notice=self._notice)
        if self._clock() - self._paused_s <= TWICE_S and view.can_leave:
            prompt = "end_next" if view.page else "pause_next"
            view = replace(view, notice=self._texts.prompts[prompt])
        if (form := self._form) is not None:
            fault, _ = form.check()
            felt = frozenset[str]() if fault else frozenset({form.question.name})
            view = replace(view, typed=form.typed, chosen=form.chosen, felt=felt)
        if view.trial is not None:
            names = ("markers", "selected", "chosen", "typed", "loops")
            view = replace(view, **{name: getattr(self._answer, name) for name in names})
        if self._hand:
            self._events.extend(self._hand.watch(view))
        if view != self._composed[0]:
            self._composed = view, compose(view, self._texts, size=self._window.size)
        self._events.extend(self._window.show(self._composed[1].items))

    def _interpret(self, event: InputEvent) -> Act | None:
        trial, page, time_s = self._view.trial, self._view.page, event.time_s
        targets = self._composed[1].targets if event.kind == "click" else []
        target = next((t for t in targets if t.box.contains(event.x, event.y)), None)
        name = target.name if target else ""
        if event.kind == "closed":
            return Abort(time_s, "the window was closed")
        if event.kind == "hidden":
            # Nobody sees what is asked: a trial begins anew after a pause, a page waits.
            return Pause(time_s) if trial is not None else None
        if event.kind == "press":
            is_theirs = page is not None and page.by == "experimenter"
            confirm = "experimenter" if is_theirs else "next"
            action = (self._form or self._texts.own_keys).name_action(event.key)
            name = {confirm: "confirm", "stop": "stop", "pause": "pause"}.get(action, "")
        if name == "pause":
            # A key must be pressed twice; the button of a trial is enough.
            is_second = time_s - self._paused_s <= TWICE_S or (event.kind == "click" and trial)
            self._paused_s = -inf if is_second else time_s
            return Pause(time_s) if is_second else None
        if name in {"confirm", "stop"}:
            return Confirm(time_s) if name == "confirm" else Stop(time_s)
        if self._form is not None:
            self._form.take(event, target)
        if trial is None:
            return None
        return self._answer.take(event, target, can_answer=self._view.can_answer)

    # Pages.

    def show_question(self, question: Question, place: Place) -> Confirm | Pause | Abort:
        """Show a question page until it has an answer."""
        form = Form(question, self._texts.own_keys)
        return self.show_page(Page(question.key), place, form=form)

    def show_page(
        self, page: Page, place: Place, *, form: Form | None = None
    ) -> Confirm | Pause | Abort:
        """Show a page until whoever it is for is done with it, for its least time at least."""
        question, left_s = form.question if form else None, ceil(page.least_s)
        view = View("page", "reading", self._view.screen + 1, place, page, question, left_s=left_s)
        self._bring_up(view, form)
        shown_s = self._clock()
        while True:
            left_s = ceil(max(0.0, page.least_s - self._clock() + shown_s))
            self._view = replace(self._view, left_s=left_s)
            for wish in self._listen():
                stood_s = max(0.0, wish.time_s - shown_s)
                if isinstance(wish, Pause | Abort) and self._view.can_leave:
                    return Abort(wish.time_s, wish.reason if isinstance(wish, Abort) else LEFT)
                if not isinstance(wish, Confirm | Abort):  # nothing is left of a closed window
                    continue
                values: dict[str, float | str] = {}
                fault = "too_early" if stood_s < page.least_s else ""
                if form is not None:
                    fault, values = form.check()
                if not fault:
                    return Confirm(wish.time_s, values, stood_s)
                if isinstance(wish, Confirm):
                    self.refuse(fault, (form.question.describe_range(),) if form else ())

    # Trials.

    def show_trial(self, trial: Trial, scale: Scale, place: Place) -> None:
        """Show a trial, all markers unset."""
        self._answer = Answer(trial, scale, self._texts.own_keys)
        sample, picture = self._surfaces.get(trial.recording) or (None, None)
        number, kind = self._view.screen + 1, self._answer.kind
        view = View(kind, "feeling", number, place, None, None, trial, scale)
        self._acts.clear()
        self._bring_up(replace(view, picture=picture, sample=sample or ""))
        self._possible_s = self._clock()

    def play(
        self, part: Part, stimulus: ports.Felt, *, gap_s: float, due_s: float | None = None
    ) -> Playback:
        """Play a stimulus to its end, or until the participant stops it."""
        self._begin_part(part, "feeling", stimulus)
        answer, goes_round = self._answer, self._goes_round
        late, goes_on = self._window.late_frames, self._is_switching and answer.loops
        self._goes_round = self._is_switching = False
        self._asked_s = self._asked_s if goes_round else self._clock()
        pause_s = LOOP_PAUSE_S if goes_round else gap_s
        pause_s = pause_s if due_s is None else max(pause_s, due_s - self._clock())
        self._output.start(stimulus, gap_s=pause_s, goes_on=goes_on)
        try:
            act, is_at_end = self._watch_playing()
        except BaseException:
            self._output.stop()
            raise
        playback = self._output.collect()
        self._end_part(part, is_felt=playback.completed and not playback.error)
        is_free = answer.loops and self._clock() - self._asked_s < LOOP_S
        if is_free and is_at_end and not playback.error and not act:
            self._goes_round = True
            self._acts.extend(answer.settle(self._clock()))
            self._acts.append(Feel(self._clock(), part.name))  # again, until something else is done
        late = self._window.late_frames - late
        return replace(playback, act=act, measured={**playback.measured, "late_frames": late})

    def _watch_playing(self) -> tuple[Pause | Abort | None, bool]:
        """Show frames until the output is silent; returns what ends the trial, and whether nothing stopped it."""
        act: Pause | Abort | None = None
        stopped_s = inf
        while self._output.is_playing and self._clock() - stopped_s < SILENCE_S:
            for wish in self._listen():
                is_switch = isinstance(wish, Feel) and self._view.kind == "rows"
                is_switch = is_switch or (isinstance(wish, Confirm) and self._answer.loops)
                if is_switch:
                    self._acts.extend(self._list_acts(wish))
                    self._is_switching = isinstance(wish, Feel)
                if isinstance(wish, Pause | Abort):
                    act = act or wish
                if act or is_switch or isinstance(wish, Stop):
                    self._output.stop()
                    stopped_s = min(stopped_s, self._clock())
        return act, stopped_s == inf

    def prompt(self, part: Part) -> Playback:
        """Ask the participant to stroke the real surface, and wait until that is done."""
        self._begin_part(part, "stroking", None)
        began_s = self._clock()
        while True:
            for wish in self._listen():
                if isinstance(wish, Pause | Abort | Confirm):
                    end = None if isinstance(wish, Confirm) else wish
                    self._end_part(part, is_felt=end is None)
                    return Playback(began_s, began_s, completed=end is None, act=end)

    def _begin_part(self, part: Part, state: str, stimulus: ports.Felt | None) -> None:
        self._view = replace(self._view, state=state, playing=part.name)
        self._show_frame()
        if self._hand:
            self._hand.feel(part, stimulus)

    def _end_part(self, part: Part, *, is_felt: bool) -> None:
        # What was felt to its end stays felt, though it be cut short when it is felt again.
        before = self._view.felt
        felt = before | ({part.name} if is_felt else set())
        self._view = replace(self._view, felt=felt, playing="")
        self._answer.felt = felt
        if not self._answer.loops or felt != before:
            self._possible_s = self._clock()  # what goes on and on keeps nobody from answering

    def wait(self, limit_s: float | None = None) -> Act:
        """Wait for the participant's next act on the trial that is shown."""
        self._view = replace(self._view, state="answering", playing="")
        while not self._acts:
            for wish in self._listen():
                self._acts.extend(self._list_acts(wish))
            self._acts.extend(self._answer.settle(self._clock()))
            if limit_s is not None:
                left_s = limit_s - self._clock() + self._possible_s
                self._view = replace(self._view, left_s=max(1, ceil(left_s)))
                if left_s <= 0 and not self._acts:
                    return ports.TimedOut(self._clock())
        return self._acts.popleft()

    def refuse(self, reason: str, parts: tuple[str, ...]) -> None:
        """Explain why an act was not accepted, until the next one; several scales are numbered."""
        trial, names = self._view.trial, [self._texts.name_part(part) for part in parts]
        if trial and reason == "not_answered" and any(one.scale for one in trial.judgements):
            names = [str(trial.judged.index(part) + 1) for part in parts]
        self._notice = self._texts.refusals[reason].format(parts=", ".join(names))

    def _list_acts(self, wish: Act) -> Iterator[Act]:
        """Complete a wish; markers come to rest before anything else is done."""
        time_s, answer = wish.time_s, self._answer
        if isinstance(wish, Pause | Abort):
            yield wish
        elif isinstance(wish, Feel):
            yield from answer.settle(time_s, rest_s=0.0)
            yield wish
        elif isinstance(wish, Confirm) and not (
            answer.finish_typing(time_s) or answer.go_to_open()
        ):
            # Enter after digits that wait for another sets their value only: it must be seen before it counts.
            yield from answer.settle(time_s, rest_s=0.0)
            yield Confirm(time_s, answer.values, max(0.0, time_s - self._possible_s))


RETRY_S, RETRIES = 2.0, 15  # pause before a failed device is tried again, and how often that is
THINKING_S = 0.3  # before the first key; answers in less than 0.2 s would count as too fast
TYPED = "text:"  # what an act begins with that types what follows


class PressingHand:
    """A simulated participant: what is on the screen alone decides which key comes next; clock: of the session, in s.

    The answers are those of `observer`, so that the same person gives the same ratings (in whole points) here as in
    `feel321 simulate`.
    """

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

    def feel(self, part: Part, stimulus: ports.Felt | None) -> None:
        """Feel what is played; None is the real surface."""
        self._felt = self._seen
        self._mind.feel(part, stimulus)

    def _choose_act(self, view: View) -> str:
        """Choose what to do next: an action, or what to type; empty to wait."""
        if (question := view.question) is not None:
            value, _ = self._mind.answer_question(question, occasion=view.place.attempt)
            if question.choices:
                chosen, target = int(view.chosen or -1), question.choices.index(value)
                return "next" if chosen == target else "down" if chosen < target else "up"
            text = f"{value:g}" if isinstance(value, float) else str(value)
            return (
                inputs.ENTER
                if view.typed == text
                else f"{TYPED}{inputs.BACKSPACE if view.typed else text}"
            )
        if view.state == "reading" and view.page is not None and not view.left_s:
            if view.page.key == "call_us":
                self._retries += 1
                return "pause" if self._retries > RETRIES else "experimenter"
            return "experimenter" if view.page.by == "experimenter" else "next"
        if view.state == "answering" and view.trial is not None:
            return self._answer(view, view.trial)
        return "next" if view.state == "stroking" else ""

    def _answer(self, view: View, trial: Trial) -> str:
        """Feel what was not felt, answer what was not answered, confirm."""
        if unfelt := view.unfelt:
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
                return _move_marker(view, key, round(value))
        # After a marker was moved, it is another vibration.
        return "again" if trial.protocol == MATCHING and self._felt != view.markers else "next"


def _move_marker(view: View, part: str, target: int) -> str:
    if view.kind in inputs.LISTS and view.selected != part:
        return _go_to_row(view, part)
    if (marker := view.markers.get(part)) is None:
        return "right"  # Where the first key puts a marker is the screen's business.
    apart = target - marker
    steps = {action: copysign(1, apart) * step for action, step in inputs.MOVES.items()}
    near = (action for action in steps if 0 < steps[action] <= abs(apart))
    return max(near, key=steps.__getitem__, default="")


def _go_to_row(view: View, part: str) -> str:
    rows = view.trial.judged if view.trial else []
    is_above = view.selected in rows and rows.index(part) < rows.index(view.selected)
    return "up" if is_above else "down"
