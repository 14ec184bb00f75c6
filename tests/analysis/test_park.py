"""Metrics over orientations of the sensor: why a spread may go with ratings the wrong way, and the measures of Park."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
import pytest

from feel321.analysis.replication.park import compare_spread, explain_spread
from feel321.analysis.report import primary
from feel321.analysis.report.parts import Choices
from feel321.analysis.table.metrics import ROTATIONS
from feel321.analysis.table.reading import Further, read_table

if TYPE_CHECKING:
    from feel321.analysis.table.items import Table

MEAN, SD = "temporal_match_rotation_mean", "temporal_match_rotation_sd"
REDUCERS = ("say321", "saz321", "soc321", "mag321", "pca321", "dft321")
MEANS = dict(zip(REDUCERS, (0.50, 0.48, 0.60, 0.02, 0.70, 0.66), strict=True))
SPREADS = dict(zip(REDUCERS, (0.20, 0.30, 0.18, 0.01, 0.25, 0.08), strict=True))
SLOPES = {MEAN: 50.0, SD: -40.0}


def make_table(*, bonus: float = 0.0, spreads: dict[str, float] = SPREADS, seed: int = 1) -> Table:
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
    statistics = manifest.set_index("stimulus_id")[[MEAN, SD]]
    further = Further(statistics, ("Rotation statistics.",))
    return read_table(
        pd.DataFrame(rows), manifest.drop(columns=[MEAN, SD]), metrics=[MEAN, SD], further=further
    )


def test_a_mean_points_up_and_a_spread_down() -> None:
    assert {one.rpartition("_")[2]: info.higher for one, info in ROTATIONS.items()} == {
        "mean": "better",
        "sd": "worse",
    }
    assert len({info.label for info in ROTATIONS.values()}) == len(ROTATIONS)


def test_spread_and_mean_are_compared_within_recordings() -> None:
    rows = make_table().rows
    found = compare_spread(rows, SD)
    items = rows.drop_duplicates("stimulus_id")
    own = items[[MEAN, SD]] - items.groupby("recording")[[MEAN, SD]].transform("mean")
    assert found.r == pytest.approx(own.corr().iloc[0, 1], abs=1e-12)
    assert (found.reducer, found.rank) == ("mag321", 0)
    assert found.mean == pytest.approx(0.02)
    assert compare_spread(rows, MEAN) is None
    assert compare_spread(rows.drop(columns=MEAN), SD) is None
    assert compare_spread(rows.assign(**{SD: 0.1}), SD) is None


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
    for row in section.tables["slopes"].to_dict("records"):
        assert row["low"] < SLOPES[row["metric"]] < row["high"]
    (line,) = [line for line in section.verdict if line.lead == "spread over orientations"]
    assert "no merit by itself" in line.text
    assert "opposite direction" not in " ".join(section.answers)
