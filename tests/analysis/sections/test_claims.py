"""What the primary model is said to show: a direction where Holm's p leaves no doubt, and nothing else."""

from __future__ import annotations

import math
import re
from typing import TYPE_CHECKING

import pandas as pd
import pytest

from feel321.analysis.primary.sensitivity import Influence
from feel321.analysis.report import primary
from feel321.analysis.report.section import TableForm, estimate
from feel321.analysis.resampling import Choices
from feel321.analysis.table.reading import Table
from feel321.analysis.words import format_estimate

if TYPE_CHECKING:
    from collections.abc import Callable

METRICS = ("spectral_match", "temporal_match")


def tell(rows: pd.DataFrame) -> tuple[dict[str, float], tuple[str, ...], str]:
    """Holm's p per metric, the sentence of each metric, and all that opens the report."""
    section = primary.compute(Table(rows, METRICS, ()), Choices(draws=2))
    found = {
        number.name.split(".")[-2]: number.value
        for number in section.numbers
        if number.name.endswith("p_holm")
    }
    p = {claim.metric: found[claim.metric] for claim in section.claims if claim.metric in found}
    return p, tuple(map(str, section.verdict[:2])), " ".join(map(str, section.verdict))


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave nothing out: what single units do is another test's."""
    nothing = Influence(pd.DataFrame(), pd.DataFrame())
    monkeypatch.setattr(primary, "measure_influence", lambda *_, **__: nothing)


@pytest.mark.parametrize(("slope", "way"), [(30.0, "higher"), (-30.0, "lower")])
def test_a_direction_follows_the_sign_and_few_recordings_weaken_it(
    tidy: Callable[..., pd.DataFrame], slope: float, way: str
) -> None:
    p, (spectral, temporal), whole = tell(tidy(1, participants=8, recordings=4, spectral=slope))
    assert p["spectral_match"] < 0.05 <= p["temporal_match"]
    assert spectral.startswith("Realism: Spectral match predicts realism ratings")
    assert ("in the opposite direction (higher spectral match, lower ratings)" in spectral) == (
        way == "lower"
    )
    assert ("points higher" in spectral) == (way == "higher")
    assert temporal.startswith("Realism: Whether temporal match predicts realism ratings is open.")
    assert "With 4 recordings this is a hint rather than a result." in whole


def test_where_nothing_is_claimed_nothing_is_called_a_hint(
    tidy: Callable[..., pd.DataFrame],
) -> None:
    p, answers, whole = tell(tidy(1, participants=4, recordings=4, spectral=0.0))
    assert min(p.values()) > 0.05
    assert all("is open." in answer for answer in answers)
    assert "hint" not in whole


def test_what_holds_before_holms_adjustment_only_is_not_claimed(
    tidy: Callable[..., pd.DataFrame], monkeypatch: pytest.MonkeyPatch
) -> None:
    tabulate = primary.tabulate_slopes
    monkeypatch.setattr(
        primary, "tabulate_slopes", lambda models: tabulate(models).assign(p=0.03, p_holm=0.06)
    )
    _, answers, whole = tell(tidy(1, participants=8, recordings=4))
    assert all("is open." in answer and "p (Holm) = 0.060" in answer for answer in answers)
    assert "predicts realism ratings." not in whole
    # What is not claimed is open: what would settle it is told.
    assert "If the true slope on spectral match is the one estimated here" in whole


def test_what_is_not_estimable_has_no_interval_and_plans_nothing(
    tidy: Callable[..., pd.DataFrame],
) -> None:
    section = primary.compute(
        Table(tidy(1, participants=2, recordings=4), METRICS, ()), Choices(draws=2)
    )
    words = " ".join([*map(str, section.verdict), *section.answers])
    assert words.count("cannot be estimated with 2 participants") == 2
    for stranger in ("interval", " CI ", "p (Holm)", "80 % power", "is open", "e+"):
        assert stranger not in words
    for number in section.numbers:
        planned = number.name.startswith("precision.") or number.name.endswith((
            ".df",
            ".p",
            ".p_holm",
        ))
        assert not planned or math.isnan(number.value)
        assert not number.name.startswith("slope") or math.isnan(number.low)


