"""The matches of the bundled scenes stay what they were: `scores.csv`, to two decimals."""

import csv
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from feel321.stimuli.condition import Conditioning, condition
from feel321.stimuli.metrics import METRICS
from feel321.stimuli.recording import Recording
from feel321.stimuli.reducers.registry import REDUCERS
from feel321.stimuli.rotation import INVARIANTS
from feel321.stimuli.synthesis import SCENES, make_scene
from feel321.types import METRIC_INFO

HALF_A_DIGIT = 0.005 + 1e-6
RAW = "bumps of 1 s as made"

with Path(__file__).with_name("scores.csv").open(encoding="utf-8", newline="") as file:
    ROWS = list(csv.DictReader(file))


def make(name: str) -> Recording:
    if name == RAW:
        return make_scene("bumps", duration_s=1)
    return condition(make_scene(name), Conditioning())


def find_metric(name: str) -> Callable[..., float]:
    word, _, rest = name.partition(" ")
    return INVARIANTS[rest] if word == "invariant" else METRICS[name]


@pytest.mark.parametrize("name", [*SCENES, RAW])
def test_the_scores_of_a_scene_stay(name: str) -> None:
    scene = make(name)
    samples, rate = scene.acceleration, scene.rate_hz
    rows = [row for row in ROWS if row["scene"] == name]
    reduced = {each: REDUCERS[each](samples, rate) for each in {row["reducer"] for row in rows}}
    found = [find_metric(row["metric"])(samples, reduced[row["reducer"]], rate) for row in rows]
    wanted = [float(row["value"]) for row in rows]
    assert np.array(found) == pytest.approx(np.array(wanted), abs=HALF_A_DIGIT)


def test_every_metric_and_the_paper_s_reducers_have_scores() -> None:
    assert {row["metric"] for row in ROWS} > set(METRIC_INFO) - {"temporal_match_windowed"}
    assert len({row["reducer"] for row in ROWS}) >= 10
