from __future__ import annotations

import re
from dataclasses import replace
from itertools import combinations, product
from types import SimpleNamespace
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
import pytest
from matplotlib import rc_context, rcParams
from matplotlib.image import imread

from feel321.analysis.association.correlate import make_panel
from feel321.analysis.contrasts.compare import participant_means, profile_reducers
from feel321.analysis.figures.estimates import describe_extremes, draw_profiles
from feel321.analysis.figures.scatter import (
    describe_relation,
    draw_scatter,
    draw_scatters,
    group_marks,
)
from feel321.analysis.figures.style import (
    CM_PER_INCH,
    MARKERS,
    PNG_DPI,
    WIDTH_CM,
    Look,
    assign_looks,
    label_scale,
    save_figure,
)
from feel321.analysis.table.items import split_tests
from feel321.analysis.table.metrics import order_reducers

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D
    from matplotlib.text import Text


SMALLEST_PT = 7


@pytest.fixture
def table(tidy: Callable[..., pd.DataFrame]) -> pd.DataFrame:
    return tidy()


def find(table: pd.DataFrame) -> SimpleNamespace:
    metrics, rng = ("spectral_match", "temporal_match"), np.random.default_rng(0)
    panels = [make_panel(part.rows, metrics, draws=20, rng=rng) for part in split_tests(table)]
    return SimpleNamespace(
        panels=panels, profile=profile_reducers(table), participants=participant_means(table)
    )


def scatter(table: pd.DataFrame) -> Figure:
    panel = find(table).panels[0]
    return draw_scatter(
        panel, panel.associations[0], looks=assign_looks(order_reducers(table["reducer"]))
    )


def profile(table: pd.DataFrame) -> Figure:
    found = find(table)
    looks = assign_looks(order_reducers(table["reducer"]))
    return draw_profiles([(found.profile, found.participants)], looks=looks)


def name_at_length(table: pd.DataFrame, stem: str) -> pd.DataFrame:
    """Give 17 reducers and the scale long names."""
    tests = table[table["role"] == "test"]
    more = tests[tests["reducer"] != "dft321"].assign(
        reducer=lambda rows: rows["reducer"] + "b",
        stimulus_id=lambda rows: rows["stimulus_id"] + "b",
    )
    whole = pd.concat([table, more], ignore_index=True)
    names = {name: f"{stem}{number}" for number, name in enumerate(whole["reducer"].unique())}
    return whole.assign(reducer=whole["reducer"].map(names), scale=stem)


def list_texts(figure: Figure) -> list[Text]:
    """List what is written for certain; tick labels along x may exist without being drawn."""
    figure.draw_without_rendering()
    axes = figure.axes[0]
    legend = [text for legend in figure.legends for text in legend.get_texts()]
    of_figure = filter(None, [figure._suptitle, figure._supxlabel])
    titles = [*of_figure, axes.title, axes._left_title, axes.xaxis.label, axes.yaxis.label]
    return [
        text for text in (*titles, *axes.texts, *axes.get_yticklabels(), *legend) if text.get_text()
    ]


def test_no_two_reducers_look_alike() -> None:
    looks = assign_looks([f"reducer{number}" for number in range(77)])
    assert len(set(looks.values())) == 77
    for (_, one), (_, other) in combinations(list(looks.items())[: len(MARKERS)], 2):
        assert one.marker != other.marker  # a colour comes again after 7


@pytest.mark.parametrize("draw", [scatter, profile])
def test_text_is_readable_and_inside_the_figure(
    draw: Callable[..., Figure], table: pd.DataFrame
) -> None:
    figure = draw(table)
    assert figure.get_figwidth() * CM_PER_INCH == pytest.approx(WIDTH_CM)
    for text in list_texts(figure):
        assert text.get_fontsize() >= SMALLEST_PT
        box = text.get_window_extent()
        assert box.x0 >= 0, text.get_text()
        assert box.x1 <= figure.bbox.x1, text.get_text()


LONG = "a reducer named by its authors, its year, its variant and what not "


