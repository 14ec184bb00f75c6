"""Published tables: maps and correlations from a paper's numbers, and one clear line about what is wrong with them."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
import pytest

from feel321.analysis.published import correlate_published, map_published, read_matrix
from feel321.analysis.space import align_spaces
from feel321.study.cli import main

if TYPE_CHECKING:
    from pathlib import Path

REDUCERS = ("sax321", "soc321", "mag321", "dft321", "pca321", "original")
PLACES = np.array([[0, 0], [3, 0], [0, 4], [3, 4], [6, 2], [5, 7]], dtype=float)
DISTANCES = np.sqrt(((PLACES[:, None] - PLACES) ** 2).sum(axis=-1))


def label(matrix: object) -> pd.DataFrame:
    return pd.DataFrame(matrix, index=REDUCERS, columns=REDUCERS)


def write(path: Path, table: pd.DataFrame, **options: Any) -> Path:
    table.to_csv(path, **options)
    return path


def test_a_published_matrix_gives_the_map_that_it_was_made_from(tmp_path: Path) -> None:
    found = map_published(write(tmp_path / "lee.csv", label(DISTANCES)))
    assert found.names == REDUCERS
    assert found.stress < 1e-3
    assert align_spaces(found, PLACES, permutations=99).disparity < 1e-5
    assert found.ellipses is None


def test_half_a_matrix_in_another_order_is_the_same_map(tmp_path: Path) -> None:
    half = label(np.where(np.tri(6, k=-1) > 0, DISTANCES, np.nan)).iloc[:, ::-1]
    labels, matrix = read_matrix(write(tmp_path / "half.csv", half))
    assert labels == REDUCERS
    np.testing.assert_allclose(matrix, DISTANCES)
    np.testing.assert_allclose(read_matrix(half)[1], DISTANCES)


def test_stimuli_are_taken_in_the_order_of_another_map() -> None:
    names = ("pca321", "original", "sax321", "dft321")
    found = map_published(label(DISTANCES), names=names)
    assert found.names == names
    places = PLACES[[REDUCERS.index(name) for name in names]]
    assert align_spaces(found, places, permutations=99).disparity < 1e-5
    with pytest.raises(ValueError, match=r"names must be one of .*; got 'vm'"):
        map_published(label(DISTANCES), names=["vm"])


def spoil(row: int, column: int, value: object) -> pd.DataFrame:
    table = label(DISTANCES).astype(object)
    table.iloc[row, column] = value
    return table


@pytest.mark.parametrize(
    ("table", "message"),
    [
        (spoil(1, 0, 9.0), "'sax321' and 'soc321' differ by 3 and by 9; must be one number"),
        (spoil(1, 1, 1.0), "'soc321' differs from itself by 1, must be 0 or empty; similarities"),
        (spoil(1, 0, "far"), "row 'soc321', column 'sax321': must be a number of 0 or more"),
        (spoil(1, 0, -1.0), "must be a number of 0 or more, or empty, got '-1.0'"),
        (label(np.eye(6) * 0 + np.nan), "no number for 'sax321' and 'soc321'; give every pair"),
        (label(DISTANCES).iloc[:, :5], "must be square, .*5 columns; not once in both: 'original'"),
        (label(DISTANCES).rename(columns={"soc321": "sax321"}), "must be square"),
        (label(DISTANCES).iloc[:2, :2], "must be square, with the same 3 or more names"),
    ],
)
def test_a_wrong_matrix_is_refused_in_one_line(
    tmp_path: Path, table: pd.DataFrame, message: str
) -> None:
    for given, what in ((table, "dissimilarities"), (write(tmp_path / "m.csv", table), "m.csv")):
        with pytest.raises(ValueError, match=rf"^{what}.*{message}") as found:
            map_published(given)
        assert "\n" not in str(found.value)


RECORDINGS = tuple(f"r{number}" for number in range(8))
FELT = REDUCERS[:5]


@pytest.fixture(scope="module")
def manifest() -> pd.DataFrame:
    rng = np.random.default_rng(9)
    rows = [
        {
            "stimulus_id": f"{recording}-{reducer}", "recording": recording, "reducer": reducer,
            "level": "as_is", "role": "test", "spectral_match_bounded": rng.uniform(),
            "temporal_match": rng.uniform(),
        }
        for recording in RECORDINGS for reducer in FELT
    ]  # fmt: skip
    return pd.DataFrame(rows)


def make_means(manifest: pd.DataFrame, *, people: int = 15, sd: float = 1.0) -> pd.DataFrame:
    """Mean ratings on a scale of 1 to 7 that follow the temporal match, and the standard deviations over raters."""
    rng = np.random.default_rng(4)
    felt = 2 + 4 * manifest["temporal_match"].to_numpy()
    ratings = felt + rng.normal(0, 0.8, (people, 1)) + rng.normal(0, sd, (people, len(felt)))
    return manifest[["recording", "reducer"]].assign(
        mean=ratings.mean(axis=0), sd=ratings.std(axis=0, ddof=1), n=people
    )


def test_published_means_are_correlated_with_the_metrics(
    manifest: pd.DataFrame, tmp_path: Path
) -> None:
    means = make_means(manifest).sample(frac=1, random_state=1)  # in any order
    paths = (
        write(tmp_path / name, table, index=False)
        for name, table in (("means.csv", means), ("manifest.csv", manifest))
    )
    found = correlate_published(*paths)
    rows = found.correlations.set_index("metric")
    joined = means.merge(manifest, on=["recording", "reducer"])
    for name in ("spectral_match_bounded", "temporal_match"):
        assert rows.loc[name, "value"] == pytest.approx(joined["mean"].corr(joined[name]))
        assert rows.loc[name, "low"] < rows.loc[name, "value"] < rows.loc[name, "high"]
    assert rows.loc["temporal_match", "value"] > 0.95
    (compared,) = found.comparisons.to_dict("records")
    assert compared["difference"] == pytest.approx(-rows["value"].diff().iloc[1])
    assert compared["high"] < 0
    assert (found.n_items, found.n_recordings) == (40, 8)
    assert any("no noise ceiling" in note for note in found.notes)


def test_the_error_share_bounds_what_the_raters_noise_does(manifest: pd.DataFrame) -> None:
    means = make_means(manifest, people=6, sd=2.0)
    found = correlate_published(means, manifest)
    squared_error = found.error_share * means["mean"].var(ddof=1)
    # Noise of a mean is 2²/6; what each rater does alike to all stimuli, 0.8²/6, is in sd as well.
    assert squared_error == pytest.approx((4 + 0.64) / 6, rel=0.25)
    assert squared_error == pytest.approx((means["sd"] ** 2 / 6).mean())
    plain = correlate_published(means[["recording", "reducer", "mean"]], manifest)
    assert np.isnan(plain.error_share)
    assert not any("Standard errors" in note for note in plain.notes)


def test_means_over_recordings_meet_metrics_over_recordings(manifest: pd.DataFrame) -> None:
    means = make_means(manifest).groupby("reducer", as_index=False)["mean"].mean()
    found = correlate_published(means, manifest, method="spearman")
    metrics = manifest.groupby("reducer")[["temporal_match"]].mean()
    expected = means.set_index("reducer")["mean"].corr(metrics["temporal_match"], method="spearman")
    value = found.correlations.set_index("metric").loc["temporal_match", "value"]
    assert value == pytest.approx(expected)
    assert (found.n_items, found.n_recordings) == (5, 0)
    assert any("over the manifest's recordings" in note for note in found.notes)
    assert any("too narrow" in note for note in found.notes)


def test_the_interval_over_recordings_holds_what_recordings_do(manifest: pd.DataFrame) -> None:
    """Points of whole recordings widen it; Fisher's interval would not know."""
    rng = np.random.default_rng(2)
    widths = []
    for spread in (0.0, 3.0):
        shift = dict(zip(RECORDINGS, spread * rng.normal(size=8), strict=True))
        means = make_means(manifest, sd=0.1)
        means["mean"] += means["recording"].map(shift)
        row = correlate_published(means, manifest).correlations.iloc[1]
        widths.append(np.arctanh(row["high"]) - np.arctanh(row["low"]))
    fisher = 2 * 1.96 / np.sqrt(37)
    assert widths[1] > fisher


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"reducer": "vm321"}, "no test stimulus 'vm321 of r0'; its reducers are dft321, mag321"),
        ({"mean": "high"}, r"means, row \d+.*: mean must be a finite number, got 'high'"),
        ({"mean": ""}, "mean must be a finite number"),
        ({"sd": -1}, "sd must be 0 or more, or empty, got -1"),
        ({"n": 1}, "n must be 2 or more, or empty, got 1"),
        ({"recording": "r1"}, "reducer must occur once"),
    ],
)
def test_wrong_means_are_refused_in_one_line(
    manifest: pd.DataFrame, change: dict[str, object], message: str
) -> None:
    means = make_means(manifest).astype(object)
    for name, value in change.items():
        means.loc[0, name] = value
    with pytest.raises(ValueError, match=message) as found:
        correlate_published(means, manifest)
    assert "\n" not in str(found.value)


