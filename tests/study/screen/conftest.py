import json
import os
import queue
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from runpy import run_path
from typing import IO, Any

import pytest

HERE = Path(__file__).parent
SIZE = (1024, 768)
PATIENCE_S = 120.0
"""How long anything is waited for: nothing takes so long, only a machine under load."""

GLANCE_S = 0.3
"""How long a window that was put away gets to hear a key before it is pressed again."""


@pytest.fixture(scope="session")
def display() -> Iterator[Callable[[int, int], dict[str, str]]]:
    """Opens a private X server of a given size, once, on a number that is free; gives the environment that uses it."""
    servers: list[subprocess.Popen[bytes]] = []

    @cache
    def open_display(width: int, height: int) -> dict[str, str]:
        reading, writing = os.pipe()
        screen = ["-screen", "0", f"{width}x{height}x24"]
        command = ["Xvfb", "-displayfd", str(writing), *screen, "-nolisten", "tcp", "-noreset"]
        servers.append(subprocess.Popen(command, pass_fds=[writing], stderr=subprocess.DEVNULL))
        os.close(writing)
        with os.fdopen(reading) as numbers:
            number = numbers.readline().strip()
        assert number, "the X server did not start"
        return {**os.environ, "DISPLAY": f":{number}", "LIBGL_ALWAYS_SOFTWARE": "1"}

    yield open_display
    for server in servers:
        server.terminate()
        server.wait()


@dataclass
class Leader:
    """A process that shows what it is told to, and the lines that it says."""

    process: subprocess.Popen[str]
    errors: IO[str]
    is_free: bool = True
    lines: queue.Queue[str] = field(default_factory=queue.Queue)
    reader: threading.Thread = field(init=False)

    def __post_init__(self) -> None:
        def read() -> None:
            for line in self.process.stdout or ():
                self.lines.put(line)
            self.lines.put("")

        self.reader = threading.Thread(target=read, daemon=True)
        self.reader.start()

    def end(self) -> None:
        self.process.kill()
        self.process.wait()
        self.reader.join()
        for stream in (self.process.stdin, self.process.stdout, self.errors):
            if stream is not None:
                stream.close()