def test_nothing_is_planned_from_a_slope_that_one_stimulus_turns(
    tidy: Callable[..., pd.DataFrame], monkeypatch: pytest.MonkeyPatch
) -> None:
    tabulate = primary.tabulate_slopes
    monkeypatch.setattr(
        primary, "tabulate_slopes", lambda models: tabulate(models).assign(p_holm=0.06, turns=True)
    )
    section = primary.compute(
        Table(tidy(1, participants=8, recordings=4), METRICS, ()), Choices(draws=2)
    )
    assert "80 % power" not in " ".join(map(str, section.verdict))
    plans = [number.value for number in section.numbers if number.name.startswith("precision.")]
    assert len(plans) == 8
    assert all(map(math.isnan, plans))


def test_a_slope_on_a_metric_that_runs_over_thousands_is_not_told_as_zero(
    tidy: Callable[..., pd.DataFrame],
) -> None:
    rows = tidy(1, participants=8, recordings=6)
    _, (spectral, _), _ = tell(rows.assign(spectral_match=1e5 * rows["spectral_match"]))
    number = r"\d+\.\d"
    assert re.search(
        rf"each \+10000 with ratings {number} points higher \({number} to {number}\)", spectral
    )


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
    row = dict(zip(("estimate", "low", "high"), ends, strict=True), n=9)
    table = TableForm("", [estimate("Slope", "estimate", "slope")], path="slope").build([row])
    assert table.rows == ((value, interval),)
    assert format_estimate(*ends, kind="slope") == (value, interval)


@pytest.mark.parametrize(
    ("change", "why"),
    [
        (lambda _: 0.5, "the stimuli of a recording do not differ in it"),
        (lambda rows: 1 - rows["spectral_match"], "within recordings it follows from the other metrics"),
    ],
)  # fmt: skip
def test_a_declared_metric_without_a_slope_is_not_passed_over(
    tidy: Callable[..., pd.DataFrame], change: Callable[[pd.DataFrame], object], why: str
) -> None:
    rows = tidy(1, participants=4, recordings=4).assign(temporal_match=change)
    section = primary.compute(Table(rows, METRICS, ()), Choices(draws=2))
    (line,) = (str(line) for line in section.verdict if "temporal match predicts" in str(line))
    lead = "Realism: Whether temporal match predicts realism ratings cannot be estimated"
    assert line == f"{lead}: {why}."
    verdicts = {claim.metric: claim.verdict for claim in section.claims}
    assert verdicts["temporal_match"] == "not_estimable"
    assert list(verdicts) == list(METRICS)


@pytest.mark.parametrize("n_reducers", [2, 3, 4, 5])
def test_few_reducers_are_handled_as_few_people_are(
    tidy: Callable[..., pd.DataFrame], n_reducers: int
) -> None:
    rows = tidy(1, participants=8, recordings=6, spectral=0.0, temporal=60.0)
    kept = rows["reducer"].isin(["sax321", "soc321", "dft321", "saz321", "pca321"][:n_reducers])
    section = primary.compute(Table(rows[kept], METRICS[1:], ()), Choices(draws=2))
    lacks, few = n_reducers < 3, n_reducers < 5
    (claim,) = section.claims
    assert claim.verdict == ("not_estimable" if lacks else "predicts")
    assert claim.few == ((f"{n_reducers} reducers",) if few else ())
    for number in section.numbers:
        if lacks and number.name.startswith("slope"):
            assert math.isnan(number.low)


@pytest.mark.parametrize("without", ["open", "predicts"])
def test_an_open_verdict_hinges_on_nothing(
    tidy: Callable[..., pd.DataFrame], monkeypatch: pytest.MonkeyPatch, without: str
) -> None:
    unit = {"kind": "reducer", "unit": "pca321", "metric": "temporal_match", "verdict": without}
    numbers = {"tenth": -0.1, "tenth_low": -0.5, "tenth_high": 0.3, "shift": 0.4, "p_holm": 0.5}
    table = pd.DataFrame([unit | numbers | {"turns": True, "moves": True}])
    found = Influence(table, pd.DataFrame({"excess": [], "p": [], "exceptional": []}))
    monkeypatch.setattr(primary, "measure_influence", lambda *_, **__: found)
    section = primary.compute(
        Table(tidy(1, participants=8, recordings=6), METRICS, ()), Choices(draws=2)
    )
    temporal = section.claims[1]
    assert (temporal.verdict, temporal.hinge, temporal.hinges_on) == ("open", "", ())
    assert not any("hinges" in str(line) for line in section.verdict)
