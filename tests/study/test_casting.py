"""What simulated participants plant: the slopes of the metric that the study declares, after the slider's ends."""

import math
from dataclasses import replace
from pathlib import Path

import pytest

from feel321.stimuli.sets.manifest import StimulusSet
from feel321.study.settings.read import read_settings
from feel321.study.settings.schema import Settings
from feel321.study.simulate import regress_planted

STUDY = """
[[recordings]]
scene = "bumps"
"""
EXACT = "[observer]\nbias_sd = 0.0\ngain_sd = 0.0\nnoise_sd = 0.0\n"


def read(folder: Path, more: str = "") -> Settings:
    path = folder / "study.toml"
    path.write_text(STUDY + more, encoding="utf-8")
    return read_settings(path)


def bound(stimuli: StimulusSet) -> StimulusSet:
    """Give every stimulus a bounded match of its own."""
    rows = [
        replace(one, spectral_match_bounded=0.2 + 0.6 * math.exp(-one.temporal_match) ** 2)
        for one in stimuli.stimuli
    ]
    return replace(stimuli, stimuli=tuple(rows))


def test_exact_people_plant_the_weights(tmp_path: Path, stimuli: StimulusSet) -> None:
    planted = regress_planted(read(tmp_path, EXACT), bound(stimuli))[0]
    assert planted == pytest.approx({"spectral_match_bounded": 4.5, "temporal_match": 3.5})


def test_the_declared_metric_is_the_one_that_is_felt(tmp_path: Path, stimuli: StimulusSet) -> None:
    declared = '[analysis]\nmetrics = ["spectral_match", "temporal_match"]\n'
    assert list(regress_planted(read(tmp_path, declared), stimuli)[0]) == [
        "spectral_match",
        "temporal_match",
    ]


def test_without_realism_nothing_is_planted(tmp_path: Path, stimuli: StimulusSet) -> None:
    settings = read(tmp_path, '[session]\nprotocols = ["similarity"]\n')
    assert regress_planted(settings, stimuli)[0] == {}
