"""What a scientist does in a notebook: tables, statistics in one call each, plots on own axes."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from feel321 import analysis, results, stimuli
from feel321.analysis.contrasts import compare
from feel321.analysis.report.means import compute_contrasts
from feel321.analysis.report.section import find_row
from feel321.analysis.resampling import Choices
from feel321.analysis.table import schema
from feel321.protocols import PROTOCOLS
from feel321.protocols.trial import SURFACE
from feel321.stimuli.match import PLANNED


@pytest.fixture(scope="module")
def table(study: object) -> results.Table:
    return analysis.read_table(str(study.ratings), str(study.manifest))


@pytest.fixture(scope="module")
def realism(table: results.Table) -> results.Table:
    return table.select(scale="realism", level="as_is")


def test_files_frames_and_a_folder_are_one_table(
    study: object, table: results.Table, tmp_path: Path
) -> None:
    frames = [pd.read_csv(path) for path in (study.ratings, study.manifest)]
    assert analysis.read_table(*frames) == table
    (tmp_path / "stimuli").mkdir()
    (tmp_path / "ratings.csv").write_bytes(study.ratings.read_bytes())
    (tmp_path / "stimuli" / "manifest.csv").write_bytes(study.manifest.read_bytes())
    assert analysis.read_table(tmp_path) == table
    with pytest.raises(ValueError, match="ratings, row 3: rating must be 0 to 100, got '120"):
        analysis.read_table(
            frames[0].assign(rating=frames[0]["rating"].where(frames[0].index != 3, 120)), frames[1]
        )
    with pytest.raises(TypeError, match="ratings must be a path"):
        analysis.read_table(frames[0])
    with pytest.raises(TypeError, match="metrics must be a list of names, got the text"):
        analysis.read_table(*frames, metrics="spectral_match")


def test_a_table_has_the_shapes_that_others_take(realism: results.Table) -> None:
    assert realism.votes().shape == (36, 6)
    assert realism.to_frame().equals(realism.rows)
    assert realism.summary().startswith("576 judgements: 6 participants, 48 stimulus")
    assert len(repr(realism)) <= 200


def test_ratings_in_memory_need_a_manifest(table: results.Table) -> None:
    with pytest.raises(TypeError, match=r"got DataFrame.*give the manifest too"):
        analysis.read_table(table.to_frame())


def test_two_reducers_are_compared_as_the_report_compares_them(realism: results.Table) -> None:
    rows = compute_contrasts(realism, Choices(draws=2, margin=6.0)).rows["contrasts"]
    found = analysis.compare_reducers(realism, "mag321", "dft321", margin=6)
    wanted = {
        "difference": ("value", found.estimate), "t": ("p", found.p), "df": ("value", found.df),
        "difference_90": ("p", found.p_equivalence), "non_inferiority": ("p", found.p_non_inferiority),
    }  # fmt: skip
    for quantity, (column, value) in wanted.items():
        row = find_row(rows, quantity, reducer="mag321", second_reducer="dft321")
        assert row[column] == pytest.approx(value, rel=1e-6)
    turned = analysis.compare_reducers(realism, "dft321", "mag321")
    assert turned.estimate == pytest.approx(-found.estimate)


def test_statistics_of_votes_take_a_table(realism: results.Table) -> None:
    votes, facts = realism.votes(), realism.rows.drop_duplicates("stimulus_id")
    facts = facts.set_index("stimulus_id")
    icc = analysis.intraclass(realism).to_dict()
    assert icc == pytest.approx(analysis.intraclass(votes).to_dict())
    assert analysis.noise_ceiling(realism) == pytest.approx(analysis.noise_ceiling(votes))
    alpha = analysis.krippendorff_alpha(votes)
    assert analysis.krippendorff_alpha(realism) == pytest.approx(alpha)
    judged = analysis.p1401(realism, "temporal_match", order=1, groups="recording")
    metric, recordings = (facts.loc[votes.index, name] for name in ("temporal_match", "recording"))
    alone = analysis.p1401(votes, metric, order=1, groups=recordings)
    assert (judged.plcc, judged.rmse) == pytest.approx((alone.plcc, alone.rmse))
    rows = realism.rows[realism.rows["role"] == "test"]
    within = analysis.repeated_measures_correlation(realism, "temporal_match")
    assert within == analysis.repeated_measures_correlation(
        rows["temporal_match"], rows["rating"], rows["participant"]
    )


def test_abx_takes_a_table(tidy: Callable[..., pd.DataFrame]) -> None:
    rows = tidy(scales=("abx",))
    answers = rows.assign(rating=np.where(np.arange(len(rows)) % 4, 100.0, 0.0))
    found = analysis.discriminate(answers)
    one = answers[answers["reducer"] == "dft321"]["rating"]
    alone = analysis.discriminate(int((one == 100).sum()), len(one))
    row = found.set_index(["level", "reducer"]).loc[("as_is", "dft321")]
    assert (row["share"], row["n_trials"]) == (alone.share, alone.n_trials)
    assert "original" not in set(found["reducer"])


def read_forest(axes: Axes) -> tuple[list[float], list[list[float]]]:
    """Estimates and intervals of a forest plot, from the top; the line at zero is neither."""
    lines = [line.get_xdata() for line in axes.get_lines()]
    dots = [float(where[0]) for where in lines if len(where) == 1]
    ends = [[float(end) for end in where] for where in lines if len(where) == 2]
    return dots, [pair for pair in ends if pair != [0.0, 0.0]]


def test_plots_go_onto_the_axes_given(table: results.Table, realism: results.Table) -> None:
    axes = Figure().subplots(2, 3).ravel()
    analysis.plot_scatter(realism, "temporal_match", ax=axes[0])
    assert len(axes[0].get_legend().get_texts()) == 9
    drawn = np.sort(np.concatenate([line.get_xydata() for line in axes[0].get_lines()]), axis=0)
    means = realism.votes().mean(axis=1).to_frame("rating")
    metric = realism.rows.groupby("stimulus_id")["temporal_match"].first()
    tests = means.assign(metric=metric)[["metric", "rating"]]
    np.testing.assert_allclose(drawn, np.sort(tests.to_numpy(), axis=0))
    analysis.plot_profile(table, ax=axes[1])
    assert len(axes[1].get_yticklabels()) == 12
    bars = [line.get_xdata() for line in axes[1].get_lines() if len(line.get_xdata()) == 2]
    ends = compare.profile_reducers(table)[["low", "high"]].to_numpy()
    np.testing.assert_allclose(np.sort(bars, axis=0), np.sort(ends, axis=0))
    models = analysis.fit_attributes(table.rows, table.metrics)
    analysis.plot_slopes(models, ax=axes[2])
    assert len(axes[2].get_yticklabels()) == 6  # a heading and two metrics per scale
    axes[2].clear()
    analysis.plot_slopes(models["realism"], ax=axes[2])
    slopes = models["realism"].slopes
    dots, bars = read_forest(axes[2])
    assert dots == list(slopes["tenth"])  # as the axis says: per +0.1
    np.testing.assert_allclose(bars, slopes[["tenth_low", "tenth_high"]])
    scene = stimuli.make_scene("hard_taps", duration_s=0.5)
    for axis, name in zip(axes[3:], ("recording", "spectrum"), strict=False):
        assert getattr(analysis, f"plot_{name}")(scene, ax=axis) is axis
    with pytest.raises(TypeError, match="rate_hz must be given with plain samples"):
        analysis.plot_recording([1.0])


def test_names_of_other_packages_are_repeated_rightly() -> None:
    assert schema.PLANNED == PLANNED
    assert schema.SURFACE == SURFACE
    scales = set(PROTOCOLS)
    assert set(schema.APART) <= scales
