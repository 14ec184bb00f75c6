"""From a stimulus or a tone to the rig's channels: who plays what, how strongly it reaches the hand, and the limits.

How strongly is compared with brute force: the hand's acceleration, sample by sample.
"""

from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from feel321.protocols.threshold import USUAL, ThresholdBlock
from feel321.stimuli.sets.manifest import Stimulus, StimulusSet
from feel321.stimuli.wav import read_wav, write_wav
from feel321.study.actuator.certificate import Certificate, make_manual
from feel321.study.actuator.output import Output
from feel321.study.actuator.render import (
    find_directions,
    find_energy,
    find_mix,
    find_rig_problems,
    find_tone_problems,
    make_tone,
    render_stimulus,
    render_tones,
)
from feel321.study.actuator.rig import (
    AXES,
    ActuatorTable,
    LimitsTable,
    MaskingTable,
    Rig,
    SyncTable,
)
from feel321.study.session.ports import Tone

RATE = 1000
LIMITS = LimitsTable(peak_m_s2=100.0, rms_m_s2=100.0, duration_s=60.0)


def coil(name: str, channel: int, *plays: str, **more: Any) -> ActuatorTable:
    return ActuatorTable(name=name, channel=channel, plays=plays or ("reduced",), **more)


def make_rig(*actuators: ActuatorTable, **tables: Any) -> Rig:
    return Rig(**{
        "actuators": actuators or (coil("one", 1), coil("two", 2)),
        "limits": LIMITS,
        **tables,
    })


def store(folder: Path, samples: np.ndarray, *, name: str = "s", rate: int = RATE) -> Stimulus:
    write_wav(folder / f"{name}.wav", samples, rate)
    n = samples.shape[-1]
    file, ones = f"{name}.wav", [1.0] * 5
    return Stimulus(name, "r", "dft321", "as_is", "test", file, rate, n, n / rate, *ones, 0, "", "")


def noise(n: int, *, channels: int = 1, rms: float = 0.2) -> np.ndarray:
    drawn = np.random.default_rng(1).normal(0, rms, (channels, n)).astype(np.float32)
    return np.clip(drawn, -1, 1) if channels > 1 else np.clip(drawn[0], -1, 1)


def test_equal_scales_leave_every_bit(tmp_path: Path) -> None:
    samples = noise(500)
    others = {"masking": MaskingTable(channels=(2,)), "sync": SyncTable(channel=6)}
    rig = make_rig(coil("one", 1), coil("two", 4), **others)
    rendered = render_stimulus(store(tmp_path, samples), tmp_path, rig, full_scale_m_s2=100.0)
    assert rendered.dtype == np.float32
    assert rendered.shape == (500, 6)
    assert_array_equal(rendered[:, [0, 3]], np.stack([samples, samples], axis=1))
    assert not rendered[:, [1, 2, 4, 5]].any()


def test_axes_go_to_those_who_play_them(tmp_path: Path) -> None:
    samples = noise(500, channels=3)
    rig = make_rig(coil("a", 1, "z"), coil("b", 2, "x", "y", "reduced"), coil("c", 3))
    rendered = render_stimulus(store(tmp_path, samples), tmp_path, rig, full_scale_m_s2=100.0)
    summed = (samples[0].astype(float) + samples[1]).astype(np.float32)
    assert_array_equal(rendered, np.stack([samples[2], summed, np.zeros(500)], axis=1))


@pytest.mark.parametrize(
    ("samples", "plays", "message"),
    [
        (
            noise(50, channels=3),
            ("reduced", "x"),
            r"\As: no actuator plays y, z; add it to `plays` in rig.toml, or name",
        ),
        (noise(50), ("x", "y", "z"), r"\As: no actuator plays reduced; add it"),
        (
            noise(50, channels=2),
            ("reduced",),
            r"\As.wav: must have 1 or 3 channels, got 2; build it again",
        ),
    ],
)
def test_what_nobody_plays_is_refused(
    samples: np.ndarray, plays: tuple[str, ...], message: str, tmp_path: Path
) -> None:
    rig = make_rig(coil("a", 1, *plays))
    with pytest.raises(ValueError, match=message):
        render_stimulus(store(tmp_path, samples), tmp_path, rig, full_scale_m_s2=100.0)


