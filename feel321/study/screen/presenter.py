"""The presenter: a screen, a keyboard, a mouse and an output for vibrations.

It shows, plays and passes on; what is accepted is the engine's to say.
"""

from __future__ import annotations

from collections import deque
from dataclasses import replace
from math import ceil
from typing import TYPE_CHECKING

from feel321.study.screen.drawing import Composition
from feel321.study.screen.input import Click, Closed, Desk, Hidden, Press, Twice, Wish
from feel321.study.screen.layout import compose
from feel321.study.screen.parts import Hand, View, name_part
from feel321.study.session.ports import Abort, Confirm, Feel, Pause, Place, Playback
from feel321.study.settings.read import Surface

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    from feel321.protocols.trial import Page, Part, Scale, Trial
    from feel321.stimuli.sets.manifest import Stimulus
    from feel321.study.actuator.output import Output
    from feel321.study.screen.drawing import Target
    from feel321.study.screen.input import Event
    from feel321.study.screen.parts import ScreenTexts
    from feel321.study.screen.window import Window
    from feel321.study.session.ports import Act

# What is on the screen now, frame by frame, and what the participant wants by key or mouse.

DOUBLE_S = 0.4
"""Within that a second click is the other half of a double one: it leaves one page, not two."""


class Front:
    """Shows views and turns events into wishes.

    clock: gives the time in s since the session began.
    """

    def __init__(
        self, window: Window, texts: ScreenTexts, *, clock: Callable[[], float], hand: Hand
    ) -> None:
        self.window, self._texts, self._clock, self._hand = window, texts, clock, hand
        self.view = View("page", "reading", 0, Place(0, 0))
        self.notice = ""
        self._desk: Desk | None = None
        self._twice = Twice()
        self._confirmed_s = -DOUBLE_S
        self._events: deque[Event] = deque()
        self._composed: tuple[View, Composition] = (self.view, Composition(()))

    def bring_up(self, view: View, desk: Desk | None = None) -> None:
        """Begin a screen: nothing of the last one is left, no key that was pressed on it counts for this one."""
        self.view, self.notice, self._desk = view, "", desk
        self._events.clear()
        self._twice = Twice()
        self.show_frame()

    def find_desk(self) -> Desk:
        """Give the desk of the trial on the screen."""
        if self._desk is None:
            raise ValueError("got no trial; show one before it is answered")
        return self._desk

    def listen(self) -> Iterator[Wish]:
        """Show a frame, and tell what the participant wants; what is left of a frame waits for who listens next."""
        self.show_frame()
        while self._events:
            event = self._events.popleft()
            if isinstance(event, Press | Click):
                self.notice = ""
            wish = self._understand(event)
            if wish is not None and not self._doubles(event, wish):
                yield wish
        if self.view.trial is not None:
            self.find_desk().tick(self._clock(), can_answer=self.view.can_answer)

    def _understand(self, event: Event) -> Wish | None:
        target = self._find_target(event)
        name = target.name if target else ""
        if isinstance(event, Closed):
            return Wish("close", event.time_s)
        if isinstance(event, Hidden):
            # Nobody sees what is asked: a trial begins anew after a pause, a page waits.
            return Wish("pause", event.time_s) if self.view.trial is not None else None
        if isinstance(event, Press):
            page = self.view.page
            go_on = "f12" if page is not None and page.by == "experimenter" else "enter"
            name = {go_on: "confirm", "space": "stop", "escape": "pause"}.get(event.key, "")
        if name == "pause":
            return self._leave(event)
        if name in {"confirm", "stop"}:
            return Wish(name, event.time_s)
        if self.view.trial is None:
            return None
        return self.find_desk().take(event, target, can_answer=self.view.can_answer)

    def _doubles(self, event: Event, wish: Wish) -> bool:
        """Say whether a click that confirms is the other half of a double one."""
        if wish.name != "confirm" or not isinstance(event, Click):
            return False
        if event.time_s - self._confirmed_s < DOUBLE_S:
            return True
        self._confirmed_s = event.time_s
        return False

    def _leave(self, event: Event) -> Wish | None:
        """Heed Esc when it comes a second time; the button of a trial does it at once."""
        is_button = isinstance(event, Click) and self.view.trial is not None
        return Wish("pause", event.time_s) if is_button or self._twice.press(event.time_s) else None

    def _find_target(self, event: Event) -> Target | None:
        if not isinstance(event, Click):
            return None
        return next(
            (t for t in self._composed[1].targets if t.box.contains(event.x, event.y)), None
        )

    def show_frame(self) -> None:
        """Show what is to be on the screen for a frame, and keep what is done in it."""
        view = self._look()
        self._hand.watch(view)
        if view != self._composed[0]:
            self._composed = view, compose(view, self._texts, size=self.window.size)
        self._events.extend(self.window.show(self._composed[1].items))

    def _look(self) -> View:
        """Put together what is on the screen now."""
        notice = self.notice
        if self._twice.is_armed(self._clock()) and self.view.can_leave:
            notice = self._texts.prompts["end_next" if self.view.page else "pause_next"]
        view = replace(self.view, notice=notice)
        if view.trial is None:
            return view
        desk = self.find_desk()
        return replace(
            view,
            markers=desk.markers.values,
            selected=desk.selected,
            chosen=desk.chosen,
            typed=desk.typed,
        )


