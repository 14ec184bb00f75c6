"""Figures: what they show is where it belongs, nothing runs off, and the same data give the same bytes."""

from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from feel321.analysis import figures
from feel321.analysis.contrasts.compare import participant_means, profile_reducers
from feel321.analysis.primary.model import fit_primary
from feel321.analysis.space import fit_space
from feel321.analysis.table.columns import order_reducers

METRICS = ["spectral_match", "temporal_match"]
LONG = "a_reducer_of_our_own_with_a_very_long_name_indeed_2026"


def draw(rows: list[tuple[object, ...]], **options: str) -> Axes:
    axes = Figure().subplots()
    frame = pd.DataFrame(rows, columns=["name", "value", "low", "high", "of"])
    figures.plot_forest(axes, frame, **options)
    return axes


def test_estimates_lie_at_their_values_and_below_each_other() -> None:
    two = [("a", 1.0, 0.5, 1.5, "x"), ("a", 2.0, 1.0, 3.0, "x")]
    axes = draw([*two, ("c", -1.0, np.nan, np.nan, "b")], heading="of")
    points = [line for line in axes.lines if line.get_marker() == "o"]
    assert [line.get_xdata().tolist() for line in points] == [[1.0], [2.0], [-1.0]]
    heights = [float(line.get_ydata()[0]) for line in points]
    assert heights == sorted(heights)
    labels = axes.get_yticklabels()
    assert [label.get_text() for label in labels] == ["x", "a", "b", "c"]
    assert [label.get_fontweight() for label in labels] == ["bold", "normal"] * 2


def test_an_endless_interval_gets_an_arrow_and_squeezes_nothing() -> None:
    usual = [(str(n), n / 10, n / 10 - 0.1, n / 10 + 0.1, "") for n in range(5)]
    axes = draw([*usual, ("odd", 0.2, -1e6, 1e6, ""), ("none", np.nan, np.nan, np.nan, "")])
    low, high = axes.get_xlim()
    assert high - low < 20
    assert {line.get_marker() for line in axes.lines} >= {"<", ">"}
    assert "no estimate" in [text.get_text() for text in axes.texts]


def test_a_frame_of_estimates_has_a_mark_each_and_hollow_ones_where_it_says_so() -> None:
    frame = pd.DataFrame({
        "name": ["a", "a", "b"], "of": ["x", "y", "x"], "value": [0.1, 0.2, 9.0], "low": 0.0, "high": 10.0,
        "filled": [True, False, True],
    })  # fmt: skip
    figure = figures.draw_estimates(frame, "Points", series="of", band=(-5.0, 5.0))
    (axes,) = figure.axes
    marks = [line for line in axes.lines if line.get_marker() in set("os")]
    assert [line.get_markerfacecolor() == "white" for line in marks] == [False, True, False]
    assert [text.get_text() for text in axes.get_yticklabels()] == ["a", "b"]
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["x", "y"]
    assert len(axes.patches) == 1


def test_names_of_two_lines_keep_apart() -> None:
    names = [f"{LONG} {number}" for number in range(5)]
    figure = figures.draw_estimates(
        pd.DataFrame({"name": names, "value": 0.5, "low": 0.1, "high": 0.9}), "d′"
    )
    figure.draw_without_rendering()
    (axes,) = figure.axes
    boxes = [label.get_window_extent() for label in axes.get_yticklabels()]
    assert all("\n" in label.get_text() for label in axes.get_yticklabels())
    assert all(upper.y0 > lower.y1 for upper, lower in pairwise(boxes))


def test_values_of_eq_1_below_the_edge_are_hollow_at_the_edge() -> None:
    stimuli = pd.DataFrame({
        "reducer": ["mag321", "dft321", "dft321"], "spectral_match": [-40.0, 0.5, 0.9],
        "mean": [20.0, 60.0, 80.0], "low": [10.0, 50.0, 70.0], "high": [30.0, 70.0, 90.0],
    })  # fmt: skip
    assert figures.find_cut("spectral_match_bounded") == -np.inf
    looks = figures.assign_looks(["mag321", "dft321"])
    shown = figures.plot_stimuli(Figure().subplots(), stimuli, "spectral_match", looks=looks)
    assert shown["mag321"].get_xdata().tolist() == [figures.CUT]
    assert shown["mag321"].get_markerfacecolor() == "white"
    assert shown["dft321"].get_xdata().tolist() == [0.5, 0.9]


def test_a_profile_has_the_best_on_top_and_anchors_below(tidy: Callable[..., pd.DataFrame]) -> None:
    rows = tidy(spectral=60.0, noise=2.0)
    profile = profile_reducers(rows)
    axes = Figure().subplots()
    looks = figures.assign_looks(order_reducers(profile["reducer"]))
    figures.plot_profile(axes, profile, participant_means(rows), looks=looks)
    labels = [label.get_text().replace("\n", "") for label in axes.get_yticklabels()]
    tests = profile[profile["role"] == "test"].sort_values("mean", ascending=False)
    assert labels[: len(tests)] == list(tests["reducer"])
    assert all("(" in label for label in labels[len(tests) :])


def test_a_map_has_an_ellipse_for_each_stimulus() -> None:
    rng = np.random.default_rng(0)
    half = np.triu(rng.uniform(0.1, 1, (6, 4, 4)), 1)
    space = fit_space(half + half.transpose(0, 2, 1), draws=5, rng=rng)
    (axes,) = figures.draw_space(space, ["a", "b", "c", "original"]).axes
    assert len(axes.patches) == 4


def test_figures_are_saved_alike_and_are_as_wide_as_a_page(
    tidy: Callable[..., pd.DataFrame], tmp_path: Path
) -> None:
    rows = tidy(participants=4, recordings=4, anchors=False)
    models = {"realism": fit_primary(rows, METRICS, explain=False)}
    odd = pd.DataFrame({"name": [LONG, "sure"], "value": [0.5, np.nan], "low": 0.1, "high": 0.9})
    drawings = {
        "residuals": lambda: figures.draw_residuals(models),
        "abx": lambda: figures.draw_estimates(odd, "d′"),
    }
    for name, drawing in drawings.items():
        for number in "12":
            figure = drawing()
            figures.save_figure(figure, tmp_path / f"{name}{number}")
            width = figure.get_size_inches()[0] * figures.CM_PER_INCH
            assert width == pytest.approx(figures.WIDTH_CM)
        for suffix in ("svg", "png"):
            one, other = (tmp_path / f"{name}{number}.{suffix}" for number in "12")
            assert one.read_bytes() == other.read_bytes()
