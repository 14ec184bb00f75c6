from __future__ import annotations

import json
import os
import queue
import subprocess
import sys
import threading
import time
from dataclasses import dataclass, field
from pathlib import Path
from runpy import run_path
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

HERE = Path(__file__).parent
PATIENCE_S = 120.0
"""How long anything is waited for: nothing takes so long, only a machine under load."""

PRESS_S = 0.04
GLANCE_S = 0.3
"""How long a key is down: longer than a frame."""

Display = "Callable[[int, int], dict[str, str]]"


@pytest.fixture
def display() -> Iterator[Callable[[int, int], dict[str, str]]]:
    """Opens private X servers of a given size, each on a number that is free; gives the environment that uses it."""
    servers: list[subprocess.Popen[bytes]] = []

    def open_display(width: int = 1024, height: int = 768) -> dict[str, str]:
        reading, writing = os.pipe()
        servers.append(
            subprocess.Popen(
                ["Xvfb", "-displayfd", str(writing), "-screen", "0", f"{width}x{height}x24", "-nolisten", "tcp"],
                pass_fds=[writing],
                stderr=subprocess.DEVNULL,
            )
        )
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
class Seat:
    """A participant's seat: a screen that a process of its own shows, and keys and a mouse that reach it."""

    process: subprocess.Popen[str]
    env: dict[str, str]
    told: list[dict[str, Any]] = field(default_factory=list)
    lines: queue.Queue[str] = field(default_factory=queue.Queue)
    view: dict[str, Any] = field(default_factory=dict)
    reader: threading.Thread = field(init=False)

    def start_reading(self) -> None:
        def read() -> None:
            for line in self.process.stdout or ():
                self.lines.put(line)
            self.lines.put("")

        self.reader = threading.Thread(target=read, daemon=True)
        self.reader.start()

    @property
    def events(self) -> list[dict[str, Any]]:
        """What the journal would hold so far."""
        return [words for words in self.told if "event" in words]

    def find(self, event: str) -> list[dict[str, Any]]:
        return [words for words in self.events if words["event"] == event]

    def until(self, test: Callable[[dict[str, Any]], bool]) -> dict[str, Any]:
        """Read on until the screen is as it is to be."""
        end_s = time.monotonic() + PATIENCE_S
        while not (self.view and test(self.view)):
            self._take(self._read_line(end_s))
        return self.view

    def _read_line(self, end_s: float) -> str:
        try:
            line = self.lines.get(timeout=max(0.1, end_s - time.monotonic()))
        except queue.Empty:
            pytest.fail(f"the screen stays as it is: {self.view}; {self.told[-5:]}")
        assert line, f"the screen is gone; it was {self.view}\n{self.read_errors()}"
        return line

    def order(self, word: str) -> None:
        """Have the clock held or go on, or only look (see lead.py); a frame later at least it is done.

        What was pressed before was heeded by then.
        """
        assert self.process.stdin is not None
        n_before = sum("obeyed" in words for words in self.told)
        self.process.stdin.write(f"{word}\n")
        self.process.stdin.flush()
        self.until(lambda _: sum("obeyed" in words for words in self.told) > n_before)

    def heed(self, event: str, **wanted: Any) -> None:
        """Wait until the journal would hold such an event."""
        self.until(
            lambda _: any(all(told[name] == value for name, value in wanted.items()) for told in self.find(event))
        )

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
        """Wait for the end of the process; gives what the journal would hold."""
        while line := self.lines.get(timeout=PATIENCE_S):
            self._take(line)
        assert self.process.wait(PATIENCE_S) == 0, self.read_errors()
        return self.events

    def press(self, *keys: str) -> None:
        self.order("look")  # before its first frame a window hears no keys
        for key in keys:
            self.do("keydown", key)
            time.sleep(PRESS_S)
            self.do("keyup", key)
            time.sleep(PRESS_S)

    def hold(self, key: str, duration_s: float) -> None:
        self.do("keydown", key)
        time.sleep(duration_s)
        self.do("keyup", key)

    def click(self, target: str, *, at: float = 0.5, to: float | None = None) -> None:
        """Click on a target at a share of its width, and drag to another."""
        self.order("look")  # a window's first frame takes the pointer to a corner
        box = self.view["targets"][target]
        for share, act in ((at, "mousedown"), (at if to is None else to, "mouseup")):
            x, y = box["left"] + share * box["width"], box["top"] + box["height"] / 2
            self.do("mousemove", str(round(x)), str(round(y)))
            time.sleep(PRESS_S)
            self.do(act, "1")
            time.sleep(PRESS_S)

    def do(self, *words: str) -> str:
        return subprocess.run(["xdotool", *words], env=self.env, check=True, capture_output=True, text=True).stdout

    def read_errors(self) -> str:
        return self.process.stderr.read() if self.process.stderr else ""

    def _take(self, line: str) -> None:
        words = json.loads(line)
        self.told.append(words)
        self.view = words.get("view", self.view)


@pytest.fixture
def seat(display: Callable[[int, int], dict[str, str]]) -> Iterator[Callable[..., Seat]]:
    """Seats participants before screens that lead through given steps."""
    seats: list[Seat] = []

    def take_seat(*steps: dict[str, Any], size: tuple[int, int] = (1024, 768), **spec: Any) -> Seat:
        env = display(*size)
        command = [sys.executable, str(HERE / "lead.py"), json.dumps({"steps": steps, "size": size, **spec})]
        pipes = dict.fromkeys(("stdin", "stdout", "stderr"), subprocess.PIPE)
        process = subprocess.Popen(command, env=env, **pipes, text=True)
        seats.append(Seat(process, env))
        seats[-1].start_reading()
        return seats[-1]

    yield take_seat
    for taken in seats:
        taken.process.kill()
        taken.process.wait()
        taken.reader.join()
        for stream in (taken.process.stdin, taken.process.stdout, taken.process.stderr):
            if stream is not None:
                stream.close()


@pytest.fixture(scope="session")
def gallery() -> dict[str, Any]:
    """The functions of `gallery.py`."""
    return run_path(str(HERE / "gallery.py"))
