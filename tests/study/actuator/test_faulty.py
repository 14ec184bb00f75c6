"""Faults between samples and hand on a real audio stack, each found in what the sensor heard, and named."""

from __future__ import annotations

import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from feel321.protocols.trial import Flow
from feel321.stimuli.sets.build import build_stimuli
from feel321.stimuli.sets.recipe import Recipe
from feel321.stimuli.synthesis import make_scene
from feel321.stimuli.wav import read_wav
from feel321.study.actuator.delivered import DeliveryCheck, reduce_stimuli
from feel321.study.actuator.rig import read_rig
from feel321.study.session.events import find_loss

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

FULL_SCALE = 100.0
BRIDGE = Path(__file__).with_name("faulty.py")
RIG = """
[device]
name = "stylus"
latency_s = 0.1
[[actuators]]
name = "moved"
channel = 1
direction = [1, 0, 0]
[[actuators]]
name = "other"
channel = 2
plays = ["y"]
direction = [0, 1, 0]
[limits]
peak_m_s2 = 100.0
rms_m_s2 = 50.0
duration_s = 30.0
[sensor]
channel = 1
full_scale_m_s2 = 100.0
"""
FAULTS = {
    "none": "", "coil dead": "no trace of the stimulus", "amplifier half": "6.0 dB too weak",
    "polarity": "inverted", "channels swapped": "no trace of the stimulus", "sensor dead": "the sensor is silent",
    "stream moved": "no trace of the stimulus",
}  # fmt: skip


class Stub:
    """A certificate that found each coil as rig.toml has it."""

    method, coils = "manual", {}


def control(pulse: Any, *words: str) -> str:
    return subprocess.run(
        ["pactl", *words], env=pulse.env, capture_output=True, text=True, check=True
    ).stdout.strip()


def is_named(found: dict[str, float], told: str) -> bool:
    loss = find_loss(found, Flow())
    is_whole = bool(told) or found["coherence"] > 0.99
    return told in loss and bool(loss) == bool(told) and is_whole


def move_streams(pulse: Any) -> None:
    """Move what plays to the participant's sink to another one, as a careless click in a mixer would."""
    sinks, streams = (
        [line.split("\t") for line in control(pulse, "list", "short", kind).splitlines()]
        for kind in ("sinks", "sink-inputs")
    )
    (ours,) = [number for number, name, *_ in sinks if name == "stylus"]
    for number, place, *_ in streams:
        if place == ours:
            control(pulse, "move-sink-input", number, "elsewhere")


@contextmanager
def bridged(pulse: Any, fault: Path) -> Iterator[None]:
    """Put two more sinks beside `stylus`, and the faulty path from there to the sensor's."""
    form = "rate=48000 format=float32le"
    modules = [
        control(pulse, "load-module", "module-null-sink", *f"sink_name={name} channels={n} {form}".split())
        for name, n in (("sensor", 1), ("elsewhere", 2))
    ]  # fmt: skip
    command = [sys.executable, str(BRIDGE), "stylus.monitor", "sensor", "2", str(fault)]
    process = subprocess.Popen(command, env=pulse.env)
    try:
        yield
    finally:
        process.terminate()
        process.wait()
        for module in modules:
            control(pulse, "unload-module", module)


@pytest.mark.soak
@pytest.mark.parametrize("pulse", [2], indirect=True)
def test_each_fault_of_the_path_is_named(
    pulse: Any,
    open_player: Callable[..., Any],
    insist: Callable[..., Any],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("PULSE_SINK", "stylus")
    monkeypatch.setenv("PULSE_SOURCE", "sensor.monitor")
    recording = make_scene("isotropic_rumble", duration_s=1.0)
    recipe = Recipe(reducers=("sax321",), anchors=False)
    stimuli = build_stimuli(recording, tmp_path / "set", recipe)
    one = stimuli.stimuli[0]
    sound = np.zeros((one.n_samples, 2), dtype=np.float32)
    sound[:, 0] = stimuli.read(one.stimulus_id)[0]
    fault, part = tmp_path / "fault", tmp_path / "fault.part"
    fault.write_text("none", encoding="utf-8")
    with bridged(pulse, fault):
        player = open_player(pulse, RIG, {"s": sound})
        assert "identity" in player.hear()
        rig = read_rig(tmp_path / "rig.toml")
        check = DeliveryCheck(
            stimuli,
            rig,
            full_scale_m_s2=FULL_SCALE,
            reduced=reduce_stimuli(stimuli, [recording], recipe),
            certificate=Stub(),
        )

        def play() -> tuple[Any, dict[str, float]]:
            if fault.read_text(encoding="utf-8") == "stream moved":
                move_streams(
                    pulse
                )  # each time: after an underrun the stream may be a new one, at its first place
            played = player.ask(do="play", sound="s", gap_s=0.1)
            number = int(played["measured"]["file_number"])
            measured, _ = read_wav(tmp_path / "delivered" / f"{number:04}.wav")
            return played, check.measure(one.stimulus_id, np.atleast_2d(measured))

        for name, told in FAULTS.items():
            part.write_text(name, encoding="utf-8")
            part.replace(fault)  # in one step: the bridge reads it all the time
            time.sleep(0.3)  # what is on its way arrives
            # A gap in the bridge, on a busy machine, is a fault that was not planted.
            _, found = insist(play, is_disturbed=lambda one, told=told: not is_named(one[1], told))
            assert is_named(found, told), (name, find_loss(found, Flow()), found)
            if name == "none":
                assert found["coherence"] > 0.9
                assert found["level_error_db"] == pytest.approx(0, abs=0.3)