@pytest.mark.parametrize("draw", [scatter, profile])
@pytest.mark.parametrize("stem", [LONG, LONG.replace(" ", "_"), "W" * 70, "short"])
def test_long_names_stay_inside_and_apart(
    draw: Callable[..., Figure], tidy: Callable[..., pd.DataFrame], stem: str
) -> None:
    table = name_at_length(tidy(recordings=3), stem)
    figure = draw(table)
    for text in list_texts(figure):
        box = text.get_window_extent()
        assert figure.bbox.x0 <= box.x0 < box.x1 <= figure.bbox.x1, text.get_text()
        assert figure.bbox.y0 <= box.y0 < box.y1 <= figure.bbox.y1, text.get_text()
    axes = figure.axes[0]
    legend = [text for legend in figure.legends for text in legend.get_texts()]
    boxes = [text.get_window_extent() for text in legend or axes.texts or axes.get_yticklabels()]
    assert len(boxes) >= 17
    assert not any(one.overlaps(other) for one, other in combinations(boxes, 2))
    assert axes.bbox.height > 100


def list_marks(axes: Axes) -> list[Line2D]:
    """List the stimuli's marks of a scatter: those that stand in data, with a marker."""
    return [line for line in axes.lines if line.get_transform() == axes.transData]


@pytest.mark.parametrize("name", ["_mine", "__", "dft321"])
def test_every_reducer_is_named_once_at_the_height_of_its_mean(
    table: pd.DataFrame, name: str
) -> None:
    table["reducer"] = table["reducer"].replace("mag321", name)
    tests = table[table["role"] == "test"]
    means = tests.groupby(["reducer", "stimulus_id"])["rating"].mean().groupby("reducer").mean()
    axes = scatter(table).axes[0]
    places = {text.get_text(): text.get_position()[1] for text in axes.texts}
    assert set(places) == set(tests["reducer"])
    # From the highest mean to the lowest, however near they are.
    assert sorted(places, key=places.get) == list(means.sort_values().index)
    beside = [line for line in axes.lines if line.get_transform() != axes.transData]
    leaders = [line.get_ydata()[0] for line in beside[::2]]
    np.testing.assert_allclose(leaders, means.sort_values(ascending=False))


def test_scatter_states_its_finding_with_interval_and_n(table: pd.DataFrame) -> None:
    figure = scatter(table)
    title = " ".join(figure.get_suptitle().split())
    assert title.startswith("Realism against spectral match, over all stimuli: r = 0.")
    for part in ("36 stimuli of 4 recordings", "95 % two-way interval", "6 participants"):
        assert part in title
    axes = figure.axes[0]
    assert axes.get_ylabel() == "Mean realism rating (0–100)"
    assert axes.get_xlabel() == "Spectral match (1 = identical energy)"


@pytest.mark.parametrize(
    ("value", "low", "high", "said"),
    [
        (0.8, 0.5, 0.9, "r = 0.80 (0.50 to 0.90)"),
        (-0.8, -0.9, -0.5, "r = −0.80 (−0.90 to −0.50)"),
        (0.3, np.nan, np.nan, "r = 0.30 (no interval)"),
        (np.nan, np.nan, np.nan, "r not estimable"),
    ],
)
def test_a_scatter_describes_and_leaves_what_is_shown_to_the_verdicts(
    table: pd.DataFrame, value: float, low: float, high: float, said: str
) -> None:
    one = find(table).panels[0].associations[0]
    found = replace(one, metric="temporal_match", value=value, low=low, high=high)
    lead = "Realism (level as is) against temporal match, over all stimuli: "
    assert describe_relation("realism", found, "as_is") == lead + said


