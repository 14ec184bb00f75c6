"""Metrics of a lab's own: what they declare, where that comes from, and what is refused."""

import json
from collections.abc import Callable
from typing import Any

import pandas as pd
import pytest

from feel321.analysis.report import means, primary
from feel321.analysis.report.section import find_row
from feel321.analysis.resampling import Choices
from feel321.analysis.table.columns import find_steps, order_reducers
from feel321.analysis.table.items import Table
from feel321.analysis.table.reading import read_table
from feel321.analysis.words import declaring, render_words
from feel321.stimuli.reducers.registry import REDUCERS
from feel321.types import MATCHES, MetricInfo

DISTANCE = MetricInfo("roughness distance", higher="worse", low=0, high=60, unit="dB")


@pytest.fixture
def small(files: Callable[..., object]) -> object:
    """Files whose manifest has a metric of another kind."""
    study = files()
    manifest = pd.read_csv(study.manifest)
    manifest["roughness"] = (50 - 40 * manifest["temporal_match"]).round(3)
    manifest.to_csv(study.manifest, index=False)
    return study


def read(study: object, **more: object) -> Table:
    return read_table(study.ratings, study.manifest, metrics=["roughness"], **more)


def declare(study: object, **facts: object) -> None:
    text = json.dumps({"metrics": {"roughness": facts}})
    study.manifest.with_name("manifest.json").write_text(text, encoding="utf-8")


def test_the_study_comes_before_the_manifest_and_that_before_the_registry(small: object) -> None:
    declare(small, label="roughness", higher="worse", low=None, unit="dB", method="mylab:rough")
    assert read(small).info["roughness"] == MetricInfo("roughness", higher="worse", unit="dB")
    assert read(small, info={"roughness": DISTANCE}).info["roughness"] == DISTANCE
    assert read(small).info["temporal_match"].high == 1


def test_a_value_beyond_declared_bounds_is_refused_with_its_line(small: object) -> None:
    manifest = pd.read_csv(small.manifest)
    manifest.loc[3, "roughness"] = 61
    manifest.to_csv(small.manifest, index=False)
    assert read(small).metrics == ("roughness",)
    expected = (
        r"^manifest\.csv, line 5: roughness must be 0 to 60, got 61; correct it, or the bounds"
    )
    with pytest.raises(ValueError, match=expected):
        read(small, info={"roughness": DISTANCE})
    # Rounded in the file, and no more.
    manifest.loc[3, "roughness"] = 60 + 1e-8
    manifest.to_csv(small.manifest, index=False)
    assert read(small, info={"roughness": DISTANCE}).info["roughness"] == DISTANCE


@pytest.mark.parametrize(
    ("values", "info", "step"),
    [
        ([0, 10, 20, 30, 40], MetricInfo("a", unit="dB"), 10),
        ([0, 0.01, 0.02, 0.03, 0.04], MetricInfo("a"), 0.01),
        ([0, 0.01, 0.02, 0.03, 0.04], MetricInfo("a", high=1), 0.1),
        ([0, 2e5, 4e5, 6e5, 8e5], MetricInfo("a"), 1e5),
        ([3, 3, 3, 3, 3], MetricInfo("a"), 0.1),
    ],
)
def test_steps_fit_the_spread_of_a_metric(
    values: list[float], info: MetricInfo, step: float
) -> None:
    items = pd.DataFrame({"recording": "r", "a": values})
    assert find_steps(items, ["a"], {"a": info}) == {
        "a": (pytest.approx(step), f"+{step:g} {info.unit}".rstrip())
    }


def test_own_names_come_from_their_registries(small: object) -> None:
    assert order_reducers(["zeta", *sorted(REDUCERS)]) == [*REDUCERS, "zeta"]
    assert set(MATCHES) <= {*read(small).info, "spectral_match_bounded"}


# A distance, of which lower is better, is as good a metric as a match.


@pytest.fixture
def mirrored(files: Callable[..., object]) -> object:
    """Ratings that follow spectral match, and a distance in dB that says the same upside down."""
    study = files(scales=("realism",), participants=8, recordings=6, spectral=50.0, noise=4.0)
    manifest = pd.read_csv(study.manifest)
    manifest["distance"] = 40 - 30 * manifest["spectral_match"]
    manifest.to_csv(study.manifest, index=False)
    return study


LOWER = {"distance": MetricInfo("spectral distance", higher="worse", unit="dB")}


def tell(study: object, metrics: list[str], **more: object) -> tuple[Any, Any, str]:
    table = read_table(study.ratings, study.manifest, metrics=metrics, **more)
    choices = Choices(draws=50)
    with declaring(table.info):
        found = primary.compute(table, choices)
        lines = render_words("primary", **found.facts)
        return found, means.compute_correlations(table, choices), lines[1]


def test_lower_ratings_with_a_larger_distance_are_a_success(mirrored: object) -> None:
    section, _, told = tell(mirrored, ["distance", "temporal_match"], info=LOWER)
    start = "Realism: Spectral distance predicts realism ratings (higher spectral distance, lower ratings)"
    assert told.startswith(start)
    assert "each +10 dB with a change of −" in told
    claim = section.verdicts[0]
    told = [claim[key] for key in ("verdict", "direction", "higher", "better_than")]
    assert told == ["predicts", "lower", "worse", ["temporal_match"]]
    undeclared, _, told = tell(mirrored, ["distance", "temporal_match"])
    assert "in the opposite direction (higher distance, lower ratings)" in told
    assert undeclared.verdicts[0]["better_than"] == []


def test_a_distance_and_its_match_are_told_alike(mirrored: object) -> None:
    down, down_pooled, _ = tell(mirrored, ["distance", "temporal_match"], info=LOWER)
    up, up_pooled, _ = tell(mirrored, ["spectral_match", "temporal_match"])
    for table, quantity, both in (
        ("slope_differences", "difference_standardised", (down, up)),
        ("differences", "difference", (down_pooled, up_pooled)),
    ):
        one, other = (find_row(found.rows[table], quantity) for found in both)
        ends = [[row[end] for end in ("value", "low", "high")] for row in (one, other)]
        assert ends[0] == pytest.approx(ends[1], rel=1e-4)
    slope, match = (find_row(found.rows["slopes"], "slope") for found in (down, up))
    # Per +10 dB, which is a third of the match downwards.
    assert slope["value"] == pytest.approx(-match["value"] / 0.1 / 3, rel=1e-4)
    assert find_row(down.rows["slopes"], "step")["note"] == "+10 dB"
