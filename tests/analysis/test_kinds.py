"""Figures: what they show is where it belongs, nothing runs off, and the same data give the same bytes."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
import pytest
from matplotlib.figure import Figure

from feel321.analysis.contrasts.compare import equivalence, participant_means, profile_reducers
from feel321.analysis.contrasts.told_apart import discriminate
from feel321.analysis.figures import kinds, style
from feel321.analysis.figures.kinds import ForestRow, Mark
from feel321.analysis.primary.model import fit_primary
from feel321.analysis.space import bootstrap_space
from feel321.analysis.table.metrics import order_reducers

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from matplotlib.axes import Axes

METRICS = ["spectral_match", "temporal_match"]
LONG = "a_reducer_of_our_own_with_a_very_long_name_indeed_2026"


def draw(rows: list[ForestRow]) -> Axes:
    axes = Figure().subplots()
    kinds.plot_forest(axes, rows)
    return axes


def test_estimates_lie_at_their_values_and_below_each_other() -> None:
    two = ForestRow("a", (Mark(1.0, 0.5, 1.5), Mark(2.0, 1.0, 3.0)))
    axes = draw([two, ForestRow("b"), ForestRow("c", (Mark(-1.0),))])
    points = [line for line in axes.lines if line.get_marker() == "o"]
    assert [line.get_xdata().tolist() for line in points] == [[1.0], [2.0], [-1.0]]
    heights = [float(line.get_ydata()[0]) for line in points]
    assert heights == sorted(heights)
    labels = axes.get_yticklabels()
    assert [label.get_text() for label in labels] == ["a", "b", "c"]
    assert [label.get_fontweight() for label in labels] == ["normal", "bold", "normal"]


def test_an_endless_interval_gets_an_arrow_and_squeezes_nothing() -> None:
    usual = [ForestRow(str(n), (Mark(n / 10, n / 10 - 0.1, n / 10 + 0.1),)) for n in range(5)]
    odd = [ForestRow("odd", (Mark(0.2, -1e6, 1e6),)), ForestRow("none", (Mark(np.nan),))]
    axes = draw([*usual, *odd])
    low, high = axes.get_xlim()
    assert high - low < 20
    assert {line.get_marker() for line in axes.lines} >= {"<", ">"}
    assert "no estimate" in [text.get_text() for text in axes.texts]


@pytest.mark.parametrize("lines", [1, 2, 3])
def test_a_text_has_so_many_lines_of_so_many_letters(lines: int) -> None:
    fitted = style.fit_text(LONG, 2.0, lines=lines).splitlines()
    assert len(fitted) <= lines
    assert max(map(len, fitted)) <= 2.0 * style.LETTERS_PER_CM + 1
    assert style.fit_text("short", 2.0) == "short"


def test_equivalence_is_filled_and_all_have_one_margin() -> None:
    near, far = (equivalence(value, se, 20, low=-5, high=5) for value, se in ((0.1, 0.5), (4.9, 2)))
    (axes,) = kinds.draw_equivalence({"a − b": near, "a − c": far}).axes
    faces = [line.get_markerfacecolor() for line in axes.lines if line.get_marker() == "o"]
    assert faces == [style.BLACK, "white"]
    other = equivalence(0.1, 0.5, 20, low=-3, high=3)
    with pytest.raises(ValueError, match="one margin for all"):
        kinds.draw_equivalence({"a − b": near, "b − c": other})


def test_values_of_eq_1_below_the_edge_are_hollow_at_the_edge() -> None:
    stimuli = pd.DataFrame({
        "reducer": ["mag321", "dft321", "dft321"], "spectral_match": [-40.0, 0.5, 0.9],
        "mean": [20.0, 60.0, 80.0], "low": [10.0, 50.0, 70.0], "high": [30.0, 70.0, 90.0],
    })  # fmt: skip
    bounded = stimuli.rename(columns={"spectral_match": "spectral_match_bounded"})
    assert kinds.count_clipped(stimuli, "spectral_match") == 1
    assert kinds.count_clipped(bounded, "spectral_match_bounded") == 0
    looks = style.assign_looks(["mag321", "dft321"])
    shown = kinds.plot_stimuli(Figure().subplots(), stimuli, "spectral_match", looks=looks)
    assert shown["mag321"].get_xdata().tolist() == [kinds.CUT]
    assert shown["mag321"].get_markerfacecolor() == "white"
    assert shown["dft321"].get_xdata().tolist() == [0.5, 0.9]


def test_a_profile_has_the_best_on_top_and_anchors_below(tidy: Callable[..., pd.DataFrame]) -> None:
    rows = tidy(spectral=60.0, noise=2.0)
    profile = profile_reducers(rows)
    axes = Figure().subplots()
    looks = style.assign_looks(order_reducers(profile["reducer"]))
    kinds.plot_profile(axes, profile, participant_means(rows), looks=looks)
    labels = [label.get_text().replace("\n", "") for label in axes.get_yticklabels()]
    tests = profile[profile["role"] == "test"].sort_values("mean", ascending=False)
    assert labels[: len(tests)] == list(tests["reducer"])
    assert all("(" in label for label in labels[len(tests) :])
    assert len(axes.collections) == len(profile)  # a cloud each


def test_a_map_needs_a_name_for_each_stimulus() -> None:
    rng = np.random.default_rng(0)
    half = np.triu(rng.uniform(0.1, 1, (6, 4, 4)), 1)
    ellipses = bootstrap_space(half + half.transpose(0, 2, 1), draws=5, rng=rng)
    (axes,) = kinds.draw_space(ellipses, ["a", "b", "c", "original"]).axes
    assert len(axes.patches) == 4
    with pytest.raises(ValueError, match="names must be one for each of 4 stimuli, got 3"):
        kinds.draw_space(ellipses, ["a", "b", "c", "a"])


def test_figures_are_saved_alike_and_are_as_wide_as_a_page(
    tidy: Callable[..., pd.DataFrame], tmp_path: Path
) -> None:
    rows = tidy(participants=4, recordings=4, anchors=False)
    models = {"realism": fit_primary(rows, METRICS, explain=False)}
    answers = {LONG: discriminate(9, 12), "sure": discriminate(12, 12)}
    drawings = {
        "slopes": lambda: kinds.draw_slopes(models, {}),
        "residuals": lambda: kinds.draw_residuals(models),
        "abx": lambda: kinds.draw_discrimination(answers),
    }
    for name, drawing in drawings.items():
        for number in "12":
            figure = drawing()
            style.save_figure(figure, tmp_path / f"{name}{number}")
            width = figure.get_size_inches()[0] * style.CM_PER_INCH
            assert width == pytest.approx(style.WIDTH_CM)
        for suffix in ("svg", "png"):
            one, other = (tmp_path / f"{name}{number}.{suffix}" for number in "12")
            assert one.read_bytes() == other.read_bytes()
