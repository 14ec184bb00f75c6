"""A real pointer on a real window: where it is and how fast it moves, as it is reported."""

from __future__ import annotations

import json
import subprocess
import sys
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from collections.abc import Callable

WATCH = """
import json, sys
from time import perf_counter
from feel321.study.exploration.motion import Pointer
from feel321.study.screen.window import open_screen
with open_screen(clock=perf_counter, windowed=True, size=(800, 600)) as window:
    pointer = Pointer(perf_counter, m_per_pixel=1e-3)
    window.on_motion = pointer.move
    window.show([])
    print("ready", flush=True)
    begin_s, most = perf_counter(), 0.0
    while len(pointer.take()) < 40 and perf_counter() - begin_s < 30:
        window.show([])
        most = max(most, pointer.read().speed_m_s)
    print(json.dumps({"track": pointer.take().tolist(), "most": most}), flush=True)
"""


@pytest.mark.realtime
def test_the_pointer_is_followed_in_its_own_reports(
    display: Callable[[int, int], dict[str, str]],
) -> None:
    env = display(800, 600)
    with subprocess.Popen(
        [sys.executable, "-c", WATCH], env=env, stdout=subprocess.PIPE, text=True, encoding="utf-8"
    ) as watch:
        assert watch.stdout is not None
        try:
            assert watch.stdout.readline() == "ready\n"
            # To and fro along a line, in steps of 4 pixels each 10 ms or more.
            xs = [200 + 4 * abs(60 - step % 120) for step in range(240)]
            moves = " ".join(f"mousemove {x} 300 sleep 0.01" for x in xs)
            subprocess.run(["xdotool", *moves.split()], env=env, check=True, timeout=60)
            found = json.loads(watch.stdout.readline())
        finally:
            watch.kill()
    times, x_m, y_m, _ = zip(*found["track"], strict=True)
    assert len(times) >= 40
    assert list(times) == sorted(times)
    assert max(x_m) - min(x_m) > 0.03
    assert max(x_m) <= 0.8
    # The first report may be of where the pointer was before.
    assert max(y_m[2:]) - min(y_m[2:]) < 0.002
    # 4 mm in 10 ms or more: at most 0.4 m/s, but for reports that came together after a busy moment.
    assert found["most"] > 0.02
