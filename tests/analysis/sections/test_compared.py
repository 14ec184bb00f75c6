"""Reducers and level arms against each other: the tables' numbers by hand, and how far a claim reaches."""

from __future__ import annotations

from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np
import pytest

from feel321.analysis.contrasts.compare import equivalence, non_inferiority
from feel321.analysis.primary.sensitivity import adjust_holm
from feel321.analysis.report import reducers
from feel321.analysis.resampling import Choices
from feel321.analysis.table.reading import Table

if TYPE_CHECKING:
    from collections.abc import Callable

    import pandas as pd

METRICS = ("spectral_match", "temporal_match")
ARMS = ("as_is", "equal_intensity")
CHOICES = Choices(draws=2)


def test_contrasts_by_hand(tidy: Callable[..., pd.DataFrame]) -> None:
    rows = tidy(1, participants=8, recordings=5)
    margin = 4.0
    section = reducers.compute_contrasts(Table(rows, METRICS, ()), Choices(draws=2, margin=margin))
    table, numbers = section.tables["contrasts"], {one.name: one.value for one in section.numbers}
    tests = rows[rows["role"] == "test"]
    # In a balanced study a contrast is the difference of two means, whatever the spreads.
    means = tests.groupby("reducer")["rating"].mean()
    assert len(table) == len(list(combinations(means.index, 2)))
    assert table["estimate"].tolist() == pytest.approx(
        means[table["first"]].array - means[table["second"]].array
    )
    assert table["p_holm"].tolist() == pytest.approx(adjust_holm(table["p"].tolist()))
    for row in table.itertuples():
        test = equivalence(row.estimate, row.se, row.df, low=-margin, high=margin)
        assert row.p_equivalence == pytest.approx(test.p)
        # Higher is better: the first, the simpler one, must not lie below the second by the margin.
        assert row.p_non_inferiority == pytest.approx(
            non_inferiority(row.estimate, row.se, row.df, margin=-margin).p
        )
    assert numbers["contrasts.realism.as_is.n_differ"] == (table["p_holm"] < 0.05).sum() > 0


def test_raters_who_ignore_the_scale_show_no_equivalence(tidy: Callable[..., pd.DataFrame]) -> None:
    rows = tidy(1, participants=12, recordings=6)
    noise = np.random.default_rng(2).uniform(0, 100, len(rows))
    section = reducers.compute_contrasts(Table(rows.assign(rating=noise), METRICS, ()), CHOICES)
    table = section.tables["contrasts"]
    assert table[["margin", "p_equivalence", "p_non_inferiority"]].isna().all(axis=None)
    assert (table["low90"] > table["low"]).all()
    assert not section.pictures


@pytest.mark.parametrize(
    ("people", "scenes", "others", "reach"),
    [
        (6, 5, "other people and other recordings;", "."),
        (6, 1, "other people;", ", about this one recording only."),
        (1, 6, "other recordings;", ", about this one participant only."),
        (
            6,
            3,
            "other people and other recordings;",
            ", a hint rather than a result with so few recordings.",
        ),
    ],
)
def test_what_is_said_of_reducers_reaches_as_far_as_the_study(
    tidy: Callable[..., pd.DataFrame], people: int, scenes: int, others: str, reach: str
) -> None:
    table = Table(tidy(1, participants=people, recordings=scenes), METRICS, ())
    section = reducers.compute_contrasts(table, CHOICES)
    assert f"95 % intervals for {others}" in section.grids[0].caption
    assert section.answers[0].removesuffix(reach)[-1] not in ".,"
    assert section.answers[0].endswith(reach)


def make_arms(tidy: Callable[..., pd.DataFrame], **changes: object) -> pd.DataFrame:
    """At the first level ratings follow the spectral match by 30 points, at the second by none but lie 9 higher."""
    rows = tidy(2, levels=ARMS, anchors=False, **changes)
    second = rows["level"] == ARMS[1]
    rows["rating"] -= second * 30 * rows["spectral_match"].clip(0, 1)
    return rows.assign(rating=rows["rating"] + second * 24)


def test_levels_by_hand(tidy: Callable[..., pd.DataFrame]) -> None:
    rows = make_arms(tidy, participants=8, recordings=6)
    section = reducers.compute_levels(Table(rows, METRICS, ()), CHOICES)
    found = section.tables["levels"]
    assert found["p_holm"].tolist() == pytest.approx(adjust_holm(found["p"].tolist()))
    table = section.tables["levels"].set_index("of")
    means = rows.groupby("level")["rating"].mean()
    assert table.loc["rating", "estimate"] == pytest.approx(
        means[ARMS[0]] - means[ARMS[1]], abs=0.01
    )
    slope = table.loc["spectral_match"]
    assert slope["low"] < 3 < slope["high"]
    assert slope["p_holm"] < 0.01
    rating, spectral, temporal = section.answers
    assert rating.startswith("Realism ratings are lower at as is than at equal intensity (−")
    assert "the slope on spectral match is larger at as is than at equal intensity (" in spectral
    assert "It is unclear whether the effect of temporal match" in temporal
    assert not any("only" in answer or "hint" in answer for answer in section.answers)


def test_levels_of_one_participant_are_about_that_one(tidy: Callable[..., pd.DataFrame]) -> None:
    rows = make_arms(tidy, participants=1, recordings=8, noise=2.0)
    rating, spectral, temporal = reducers.compute_levels(Table(rows, METRICS, ()), CHOICES).answers
    assert spectral.endswith(", about this one participant only.")
    assert not temporal.endswith("only.")
    assert (
        "reach" not in reducers.compute_levels(Table(rows, METRICS, ()), CHOICES).tables["levels"]
    )
    assert rating
