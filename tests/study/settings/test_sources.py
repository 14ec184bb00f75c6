"""Orientations of the sensor; the other sources are tested with the settings."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
import pytest

from feel321.stimuli.sets.manifest import read_stimuli
from feel321.stimuli.synthesis import make_scene
from feel321.study.settings.read import (
    Surface,
    list_surfaces,
    open_recordings,
    read_settings,
    turn_recording,
)
from feel321.study.workflow import build_study, check_study

if TYPE_CHECKING:
    from feel321.study.folder import StudyFolder

SCENE = '[[recordings]]\nscene = "bumps"\nduration_s = 0.5\n'


def test_turning_keeps_energy_and_angles_and_is_no_mirror() -> None:
    recording = make_scene("bumps", duration_s=0.5)
    turned = turn_recording(recording, 1)
    turn = np.linalg.lstsq(recording.acceleration.T, turned.acceleration.T, rcond=None)[0].T
    np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(turn) == pytest.approx(1.0)
    assert np.abs(turn - np.eye(3)).max() > 0.1
    energy = np.sum(recording.acceleration**2, axis=0)
    np.testing.assert_allclose(np.sum(turned.acceleration**2, axis=0), energy, atol=1e-9)


def test_one_number_is_one_orientation_of_every_recording() -> None:
    turns = []
    for scene, rotation in (("bumps", 4), ("hard_taps", 4), ("bumps", 5)):
        recording = make_scene(scene, duration_s=0.5)
        turned = turn_recording(recording, rotation)
        turns.append(
            np.linalg.lstsq(recording.acceleration.T, turned.acceleration.T, rcond=None)[0]
        )
    np.testing.assert_allclose(turns[0], turns[1], atol=1e-9)
    assert np.abs(turns[0] - turns[2]).max() > 0.1


def test_the_digest_tells_source_and_orientation() -> None:
    bumps, taps = (make_scene(name, duration_s=0.5) for name in ("bumps", "hard_taps"))
    digests = [
        bumps.sha256,
        *(turn_recording(*which).sha256 for which in ((bumps, 0), (bumps, 1), (taps, 1))),
    ]
    assert len(set(digests)) == 4
    assert turn_recording(bumps, 1).sha256 == digests[2]


def test_a_recording_is_named_after_its_orientation_unless_it_has_a_name(
    study: StudyFolder,
) -> None:
    text = f'{SCENE}{SCENE}rotation = 0\n{SCENE}rotation = 1\n{SCENE}rotation = 1\nname = "b"\n'
    study.settings.write_text(text, encoding="utf-8")
    recordings = open_recordings(read_settings(study.settings), study.path)
    assert [recording.name for recording in recordings] == ["bumps", "bumps-r0", "bumps-r1", "b"]
    same = [np.array_equal(a.acceleration, b.acceleration) for a, b in pairwise(recordings)]
    assert same == [False, False, True]


def test_another_orientation_makes_the_set_stale_until_it_is_built_again(
    study: StudyFolder,
) -> None:
    study.settings.write_text(f'{SCENE}name = "b"\nrotation = 1\n', encoding="utf-8")
    _, first = build_study(study)
    assert list(check_study(study).problems) == []
    study.settings.write_text(f'{SCENE}name = "b"\nrotation = 2\n', encoding="utf-8")
    assert list(check_study(study).problems) == [
        f"{study.stimuli}: recording 'b': is not the one that the set was built from; run feel321 build"
    ]
    build_study(study)
    second = read_stimuli(study.stimuli)
    assert second.sha256 != first.sha256
    assert {row.sha256 for row in first.stimuli}.isdisjoint(row.sha256 for row in second.stimuli)


def test_surfaces_are_found_by_the_names_that_trials_know_them_by(study: StudyFolder) -> None:
    text = f'{SCENE}name = "oak"\nsample = "the oak board"\npicture = "pictures/oak.png"\n{SCENE}rotation = 2\n'
    study.settings.write_text(text, encoding="utf-8")
    assert list_surfaces(read_settings(study.settings), study.path) == {
        "oak": Surface("the oak board", study.path / "pictures" / "oak.png"),
        "bumps-r2": Surface(None, None),
    }