# Playing a stimulus, or asking for a stroke over the real surface, while the screen goes on.

CLOSED = "the window was closed"

SILENCE_S = 1.0
"""How long an output may take to fall silent before its own word on what happened is asked for."""


class Player:
    """Plays stimuli through an output, and heeds what the participant does meanwhile.

    clock: gives the time in s since the session began.
    """

    def __init__(
        self, front: Front, output: Output, *, clock: Callable[[], float], acts: deque[Act]
    ) -> None:
        self._front, self._output, self._clock, self._acts = front, output, clock, acts

    def play(self, part: Part, stimulus: Stimulus, *, gap_s: float) -> Playback:
        """Play a stimulus to its end, or until the participant stops it."""
        self._front.view = replace(self._front.view, state="feeling", playing=part.name)
        self._front.show_frame()  # what is announced is on the screen before it is felt
        late = self._front.window.frames.late
        self._output.start(stimulus, gap_s=gap_s)
        try:
            act = self._watch_playing()
        except BaseException:
            self._output.stop()
            raise
        delivery = self._output.collect()
        self._note_felt(part, is_felt=delivery.completed and not delivery.error)
        return Playback(
            requested_s=delivery.requested_s,
            onset_s=delivery.onset_s,
            underruns=delivery.underruns,
            clipped=delivery.clipped,
            completed=delivery.completed,
            error=delivery.error,
            act=act,
            measured={**delivery.measured, "late_frames": self._front.window.frames.late - late},
        )

    def prompt(self, part: Part) -> Playback:
        """Ask the participant to stroke the real surface, and wait until that is done."""
        self._front.view = replace(self._front.view, state="stroking", playing=part.name)
        self._front.show_frame()
        began_s = self._clock()
        while True:
            for wish in self._front.listen():
                if wish.name == "confirm":
                    self._note_felt(part, is_felt=True)
                    return Playback(began_s, began_s)
                if (act := find_end(wish)) is not None:
                    self._note_felt(part, is_felt=False)
                    return Playback(began_s, began_s, completed=False, act=act)

    def _watch_playing(self) -> Pause | Abort | None:
        """Show frames until the output is silent; what ends the trial stops it, and so does feeling another part."""
        act: Pause | Abort | None = None
        stopped_s = float("inf")
        while self._output.is_playing and self._clock() - stopped_s < SILENCE_S:
            for wish in self._front.listen():
                is_switch = wish.name == "feel" and self._front.view.kind == "rows"
                if is_switch:
                    self._acts.append(Feel(wish.time_s, wish.part))
                act = act or find_end(wish)
                if act or is_switch or wish.name == "stop":
                    self._output.stop()
                    stopped_s = min(stopped_s, self._clock())
        return act

    def _note_felt(self, part: Part, *, is_felt: bool) -> None:
        # What was felt to its end stays felt, though it be cut short when it is felt again.
        felt = self._front.view.felt | {part.name} if is_felt else self._front.view.felt
        self._front.view = replace(self._front.view, felt=felt, playing="")


def find_end(wish: Wish) -> Pause | Abort | None:
    """Tell whether a wish ends the trial."""
    if wish.name == "close":
        return Abort(wish.time_s, CLOSED)
    return Pause(wish.time_s) if wish.name == "pause" else None


