"""How strongly coils bring stimuli to the hand, against brute force: the hand's acceleration, sample by sample."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from feel321.stimuli.sets.manifest import Stimulus
from feel321.stimuli.wav import write_wav
from feel321.study.actuator.render import (
    find_directions,
    find_mix,
    original_energy,
    reduced_energy,
    render_stimulus,
)
from feel321.study.actuator.rig import AXES, ActuatorTable, LimitsTable, Rig

RATE = 2000
LIMITS = LimitsTable(peak_m_s2=100.0, rms_m_s2=100.0, duration_s=60.0)


def coil(name: str, channel: int, *plays: str, **more: Any) -> ActuatorTable:
    return ActuatorTable(name=name, channel=channel, plays=plays or ("reduced",), **more)


def draw_rig(rng: np.random.Generator, *, right_angles: bool) -> Rig:
    """Draw coils in random directions: some for reduced stimuli, one or two per axis."""
    frame = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    coils = [
        coil(
            f"axis {axis} {copy}",
            3 * copy + place + 1,
            axis,
            *(["reduced"] if rng.random() < 0.5 else []),
            direction=tuple(
                (frame[place] if right_angles else rng.standard_normal(3)) * rng.uniform(0.5, 2)
            ),
            full_scale_m_s2=rng.uniform(20, 200),
        )
        for place, axis in enumerate(AXES)
        for copy in range(rng.integers(1, 3) if right_angles else 1)
    ]
    extra = [
        coil(f"r{i}", 10 + i, direction=tuple(rng.standard_normal(3)))
        for i in range(rng.integers(1, 4))
    ]
    return Rig(actuators=(*coils, *extra), limits=LIMITS)


def reach_hand(rig: Rig, samples: np.ndarray, folder: Path) -> float:
    """Play a file, and give the mean square of the hand's acceleration relative to that of the file."""
    write_wav(folder / "s.wav", samples, RATE)
    n = samples.shape[-1]
    ones = [1.0] * 5
    row = Stimulus("s", "r", "x", "as_is", "test", "s.wav", RATE, n, n / RATE, *ones, 0, "", "")
    rendered = render_stimulus(row, folder, rig, full_scale_m_s2=100.0).astype(float)
    hand = np.zeros((3, n))
    for actuator in rig.actuators:
        direction = np.array(actuator.direction) / np.linalg.norm(actuator.direction)
        hand += np.outer(direction, rendered[:, actuator.channel - 1] * actuator.full_scale_m_s2)
    return float((hand**2).sum() / (samples**2).sum() / 100.0**2)


@pytest.mark.parametrize("seed", range(5))
def test_reduced_and_original_reach_the_hand_alike_whatever_the_directions(
    seed: int, tmp_path: Path
) -> None:
    rng = np.random.default_rng(seed)
    rig = draw_rig(rng, right_angles=True)
    axes = rng.standard_normal((3, 3)) @ rng.standard_normal((3, 400)) / 30  # correlated
    assert reach_hand(rig, axes, tmp_path) == pytest.approx(1.0, rel=1e-5)
    assert reach_hand(rig, axes[1], tmp_path) == pytest.approx(1.0, rel=1e-5)


@pytest.mark.parametrize("seed", range(5))
def test_energies_are_those_at_the_hand(seed: int, tmp_path: Path) -> None:
    rng = np.random.default_rng(100 + seed)
    drawn = draw_rig(rng, right_angles=False)
    weighted = [a.model_copy(update={"weight": rng.uniform(0.1, 3)}) for a in drawn.actuators]
    rig = drawn.model_copy(update={"actuators": tuple(weighted)})
    mix, (directions, unknown) = find_mix(rig), find_directions(rig)
    axes = rng.standard_normal((3, 3)) @ rng.standard_normal((3, 400)) / 30
    covariance = axes @ axes.T
    assert unknown == []
    assert reach_hand(rig, axes[0], tmp_path) == pytest.approx(
        reduced_energy(mix, directions), rel=1e-5
    )
    assert reach_hand(rig, axes, tmp_path) == pytest.approx(
        original_energy(mix, directions, covariance), rel=1e-5
    )
    # Default weights: one for reduced stimuli always, one on average over directions for those with three axes.
    default = find_mix(drawn)
    assert reduced_energy(default, directions) == pytest.approx(1.0)
    assert original_energy(default, directions, np.eye(3)) == pytest.approx(1.0)


def test_coils_that_cancel_each_other_are_refused() -> None:
    rig = Rig(
        actuators=(coil("a", 1, direction=(1, 0, 0)), coil("b", 2, direction=(-2, 0, 0))),
        limits=LIMITS,
    )
    with pytest.raises(
        ValueError, match=r"\A'a' and 'b' play 'reduced' in opposite directions and cancel"
    ):
        find_mix(rig)
