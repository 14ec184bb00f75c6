from __future__ import annotations

import dataclasses
import math

import pandas as pd
import pytest

from analysis.association.correlate import Association, Difference
from analysis.findings import Panel
from analysis.report.verdict import judge_association, judge_difference, sum_up_panels
from analysis.words import tell_method

CLEAR = Association(
    value=0.7, low=0.4, high=0.9, n_items=36, ceiling=0.9, disattenuated=0.78, draws=2000, participants_low=0.6,
    participants_high=0.8, n_participants=12, n_recordings=4, n_sources=4, n_missing=0,
    metric="spectral_match", method="pearson",
)  # fmt: skip

BETTER = Difference(
    value=0.5, low=0.2, high=0.8, z_value=0.6, z_low=0.2, z_high=1.0, first_value=0.7, second_value=0.2, n_items=36,
    n_participants=12, n_recordings=4, n_sources=4, n_missing=0, draws=2000, first="spectral_match",
    second="temporal_match", method="pearson",
)  # fmt: skip


def judge(**changes: object) -> str:
    return judge_association(dataclasses.replace(CLEAR, **changes), "realism", ranked=CLEAR)


def compare(*, spread: float = 0.05, **changes: object) -> str:
    result = dataclasses.replace(BETTER, **changes)
    first, second = (
        dataclasses.replace(CLEAR, metric=metric, value=value, low=value - spread, high=value + spread)
        for metric, value in ((result.first, result.first_value), (result.second, result.second_value))
    )
    return judge_difference(result, "realism", first=first, second=second)


def test_a_clear_association_is_claimed_with_its_evidence() -> None:
    said = judge().replace("\N{NO-BREAK SPACE}", " ")
    assert said.startswith("Stimuli with a higher spectral match got higher realism ratings")
    assert "r = 0.70 of at most 0.90 that ratings as noisy as these allow, 95 % two-way interval" in said
    assert "interval 0.40 to 0.90; 12 participants, 4 recordings, 36 stimuli" in said
    assert said.endswith("agrees.")


def test_direction_follows_the_sign() -> None:
    assert "got lower realism ratings" in judge(value=-0.7, low=-0.9, high=-0.4)


@pytest.mark.parametrize(("low", "high"), [(-0.1, 0.9), (0.0, 0.9), (-0.9, 0.0)])
def test_an_interval_over_zero_claims_nothing(low: float, high: float) -> None:
    said = judge(low=low, high=high)
    assert "undecided" in said
    assert "got higher" not in said
    assert said.endswith("(0.70, 0.40 to 0.90) leaves zero out.")


@pytest.mark.parametrize(
    ("ranks", "said"),
    [
        ({"value": 0.6, "low": 0.2, "high": 0.8}, "agrees."),
        ({"value": 0.3, "low": -0.2, "high": 0.7}, "covers zero."),
        ({"value": -0.6, "low": -0.8, "high": -0.3}, "has the opposite direction."),
        ({"value": -0.1, "low": -0.5, "high": 0.3}, "covers zero and has the opposite direction."),
        ({"low": math.nan, "high": math.nan}, "has no interval to compare."),
    ],
)
def test_ranks_agree_only_in_verdict_and_direction(ranks: dict[str, float], said: str) -> None:
    ranked = dataclasses.replace(CLEAR, method="spearman", **ranks)
    assert judge_association(CLEAR, "realism", ranked=ranked).endswith(f") {said}")


@pytest.mark.parametrize(
    ("ranks", "told"),
    [
        ({"value": 0.6, "low": 0.2, "high": 0.8}, ")"),
        ({"value": 0.3, "low": -0.2, "high": 0.7}, "; by ranks 0.30, −0.20 to 0.70)"),
        ({"value": -0.6, "low": -0.8, "high": -0.3}, "; by ranks −0.60, −0.80 to −0.30)"),
        ({"low": math.nan, "high": math.nan}, ")"),
    ],
)
def test_the_answer_gives_the_ranks_where_they_contradict_it(ranks: dict[str, float], told: str) -> None:
    both = (CLEAR, dataclasses.replace(CLEAR, method="spearman", **ranks))
    (line,) = sum_up_panels([Panel("realism", "as_is", both, (), pd.DataFrame())])
    assert f"95 % two-way interval 0.40 to 0.90{told}; ratings" in str(line).replace("\N{NO-BREAK SPACE}", " ")


@pytest.mark.parametrize("second_value", [0.2, -0.2])
def test_no_metric_is_better_whose_own_interval_covers_zero(second_value: float) -> None:
    said = compare(spread=0.75, second_value=second_value)
    assert "spectral match" in said.split("leaves zero out")[1]
    assert said.endswith("covers zero, so neither is named the better.")


def test_an_unclear_weaker_metric_of_opposite_sign_has_no_direction() -> None:
    said = compare(second_value=-0.1, spread=0.2)
    assert said.endswith("the interval with temporal match covers zero, so neither is named the better.")


def test_no_interval_no_conclusion() -> None:
    assert "nothing follows" in judge(low=math.nan, high=math.nan, n_recordings=1)
    assert "1 recording," in judge(low=math.nan, high=math.nan, n_recordings=1)


def test_no_correlation_gives_the_reason() -> None:
    assert judge(value=math.nan, low=math.nan, high=math.nan, notes=("No correlation: why.",)).endswith("why.")


def test_the_better_metric_is_named() -> None:
    assert compare().endswith("spectral match is the better predictor.")
    turned = compare(value=-0.5, low=-0.8, high=-0.2, first_value=0.2, second_value=0.7)
    assert turned.endswith("temporal match is the better predictor.")


def test_better_means_stronger_where_both_are_negative() -> None:
    said = compare(first_value=-0.2, second_value=-0.7)
    assert said.endswith("temporal match is the better predictor.")


def test_opposite_signs_are_not_ranked() -> None:
    assert compare(first_value=0.4, second_value=-0.1).endswith("they point in opposite directions.")


def test_a_difference_over_zero_ranks_nothing() -> None:
    said = compare(low=-0.1)
    assert said.startswith("Neither metric is shown to predict realism better")
    assert "is the better predictor" not in said


def test_a_difference_without_interval_says_so() -> None:
    assert compare(low=math.nan).endswith("cannot be compared by an interval here.")


@pytest.mark.parametrize(
    ("name", "told"), [("pearson", "Pearson"), ("within", "Pearson within recordings"), ("kendall", "Kendall")]
)
def test_methods_have_names(name: str, told: str) -> None:
    assert tell_method(name) == told
