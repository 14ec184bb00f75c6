"""Stimulus sets with two metrics, and studies drawn from them."""

from collections.abc import Callable

import numpy as np
import pandas as pd
import pytest

from feel321.analysis.power.design import PowerDesign, Truth

METRICS = ("spectral", "temporal")


def make_items(recordings: int, reducers: int, *, seed: int = 1) -> pd.DataFrame:
    """Metrics that differ between reducers and, by more, between stimuli."""
    rng = np.random.default_rng(seed)
    scene, kind = (axis.ravel() for axis in np.indices((recordings, reducers)))
    values = 0.5 + rng.normal(0, 0.15, (2, len(scene))) + rng.normal(0, 0.1, (2, reducers))[:, kind]
    return pd.DataFrame({
        "recording": [f"scene{number}" for number in scene],
        "reducer": [f"way{number}" for number in kind],
        "item": np.arange(len(scene)),
        **dict(zip(METRICS, values, strict=True)),
    })


def make(own: tuple[int, int] = (6, 6), **changes: object) -> PowerDesign:
    """Make a design of own recordings x reducers; changes go to its truth or to itself."""
    truth = {name: changes.pop(name) for name in list(changes) if name in Truth.__slots__}
    sizes = {"participants": 10, **changes}
    return PowerDesign(
        make_items(*own), METRICS, Truth(**{"slopes": {"spectral": 25.0}, **truth}), **sizes
    )


@pytest.fixture(scope="session")
def make_design() -> Callable[..., PowerDesign]:
    """Make designs."""
    return make
