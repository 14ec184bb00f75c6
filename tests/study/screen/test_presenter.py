"""Real windows, real keys, a real mouse; only the actuators are silent."""

import os
import signal
import subprocess
import sys
from collections.abc import Callable
from typing import Any

import pytest


def test_slider_by_keys(seat: Callable[..., Any]) -> None:
    here = seat({"trial": "similarity"}, held=True)
    here.see(state="feeling", playing="reference")
    here.press("Right", "Return")
    here.order("go on")
    view = here.see(state="answering")
    assert view["markers"] == {}  # neither a marker by default nor one moved before all was felt
    here.press("Return")
    here.until(lambda view: view["notice"] == "Please answer first. Still open: Vibration")
    here.press("Left")
    assert here.see(markers={"test": 50.0})["notice"] == ""
    here.press("Right", "Prior", "Prior", "Next", "Left", "Left")
    here.see(markers={"test": 59.0})
    here.heed("moved", value=59.0)
    here.order("hold")  # the next digit comes in time, however late
    here.press("7")
    here.see(typed="7")
    here.press("5")
    here.see(markers={"test": 75.0}, typed="")
    here.press("8")
    here.see(markers={"test": 75.0}, typed="8")
    here.order("go on")
    here.see(markers={"test": 8.0}, typed="")
    here.press("Return")
    events = here.finish()
    assert [event["event"] for event in events[:4]] == ["shown", "played", "played", "refused"]
    moves = [event["value"] for event in here.find("moved")]
    assert moves[-1] == 8.0
    assert 59.0 in moves
    rated = here.find("rated")[0]
    assert rated["values"] == {"test": 8.0}
    assert rated["flags"] == []
    # It counts from the end of what was felt, which was collected then, until before the screen says so.
    ended_s = [words["collected"] for words in here.told if "collected" in words][-1]
    seen_s = next(
        words["time_s"] for words in here.told if words.get("view", {}).get("state") == "answering"
    )
    assert rated["time_s"] - seen_s <= rated["response_time_s"] <= rated["time_s"] - ended_s
    assert events[-1]["event"] == "closed"


def test_an_answer_that_is_late_does_not_count(seat: Callable[..., Any]) -> None:
    again = {"page": "timed_out", "least_s": 1.0}, {"trial": "triplet"}
    here = seat({"trial": "triplet"}, *again, limits_s={"triplet": 1.5})
    here.see(state="answering", left_s=2)
    here.press("Left")
    here.see(chosen="a")
    here.see(left_s=1)
    here.see(page="timed_out")
    spoiled = here.find("spoiled")[0]
    assert spoiled["flags"] == ["timed_out"]
    ended_s = [words["collected"] for words in here.told if "collected" in words][-1]
    assert spoiled["time_s"] - ended_s > 1.5
    here.press("Return")
    here.until(lambda view: view["notice"].startswith("Please wait a "))
    here.see(left_s=0)
    here.press("Return")
    here.see(state="answering", left_s=2)
    assert here.view["chosen"] == ""  # nothing of the last attempt is left
    here.press("Right", "Return")
    here.finish()
    assert [event["values"] for event in here.find("rated")] == [{"a": "b"}]


def test_slider_by_mouse(seat: Callable[..., Any]) -> None:
    here = seat({"page": "main"}, {"trial": "realism"})
    here.see(page="main")
    here.order("hold")
    here.click("confirm")
    here.see(state="feeling")
    here.click("stop")
    here.see(state="answering")
    here.order("go on")
    here.click("mark test", at=0.25)
    here.see(markers={"test": 25.0})
    here.click("mark test", at=0.25, to=0.8)
    here.see(markers={"test": 80.0})
    here.click("mark test", at=0.5, to=1.3)
    here.see(markers={"test": 100.0})
    here.click("confirm")
    here.until(lambda view: view["notice"].startswith("Please let it play to the end"))
    here.click("again")
    here.see(state="feeling")
    here.see(state="answering", felt=["test"])
    here.order("hold")
    here.click("feel test")
    here.see(state="feeling")
    here.click("stop")
    here.see(state="answering", felt=["test"])
    here.order("go on")
    here.click("confirm")
    here.finish()
    assert here.find("rated")[0]["values"] == {"test": 100.0}
    assert [event["completed"] for event in here.find("played")] == [False, True, False]
    assert len(here.find("replayed")) == 1


