from __future__ import annotations

import json
import re
import subprocess
import sys
from typing import TYPE_CHECKING, Any

import pytest

from feel321.study.actuator.doctor import make_pulse, try_stops
from feel321.study.actuator.rig import LimitsTable, Rig
from feel321.study.session.ports import Playback

if TYPE_CHECKING:
    from pathlib import Path

RUN = [
    sys.executable,
    "-c",
    "import sys; from feel321.study.cli import main; sys.exit(main())",
    "doctor",
]


def call(pulse: Any, *arguments: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    done = subprocess.run(
        [*RUN, *arguments],
        env=pulse.env,
        cwd=cwd,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    # ALSA and PortAudio speak of underruns on their own account; doctor counts them too.
    foreign = ("ALSA lib", "Expression '")
    done.stderr = "".join(
        line for line in done.stderr.splitlines(keepends=True) if not line.startswith(foreign)
    )
    return done


def find_faults(done: subprocess.CompletedProcess[str]) -> int:
    """Count what doctor says went wrong with its pulses, which may be on a busy machine; it ends accordingly."""
    counts = re.search(r"failed (\d+), underruns (\d+)", done.stdout)
    counts = counts or re.search(r'"n_failed": (\d+),\s+"n_underruns": (\d+)', done.stdout)
    assert counts, done
    n_faults = int(counts[1]) + int(counts[2])
    assert done.returncode == int(n_faults > 0)
    return n_faults


def test_devices_are_listed_with_the_rates_that_they_take(pulse: Any, tmp_path: Path) -> None:
    done = call(pulse, cwd=tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    *devices, last = done.stdout.splitlines()
    for name in ("stylus", "stylus twin"):  # the system may list names of its own besides
        told = f"{name} (ALSA): 32 out, 32 in; plays at 8000, 16000, 44100, 48000, 96000, 192000 Hz; through a program"
        assert told in devices
    assert last == "nothing was played; name a device with --device, or in the study's rig.toml"


def test_pulses_are_played_quietly_and_measured(
    pulse: Any, make_rig: Any, insist: Any, tmp_path: Path
) -> None:
    (tmp_path / "study.toml").write_text(
        '[[recordings]]\nscene = "bumps"\n[[recordings]]\nscene = "hard_taps"\n'
    )
    sensor = "[sensor]\nchannel = 4\nfull_scale_m_s2 = 100.0"
    (tmp_path / "rig.toml").write_text(
        make_rig(sensor, channels=4, device="nowhere", latency_s=0.15)
    )

    def examine() -> tuple[Any, Any]:
        with pulse.captured() as capture:
            done = call(
                pulse,
                str(tmp_path),
                "--device",
                "stylus twin",
                "--seconds",
                "2",
                "--json",
                cwd=tmp_path,
            )
        return done, capture

    def is_disturbed(found: tuple[Any, Any]) -> bool:
        told = json.loads(found[0].stdout)["examination"]
        return find_faults(found[0]) > 0 or told["n_pulses"] < 2 or told["jitter_99_ms"] >= 100

    done, capture = insist(examine, is_disturbed=is_disturbed)
    assert done.stderr == ""
    found = json.loads(done.stdout)["examination"]
    assert found["is_program"] is True
    assert 0 < found["stop_ms"] < 2 * 150 + 50
    assert (found["device"], found["host_api"], found["rate_hz"]) == ("stylus twin", "ALSA", 48000)
    assert found["n_pulses"] >= 2
    assert found["n_failed"] == 0
    assert done.returncode == (1 if found["n_underruns"] else 0)
    assert 0 < found["onset_ms"] < 500
    assert 0 < found["sensed_ms"] < 500
    assert found["jitter_ms"] <= found["jitter_99_ms"] < 100
    assert abs(capture.samples).max() == pytest.approx(0.05, rel=0.05)


def test_a_report_for_people_says_the_same(pulse: Any, insist: Any, tmp_path: Path) -> None:
    arguments = ["--device", "stylus twin", "--seconds", "0.5"]
    done = insist(lambda: call(pulse, *arguments, cwd=tmp_path), is_disturbed=find_faults)
    played, pulses, onset, stop = done.stdout.splitlines()[-4:]
    assert played == "stylus twin (ALSA) played at 48000 Hz; latency 50.0 ms"
    assert re.fullmatch(
        r"a stop is silent after \d+ ms at most; latency_s in rig.toml shortens it", stop
    )
    assert re.fullmatch(r"pulses [1-4], failed 0, underruns \d+", pulses)
    assert onset.startswith("requested to onset ")


def test_a_program_before_the_card_is_told(
    pulse: Any, make_rig: Any, insist: Any, tmp_path: Path
) -> None:
    sensor = "[sensor]\nchannel = 4\nfull_scale_m_s2 = 100.0"
    (tmp_path / "rig.toml").write_text(
        make_rig(sensor, channels=4, device="stylus twin", latency_s=0.15)
    )
    done = insist(lambda: call(pulse, "--seconds", "0.1", cwd=tmp_path), is_disturbed=find_faults)
    assert done.stderr.startswith(
        "feel321: warning: stylus twin: a program plays it (a sound server, say)"
    )
    assert done.stderr.count("\n") == 1
    assert done.stdout.splitlines()[-2].startswith("onset's block to sensor ")


class Late:
    """An output on a machine that is late: of each stop, the first tries come after the end, or run dry."""

    is_playing = False

    def __init__(self, *tries: tuple[float | None, int]) -> None:
        self.tries = list(tries)

    def start(self, _stimulus: str, *, gap_s: float) -> None:
        assert gap_s == 0.3

    def stop(self) -> None:
        pass

    def collect(self) -> Playback:
        stop_s, underruns = self.tries.pop(0)
        measured = {} if stop_s is None else {"stop_s": stop_s}
        return Playback(0.0, 0.1, completed=stop_s is None, underruns=underruns, measured=measured)


def test_stops_are_tried_again_where_the_machine_is_late(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("feel321.study.actuator.doctor.sleep", lambda _: None)
    good, over, dry = (0.07, 0), (None, 0), (0.9, 2)
    assert try_stops(
        Late(good, over, dry, good, over, over, over, over, (0.06, 0)), lead_s=0.3
    ) == [70, 70, 60]
    assert try_stops(Late(good, good, *5 * [dry]), lead_s=0.3) == [70, 70]


def test_the_file_device_plays_nothing(pulse: Any, make_rig: Any, tmp_path: Path) -> None:
    (tmp_path / "rig.toml").write_text(make_rig(device="file"))
    done = call(pulse, cwd=tmp_path)
    assert done.returncode == 0
    assert "nothing was played" in done.stdout


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            ["--device", "nowhere"],
            "feel321: device 'nowhere' not found; name one of 'stylus' (ALSA), ",
        ),
        (["--device", " "], "feel321: device ' ' not found; name one of 'stylus' (ALSA), "),
        (["--device", "DEF"], "feel321: device 'DEF' not found; name one of 'stylus' (ALSA), "),
        (["nowhere"], "feel321: nowhere: no such folder; begin a study with: feel321 new nowhere"),
    ],
)
def test_what_is_not_there_is_one_line(
    pulse: Any, tmp_path: Path, arguments: list[str], message: str
) -> None:
    done = call(pulse, *arguments, cwd=tmp_path)
    assert done.returncode == 1
    assert done.stderr.startswith(message)
    assert done.stderr.count("\n") == 1


def test_no_device_at_all_is_one_line(pulse: Any, tmp_path: Path) -> None:
    (pulse.folder / "asound.conf").write_text('pcm.hollow { type pulse server "unix:/nowhere" }\n')
    done = call(pulse, cwd=tmp_path)
    assert done.returncode == 1
    assert done.stderr == (
        'feel321: doctor: no audio device found; plug one in, or play to files: name = "file" in rig.toml\n'
    )


def test_a_mistake_in_the_rig_is_told(pulse: Any, make_rig: Any, tmp_path: Path) -> None:
    (tmp_path / "study.toml").write_text('[[recordings]]\nscene = "bumps"\n')
    (tmp_path / "rig.toml").write_text(make_rig("[sync]\nchannel = 1"))
    done = call(pulse, cwd=tmp_path)
    assert done.returncode == 1
    assert "channel 1: got actuator 'left' and sync" in done.stderr


def test_a_pulse_keeps_far_from_the_limits() -> None:
    rig = Rig(limits=LimitsTable(peak_m_s2=20, rms_m_s2=10, duration_s=9))
    pulse = make_pulse(rig, rate_hz=48000)
    assert pulse.shape == (960, 2)
    assert abs(pulse).max() <= 0.01
    assert abs(pulse[0]).max() == abs(pulse[-1]).max() == 0
