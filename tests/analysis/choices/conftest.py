"""Choices that follow a planted model, as the two tables of a study."""

from collections.abc import Callable
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import pytest

from feel321.analysis.table.items import Table
from feel321.analysis.table.reading import read_table

METRICS = ("spectral_match_bounded", "temporal_match")
REDUCERS = ("sax321", "mag321", "soc321", "dft321", "pca321")


class Planted(NamedTuple):
    """Choices and stimuli, and the weights in log odds per unit of each metric."""

    votes: pd.DataFrame
    stimuli: pd.DataFrame
    weights: tuple[float, float]

    def read(self, **more: Any) -> Table:
        return read_table(self.votes, self.stimuli, **more)


def list_stimuli(n_recordings: int, rng: np.random.Generator) -> pd.DataFrame:
    rows = [
        (f"r{r}-{name}", f"r{r}", name, "as_is", role)
        for r in range(n_recordings)
        for name, role in (
            *((name, "test") for name in REDUCERS),
            ("original", "reference"),
            ("low", "anchor"),
        )
    ]
    frame = pd.DataFrame(rows, columns=["stimulus_id", "recording", "reducer", "level", "role"])
    return frame.assign(**{name: rng.uniform(0.1, 0.9, len(frame)) for name in METRICS})


def plant_votes(
    *,
    seed: int = 0,
    participants: int = 16,
    recordings: int = 8,
    weights: tuple[float, float] = (5.0, 0.0),
    lapse: float = 0.05,
    order: float = 0.0,
    scale: str = "triplet",
) -> Planted:
    """Every participant judges every pair of reducers of every recording once; which comes first is drawn."""
    rng = np.random.default_rng(seed)
    stimuli = list_stimuli(recordings, rng)
    values = stimuli.set_index("stimulus_id")[list(METRICS)]
    rows = [
        (f"p{p:02}", *(f"r{r}-{name}" for name in (pair if rng.random() < 0.5 else pair[::-1])))
        for p in range(participants)
        for r in range(recordings)
        for pair in combinations(REDUCERS, 2)
    ]
    votes = pd.DataFrame(rows, columns=["participant", "stimulus_id", "other_id"])
    apart = values.loc[votes["stimulus_id"]].to_numpy() - values.loc[votes["other_id"]].to_numpy()
    felt = 1 / (1 + np.exp(-(order + apart @ np.array(weights))))
    first = rng.random(len(votes)) < lapse / 2 + (1 - lapse) * felt
    about = votes["stimulus_id"].str.split("-").str[0] + "-original" if scale == "triplet" else ""
    votes = votes.assign(
        reference_id=about, scale=scale, rating=np.where(first, 100, 0), trial=np.arange(len(votes))
    )
    return Planted(votes, stimuli, weights)


@pytest.fixture(scope="session")
def plant() -> Callable[..., Planted]:
    return plant_votes
