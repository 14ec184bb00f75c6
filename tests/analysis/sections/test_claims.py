"""What the primary model is said to show: a direction where Holm's p leaves no doubt, and nothing else."""

from __future__ import annotations

import math
import re
from typing import TYPE_CHECKING

import pytest

from analysis.numbers import SATTERTHWAITE, make_interval, make_number
from analysis.report.sections import primary
from analysis.report.sections.choices import Choices
from analysis.report.sections.effects import lay_estimate, tell_estimate
from analysis.table.reading import Table

if TYPE_CHECKING:
    from collections.abc import Callable

    import pandas as pd

METRICS = ("spectral_match", "temporal_match")
HINT = "a hint rather than a result with so few recordings"


def tell(rows: pd.DataFrame) -> tuple[dict[str, float], tuple[str, ...], str]:
    """Holm's p per metric, the claims at length, and the line that sums them up."""
    section = primary.compute(Table(rows, METRICS, ()), Choices(draws=2))
    found = {number.name.split(".")[-2]: number.value for number in section.numbers if number.name.endswith("p_holm")}
    (line,) = section.verdict
    return found, section.answers, str(line)


@pytest.mark.parametrize(("slope", "way"), [(30.0, "higher"), (-30.0, "lower")])
def test_a_direction_follows_the_sign_and_few_recordings_weaken_it(
    tidy: Callable[..., pd.DataFrame], slope: float, way: str
) -> None:
    p, (spectral, temporal), line = tell(tidy(1, participants=8, recordings=4, spectral=slope))
    assert p["spectral_match"] < 0.05 <= p["temporal_match"]
    assert f"stimuli with a higher spectral match got {way} realism ratings" in spectral
    assert spectral.endswith(f", {HINT}.")
    assert "follow temporal match within recordings is undecided" in temporal
    assert f"+0.1 of spectral match goes with {way} ratings" in line
    assert "what +0.1 of temporal match goes with is undecided" in line
    assert f"This is {HINT}." in line


def test_where_nothing_is_claimed_nothing_is_called_a_hint(tidy: Callable[..., pd.DataFrame]) -> None:
    p, answers, line = tell(tidy(1, participants=4, recordings=4, spectral=0.0))
    assert min(p.values()) > 0.05
    assert all("is undecided" in answer for answer in answers)
    assert "hint" not in line + " ".join(answers)


def test_what_holds_before_holms_adjustment_only_is_not_claimed(
    tidy: Callable[..., pd.DataFrame], monkeypatch: pytest.MonkeyPatch
) -> None:
    tabulate = primary.tabulate_slopes
    monkeypatch.setattr(primary, "tabulate_slopes", lambda models: tabulate(models).assign(p=0.03, p_holm=0.06))
    _, answers, line = tell(tidy(1, participants=8, recordings=4))
    assert all("is undecided" in answer and "p (Holm) = 0.060" in answer for answer in answers)
    assert "goes with higher" not in line
    # What is not claimed is open: what would settle it is told.
    assert "If the slope on spectral match is what was estimated here" in line


def test_what_is_not_estimable_has_no_interval_and_plans_nothing(tidy: Callable[..., pd.DataFrame]) -> None:
    section = primary.compute(Table(tidy(1, participants=2, recordings=4), METRICS, ()), Choices(draws=2))
    words = " ".join([*map(str, section.verdict), *section.answers])
    assert words.count("is not estimable") == 4
    for stranger in ("interval", "p (Holm)", "would find it", "undecided", "e+"):
        assert stranger not in words
    for number in section.numbers:
        planned = number.name.startswith("precision.") or number.name.endswith((".df", ".p", ".p_holm"))
        assert not planned or math.isnan(number.value)
        assert not number.name.startswith("slope") or math.isnan(number.low)


def test_nothing_is_planned_from_a_slope_that_one_stimulus_turns(
    tidy: Callable[..., pd.DataFrame], monkeypatch: pytest.MonkeyPatch
) -> None:
    tabulate = primary.tabulate_slopes
    monkeypatch.setattr(primary, "tabulate_slopes", lambda models: tabulate(models).assign(p_holm=0.06, turns=True))
    section = primary.compute(Table(tidy(1, participants=8, recordings=4), METRICS, ()), Choices(draws=2))
    assert "would find it" not in str(section.verdict[0])
    plans = [number.value for number in section.numbers if number.name.startswith("precision.")]
    assert len(plans) == 8
    assert all(map(math.isnan, plans))


def test_a_slope_on_a_metric_that_runs_over_thousands_is_not_told_as_zero(tidy: Callable[..., pd.DataFrame]) -> None:
    rows = tidy(1, participants=8, recordings=6)
    _, (spectral, _), line = tell(rows.assign(spectral_match=1e5 * rows["spectral_match"]))
    number = r"\d\.\de−05"
    evidence = rf"{number} points, 95 % interval {number} to {number}; p \(Holm\)"
    assert re.search(evidence, line)
    assert re.search(evidence, spectral)


@pytest.mark.parametrize(
    ("ends", "value", "interval"),
    [
        ((2.2e-4, -1.3e-3, 1.7e-3), "2.2e−04", "−1.3e−03 to 1.7e−03"),
        ((0.002, -0.001, 0.2), "0.00", "0.00 to 0.20"),
        ((0.0, 0.0, 0.0), "0.00", "0.00 to 0.00"),
    ],
)
def test_tables_and_sentences_tell_a_slope_in_the_same_digits(
    ends: tuple[float, float, float], value: str, interval: str
) -> None:
    number = make_interval(make_number("slope", ends[0], "slope", n=9), *ends[1:], uncertainty=SATTERTHWAITE)
    assert [str(cell) for cell in lay_estimate(number, "slope")] == [value, interval]
    assert tell_estimate(number, kind="slope") == f"{value} points, 95 % interval {interval}"


def test_one_participant_speaks_of_nobody_else(tidy: Callable[..., pd.DataFrame]) -> None:
    _, _, line = tell(tidy(1, participants=1, recordings=8))
    assert "This is about this one participant only." in line
