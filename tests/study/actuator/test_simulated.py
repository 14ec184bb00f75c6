"""The simulated device: what its sensor measures is what the coils of `[simulation]` make of what is sent."""

from __future__ import annotations

from time import perf_counter, sleep
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy import signal

from feel321.stimuli.wav import read_wav
from feel321.study.actuator.device import BLOCK_FRAMES, discretise
from feel321.study.actuator.output import open_output
from feel321.study.actuator.rig import CoilTable, read_rig

if TYPE_CHECKING:
    from pathlib import Path

RATE_HZ = 8000.0
RIG = """
[device]
name = "simulated"
latency_s = 0.1
[[actuators]]
name = "left coil"
channel = 1
direction = [1, 0, 0]
[[actuators]]
name = "right coil"
channel = 2
[limits]
peak_m_s2 = 100.0
rms_m_s2 = 60.0
duration_s = 30.0
[sensor]
{sensor}
[simulation]
speed = 10
latency = 40
noise_m_s2 = 0.0
[[simulation.coils]]
name = "right coil"
resonance_hz = 100
q = 2
full_scale_m_s2 = 50
direction = [0, 3, 4]
latency = 3
"""


def make_rig(folder: Path, sensor: str) -> Any:
    (folder / "rig.toml").write_text(RIG.format(sensor=sensor), encoding="utf-8")
    return read_rig(folder / "rig.toml")


def test_a_playback_comes_back_through_coils_and_sensor(tmp_path: Path) -> None:
    sound = np.zeros((4000, 2), dtype=np.float32)
    sound[:, 1] = np.random.default_rng(1).uniform(-0.5, 0.5, 4000)
    rig = make_rig(tmp_path, "channels = [1, 2, 3]\nfull_scale_m_s2 = 200.0")
    opened = open_output(
        rig, {"noise": sound}, rate_hz=RATE_HZ, folder=tmp_path, clock=perf_counter
    )
    with opened as output:
        output.start("noise", gap_s=0.05)
        while output.is_playing:
            sleep(0.001)
        playback = output.collect()
    assert (playback.completed, playback.error, playback.underruns) == (True, "", 0)
    measured, rate_hz = read_wav(tmp_path / f"{playback.measured['file_number']:04.0f}.wav")
    np.testing.assert_array_equal(measured, output.captured)
    late = BLOCK_FRAMES + 40 + 3
    coil = discretise(CoilTable(name="coil", resonance_hz=100, q=2), rate_hz=RATE_HZ)
    expected = np.outer([0, 0.6, 0.8], 50 * signal.lfilter(*coil, sound[:, 1]))
    assert rate_hz == RATE_HZ
    np.testing.assert_allclose(measured[:, late : late + 4000], expected, atol=1e-4)
    assert not measured[:, :late].any()
