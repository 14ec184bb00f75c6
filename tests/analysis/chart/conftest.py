"""One small chart, measured once, and recordings to measure."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import pytest

from feel321.analysis.tradeoff.chart.compute import Effort, compute_chart
from feel321.analysis.tradeoff.chart.records import Rated
from feel321.stimuli.condition import Conditioning, condition
from feel321.stimuli.synthesis import make_scene

if TYPE_CHECKING:
    from collections.abc import Callable

    from feel321.analysis.tradeoff.chart.records import Chart
    from feel321.stimuli.recording import Recording

TINY = Effort("tiny", longest_s=0.3, rotations=4, sweep_rotations=2, largest_n=10_000, rounds=3)


@pytest.fixture(scope="session")
def make_recording() -> Callable[[str], Recording]:
    return lambda name: condition(make_scene(name, duration_s=0.4), Conditioning())


@pytest.fixture(scope="session")
def tiny(make_recording: Callable[[str], Recording]) -> Chart:
    """Two scenes at the least effort."""
    return compute_chart(
        [make_recording("bumps"), make_recording("circular_motion")], effort=TINY, seed=3
    )


@pytest.fixture(scope="session")
def rated(tiny: Chart) -> Chart:
    """The same with ratings of two reducers, one of them by one participant only."""
    rows = (
        Rated("soc321", "realism", "as_is", 62.5, 55.0, 70.0, 50.0, 75.0, 12, 2),
        Rated("dft321", "realism", "as_is", 71.0, None, None, 60.0, 80.0, 1, 2),
    )
    return replace(tiny, rated=rows, simulated=True)