# A presenter with a screen, a keyboard, a mouse and an output for vibrations.

LEFT = "the participant ended it for today"
NOT_AT_HAND = Surface(None, None)


class ScreenPresenter:
    """Shows, plays, and passes on what the participant does; implements `study.session.ports.Presenter`.

    clock: gives the time in s since the session began.
    """

    def __init__(
        self,
        window: Window,
        output: Output,
        texts: ScreenTexts,
        *,
        clock: Callable[[], float],
        surfaces: Mapping[str, Surface],
        hand: Hand | None = None,
    ) -> None:
        self._front = Front(window, texts, clock=clock, hand=hand or Hand())
        self._texts, self._clock, self._surfaces = texts, clock, surfaces
        self._acts: deque[Act] = deque()
        self._player = Player(self._front, output, clock=clock, acts=self._acts)
        self._possible_s = 0.0

    def show_page(self, page: Page, place: Place) -> Confirm | Pause | Abort:
        """Show a page until whoever it is for is done with it, at least as long as it is to stand."""
        self._front.bring_up(
            View(
                "page",
                "reading",
                self._front.view.screen + 1,
                place,
                page=page,
                left_s=ceil(page.least_s),
            )
        )
        shown_s = self._clock()
        while True:
            self._front.view = replace(
                self._front.view, left_s=ceil(max(0.0, page.least_s - self._clock() + shown_s))
            )
            for wish in self._front.listen():
                stood_s = max(0.0, wish.time_s - shown_s)
                if (end := find_end(wish)) is not None and self._front.view.can_leave:
                    return Abort(wish.time_s, end.reason if isinstance(end, Abort) else LEFT)
                if wish.name in {"confirm", "close"} and stood_s >= page.least_s:
                    return Confirm(wish.time_s, {}, stood_s)
                if wish.name == "confirm":
                    self.refuse("too_early", ())

    def show_trial(self, trial: Trial, scale: Scale, place: Place) -> None:
        """Bring a trial before the participant, all markers unset."""
        desk = Desk(trial, scale)
        self._acts.clear()
        surface = self._surfaces.get(trial.recording, NOT_AT_HAND)
        view = View(
            desk.kind, "feeling", self._front.view.screen + 1, place, trial=trial, scale=scale
        )
        self._front.bring_up(
            replace(view, picture=surface.picture, sample=surface.sample or ""), desk
        )
        self._possible_s = self._clock()

    def play(self, part: Part, stimulus: Stimulus, *, gap_s: float) -> Playback:
        """Play a stimulus to its end, or until the participant stops it."""
        return self._begin_answer(self._player.play(part, stimulus, gap_s=gap_s))

    def prompt(self, part: Part) -> Playback:
        """Ask the participant to stroke the real surface, and wait until that is done."""
        return self._begin_answer(self._player.prompt(part))

    def wait(self) -> Act:
        """Wait for the participant's next act on the trial that is shown."""
        self._front.view = replace(self._front.view, state="answering", playing="")
        desk = self._front.find_desk()
        while not self._acts:
            for wish in self._front.listen():
                self._acts.extend(_answer(wish, desk, possible_s=self._possible_s))
            self._acts.extend(desk.markers.settle(self._clock()))
        return self._acts.popleft()

    def refuse(self, reason: str, parts: tuple[str, ...]) -> None:
        """Tell the participant why an act was not accepted, until the next one."""
        names = ", ".join(name_part(part, self._texts) for part in parts)
        self._front.notice = self._texts.refusals[reason].format(parts=names)

    def _begin_answer(self, playback: Playback) -> Playback:
        self._possible_s = self._clock()
        return playback


def _answer(wish: Wish, desk: Desk, *, possible_s: float) -> Iterator[Act]:
    """Turn a wish into acts; markers come to rest before anything else is done."""
    if (end := find_end(wish)) is not None:
        yield end
    elif wish.name == "feel":
        yield from desk.markers.settle(wish.time_s, rest_s=0.0)
        yield Feel(wish.time_s, wish.part)
    elif wish.name == "confirm" and not desk.finish_typing(wish.time_s):
        # Enter after digits that wait for another sets their value only: it must be seen before it counts.
        yield from desk.markers.settle(wish.time_s, rest_s=0.0)
        yield Confirm(wish.time_s, desk.values, max(0.0, wish.time_s - possible_s))
