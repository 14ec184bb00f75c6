"""The verb `run` up to the door of the lab: what it refuses before anybody gets a number, and what it says."""

import csv
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest

from feel321.study.actuator.device import Device
from feel321.study.actuator.rig import digest, read_rig
from feel321.study.check import check_study
from feel321.study.cli import main
from feel321.study.evidence.audit import examine
from feel321.study.folder import StudyFolder, create_study
from feel321.study.participants.roster import write_roster
from feel321.study.run import run_participant, start_clock
from feel321.study.screen import window
from feel321.study.session.events import RigAccepted
from feel321.study.session.journal import read_journal
from feel321.study.session.ports import Abort
from feel321.study.sessions import read_room
from feel321.study.status import read_status
from tests.study.conftest import audit_study

TOTAL = 2


@pytest.fixture
def ready(smallest: StudyFolder, monkeypatch: pytest.MonkeyPatch) -> StudyFolder:
    """A study that is built, on a machine that has all that is needed."""
    monkeypatch.setenv("DISPLAY", ":99")
    monkeypatch.setattr("feel321.study.run.find_spec", lambda _: "there")
    return smallest


@pytest.fixture
def present(scripted: Any, monkeypatch: pytest.MonkeyPatch) -> Callable[..., Any]:
    """Puts somebody into the place of screen and actuators."""

    def take_place(**script: Any) -> Any:
        presenter = scripted(**script)

        @contextmanager
        def open_presenter(*_: object, **__: object) -> Iterator[Any]:
            presenter.log.append("opened")
            yield presenter
            presenter.log.append("closed")

        monkeypatch.setattr("feel321.study.run.open_lab", open_presenter)
        return presenter

    return take_place


def visit(study: StudyFolder, participant: str = "p01", **choices: Any) -> Any:
    simulated = choices.pop("simulated", False)
    room = replace(read_room(study, now=lambda: datetime.now(UTC)), **choices)
    return run_participant(room, participant, simulated=simulated)


def test_a_session_runs_to_its_end_and_no_window_opens_for_what_is_finished(
    ready: StudyFolder, present: Callable[..., Any], capsys: pytest.CaptureFixture[str]
) -> None:
    presenter = present()
    assert main(["run", str(ready.path), "--participant", "p01"]) == 0
    assert (
        capsys.readouterr().out
        == f"p01: 0 of {TOTAL} answered so far\np01: {TOTAL} of {TOTAL} answered\n"
    )
    assert (presenter.log[0], presenter.log[-1]) == ("opened", "closed")
    presenter.log.clear()
    assert main(["run", str(ready.path), "--participant", "p01"]) == 0
    assert presenter.log == []
    assert not ready.ratings.exists()


@pytest.fixture
def devices(monkeypatch: pytest.MonkeyPatch) -> None:
    """The only audio device there is: `other`."""
    only = Device(index=0, name="other", host_api="ALSA", n_outputs=4, n_inputs=0)
    monkeypatch.setattr("feel321.study.actuator.device.list_devices", lambda: [only])


@pytest.mark.usefixtures("devices")
def test_a_device_that_is_not_there_takes_nobodys_number(
    ready: StudyFolder, present: Callable[..., Any]
) -> None:
    presenter = present()
    with pytest.raises(OSError, match="'othre' not found"):
        visit(ready, device="othre")
    assert not ready.participants
    assert presenter.log == []
    assert visit(ready, device="other").done == TOTAL


@pytest.mark.usefixtures("devices")
def test_a_device_that_is_named_by_hand_is_looked_for_in_every_host_api(
    ready: StudyFolder, present: Callable[..., Any]
) -> None:
    present()
    text = ready.rig.read_text(encoding="utf-8")
    ready.rig.write_text(
        text.replace("[device]", '[device]\nhost_api = "JACK"', 1), encoding="utf-8"
    )
    assert visit(ready, device="other").done == TOTAL


