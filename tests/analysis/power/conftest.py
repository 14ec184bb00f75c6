"""Stimulus sets with two metrics, and studies drawn from them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
import pytest

from feel321.analysis.power.simulate import Scenario
from feel321.analysis.power.truth import PowerDesign, Truth

if TYPE_CHECKING:
    from collections.abc import Callable

METRICS = ("spectral", "temporal")


def make_items(recordings: int, reducers: int, *, seed: int = 1) -> pd.DataFrame:
    """Metrics that differ between reducers and, by more, between stimuli."""
    rng = np.random.default_rng(seed)
    scene, kind = (axis.ravel() for axis in np.indices((recordings, reducers)))
    values = 0.5 + rng.normal(0, 0.15, (2, len(scene))) + rng.normal(0, 0.1, (2, reducers))[:, kind]
    return pd.DataFrame({
        "recording": [f"scene{number}" for number in scene],
        "reducer": [f"way{number}" for number in kind],
        **dict(zip(METRICS, values, strict=True)),
    })


def make(own: tuple[int, int] = (6, 6), **changes: object) -> Scenario:
    """Make a scenario of own recordings x reducers; changes go to the truth or to the design."""
    truth = {name: changes.pop(name) for name in list(changes) if name in Truth.__slots__}
    sizes = {"participants": 10, **changes}
    design = PowerDesign(make_items(*own), METRICS, **sizes)
    return Scenario(design, Truth(**{"slopes": {"spectral": 25.0}, **truth}))


@pytest.fixture(scope="session")
def make_scenario() -> Callable[..., Scenario]:
    """Make scenarios."""
    return make
