from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest
from matplotlib import rc_context, rcParams
from matplotlib.image import imread

from analysis.figures import draw_profile, draw_scatter
from analysis.findings import analyse
from analysis.style import CM_PER_INCH, COLUMN_CM, PNG_DPI, assign_looks, save_figure
from analysis.table import Table, order_reducers

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    import pandas as pd
    from matplotlib.figure import Figure
    from matplotlib.text import Text

    from analysis.findings import Findings

SMALLEST_PT = 7


@pytest.fixture
def table(tidy: Callable[..., pd.DataFrame]) -> pd.DataFrame:
    return tidy()


def find(table: pd.DataFrame) -> Findings:
    whole = Table(table, ("spectral_match", "temporal_match"), ())
    return analyse(whole, draws=20, rng=np.random.default_rng(0))


def scatter(table: pd.DataFrame) -> Figure:
    panel = find(table).panels[0]
    return draw_scatter(panel, panel.associations[0], looks=assign_looks(order_reducers(table["reducer"])))


def profile(table: pd.DataFrame) -> Figure:
    found = find(table)
    return draw_profile(found.profile, found.participants, looks=assign_looks(order_reducers(table["reducer"])))


def list_texts(figure: Figure) -> list[Text]:
    """List what is written for certain; tick labels along x may exist without being drawn."""
    figure.draw_without_rendering()
    axes = figure.axes[0]
    legend = [text for legend in figure.legends for text in legend.get_texts()]
    titles = [axes.title, axes._left_title, axes.xaxis.label, axes.yaxis.label]
    return [text for text in (*titles, *axes.texts, *axes.get_yticklabels(), *legend) if text.get_text()]


def test_no_two_reducers_look_alike() -> None:
    looks = assign_looks([f"reducer{number}" for number in range(77)])
    assert len(set(looks.values())) == 77


@pytest.mark.parametrize("draw", [scatter, profile])
def test_text_is_readable_and_inside_the_figure(draw: Callable[..., Figure], table: pd.DataFrame) -> None:
    figure = draw(table)
    assert figure.get_figwidth() * CM_PER_INCH == pytest.approx(COLUMN_CM)
    for text in list_texts(figure):
        assert text.get_fontsize() >= SMALLEST_PT
        box = text.get_window_extent()
        assert box.x0 >= 0, text.get_text()
        assert box.x1 <= figure.bbox.x1, text.get_text()


def test_scatter_tells_n_and_both_intervals(table: pd.DataFrame) -> None:
    axes = scatter(table).axes[0]
    title = axes.get_title(loc="left")
    for part in ("Pearson r = ", "36 stimuli", "4 recordings", "two-way interval", "over 6 participants only"):
        assert part in title
    assert axes.get_ylabel() == "Mean realism rating (0–100)"
    assert axes.get_xlabel() == "Spectral match (1 = identical energy)"


def test_every_stimulus_is_drawn_once(table: pd.DataFrame) -> None:
    axes = scatter(table).axes[0]
    assert sum(len(line.get_xdata()) for line in axes.lines) == 36
    assert sum(len(bars.get_segments()) for bars in axes.collections) == 36


def test_far_outliers_stand_hollow_at_the_edge_and_are_counted(table: pd.DataFrame) -> None:
    outlying = table["stimulus_id"] == "rec1_say321_as_is"
    table.loc[outlying, "spectral_match"] = -31.4
    axes = scatter(table).axes[0]
    points = np.concatenate([line.get_xdata() for line in axes.lines])
    assert points.min() == -1
    hollow = [line for line in axes.lines if line.get_markerfacecolor() == "white" and len(line.get_xdata())]
    assert [list(line.get_xdata()) for line in hollow] == [[-1]]
    assert "1 of 36 stimuli below −1\n    (lowest −31.40)" in axes.texts[0].get_text()


@pytest.mark.parametrize(("sign", "side"), [(1, "top"), (-1, "bottom")])
def test_the_count_stands_where_the_cloud_is_not(table: pd.DataFrame, sign: int, side: str) -> None:
    table.loc[table["stimulus_id"] == "rec1_say321_as_is", "spectral_match"] = -1.2
    table["rating"] = 50 + sign * (table["rating"] - 50)
    assert scatter(table).axes[0].texts[0].get_verticalalignment() == side


def test_scatter_without_outliers_says_nothing_of_them(table: pd.DataFrame) -> None:
    assert not scatter(table).axes[0].texts


def test_profile_sets_reference_and_anchors_apart(table: pd.DataFrame) -> None:
    axes = profile(table).axes[0]
    labels = [label.get_text() for label in axes.get_yticklabels()]
    heights = dict(zip(labels, axes.get_yticks(), strict=True))
    assert labels[:9] == order_reducers(labels[:9])
    assert labels[9:] == ["original\n(reference)", "anchor_low\n(anchor)", "anchor_mid\n(anchor)"]
    assert heights["dft321_windowed"] - heights["original\n(reference)"] == 2
    assert "over 6 participants" in axes.get_title(loc="left")


def test_profile_of_tests_alone_has_no_dividing_line(table: pd.DataFrame) -> None:
    axes = profile(table[table["role"] == "test"]).axes[0]
    assert all(line.get_linestyle() != ":" for line in axes.lines)


def test_profile_of_one_participant_has_no_bars(tidy: Callable[..., pd.DataFrame]) -> None:
    assert not profile(tidy(participants=1)).axes[0].collections


def test_names_are_never_read_as_formulas(table: pd.DataFrame, tmp_path: Path) -> None:
    name = r"5$ \frac{ $"  # as a formula this would be refused
    table["reducer"] = table["reducer"].replace("mag321", name)
    save_figure(scatter(table), tmp_path / "figure")
    assert name in (tmp_path / "figure.svg").read_text(encoding="utf-8")


def test_files_are_made_for_print_and_repeat_to_the_byte(table: pd.DataFrame, tmp_path: Path) -> None:
    before = dict(rcParams)
    for name in ("one", "two"):
        save_figure(scatter(table), tmp_path / name)
    for suffix in (".svg", ".png"):
        assert (tmp_path / f"one{suffix}").read_bytes() == (tmp_path / f"two{suffix}").read_bytes()
    width = imread(tmp_path / "one.png").shape[1]
    assert width == pytest.approx(COLUMN_CM / CM_PER_INCH * PNG_DPI, abs=1)
    assert dict(rcParams) == before


def test_a_setting_of_the_working_folder_changes_no_byte(table: pd.DataFrame, tmp_path: Path) -> None:
    save_figure(scatter(table), tmp_path / "one")
    with rc_context({"axes.grid": True, "savefig.bbox": "tight", "axes.facecolor": "yellow"}):
        save_figure(scatter(table), tmp_path / "two")
    assert (tmp_path / "one.svg").read_bytes() == (tmp_path / "two.svg").read_bytes()