@pytest.mark.usefixtures("devices")
def test_a_rehearsal_that_was_begun_otherwise_is_told_apart(
    ready: StudyFolder, present: Callable[..., Any]
) -> None:
    present(pages={"consent": [Abort(2.0, "not today")]})
    rehearsal = replace(ready, is_rehearsal=True)
    visit(rehearsal)
    with pytest.raises(ValueError, match="or move rehearsals/ away"):
        visit(rehearsal, device="other")


@pytest.mark.usefixtures("devices")
def test_the_header_names_the_rig_and_another_one_is_refused(
    ready: StudyFolder, present: Callable[..., Any]
) -> None:
    present(pages={"consent": [Abort(2.0, "not today")]})
    assert visit(ready).stopped == "not today"
    header = read_journal(ready.journals[0]).records[0].data["presenter"]
    assert (header["simulated"], header["rehearsal"], header["rig"]["device"]["name"]) == (
        False,
        False,
        "file",
    )
    with pytest.raises(
        ValueError, match=r"begun otherwise \(presenter\.rig\.device\.name 'file' -> 'other'\)"
    ):
        visit(ready, device="other")
    assert visit(ready).done == TOTAL


@pytest.mark.usefixtures("devices")
def test_another_rig_takes_over_where_nobody_has_done_anything_yet(
    ready: StudyFolder, present: Callable[..., Any]
) -> None:
    present(pages={"welcome": [Abort(2.0, "no sound")]})
    assert visit(ready).stopped == "no sound"
    present(pages={"welcome": [Abort(2.0, "still none")]})
    assert visit(ready, device="other").stopped == "still none"
    present()
    assert visit(ready).done == TOTAL
    chains = [read_journal(path).records for path in ready.journals]
    names = [records[0].data["presenter"]["rig"]["device"]["name"] for records in chains]
    assert names == ["file", "other", "file"]
    assert [records[-1].event for records in chains] == ["superseded", "superseded", "finished"]
    assert audit_study(ready) == []
    assert read_status(ready).participants[0].done == TOTAL


@pytest.mark.usefixtures("devices")
def test_a_spare_device_is_accepted_by_name_and_recorded_with_what_differs(
    ready: StudyFolder, present: Callable[..., Any], capsys: pytest.CaptureFixture[str]
) -> None:
    command = ["run", str(ready.path), "--participant", "p01"]
    present(pages={"rest": [Abort(9.0, "card broke")]})
    assert main(command) == 1
    capsys.readouterr()
    assert main([*command, "--device", "other"]) == 1
    assert "go on with the rig as it is now (--accept-rig, which records it)" in (
        capsys.readouterr().err
    )
    present(pages={"rest": [Abort(9.0, "tired")]})
    assert main([*command, "--device", "other", "--accept-rig"]) == 1
    assert capsys.readouterr().err.rstrip().endswith("--participant p01 --device other")
    present()
    assert main([*command, "--device", "other"]) == 0  # it need not be accepted again
    (records,) = (read_journal(path).records for path in ready.journals)
    (event,) = records.find(RigAccepted)
    assert event.changes == ["presenter.rig.device.name 'file' -> 'other'"]
    assert event.rig is not None
    assert event.rig["device"]["name"] == "other"
    assert audit_study(ready) == []
    capsys.readouterr()
    assert main(["audit", str(ready.path)]) == 0
    line = f"p01: the rig was changed in mid-session ({event.changes[0]})"
    assert line in capsys.readouterr().out.splitlines()
    assert line in read_status(ready).summary().splitlines()


@pytest.mark.usefixtures("devices")
def test_nothing_but_the_rig_can_be_accepted(
    ready: StudyFolder, present: Callable[..., Any]
) -> None:
    present(pages={"rest": [Abort(9.0, "tired")]})
    visit(ready)
    text = ready.settings.read_text(encoding="utf-8")
    ready.settings.write_text(
        text.replace("[session]", "[session]\nlanguage = 'de'", 1), encoding="utf-8"
    )
    with pytest.raises(ValueError, match="begun otherwise") as refused:
        visit(ready, device="other", accept_rig=True)
    assert "--accept-rig" not in str(refused.value)


