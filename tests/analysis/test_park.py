"""Metrics over orientations of the sensor: why a spread may go with ratings the wrong way, and the measures of Park."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from feel321.analysis.page import render_words
from feel321.analysis.primary.model import fit_slopes
from feel321.analysis.primary.plan import REDUCER, make_cells
from feel321.analysis.primary.sensitivity import measure_excess
from feel321.analysis.replication import (
    Paper,
    PaperAnswer,
    PaperClaim,
    answer_claims,
    explain_spread,
)
from feel321.analysis.report import answer as opening
from feel321.analysis.report import primary
from feel321.analysis.resampling import Choices
from feel321.analysis.table.reading import Further, read_table

if TYPE_CHECKING:
    from feel321.analysis.report.section import Found
    from feel321.analysis.table.items import Table

MEAN, SD = "temporal_match_rotation_mean", "temporal_match_rotation_sd"
REDUCERS = ("say321", "saz321", "soc321", "mag321", "pca321", "dft321")
MEANS = dict(zip(REDUCERS, (0.50, 0.48, 0.60, 0.02, 0.70, 0.66), strict=True))
SPREADS = dict(zip(REDUCERS, (0.20, 0.30, 0.18, 0.01, 0.25, 0.08), strict=True))
SLOPES = {MEAN: 50.0, SD: -40.0}


def make_table(
    *,
    bonus: float = 0.0,
    spreads: dict[str, float] = SPREADS,
    seed: int = 1,
    gain: float | None = None,
) -> Table:
    """Ratings of twelve people who follow mean and spread, and mag321 a bonus besides."""
    rng = np.random.default_rng(seed)
    scenes = [f"s{number}" for number in range(8)]
    manifest = pd.DataFrame(
        [
            {"stimulus_id": f"{scene}-{reducer}", "recording": scene, "reducer": reducer, "temporal_match": 0.5,
             MEAN: MEANS[reducer] + rng.normal(0, 0.05) * (reducer != "mag321"),
             SD: spreads[reducer] * rng.uniform(0.7, 1.3)}
            for scene in scenes for reducer in REDUCERS
        ]
    )  # fmt: skip
    felt = 20 + manifest[MEAN] * SLOPES[MEAN] + manifest[SD] * SLOPES[SD]
    felt += bonus * (manifest["reducer"] == "mag321") + rng.normal(0, 2, len(felt))
    rows = [
        {"participant": f"p{who}", "stimulus_id": name, "scale": "similarity", "trial": trial,
         "rating": float(np.clip(level + mean + rng.normal(0, 6), 0, 100))}
        for who in range(12)
        for level in [rng.normal(0, 5)]
        for trial, (name, mean) in enumerate(zip(manifest["stimulus_id"], felt, strict=True))
    ]  # fmt: skip
    ratings = pd.DataFrame(rows)
    if gain is not None:
        manifest["gain"], ratings["reference_id"] = gain, "surface"
    statistics = manifest.set_index("stimulus_id")[[MEAN, SD]]
    further = Further(statistics, ("Rotation statistics.",))
    return read_table(
        ratings, manifest.drop(columns=[MEAN, SD]), metrics=[MEAN, SD], further=further
    )


def test_a_spread_that_rises_with_its_mean_is_explained() -> None:
    told = explain_spread(make_table().rows, SD)
    assert "nothing to lose when the sensor turns, and mag321 has the lowest mean (0.02)" in told
    assert "and the smallest spread (0.01)" in told
    steady = make_table(spreads=dict.fromkeys(REDUCERS, 0.2) | {"mag321": 0.05, "soc321": 0.01})
    assert "reducers that match better vary more (mag321: " in explain_spread(steady.rows, SD)
    falling = make_table(spreads={name: 0.8 - mean for name, mean in MEANS.items()})
    assert explain_spread(falling.rows, SD) == ""


def test_the_report_holds_the_plants_and_explains_the_spread() -> None:
    section = primary.compute(make_table(), Choices(draws=2))
    for row in section.rows["slopes"]:
        if row["quantity"] == "slope":
            assert row["low"] < SLOPES[row["metric"]] / 10 < row["high"]
    said = render_words("primary", **section.facts)
    (line,) = [line for line in said if "spread over orientations" in line]
    assert "no merit by itself" in line
    assert "opposite direction" not in " ".join(said)


def say(found: Found) -> tuple[str, ...]:
    return render_words("paper", **found.facts)


# The measures of the paper's claims.

CLAIMS = (
    PaperClaim("mean", "the mean is felt", "abstract", "correlation", exceptions=("mag321",),
               options={"metric": MEAN, "method": "within"}),
    PaperClaim("spread", "the spread is felt", "abstract", "correlation", "negative", exceptions=("mag321",),
               options={"metric": SD, "method": "within"}),
    PaperClaim("excess", "vector magnitude feels good", "abstract", "rating_excess", options={"reducer": "mag321"}),
)  # fmt: skip


def answer(table: Table) -> dict[str, PaperAnswer]:
    paper = Paper("Park & Kuchenbecker 2019", "10.1109/WHC.2019.8816148", "abstract", CLAIMS)
    return {one.claim.name: one for one in answer_claims(table, paper, Choices(draws=200, seed=1))}


def test_claims_are_answered_with_and_without_the_exception() -> None:
    found = answer(make_table(bonus=45))
    mean, spread, excess = (found[name] for name in ("mean", "spread", "excess"))
    assert mean.found.value < 0 < mean.without.low
    assert "without mag321 0." in mean.sentence
    assert spread.without.high < 0
    assert excess.verdict == "agrees"
    assert excess.found.low < 45 < excess.found.high
    assert excess.without is None


def test_no_excess_is_found_where_none_was_planted() -> None:
    for seed in range(6):
        table = make_table(seed=seed)
        cells = make_cells(table.rows, table.metrics)
        others = fit_slopes(cells.leave_out(REDUCER, "mag321"))
        excess, se, _ = measure_excess(cells, "mag321", others)
        assert abs(excess) < 2 * se
        items = table.rows.drop_duplicates("stimulus_id")
        means = items.groupby("reducer", observed=True)[[MEAN, SD]].mean()
        gap = means.loc["mag321"] - means.drop("mag321").mean()
        alone = others.solved.estimate({f"{name}_w": gap[name] for name in (MEAN, SD)})
        assert se > alone.se
    section = primary.compute(table, Choices(draws=2))
    assert not any(row["note"] == "yes" for row in section.rows["exceptions"])


def test_the_first_sentence_names_a_planted_surprise() -> None:
    table, choices = make_table(bonus=45), Choices(draws=50)
    paper = Paper("Park & Kuchenbecker 2019", "10.1109/WHC.2019.8816148", "abstract", CLAIMS)
    found = {"primary": primary.compute(table, choices)}
    first = say(opening.compute_paper(table, choices, paper=paper, others=found))[1]
    assert "mag321 was rated 4" in first.lower()
    assert "points higher than the metrics predict from the other reducers" in first
    assert "the paper names it as an exception too" in first
