"""What puts an end to a session, or nearly: the journal is whole, the device silent, and the session goes on."""

import json
import signal
import time
from collections.abc import Callable
from typing import Any

import pytest

from feel321.protocols.texts import read_scales, read_texts
from feel321.protocols.trial import Judgement, Part, Trial
from feel321.study.analyze import analyze_study
from feel321.study.cli import main
from feel321.study.folder import StudyFolder
from feel321.study.screen.input import View, make_screen_texts
from feel321.study.screen.layout import compose
from feel321.study.session.ports import Place
from feel321.study.status import read_status
from tests.study.conftest import audit_study

HAND = ("--simulate-participant",)
TOTAL = 4
"""Trials of a session of realism."""

INTERRUPTED = "feel321: interrupted; what is done is kept, the same command continues"
TERMINATED = INTERRUPTED.replace("interrupted", "ended by SIGTERM")

STREAM = "stylus"
"""The device of the private PulseAudio as PortAudio lists it."""


def check_whole(study: StudyFolder) -> None:
    """Demand a session that is finished, and nothing that is not as it was written."""
    entry = read_status(study).participants[0]
    assert (entry.state, entry.done, entry.left) == ("finished", TOTAL, 0)
    assert audit_study(study) == []


def tell_how_to_go_on(study: StudyFolder, participant: str, *options: str) -> str:
    return f"resume with: feel321 run {study.path} --participant {participant}{''.join(f' {word}' for word in options)}"


def ask_to_close(display: str, window: int) -> None:
    """Ask a window to close as its button does."""
    from Xlib.display import Display
    from Xlib.protocol.event import ClientMessage

    server = Display(display)
    protocols, delete = (server.intern_atom(name) for name in ("WM_PROTOCOLS", "WM_DELETE_WINDOW"))
    target = server.create_resource_object("window", window)
    target.send_event(
        ClientMessage(window=target, client_type=protocols, data=(32, [delete, 0, 0, 0, 0]))
    )
    server.sync()
    server.close()


@pytest.mark.soak
def test_killed_in_the_middle_it_resumes_and_is_analysed(
    rig: Any, make_study: Callable[..., StudyFolder]
) -> None:
    study = make_study("realism", device=STREAM)
    session = rig.start(study, "sim001", *HAND)
    session.wait_for("rated")
    session.wait_for("shown", 2)
    session.send(signal.SIGKILL)
    session.finish()
    done = session.count_done()
    code, out, _ = rig.run(study, "sim001", *HAND)
    assert code == 0
    assert out.startswith(f"sim001: {done} of {TOTAL} answered so far\n")
    check_whole(study)
    analyze_study(study)
    assert json.loads((study.report / "results.json").read_text(encoding="utf-8"))
    played = [record.data for record in session.records if record.event == "played"]
    assert all(entry["measured"]["n_samples"] == 7200 for entry in played if entry["completed"])
    assert rig.run(study, "sim001", *HAND) == (0, f"sim001: {TOTAL} of {TOTAL} answered\n", "")


def test_interrupted_it_says_how_to_go_on(lab: Any, make_study: Callable[..., StudyFolder]) -> None:
    study = make_study("realism")
    session = lab.start(study, "sim001", *HAND)
    session.wait_for("rated")
    session.wait_for("played", 2)
    session.send(signal.SIGINT)
    code, _, err = session.finish()
    line = f"sim001: {session.count_done()} of {TOTAL} answered (aborted: KeyboardInterrupt); "
    assert (code, err.splitlines()) == (
        130,
        [line + tell_how_to_go_on(study, "sim001", *HAND), INTERRUPTED],
    )
    assert session.records[-1].event == "aborted"
    assert audit_study(study) == []


def test_a_window_that_is_closed_ends_it_for_today(
    lab: Any, make_study: Callable[..., StudyFolder]
) -> None:
    study = make_study("realism")
    session = lab.start(study, "p01", "--windowed")
    session.wait_for("device")
    window = session.find_window()
    session.press("Return", "Return")
    ask_to_close(lab.env["DISPLAY"], int(window))
    code, _, err = session.finish()
    assert code == 1
    assert err.splitlines() == [
        f"p01: 0 of {TOTAL} answered (aborted: the window was closed); "
        + tell_how_to_go_on(study, "p01", "--windowed")
    ]
    assert session.records[-1].data["reason"] == "the window was closed"
    assert audit_study(study) == []


def test_a_rehearsal_lies_apart_and_its_end_says_how_to_go_on(
    lab: Any, make_study: Callable[..., StudyFolder], capsys: pytest.CaptureFixture[str]
) -> None:
    study = make_study("realism")
    session = lab.start(study, "p01", "--rehearse", *HAND)
    session.wait_for("rated")
    assert session.records[0].data["presenter"]["rehearsal"] is True
    assert not study.sessions.exists()
    session.send(signal.SIGTERM)
    code, _, err = session.finish()
    line = f"p01: {session.count_done()} of {TOTAL} answered (aborted: Terminated); "
    assert (code, err.splitlines()) == (
        143,
        [line + tell_how_to_go_on(study, "p01", "--rehearse", *HAND), TERMINATED],
    )
    assert read_status(study).participants == ()
    apart = StudyFolder(study.path, is_rehearsal=True)
    assert read_status(apart).participants[0].done == session.count_done()
    assert audit_study(apart) == []
    assert main(["audit", str(study.path), "--rehearsals"]) == 0
    assert capsys.readouterr().out.startswith(f"{study.path}: 1 journal, no contradiction in them")
    assert main(["status", str(study.path), "--rehearsals"]) == 0
    assert "p01 " in capsys.readouterr().out


