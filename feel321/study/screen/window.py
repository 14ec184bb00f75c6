"""The window that PsychoPy opens. The only module that knows PsychoPy.

PsychoPy is imported when a window is opened: that takes one to two seconds from a warm disk and up to eight from a
cold one. Of it only the window, text, polygons and pictures are used; its Slider cannot be moved by keys.

Keys are read from the window's own events. PsychoPy's Keyboard stamps them more finely, by reading the devices
themselves, but so it also hears what is typed into any other window: what the experimenter types in the terminal would
answer for the participant. (Under Xvfb it heard none of 20 keys, the window all of them.) Events are collected every
millisecond or two between frames, and stamped by the session's own clock.
"""

from __future__ import annotations

import os
import time
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from feel321.study.screen.drawing import FONT, GROUND, Area, Text, find_font_files, round_corners
from feel321.study.screen.input import (
    Click,
    Closed,
    Drag,
    Hidden,
    Press,
    Release,
    Unfocused,
    drop_repeats,
    hold_signals,
    name_key,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence
    from pathlib import Path

    from feel321.study.screen.drawing import Item, Picture
    from feel321.study.screen.input import Event

FRAME_S = 1 / 60
"""How long a frame stands at least; a screen that is slower decides for itself."""

POLL_S = 0.0015
"""How often events are collected between frames."""

WINDOW_SIZE = (1280, 800)
"""Size in pixels of a window that nobody gave one."""

DESTROY_NOTIFY = 17
"""X11's number of the event that a window was destroyed."""

REDRAW_S = 0.5
"""What has not changed is drawn so often again, should something have covered it."""


@dataclass(slots=True)
class Frames:
    """How frames went."""

    shown: int = 0
    late: int = 0
    longest_s: float = 0.0

    def count(self, took_s: float) -> None:
        """Take one frame into account."""
        self.shown += 1
        self.late += took_s > 1.5 * FRAME_S
        self.longest_s = max(self.longest_s, took_s)


@dataclass(slots=True)
class Easel:
    """Makes PsychoPy's objects of items, and keeps them as long as they are shown."""

    handle: Any
    drawn: dict[Item, Any] = field(default_factory=dict, init=False)

    def find_stimuli(self, items: tuple[Item, ...]) -> list[Any]:
        """Give PsychoPy's objects for items; those that are not shown any longer are let go."""
        self.drawn = {item: self.drawn.get(item) or self._make_stimulus(item) for item in items}
        return list(self.drawn.values())

    def _make_stimulus(self, item: Item) -> Any:  # noqa: ANN401 - PsychoPy has no types
        match item:
            case Text():
                return self._make_text(item)
            case Area():
                return self._make_area(item)
            case _:
                return self._make_picture(item)

    def _make_text(self, text: Text) -> Any:  # noqa: ANN401 - PsychoPy has no types
        from psychopy.visual.text import TextStim

        x = {"left": text.box.left, "right": text.box.right}.get(
            text.align, text.box.left + text.box.width / 2
        )
        return TextStim(
            self.handle,
            text.words,
            font=FONT,
            bold=text.bold,
            height=text.size,
            color=text.color,
            pos=self._turn_up(round(x), round(text.box.top + text.box.height / 2)),
            anchorHoriz=text.align,
            alignText=text.align,
            anchorVert="center",
            wrapWidth=10 * self.handle.size[0],  # lines were broken by the layout
        )

    def _make_area(self, area: Area) -> Any:  # noqa: ANN401 - PsychoPy has no types
        from psychopy.visual.shape import BaseShapeStim

        box = area.box.grow(-area.line_px / 2) if area.line else area.box
        return BaseShapeStim(
            self.handle,
            vertices=[self._turn_up(x, y) for x, y in round_corners(box, area.round_px)],
            fillColor=area.fill or None,
            lineColor=area.line or None,
            lineWidth=area.line_px,
        )

    def _make_picture(self, picture: Picture) -> Any:  # noqa: ANN401 - PsychoPy has no types
        from psychopy.visual.image import ImageStim

        box = picture.box
        image = ImageStim(
            self.handle,
            str(picture.path),
            pos=self._turn_up(box.left + box.width / 2, box.top + box.height / 2),
        )
        width, height = image.size
        image.size = tuple(
            side * min(box.width / width, box.height / height) for side in (width, height)
        )
        return image

    def _turn_up(self, x: float, y: float) -> tuple[float, float]:
        """Count from the middle, upwards, as PsychoPy does."""
        width, height = self.handle.size
        return x - width / 2, height / 2 - y


@dataclass(slots=True)
class Window:
    """A window that shows items and collects events.

    clock: gives the time in s since the session began.
    """

    handle: Any
    clock: Callable[[], float]
    heed_signals: Callable[[], None]
    frames: Frames = field(default_factory=Frames, init=False)
    easel: Easel = field(init=False)
    _events: list[Event] = field(default_factory=list, init=False)
    _shown: tuple[Item, ...] = field(default=(), init=False)
    _due_s: float = field(default=0.0, init=False)
    _redraw_s: float = field(default=0.0, init=False)
    _is_closed: bool = field(default=False, init=False)

    def __post_init__(self) -> None:
        """Take an easel of its own."""
        self.easel = Easel(self.handle)

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in pixels."""
        width, height = self.handle.size
        return int(width), int(height)

    def show(self, items: Sequence[Item]) -> list[Event]:
        """Show items for a frame, and collect what is done in it."""
        items = tuple(items)
        began = time.perf_counter()
        if not self._is_closed and (items != self._shown or began > self._redraw_s):
            self._draw(items)
            if items != self._shown:
                self.frames.count(time.perf_counter() - began)
            self._shown, self._redraw_s = items, began + REDRAW_S
        self._await_frame()
        self.heed_signals()
        if self._is_closed:
            # Said with every frame: whoever brings up another screen meanwhile must not miss it.
            self._events.append(Closed(self.clock()))
        events, self._events = drop_repeats(self._events), []
        return events

    def capture(self, path: Path) -> None:
        """Save what is on the screen as a picture."""
        for stimulus in self.easel.find_stimuli(self._shown):
            stimulus.draw()
        self.handle.getMovieFrame(buffer="back")  # the front buffer reads black under Xvfb
        self.handle.flip()
        self.handle.saveMovieFrames(str(path))
        self.handle.movieFrames = []

    def close(self) -> None:
        """Close the window; it may be gone already."""
        with suppress(*_list_graphics_errors()):
            self.handle.close()

    def _draw(self, items: tuple[Item, ...]) -> None:
        try:
            self.handle.winHandle.switch_to()  # only then does pyglet free what texts of former screens took
            for stimulus in self.easel.find_stimuli(items):
                stimulus.draw()
            self.handle.flip()
        except _list_graphics_errors():
            # Drawing fails in many ways when the window was destroyed without being asked to close.
            self._is_closed = True

    def _await_frame(self) -> None:
        """Collect events until the frame is over."""
        self._due_s = max(self._due_s + FRAME_S, time.perf_counter())
        while True:
            self.handle.winHandle.dispatch_events()
            left_s = self._due_s - time.perf_counter()
            if left_s <= 0:
                return
            time.sleep(min(POLL_S, left_s))

    def listen(self) -> None:
        """Collect the window's events from now on; PsychoPy's own lists of them would grow for hours."""
        from pyglet.window import key as keys

        inner = self.handle.winHandle

        def locate(x: float, y: float) -> tuple[float, float]:
            width, height = inner.get_size()
            return x * self.size[0] / width, (height - y) * self.size[1] / height

        def take(event: Event) -> bool:
            self._events.append(event)
            return True  # handled: nobody else is told

        def end(*_: object) -> bool:
            self._is_closed = True
            return True  # handled: the window stays until the session has let go of it

        inner.push_handlers(
            on_key_press=lambda symbol, _: take(
                Press(name_key(keys.symbol_string(symbol)), self.clock())
            ),
            on_key_release=lambda symbol, _: take(
                Release(name_key(keys.symbol_string(symbol)), self.clock())
            ),
            on_mouse_press=lambda x, y, *_: take(Click(*locate(x, y), self.clock())),
            on_mouse_drag=lambda x, y, *_: take(Drag(*locate(x, y), self.clock())),
            on_deactivate=lambda: take(Unfocused(self.clock())),
            on_hide=lambda: take(Hidden(self.clock())),
            on_close=end,
        )
        if (own := getattr(inner, "_event_handlers", None)) is not None:
            # A window that is destroyed from outside is never asked to close. X11 says so; pyglet does not pass it on.
            own[DESTROY_NOTIFY] = end


@contextmanager
def open_screen(
    *,
    clock: Callable[[], float],
    windowed: bool = False,
    size: tuple[int, int] | None = None,
    screen: int = 0,
) -> Iterator[Window]:
    """Open the window that participants look at, and close it whatever happens.

    clock: gives the time in s since the session began; size: width and height of a window, in
    pixels; screen: which screen, from 0.
    """
    handle = _open_handle(windowed=windowed, size=size or WINDOW_SIZE, screen=screen)
    with hold_signals() as heed_signals:
        window = Window(handle, clock, heed_signals)
        try:
            window.listen()
            yield window
        finally:
            window.close()


def _open_handle(*, windowed: bool, size: tuple[int, int], screen: int) -> Any:  # noqa: ANN401 - PsychoPy has no types
    try:
        handle = _make_handle(windowed=windowed, size=size, screen=screen)
    except Exception as error:
        if type(error).__name__ != "NoSuchDisplayException":
            raise
        display = os.environ.get("DISPLAY")
        raise OSError(
            f"got no display (DISPLAY is {display!r}), needed is one that windows can be opened on"
        ) from None
    for file in find_font_files():
        _add_font(str(file))
    handle.mouseVisible = True
    return handle


def _make_handle(*, windowed: bool, size: tuple[int, int], screen: int) -> Any:  # noqa: ANN401 - PsychoPy has no types
    from psychopy import logging, monitors, visual  # looks for a display already here

    logging.console.setLevel(logging.ERROR)  # it warns of what is meant: no monitor is calibrated
    return visual.Window(
        size=size,
        fullscr=not windowed,
        screen=screen,
        winType="pyglet",
        allowGUI=windowed,
        units="pix",
        monitor=monitors.Monitor("feel321", width=60, distance=100),
        color=GROUND,
        checkTiming=False,
        multiSample=False,  # nearly all edges are straight, and where a processor draws it doubles a frame's time
    )


def _add_font(file: str) -> None:
    from pyglet import font

    font.add_file(file)


def _list_graphics_errors() -> tuple[type[Exception], ...]:
    from pyglet.gl.lib import GLException
    from pyglet.window import WindowException

    return GLException, WindowException
