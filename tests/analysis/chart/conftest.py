"""One small chart, measured once, and recordings to measure."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import pytest

from feel321.analysis.tradeoff.chart import cost
from feel321.analysis.tradeoff.chart.compute import Effort, compute_chart
from feel321.analysis.tradeoff.chart.points import TABLES, make_table
from feel321.stimuli.condition import Conditioning, condition
from feel321.stimuli.synthesis import make_scene

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from feel321.analysis.tradeoff.chart.compute import Chart
    from feel321.stimuli.recording import Recording

TINY = Effort("tiny", longest_s=0.3, rotations=4, sweep_rotations=2, largest_n=10_000, rounds=3)


@pytest.fixture(scope="session")
def make_recording() -> Callable[[str], Recording]:
    return lambda name: condition(make_scene(name, duration_s=0.4), Conditioning())


@pytest.fixture(scope="session")
def tiny(make_recording: Callable[[str], Recording]) -> Chart:
    """Two scenes at the least effort, timed on short signals."""
    with pytest.MonkeyPatch.context() as patch:
        for name, short in (
            ("REFERENCE_N", 5000),
            ("RATE_DURATION_S", 0.1),
            ("CALLS", 20),
            ("FRAMES", 1),
        ):
            patch.setattr(cost, name, short)
        scenes = [make_recording("bumps"), make_recording("circular_motion")]
        return compute_chart(scenes, effort=TINY, seed=3)


@pytest.fixture(scope="session")
def rated(tiny: Chart) -> Chart:
    """The same with ratings of two reducers, one of them by one participant only."""
    rows = [
        ("soc321", "realism", "as_is", 62.5, 55.0, 70.0, 50.0, 75.0, 12, 2),
        ("dft321", "realism", "as_is", 71.0, None, None, 60.0, 80.0, 1, 2),
    ]
    table = make_table("rated", (dict(zip(TABLES["rated"], row, strict=True)) for row in rows))
    return replace(tiny, rated=table, simulated=True)


@pytest.fixture(scope="session")
def written(rated: Chart, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of the rated chart; to be read only."""
    return rated.write(tmp_path_factory.mktemp("chart") / "chart").parent
