"""What is on the screen now, frame by frame, and what the participant wants by key or mouse."""

from __future__ import annotations

from collections import deque
from dataclasses import replace
from typing import TYPE_CHECKING

from study.screen.desk import Wish
from study.screen.events import Click, Closed, Hidden, Press
from study.screen.keyboard import Twice
from study.screen.layout import compose
from study.screen.shapes import Composition
from study.screen.views import View
from study.session.ports import Place

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from study.screen.desk import Desk
    from study.screen.events import Event
    from study.screen.shapes import Target
    from study.screen.views import Hand
    from study.screen.window import Window
    from study.screen.wording import ScreenTexts

DOUBLE_S = 0.4
"""Within that a second click is the other half of a double one: it leaves one page, not two."""


class Front:
    """Shows views and turns events into wishes.

    Parameters
    ----------
    window : Window
        The window, open.
    texts : ScreenTexts
        What participants read.
    clock : callable
        Gives the time in s since the session began.
    hand : Hand
        Whoever watches the screen.
    """

    def __init__(self, window: Window, texts: ScreenTexts, *, clock: Callable[[], float], hand: Hand) -> None:
        self.window, self._texts, self._clock, self._hand = window, texts, clock, hand
        self.view = View("page", "reading", 0, Place(0, 0))
        self.notice = ""
        self._desk: Desk | None = None
        self._twice = Twice()
        self._confirmed_s = -DOUBLE_S
        self._events: deque[Event] = deque()
        self._composed: tuple[View, Composition] = (self.view, Composition(()))

    def bring_up(self, view: View, desk: Desk | None = None) -> None:
        """Begin a screen: nothing of the last one is left, no key that was pressed on it counts for this one.

        Parameters
        ----------
        view : View
            What is on it.
        desk : Desk, optional
            Where the answer takes shape; none on a page.
        """
        self.view, self.notice, self._desk = view, "", desk
        self._events.clear()
        self._twice = Twice()
        self.show_frame()

    def find_desk(self) -> Desk:
        """Give the desk of the trial on the screen.

        Returns
        -------
        Desk
            Where the answer takes shape.

        Raises
        ------
        ValueError
            If there is no trial on the screen.
        """
        if self._desk is None:
            raise ValueError("got no trial; show one before it is answered")
        return self._desk

    def listen(self) -> Iterator[Wish]:
        """Show a frame, and tell what the participant wants; what is left of a frame waits for who listens next.

        Yields
        ------
        Wish
            What the participant wants, in order.
        """
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
        return next((t for t in self._composed[1].targets if t.box.contains(event.x, event.y)), None)

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
        return replace(view, markers=desk.markers.values, selected=desk.selected, chosen=desk.chosen, typed=desk.typed)
