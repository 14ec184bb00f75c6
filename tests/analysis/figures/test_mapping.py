from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
import pytest

from feel321.analysis.association.correlate import Association, correlate
from feel321.analysis.contrasts.compare import stimulus_means
from feel321.analysis.figures.scatter import draw_mapping
from feel321.analysis.figures.style import assign_looks
from feel321.analysis.standard import P1401, p1401

if TYPE_CHECKING:
    from collections.abc import Callable

    from matplotlib.figure import Figure

METRIC = "spectral_match"
Parts = tuple[pd.DataFrame, P1401, Association]


@pytest.fixture
def parts(tidy: Callable[..., pd.DataFrame]) -> Parts:
    rows = tidy(recordings=5)
    rows = rows[rows["role"] == "test"]
    stimuli = stimulus_means(rows).join(
        rows.groupby("stimulus_id")[METRIC].first(), on="stimulus_id"
    )
    votes = rows.pivot_table("rating", "stimulus_id", "participant").loc[stimuli["stimulus_id"]]
    association = correlate(rows, METRIC, draws=20, rng=np.random.default_rng(0))
    return stimuli, p1401(votes, stimuli[METRIC]), association


def draw(parts: Parts, *, scale: str = "realism") -> Figure:
    return draw_mapping(
        *parts, scale=scale, looks=assign_looks(sorted(parts[0]["reducer"].unique()))
    )


def test_every_recording_has_its_stimuli_and_the_mapping(
    parts: Parts, said: Callable[[Figure], str]
) -> None:
    stimuli, judged, association = parts
    figure = draw(parts)
    *panels, strip = figure.axes
    assert [axes.get_title(loc="left") for axes in panels] == sorted(stimuli["recording"].unique())
    for axes, (_, part) in zip(panels, stimuli.groupby("recording"), strict=True):
        curve, *points = axes.lines
        x, y = curve.get_xydata().T
        np.testing.assert_allclose(y, np.polynomial.Polynomial(judged.coefficients)(x))
        drawn = sorted(tuple(point) for line in points for point in line.get_xydata())
        assert drawn == sorted(zip(part[METRIC], part["mean"], strict=True))
        low, high = axes.get_ylim()
        assert low < part["low"].min() < part["high"].max() < high
    assert strip.lines[1].get_xdata()[0] == association.value
    assert list(strip.lines[0].get_xdata()) == [association.low, association.high]
    assert strip.lines[2].get_xdata()[0] == association.ceiling
    for part in (
        "two-way interval",
        "noise ceiling 0.",
        "monotone cubic",
        "n = 45 stimuli of 5 recordings",
        "95 % t",
    ):
        assert part in said(figure)


def test_far_outliers_stand_hollow_at_the_edge(parts: Parts, said: Callable[[Figure], str]) -> None:
    stimuli, judged, association = parts
    stimuli = stimuli.assign(**{METRIC: stimuli[METRIC].where(stimuli.index != 3, -7.0)})
    figure = draw((stimuli, judged, association))
    assert "below −1, drawn there (1 of 45), the curve fitted where they are" in said(figure)
    hollow = [
        line for axes in figure.axes for line in axes.lines if line.get_markerfacecolor() == "white"
    ]
    assert [list(line.get_xdata()) for line in hollow if len(line.get_xdata())] == [[-1]]


def test_a_falling_metric_has_its_ceiling_below(parts: Parts) -> None:
    stimuli, judged, association = parts
    falling = replace(association, value=-0.6, low=-0.8, high=-0.3)
    strip = draw((stimuli, judged, falling)).axes[-1]
    assert -association.ceiling in [line.get_xdata()[0] for line in strip.lines]
    assert strip.get_xlim()[0] < -association.ceiling


def test_what_is_not_defined_is_a_dash(parts: Parts, said: Callable[[Figure], str]) -> None:
    stimuli, judged, association = parts
    bare = replace(association, low=np.nan, high=np.nan, ceiling=np.nan)
    assert "interval –, noise ceiling –." in said(draw((stimuli, judged, bare)))


@pytest.mark.parametrize("recordings", [1, 2, 7, 12])
def test_long_names_stay_inside_and_apart(
    parts: Parts, names: list[str], recordings: int, faults: Callable[[Figure], list[str]]
) -> None:
    first = parts[0][parts[0]["recording"] == "rec0"]
    reducers = dict(zip(first["reducer"], names, strict=False))
    copies = [first.assign(recording=f"{names[0]}{number}") for number in range(recordings)]
    stimuli = pd.concat(copies, ignore_index=True).assign(
        reducer=lambda rows: rows["reducer"].map(reducers)
    )
    assert faults(draw((stimuli, parts[1], parts[2]), scale=names[1])) == []