def answer_by_keys(session: Any, *, is_felt: bool) -> None:
    if is_felt:
        with session.frozen():  # the second digit is in time, however late
            session.press("7", "5")
    session.press("Return")


def answer_by_mouse(session: Any, *, is_felt: bool) -> None:
    """Click where the layout has slider and button on the whole screen of 1024 by 768 pixels."""
    names = ("realism", "realism", "replay", "bumps")
    trial = Trial(1, 1, 1, *names, (Part("test", "s1"),), (Judgement("test", "s1"),))
    texts, scale = make_screen_texts(read_texts()), read_scales()["realism"]
    view = View("slider", "answering", 1, Place(0, TOTAL), trial=trial, scale=scale)
    targets = {target.name: target for target in compose(view, texts, size=(1024, 768)).targets}
    track, button = targets["mark"].track, targets["confirm"].box
    if is_felt:
        session.click(track.left + 0.75 * track.width, track.top + track.height / 2)
    session.click(button.left + button.width / 2, button.top + button.height / 2)


def test_xdotool_alone_leads_through_realism(
    lab: Any, make_study: Callable[..., StudyFolder]
) -> None:
    """Somebody else's hand: blind, by what the journal holds, first with the mouse alone, then with keys alone."""
    study = make_study("realism")
    session = lab.start(study, "p01")
    session.wait_for("device")
    end_s = time.monotonic() + 3 * session.patience_s
    while session.count("finished") == 0:
        assert time.monotonic() < end_s, [record.event for record in session.records][-5:]
        answer = answer_by_mouse if session.count_done() < TOTAL / 2 else answer_by_keys
        answer(session, is_felt=session.records[-1].event in {"played", "moved", "refused"})
        time.sleep(0.1)
    code, _, err = session.finish()
    assert (code, err) == (0, "")
    values = [
        record.data["values"]["test"] for record in session.records if record.event == "rated"
    ]
    assert values == [75.0] * TOTAL
    check_whole(study)
    assert not read_status(study).participants[0].simulated


OWN_KEYS = '[keys]\nnext = ["b", "q"]\nexperimenter = "f10"\n'


def lead_by_keys(session: Any, *, until: Callable[[], bool]) -> None:
    """Rate with an arrow and continue by the pedal's key, whatever is on the screen."""
    end_s = time.monotonic() + session.patience_s
    while not until():
        assert time.monotonic() < end_s, [record.event for record in session.records][-5:]
        if session.records[-1].event in {"played", "moved", "refused"}:
            time.sleep(0.2)  # a faster answer would not count
            session.press("Right")
        session.press("b")
        time.sleep(0.1)


@pytest.mark.soak
def test_a_person_with_a_pedal_is_interrupted_by_a_crash_and_by_a_dead_server(
    rig: Any, sound: Any, make_study: Callable[..., StudyFolder]
) -> None:
    """Real keys on a real window: a resumed session waits, a failed device calls, and nothing is lost."""
    study = make_study("realism", device=STREAM)
    study.rig.write_text(study.rig.read_text(encoding="utf-8") + OWN_KEYS, encoding="utf-8")
    session = rig.start(study, "p01")
    session.wait_for("device")
    lead_by_keys(session, until=lambda: session.count("rated") >= 1)
    session.send(signal.SIGKILL)
    session.finish()

    session = rig.start(study, "p01")
    session.wait_for("device", 2)
    n_shown = session.count("shown")
    session.find_window()
    session.press("Return", "F12")  # are no keys of this lab
    time.sleep(1.5)  # longer than it took to the first vibration before there was a page
    assert session.count("shown") == n_shown
    while session.count("shown") == n_shown:
        session.press("q")
    pages = [record.data["key"] for record in session.records if record.event == "page"]
    assert pages.count("ready") == 1

    sound.kill()
    lead_by_keys(session, until=lambda: session.count("device_failed") >= 1)
    session.press("b", "F12")
    assert session.count("device_failed") == 1
    session.press("F10")
    session.wait_for("device_failed", 2)  # it was tried again, and is dead still
    sound.start()
    session.press("F10")
    lead_by_keys(session, until=lambda: session.count("finished") == 1)
    code, out, err = session.finish()
    assert (code, out.splitlines()[-1]) == (0, f"p01: {TOTAL} of {TOTAL} answered")
    assert err.count("check it, then press F10 in the participant's window") == 2
    rated = [record.data for record in session.records if record.event == "rated"]
    assert sorted(entry["trial"] for entry in rated if not entry["rejected"]) == [1, 2, 3, 4]
    check_whole(study)
