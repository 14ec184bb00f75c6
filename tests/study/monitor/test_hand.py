"""A rehearsal by hand: the verb as a process, asked as a browser asks it."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
import urllib.error
import urllib.request
from typing import TYPE_CHECKING, Any

import pytest

from feel321.study.monitor.hand import BrowserWindow
from feel321.study.monitor.replay import REHEARSAL

if TYPE_CHECKING:
    from pathlib import Path


class Page:
    """What a browser knows of the rehearsal, and what it sends."""

    def __init__(self, address: str) -> None:
        self.address, self.state = address, {"version": ""}

    def send(self, body: bytes) -> int:
        request = urllib.request.Request(self.address.replace("/?", "/act?"), body, method="POST")  # noqa: S310 - our own server
        try:
            with urllib.request.urlopen(request, timeout=30) as answer:  # noqa: S310 - our own server
                return int(answer.status)
        except urllib.error.HTTPError as error:
            return error.code

    def press(self, *keys: str) -> None:
        for key in keys:
            for kind in ("press", "release"):
                assert self.send(json.dumps({"kind": kind, "key": key}).encode()) == 204

    def wait_for(self, words: str) -> dict[str, Any]:
        end_s = time.monotonic() + 100
        while words not in self.state.get("words", ""):
            assert time.monotonic() < end_s
            address = self.address.replace("/?", "/screen.json?")
            with urllib.request.urlopen(  # noqa: S310 - our own server
                f"{address}&after={self.state['version']}", timeout=30
            ) as answer:
                self.state = json.loads(answer.read())
        assert REHEARSAL in self.state["words"]
        return self.state


def list_files(folder: Path) -> dict[str, tuple[int, int]]:
    return {str(path): (path.stat().st_mtime_ns, path.stat().st_size) for path in folder.rglob("*")}


def answer_first_trial(page: Page) -> None:
    for title in ("Welcome; ", "Your consent; ", "How real does it feel?; ", "Let us try it; "):
        page.wait_for(title)
        page.press("enter")
    page.wait_for("✓")  # felt to its end, so it can be answered
    assert page.state["sound"]["wav"].startswith("UklGR")  # RIFF
    page.press("4", "2")
    page.wait_for("; 42; ")
    for act in ACTS:
        assert page.send(act) == 204
    assert page.send(b" " * 5000) == 413
    time.sleep(0.5)  # what is answered in less than 0.2 s is asked again, here as in the lab
    page.press("enter")
    page.wait_for("expected")
    page.address = page.address.replace("token=", "token=x")
    assert page.send(b'{"kind": "press", "key": "enter"}') == 403


ACTS = (
    b"{", b"[]", b'{"kind": []}', b'{"kind": "evil"}', b'{"kind": "press", "x": "a"}', b"\xff", b"[" * 4000,
    b'{"kind": "click", "x": NaN}', b'{"kind": "click", "y": 1' + b"0" * 400 + b"}", b'{"kind": "press", "key": {}}',
)  # fmt: skip
"""Nothing that a page sends."""


def test_what_no_page_sends_is_left_out_and_cut_off() -> None:
    window = BrowserWindow(lambda: 1.0)
    for act in ACTS:
        window.take(act)
    window.take(b'{"kind": "press", "key": "enter"}')
    assert [event.key for event in window.show([])] == ["enter"]


@pytest.mark.soak
def test_a_rehearsal_is_answered_by_keys_and_stores_nothing(made: Path) -> None:
    before = list_files(made)
    code = f"import sys; from feel321.study.cli import main; sys.exit(main(['rehearse', {str(made)!r}, '--by-hand']))"
    command = [sys.executable, "-c", code]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    with subprocess.Popen(command, text=True, **pipes) as process:
        try:
            answer_first_trial(Page(process.stdout.readline().strip()))
            process.send_signal(signal.SIGINT)
            _, told = process.communicate(timeout=100)
        finally:
            process.kill()
    assert (process.returncode, told) == (0, "rehearse: ended\n")
    assert list_files(made) == before