def problems(folder: Path, stimuli: list[Stimulus], rig: Rig) -> list[str]:
    played = StimulusSet(folder, tuple(stimuli), "")
    own = SimpleNamespace(rate_hz=RATE, full_scale_m_s2=100.0)
    settings: Any = SimpleNamespace(rig=own, session=SimpleNamespace(threshold=None))
    lines, _ = find_rig_problems(rig, played, settings)
    assert all(line.startswith("rig.toml: ") for line in lines)
    return [line.removeprefix("rig.toml: ") for line in lines]


LOUD = {
    "peak": ({"peak_m_s2": 40.0}, "got 100, above limits.peak_m_s2 of 40;"),
    "rms": ({"rms_m_s2": 15.0}, "got 20, above limits.rms_m_s2 of 15;"),
    "duration": ({"duration_s": 2.0}, "got 3, above limits.duration_s of 2;"),
}


@pytest.mark.parametrize("name", LOUD)
def test_each_limit_gets_a_line_for_all_stimuli(name: str, tmp_path: Path) -> None:
    change, message = LOUD[name]
    samples = np.zeros(3000)
    samples[500:1000] = 0.2 * np.sqrt(2) * np.resize([1, -1], 500)
    samples[700] = 1.0 if name == "peak" else samples[700]
    stimuli = [store(tmp_path, samples), store(tmp_path, samples * 0.99, name="t")]
    rig = make_rig(coil("one", 1), limits=LIMITS.model_copy(update=change))
    (line,) = problems(tmp_path, stimuli, rig)
    assert line.startswith(f"actuator 'one': s and 1 more: {message}")


def test_what_cannot_be_played_gets_one_line_per_kind(tmp_path: Path) -> None:
    stimuli = [store(tmp_path, noise(50, channels=3), name=name) for name in ("s", "t", "u")]
    stimuli += [
        store(tmp_path, noise(50), name="v", rate=2000),
        store(tmp_path, noise(50), name="gone"),
    ]
    (tmp_path / "gone.wav").unlink()
    lines = problems(tmp_path, stimuli, make_rig())
    assert len(lines) == 3
    assert lines[0].startswith("s and 2 more: no actuator plays x, y, z; ")
    assert lines[1] == "v: got a rate of 2000 Hz, the study plays at 1000 Hz; build the set again"
    assert lines[2] == "gone.wav: No such file or directory; build the set again"


@pytest.mark.parametrize("wrong", [np.nan, np.inf, -np.inf])
def test_what_is_no_number_is_refused(tmp_path: Path, wrong: float) -> None:
    stimulus = store(tmp_path, np.full(10, 0.5))
    path = tmp_path / stimulus.file
    content = bytearray(path.read_bytes())
    content[-8:-4] = np.float32(wrong).tobytes()  # write_wav itself would refuse
    path.write_bytes(content)
    with pytest.raises(ValueError, match="must be finite, got 1 values that are not"):
        render_stimulus(stimulus, tmp_path, make_rig(), full_scale_m_s2=100.0)
    (line,) = problems(tmp_path, [stimulus], make_rig())
    assert "must be finite" in line


# How strongly coils bring stimuli to the hand.


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
    row = store(folder, samples)
    rendered = render_stimulus(row, folder, rig, full_scale_m_s2=100.0).astype(float)
    hand = np.zeros((3, row.n_samples))
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
        find_energy(mix, directions), rel=1e-5
    )
    assert reach_hand(rig, axes, tmp_path) == pytest.approx(
        find_energy(mix, directions, covariance), rel=1e-5
    )
    # Default weights: one for reduced stimuli always, one on average over directions for those with three axes.
    default = find_mix(drawn)
    assert find_energy(default, directions) == pytest.approx(1.0)
    assert find_energy(default, directions, np.eye(3)) == pytest.approx(1.0)


