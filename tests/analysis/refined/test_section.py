"""The section on refined metrics: the same numbers as the search, in words no stronger than they are."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
import pytest

from feel321.analysis.refined.refine import Refined, refine_metric
from feel321.analysis.report.robustness import LEVEL, compute_refined
from feel321.analysis.resampling import Choices
from feel321.analysis.table.reading import Table
from feel321.analysis.words import format_interval

if TYPE_CHECKING:
    from collections.abc import Callable

METRICS = ("spectral_match", "temporal_match")
CHOICES = Choices(draws=40, seed=3)


@pytest.fixture
def make_table(tidy: Callable[..., pd.DataFrame]) -> Callable[..., Table]:
    def make(seed: int = 0, **changes: object) -> Table:
        rows = tidy(seed, **{"recordings": 8, "participants": 8, "noise": 5.0, **changes})
        return Table(rows, METRICS, ())

    return make


def test_section_tells_what_the_search_found(make_table: Callable[..., Table]) -> None:
    table = make_table(spectral=25, temporal=30)
    section = compute_refined(table, CHOICES)
    tests = table.rows[table.rows["role"] == "test"]
    found = refine_metric(
        tests, METRICS, draws=40, rng=CHOICES.make_rng("refined", "realism", "as_is")
    )
    numbers = {number.name: number for number in section.numbers}
    value = numbers["refined.realism.as_is.value"]
    assert (value.value, value.low, value.high) == pytest.approx((
        found.value,
        found.low,
        found.high,
    ))
    gain = numbers["refined.realism.as_is.over.spectral_match.gain"]
    assert gain.value == pytest.approx(found.gains["value"][0])
    assert set(section.tables) == {"refined_gains", "refined_candidates", "refined_weights"}
    assert tuple(map(str, section.verdict)) == section.answers
    assert len(numbers) == len(section.numbers)


def test_a_sum_is_recommended_and_a_single_metric_is_not_improved(
    make_table: Callable[..., Table],
) -> None:
    both = compute_refined(make_table(spectral=25, temporal=30), CHOICES).answers
    assert len(both) == 1
    assert both[0].startswith(
        "Realism: the weighted sum of spectral match + temporal match predicts better than each "
    )
    one = compute_refined(make_table(spectral=40, temporal=0), CHOICES).answers[0]
    assert one.startswith("Realism: no refined metric is recommended: ")
    assert one.endswith("the interval covers zero.")


def test_what_is_not_recommended_opens_the_report_in_one_line(
    make_table: Callable[..., Table],
) -> None:
    rows = make_table(spectral=40, temporal=0).rows
    both = pd.concat([rows, rows.assign(scale="similarity")], ignore_index=True)
    section = compute_refined(Table(both, METRICS, ()), CHOICES)
    assert len(section.answers) == 2
    (line,) = map(str, section.verdict)
    gains = sorted(
        number.value
        for number in section.numbers
        if number.name.endswith("over.spectral_match.gain")
    )
    assert line == (
        f"No refined metric is recommended (gains in correlation over the best single metric "
        f"{format_interval(*gains)}, out of fold; each 95 % two-way interval covers zero)."
    )


def test_one_recommendation_leaves_a_line_for_the_rest(
    make_table: Callable[..., Table], monkeypatch: pytest.MonkeyPatch
) -> None:
    turns = iter([True, False])

    def search(*given: Any, **choices: Any) -> Refined:
        return replace(refine_metric(*given, **choices), recommended=next(turns))

    monkeypatch.setattr("feel321.analysis.report.robustness.refine_metric", search)
    rows = make_table(spectral=25, temporal=30).rows
    both = pd.concat([rows, rows.assign(scale="similarity")], ignore_index=True)
    first, second = map(str, compute_refined(Table(both, METRICS, ()), CHOICES).verdict)
    assert "predicts better than each metric" in first
    assert second.startswith(
        "No further refined metric is recommended (gain in correlation over the best single "
    )
    assert "covers zero" not in second


def test_a_level_enters_where_the_manifest_tells_it(make_table: Callable[..., Table]) -> None:
    table = make_table()
    amplitude = np.exp(
        np.random.default_rng(1).normal(size=len(table.rows["stimulus_id"].unique()))
    )
    of_stimulus = dict(zip(table.rows["stimulus_id"].unique(), amplitude, strict=True))
    rows = table.rows.assign(rms_m_s2=table.rows["stimulus_id"].map(of_stimulus))
    names = compute_refined(Table(rows, METRICS, ()), CHOICES).tables["refined_candidates"]["name"]
    assert f"spectral_match + {LEVEL}" in set(names)


def test_a_gain_over_the_best_alone_is_no_recommendation(
    make_table: Callable[..., Table], monkeypatch: pytest.MonkeyPatch
) -> None:
    def search(*given: Any, **choices: Any) -> Refined:
        return replace(refine_metric(*given, **choices), recommended=False)

    monkeypatch.setattr("feel321.analysis.report.robustness.refine_metric", search)
    answer = compute_refined(make_table(spectral=25, temporal=30), CHOICES).answers[0]
    assert answer.startswith("Realism: no refined metric is recommended: ")
    assert (
        "but one is not chosen on all ratings, or does not gain over every single metric." in answer
    )


def test_small_studies_are_told_why_there_is_none(make_table: Callable[..., Table]) -> None:
    section = compute_refined(make_table(recordings=4), CHOICES)
    assert section.is_empty
    (note,) = section.notes
    assert note.startswith("realism, as_is, refined metrics: none is searched. ")
    assert "5 recordings of their own or more, got 4" in note


def test_what_has_no_interval_is_not_recommended(make_table: Callable[..., Table]) -> None:
    table = make_table()
    rows = table.rows.assign(rating=20 + 50 * table.rows["spectral_match"].clip(0, 1).fillna(1))
    section = compute_refined(
        Table(rows.assign(spectral_match=rows["spectral_match"].clip(0, 1)), METRICS, ()), CHOICES
    )
    assert section.answers == (
        "Realism: no refined metric is recommended: its gain has no interval here.",
    )
    assert [str(line) for line in section.verdict] == [
        "No refined metric is recommended: gains have no interval here."
    ]


def test_ratings_that_fall_with_the_metrics_are_no_gain(make_table: Callable[..., Table]) -> None:
    section = compute_refined(make_table(spectral=-40, temporal=0), CHOICES)
    (line,) = map(str, section.verdict)
    assert "the strongest single metric correlates negatively" in line
    assert "spectral match, at −" in section.answers[0]
