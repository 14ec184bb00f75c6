"""Leads a participant through steps with a real window and a silent output, and tells on stdout what happens.

Run on a display: lead.py. A line of JSON says what to show, with `steps`, `size`, `language` and more, see `main`; what
follows are orders. When that is over, it waits for the next one, for importing PsychoPy takes longer than most tests.
"""

import json
import queue
import threading
import time
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from runpy import run_path
from types import SimpleNamespace
from typing import Any

from feel321.protocols.tasks import make_task
from feel321.protocols.texts import read_scales, read_texts
from feel321.protocols.trial import Flow, Page
from feel321.study.screen.input import View, make_screen_texts
from feel321.study.screen.layout import compose
from feel321.study.screen.presenter import ScreenPresenter
from feel321.study.screen.window import Window, open_screen
from feel321.study.session.engine import Session, Stopped
from feel321.study.session.events import SessionEvent
from feel321.study.session.journal import Records
from feel321.study.session.ports import Place, Playback, Surface

gallery = run_path(str(Path(__file__).with_name("gallery.py")))


def tell(**words: Any) -> None:
    print(json.dumps(words), flush=True)  # noqa: T201 - the test reads this


class Clock:
    """The session's clock; a test may hold it, so that nothing is over before somebody slow has done something."""

    def __init__(self) -> None:
        self.restart()

    def restart(self) -> None:
        self._began_s, self._held_s = time.perf_counter(), None

    def __call__(self) -> float:
        return (time.perf_counter() if self._held_s is None else self._held_s) - self._began_s

    def hold(self) -> None:
        self._held_s = self._began_s + self()

    def go_on(self) -> None:
        if self._held_s is not None:
            self._began_s += time.perf_counter() - self._held_s
            self._held_s = None


clock = Clock()
ORDERS = {"hold": clock.hold, "go on": clock.go_on, "look": lambda: None}


given: queue.SimpleQueue[str] = queue.SimpleQueue()
"""The lines that were read, and an empty one at their end."""


def read() -> None:
    # A buffer would be locked at the end.
    with open(0, "rb", buffering=0, closefd=False) as lines:
        for line in lines:
            given.put(line.decode().strip())
    given.put("")


def await_spec() -> str:
    """Wait for what to show next; orders that came too late for the last screen are dropped."""
    while (line := given.get()) and not line.startswith("{"):
        pass
    return line


class Orders:
    """What a test asks for, one word a line; obeyed between two frames, and told when the next frame is over."""

    def __init__(self) -> None:
        self._obeyed: list[str] = []

    def obey(self) -> None:
        for order in self._obeyed:
            tell(obeyed=order)
        self._obeyed.clear()
        while not given.empty() and (line := given.get()):
            self._obeyed.append(line)
            ORDERS[line]()


class SilentOutput:
    """Plays nothing for as long as it is told to."""

    def __init__(self, duration_s: float) -> None:
        self.duration_s = duration_s
        self.began_s = self.ends_s = 0.0
        self.was_stopped = False

    def start(self, stimulus: Any, *, gap_s: float, goes_on: bool = False) -> None:  # noqa: ARG002 - the form of an output
        tell(goes_on=goes_on)
        self.began_s = clock() + gap_s
        self.ends_s = self.began_s + self.duration_s
        self.was_stopped = False

    @property
    def is_playing(self) -> bool:
        return clock() < self.ends_s

    def stop(self) -> None:
        if self.is_playing:
            self.was_stopped, self.ends_s = True, clock()
            tell(stopped=clock())

    def collect(self) -> Playback:
        tell(collected=clock())
        return Playback(
            self.began_s, self.began_s, completed=not self.was_stopped, measured={"dac_time_s": 1.0}
        )


class Watcher:
    """Tells what is on the screen whenever that changes, and what can be clicked."""

    def __init__(self, texts: Any, window: Window) -> None:
        self.texts, self.window, self.last = texts, window, None
        self.orders = Orders()

    def feel(self, *_: Any) -> None:
        """Feel nothing."""

    def watch(self, view: View) -> tuple[()]:
        self.orders.obey()
        if view == self.last:
            return ()
        self.last = view
        targets = compose(view, self.texts, size=self.window.size).targets
        tell(
            view={
                **{
                    name: getattr(view, name)
                    for name in ("kind", "state", "screen", "playing", "notice", "typed")
                },
                **{name: getattr(view, name) for name in ("selected", "chosen", "left_s", "loops")},
                "page": view.page.key if view.page else "",
                "felt": sorted(view.felt),
                "markers": dict(view.markers),
                "targets": {
                    f"{t.name} {t.part}".strip(): (t.track or t.box)._asdict() for t in targets
                },
            },
            time_s=clock(),
        )
        return ()


class Journal:
    """Tells what would be written."""

    records = Records()

    def write(self, event: SessionEvent) -> None:
        tell(event=event.event, **event.to_data())


def conduct(step: dict[str, Any], session: Session) -> None:
    if "page" in step:
        session._conduct_page(Page(**{"key": step.pop("page"), **step}), Place(12, 80))
    else:
        session._run_attempt(gallery["make_trial"](step.pop("trial"), **step), Place(12, 80))


def main(spec: dict[str, Any]) -> bool:
    """Lead through what a test wants; returns whether the window was ours to the end, so that another may be opened."""
    clock.restart()
    if spec.get("held"):
        clock.hold()
    tables = read_texts(spec.get("language", "en"))
    texts, scales = make_screen_texts(tables), read_scales(spec.get("language", "en"))
    output = SilentOutput(spec.get("duration_s", 0.3))
    picture = Path(spec["picture"]) if "picture" in spec else None
    surfaces = {"felt": Surface("Cotton", picture)}
    with open_screen(
        clock=clock, windowed=spec.get("windowed", False), size=spec.get("size")
    ) as window:
        watcher = Watcher(texts, window)
        presenter = ScreenPresenter(
            window, output, texts, clock=clock, surfaces=surfaces, hand=watcher
        )
        limits = spec.get("limits_s", {}).items()
        tasks = {name: replace(make_task(name), answer_timeout_s=limit) for name, limit in limits}
        stimuli = dict.fromkeys(f"s{n}" for n in range(13))
        plan: Any = SimpleNamespace(
            flow=Flow(gap_s=0.1),
            tasks=tuple(tasks.values()),
            trials=(),
            questions=(),
            threshold=None,
            matching=None,
        )
        session = Session(plan, presenter, Journal(), stimuli=stimuli, scales=scales)
        try:
            for step in spec["steps"]:
                conduct(step, session)
        except Stopped as stop:
            tell(event="ended", reason=stop.args[0])
        finally:
            tell(late_frames=window.late_frames)
    tell(event="closed")
    return not window._is_closed


if __name__ == "__main__":
    import_module("psychopy.visual.text")  # beforehand: it takes seconds
    threading.Thread(target=read, daemon=True).start()
    while (spec := await_spec()) and main(json.loads(spec)):
        tell(ready=True)
