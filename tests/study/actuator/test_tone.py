"""Tones of the threshold block as the actuators play them."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime
from typing import TYPE_CHECKING

import numpy as np
import pytest

from feel321.protocols.threshold import USUAL, ThresholdBlock
from feel321.stimuli.wav import read_wav
from feel321.study.actuator.certificate import Certificate, make_manual
from feel321.study.actuator.output import Output
from feel321.study.actuator.render import find_tone_problems, make_tone, render_tones
from feel321.study.actuator.rig import ActuatorTable, LimitsTable, Rig, SyncTable
from feel321.study.session.ports import Tone

if TYPE_CHECKING:
    from pathlib import Path

RATE = 8000
BLOCK = ThresholdBlock("bayesian", (40.0, 250.0), USUAL, duration_s=0.5)
COILS = (
    ActuatorTable(name="left", channel=1, direction=(1, 0, 0), full_scale_m_s2=20.0),
    ActuatorTable(name="right", channel=2, direction=(0.6, 0.8, 0), full_scale_m_s2=50.0),
    ActuatorTable(name="axis", channel=4, direction=(0, 0, 1), plays=("z",)),
)
SYNC = SyncTable(channel=3)
RIG = Rig(
    actuators=COILS, limits=LimitsTable(peak_m_s2=10.0, rms_m_s2=5.0, duration_s=2.0), sync=SYNC
)


def open_file(folder: Path) -> Output:
    """Open an output to files whose clock goes on by itself."""
    ticks = iter(np.arange(0, 10, 0.05))
    sounds = render_tones(BLOCK, RIG, rate_hz=RATE)
    output = Output(RIG, sounds, rate_hz=RATE, folder=folder, clock=lambda: float(next(ticks)))
    output.open()
    return output


@pytest.mark.parametrize("level_db", [-40.0, 6.0])
@pytest.mark.parametrize("frequency_hz", BLOCK.frequencies_hz)
def test_a_tone_reaches_the_hand_at_its_level(
    tmp_path: Path, frequency_hz: float, level_db: float
) -> None:
    """Against the vector sum of the coils' motions, from the file that was played."""
    output = open_file(tmp_path)
    output.start(Tone(frequency_hz, 0.5, level_db), gap_s=0.0)
    while output.is_playing:
        pass
    playback = output.collect()
    assert (playback.completed, playback.clipped) == (True, 0)
    samples, _ = read_wav(tmp_path / "0001.wav")
    motion = sum(
        np.outer(coil.direction, coil.full_scale_m_s2 * samples[coil.channel - 1]) for coil in COILS
    )
    plateau = motion[:, round(0.1 * RATE) : round(0.4 * RATE)]  # whole periods
    rms = np.sqrt(np.mean((plateau**2).sum(axis=0)))
    assert 20 * np.log10(rms) == pytest.approx(level_db, abs=0.01)
    assert not samples[3].any()
    assert abs(motion[:, 0]).max() == 0


def test_a_silent_interval_is_one_that_vibrates_times_zero_with_the_same_sync_pulse(
    tmp_path: Path,
) -> None:
    output = open_file(tmp_path)
    for level_db in (None, -10.0):
        output.start(Tone(40.0, 0.5, level_db), gap_s=0.1)
        while output.is_playing:
            pass
        assert output.collect().measured["n_samples"] == 4000
    silent, loud = (read_wav(tmp_path / f"000{n}.wav")[0] for n in (1, 2))
    assert silent.shape == loud.shape
    assert not silent[[0, 1, 3]].any()
    assert np.array_equal(silent[2], loud[2])
    pulse = np.flatnonzero(loud[2])
    assert SYNC.duration_s * RATE == len(pulse) == pulse[-1] - pulse[0] + 1
    assert pulse[0] == round(0.1 * RATE)  # with the first sample of the interval
    assert np.unique(loud[2][pulse]) == pytest.approx(SYNC.level)


def test_a_rig_that_cannot_play_the_strongest_tone_is_refused() -> None:
    def find(highest_db: float, **limits: float) -> list[str]:
        block = replace(BLOCK, plan=replace(USUAL, highest_db=highest_db))
        own = RIG.limits.model_copy(update=limits)
        rig = RIG.model_copy(update={"limits": own})
        return list(find_tone_problems(block, rig, rate_hz=RATE))

    weight = 1 / np.linalg.norm([1.6, 0.8])
    # Of any second half is silent, but for the ramps: RMS times the root of 0.485 on the plateau's scale.
    energy = np.mean(make_tone(250.0, duration_s=0.5, rate_hz=RATE) ** 2) / 2
    most_db = 20 * np.log10(5.0 / weight / np.sqrt(energy))
    assert find(most_db - 0.1, peak_m_s2=50.0) == []
    left, right = find(most_db + 0.1, peak_m_s2=50.0)
    assert "'left'" in left
    assert "limits.rms_m_s2 of 5" in right
    assert "limits.peak_m_s2" in find(0.0, peak_m_s2=0.1)[0]
    assert "session.threshold.duration_s" in find(0.0, duration_s=0.4)[0]


def test_the_motion_at_a_resonance_counts_against_the_limits() -> None:
    """A coil that moves five times as much as it is driven at passes its full scale, but not the rig's limits."""
    made = datetime(2026, 3, 1, tzinfo=UTC)
    directions = {coil.name: np.eye(3)[k] for k, coil in enumerate(COILS)}
    flat = make_manual(
        RIG, {coil.name: 50.0 for coil in COILS}, made=made, rate_hz=RATE, directions=directions
    )
    coils = {name: replace(coil, response=5 * coil.response) for name, coil in flat.coils.items()}
    resonant = replace(flat, coils=coils)
    block = replace(BLOCK, plan=replace(USUAL, highest_db=12.0))

    def find(certificate: Certificate) -> list[str]:
        return list(find_tone_problems(block, RIG, rate_hz=RATE, certificate=certificate))

    assert find(flat) == []
    assert "limits.peak_m_s2 of 10" in find(resonant)[0]
    assert not any("full_scale" in line for line in find(resonant))
