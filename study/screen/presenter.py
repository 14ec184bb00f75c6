"""A presenter with a screen, a keyboard, a mouse and an output for vibrations.

It shows, plays and passes on; what is accepted is the engine's to say.
"""

from __future__ import annotations

from collections import deque
from dataclasses import replace
from math import ceil
from typing import TYPE_CHECKING

from study.screen.desk import Desk
from study.screen.front import Front
from study.screen.parts import name_part
from study.screen.views import Hand, View
from study.session.ports import Abort, Confirm, Feel, Pause, Playback

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    from protocols.flow import Page
    from protocols.trial import Part, Scale, Trial
    from stimuli.manifest import Stimulus
    from study.actuator.output import Output
    from study.screen.desk import Wish
    from study.screen.window import Window
    from study.screen.wording import ScreenTexts
    from study.session.ports import Act, Place
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
        self._front = Front(window, texts, clock=clock, hand=hand or Hand())
        self._output, self._texts = output, texts
        self._clock, self._surfaces = clock, surfaces
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
        self._front.bring_up(
            View("page", "reading", self._front.view.screen + 1, place, page=page, left_s=ceil(page.least_s))
        )
        shown_s = self._clock()
        while True:
            left_s = ceil(max(0.0, page.least_s - (self._clock() - shown_s)))
            self._front.view = replace(self._front.view, left_s=left_s)
            for wish in self._front.listen():
                stood_s = max(0.0, wish.time_s - shown_s)
                if wish.name == "close":
                    return Abort(wish.time_s, CLOSED)
                if wish.name == "pause" and self._front.view.can_leave:
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
        desk = Desk(trial, scale)
        self._acts.clear()
        surface = self._surfaces.get(trial.recording)
        view = View(desk.kind, "feeling", self._front.view.screen + 1, place, trial=trial, scale=scale)
        self._front.bring_up(
            view if surface is None else replace(view, picture=surface.picture, sample=surface.sample or ""), desk
        )
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
        self._front.view = replace(self._front.view, state="stroking", playing=part.name)
        self._front.show_frame()
        began_s = self._clock()
        while True:
            for wish in self._front.listen():
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
        self._front.view = replace(self._front.view, state="answering", playing="")
        while not self._acts:
            for wish in self._front.listen():
                self._acts.extend(self._answer(wish))
            self._acts.extend(self._front.find_desk().markers.settle(self._clock()))
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
        self._front.notice = self._texts.refusals[reason].format(parts=names)

    def _answer(self, wish: Wish) -> Iterator[Act]:
        """Turn a wish into acts; markers come to rest before anything else is done."""
        desk = self._front.find_desk()
        if (end := _find_end(wish)) is not None:
            yield end
        elif wish.name == "feel":
            yield from desk.markers.settle(wish.time_s, rest_s=0.0)
            yield Feel(wish.time_s, wish.part)
        elif wish.name == "confirm" and not desk.finish_typing(wish.time_s):
            # Enter after digits that wait for another sets their value only: it must be seen before it counts.
            yield from desk.markers.settle(wish.time_s, rest_s=0.0)
            yield Confirm(wish.time_s, desk.values, max(0.0, wish.time_s - self._possible_s))

    def _watch_playing(self) -> Pause | Abort | None:
        """Show frames until the output is silent; what ends the trial stops it, and so does feeling another part."""
        act: Pause | Abort | None = None
        stopped_s = float("inf")
        while self._output.is_playing and self._clock() - stopped_s < SILENCE_S:
            for wish in self._front.listen():
                is_switch = wish.name == "feel" and self._front.view.kind == "rows"
                if is_switch:
                    self._acts.append(Feel(wish.time_s, wish.part))
                act = act or _find_end(wish)
                if act or is_switch or wish.name == "stop":
                    self._output.stop()
                    stopped_s = min(stopped_s, self._clock())
        return act

    def _note_felt(self, part: Part, *, is_felt: bool) -> None:
        felt = self._front.view.felt | {part.name} if is_felt else self._front.view.felt - {part.name}
        self._front.view = replace(self._front.view, felt=felt, playing="")
        self._possible_s = self._clock()


def _find_end(wish: Wish) -> Pause | Abort | None:
    """Tell whether a wish ends the trial."""
    if wish.name == "close":
        return Abort(wish.time_s, CLOSED)
    return Pause(wish.time_s) if wish.name == "pause" else None
