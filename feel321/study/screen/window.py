"""The window that PsychoPy opens, and the keys, clicks and signals that reach it. The only module that knows PsychoPy.

PsychoPy is imported when a window is opened, which takes one to eight seconds. Only its window, text, polygons and
pictures are used; its Slider cannot be moved by keys. Its Keyboard stamps keys more finely than the window, but reads
the devices themselves: what the experimenter types in the terminal would answer for the participant.

Python raises what Ctrl-C means wherever it happens to be: in the middle of a record of the journal, or in a callback
of the window system, where the exception is printed and lost. While a screen is open, the first signal waits until a
frame is over; the second one does what it does elsewhere, at once.
"""

import os
import signal
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from itertools import count
from math import cos, pi, sin
from typing import Any

from feel321.study.screen import sheet
from feel321.study.screen.input import InputEvent

Foreign = Any  # PsychoPy has no types

FRAME_S = 1 / 60  # shortest time for a frame; a slower screen decides for itself
POLL_S = 0.0015  # how often events are collected between frames
REDRAW_S = 0.5  # what has not changed is drawn again, in case something covered it
REPEAT_S = 0.003  # shortest time between two presses: X repeats held keys faster
WINDOW_SIZE = (1280, 800)  # default size of a window, in pixels
DESTROY_NOTIFY = 17  # X11's number of the event that a window was destroyed
HELD = (signal.SIGINT, signal.SIGTERM)

ALIASES = {
    "return": "enter", "page_up": "pageup", "page_down": "pagedown", "add": "plus", "subtract": "minus",
    "divide": "slash", "decimal": "period",
}  # fmt: skip


def name_key(symbol: str) -> str:
    """Name a key, the same on the main block and on the number block."""
    name = symbol.lower().removeprefix("num_").removeprefix("_")
    return ALIASES.get(name, name)


def drop_repeats(events: list[InputEvent]) -> list[InputEvent]:
    """Leave out the releases and presses that a held key makes up."""
    kept: list[InputEvent] = []
    for event in events:
        last = kept[-1] if kept else event
        is_pair = (last.kind, event.kind) == ("release", "press") and last.key == event.key
        if is_pair and event.time_s - last.time_s < REPEAT_S:
            kept.pop()
        else:
            kept.append(event)
    return kept


@contextmanager
def hold_signals() -> Iterator[Callable[[], None]]:
    """Hold Ctrl-C and SIGTERM until the function given is called; only the main thread receives signals."""
    is_main = threading.current_thread() is threading.main_thread()
    known: dict[int, Any] = {number: signal.getsignal(number) for number in HELD if is_main}
    before = {number: handler for number, handler in known.items() if callable(handler)}
    numbers, waiting = count(), list[int]()

    def hold(number: int, frame: object) -> None:
        if next(numbers) == 0:
            waiting.append(number)
        else:
            before[number](number, frame)

    def deliver() -> None:
        if waiting:
            number = waiting.pop()
            before[number](number, None)

    for number in before:
        signal.signal(number, hold)
    try:
        yield deliver
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


