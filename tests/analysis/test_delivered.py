"""What was delivered beside what was intended, and rigs as a choice of the analysis."""

from collections.abc import Callable

import numpy as np
import pandas as pd
import pytest

from feel321.analysis.primary.sensitivity import vary_primary
from feel321.analysis.report import primary, raters
from feel321.analysis.report.section import find_row
from feel321.analysis.resampling import Choices
from feel321.analysis.table.items import split_tests
from feel321.analysis.table.reading import Table, read_table
from feel321.analysis.words import render_words

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
    section = raters.compute_delivered(table, Choices())
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


def write_roster(study: object, odd: tuple[str, ...], *, column: str = "rig") -> None:
    people = pd.read_csv(study.ratings)["participant"].unique()
    values = [ODD if who in odd else USUAL for who in people]
    roster = pd.DataFrame({"participant": people, column: values})
    roster.to_csv(study.ratings.with_name("participants.csv"), index=False)


@pytest.mark.parametrize("column", ["rig", "calibration"])
def test_a_rig_on_which_people_feel_otherwise_is_named(small: object, column: str) -> None:
    ratings = pd.read_csv(small.ratings)
    odd = ratings["participant"].isin(["p01", "p04"])
    ratings.loc[odd, "rating"] = 100 - ratings.loc[odd, "rating"]
    ratings.to_csv(small.ratings, index=False)
    write_roster(small, ("p01", "p04"), column=column)
    table = read_table(small.ratings, small.manifest)
    assert any(f"{USUAL} 4, {ODD} 2" in note for note in table.notes)
    section = primary.compute_robustness(table, Choices(draws=2))
    assert f"without {column} {ODD}" in {row["variant"] for row in section.facts["turned"]}
    variants = {row["variant"] for row in section.rows["variants"]}
    assert {f"{column} as a factor", f"without {column} {ODD}"} <= variants
    assert f"without {column} {USUAL}" not in variants


def test_a_rig_as_a_factor_takes_out_what_the_rig_adds(small: object) -> None:
    write_roster(small, ("p01", "p04"))
    before = read_table(small.ratings, small.manifest)
    rows = next(split_tests(before)).rows
    # Unbalanced, or people's recordings would take it out by themselves.
    left = (rows["rig"] == USUAL) | (rows["recording"] != "rec0") | (rows["spectral_match"] > 0.5)
    rows = rows[left].assign(rating=rows["rating"] / 2)
    there = (rows["rig"] == ODD) & (rows["recording"] == "rec0")
    shifted = rows.assign(rating=rows["rating"] + 12.5 * there)
    slopes = [
        vary_primary(one, before.metrics).set_index(["variant", "metric"])["estimate"]
        for one in (rows, shifted)
    ]
    np.testing.assert_allclose(*(own["rig as a factor"] for own in slopes), rtol=1e-3)