@dataclass
class Seat:
    """A participant's seat: a screen that a process of its own shows, and keys and a mouse that reach it."""

    leader: Leader
    env: dict[str, str]
    is_held: bool
    told: list[dict[str, Any]] = field(default_factory=list)
    view: dict[str, Any] = field(default_factory=dict)
    seen: int = 0

    @property
    def process(self) -> subprocess.Popen[str]:
        return self.leader.process

    @property
    def lines(self) -> queue.Queue[str]:
        return self.leader.lines

    @property
    def events(self) -> list[dict[str, Any]]:
        """What the journal would hold so far."""
        return [words for words in self.told if "event" in words]

    @property
    def now(self) -> int:
        """Where what is on the screen now was told."""
        return max((place for place, words in enumerate(self.told) if "view" in words), default=0)

    def find(self, event: str) -> list[dict[str, Any]]:
        return [words for words in self.events if words["event"] == event]

    def until(self, test: Callable[[dict[str, Any]], bool]) -> dict[str, Any]:
        """Read on until the screen is, or since the last key or click was, as it is to be; gives it as it was then."""
        end_s, fresh = time.monotonic() + PATIENCE_S, self.seen
        while True:
            for place in range(fresh, len(self.told)):
                if "view" in self.told[place] and test(self.told[place]["view"]):
                    self.seen = place
                    return self.told[place]["view"]
            fresh = len(self.told)
            self._read_on(end_s)

    def heed(self, event: str, **wanted: Any) -> None:
        """Wait until the journal would hold such an event."""
        end_s = time.monotonic() + PATIENCE_S
        while not any(
            all(told[name] == value for name, value in wanted.items()) for told in self.find(event)
        ):
            self._read_on(end_s)

    def _read_on(self, end_s: float) -> None:
        line = self._read_line(end_s)
        assert line, f"the screen is gone; it was {self.view}\n{self.read_errors()}"
        self._take(line)

    def _read_line(self, end_s: float) -> str:
        try:
            return self.lines.get(timeout=max(0.1, end_s - time.monotonic()))
        except queue.Empty:
            pytest.fail(f"the screen stays as it is: {self.view}; {self.told[-5:]}")

    def order(self, word: str) -> None:
        """Have the clock held or go on, or only look (see lead.py), and wait until the next frame is over.

        What was pressed before has taken effect by then. The last key of all closes the screen, which answers nothing.
        """
        assert self.process.stdin is not None
        self.is_held = {"hold": True, "go on": False}.get(word, self.is_held)
        n_before = self.count_obeyed()
        with suppress(BrokenPipeError):
            os.write(self.process.stdin.fileno(), f"{word}\n".encode())
        end_s = time.monotonic() + PATIENCE_S
        while self.count_obeyed() == n_before:
            line = self._read_line(end_s)
            if not line or "ready" in json.loads(line):
                self.lines.put(line)
                return
            self._take(line)

    def count_obeyed(self) -> int:
        return sum("obeyed" in words for words in self.told)

    def see(self, **wanted: Any) -> dict[str, Any]:
        return self.until(lambda view: all(view[name] == value for name, value in wanted.items()))

    def insist(self, key: str, **wanted: Any) -> dict[str, Any]:
        """Press a key until the screen obeys: a window that was put away may get the first one too early."""
        end_s = time.monotonic() + PATIENCE_S
        while not all(self.view.get(name) == value for name, value in wanted.items()):
            assert time.monotonic() < end_s, self.view
            self.press(key)
            time.sleep(GLANCE_S)
            while not self.lines.empty():
                self._take(self.lines.get())
        return self.view

    def finish(self) -> list[dict[str, Any]]:
        """Wait until the screen is closed; gives what the journal would hold."""
        while line := self.lines.get(timeout=PATIENCE_S):
            self._take(line)
            if "ready" in self.told[-1]:
                self.leader.is_free = True
                return self.events
        assert self.process.wait(PATIENCE_S) == 0, self.read_errors()
        return self.events

    def press(self, *keys: str) -> None:
        """Press keys with the clock held: however slow the machine is, none of them repeats or comes too late."""
        was_held, self.seen = self.is_held, self.now
        self.order("hold")  # before its first frame a window hears no keys
        for key in keys:
            self.reach("keydown", key)
            self.reach("keyup", key)
        if not was_held:
            self.order("go on")

    def click(self, target: str, *, at: float = 0.5, to: float | None = None) -> None:
        """Click on a target at a share of its width, and drag to another."""
        self.order("look")  # a window's first frame takes the pointer to a corner
        self.seen = self.now
        box = self.view["targets"][target]
        for share, act in ((at, "mousedown"), (at if to is None else to, "mouseup")):
            x, y = box["left"] + share * box["width"], box["top"] + box["height"] / 2
            self.reach("mousemove", str(round(x)), str(round(y)))
            self.reach(act, "1")

    def reach(self, *words: str) -> None:
        """Move a key or the mouse, and wait until the screen has shown a frame since."""
        # Once the X server answers this, the rest has been sent to the window.
        self.do(*words, "getmouselocation")
        self.order("look")

    def do(self, *words: str) -> str:
        return subprocess.run(
            ["xdotool", *words], env=self.env, check=True, capture_output=True, text=True
        ).stdout

    def read_errors(self) -> str:
        self.leader.errors.seek(0)
        return self.leader.errors.read()

    def _take(self, line: str) -> None:
        words = json.loads(line)
        self.told.append(words)
        self.view = words.get("view", self.view)


@pytest.fixture(scope="session")
def leaders(display: Callable[[int, int], dict[str, str]]) -> Iterator[Callable[[], Leader]]:
    """Gives a process that waits for what to show; a spare one starts meanwhile, which takes seconds."""
    env = display(*SIZE)
    started: list[Leader] = []

    def start() -> None:
        errors = tempfile.TemporaryFile("w+", encoding="utf-8")  # noqa: SIM115 - open as long as the process
        command = [sys.executable, str(HERE / "lead.py")]
        pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": errors}
        started.append(Leader(subprocess.Popen(command, env=env, **pipes, text=True), errors))

    def give() -> Leader:
        if sum(leader.is_free for leader in started) < 2:
            start()
        leader = next(leader for leader in started if leader.is_free)
        leader.is_free = False
        return leader

    yield give
    for leader in started:
        leader.end()


@pytest.fixture
def seat(
    display: Callable[[int, int], dict[str, str]], leaders: Callable[[], Leader]
) -> Iterator[Callable[..., Seat]]:
    """Seats participants before screens that lead through given steps."""
    seats: list[Seat] = []

    def take_seat(*steps: dict[str, Any], **spec: Any) -> Seat:
        leader = leaders()
        assert leader.process.stdin is not None
        leader.process.stdin.write(json.dumps({"steps": steps, "size": SIZE, **spec}) + "\n")
        leader.process.stdin.flush()
        seats.append(Seat(leader, display(*SIZE), spec.get("held", False)))
        return seats[-1]

    yield take_seat
    for taken in seats:
        if not taken.leader.is_free:
            taken.leader.process.kill()


@pytest.fixture(scope="session")
def gallery() -> dict[str, Any]:
    """The functions of `gallery.py`."""
    return run_path(str(HERE / "gallery.py"))
