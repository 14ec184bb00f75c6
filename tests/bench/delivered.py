"""What simulated coils deliver of a study's stimuli, before and after calibration: `make bench`.

Each stimulus is played on the simulated device, through the stream that sessions use, and measured by a three-axis
sensor. Intended and delivered match metrics, level errors and coherence, uncalibrated and with a certificate.
"""

from __future__ import annotations

import tempfile
from datetime import UTC, datetime
from pathlib import Path
from time import perf_counter, sleep
from typing import TYPE_CHECKING

import numpy as np
from figures import Figure

from feel321.protocols.trial import Flow
from feel321.stimuli.sets.build import build_stimuli
from feel321.stimuli.sets.recipe import Recipe
from feel321.stimuli.synthesis import make_scene
from feel321.study.actuator.calibrate import Calibration
from feel321.study.actuator.delivered import DeliveryCheck, reduce_stimuli
from feel321.study.actuator.output import open_output
from feel321.study.actuator.render import render_stimulus
from feel321.study.actuator.rig import read_rig
from feel321.study.session.events import find_loss

if TYPE_CHECKING:
    from collections.abc import Iterator

    from feel321.stimuli.sets.manifest import StimulusSet
    from feel321.study.actuator.mixer import Sounds
    from feel321.study.actuator.rig import Rig
    from feel321.study.session.ports import Playback

RATE_HZ, FULL_SCALE = 48000.0, 20.0
SCENES = ("bumps", "texture_drag", "hard_taps", "isotropic_rumble")
REDUCERS = ("sax321", "mag321", "dft321", "dft321_windowed")
RECIPE = Recipe(reducers=REDUCERS, full_scale_m_s2=FULL_SCALE, anchors=False)
MATCHES = ("spectral_match", "temporal_match", "spectral_match_bounded")
SPEED = 50
RIG = """
[device]
name = "simulated"
[[actuators]]
name = "left coil"
channel = 1
full_scale_m_s2 = 100.0
plays = ["reduced", "x"]
direction = [1, 0, 0]
[[actuators]]
name = "right coil"
channel = 2
full_scale_m_s2 = 100.0
plays = ["reduced", "y"]
direction = [0, 1, 0]
[[actuators]]
name = "third coil"
channel = 3
full_scale_m_s2 = 100.0
plays = ["z"]
direction = [0, 0, 1]
[limits]
peak_m_s2 = 2000.0
rms_m_s2 = 1000.0
duration_s = 60.0
[sensor]
channels = [1, 2, 3]
full_scale_m_s2 = 2000.0
[calibration]
max_gain_db = 50.0
level = 0.2
[simulation]
speed = 50.0
noise_m_s2 = 0.02
[[simulation.coils]]
name = "left coil"
resonance_hz = 80.0
q = 1.0
[[simulation.coils]]
name = "right coil"
resonance_hz = 160.0
q = 3.0
[[simulation.coils]]
name = "third coil"
resonance_hz = 250.0
q = 8.0
"""


def measure() -> Iterator[Figure]:
    """Play everything, uncalibrated and calibrated; the largest errors with a certificate."""
    recordings = [make_scene(name) for name in SCENES]
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "rig.toml").write_text(RIG, encoding="utf-8")
        rig = read_rig(Path(folder) / "rig.toml")
        stimuli = build_stimuli(recordings, Path(folder) / "set", RECIPE)
        begin_s = perf_counter()
        reduced = reduce_stimuli(stimuli, recordings, RECIPE)
        print(f"{len(reduced)} reductions made again in {perf_counter() - begin_s:.2f} s")
        certificate = Calibration(
            rig=rig, rate_hz=RATE_HZ, made=datetime.now(UTC), folder=Path(folder)
        ).run()
        for name, coil in certificate.coils.items():
            print(
                f"{name}: +-{coil.largest_db:.2f} dB, coherence {coil.least_coherence:.3f} or more"
            )
        for one in (None, certificate):
            choices = {"full_scale_m_s2": FULL_SCALE, "certificate": one}
            check = DeliveryCheck(stimuli, rig, reduced=reduced, **choices)
            sounds = {
                one.stimulus_id: render_stimulus(one, stimuli.folder, rig, **choices)
                for one in stimuli
            }
            print("calibrated" if one else "uncalibrated")
            own = one.apply(rig) if one else rig
            worst = report(
                stimuli, play_all(stimuli, own, sounds, check=check, folder=Path(folder))
            )
        for name, limit in (*((match, 0.02) for match in MATCHES), ("level_error_db", 0.1)):
            what = f"{name} delivered, calibrated"
            yield Figure(what, worst[name], "largest error of a stimulus", limit, compared=False)


def play_all(
    stimuli: StimulusSet, rig: Rig, sounds: Sounds, *, check: DeliveryCheck, folder: Path
) -> dict[str, Playback]:
    played, worst_s = {}, 0.0
    how = {"rate_hz": RATE_HZ, "folder": folder / "delivered", "clock": perf_counter}
    with open_output(rig, sounds, check=check, **how) as output:
        for stimulus in stimuli:
            output.start(stimulus, gap_s=0.01)
            while output.is_playing:
                sleep(0.001)
            begin_s = perf_counter()
            played[stimulus.stimulus_id] = output.collect()
            worst_s = max(worst_s, perf_counter() - begin_s)
    print(f"  slowest collect {worst_s * 1e3:.0f} ms, the device running {SPEED} times as fast")
    return played


def report(stimuli: StimulusSet, played: dict[str, Playback]) -> dict[str, float]:
    """Print errors by role; the largest of the test stimuli."""
    worst = {}
    for role in ("test", "reference"):
        errors = {name: [] for name in (*MATCHES, "level_error_db")}
        own = [one for one in stimuli if one.role == role]
        for one in own:
            found = played[one.stimulus_id].delivered
            for name, values in errors.items():
                values.append(found[name] - getattr(one, name, 0.0))
            if loss := find_loss(found, Flow()):
                print(f"  {one.stimulus_id}: {loss}")
        for name, values in errors.items():
            worst.setdefault(name, float(np.abs(values).max()))
            print(
                f"  {role:10}{name:24}mean {np.mean(values):+.4f}, largest {np.abs(values).max():.4f}"
            )
        least = min(played[one.stimulus_id].delivered["coherence"] for one in own)
        print(f"  {role:10}least coherence {least:.3f}")
    return worst
