"""A rehearsal by hand in a browser: the engine and the presenter of a real session, before a window that is a page.

The page shows what the window is given, and sends back keys and clicks; vibrations are played as sound.
"""

from __future__ import annotations

import json
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from math import isfinite
from queue import Empty, SimpleQueue
from time import perf_counter
from typing import TYPE_CHECKING, Any, cast

from feel321.analysis.page import render_template
from feel321.study.monitor.media import SoundBank, read_words, write_svg
from feel321.study.monitor.replay import PAGE_SIZE, mark_sheet, prepare_rehearsal, run_rehearsal
from feel321.study.monitor.server import serve_pages
from feel321.study.screen.drawing import GROUND, Sheet
from feel321.study.screen.input import InputEvent
from feel321.study.screen.presenter import ScreenPresenter
from feel321.study.screen.window import FRAME_S, FrameCounts
from feel321.study.session.ports import Playback

if TYPE_CHECKING:
    from feel321.stimuli.sets.manifest import Stimulus
    from feel321.study.folder import StudyFolder
    from feel321.study.monitor.replay import Rehearsal
    from feel321.study.screen.drawing import Item
    from feel321.study.screen.window import Window
    from feel321.study.session.journal import Clock
    from feel321.study.session.ports import Scaled, Tone

POLL_S = 1.0
"""How long the page waits for another screen before it asks again."""

KINDS = frozenset({"press", "release", "text", "click", "drag", "unfocused"})
"""What a page may send."""


@dataclass(slots=True)
class BrowserWindow:
    """A window that is a page: what `screen.window.Window` is to the presenter."""

    clock: Callable[[], float]
    size: tuple[int, int] = PAGE_SIZE
    frames: FrameCounts = field(default_factory=FrameCounts)
    _shown: tuple[Item, ...] = ()
    _state: dict[str, Any] = field(default_factory=lambda: {"version": 0})
    _changed: threading.Condition = field(default_factory=threading.Condition)
    _events: SimpleQueue[InputEvent] = field(default_factory=SimpleQueue)

    def show(self, items: Sequence[Item]) -> list[InputEvent]:
        """Show items for a frame, and collect what is done in it."""
        if (items := tuple(items)) != self._shown:
            self._shown = items
            sheet = Sheet(*self.size, [*items])
            mark_sheet(sheet)
            self.change(svg="".join(map(write_svg, sheet.items)), words=read_words(sheet.items))
        events: list[InputEvent] = []
        try:
            events.append(self._events.get(timeout=FRAME_S))
            while True:
                events.append(self._events.get_nowait())
        except Empty:
            return events

    def change(self, **values: object) -> None:
        """Change what the page shows or plays."""
        with self._changed:
            self._state = {**self._state, **values, "version": self._state["version"] + 1}
            self._changed.notify_all()

    def write_state(self, _nonce: str, query: Mapping[str, str]) -> tuple[str, str]:
        """Write what is to be shown, once it is newer than what the page has."""
        after = query.get("after", "")
        with self._changed:
            self._changed.wait_for(lambda: str(self._state["version"]) != after, timeout=POLL_S)
            return "application/json", json.dumps(self._state)

    def take(self, body: bytes) -> None:
        """Take what was done on the page; what is no such thing is left out."""
        try:
            done = json.loads(body)
            x, y = float(done.get("x", 0.0)), float(done.get("y", 0.0))
            kind, key = done["kind"], done.get("key", "")
            is_known = kind in KINDS and isinstance(key, str) and isfinite(x) and isfinite(y)
        except (
            ArithmeticError,
            AttributeError,
            LookupError,
            RecursionError,
            TypeError,
            ValueError,
        ):
            return
        if is_known:
            self._events.put(InputEvent(kind, self.clock(), key, x, y))


@dataclass(slots=True)
class BrowserOutput:
    """Plays vibrations as sound on a page, each for as long as it lasts."""

    window: BrowserWindow
    bank: SoundBank
    strongest: float
    lead_s: float = 0.0
    identity: Mapping[str, Any] = field(default_factory=dict)
    _count: int = 0
    _began_s: float = 0.0
    _ends_s: float = 0.0
    _was_stopped: bool = False

    def start(
        self,
        stimulus: Stimulus | Tone | Scaled,
        *,
        gap_s: float,
        goes_on: bool = False,  # noqa: ARG002 - the form of an output
    ) -> None:
        """Schedule silence, then a stimulus."""
        self._began_s = self.window.clock() + gap_s
        self._ends_s, self._was_stopped = self._began_s + stimulus.duration_s, False
        self._count += 1
        if sound := self.bank.add(stimulus):
            key, peak = sound
            gain = min(1.0, peak / self.strongest)
            wav = self.bank.sounds[key]
            self.window.change(
                sound={"id": self._count, "wav": wav, "gain": gain, "delay": gap_s}, stopped=0
            )

    @property
    def is_playing(self) -> bool:
        """Whether the stimulus is not over yet."""
        return self.window.clock() < self._ends_s

    def stop(self) -> None:
        """Fall silent."""
        if self.is_playing:
            self._ends_s, self._was_stopped = self.window.clock(), True
            self.window.change(stopped=self._count)

    def collect(self) -> Playback:
        """Report what became of the stimulus."""
        return Playback(self._began_s, self._began_s, completed=not self._was_stopped)


def serve_rehearsal(
    study: StudyFolder, *, trials: int, now: Clock, announce: Callable[[str], None]
) -> None:
    """Lead through a rehearsal by hand, in a browser, until Ctrl-C."""
    rehearsal = prepare_rehearsal(study, trials=trials)
    start_s = perf_counter()
    window = BrowserWindow(lambda: perf_counter() - start_s)
    page = render_template(
        "rehearse.html",
        nonce="@nonce@",
        study=rehearsal.settings.study.name,
        size=PAGE_SIZE,
        ground=GROUND,
    )
    threading.Thread(target=_lead, args=(rehearsal, window, now), daemon=True).start()
    pages = {
        "/": lambda nonce, _query: ("text/html", page.replace("@nonce@", nonce)),
        "/screen.json": window.write_state,
    }
    serve_pages("127.0.0.1", 0, pages, announce=announce, acts={"/act": window.take})


def _lead(rehearsal: Rehearsal, window: BrowserWindow, now: Clock) -> None:
    """Lead through the session, and say that it is over."""
    cast_ = rehearsal.cast
    bank = SoundBank(rehearsal.study.stimuli, rehearsal.settings.rig.full_scale_m_s2)
    named = {part.stimulus_id or "" for trial in cast_.plan.trials for part in trial.parts}
    sounds = [bank.add(cast_.stimuli[name]) for name in named if name in cast_.stimuli]
    strongest = max((sound[1] for sound in sounds if sound), default=1.0)
    presenter = ScreenPresenter(
        cast("Window", window),
        BrowserOutput(window, bank, strongest),
        cast_.texts,
        clock=window.clock,
        surfaces=cast_.surfaces,
    )
    try:
        run_rehearsal(rehearsal, presenter, now=now)
        window.change(over="The rehearsal is over. Nothing was stored.")
    except Exception as error:  # noqa: BLE001 - whatever it is, the page says so
        window.change(over=f"The rehearsal ended: {error}")