def test_small_multiples_hold_every_scale_and_metric(tidy: Callable[..., pd.DataFrame]) -> None:
    table = tidy(scales=("realism", "mushra"))
    panels, metrics = find(table).panels, ("spectral_match", "temporal_match")
    looks = assign_looks(order_reducers(table["reducer"]))
    figure = draw_scatters(panels, metrics, "pearson", looks=looks)
    assert len(figure.axes) == len(panels) * len(metrics) == 4
    for axes, (panel, metric) in zip(figure.axes, product(panels, metrics), strict=True):
        drawn = sorted(tuple(point) for line in list_marks(axes) for point in line.get_xydata())
        assert drawn == sorted(zip(panel.stimuli[metric], panel.stimuli["mean"], strict=True))
        (one,) = (a for a in panel.associations if (a.metric, a.method) == (metric, "pearson"))
        assert axes.get_title(loc="left").startswith(f"r = {one.value:.2f} ")
    title = " ".join(figure.get_suptitle().split())
    assert title.startswith("Mean ratings against spectral match and temporal match r: Pearson, in")


def test_levels_are_named_where_there_are_several(table: pd.DataFrame) -> None:
    two = [table, table.assign(level="matched", stimulus_id=table["stimulus_id"] + "_m")]
    found, looks = find(pd.concat(two)), assign_looks(order_reducers(table["reducer"]))
    metrics = ("spectral_match", "temporal_match")
    figure = draw_scatters(found.panels, metrics, "pearson", looks=looks)
    labels = [" ".join(axes.get_ylabel().split()) for axes in figure.axes[::2]]
    own = [
        [frame[frame["level"] == level] for frame in (found.profile, found.participants)]
        for level in ("as_is", "matched")
    ]
    axes = draw_profiles(own, looks=looks).axes
    labels += [" ".join(one.get_xlabel().split()) for one in axes]
    for label, level in zip(labels, ["as is", "matched"] * 2, strict=True):
        assert label == f"Mean realism rating, level {level} (0–100)"
    titles = [" ".join(one.get_title(loc="left").split()) for one in axes]
    assert titles[0].replace("level as is", "level matched") == titles[1]
    assert titles[0].startswith("Realism (level as is): ")


@pytest.mark.parametrize(
    ("scale", "low", "said"),
    [
        ("realism", 60.0, "a highest, b lowest"),
        ("realism", 30.0, "highest and lowest do not differ clearly"),
        ("realism", np.nan, ""),
        ("dissimilarity", 60.0, "a least like the reference, b most like it"),
        ("abx", 60.0, "a told apart most, b least"),
    ],
)
def test_ends_are_named_as_the_scale_means_them_and_where_they_differ(
    scale: str, low: float, said: str
) -> None:
    rows = {"scale": scale, "role": "test", "reducer": ["a", "b"], "mean": [70.0, 30.0]}
    profile = pd.DataFrame({**rows, "low": [low, 20.0], "high": [80.0, 40.0]})
    assert describe_extremes(profile) == said
    assert label_scale("abx") == "Mean percentage correct (0–100)"


def test_every_mark_can_be_found_in_the_file(table: pd.DataFrame, tmp_path: Path) -> None:
    table.loc[table["stimulus_id"] == "rec1_say321_as_is", "spectral_match"] = -31.4
    save_figure(scatter(table), tmp_path / "figure")
    text = (tmp_path / "figure.svg").read_text(encoding="utf-8")
    groups = list(group_marks(find(table).panels[0].stimuli, "spectral_match", "0-0"))
    assert sum(len(group.rows) for group in groups) == 36
    assert [group.reducer for group in groups if group.hollow] == ["say321"]
    for group in groups:
        marks = re.search(rf'<g id="{group.name}".*?</g>', text, flags=re.DOTALL)[0]
        assert marks.count("<use") == len(group.rows)


def test_every_stimulus_is_drawn_once(table: pd.DataFrame) -> None:
    axes = scatter(table).axes[0]
    assert sum(len(line.get_xdata()) for line in list_marks(axes)) == 36
    assert sum(len(bars.get_segments()) for bars in axes.collections) == 36