@pytest.mark.usefixtures("devices")
def test_participants_on_another_rig_than_most_are_named(
    ready: StudyFolder, present: Callable[..., Any]
) -> None:
    for name, device in (
        ("p01", None),
        ("p02", "other"),
        ("p03", None),
        ("p04", "other"),
        ("p05", None),
    ):
        present()
        visit(ready, name, device=device)
    with write_roster(ready).open(encoding="utf-8", newline="") as file:
        rows = {row["participant"]: row for row in csv.DictReader(file)}
    file_rig, other = rows["p01"]["rig"], rows["p02"]["rig"]
    assert file_rig == digest(read_rig(ready.rig))[:12] != other
    assert [row["rig"] for row in rows.values()] == [file_rig, other] * 2 + [file_rig]
    line = f"p02, p04: another rig ({other}) than the other 3 ({file_rig})"
    assert line in read_status(ready).summary().splitlines()
    assert line in examine(ready).remarks


def test_who_stops_is_told_how_to_go_on(
    ready: StudyFolder, present: Callable[..., Any], capsys: pytest.CaptureFixture[str]
) -> None:
    present(pages={"rest": [Abort(9.0, "tired")]})
    assert main(["run", str(ready.path), "--participant", "p01", "--windowed"]) == 1
    line = f"p01: 1 of {TOTAL} answered (aborted: tired); resume with: "
    line += f"feel321 run {ready.path} --participant p01 --windowed"
    assert capsys.readouterr().err == f"{line}\n"


def test_the_command_that_goes_on_has_every_option(
    ready: StudyFolder, present: Callable[..., Any], capsys: pytest.CaptureFixture[str]
) -> None:
    present(stop_after=1)
    options = [
        "--participant",
        "p01",
        "--device",
        "file",
        "--rehearse",
        "--simulate-participant",
        "--seed",
        "0",
    ]
    assert main(["run", str(ready.path), *options]) == 130
    told, interrupted = capsys.readouterr().err.splitlines()
    command = f"feel321 run {ready.path} {' '.join(options)}"
    assert (
        told == f"p01: 1 of {TOTAL} answered (aborted: KeyboardInterrupt); resume with: {command}"
    )
    assert interrupted == "feel321: interrupted; what is done is kept, the same command continues"
    assert read_status(ready).participants == ()
    assert read_status(replace(ready, is_rehearsal=True)).participants[0].done == 1


