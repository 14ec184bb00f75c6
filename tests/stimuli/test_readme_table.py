"""The README's own rows of the paper's table are what the code computes."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from stimuli.condition import Conditioning, condition
from stimuli.match import spectral_match, temporal_match
from stimuli.reduce import REDUCERS
from stimuli.synthesis import SCENES, make_scene

COLUMNS = ["sax321", "say321", "saz321", "soc321", "mag321", "pca321", "dft321", "dft321_windowed"]
README = Path(__file__).resolve().parents[2] / "README.md"


def table_row(name: str) -> str:
    scene = condition(make_scene(name), Conditioning())
    acceleration, rate = scene.acceleration, scene.rate_hz
    cells = []
    for reducer in COLUMNS:
        reduced = REDUCERS[reducer](acceleration, rate)
        matches = spectral_match(acceleration, reduced, rate), temporal_match(acceleration, reduced)
        cells.append(" / ".join(f"{match:.2f}" for match in matches))
    return f"| `{name}` | {' | '.join(cells)} |"


@pytest.mark.parametrize("name", SCENES)
def test_the_row_of_a_scene_is_computed(name: str) -> None:
    rows = re.findall(rf"^\| `{name}` \|.*$", README.read_text(encoding="utf-8"), re.MULTILINE)
    assert rows == [table_row(name)]
