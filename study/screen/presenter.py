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
from study.screen.player import Player, find_end
from study.screen.views import Hand, View
from study.session.ports import Abort, Confirm, Feel
from study.settings.sources import Surface

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    from protocols.flow import Page
    from protocols.trial import Part, Scale, Trial
    from stimuli.manifest import Stimulus
    from study.actuator.output import Output
    from study.screen.desk import Wish
    from study.screen.window import Window
    from study.screen.wording import ScreenTexts
    from study.session.ports import Act, Pause, Place, Playback

LEFT = "the participant ended it for today"
NOT_AT_HAND = Surface(None, None)


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
        self._texts, self._clock, self._surfaces = texts, clock, surfaces
        self._acts: deque[Act] = deque()
        self._player = Player(self._front, output, clock=clock, acts=self._acts)
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
            self._front.view = replace(self._front.view, left_s=ceil(max(0.0, page.least_s - self._clock() + shown_s)))
            for wish in self._front.listen():
                stood_s = max(0.0, wish.time_s - shown_s)
                if (end := find_end(wish)) is not None and self._front.view.can_leave:
                    return Abort(wish.time_s, end.reason if isinstance(end, Abort) else LEFT)
                if wish.name in {"confirm", "close"} and stood_s >= page.least_s:
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
        surface = self._surfaces.get(trial.recording, NOT_AT_HAND)
        view = View(desk.kind, "feeling", self._front.view.screen + 1, place, trial=trial, scale=scale)
        self._front.bring_up(replace(view, picture=surface.picture, sample=surface.sample or ""), desk)
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
        return self._begin_answer(self._player.play(part, stimulus, gap_s=gap_s))

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
        return self._begin_answer(self._player.prompt(part))

    def wait(self) -> Act:
        """Wait for the participant's next act on the trial that is shown.

        Returns
        -------
        Feel, Move, Confirm, Pause or Abort
            What the participant did.
        """
        self._front.view = replace(self._front.view, state="answering", playing="")
        desk = self._front.find_desk()
        while not self._acts:
            for wish in self._front.listen():
                self._acts.extend(_answer(wish, desk, possible_s=self._possible_s))
            self._acts.extend(desk.markers.settle(self._clock()))
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