def test_strict_trials_are_felt_once_and_spoiled_when_stopped_and_surfaces_are_stroked(
    seat: Callable[..., Any],
) -> None:
    strict = {"trial": "similarity", "timing": "strict"}
    here = seat({"trial": "touched"}, strict, strict)
    here.see(state="stroking", playing="surface")
    here.press("Return")
    here.see(state="answering", felt=["surface", "test"])
    here.press("Right", "Return")
    here.see(screen=2, state="answering")
    assert "again" not in here.view["targets"]
    here.press("r")
    here.until(lambda view: view["notice"].startswith("Each one is felt only once"))
    here.order("hold")
    here.press("5", "0", "Return")
    here.see(screen=3, state="feeling", playing="reference")
    here.press("space")
    here.finish()
    assert here.find("prompted")[0]["completed"] is True
    assert here.find("rated")[0]["values"] == {"test": 50.0}
    assert here.find("spoiled")[0]["flags"] == ["not_felt"]
    assert here.find("refused")[0]["reason"] == "no_replay"


def test_rows_by_keys(seat: Callable[..., Any]) -> None:
    here = seat({"trial": "mushra", "rows": 3}, duration_s=0.5)
    here.see(state="answering", selected="1")
    here.order("hold")
    here.press("Tab")
    here.see(playing="reference")
    here.press("F2")  # switches at once: what plays is stopped
    here.see(playing="2", selected="2")
    here.press("Right", "Right")  # no marker can be moved before its vibration was felt
    assert "mark 2" not in here.view["targets"]
    here.order("go on")
    here.see(markers={}, felt=["2"], state="answering")
    here.press("Right", "Right", "Prior")
    here.see(markers={"2": 61.0})
    assert [name for name in here.view["targets"] if name.startswith("mark")] == ["mark 2"]
    here.press("Return")
    here.until(
        lambda view: (
            view["notice"] == "Please let it play to the end. Not yet played: Reference, 1, 3"
        )
    )
    here.press("Up", "r")
    here.see(playing="1", selected="1")
    here.see(felt=["1", "2"])
    here.press("Next", "Down", "Down", "r")
    here.see(felt=["1", "2", "3"])
    here.press("4", "5")
    here.see(markers={"1": 50.0, "2": 61.0, "3": 45.0})
    here.press("F9")
    here.until(lambda view: view["notice"] == "There is nothing to feel under that key.")
    here.press("Tab")
    here.see(felt=["1", "2", "3", "reference"])
    here.press("Return")
    here.finish()
    assert here.find("rated")[0]["values"] == {"1": 50.0, "2": 61.0, "3": 45.0}
    first = here.find("played")[0]
    assert (first["part"], first["completed"]) == ("reference", False)
    assert {event["part"]: event["value"] for event in here.find("moved")} == {
        "1": 50.0,
        "2": 61.0,
        "3": 45.0,
    }


def test_pages_stand_and_count_down(seat: Callable[..., Any]) -> None:
    pages = (
        {"page": "rest", "least_s": 1.5},
        {"page": "training_failed", "by": "experimenter"},
        {"page": "end"},
    )
    here = seat(*pages, held=True)
    here.see(page="rest", left_s=2)
    here.press("Return")
    here.until(lambda view: view["notice"] == "Please wait a little longer.")
    assert "confirm" not in here.view["targets"]
    here.order("go on")
    here.see(left_s=0)
    left_s = [words["view"]["left_s"] for words in here.told if "view" in words]
    assert left_s == sorted(left_s, reverse=True)
    here.press("Return")
    here.see(page="training_failed")
    here.press("Return", "space")
    here.press("F12")
    here.see(page="end")
    here.order("hold")
    here.press("Escape", "Escape")  # nothing is left to end
    here.press("Return")
    here.finish()
    pages = here.find("page")
    assert [page["key"] for page in pages] == ["rest", "training_failed", "end"]
    assert pages[0]["stood_s"] >= 1.5


def test_escape_pauses_then_ends(seat: Callable[..., Any]) -> None:
    here = seat({"trial": "similarity"}, duration_s=60.0, held=True)
    here.see(state="feeling")
    here.press("Escape")
    here.until(lambda view: view["notice"] == "Press Esc once more to pause")
    here.order("go on")
    here.see(notice="")  # too late now
    here.order("hold")
    here.press("Escape", "Escape")
    here.see(page="pause")
    assert here.find("played")[-1]["completed"] is False
    here.press("Return")
    here.see(state="feeling", playing="reference", felt=[])
    here.click("pause")
    here.see(page="pause")
    here.press("Escape", "Escape")
    events = here.finish()
    assert [
        event["event"] for event in events if event["event"] not in {"shown", "played", "refused"}
    ] == ["paused", "continued", "paused", "ended", "closed"]
    assert events[-2]["reason"] == "the participant ended it for today"