class Window:
    """A window that shows items and collects events; clock: gives the time in s since the session began."""

    def __init__(
        self, handle: Foreign, clock: Callable[[], float], deliver_signals: Callable[[], None]
    ) -> None:
        self.handle, self._clock, self._deliver_signals = handle, clock, deliver_signals
        self.drawn: dict[sheet.Item, Foreign] = {}  # PsychoPy's objects of what is shown
        self.late_frames = 0
        self._events: list[InputEvent] = []
        self._shown: tuple[sheet.Item, ...] = ()
        self._due_s = self._redraw_s = 0.0
        self._is_closed = False

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in pixels."""
        width, height = self.handle.size
        return int(width), int(height)

    def show(self, items: Sequence[sheet.Item]) -> list[InputEvent]:
        """Show items for a frame, and collect what is done in it."""
        items, began = tuple(items), time.perf_counter()
        if not self._is_closed and (items != self._shown or began > self._redraw_s):
            try:
                self.handle.winHandle.switch_to()  # only then does pyglet free what texts of former screens took
                # The objects of what is not shown any longer are let go.
                self.drawn = {item: self.drawn.get(item) or self._make(item) for item in items}
                for stimulus in self.drawn.values():
                    stimulus.draw()
                self.handle.flip()
            except _list_graphics_errors():
                # Drawing fails in many ways when the window was destroyed without being asked to close.
                self._is_closed = True
            if items != self._shown:
                self.late_frames += time.perf_counter() - began > 1.5 * FRAME_S
            self._shown, self._redraw_s = items, began + REDRAW_S
        self._due_s = max(self._due_s + FRAME_S, time.perf_counter())
        self.handle.winHandle.dispatch_events()
        while (left_s := self._due_s - time.perf_counter()) > 0:
            time.sleep(min(POLL_S, left_s))
            self.handle.winHandle.dispatch_events()
        self._deliver_signals()
        if self._is_closed:
            # With every frame: who shows another screen meanwhile must not miss it.
            self._events.append(InputEvent("closed", self._clock()))
        events, self._events = drop_repeats(self._events), []
        return events

    def _make(self, item: sheet.Item) -> Foreign:
        from psychopy.visual.image import ImageStim
        from psychopy.visual.shape import BaseShapeStim
        from psychopy.visual.text import TextStim

        def turn_up(x: float, y: float) -> tuple[float, float]:
            """Count from the middle, upwards, as PsychoPy does."""
            width, height = self.handle.size
            return x - width / 2, height / 2 - y

        box = item.box
        middle_x, middle_y = box.left + box.width / 2, box.top + box.height / 2
        if isinstance(item, sheet.Photo):
            image = ImageStim(self.handle, str(item.path), pos=turn_up(middle_x, middle_y))
            width, height = image.size
            scale = min(box.width / width, box.height / height)
            image.size = width * scale, height * scale
            return image
        if isinstance(item, sheet.Area):
            box = box.grow(-item.line_px / 2) if item.line else box
            reach = min(item.round_px, box.width / 2, box.height / 2)
            inner = box.grow(-reach)
            lefts = (inner.right, inner.right, inner.left, inner.left)
            tops = (inner.top, inner.bottom, inner.bottom, inner.top)
            corners = [
                turn_up(x + reach * sin(angle), y - reach * cos(angle))
                for turn, (x, y) in enumerate(zip(lefts, tops, strict=True))
                for angle in (pi / 2 * (turn + step / 8) for step in range(9 if reach else 1))
            ]
            colors = {"fillColor": item.fill or None, "lineColor": item.line or None}
            return BaseShapeStim(self.handle, vertices=corners, lineWidth=item.line_px, **colors)
        x = {"left": box.left, "right": box.right}.get(item.align, middle_x)
        return TextStim(
            self.handle,
            item.words,
            font=sheet.FONT,
            bold=item.bold,
            height=item.size,
            color=item.color,
            pos=turn_up(round(x), round(middle_y)),
            anchorHoriz=item.align,
            alignText=item.align,
            anchorVert="center",
            wrapWidth=10 * self.handle.size[0],  # lines were broken by the layout
        )

    def listen(self) -> None:
        """Collect the window's events from now on; PsychoPy's own lists of them would grow for hours."""
        from pyglet.window import key as keys

        inner = self.handle.winHandle

        # Handlers that return True are the last to receive an event.
        def take(kind: Any, key: str = "", *, x: float = 0.0, y: float = 0.0) -> bool:  # noqa: ANN401 - a kind of InputEvent
            self._events.append(InputEvent(kind, self._clock(), key, x, y))
            return True

        def strike(kind: str, symbol: int | None) -> bool:
            # macOS has no symbol for keys such as ä.
            return take(kind, name_key(keys.symbol_string(symbol)) if symbol else "")

        def point(kind: str, x: float, y: float) -> bool:
            (width, height), size = inner.get_size(), self.size
            return take(kind, x=x * size[0] / width, y=(height - y) * size[1] / height)

        def end(*_: object) -> bool:
            self._is_closed = True
            return True  # the window stays until the session has let go of it

        inner.push_handlers(
            on_key_press=lambda symbol, _: strike("press", symbol),
            on_key_release=lambda symbol, _: strike("release", symbol),
            on_text=lambda text: (
                not text.isprintable() or take("text", text)
            ),  # Enter is a text too
            on_text_motion=lambda motion: (
                motion != keys.MOTION_BACKSPACE or take("text", "backspace")
            ),
            on_mouse_press=lambda x, y, *_: point("click", x, y),
            on_mouse_drag=lambda x, y, *_: point("drag", x, y),
            on_deactivate=lambda: take("unfocused"),
            on_hide=lambda: take("hidden"),
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
    size: tuple[int, int] = WINDOW_SIZE,
    screen: int = 0,
) -> Iterator[Window]:
    """Open the participants' window, and close it whatever happens; clock: in s since the session began."""
    with _needing_display():
        from psychopy import logging, monitors, visual  # looks for a display already here

        # It warns of what is meant: no monitor is calibrated.
        logging.console.setLevel(logging.ERROR)
        handle = visual.Window(
            size=size,
            fullscr=not windowed,
            screen=screen,
            winType="pyglet",
            allowGUI=windowed,
            units="pix",
            monitor=monitors.Monitor("feel321", width=60, distance=100),
            color=sheet.GROUND,
            checkTiming=False,
            # Nearly all edges are straight, and where a processor draws it doubles a frame's time.
            multiSample=False,
        )
    from pyglet import font

    for file in sheet.find_font_files():
        font.add_file(str(file))
    handle.mouseVisible = True
    with hold_signals() as deliver_signals:
        window = Window(handle, clock, deliver_signals)
        try:
            window.listen()
            yield window
        finally:
            with suppress(*_list_graphics_errors()):  # it may be gone already
                handle.close()


def check_screen(screen: int) -> None:
    """Refuse a number that no monitor has: PsychoPy would take the first one instead, with a warning."""
    with _needing_display():
        from pyglet.canvas import get_display

        monitors = get_display().get_screens()  # numbered as PsychoPy numbers them
    if screen not in range(len(monitors)):
        listed = ", ".join(f"{n} ({one.width} x {one.height})" for n, one in enumerate(monitors))
        raise ValueError(f"--screen must be one of the monitors found: {listed}; got {screen}")


@contextmanager
def _needing_display() -> Iterator[None]:
    """Say in our words that there is no display; whatever else an error is, it is left alone."""
    try:
        yield
    except Exception as error:
        if type(error).__name__ != "NoSuchDisplayException":
            raise
        display = os.environ.get("DISPLAY")
        raise OSError(
            f"no display found (DISPLAY is {display!r}); use one on which windows can be opened"
        ) from None


def _list_graphics_errors() -> tuple[type[Exception], ...]:
    from pyglet.gl.lib import GLException
    from pyglet.window import WindowException

    return GLException, WindowException