@pytest.mark.parametrize("number", [0, 2])
def test_points_and_bars_stand_where_the_numbers_say(table: pd.DataFrame, number: int) -> None:
    panel = find(table).panels[0]
    association, looks = panel.associations[number], assign_looks(order_reducers(table["reducer"]))
    axes = draw_scatter(panel, association, looks=looks).axes[0]
    drawn = [tuple(point) for line in list_marks(axes) for point in line.get_xydata()]
    bars = [tuple(segment.ravel()) for part in axes.collections for segment in part.get_segments()]
    stimuli = panel.stimuli
    assert sorted(drawn) == sorted(zip(stimuli[association.metric], stimuli["mean"], strict=True))
    x = stimuli[association.metric]
    assert sorted(bars) == sorted(zip(x, stimuli["low"], x, stimuli["high"], strict=True))
    by_look = {Look(line.get_color(), line.get_marker()): line for line in list_marks(axes)}
    for name, part in stimuli.groupby("reducer"):
        assert set(by_look[looks[name]].get_xdata()) == set(part[association.metric])


def test_profile_rows_stand_where_the_numbers_say(table: pd.DataFrame) -> None:
    found = find(table).profile
    axes = profile(table).axes[0]
    labels = [label.get_text().split("\n")[0] for label in axes.get_yticklabels()]
    heights = dict(zip(labels, axes.get_yticks(), strict=True))
    drawn = {float(bar.lines[0].get_ydata()[0]): bar for bar in axes.containers}
    assert len(drawn) == len(found) == 12
    for row in found.to_dict("records"):
        height = heights[row["reducer"]]
        point, _, (bars,) = drawn[height].lines
        assert point.get_xdata()[0] == row["mean"]
        (segment,) = bars.get_segments()
        np.testing.assert_allclose(segment, [[row["low"], height], [row["high"], height]])


def test_far_outliers_stand_hollow_at_the_edge_and_are_counted(table: pd.DataFrame) -> None:
    outlying = table["stimulus_id"] == "rec1_say321_as_is"
    table.loc[outlying, "spectral_match"] = -31.4
    axes = scatter(table).axes[0]
    points = np.concatenate([line.get_xdata() for line in list_marks(axes)])
    assert points.min() == -1
    hollow = [line for line in list_marks(axes) if line.get_markerfacecolor() == "white"]
    assert [list(line.get_xdata()) for line in hollow] == [[-1]]
    assert "1 of 36 stimuli below −1\n    (lowest −31.40)" in axes.texts[0].get_text()
    table.loc[outlying, "spectral_match"] = -1e200
    assert "(lowest −1.0e+200)" in scatter(table).axes[0].texts[0].get_text()


@pytest.mark.parametrize(("sign", "side"), [(1, "top"), (-1, "bottom")])
def test_the_count_stands_where_the_cloud_is_not(table: pd.DataFrame, sign: int, side: str) -> None:
    table.loc[table["stimulus_id"] == "rec1_say321_as_is", "spectral_match"] = -1.2
    table["rating"] = 50 + sign * (table["rating"] - 50)
    assert scatter(table).axes[0].texts[0].get_verticalalignment() == side


def test_scatter_without_outliers_says_nothing_of_them(table: pd.DataFrame) -> None:
    assert not any("hollow" in text.get_text() for text in scatter(table).axes[0].texts)


def test_profile_sets_reference_and_anchors_apart(table: pd.DataFrame) -> None:
    axes = profile(table).axes[0]
    labels = [label.get_text() for label in axes.get_yticklabels()]
    heights = dict(zip(labels, axes.get_yticks(), strict=True))
    means = find(table).profile.query("role == 'test'").set_index("reducer")["mean"]
    order = list(means.sort_values(ascending=False).index)
    assert labels[:9] == order
    title = axes.get_title(loc="left").replace("\n", " ")
    assert title == f"Realism: {order[0]} highest, {order[-1]} lowest"
    assert labels[9:] == ["original\n(reference)", "anchor_low\n(anchor)", "anchor_mid\n(anchor)"]
    assert heights[order[-1]] - heights["original\n(reference)"] == pytest.approx(2)
    assert "over 6 participants;" in axes.figure.get_suptitle()