def test_space_stops_at_once(seat: Callable[..., Any]) -> None:
    here = seat({"trial": "realism"}, duration_s=300.0)
    for number in (1, 2):
        here.see(state="feeling")
        here.order("look")
        here.reach("keydown", "space")
        # In the first frame that knows of the key.
        assert sum("stopped" in words for words in here.told) == number
        here.reach("keyup", "space")
        here.see(state="answering", felt=[])
        here.press("r")
    here.see(state="feeling")
    here.order("hold")
    here.press("Escape", "Escape")
    here.see(page="pause")
    here.press("Escape", "Escape")
    here.finish()


def find_window(here: Any) -> str:
    """Find the number of the window that is seen; those of former screens are put away."""
    return here.do("search", "--onlyvisible", "--name", "PsychoPy").split()[0]


def close_by_manager(here: Any) -> None:
    """Ask the window to close, as its button and Alt-F4 do."""
    from Xlib import X
    from Xlib.display import Display
    from Xlib.protocol.event import ClientMessage

    display = Display(here.env["DISPLAY"])
    window = display.create_resource_object("window", int(find_window(here)))
    protocols, delete = display.intern_atom("WM_PROTOCOLS"), display.intern_atom("WM_DELETE_WINDOW")
    window.send_event(
        ClientMessage(
            window=window, client_type=protocols, data=(32, [delete, X.CurrentTime, 0, 0, 0])
        )
    )
    display.sync()
    display.close()


def close_by_force(here: Any) -> None:
    here.do("windowclose", find_window(here))


def test_a_display_that_is_not_there_is_one_line() -> None:
    code = "from feel321.study.screen.window import check_screen; check_screen(0)"
    command, env = [sys.executable, "-c", code], {**os.environ, "DISPLAY": ":9999"}
    done = subprocess.run(command, env=env, capture_output=True, text=True, check=False)
    assert done.stderr.splitlines()[-1].startswith("OSError: no display found (")


def test_a_window_that_is_put_away_pauses_a_trial_and_ends_nothing(
    seat: Callable[..., Any],
) -> None:
    """A key that is let go elsewhere does not go on either."""
    here = seat({"page": "main"}, {"trial": "realism"}, windowed=True)
    here.see(page="main")
    window = find_window(here)

    def put_away() -> None:
        here.do("windowunmap", "--sync", window)
        here.do("windowmap", "--sync", window)
        here.do("windowfocus", "--sync", window)

    put_away()
    here.insist("Return", state="answering")
    here.press("Right")
    here.see(markers={"test": 50.0})
    here.do("keydown", "Right")
    here.until(lambda view: view["markers"]["test"] > 52.0)
    here.do("windowunmap", "--sync", window)
    here.do("keyup", "Right")
    here.see(page="pause")
    here.do("windowmap", "--sync", window)
    here.do("windowfocus", "--sync", window)
    here.insist("Return", state="answering", markers={})
    here.process.send_signal(signal.SIGINT)
    here.process.wait(120.0)
    assert len(here.find("paused")) == 1
    assert not here.find("ended")


@pytest.mark.parametrize(
    ("close", "state"), [(close_by_manager, "feeling"), (close_by_force, "answering")]
)
def test_closed_windows_end_the_session(
    seat: Callable[..., Any], close: Callable[[Any], None], state: str
) -> None:
    here = seat(
        {"trial": "realism"}, duration_s=300.0 if state == "feeling" else 0.2, windowed=True
    )
    here.see(state=state)
    here.order("look")
    close(here)
    events = here.finish()
    assert events[-2] == {"event": "ended", "reason": "the window was closed"}
    assert any("stopped" in words for words in here.told) == (state == "feeling")


def test_interrupt_leaves_silence(seat: Callable[..., Any]) -> None:
    here = seat({"trial": "realism"}, duration_s=300.0)
    here.see(state="feeling", playing="test")
    here.order("look")
    here.process.send_signal(signal.SIGINT)
    while line := here.lines.get(timeout=120.0):
        here._take(line)
    assert here.process.wait(120.0) != 0
    assert "KeyboardInterrupt" in here.read_errors()
    assert any("stopped" in words for words in here.told)
    assert any("late_frames" in words for words in here.told)
