from __future__ import annotations

import math
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


def test_references_and_anchors_keep_their_place(tidy: Callable[..., pd.DataFrame]) -> None:
    profile = profile_reducers(tidy())
    assert set(profile["role"]) == {"test", "reference", "anchor"}
    assert len(profile) == 12


def test_one_participant_has_no_interval(tidy: Callable[..., pd.DataFrame]) -> None:
    profile = profile_reducers(tidy(participants=1))
    assert profile["mean"].notna().all()
    assert all(math.isnan(value) for value in profile["low"])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda table: table.drop(columns="scale"), "ratings: column scale is missing"),
        (
            lambda table: table.assign(rating=table["rating"].where(table.index > 1)),
            "ratings must have scale, level, role, reducer, participant, stimulus_id and a",
        ),
        (
            lambda table: table.assign(reducer=table["reducer"].where(table.index > 0)),
            "ratings must have scale, level, role, reducer, participant, stimulus_id and a",
        ),
        (
            lambda table: table.assign(rating="good"),
            "ratings, 'rating' must hold numbers: could not convert string to float: 'good'",
        ),
    ],
)
def test_nothing_drops_out_of_a_mean_unseen(
    tidy: Callable[..., pd.DataFrame], change: Callable[[pd.DataFrame], pd.DataFrame], message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        profile_reducers(change(tidy()))
