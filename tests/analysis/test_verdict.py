from __future__ import annotations

import dataclasses
import math

import pandas as pd
import pytest

from feel321.analysis.association.correlate import Association, Difference, Panel
from feel321.analysis.report.association import sum_up_panels
from feel321.analysis.words import format_method

CLEAR = Association(
    value=0.7,
    low=0.4,
    high=0.9,
    n_items=36,
    ceiling=0.9,
    disattenuated=0.78,
    draws=2000,
    participants_low=0.6,
    participants_high=0.8,
    n_participants=12,
    n_recordings=4,
    n_sources=4,
    n_missing=0,
    metric="spectral_match_bounded",
    method="pearson",
)

APART = Difference(
    value=0.5,
    low=0.2,
    high=0.8,
    z_value=0.6,
    z_low=0.2,
    z_high=1.0,
    first_value=0.7,
    second_value=0.2,
    n_items=36,
    n_participants=12,
    n_recordings=4,
    n_sources=4,
    n_missing=0,
    draws=2000,
    first="spectral_match_bounded",
    second="temporal_match",
    method="pearson",
)


def say(
    *,
    ranks: dict[str, float] | None = None,
    differences: tuple[Difference, ...] = (),
    **changes: object,
) -> str:
    alone = dataclasses.replace(CLEAR, **changes)
    both = (alone, dataclasses.replace(CLEAR, method="spearman", **(ranks or {})))
    (line,) = sum_up_panels([Panel("realism", "as_is", both, differences, pd.DataFrame())])
    return line.replace("\N{NO-BREAK SPACE}", " ")


def test_a_correlation_comes_with_its_interval_and_the_ceiling() -> None:
    assert say() == (
        "Realism, over all 36 stimuli pooled: r = 0.70 with bounded spectral match (95 % two-way interval 0.40 to "
        "0.90); the noise ceiling is 0.90."
    )


@pytest.mark.parametrize(("low", "high"), [(-0.1, 0.9), (0.0, 0.9), (-0.9, 0.0)])
def test_an_interval_over_zero_is_said_to_be_one(low: float, high: float) -> None:
    assert ", which covers zero" in say(low=low, high=high, ranks={"low": low, "high": high})


@pytest.mark.parametrize(
    ("ranks", "told"),
    [
        ({"value": 0.6, "low": 0.2, "high": 0.8}, "0.40 to 0.90)"),
        ({"value": 0.3, "low": -0.2, "high": 0.7}, "0.40 to 0.90; by ranks 0.30, −0.20 to 0.70)"),
        (
            {"value": -0.6, "low": -0.8, "high": -0.3},
            "0.40 to 0.90; by ranks −0.60, −0.80 to −0.30)",
        ),
        ({"low": math.nan, "high": math.nan}, "0.40 to 0.90)"),
    ],
)
def test_the_ranks_are_given_where_they_contradict(ranks: dict[str, float], told: str) -> None:
    assert f"95 % two-way interval {told}; the noise" in say(ranks=ranks)


def test_without_interval_or_value_that_is_said() -> None:
    assert "r = 0.70 with bounded spectral match, without an interval" in say(
        low=math.nan, high=math.nan
    )
    said = say(
        value=math.nan, low=math.nan, notes=("No correlation: why.", "More."), ceiling=math.nan
    )
    assert (
        said
        == "Realism, over all 36 stimuli pooled: no correlation with bounded spectral match (why)."
    )


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({}, "differ by 0.50 (0.20 to 0.80, which excludes zero)."),
        ({"low": -0.1}, "differ by 0.50 (−0.10 to 0.80, which covers zero)."),
        ({"low": math.nan}, "cannot be compared by an interval."),
    ],
)
def test_a_difference_names_no_better_metric(changes: dict[str, float], told: str) -> None:
    said = say(differences=(dataclasses.replace(APART, **changes),))
    assert said.endswith(f"The correlations with bounded spectral match and temporal match {told}")
    assert "better" not in said


@pytest.mark.parametrize(
    ("name", "told"),
    [("pearson", "Pearson"), ("within", "Pearson within recordings"), ("kendall", "Kendall")],
)
def test_methods_have_names(name: str, told: str) -> None:
    assert format_method(name) == told