def test_termination_is_met_as_ctrl_c_is_and_only_during_the_session(
    ready: StudyFolder, present: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    before = signal.getsignal(signal.SIGTERM)
    presenter = present()
    monkeypatch.setattr(presenter, "play", lambda *_, **__: signal.raise_signal(signal.SIGTERM))
    assert main(["run", str(ready.path), "--participant", "p01"]) == 143
    assert read_journal(ready.journals[0]).records[-1].data["reason"] == "Terminated: 15"
    assert signal.getsignal(signal.SIGTERM) == before


def test_what_was_mended_is_told(ready: StudyFolder, present: Callable[..., Any]) -> None:
    present(pages={"rest": [Abort(9.0, "tired")]})
    visit(ready)
    ready.journals[0].write_bytes(ready.journals[0].read_bytes() + b"torn")
    told: list[str] = []
    present()
    room = read_room(ready, now=lambda: datetime.now(UTC))
    run_participant(room, "p01", warn=told.append)
    assert len(told) == 1
    assert "session-01.jsonl.torn1" in told[0]


@pytest.mark.parametrize(
    ("missing", "device", "words"),
    [
        ({"psychopy"}, "file", "psychopy not found"),
        ({"psychopy", "sounddevice"}, "other", "psychopy and sounddevice not found"),
        ({"sounddevice"}, "other", "sounddevice not found"),
    ],
)
def test_a_machine_without_the_extra_is_told_what_to_install(
    ready: StudyFolder, monkeypatch: pytest.MonkeyPatch, missing: set[str], device: str, words: str
) -> None:
    monkeypatch.setattr(
        "feel321.study.run.find_spec", lambda name: None if name in missing else "there"
    )
    with pytest.raises(
        OSError, match=rf"run: {words}, .*: pip install -c constraints.txt '.\[rig\]'"
    ):
        visit(ready, device=device)
    assert not ready.participants  # Nobody got a number.


@pytest.mark.skipif(
    sys.platform != "linux", reason="NO X11 HERE: only there a display is named by DISPLAY"
)
def test_no_display_is_one_line(ready: StudyFolder, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("DISPLAY")
    with pytest.raises(OSError, match="run: no display found"):
        visit(ready)
    assert not ready.participants


def test_no_rig_is_one_line(ready: StudyFolder) -> None:
    ready.rig.unlink()
    with pytest.raises(
        FileNotFoundError, match=r"rig\.toml: there is none; feel321 new DIR writes one"
    ):
        visit(ready)
    assert list(check_study(ready).problems) == []  # Simulated participants need none.


def test_a_rig_that_cannot_play_the_stimuli_is_refused_by_run_and_check_alike(
    ready: StudyFolder,
) -> None:
    text = ready.rig.read_text(encoding="utf-8").replace('"reduced", ', "")
    ready.rig.write_text(text, encoding="utf-8")
    with pytest.raises(ValueError, match=r"^rig\.toml: .*no actuator plays reduced") as error:
        visit(ready)
    assert list(check_study(ready).problems) == str(error.value).splitlines()
    assert not ready.participants


def test_check_finds_mistakes_in_the_rig_before_anything_is_built(tmp_path: Path) -> None:
    study = create_study(tmp_path / "a")
    assert list(check_study(study).problems) == []
    study.rig.write_text("[device]\nnme = 'x'\n", encoding="utf-8")
    assert [line.partition(":")[0] for line in check_study(study).problems] == ["rig.toml"] * 2


def test_new_keeps_a_rig_that_is_there(tmp_path: Path) -> None:
    (tmp_path / "rig.toml").write_text("mine", encoding="utf-8")
    assert create_study(tmp_path).rig.read_text(encoding="utf-8") == "mine"


def test_the_clock_goes_on_where_it_stopped(monkeypatch: pytest.MonkeyPatch) -> None:
    times = iter([100.0, 100.5])
    monkeypatch.setattr("feel321.study.run.perf_counter", lambda: next(times))
    assert start_clock(40.0)() == 40.5


def test_a_person_who_has_not_begun_is_not_taken_over_by_a_simulated_one(
    ready: StudyFolder, present: Callable[..., Any]
) -> None:
    present(pages={"welcome": [Abort(2.0, "not today")]})
    visit(ready)
    with pytest.raises(ValueError, match="p01"):
        visit(ready, simulated=True)
    assert len(ready.journals) == 1


def test_a_monitor_that_is_not_there_takes_nobodys_number(
    ready: StudyFolder, present: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = []

    def refuse(screen: int) -> None:
        asked.append(screen)
        raise ValueError("--screen must be")

    monkeypatch.setattr(window, "check_screen", refuse)
    presenter = present()
    assert main(["run", str(ready.path), "--participant", "p01", "--screen", "3"]) == 1
    assert (asked, presenter.log, ready.participants) == ([3], [], [])


def test_the_window_opens_on_the_monitor_that_was_asked_for(
    ready: StudyFolder, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(window, "check_screen", lambda _: None)

    @contextmanager
    def open_screen(**choices: Any) -> Iterator[Any]:
        assert (choices["screen"], choices["windowed"]) == (1, True)
        raise RuntimeError("as asked")
        yield

    monkeypatch.setattr(window, "open_screen", open_screen)
    command = ["run", str(ready.path), "--participant", "p01", "--windowed", "--screen", "1"]
    assert main(command) == 1
    assert "as asked" in capsys.readouterr().err


def test_who_stops_goes_on_at_the_same_monitor(
    ready: StudyFolder,
    present: Callable[..., Any],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(window, "check_screen", lambda _: None)
    present(pages={"rest": [Abort(9.0, "tired")]})
    assert main(["run", str(ready.path), "--participant", "p01", "--screen", "1"]) == 1
    assert capsys.readouterr().err.endswith(" --participant p01 --screen 1\n")