def test_coils_that_cancel_each_other_are_refused() -> None:
    rig = Rig(
        actuators=(coil("a", 1, direction=(1, 0, 0)), coil("b", 2, direction=(-2, 0, 0))),
        limits=LIMITS,
    )
    with pytest.raises(
        ValueError,
        match=r"\Arig.toml: 'a' and 'b' play 'reduced' in opposite directions and cancel",
    ):
        find_mix(rig)


# Tones of the threshold block.

TONE_HZ = 8000
BLOCK = ThresholdBlock("bayesian", (40.0, 250.0), USUAL, duration_s=0.5)
TILTED = (
    ActuatorTable(name="left", channel=1, direction=(1, 0, 0), full_scale_m_s2=20.0),
    ActuatorTable(name="right", channel=2, direction=(0.6, 0.8, 0), full_scale_m_s2=50.0),
    ActuatorTable(name="axis", channel=4, direction=(0, 0, 1), plays=("z",)),
)
SYNC = SyncTable(channel=3)
TONES = Rig(
    actuators=TILTED, limits=LimitsTable(peak_m_s2=10.0, rms_m_s2=5.0, duration_s=2.0), sync=SYNC
)


def open_file(folder: Path) -> Output:
    """Open an output to files whose clock goes on by itself."""
    ticks = iter(np.arange(0, 10, 0.05))
    sounds = render_tones(BLOCK, TONES, rate_hz=TONE_HZ)
    output = Output(TONES, sounds, rate_hz=TONE_HZ, folder=folder, clock=lambda: float(next(ticks)))
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
        np.outer(coil.direction, coil.full_scale_m_s2 * samples[coil.channel - 1])
        for coil in TILTED
    )
    plateau = motion[:, round(0.1 * TONE_HZ) : round(0.4 * TONE_HZ)]  # whole periods
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
    assert SYNC.duration_s * TONE_HZ == len(pulse) == pulse[-1] - pulse[0] + 1
    assert pulse[0] == round(0.1 * TONE_HZ)  # with the first sample of the interval
    assert np.unique(loud[2][pulse]) == pytest.approx(SYNC.level)


def test_a_rig_that_cannot_play_the_strongest_tone_is_refused() -> None:
    def find(highest_db: float, **limits: float) -> list[str]:
        block = replace(BLOCK, plan=replace(USUAL, highest_db=highest_db))
        own = TONES.limits.model_copy(update=limits)
        rig = TONES.model_copy(update={"limits": own})
        return list(find_tone_problems(block, rig, rate_hz=TONE_HZ))

    weight = 1 / np.linalg.norm([1.6, 0.8])
    # Of any second half is silent, but for the ramps: RMS times the root of 0.485 on the plateau's scale.
    energy = np.mean(make_tone(250.0, duration_s=0.5, rate_hz=TONE_HZ) ** 2) / 2
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
    directions = {coil.name: np.eye(3)[k] for k, coil in enumerate(TILTED)}
    flat = make_manual(
        TONES,
        {coil.name: 50.0 for coil in TILTED},
        made=made,
        rate_hz=TONE_HZ,
        directions=directions,
    )
    coils = {name: replace(coil, response=5 * coil.response) for name, coil in flat.coils.items()}
    resonant = replace(flat, coils=coils)
    block = replace(BLOCK, plan=replace(USUAL, highest_db=12.0))

    def find(certificate: Certificate) -> list[str]:
        return list(find_tone_problems(block, TONES, rate_hz=TONE_HZ, certificate=certificate))

    assert find(flat) == []
    assert "limits.peak_m_s2 of 10" in find(resonant)[0]
    assert not any("full_scale" in line for line in find(resonant))
