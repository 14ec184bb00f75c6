from __future__ import annotations

import re
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
import pytest

from feel321.analysis.figures.estimates import draw_slopes
from feel321.analysis.primary.model import Primary, fit_primary
from feel321.analysis.report.primary import describe_claims
from feel321.analysis.words import Claim

if TYPE_CHECKING:
    from collections.abc import Callable

    from matplotlib.figure import Figure

METRICS = ["spectral_match", "temporal_match"]


@pytest.fixture(scope="module")
def model() -> Primary:
    rng = np.random.default_rng(0)
    people, scenes, reducers = np.indices((6, 4, 5)).reshape(3, -1)
    match = rng.uniform(size=(2, 4, 5))
    spectral, temporal = match[:, scenes, reducers]
    rows = pd.DataFrame({
        "participant": people, "recording": scenes, "item": scenes * 5 + reducers, "spectral_match": spectral,
        "temporal_match": temporal, "rating": 40 + 30 * spectral + 3 * people + rng.normal(0, 8, len(people)),
    })  # fmt: skip
    return fit_primary(rows, METRICS)


def make_variants(names: list[str], metrics: list[str]) -> pd.DataFrame:
    variants = [
        "primary",
        "correlated slopes",
        "without reducers",
        *(f"without recording {name}" for name in names[:10]),
        *(f"without reducer {name}" for name in names),
        "rater-standardised",
        "logits",
    ]
    table = pd.DataFrame(
        [(variant, metric) for variant in variants for metric in metrics],
        columns=["variant", "metric"],
    )
    value = np.linspace(0.1, 0.6, len(table))
    table = table.assign(
        standardised=value,
        standardised_low=value - 0.2,
        standardised_high=value + 0.2,
        singular=False,
    )
    table.loc[3, "singular"] = True
    table.loc[5, ["standardised", "standardised_low", "standardised_high"]] = np.nan
    return table


def test_slopes_stand_where_the_numbers_say(model: Primary, said: Callable[[Figure], str]) -> None:
    figure = draw_slopes({"realism": model, "similarity": model})
    (axes,) = figure.axes
    points = [line.get_xdata()[0] for line in axes.lines if line.get_marker() in {"o", "s"}]
    assert points == [*model.slopes["tenth"]] * 2
    bars = [tuple(line.get_xdata()) for line in axes.lines[1:] if len(line.get_xdata()) == 2]
    expected = [*zip(model.slopes["tenth_low"], model.slopes["tenth_high"], strict=True)] * 2
    np.testing.assert_array_equal(bars, expected)
    assert np.isfinite(bars).any()
    labels = [label.get_text() for label in axes.get_yticklabels()]
    assert labels == [
        "realism",
        "spectral match",
        "temporal match",
        "similarity",
        "spectral match",
        "temporal match",
    ]
    words = said(figure)
    for part in (
        "95 % Satterthwaite",
        "n = 6 participants, 4 recordings, 20 stimuli",
        "Points of rating per +0.1",
    ):
        assert part in words


def test_a_singular_fit_is_hollow_and_said(model: Primary, said: Callable[[Figure], str]) -> None:
    singular = replace(model, fit=replace(model.fit, singular=True))
    regular = replace(model, fit=replace(model.fit, singular=False))
    figure = draw_slopes({"realism": singular, "similarity": regular})
    faces = [
        line.get_markerfacecolor() for line in figure.axes[0].lines if line.get_marker() == "o"
    ]
    assert faces == ["white", "#000000"]
    assert "Hollow: singular fit" in said(figure)
    assert "Hollow" not in said(draw_slopes({"similarity": regular}))


def test_a_slope_that_is_not_estimable_is_a_point_without_a_bar(model: Primary) -> None:
    slopes = model.slopes.assign(tenth_low=np.nan, tenth_high=np.nan)
    axes = draw_slopes({"realism": replace(model, slopes=slopes), "similarity": model}).axes[0]
    points = [line.get_xdata()[0] for line in axes.lines if line.get_marker() in {"o", "s"}]
    assert points == [*model.slopes["tenth"]] * 2
    bars = [tuple(line.get_xdata()) for line in axes.lines[1:] if len(line.get_xdata()) == 2]
    expected = zip(model.slopes["tenth_low"], model.slopes["tenth_high"], strict=True)
    assert [bar for bar in bars if np.isfinite(bar).all()] == [
        bar for bar in expected if np.isfinite(bar).all()
    ]


def test_variants_stand_below_under_their_headings(
    model: Primary, said: Callable[[Figure], str]
) -> None:
    table = make_variants(["one", "two"], METRICS)
    figure = draw_slopes({"realism": model}, variants=table)
    axes = figure.axes[1]
    labels = [label.get_text() for label in axes.get_yticklabels()]
    assert labels[:3] == ["primary", "correlated slopes", "without reducers"]
    assert labels[3:9] == ["without recording", "one", "two", "without reducer", "one", "two"]
    assert labels[9:] == ["ratings rescaled", "rater-standardised", "logits"]
    points = [line.get_xdata()[0] for line in axes.lines if line.get_marker() in {"o", "s"}]
    np.testing.assert_array_equal(points, table["standardised"].dropna())
    assert "SD of ratings per SD of metric" in said(figure)
    assert "no estimate" in said(figure)


def test_long_names_stay_inside_and_apart(
    model: Primary, names: list[str], faults: Callable[[Figure], list[str]]
) -> None:
    metrics = names[:2]
    renamed = replace(model, slopes=model.slopes.set_axis(pd.Index(metrics, name="metric")))
    attributes = [name[::-1] for name in names[:3]]
    variants = make_variants(names, metrics)
    assert faults(draw_slopes(dict.fromkeys(attributes, renamed), variants=variants)) == []


def test_nothing_to_draw_is_refused() -> None:
    with pytest.raises(ValueError, match="models must hold one or more"):
        draw_slopes({})


def test_the_title_is_what_the_verdicts_say(model: Primary, said: Callable[[Figure], str]) -> None:
    def claim(scale: str, metric: str, verdict: str, way: str = "") -> Claim:
        return Claim(scale, "as_is", metric, verdict, way, "")

    one = [claim("realism", "spectral_match", "predicts", "lower"), claim("realism", "x", "open")]
    assert (
        describe_claims(one)
        == "Spectral match: predicts lower ratings on the scale; x: open on the scale"
    )
    more = [claim("mushra", "spectral_match", "not_estimable"), claim("mushra", "x", "open")]
    title = describe_claims(one + more)
    assert (
        title
        == "Spectral match: predicts lower ratings on 1 of 2 scales, not estimable on 1; x: open on both scales"
    )
    levels = [replace(claim, scale="realism", level=claim.scale) for claim in one + more]
    assert "x: open on both levels" in describe_claims(levels)
    # The model's own intervals are not adjusted, and claim nothing.
    figure = draw_slopes({"realism": model}, title=title)
    assert " ".join(figure.get_suptitle().split()).startswith(title)
    assert not re.search("rise|fall|relation", said(draw_slopes({"realism": model})))
