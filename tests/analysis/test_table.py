import os
import re
from collections.abc import Callable
from pathlib import Path

import pandas as pd
import pytest

from feel321.analysis.table.reading import Table, read_table


def read(files: object) -> Table:
    return read_table(files.ratings, files.manifest)


def edit(path: Path, change: Callable[[pd.DataFrame], pd.DataFrame]) -> None:
    change(pd.read_csv(path)).to_csv(path, index=False)


def set_cell(column: str, value: object, row: int = 0) -> Callable[[pd.DataFrame], pd.DataFrame]:
    def change(frame: pd.DataFrame) -> pd.DataFrame:
        frame[column] = frame[column].astype(object)
        frame.loc[row, column] = value
        return frame

    return change


def test_ratings_and_metrics_come_together(files: Callable[..., object]) -> None:
    study = files()
    table = read(study)
    ratings, manifest = (
        pd.read_csv(study.ratings),
        pd.read_csv(study.manifest, index_col="stimulus_id"),
    )
    assert list(table.rows["rating"]) == list(ratings["rating"])
    expected = manifest.loc[ratings["stimulus_id"]]
    for name in ("spectral_match", "temporal_match"):
        pd.testing.assert_series_equal(table.rows[name], expected[name].reset_index(drop=True))
    for name in ("recording", "reducer", "level", "role"):
        assert list(table.rows[name]) == list(expected[name])
    assert table.metrics == ("spectral_match", "temporal_match")
    assert table.rows["simulated"].all()
    assert table.notes == ()


def test_four_columns_from_elsewhere_are_enough(files: Callable[..., object]) -> None:
    study = files()
    edit(study.ratings, lambda frame: frame[["participant", "stimulus_id", "scale", "rating"]])
    edit(
        study.manifest,
        lambda frame: frame[["stimulus_id", "recording", "reducer", "spectral_match"]].fillna(0),
    )
    table = read(study)
    assert table.metrics == ("spectral_match",)
    assert not table.rows["simulated"].any()
    assert set(table.rows["repeat"]) == {"1", "2"}
    assert [note.split(":")[0] for note in table.notes] == [
        "manifest.csv has nothing in a column 'temporal_match', so that metric is not reported.",
        "manifest.csv has nothing in a column 'level'",
        "manifest.csv has nothing in a column 'role'",
        "ratings.csv has nothing in a column 'trial' or 'repeat'",
    ]


def test_rejected_judgements_are_left_out_and_said_so(files: Callable[..., object]) -> None:
    study = files()
    edit(study.ratings, lambda frame: frame.assign(rejected=frame.index < 7))
    table = read(study)
    assert len(table.rows) == 6 * 2 * 2 * 48 - 7
    assert table.notes == ("7 judgements marked as rejected are left out.",)


def test_without_trials_the_repeat_tells_judgements_apart(files: Callable[..., object]) -> None:
    study = files()
    edit(study.ratings, lambda frame: frame.drop(columns=["trial", "block"]))
    assert read(study).notes == ()
    edit(study.ratings, lambda frame: pd.concat([frame, frame.iloc[[4]]]))
    with pytest.raises(
        ValueError, match=r"ratings.csv, line 1154: repeat must occur once with the same"
    ):
        read(study)


def test_a_missing_file_is_an_oserror_that_names_it(files: Callable[..., object]) -> None:
    study = files()
    study.manifest.unlink()
    with pytest.raises(OSError, match=re.escape(os.fspath(study.manifest))):
        read(study)


def add_columns(study: object, **columns: object) -> None:
    edit(study.manifest, lambda frame: frame.assign(**columns))


def test_the_bounded_metric_is_primary_and_the_papers_is_explored(
    files: Callable[..., object],
) -> None:
    study = files()
    add_columns(study, spectral_match_bounded=0.5)
    table = read(study)
    assert table.metrics == ("spectral_match_bounded", "temporal_match")
    assert "spectral_match" in table.further


def test_any_numeric_column_may_be_declared(files: Callable[..., object]) -> None:
    study = files()
    add_columns(study, roughness=lambda frame: frame["temporal_match"] * 40 + 3)
    table = read_table(study.ratings, study.manifest, metrics=["roughness", "spectral_match"])
    assert table.metrics == ("roughness", "spectral_match")
    assert "temporal_match" in table.further
    manifest = pd.read_csv(study.manifest, index_col="stimulus_id")["roughness"]
    assert list(table.rows["roughness"].fillna(0)) == list(
        manifest[table.rows["stimulus_id"]].fillna(0)
    )


@pytest.mark.parametrize(
    ("metrics", "message"),
    [
        (["loudness"], "got no column 'loudness' as a metric; its numeric columns are spectral_match, temporal_match"),
        (["reducer", "temporal_match"], "got no numbers in column 'reducer' as a metric; its numeric columns are"),
        (["level"], "got no numbers in column 'level' as a metric"),
        (
            ["temporal_match", "temporal_match"],
            "metrics must be one name or more, each once, got temporal_match, temporal_match",
        ),
        (["spectral_match_bounded"], "(build the set again, or use spectral_match)"),
    ],
)  # fmt: skip
def test_metrics_that_a_manifest_does_not_have(
    files: Callable[..., object], metrics: list[str], message: str
) -> None:
    study = files()
    with pytest.raises(ValueError, match=re.escape(message)) as caught:
        read_table(study.ratings, study.manifest, metrics=metrics)
    assert "\n" not in str(caught.value)


def test_without_any_metric_the_numeric_columns_are_listed(files: Callable[..., object]) -> None:
    study = files()
    edit(
        study.manifest,
        lambda frame: frame.drop(columns=["spectral_match", "temporal_match"]).assign(mine=0.5),
    )
    with pytest.raises(ValueError, match=r"--metric\); its numeric columns are mine$"):
        read(study)
