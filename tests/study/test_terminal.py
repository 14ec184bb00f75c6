"""What a terminal shows: progress, loudness, and no colours."""

import os
import pty
import re
import subprocess
import sys
from contextlib import suppress
from pathlib import Path
from struct import pack
from time import monotonic, sleep

import pytest

from feel321 import arguments
from feel321.study.folder import StudyFolder
from feel321.study.terminal import echo

FEEL321 = Path(sys.executable).with_name("feel321")


def watch(*arguments: object) -> str:
    """Run a verb in a terminal of 100 columns; all that it showed."""
    from fcntl import ioctl
    from termios import TIOCSWINSZ

    terminal, end = pty.openpty()
    ioctl(end, TIOCSWINSZ, pack("HHHH", 24, 100, 0, 0))
    command, shown = [FEEL321, *map(str, arguments)], b""
    with subprocess.Popen(command, stdin=end, stdout=end, stderr=end) as process:
        os.close(end)
        with suppress(OSError):  # so Linux ends a terminal
            while piece := os.read(terminal, 65536):
                shown += piece
    os.close(terminal)
    assert process.returncode == 0
    return shown.decode()


def test_numbers_are_printed_whole_and_nothing_moves_the_cursor(
    capsys: pytest.CaptureFixture[str],
) -> None:
    echo("power 0.99 (95\N{NO-BREAK SPACE}% interval) of \x1b[2Ap\u202e1")
    said = capsys.readouterr().out
    assert said == "power 0.99 (95\N{NO-BREAK SPACE}% interval) of \\u001b[2Ap\\u202e1\n"


@pytest.fixture
def unbuilt(smallest: StudyFolder) -> StudyFolder:
    for path in smallest.stimuli.iterdir():
        path.unlink()
    return smallest


def test_a_terminal_sees_what_is_done_and_no_colour(unbuilt: StudyFolder) -> None:
    shown = watch("build", unbuilt.path)
    assert re.search(r"build: [12]/2 \|", shown)  # it moves ten times per s at most
    # Neither colour nor cursor, so NO_COLOR has nothing to switch off.
    assert "\x1b[" not in shown + watch("--help") + watch("--version")
    assert re.search(r"\r +\r[^\r]*stimuli: 2 stimuli, set \w{12}\r\n", shown)  # the bar is wiped


def test_the_clock_runs_while_one_step_takes_long(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(arguments, "TICK_S", 0.01)
    shown, until = "", monotonic() + 60
    with arguments.follow(True, "analyze") as move:
        move(0, 12)
        while shown.count("analyze: 0/12 ") < 5:
            assert monotonic() < until, "the bar stood still"
            sleep(0.01)
            shown += capsys.readouterr().err
