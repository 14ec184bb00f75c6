from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from feel321.analysis.table.reading import Further
from feel321.stimuli.condition import Conditioning, condition
from feel321.stimuli.rotation import rotation_statistics
from feel321.stimuli.sets.manifest import read_stimuli
from feel321.stimuli.sets.recipe import Recipe
from feel321.stimuli.synthesis import make_scene
from feel321.study import analyze as metrics
from feel321.study.analyze import compute_rotations, measure_declared, measure_rotations
from feel321.study.check import build_study, check_study
from feel321.study.folder import StudyFolder
from feel321.study.settings.read import read_settings
from feel321.types import MATCHES

REDUCERS = ("saz321", "pca321", "dft321_windowed")
STUDY = f"""
[study]
seed = 6
[[recordings]]
scene = "bumps"
duration_s = 0.3
[[recordings]]
scene = "hard_taps"
duration_s = 0.3
rotation = 2
[stimuli]
reducers = {list(REDUCERS)}
levels = ["as_is", "equal_intensity"]
[stimuli.conditioning]
high_pass_hz = 30
"""


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> StudyFolder:
    """Build stimuli of two short recordings."""
    folder: Path = tmp_path_factory.mktemp("lab")
    (folder / "study.toml").write_text(STUDY, encoding="utf-8")
    study = StudyFolder(folder)
    build_study(study)
    return study


def measure(study: StudyFolder) -> Further:
    return measure_rotations(study, read_settings(study.settings), read_stimuli(study.stimuli))


def test_every_test_stimulus_has_the_statistics_of_its_recording_and_reducer(
    lab: StudyFolder, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(metrics, "MOST", 200)
    found = measure(lab).metrics
    tests = [stimulus for stimulus in read_stimuli(lab.stimuli).stimuli if stimulus.role == "test"]
    assert list(found.index) == [stimulus.stimulus_id for stimulus in tests]
    steps = Conditioning(high_pass_hz=30)
    bumps = condition(make_scene("bumps", duration_s=0.3), steps)
    for reducer in REDUCERS:
        one = rotation_statistics(bumps, [reducer], rng=np.random.default_rng(6)).loc[reducer]
        expected = (one.spectral_mean, one.spectral_sd, one.temporal_mean, one.temporal_sd)
        expected += (one.bounded_mean, one.bounded_sd)
        for level in ("as_is", "equal_intensity"):
            np.testing.assert_allclose(found.loc[f"bumps__{reducer}__{level}"], expected, atol=1e-9)
    kinds = ("mean", "sd")
    assert list(found) == [f"{name}_rotation_{kind}" for name in MATCHES for kind in kinds]


def test_turned_copies_share_what_belongs_to_their_recording(tmp_path: Path) -> None:
    entry = '[[recordings]]\nscene = "bumps"\nduration_s = 0.3\n'
    text = f'{entry}{entry}rotation = 2\n{entry}rotation = 3\nseed = 1\n[stimuli]\nreducers = ["saz321"]\n'
    (tmp_path / "study.toml").write_text(text, encoding="utf-8")
    study = StudyFolder(tmp_path)
    build_study(study)
    stimuli, found = read_stimuli(study.stimuli), measure(study)
    own = {
        one.recording: found.metrics.loc[one.stimulus_id]
        for one in stimuli.stimuli
        if one.role == "test"
    }
    assert own["bumps"].equals(own["bumps-r2"])
    assert not own["bumps"].equals(own["bumps-r3"])
    assert found.notes[0].endswith("Turned copies of a recording share theirs.")
    turned, still = (
        next(one for one in stimuli.stimuli if one.recording == name and one.role == "test")
        for name in ("bumps-r2", "bumps")
    )
    assert turned.temporal_match != still.temporal_match


def test_declared_statistics_get_more_orientations_and_pass_the_check(
    lab: StudyFolder, tmp_path: Path
) -> None:
    name = "temporal_match_rotation_sd"
    (tmp_path / "stimuli").symlink_to(lab.stimuli)
    study = StudyFolder(tmp_path)
    declare = '[analysis]\nmetrics = ["{}", "temporal_match"]\n'
    study.settings.write_text(STUDY + declare.format(name), encoding="utf-8")
    assert check_study(study).problems == ()
    found = measure(study)
    assert "into 256 random orientations" in found.notes[0]
    assert measure_declared(study, read_settings(study.settings)).metrics.equals(found.metrics)
    assert measure_declared(lab, read_settings(lab.settings)) is None
    study.settings.write_text(STUDY + declare.format("temporal_match_rotated"), encoding="utf-8")
    (line,) = check_study(study).problems
    assert "or rotation statistics, got 'temporal_match_rotated'; there are: " in line
    assert name in line


def test_long_recordings_get_fewer_orientations(
    lab: StudyFolder, monkeypatch: pytest.MonkeyPatch
) -> None:
    size = 3 * 3000 * len(REDUCERS)
    recordings = [
        replace(make_scene("bumps", duration_s=0.3), name=name)
        for name in ("bumps", "hard_taps-r2")
    ]
    for affordable, count in ((10**9, 64), (2 * size * 20 + 5, 20), (size, 16)):
        monkeypatch.setattr(metrics, "AFFORDABLE", affordable)
        found = compute_rotations(recordings, read_stimuli(lab.stimuli), recipe=Recipe(), seed=1)
        assert f"into {count} random orientations" in found.notes[0]


@pytest.mark.parametrize(
    ("old", "new", "reason"),
    [
        ("high_pass_hz = 30", "high_pass_hz = 40", "high_pass_hz"),
        ('scene = "bumps"\nduration_s = 0.3', 'file = "gone.csv"', "recording 'gone'"),
        ("rotation = 2", "rotation = 2\nseed = 8", "is not the one that the set was built from"),
    ],
)
def test_other_recordings_or_settings_leave_them_out(
    lab: StudyFolder, tmp_path: Path, old: str, new: str, reason: str
) -> None:
    (tmp_path / "study.toml").write_text(STUDY.replace(old, new), encoding="utf-8")
    (tmp_path / "stimuli").symlink_to(lab.stimuli)
    with pytest.warns(UserWarning, match="Rotation statistics") as told:
        found = measure(StudyFolder(tmp_path))
    assert found.metrics.equals(pd.DataFrame())
    (note,) = found.notes
    assert str(told[0].message) == note
    assert ("settings differ from those of the built set" in note) == ("gone" not in new)
    assert note.endswith("Rotation statistics of the metrics are left out.")
    assert reason in note
    assert "\n" not in note
