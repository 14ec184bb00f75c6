"""What was delivered beside what was intended, and rigs as a choice of the analysis."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
import pytest

from feel321.analysis.page import render_words
from feel321.analysis.primary.sensitivity import vary_primary
from feel321.analysis.report import delivered, robustness
from feel321.analysis.report.answer import find_row
from feel321.analysis.report.parts import split_parts
from feel321.analysis.resampling import Choices
from feel321.analysis.table.reading import read_table

if TYPE_CHECKING:
    from collections.abc import Callable

    from feel321.analysis.table.reading import Table

LOSS = 0.1
USUAL, ODD = "a1b2c3d4e5f6", "b7c1d2e3f4a5"


@pytest.fixture
def small(files: Callable[..., object]) -> object:
    return files(participants=6, repeats=1, scales=("realism",), anchors=False, noise=4.0)


def deliver(study: object, **columns: object) -> Table:
    """Add columns to ratings.csv; a metric is delivered with the same loss everywhere."""
    ratings, manifest = pd.read_csv(study.ratings), pd.read_csv(study.manifest)
    metrics = manifest.set_index("stimulus_id").reindex(ratings["stimulus_id"])
    for name in ("spectral_match", "temporal_match"):
        ratings[f"{name}_delivered"] = metrics[name].to_numpy() - LOSS
    ratings = ratings.assign(**columns)
    ratings.to_csv(study.ratings, index=False)
    return read_table(study.ratings, study.manifest)


def test_the_difference_is_what_was_lost_on_the_way(small: object) -> None:
    n = len(pd.read_csv(small.ratings))
    errors = np.linspace(-2, 1, n)
    table = deliver(small, level_error_db=errors, delivered_by="sensor")
    section = delivered.compute(table, Choices())
    for name in ("spectral_match", "temporal_match"):
        for quantity in ("difference", "largest"):
            row = find_row(section.rows["delivered"], quantity, metric=name)
            assert row["value"] == pytest.approx(-LOSS)
    tests = errors[[role == "test" for role in table.rows["role"]]]
    levels = {row["quantity"]: row["value"] for row in section.rows["level_errors"]}
    assert levels["median"] == pytest.approx(np.median(tests))
    assert levels["q05"] == pytest.approx(np.quantile(tests, 0.05))
    assert levels["n_judgements"] == len(tests)
    assert "(measured by the sensor)" in render_words("delivered", **section.facts)[0]
    assert section.pictures[0].figure.axes


def test_what_is_measured_in_part_is_counted_by_its_source(small: object) -> None:
    n = len(pd.read_csv(small.ratings))
    by = np.where(np.arange(n) < 5, "certificate", np.where(np.arange(n) < 12, "sensor", ""))
    errors = np.where(by == "", np.nan, 0.5)
    section = delivered.compute(deliver(small, level_error_db=errors, delivered_by=by), Choices())
    levels = {row["source"]: row["n"] for row in section.rows["level_errors"]}
    assert sum(levels.values()) < n
    assert levels.keys() == {"certificate", "sensor"}


def test_nothing_delivered_is_no_section(small: object) -> None:
    table = read_table(small.ratings, small.manifest)
    assert delivered.compute(table, Choices()).is_empty


def test_a_constant_loss_changes_no_slope_but_a_lost_metric_does(small: object) -> None:
    def vary(table: Table) -> pd.DataFrame:
        (part,) = split_parts(table)
        found = vary_primary(part.rows, table.metrics)
        return found.set_index(["variant", "metric"])["estimate"]

    slopes = vary(deliver(small))
    for name in ("spectral_match", "temporal_match"):
        assert slopes["delivered metrics", name] == pytest.approx(slopes["primary", name], rel=1e-4)
    ratings = pd.read_csv(small.ratings)
    codes = ratings["stimulus_id"].factorize()[0]
    noise = np.random.default_rng(3).uniform(0, 1, codes.max() + 1)
    slopes = vary(deliver(small, spectral_match_delivered=noise[codes]))
    assert abs(slopes["delivered metrics", "spectral_match"]) < 0.4 * abs(
        slopes["primary", "spectral_match"]
    )


def write_roster(study: object, odd: tuple[str, ...], *, column: str = "rig") -> None:
    people = pd.read_csv(study.ratings)["participant"].unique()
    values = [ODD if who in odd else USUAL for who in people]
    roster = pd.DataFrame({"participant": people, column: values})
    roster.to_csv(study.ratings.with_name("participants.csv"), index=False)


@pytest.mark.parametrize("column", ["rig", "calibration"])
def test_a_rig_on_which_people_feel_otherwise_is_named_first(small: object, column: str) -> None:
    ratings = pd.read_csv(small.ratings)
    odd = ratings["participant"].isin(["p01", "p04"])
    ratings.loc[odd, "rating"] = 100 - ratings.loc[odd, "rating"]
    ratings.to_csv(small.ratings, index=False)
    write_roster(small, ("p01", "p04"), column=column)
    table = read_table(small.ratings, small.manifest)
    assert any(f"{USUAL} 4, {ODD} 2" in note for note in table.notes)
    section = robustness.compute(table, Choices(draws=2))
    (line,) = (one for one in render_words("robustness", **section.facts) if "rigs:" in one)
    assert line.startswith("Realism, rigs: slopes depend on the rig.")
    assert f"(without {column} {ODD})" in line
    variants = {row["variant"] for row in section.rows["variants"]}
    assert {f"{column} as a factor", f"without {column} {ODD}"} <= variants
    assert f"without {column} {USUAL}" not in variants


def test_rigs_on_which_people_feel_alike_are_not_named_first(small: object) -> None:
    write_roster(small, ("p01", "p04"))
    table = read_table(small.ratings, small.manifest)
    assert not robustness.compute(table, Choices(draws=2)).facts["rigs"]
    write_roster(small, ())
    table = read_table(small.ratings, small.manifest)
    assert "rig" not in table.rows
    assert not any("rig" in note for note in table.notes)


def test_a_rig_as_a_factor_takes_out_what_the_rig_adds(small: object) -> None:
    write_roster(small, ("p01", "p04"))
    before = read_table(small.ratings, small.manifest)
    rows = next(split_parts(before)).rows
    # Unbalanced, or people's recordings would take it out by themselves.
    left = (rows["rig"] == USUAL) | (rows["recording"] != "rec0") | (rows["spectral_match"] > 0.5)
    rows = rows[left]
    there = (rows["rig"] == ODD) & (rows["recording"] == "rec0")
    shifted = rows.assign(rating=rows["rating"] + 25 * there)
    slopes = [
        vary_primary(one, before.metrics, top=200).set_index(["variant", "metric"])["estimate"][
            "rig as a factor"
        ]
        for one in (rows, shifted)
    ]
    np.testing.assert_allclose(*slopes, rtol=1e-3)
