from collections.abc import Callable
from itertools import chain

import numpy as np
import pandas as pd
import pytest

from feel321.analysis.report import means, primary
from feel321.analysis.report.section import find_row
from feel321.analysis.resampling import Choices
from feel321.analysis.table.columns import FURTHER
from feel321.analysis.table.reading import Further, read_table
from feel321.analysis.words import render_words
from feel321.types import MATCHES

MEAN, SD = "spectral_match_rotation_mean", "temporal_match_rotation_sd"
DELIVERED, INVARIANT = ("temporal_match_delivered", "temporal_match_invariant")


def draw_column(study: object, seed: int = 4) -> pd.Series:
    """Draw values of a metric that no other metric has anything to do with."""
    ids = pd.read_csv(study.manifest)["stimulus_id"]
    return pd.Series(
        np.random.default_rng(seed).uniform(0, 1, len(ids)), index=pd.Index(ids, name="stimulus_id")
    )


def add_to_manifest(study: object, **columns: object) -> None:
    manifest = pd.read_csv(study.manifest)
    for name, values in columns.items():
        manifest[name] = (
            manifest["stimulus_id"].map(values) if isinstance(values, pd.Series) else values
        )
    manifest.to_csv(study.manifest, index=False)


def plant(study: object, values: pd.Series, *, points: float) -> None:
    """Let every rating follow a metric, and nothing else but noise."""
    ratings = pd.read_csv(study.ratings)
    noise = np.random.default_rng(8).normal(0, 6, len(ratings))
    felt = 20 + points * ratings["stimulus_id"].map(values) + noise
    ratings.assign(rating=felt.clip(0, 100).round(1)).to_csv(study.ratings, index=False)


@pytest.fixture
def small(files: Callable[..., object]) -> object:
    """Four people, four recordings, one scale."""
    return files(participants=4, scales=("realism",), anchors=False)


def test_every_metric_may_be_told_in_four_more_ways() -> None:
    kinds = "rotation_mean", "rotation_sd", "delivered"
    own = {
        "spectral_match": ["spectral_match_energy_weighted"],
        "temporal_match": ["temporal_match_invariant"],
        "spectral_match_bounded": [],  # bounded, and no orientation changes it
    }
    every = [[*(f"{metric}_{kind}" for kind in kinds), *own[metric]] for metric in MATCHES]
    assert list(FURTHER) == list(chain(*every))
    meanings = list(FURTHER.values())
    assert len(set(meanings)) == len(meanings)


def test_a_planted_effect_of_a_rotation_mean_is_found(small: object) -> None:
    values = draw_column(small)
    add_to_manifest(small, **{MEAN: values, INVARIANT: draw_column(small, seed=5)})
    plant(small, values, points=60)
    table = read_table(small.ratings, small.manifest)
    assert (table.metrics, table.further) == (
        ("spectral_match", "temporal_match"),
        (MEAN, INVARIANT),
    )
    section = means.compute_correlations(table, Choices(draws=200, seed=1))
    rows = section.rows["further_associations"]
    for method in ("Pearson", "Spearman", "Pearson within recordings"):
        found, other = (
            find_row(rows, "r", metric=name, method=method) for name in (MEAN, INVARIANT)
        )
        assert found["value"] > 0.9
        assert found["low"] > 0.5
        assert other["high"] < found["low"]


def test_declared_ones_are_in_the_model_and_each_points_its_way(small: object) -> None:
    means, spreads = draw_column(small), draw_column(small, seed=6) / 4
    plant(small, means * 40 - spreads * 80, points=1)
    further = Further(pd.DataFrame({MEAN: means, SD: spreads}))
    table = read_table(small.ratings, small.manifest, metrics=[MEAN, SD], further=further)
    assert table.metrics == (MEAN, SD)
    assert {MEAN, SD}.isdisjoint(table.further)
    assert [table.info[name].higher for name in table.metrics] == ["better", "worse"]
    section = primary.compute(table, Choices(draws=2))
    for name, planted in ((MEAN, 40), (SD, -80)):
        row, step = (
            find_row(section.rows["slopes"], one, metric=name) for one in ("slope", "step")
        )
        assert row["low"] < planted * step["value"] < row["high"]
    claims = {claim["metric"]: claim for claim in section.verdicts}
    told = [claims[SD][key] for key in ("verdict", "direction", "higher", "opposite")]
    assert told == ["predicts", "lower", "worse", False]


def test_further_metrics_have_no_part_in_the_primary_analysis(small: object) -> None:
    values = draw_column(small)
    choices = Choices(draws=2)
    before = primary.compute(read_table(small.ratings, small.manifest), choices)
    add_to_manifest(small, **{MEAN: values, SD: values**2})
    after = primary.compute(read_table(small.ratings, small.manifest), choices)
    assert repr(after.rows) == repr(before.rows)
    assert render_words("primary", **after.facts) == render_words("primary", **before.facts)
