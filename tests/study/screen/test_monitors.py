"""Real windows on a private X server with two monitors side by side: 1000 and 600 pixels wide."""

import importlib
import json
import subprocess
import sys
from collections.abc import Callable
from typing import Any

import pytest

WIDTHS, HEIGHT = (1000, 600), 500

OPEN = """
import json, sys, time
from feel321.study.screen.window import check_screen, open_screen
for windowed in (False, True):
    check_screen(int(sys.argv[1]))
    with open_screen(clock=time.perf_counter, screen=int(sys.argv[1]), windowed=windowed, size=(400, 300)) as window:
        window.show([])
        print(json.dumps([*window.handle.winHandle.get_location(), *window.size]))
"""


def split(env: dict[str, str]) -> None:
    """Divide the X server's one screen into two monitors, as `xrandr --setmonitor` does."""
    display, rq = (importlib.import_module(f"Xlib.{name}") for name in ("display", "protocol.rq"))
    sizes = ("width_in_pixels", "height_in_pixels")

    class SetMonitor(rq.Request):  # type: ignore[misc, name-defined] - python-xlib's own cannot be packed
        _request = rq.Struct(
            rq.Card8("opcode"),
            rq.Opcode(43),
            rq.RequestLength(),
            rq.Window("window"),
            rq.Card32("name"),
            rq.Bool("primary"),
            rq.Bool("automatic"),
            rq.LengthOf("crtcs", 2),
            *(rq.Int16(name) for name in ("x", "y")),
            *(rq.Card16(name) for name in sizes),
            *(rq.Card32(name.replace("pixels", "millimeters")) for name in sizes),
            rq.List("crtcs", rq.Card32Obj),
        )

    server = display.Display(env["DISPLAY"])
    root = server.screen().root
    outputs = list(root.xrandr_get_screen_resources().outputs)
    for place, width in enumerate(WIDTHS):
        SetMonitor(
            display=server.display,
            opcode=server.display.get_extension_major("RANDR"),
            window=root,
            name=server.intern_atom(f"monitor{place}"),
            primary=not place,
            automatic=False,
            crtcs=[] if place else outputs,
            x=sum(WIDTHS[:place]),
            y=0,
            width_in_pixels=width,
            height_in_pixels=HEIGHT,
            width_in_millimeters=300,
            height_in_millimeters=200,
        )
    server.sync()
    server.close()


@pytest.fixture(scope="module")
def screen(display: Callable[[int, int], dict[str, str]]) -> dict[str, str]:
    """The environment of two monitors."""
    pytest.importorskip("psychopy", exc_type=ImportError)
    env = display(sum(WIDTHS), HEIGHT)
    split(env)
    return env


def open_on(screen: dict[str, str], number: int) -> Any:
    command = [sys.executable, "-W", "ignore", "-c", OPEN, str(number)]
    return subprocess.run(command, env=screen, capture_output=True, text=True, timeout=300)  # noqa: PLW1510 - a refusal is looked at


def test_the_window_opens_on_the_monitor_that_was_named(screen: dict[str, str]) -> None:
    done = open_on(screen, 1)
    assert done.returncode == 0, done.stderr
    whole, windowed = map(json.loads, done.stdout.splitlines())
    left, width = WIDTHS
    assert whole == [left, 0, width, HEIGHT]
    assert windowed == [left + (width - 400) // 2, (HEIGHT - 300) // 2, 400, 300]


def test_a_monitor_that_is_not_there_is_refused_with_what_there_is(screen: dict[str, str]) -> None:
    done = open_on(screen, 2)
    assert done.stderr.splitlines()[-1] == (
        "ValueError: --screen must be one of the monitors found: 0 (1000 x 500), 1 (600 x 500); got 2"
    )
