from __future__ import annotations

import json
import re
import subprocess
import sys
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from scipy import signal

from feel321.study.actuator.doctor import check_sensor, make_pulse, try_stops
from feel321.study.actuator.rig import LimitsTable, Rig, SensorTable
from feel321.study.session.ports import Playback

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

RIG = Rig(
    limits=LimitsTable(peak_m_s2=100, rms_m_s2=50, duration_s=60),
    sensor=SensorTable(channel=3, full_scale_m_s2=20),
)
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
    # On a busy machine the server may lose samples without a flag; then the sensor has no pulse either.
    n_faults = int(counts[1]) + int(counts[2]) + done.stderr.count("feel321: sensor on channel")
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
    assert found["sensor"]["n_recorded"] == len(found["sensor"]["lags_ms"]) >= 2
    # The sink's monitor is the sensor: it measures the pulse as it was sent, after silence.
    sent_m_s2 = 5 * np.sqrt(np.mean((make_pulse(RIG, rate_hz=48000)[:, 0] / 0.05) ** 2))
    assert found["sensor"]["level_m_s2"] == pytest.approx(sent_m_s2, rel=0.02)
    assert found["sensor"]["noise_m_s2"] < 0.01 * sent_m_s2
    assert found["jitter_ms"] <= found["jitter_99_ms"] < 100
    assert abs(capture.samples).max() == pytest.approx(0.05, rel=0.05)


