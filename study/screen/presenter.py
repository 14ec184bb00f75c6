"""A presenter with a screen, a keyboard, a mouse and an output for vibrations.

It shows, plays and passes on; what is accepted is the engine's to say.
"""

from __future__ import annotations

from collections import deque
from dataclasses import replace
from math import ceil
from typing import TYPE_CHECKING

from study.screen.desk import Desk, Wish
from study.screen.events import Click, Closed, Press
from study.screen.keyboard import Twice
from study.screen.layout import compose
from study.screen.parts import name_part
from study.screen.shapes import Composition
from study.screen.views import Hand, View
from study.session.ports import Abort, Confirm, Feel, Pause, Place, Playback

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    from protocols.flow import Page
    from protocols.trial import Part, Scale, Trial
    from stimuli.manifest import Stimulus
    from study.actuator.output import Output
    from study.screen.events import Event
    from study.screen.shapes import Target
    from study.screen.window import Window
    from study.screen.wording import ScreenTexts
    from study.session.ports import Act
    from study.settings.sources import Surface

CLOSED = "the window was closed"
LEFT = "the participant ended it for today"

SILENCE_S = 1.0
"""How long an output may take to fall silent before its own word on what happened is asked for."""


class ScreenPresenter:
    """Shows, plays, and passes on what the participant does; implements `study.session.ports.Presenter`.

    Parameters
    ----------
    window : Window
        The window, open.
    output : Output
        What plays stimuli.
    texts : ScreenTexts
        What participants read.
    clock : callable
        Gives the time in s since the session began; window and output have the same.
    surfaces : mapping of str to Surface
        The real surface of every recording, by the recording's name.
    hand : Hand, optional
        Whoever watches the screen and presses keys; nobody unless given.
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
        self._window, self._output, self._texts = window, output, texts
        self._clock, self._surfaces, self._hand = clock, surfaces, hand or Hand()
        self._view = View("page", "reading", 0, Place(0, 0))
        self._composed: tuple[View, Composition] = (self._view, Composition(()))
        self._desk: Desk | None = None
        self._twice = Twice()
        self._notice = ""
        self._events: deque[Event] = deque()
        self._acts: deque[Act] = deque()
        self._possible_s = 0.0

    def show_page(self, page: Page, place: Place) -> Confirm | Pause | Abort:
        """Show a page until whoever it is for is done with it, at least as long as it is to stand.

        Parameters
        ----------
        page : Page
            What to show.
        place : Place
            How far the session has come.

        Returns
        -------
        Confirm or Abort
            What was done. There is nothing to pause on a page: who asks for that here ends the session for today.
        """
        self._bring_up(View("page", "reading", self._view.screen + 1, place, page=page, left_s=ceil(page.least_s)))
        self._show_frame()
        shown_s = self._clock()
        while True:
            left_s = ceil(max(0.0, page.least_s - (self._clock() - shown_s)))
            self._view = replace(self._view, left_s=left_s)
            for wish in self._listen():
                stood_s = max(0.0, wish.time_s - shown_s)
                if wish.name == "close":
                    return Abort(wish.time_s, CLOSED)
                if wish.name == "pause" and self._view.can_leave:
                    return Abort(wish.time_s, LEFT)
                if wish.name == "confirm" and stood_s >= page.least_s:
                    return Confirm(wish.time_s, {}, stood_s)
                if wish.name == "confirm":
                    self.refuse("too_early", ())

    def show_trial(self, trial: Trial, scale: Scale, place: Place) -> None:
        """Bring a trial before the participant, all markers unset.

        Parameters
        ----------
        trial : Trial
            The trial that begins.
        scale : Scale
            The scale that it will be answered on.
        place : Place
            How far the session has come.
        """
        self._desk = desk = Desk(trial, scale)
        surface = self._surfaces.get(trial.recording)
        view = View(desk.kind, "feeling", self._view.screen + 1, place, trial=trial, scale=scale)
        self._bring_up(
            view if surface is None else replace(view, picture=surface.picture, sample=surface.sample or "")
        )
        self._show_frame()
        self._possible_s = self._clock()

    def play(self, part: Part, stimulus: Stimulus, *, gap_s: float) -> Playback:
        """Play a stimulus to its end, or until the participant stops it.

        Parameters
        ----------
        part : Part
            The part that it is.
        stimulus : Stimulus
            What to play.
        gap_s : float
            Silence before it, in s.

        Returns
        -------
        Playback
            What became of it.
        """
        self._view = replace(self._view, state="feeling", playing=part.name)
        self._show_frame()  # what is announced is on the screen before it is felt
        late = self._window.frames.late
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
            measured={**delivery.measured, "late_frames": self._window.frames.late - late},
        )

    def prompt(self, part: Part) -> Playback:
        """Ask the participant to stroke the real surface, and wait until that is done.

        Parameters
        ----------
        part : Part
            The part that it is.

        Returns
        -------
        Playback
            When it began, and whether it was done.
        """
        self._view = replace(self._view, state="stroking", playing=part.name)
        self._show_frame()
        began_s = self._clock()
        while True:
            for wish in self._listen():
                if wish.name == "confirm":
                    self._note_felt(part, is_felt=True)
                    return Playback(began_s, began_s)
                if (act := _find_end(wish)) is not None:
                    self._note_felt(part, is_felt=False)
                    return Playback(began_s, began_s, completed=False, act=act)

    def wait(self) -> Act:
        """Wait for the participant's next act on the trial that is shown.

        Returns
        -------
        Feel, Move, Confirm, Pause or Abort
            What the participant did.
        """
        self._view = replace(self._view, state="answering", playing="")
        while not self._acts:
            for wish in self._listen():
                self._acts.extend(self._answer(wish))
            self._acts.extend(self._desk_now().settle(self._clock()))
        return self._acts.popleft()

    def refuse(self, reason: str, parts: tuple[str, ...]) -> None:
        """Tell the participant why an act was not accepted, until the next one.

        Parameters
        ----------
        reason : str
            One of `study.session.ports.REFUSALS`.
        parts : tuple of str
            The parts that it is about.
        """
        names = ", ".join(name_part(part, self._texts) for part in parts)
        self._notice = self._texts.refusals[reason].format(parts=names)

    def _answer(self, wish: Wish) -> Iterator[Act]:
        """Turn a wish into acts; markers come to rest before anything else is done."""
        desk = self._desk_now()
        if (end := _find_end(wish)) is not None:
            yield end
        elif wish.name == "feel":
            yield from desk.settle(wish.time_s, rest_s=0.0)
            yield Feel(wish.time_s, wish.part)
        elif wish.name == "confirm" and not desk.finish_typing(wish.time_s):
            # Enter after digits that wait for another sets their value only: it must be seen before it counts.
            yield from desk.settle(wish.time_s, rest_s=0.0)
            yield Confirm(wish.time_s, desk.values, max(0.0, wish.time_s - self._possible_s))

    def _watch_playing(self) -> Pause | Abort | None:
        """Show frames until the output is silent; what ends the trial stops it, and so does feeling another part."""
        act: Pause | Abort | None = None
        stopped_s = float("inf")
        while self._output.is_playing and self._clock() - stopped_s < SILENCE_S:
            for wish in self._listen():
                is_switch = wish.name == "feel" and self._view.kind == "rows"
                if is_switch:
                    self._acts.append(Feel(wish.time_s, wish.part))
                act = act or _find_end(wish)
                if act or is_switch or wish.name == "stop":
                    self._output.stop()
                    stopped_s = min(stopped_s, self._clock())
        return act

    def _note_felt(self, part: Part, *, is_felt: bool) -> None:
        felt = self._view.felt | {part.name} if is_felt else self._view.felt - {part.name}
        self._view = replace(self._view, felt=felt, playing="")
        self._possible_s = self._clock()

    def _bring_up(self, view: View) -> None:
        """Begin a screen: nothing of the last one is left, no key that was pressed on it counts for this one."""
        self._view, self._notice = view, ""
        self._events.clear()
        self._acts.clear()
        self._twice = Twice()

    def _desk_now(self) -> Desk:
        if self._desk is None:
            raise ValueError("got no trial; show one before it is answered")
        return self._desk

    def _listen(self) -> Iterator[Wish]:
        """Show a frame, and tell what the participant wants; what is left of a frame waits for who listens next."""
        self._show_frame()
        while self._events:
            event = self._events.popleft()
            if isinstance(event, Press | Click):
                self._notice = ""
            if (wish := self._understand(event)) is not None:
                yield wish
        if self._view.trial is not None:
            self._desk_now().tick(self._clock(), can_answer=self._view.can_answer)

    def _understand(self, event: Event) -> Wish | None:
        target = self._find_target(event)
        name = target.name if target else ""
        if isinstance(event, Closed):
            return Wish("close", event.time_s)
        if isinstance(event, Press):
            page = self._view.page
            go_on = "f12" if page is not None and page.by == "experimenter" else "enter"
            name = {go_on: "confirm", "space": "stop", "escape": "pause"}.get(event.key, "")
        if name == "pause":
            return self._leave(event)
        if name in {"confirm", "stop"}:
            return Wish(name, event.time_s)
        if self._view.trial is None:
            return None
        return self._desk_now().take(event, target, can_answer=self._view.can_answer)

    def _leave(self, event: Event) -> Wish | None:
        """Heed Esc when it comes a second time; the button of a trial does it at once."""
        is_button = isinstance(event, Click) and self._view.trial is not None
        return Wish("pause", event.time_s) if is_button or self._twice.press(event.time_s) else None

    def _find_target(self, event: Event) -> Target | None:
        if not isinstance(event, Click):
            return None
        return next((t for t in self._composed[1].targets if t.box.contains(event.x, event.y)), None)

    def _show_frame(self) -> None:
        view = self._look()
        self._hand.watch(view)
        if view != self._composed[0]:
            self._composed = view, compose(view, self._texts, size=self._window.size)
        self._events.extend(self._window.show(self._composed[1].items))

    def _look(self) -> View:
        """Put together what is on the screen now."""
        notice = self._notice
        if self._twice.is_armed(self._clock()) and self._view.can_leave:
            notice = self._texts.prompts["end_next" if self._view.page else "pause_next"]
        view = replace(self._view, notice=notice)
        if view.trial is None:
            return view
        desk = self._desk_now()
        return replace(view, markers=desk.markers, selected=desk.selected, chosen=desk.chosen, typed=desk.typed)


def _find_end(wish: Wish) -> Pause | Abort | None:
    """Tell whether a wish ends the trial."""
    if wish.name == "close":
        return Abort(wish.time_s, CLOSED)
    return Pause(wish.time_s) if wish.name == "pause" else None
