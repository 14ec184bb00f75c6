from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from feel321.stimuli.sets.manifest import Stimulus, StimulusSet
from feel321.stimuli.wav import write_wav
from feel321.study.actuator.render import find_rig_problems, render_stimulus
from feel321.study.actuator.rig import ActuatorTable, LimitsTable, MaskingTable, Rig, SyncTable

if TYPE_CHECKING:
    from pathlib import Path

RATE = 1000
LIMITS = LimitsTable(peak_m_s2=100.0, rms_m_s2=100.0, duration_s=60.0)


def coil(name: str, channel: int, *plays: str, full_scale_m_s2: float = 100.0) -> ActuatorTable:
    return ActuatorTable(
        name=name, channel=channel, full_scale_m_s2=full_scale_m_s2, plays=plays or ("reduced",)
    )


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


def problems(
    folder: Path, stimuli: list[Stimulus], rig: Rig, *, full_scale_m_s2: float = 100.0
) -> list[str]:
    return find_rig_problems(
        rig, StimulusSet(folder, tuple(stimuli), ""), rate_hz=RATE, full_scale_m_s2=full_scale_m_s2
    )


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
    problems = find_rig_problems(
        make_rig(), StimulusSet(tmp_path, (stimulus,), ""), rate_hz=RATE, full_scale_m_s2=100.0
    )
    assert len(problems) == 1
    assert "must be finite" in problems[0]
