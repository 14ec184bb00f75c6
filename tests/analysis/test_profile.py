from __future__ import annotations

from typing import TYPE_CHECKING

import pandas as pd
import pytest
from scipy import stats

from feel321.analysis.contrasts.compare import participant_means, profile_reducers, stimulus_means

if TYPE_CHECKING:
    from collections.abc import Callable


def test_means_by_hand() -> None:
    table = pd.DataFrame(
        {
            "scale": "realism", "level": "as_is", "role": "test", "reducer": "dft321",
            "participant": ["a", "a", "a", "b", "b"], "stimulus_id": ["s", "s", "t", "s", "t"],
            "recording": ["s", "s", "t", "s", "t"], "rating": [10.0, 20, 35, 60, 80],
        }
    )  # fmt: skip
    assert list(participant_means(table)["rating"]) == [25, 70]
    row = profile_reducers(table).iloc[0]
    assert (row["mean"], row["n_participants"], row["n_stimuli"], row["n_ratings"]) == (
        47.5,
        2,
        2,
        5,
    )
    assert list(stimulus_means(table)["mean"]) == [(15 + 60) / 2, (35 + 80) / 2]


def test_interval_is_the_t_interval_of_participant_means(tidy: Callable[..., pd.DataFrame]) -> None:
    table = tidy(participants=9)
    profile = profile_reducers(table)
    row = profile[profile["reducer"] == "pca321"].iloc[0]
    means = participant_means(table)
    values = means.loc[means["reducer"] == "pca321", "rating"]
    low, high = stats.t.interval(0.95, 8, values.mean(), stats.sem(values))
    assert (row["low"], row["high"]) == pytest.approx((low, high))