def test_a_report_for_people_says_the_same_and_names_a_program_before_the_card(
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
    facts = dict(line.strip().partition(" ")[::2] for line in done.stdout.splitlines())
    assert (facts["device"], facts["n_failed"]) == ("stylus twin", "0")
    assert 100 <= float(facts["latency_ms"]) < 200
    assert {"onset_ms", "sensed_ms", "level_m_s2", "stop_ms"} <= facts.keys()


# No coil plays on channel 3 of the sink.
DEAD = "[sensor]\nchannel = 3\nfull_scale_m_s2 = 100.0"


def test_a_dead_sensor_fails_with_one_line_and_no_jitter(
    pulse: Any, make_rig: Any, insist: Any, tmp_path: Path
) -> None:
    (tmp_path / "rig.toml").write_text(
        make_rig(DEAD, channels=4, device="stylus twin", latency_s=0.15)
    )

    def is_disturbed(done: subprocess.CompletedProcess[str]) -> bool:
        return "failed 0, underruns 0" not in done.stdout

    done = insist(lambda: call(pulse, "--seconds", "0.5", cwd=tmp_path), is_disturbed=is_disturbed)
    assert done.returncode == 1
    assert "sensor: pulse found in 0 of " in done.stdout
    assert "onset's block to sensor" not in done.stdout
    (line,) = [line for line in done.stderr.splitlines() if "warning" not in line]
    assert re.fullmatch(
        r"feel321: sensor on channel 3, (\d+) of \1 pulses: got no signal \(every sample is alike: 0 m/s²\), "
        r"expected a pulse of 0\.22 to 65 m/s² RMS; check the sensor's power and cable, the input's mute, "
        r"and \[sensor\] channel in rig.toml",
        line,
    )


def listen(
    *, gain: float = 1.0, noise_m_s2: float = 0.01, offset_m_s2: float = 0.0, rate_hz: float = 48000
) -> NDArray[np.float64]:
    """What a sensor beside a coil of 160 Hz, Q 4 measures: the pulse after 0.1 s, noise, and gravity."""
    resonance = 2 * np.pi * 160
    coil = signal.bilinear([1, 0, 0], [1, resonance / 4, resonance**2], rate_hz)
    pulse = make_pulse(RIG, rate_hz=rate_hz)[:, 0] * 100
    sent = np.zeros(round(0.25 * rate_hz))
    sent[round(0.1 * rate_hz) :][: len(pulse)] = gain * pulse
    noise = np.random.default_rng(5).normal(scale=noise_m_s2, size=len(sent))
    return np.asarray(signal.lfilter(*coil, sent) + noise + offset_m_s2)


def check(*recordings: NDArray[np.float64], rate_hz: float = 48000, rig: Rig = RIG) -> Any:
    pulse = make_pulse(rig, rate_hz=rate_hz)
    return check_sensor(rig, [one[None] for one in recordings], pulse=pulse, rate_hz=rate_hz)


@pytest.mark.parametrize("rate_hz", [8000, 48000])
@pytest.mark.parametrize(
    "heard", [{}, {"offset_m_s2": -9.81}, {"gain": -1.0}, {"gain": 0.2}, {"noise_m_s2": 1.0}]
)
def test_a_sensor_that_shows_the_pulse_passes(heard: dict[str, float], rate_hz: float) -> None:
    found = check(listen(**heard, rate_hz=rate_hz), rate_hz=rate_hz)
    assert found.fault == ""
    assert found.lags_ms == [pytest.approx(100, abs=4)]  # a quarter of a period, and the resonance
    assert found.noise_m_s2 == pytest.approx(heard.get("noise_m_s2", 0.01), rel=0.1)


TIMES_S = np.arange(12000) / 48000


@pytest.mark.parametrize(
    ("recording", "fault"),
    [
        (np.zeros(12000), "got no signal (every sample is alike: 0 m/s²), expected a pulse of "),
        (np.full(12000, 9.0), "got no signal (every sample is alike: 9 m/s²)"),
        (np.clip(listen(gain=5), -20, 20), "got a clipped recording (full scale is 20 m/s²)"),
        (np.clip(listen(gain=5), -20, 99) + 1e-3, "got a clipped recording"),
        (listen(gain=0), "got no pulse (at best 0.0"),
        (np.sin(2 * np.pi * 250 * TIMES_S), "got no pulse"),  # hum of the pulse's own frequency
        (listen(gain=0) + 9.0 * (abs(TIMES_S - 0.1) < 1e-4), "got no pulse"),  # a knock
        (listen(gain=0.3, noise_m_s2=1.0), "got no pulse"),
        (listen(gain=0.02, noise_m_s2=1e-4), "got a pulse of 0.076 m/s² RMS, expected 0.22 to 43"),
    ],
)
def test_a_sensor_without_the_pulse_is_named(recording: NDArray[np.float64], fault: str) -> None:
    found = check(recording, listen())
    assert found.fault.startswith(f"sensor on channel 3, 1 of 2 pulses: {fault}")
    assert (found.n_recorded, len(found.lags_ms)) == (2, 1)
    assert "; " in found.fault
    assert "\n" not in found.fault


@pytest.mark.parametrize("recordings", [[], [np.zeros(0)], [np.zeros(959)]])
def test_a_sensor_that_records_nothing_is_named(recordings: list[NDArray[np.float64]]) -> None:
    assert check(*recordings).fault == (
        "sensor on channel 3: got no samples, expected a recording of each pulse; check the input device"
    )


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


def test_no_device_at_all_is_one_line(pulse: Any, tmp_path: Path) -> None:
    (pulse.folder / "asound.conf").write_text('pcm.hollow { type pulse server "unix:/nowhere" }\n')
    done = call(pulse, cwd=tmp_path)
    assert done.returncode == 1
    assert done.stderr == (
        'feel321: doctor: no audio device found; plug one in, or play to files: name = "file" in rig.toml\n'
    )


def test_a_pulse_keeps_far_from_the_limits() -> None:
    rig = Rig(limits=LimitsTable(peak_m_s2=20, rms_m_s2=10, duration_s=9))
    pulse = make_pulse(rig, rate_hz=48000)
    assert pulse.shape == (960, 2)
    assert abs(pulse).max() <= 0.01
    assert abs(pulse[0]).max() == abs(pulse[-1]).max() == 0
