"""The matches of the bundled scenes in docs/metrics.md and docs/rivals.md are what the code computes."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from feel321.names import METRIC_INFO
from feel321.stimuli.condition import Conditioning, condition
from feel321.stimuli.match import spectral_match, spectral_match_bounded, temporal_match
from feel321.stimuli.metrics import match
from feel321.stimuli.reducers.registry import REDUCERS
from feel321.stimuli.rivals.catalog import RIVALS
from feel321.stimuli.rotation import INVARIANTS
from feel321.stimuli.synthesis import SCENES, make_scene

COLUMNS = ["sax321", "say321", "saz321", "soc321", "mag321", "pca321", "dft321", "dft321_windowed"]
HALF_A_DIGIT = 0.005 + 1e-6
PAGE = Path(__file__).resolve().parents[2] / "docs" / "metrics.md"


def matches(name: str) -> list[list[float]]:
    """Spectral, temporal and bounded spectral match of every column's reducer."""
    scene = condition(make_scene(name), Conditioning())
    acceleration, rate = scene.acceleration, scene.rate_hz
    reductions = (REDUCERS[reducer](acceleration, rate) for reducer in COLUMNS)
    return [
        [
            spectral_match(acceleration, reduced, rate),
            temporal_match(acceleration, reduced),
            spectral_match_bounded(acceleration, reduced, rate),
        ]
        for reduced in reductions
    ]


@pytest.mark.parametrize("name", SCENES)
def test_the_rows_of_a_scene_are_computed(name: str) -> None:
    paper, bounded = re.findall(
        rf"^\| `{name}` \|(.*)\|$", PAGE.read_text(encoding="utf-8"), re.MULTILINE
    )
    cells = zip(paper.split("|"), bounded.split("|"), strict=True)
    numbers = [[float(match) for match in [*pair.split("/"), one]] for pair, one in cells]
    assert np.array(numbers) == pytest.approx(np.array(matches(name)), abs=HALF_A_DIGIT)


def test_the_page_of_rivals_names_each_and_its_numbers_are_computed() -> None:
    text = PAGE.with_name("rivals.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| `(\w+)` \|(.*)\|$", text, re.MULTILINE)
    rows = [row for row in rows if row[0] in RIVALS]
    described, numbers = rows[: len(RIVALS)], rows[len(RIVALS) :]
    assert [name for name, _ in described] == [name for name, _ in numbers] == list(RIVALS)
    for name, row in described:
        assert ("**" in row) == (METRIC_INFO[name].higher == "better")
    reducers = ["saz321", "mag321", "dft321", "dft321_windowed"]
    found = match(make_scene("bumps", duration_s=1), reducers=reducers, metrics=list(RIVALS))
    shown = [[float(cell) for cell in row.split("|")] for _, row in numbers]
    assert pytest.approx(found.to_numpy(), abs=HALF_A_DIGIT) == np.array(shown).T


@pytest.mark.parametrize("name", SCENES)
def test_the_scores_of_rival_reducers_are_computed(name: str) -> None:
    text = PAGE.with_name("rivals.md").read_text(encoding="utf-8")
    (row,) = re.findall(rf"^\| `{name}` \|(.*)\|$", text, re.MULTILINE)
    (head,) = re.findall(r"^\| \| (`dft321` .*) \|$", text, re.MULTILINE)
    scene = condition(make_scene(name), Conditioning())
    found = []
    for reducer in re.findall(r"`(\w+)`", head):
        reduced = REDUCERS[reducer](scene.acceleration, scene.rate_hz)
        found.append([
            spectral_match_bounded(scene.acceleration, reduced, scene.rate_hz),
            INVARIANTS["temporal_match"](scene.acceleration, reduced, scene.rate_hz),
        ])
    shown = [[float(value) for value in cell.split("/")] for cell in row.split("|")]
    assert np.array(shown) == pytest.approx(np.array(found), abs=HALF_A_DIGIT)
