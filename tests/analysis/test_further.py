from __future__ import annotations

import hashlib
from itertools import chain
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
import pytest

from feel321.analysis.page import render_words
from feel321.analysis.report import correlations, primary
from feel321.analysis.report import write as report
from feel321.analysis.report.answer import find_row
from feel321.analysis.report.write import describe_inputs
from feel321.analysis.resampling import Choices
from feel321.analysis.table.metrics import describe_further
from feel321.analysis.table.reading import Further, read_table
from feel321.names import MATCHES

if TYPE_CHECKING:
    from collections.abc import Callable

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
    assert list(describe_further()) == list(chain(*every))
    meanings = list(describe_further().values())
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
    rows = correlations.compute_further(table, Choices(draws=200, seed=1)).rows[
        "further_associations"
    ]
    for method in ("Pearson", "Spearman", "Pearson within recordings"):
        found, other = (
            find_row(rows, "r", metric=name, method=method) for name in (MEAN, INVARIANT)
        )
        assert found["value"] > 0.9
        assert found["low"] > 0.5
        assert other["high"] < found["low"]
    (form,) = correlations.SECTIONS[1].tables
    assert form.caption.startswith("Exploratory")
    assert not correlations.SECTIONS[1].front


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


def test_a_declared_one_that_stimuli_lack_is_refused_with_the_reason(small: object) -> None:
    values = draw_column(small)
    short = Further(pd.DataFrame({MEAN: values.iloc[:-4]}), ("Without my321: a command.",))
    with pytest.raises(
        ValueError, match=r"got 'spectral_match_rotation_mean', which .* a command\.$"
    ):
        read_table(small.ratings, small.manifest, metrics=[MEAN], further=short)
    with pytest.raises(
        ValueError, match=r"got no column .* \(feel321 analyze computes it in a study"
    ):
        read_table(small.ratings, small.manifest, metrics=[MEAN])


def test_further_metrics_have_no_part_in_the_primary_analysis(small: object) -> None:
    values = draw_column(small)
    choices = Choices(draws=2)
    before = primary.compute(read_table(small.ratings, small.manifest), choices)
    add_to_manifest(small, **{MEAN: values, SD: values**2})
    after = primary.compute(read_table(small.ratings, small.manifest), choices)
    assert repr(after.rows) == repr(before.rows)
    assert render_words("primary", **after.facts) == render_words("primary", **before.facts)


def test_p1401_judges_them_too(small: object) -> None:
    add_to_manifest(small, **{MEAN: draw_column(small)})
    table = read_table(small.ratings, small.manifest)
    rows = correlations.compute_standard(table, Choices(draws=2)).rows
    planned = {"spectral_match", "temporal_match"}
    assert {row["metric"] for row in rows["p1401"]} == {*planned, MEAN}


def test_values_may_be_handed_over_and_are_told(small: object) -> None:
    values = draw_column(small)
    handed = Further(pd.DataFrame({MEAN: values}), ("They were drawn.",))
    table = read_table(small.ratings, small.manifest, further=handed)
    np.testing.assert_array_equal(table.rows[MEAN], values[table.rows["stimulus_id"]])
    assert "They were drawn." in table.notes
    inputs = describe_inputs({}, table=table, further=handed, choices=Choices())
    assert inputs["further_metrics"] == MEAN
    other = describe_inputs(
        {}, table=table, further=Further(handed.metrics + 1e-15), choices=Choices()
    )
    assert inputs["further_metrics_sha256"] != other["further_metrics_sha256"]


def test_inputs_hold_digests_of_whatever_decided(small: object) -> None:
    def describe(**how: object) -> dict[str, str]:
        table = read_table(small.ratings, small.manifest, **how)
        given = {role: getattr(small, role) for role in ("ratings", "manifest")}
        roster = {"participants": small.ratings.with_name("participants.csv")}
        return describe_inputs(given | roster, table=table, further=None, choices=Choices(seed=7))

    plain = describe()
    assert list(plain) == [
        "ratings",
        "ratings_sha256",
        "manifest",
        "manifest_sha256",
        "metrics",
        "draws",
        "margin",
        "seed",
    ]
    assert plain["ratings_sha256"] == hashlib.sha256(small.ratings.read_bytes()).hexdigest()
    roster = small.ratings.with_name("participants.csv")
    roster.write_text("participant,grip\np00,firm\n")
    sources = {f"rec{number}": f"of{number % 2}" for number in range(4)}
    more = describe(sources=sources)
    assert more["participants_sha256"] == hashlib.sha256(roster.read_bytes()).hexdigest()
    assert more["sources"] == "4 recordings of 2 sources"
    other = describe(sources=sources | {"rec3": "of0"})
    assert more["sources_sha256"] != other["sources_sha256"]
    assert {name: text for name, text in more.items() if name in plain} == plain


def test_the_report_holds_them(small: object, monkeypatch: pytest.MonkeyPatch) -> None:
    # All others are another test's, and slow.
    monkeypatch.setattr(report, "SECTIONS", correlations.SECTIONS[1:2])
    values = draw_column(small)
    folder = small.ratings.with_name("report")
    results = report.write_report(
        small.ratings,
        small.manifest,
        folder,
        draws=20,
        rng=1,
        further=Further(pd.DataFrame({MEAN: values})),
    )
    assert set(results.numbers["metric"].dropna()) == {MEAN}
    assert results.inputs["further_metrics"] == MEAN
    assert "tables/further_associations.csv" in results.files
    assert "Further metrics, explored" in (folder / "details.html").read_text(encoding="utf-8")