def test_what_cannot_be_correlated_is_refused(manifest: pd.DataFrame) -> None:
    means = make_means(manifest)
    with pytest.raises(ValueError, match="got 3 rows, a correlation needs 4"):
        correlate_published(means[:3], manifest)
    with pytest.raises(ValueError, match="mean is 5 for every stimulus"):
        correlate_published(means.assign(mean=5.0), manifest)
    with pytest.raises(ValueError, match="column mean is missing"):
        correlate_published(means.drop(columns="mean"), manifest)
    with pytest.raises(ValueError, match="manifest: no column level_only"):
        correlate_published(means, manifest, metrics=["level_only"])
    both = pd.concat([manifest, manifest.assign(level="equal_intensity")])
    with pytest.raises(ValueError, match="level must be one of as_is, equal_intensity"):
        correlate_published(means, both)
    assert correlate_published(means, both, level="as_is") == correlate_published(means, manifest)


def test_the_verb_takes_either_table(
    manifest: pd.DataFrame, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    means = write(tmp_path / "means.csv", make_means(manifest), index=False)
    listed = write(tmp_path / "manifest.csv", manifest, index=False)
    square = write(tmp_path / "square.csv", label(DISTANCES))
    assert main(["published", str(means)]) == 2
    assert "--manifest is missing" in capsys.readouterr().err
    assert main(["published", str(square), "--manifest", str(listed)]) == 2
    assert "a matrix needs no manifest" in capsys.readouterr().err
    assert main(["published", str(square)]) == 0
    assert "stress" in capsys.readouterr().out
    assert main(["published", str(means), "--manifest", str(listed), "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert [row["metric"] for row in facts["correlations"]] == [
        "spectral_match_bounded",
        "temporal_match",
    ]
    assert main(["published", str(tmp_path / "none.csv")]) == 1
    assert capsys.readouterr().err.count("\n") == 1