def test_clouds_show_where_the_participants_are(table: pd.DataFrame) -> None:
    means = find(table).participants
    axes = profile(table).axes[0]
    labels = [label.get_text().split("\n")[0] for label in axes.get_yticklabels()]
    heights = dict(zip(labels, axes.get_yticks(), strict=True))
    clouds = {round(float(patch.get_xy()[:, 1].min()), 6): patch.get_xy() for patch in axes.patches}
    assert len(clouds) == len(heights) == 12
    for name, part in means.groupby("reducer"):
        outline = clouds[round(heights[name] + 0.14, 6)]
        assert (
            outline[:, 0].min()
            < part["rating"].min()
            < part["rating"].max()
            < outline[:, 0].max()
            <= 100
        )
        assert outline[:, 1].max() == pytest.approx(heights[name] + 0.64)
    assert "clouds: their distribution" in " ".join(axes.figure.get_suptitle().split())


def test_participants_who_agree_have_no_cloud(table: pd.DataFrame) -> None:
    table.loc[table["reducer"] == "mag321", "rating"] = 50.0
    assert len(profile(table).axes[0].patches) == 11


def test_profile_of_tests_alone_has_no_dividing_line(table: pd.DataFrame) -> None:
    axes = profile(table[table["role"] == "test"]).axes[0]
    assert all(line.get_linestyle() != ":" for line in axes.lines)


def test_profile_of_one_participant_has_no_bars(tidy: Callable[..., pd.DataFrame]) -> None:
    axes = profile(tidy(participants=1)).axes[0]
    assert not axes.collections
    assert axes.figure.get_suptitle().startswith("Mean of 1 participant, no interval")


def test_a_row_of_fewer_participants_is_told(table: pd.DataFrame) -> None:
    gone = (table["reducer"] == "mag321") & table["participant"].isin(["p00", "p01"])
    assert "over 4–6 participants" in profile(table[~gone]).get_suptitle()


def test_names_are_never_read_as_formulas(table: pd.DataFrame, tmp_path: Path) -> None:
    name = r"5$ \frac{ $"  # as a formula this would be refused
    table["reducer"] = table["reducer"].replace("mag321", name)
    save_figure(scatter(table), tmp_path / "figure")
    assert name in (tmp_path / "figure.svg").read_text(encoding="utf-8")


def test_files_are_made_for_print_and_repeat_to_the_byte(
    table: pd.DataFrame, tmp_path: Path
) -> None:
    before = dict(rcParams)
    for name in ("one", "two"):
        save_figure(scatter(table), tmp_path / name)
    for suffix in (".svg", ".png"):
        assert (tmp_path / f"one{suffix}").read_bytes() == (tmp_path / f"two{suffix}").read_bytes()
    width = imread(tmp_path / "one.png").shape[1]
    assert width == pytest.approx(WIDTH_CM / CM_PER_INCH * PNG_DPI, abs=1)
    assert dict(rcParams) == before


def test_a_pdf_repeats_to_the_byte_and_nothing_else_is_known(
    table: pd.DataFrame, tmp_path: Path
) -> None:
    figure = scatter(table)
    for name in ("v1.0", "v1.1"):
        save_figure(figure, tmp_path / name, formats=["pdf"])
    assert (tmp_path / "v1.0.pdf").read_bytes() == (tmp_path / "v1.1.pdf").read_bytes()
    assert len(list(tmp_path.iterdir())) == 2
    with pytest.raises(ValueError, match="formats must be one of svg, png, pdf; got 'bmp'"):
        save_figure(figure, tmp_path / "figure", formats=["bmp"])


def test_a_setting_of_the_working_folder_changes_no_byte(
    table: pd.DataFrame, tmp_path: Path
) -> None:
    save_figure(scatter(table), tmp_path / "one")
    with rc_context({"axes.grid": True, "savefig.bbox": "tight", "axes.facecolor": "yellow"}):
        save_figure(scatter(table), tmp_path / "two")
    assert (tmp_path / "one.svg").read_bytes() == (tmp_path / "two.svg").read_bytes()
