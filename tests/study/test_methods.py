from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from feel321.stimuli.condition import Conditioning, condition
from feel321.stimuli.synthesis import make_scene
from feel321.study.analyze import gather_recordings

STUDY = """
[[recordings]]
scene = "bumps"
duration_s = 1.0
[[recordings]]
file = "own.npz"
name = "own"
[stimuli.conditioning]
high_pass_hz = 40.0
crop_s = [0.1, 0.6]
"""


@pytest.fixture
def study(tmp_path: Path) -> Path:
    folder = tmp_path / "study"
    folder.mkdir()
    (folder / "study.toml").write_text(STUDY)
    save(folder / "own.npz", seed=1)
    return folder


def save(path: Path, *, seed: int, rate_hz: float = 1000.0) -> Path:
    samples = np.random.default_rng(seed).standard_normal((3, 800))
    np.savez(path, acceleration=samples, rate_hz=rate_hz, unit="m/s^2")
    return path


def test_recordings_of_a_study_are_conditioned_as_the_study_says(study: Path) -> None:
    bumps, own = gather_recordings(study)
    expected = condition(
        make_scene("bumps", duration_s=1.0), Conditioning(high_pass_hz=40.0, crop_s=(0.1, 0.6))
    )
    assert (bumps.name, own.name) == ("bumps", "own")
    assert np.array_equal(bumps.acceleration, expected.acceleration)


def test_others_are_conditioned_alike_but_not_cropped(study: Path, tmp_path: Path) -> None:
    other = gather_recordings(study, extra=[save(tmp_path / "other.npz", seed=2)])[-1]
    raw = np.random.default_rng(2).standard_normal((3, 800))
    plain = replace(make_scene("bumps"), acceleration=raw, rate_hz=1000.0, sha256="")
    assert other.n_samples == 800
    assert np.allclose(
        other.acceleration, condition(plain, Conditioning(high_pass_hz=40.0)).acceleration
    )


def test_what_is_there_twice_is_taken_once_and_other_namesakes_are_numbered(
    study: Path, tmp_path: Path
) -> None:
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    other = save(elsewhere / "own.npz", seed=3)
    found = gather_recordings(study, extra=[study / "own.npz", other, other])
    assert [recording.name for recording in found] == ["bumps", "own", "own (2)"]


def test_what_cannot_be_read_or_conditioned_is_named(study: Path, tmp_path: Path) -> None:
    slow = [
        save(tmp_path / f"{name}.npz", seed=4 + len(name), rate_hz=60.0) for name in ("a", "bb")
    ]
    with pytest.raises(ValueError, match=r"recording 'a': .*\nrecording 'bb': "):
        gather_recordings(study, extra=slow)
    (study / "own.npz").unlink()
    with pytest.raises(ValueError, match="recording 'own': "):
        gather_recordings(study)
