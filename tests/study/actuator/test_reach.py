"""How strongly coils bring stimuli to the hand, against brute force: the hand's acceleration, sample by sample."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from feel321.stimuli.sets.manifest import Stimulus
from feel321.stimuli.sets.recipe import Recipe
from feel321.stimuli.wav import write_wav
from feel321.study.actuator.render import (
    find_directions,
    find_mix,
    original_energy,
    reduced_energy,
    render_stimulus,
)
from feel321.study.actuator.rig import AXES, ActuatorTable, LimitsTable, Rig, identify, read_rig
from feel321.study.strength import find_reach

if TYPE_CHECKING:
    from feel321.study.findings import Problems

RATE = 2000
LIMITS = LimitsTable(peak_m_s2=100.0, rms_m_s2=100.0, duration_s=60.0)
TEMPLATE = (Path(__file__).parents[1] / "settings" / "all_rig_settings.toml").read_text(
    encoding="utf-8"
)
OLD = "".join(
    line for line in TEMPLATE.splitlines(keepends=True) if not line.startswith("direction")
)


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


def read(tmp_path: Path, text: str) -> Rig:
    (tmp_path / "rig.toml").write_text(text, encoding="utf-8")
    return read_rig(tmp_path / "rig.toml")


def compare(rig: Rig, **changes: Any) -> Problems:
    noise = np.random.default_rng(0).standard_normal((3, 4000))
    return find_reach(rig, {"oak": np.cov(noise)}, Recipe(**changes))


def test_the_template_reaches_the_hand_with_equal_energy(tmp_path: Path) -> None:
    found = compare(read(tmp_path, TEMPLATE))
    assert (found.problems, found.warnings) == ((), ())
    assert list(found.notes) == [
        "one-axis stimuli and the three-axis reference reach the hand with equal energy (difference 0.0 dB)"
    ]
    assert compare(read(tmp_path, TEMPLATE), reference="none").notes == ()


def test_a_rig_without_directions_plays_as_it_is_and_is_warned_of(tmp_path: Path) -> None:
    rig = read(tmp_path, OLD)
    assert find_mix(rig) == {
        "left coil": {"reduced": 1.0, "x": 1.0},
        "right coil": {"reduced": 1.0, "y": 1.0},
        "third coil": {"z": 1.0},
    }
    (warning,) = compare(rig).warnings
    assert warning == (
        "one-axis stimuli reach the hand 3.0 dB stronger than the three-axis reference, so they can be "
        "distinguished by strength; set weight: 'left coil' 0.7071, 'right coil' 0.7071; or add direction = [x, y, z] "
        "to every actuator, then these weights are the default"
    )
    mended = OLD.replace('"x"]', '"x"]\nweight = 0.7071').replace('"y"]', '"y"]\nweight = 0.7071')
    assert compare(read(tmp_path, mended)).warnings == ()
    assert identify(read(tmp_path, mended))["actuators"][0]["weight"] == 0.7071
    assert identify(read(tmp_path, TEMPLATE))["actuators"][0]["direction"] == [1.0, 0.0, 0.0]


def test_two_coils_in_one_direction_add_in_amplitude() -> None:
    along = {"direction": (0.0, 0.0, 2.0)}
    loud = Rig(
        actuators=(coil("a", 1, weight=1.0, **along), coil("b", 2, weight=1.0, **along)),
        limits=LIMITS,
    )
    assert reduced_energy(find_mix(loud), find_directions(loud)[0]) == pytest.approx(4.0)  # 6 dB
    rig = Rig(actuators=(coil("a", 1, **along), coil("b", 2, **along)), limits=LIMITS)
    assert find_mix(rig) == {"a": {"reduced": 0.5}, "b": {"reduced": 0.5}}


def test_a_coil_of_unknown_direction_is_named() -> None:
    axes = [coil(axis, place, axis) for place, axis in enumerate(AXES, start=1)]
    (warning,) = compare(Rig(actuators=(*axes, coil("tip", 4)), limits=LIMITS)).warnings
    assert warning.startswith("actuators 'tip': no direction is known, so it is unknown whether")


def test_coils_for_axes_that_are_not_at_right_angles_are_warned_of_where_it_counts() -> None:
    slanted = [
        coil(axis, place, axis, direction=(1.0, 0.1 * place, 0.0))
        for place, axis in enumerate(AXES, start=1)
    ]
    rig = Rig(actuators=(*slanted, coil("tip", 4, direction=(0.0, 0.0, 1.0))), limits=LIMITS)
    wave = np.random.default_rng(0).standard_normal(4000)
    together = np.cov(np.stack([wave, wave, wave]))
    (warning,) = find_reach(rig, {"together": together}, Recipe()).warnings
    assert "4.7 dB weaker than the three-axis reference" in warning
    assert find_reach(rig, {"silence": np.zeros((3, 3))}, Recipe()).warnings == ()


def test_coils_that_cancel_each_other_are_refused() -> None:
    rig = Rig(
        actuators=(coil("a", 1, direction=(1, 0, 0)), coil("b", 2, direction=(-2, 0, 0))),
        limits=LIMITS,
    )
    with pytest.raises(
        ValueError, match=r"\A'a' and 'b' play 'reduced' in opposite directions and cancel"
    ):
        find_mix(rig)
