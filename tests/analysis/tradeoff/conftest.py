"""A few recordings of different physics, measured once with all reducers."""

import numpy as np
import pandas as pd
import pytest

from feel321.analysis.tradeoff.measure import measure_tradeoff
from feel321.analysis.tradeoff.page import Tradeoff, advise_tradeoff
from feel321.stimuli.recording import Recording
from feel321.stimuli.synthesis import make_scene

SCENES = ("bumps", "constrained_drag", "circular_motion")


@pytest.fixture(scope="session")
def recordings() -> list[Recording]:
    made = [make_scene(name, rate_hz=4000, duration_s=0.5) for name in SCENES]
    return [*made, Recording(np.zeros((3, 800)), 4000.0, "calm")]


@pytest.fixture(scope="session")
def frame(recordings: list[Recording]) -> pd.DataFrame:
    return measure_tradeoff(recordings, rng=3)


@pytest.fixture(scope="session")
def result(frame: pd.DataFrame) -> Tradeoff:
    return advise_tradeoff(frame)
