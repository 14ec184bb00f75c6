import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import signal

from feel321.study.actuator.doctor import find_fault, find_pulse, make_pulse
from feel321.study.actuator.response import Sweep, make_sweep, measure_sweep
from feel321.study.actuator.rig import LimitsTable, Rig, SensorTable
from tests.study.actuator.outside import Loop, make_rig

RIG = Rig(
    limits=LimitsTable(peak_m_s2=100, rms_m_s2=50, duration_s=60),
    sensor=SensorTable(channels=(1, 2, 3), full_scale_m_s2=20),
)
RUN = "import sys; from feel321.study.cli import main; sys.exit(main())"


def call(pulse: Any, *arguments: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    how: Any = {"env": pulse.env, "cwd": cwd, "capture_output": True, "text": True, "timeout": 300}
    command = [sys.executable, "-c", RUN, "doctor", *arguments]
    done = subprocess.run(command, check=False, **how)
    # ALSA and PortAudio speak of underruns on their own account; doctor counts them too.
    foreign = ("ALSA lib", "Expression '")
    done.stderr = "".join(
        line for line in done.stderr.splitlines(keepends=True) if not line.startswith(foreign)
    )
    return done


def test_devices_are_listed_with_the_rates_that_they_take(pulse: Any, tmp_path: Path) -> None:
    done = call(pulse, "--json", cwd=tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    found = {one["name"]: one for one in json.loads(done.stdout)["devices"]}
    for name in ("stylus", "stylus twin"):  # the system may list names of its own besides
        assert (found[name]["host_api"], found[name]["is_program"]) == ("ALSA", True)
        assert found[name]["rates_hz"] == [8000, 16000, 44100, 48000, 96000, 192000]


def test_pulses_are_played_quietly_and_measured(
    pulse: Any, make_rig: Any, insist: Any, tmp_path: Path
) -> None:
    (tmp_path / "study.toml").write_text(
        '[[recordings]]\nscene = "bumps"\n[[recordings]]\nscene = "hard_taps"\n'
    )
    sensor = "[sensor]\nchannels = [4, 4, 4]\nfull_scale_m_s2 = 100.0"
    (tmp_path / "rig.toml").write_text(
        make_rig(sensor, channels=4, device="nowhere", latency_s=0.15)
    )

    def examine() -> tuple[Any, Any]:
        with pulse.captured() as capture:
            options = ("--device", "stylus twin", "--seconds", "2", "--json")
            done = call(pulse, str(tmp_path), *options, cwd=tmp_path)
        return done, capture

    def is_disturbed(found: tuple[Any, Any]) -> bool:
        told = json.loads(found[0].stdout)["examination"] if found[0].stdout else None
        return (
            told is None
            or told["n_failed"] + told["n_underruns"] > 0
            or told["n_pulses"] < 2
            or told["onset_jitter_99_ms"] >= 100
        )

    done, capture = insist(examine, is_disturbed=is_disturbed)
    # The sensor's axes are all the monitor of channel 4, on which only the spare coil plays, whose axis is z.
    lines = [line.removeprefix("feel321: ") for line in done.stderr.splitlines()]
    faults = [line for line in lines if "program plays" not in line]
    expected = ("left: sensor dead", "right: sensor dead", "spare: moves along [0.58, 0.58, 0.58]")
    assert [line[: len(start)] for line, start in zip(faults, expected, strict=True)] == [*expected]
    assert done.returncode == 1
    found = json.loads(done.stdout)["examination"]
    assert found["is_program"] is True
    assert (found["device"], found["host_api"], found["rate_hz"]) == ("stylus twin", "ALSA", 48000)
    assert found["n_pulses"] >= 2
    assert found["n_failed"] == 0
    assert 0 < found["onset_ms"] < 500
    assert 0 < found["sensed_ms"] < 500
    assert found["n_sensed"] >= 2
    assert found["onset_jitter_ms"] <= found["onset_jitter_99_ms"] < 100
    assert abs(capture.samples).max() < 0.25  # pulses and probes are quiet


def listen(
    *, gain: float = 1.0, noise_m_s2: float = 0.01, offset_m_s2: float = 0.0, rate_hz: float = 48000
) -> NDArray[np.float32]:
    """What a sensor beside a coil of 160 Hz, Q 4 measures: the pulse after 0.1 s, noise, and gravity."""
    resonance = 2 * np.pi * 160
    coil = signal.bilinear([1, 0, 0], [1, resonance / 4, resonance**2], rate_hz)
    pulse = make_pulse(RIG, rate_hz=rate_hz)[:, 0] * 100
    sent = np.zeros(round(0.25 * rate_hz))
    sent[round(0.1 * rate_hz) :][: len(pulse)] = gain * pulse
    noise = np.random.default_rng(5).normal(scale=noise_m_s2, size=len(sent))
    return np.asarray(signal.lfilter(*coil, sent) + noise + offset_m_s2, dtype=np.float32)


@pytest.mark.parametrize("rate_hz", [8000, 48000])
@pytest.mark.parametrize(
    ("heard", "is_there"),
    [
        ({}, True), ({"offset_m_s2": -9.81}, True), ({"gain": -1.0}, True), ({"gain": 0.2}, True),
        ({"noise_m_s2": 1.0}, True), ({"gain": 0.0}, False), ({"gain": 0.3, "noise_m_s2": 3.0}, False),
    ],
)  # fmt: skip
def test_a_pulse_is_found_to_the_millisecond_or_not_at_all(
    heard: dict[str, float], is_there: bool, rate_hz: float
) -> None:
    found = find_pulse(listen(**heard, rate_hz=rate_hz)[None], make_pulse(RIG, rate_hz=rate_hz))
    assert (found is not None) == is_there
    if found is not None:
        # A quarter of a period, and the resonance.
        assert 1e3 * found / rate_hz == pytest.approx(100, abs=4)
    assert find_pulse(None, make_pulse(RIG, rate_hz=rate_hz)) is None


PROBE = Sweep(rate_hz=48000, band_hz=(30, 800), duration_s=0.8, pause_s=0.3, n_repeats=2, peak=0.2)


@pytest.mark.parametrize(
    ("change", "fault"),
    [
        ({}, ""),
        ({"gains": (1, 0, 1)}, "dead"),
        ({"gains": (1, -1, 1)}, "inverted"),
        ({"sensor": (0, 0, 0)}, "sensor dead"),
        ({"order": (1, 0, 2)}, "right and left swapped"),
        ({"rate": 0.91875}, "wrong rate: played at 44100 Hz"),
    ],
)
def test_a_coil_without_a_certificate_is_judged_by_rig_toml(change: Any, fault: str) -> None:
    rig, sent = make_rig(), make_sweep(PROBE)
    frames = np.zeros((len(sent), 3))
    frames[:, 1] = sent
    recorded = Loop().but(**change).move(frames)
    seen = measure_sweep(PROBE, recorded) if recorded.any() else None
    found = find_fault(rig, rig.actuators[1], seen, recorded=recorded, sent=sent)
    assert found.startswith(fault)
    assert bool(found) == bool(fault)


def test_a_sink_that_lacks_the_third_channel_is_named() -> None:
    """A sound server mixes what it has no channel for into the others."""
    rig, sent = make_rig(), make_sweep(PROBE)
    recorded = Loop().move(np.outer(sent, (0.7, 0.7, 0.0)))
    seen = measure_sweep(PROBE, recorded)
    found = find_fault(rig, rig.actuators[2], seen, recorded=recorded, sent=sent)
    assert found.startswith("dead, its samples move left and right: the sink lacks channel 3")
