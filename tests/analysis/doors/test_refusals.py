"""What cannot be analysed gets one line that names file, line and column, what was got, and what to do."""

import csv
import gzip
import io
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from feel321.analysis.table.reading import read_ratings, read_table

Change = Callable[[pd.DataFrame], pd.DataFrame]


@pytest.fixture(scope="module")
def texts() -> dict[str, str]:
    """Two small tables without a fault."""
    stimuli = [
        ("r", "mag321", "test"),
        ("r", "dft321", "test"),
        ("s", "mag321", "test"),
        ("r", "original", "reference"),
    ]
    manifest = pd.DataFrame(stimuli, columns=["recording", "reducer", "role"])
    manifest.insert(0, "stimulus_id", manifest["recording"] + "_" + manifest["reducer"])
    manifest = manifest.assign(
        level="as_is", spectral_match=[0.2, 0.9, 0.5, ""], temporal_match=[0.1, 0.8, 0.4, ""]
    )
    ratings = pd.concat(
        [manifest[["stimulus_id", "recording", "reducer", "level"]]] * 2, ignore_index=True
    )
    ratings = ratings.assign(
        participant=["p1"] * 4 + ["p2"] * 4, session=1, protocol="realism", block=1
    )
    ratings = ratings.assign(trial=[1, 2, 3, 4] * 2, repeat=1, reference_id="", scale="realism")
    ratings["rating"] = [10.5, 80, 40, 90, 20, 70, 50, 100]
    ratings = ratings.assign(
        response_time_s=1.5, onset_s=2.5, underruns=0, rejected="false", simulated="false"
    )
    return {"ratings": ratings.to_csv(index=False), "manifest": manifest.to_csv(index=False)}


@pytest.fixture
def refuse(texts: dict[str, str], tmp_path: Path) -> Callable[..., str]:
    """Put a file in the place of a good one, and return the line that it is refused with."""

    def try_to_read(**contents: bytes) -> str:
        for name, text in texts.items():
            (tmp_path / f"{name}.csv").write_bytes(contents.get(name, text.encode()))
        with pytest.raises(ValueError, match=r"\.csv") as caught:
            read_table(tmp_path / "ratings.csv", tmp_path / "manifest.csv")
        message = str(caught.value)
        assert "\n" not in message
        assert len(message) < 330
        assert "Traceback" not in message
        return message

    return try_to_read


def cell(column: str, value: object, row: int = 0) -> Callable[[pd.DataFrame], pd.DataFrame]:
    def change(frame: pd.DataFrame) -> pd.DataFrame:
        frame.loc[row, column] = value
        return frame

    return change


def alter(text: str, change: Callable[[pd.DataFrame], pd.DataFrame]) -> bytes:
    frame = pd.read_csv(io.StringIO(text), dtype=str, na_filter=False)
    return change(frame).to_csv(index=False).encode()


def test_the_tables_are_good(texts: dict[str, str], tmp_path: Path) -> None:
    for name, text in texts.items():
        (tmp_path / f"{name}.csv").write_text(text)
    table = read_table(tmp_path / "ratings.csv", tmp_path / "manifest.csv")
    assert table.notes == ()
    assert list(table.rows["rating"]) == [10.5, 80, 40, 90, 20, 70, 50, 100]


FOREIGN = [
    (lambda _: b"", "the file is empty; its first line must name the columns participant, stimulus_id, scale, rating"),
    (lambda t: t.splitlines()[0].encode(), "got no rows below the header"),
    (lambda t: t.replace(",", ";").encode(), "its columns are separated by semicolons: save it with commas, and with"),
    (lambda t: t.replace(",", "\t").encode(), "its columns are separated by tabs"),
    (lambda t: t.replace(",", "|").encode(), "its columns are separated by bars"),
    (lambda t: t.encode("utf-16"), "the text is in UTF-16; save the file as UTF-8"),
    (lambda t: t.encode("utf-16-le"), "line 1 holds a zero byte"),
    (lambda t: t.replace("p2", "J\xf6rg").encode("latin-1"), "which is not UTF-8"),
    (lambda t: gzip.compress(t.encode()), "must be plain UTF-8 text, got a gzip file; unpack it first"),
    (
        lambda t: b"PK\x03\x04" + t.encode(),
        "must be plain UTF-8 text, got an Excel or other zipped file; save the sheet as CSV",
    ),
    (lambda t: b"\xd0\xcf\x11\xe0" + t.encode(), "got an old Excel file"),
    (lambda t: t.encode() + b"\n" * 600 + b"\0", "line 610 holds a zero byte"),
    (lambda t: t.replace("p1", '"p1', 1).encode(), "not a regular CSV file, correct lines or quotes"),
    (lambda t: t.replace("p1", '"p1"x', 1).encode(), "not a regular CSV file, correct lines or quotes"),
    (
        lambda t: t.replace("p1", "p" * 200_000, 1).encode(),
        "not a regular CSV file, correct lines or quotes (field larger than field limit",
    ),
    (
        lambda t: ("# my ratings\n" + t).encode(),
        "line 1: column participant, stimulus_id, scale, rating is missing; got",
    ),
    (lambda t: ("sep=,\n" + t).encode(), "line 1: column participant, stimulus_id, scale, rating is missing; got"),
    (lambda t: ("\n" + t).encode(), "line 1 is blank; its first line must name the columns"),
    (lambda _: b"<!DOCTYPE html>\n<p>", "its first line must name the columns, separated by commas"),
    (lambda t: t.encode()[:-30], "line 9: must have 18 cells like the header, got 12; is the file cut off?"),
    (lambda t: (t + "total,8\n").encode(), "line 10: must have 18 cells like the header, got 2; is the file cut off?"),
    (
        lambda t: t.replace("10.5", "10,5").encode(),
        "line 2: must have 18 cells like the header, got 19; put a cell that holds a comma in",
    ),
]  # fmt: skip


@pytest.mark.parametrize(("damage", "message"), FOREIGN)
def test_files_that_are_no_comma_separated_text(
    refuse: Callable[..., str], texts: dict[str, str], damage: Callable[[str], bytes], message: str
) -> None:
    told = refuse(ratings=damage(texts["ratings"]))
    assert told.startswith("ratings.csv")
    assert message in told


RATINGS = [
    (lambda f: f.drop(columns="rating"), "line 1: column rating is missing; got"),
    (lambda f: f.rename(columns={"rating": "Rating"}), "line 1: column 'Rating' must be spelt 'rating'; rename or"),
    (lambda f: f.rename(columns={"rejected": " rejected "}), "line 1: column ' rejected ' must be spelt"),
    (lambda f: f.rename(columns={"stimulus_id": "Stimulus ID"}), "line 1: column 'Stimulus ID' must be spelt"),
    (lambda f: f.assign(again=f["rating"]).rename(columns={"again": "rating"}), "column rating appears more than once"),
    *((cell("rating", text), f"line 2: rating must be a finite number, got {text!r}; correct it or leave")
      for text in ("", "nan", "inf", "-inf", "1e400", "good", "50%", "10,5", "0x1A", "1_0", "1 0", "True", "５０")),
    (cell("rating", "-1"), "line 2: rating must be 0 to 100, got '-1'; rescale what was asked on another scale"),
    (cell("rating", "101", 3), "line 5: rating must be 0 to 100, got '101'; rescale what was asked on another scale"),
    (cell("rating", "1e308"), "line 2: rating must be 0 to 100, got '1e308'; rescale what was asked on another scale"),
    (cell("scale", "abx"), "line 2: rating must be 100 (right) or 0 (wrong) on scale 'abx', got 10.5"),
    (lambda f: pd.concat([f, f.iloc[[4]]]), "line 10: trial must occur once with the same participant, session,"),
    (lambda f: pd.concat([f, f.iloc[[4]]]).drop(columns="trial"), "line 10: repeat must occur once with the same"),
    (cell("trial", ""), "line 2: trial must not be empty, got ''; name it"),
    (cell("repeat", ""), "line 2: repeat must not be empty, got ''; name it"),
    (cell("stimulus_id", "ghost"), "line 2: stimulus_id must be a stimulus of manifest.csv, got 'ghost'; is it the"),
    (cell("stimulus_id", "g" * 999), "line 2: stimulus_id must be a stimulus of manifest.csv, got"),
    (cell("reducer", "say321"), "line 2: reducer must be 'mag321', as manifest.csv says of that stimulus, got"),
    (cell("recording", "s"), "line 2: recording must be 'r', as manifest.csv says of that stimulus, got 's'; correct"),
    (cell("level", ""), "line 2: level must be 'as_is', as manifest.csv says of that stimulus, got ''; correct"),
    (cell("participant", ""), "line 2: participant must not be empty, got ''; name it"),
    (cell("participant", "p1\u00a0"), "line 2: participant must not begin or end with a blank, got 'p1\\xa0';"),
    (cell("participant", "p\n1"), "line 2: participant must not hold control characters, got"),
    (cell("scale", "real\x07ism"), "line 2: scale must not hold control characters, got"),
    (cell("rejected", "perhaps"), "line 2: rejected must be true, false, 1, 0, yes, no or empty, got 'perhaps'"),
    (lambda f: f.assign(rejected="yes"), "all 8 judgements are marked as rejected; one must be valid"),
    (cell("simulated", "?"), "line 2: simulated must be true, false, 1, 0, yes, no or empty, got '?'"),
    (cell("simulated", "true"), "line 2: participant must be simulated in all of its lines or in none, got 'p1'"),
    (cell("underruns", "-1"), "line 2: underruns must be a count (0, 1, 2, ...) or empty, got '-1'"),
    (cell("underruns", "0.5"), "line 2: underruns must be a count (0, 1, 2, ...) or empty, got '0.5'"),
    (cell("underruns", "many"), "line 2: underruns must be a finite number, got 'many'; correct it or leave the"),
    (cell("response_time_s", "-0.1"), "line 2: response_time_s must be 0 or more, in seconds, or empty, got '-0.1'"),
    (cell("response_time_s", "nan"), "line 2: response_time_s must be a finite number, got 'nan'; correct it or"),
    (cell("scale", "triplet"), "line 2: rating must be 100 (stimulus_id was chosen) or 0 (other_id was chosen)"),
    (lambda f: f.assign(scale="triplet", rating="100"), "other_id must name the second of the two stimuli on scale"),
    (lambda f: f.assign(scale="preference", rating="0", other_id=f["stimulus_id"]), "other_id must name the second of"),
    (lambda f: f.assign(scale="preference", rating="0", other_id="ghost"), "other_id must be a stimulus of"),
    (lambda f: f.assign(other_id=f["stimulus_id"]), "other_id must be empty but on scale 'triplet'"),
    (lambda f: f.assign(scale="dissimilarity", reference_id="ghost"), "lines 2, 3, 4 and 5 more: reference_id must"),
]  # fmt: skip


@pytest.mark.parametrize(("change", "message"), RATINGS)
def test_ratings_that_cannot_be(
    refuse: Callable[..., str], texts: dict[str, str], change: Change, message: str
) -> None:
    told = refuse(ratings=alter(texts["ratings"], change))
    assert told.startswith("ratings.csv")
    assert message in told


MANIFEST = [
    (lambda f: f.drop(columns="reducer"), "line 1: column reducer is missing; got"),
    (
        lambda f: f.rename(columns={"spectral_match": "Spectral_Match"}),
        "line 1: column 'Spectral_Match' must be spelt 'spectral_match'; rename or remove it",
    ),
    (lambda f: f.drop(columns=["spectral_match", "temporal_match"]), "got no metric; at least one of the columns spec"),
    (lambda f: f.assign(spectral_match="", temporal_match=""), "got no metric; at least one of the columns spectral"),
    (lambda f: pd.concat([f, f.iloc[[0]]]), "line 6: stimulus_id must be listed once, got"),
    (cell("role", "Test"), "line 2: role must be one of test, reference, anchor, got 'Test'"),
    (cell("role", ""), "line 2: role must be one of test, reference, anchor, got ''"),
    (
        cell("role", "test", 3),
        "line 5: spectral_match must be a finite number, got ''; correct it or leave the row out",
    ),
    (
        cell("spectral_match", "nan"),
        "line 2: spectral_match must be a finite number, got 'nan'; correct it or leave the row",
    ),
    (
        cell("temporal_match", "-inf", 1),
        "line 3: temporal_match must be a finite number, got '-inf'; correct it or leave the row",
    ),
    (cell("spectral_match", "-1e300"), "line 2: spectral_match must be no more than 1e+12 in size, got '-1e300'"),
    (cell("recording", ""), "line 2: recording must not be empty, got ''; name it"),
    (cell("reducer", "mag321 "), "line 2: reducer must not begin or end with a blank, got 'mag321 '; remove it"),
    (cell("level", ""), "line 2: level must not be empty, got ''; name it"),
    (lambda f: f.assign(source=["a", "b", "c", "a"]), "line 3: source must be one per recording, got 'b'"),
]  # fmt: skip


@pytest.mark.parametrize(("change", "message"), MANIFEST)
def test_manifests_that_cannot_be(
    refuse: Callable[..., str], texts: dict[str, str], change: Change, message: str
) -> None:
    told = refuse(manifest=alter(texts["manifest"], change))
    assert told.startswith("manifest.csv")
    assert message in told


def test_files_in_each_others_place(refuse: Callable[..., str], texts: dict[str, str]) -> None:
    told = refuse(ratings=texts["manifest"].encode(), manifest=texts["ratings"].encode())
    assert told.startswith("manifest.csv: got no metric")


def test_lines_are_those_of_the_file_where_cells_hold_line_breaks(
    refuse: Callable[..., str], texts: dict[str, str]
) -> None:
    frame = pd.read_csv(io.StringIO(texts["ratings"]), dtype=str, na_filter=False)
    frame["remark"] = np.where(frame.index == 1, "two\nlines", "one")
    frame.loc[[1, 3], "rating"] = "good"
    text = frame.to_csv(index=False, quoting=csv.QUOTE_ALL)
    assert text.splitlines()[2].count("good") == text.splitlines()[5].count("good") == 1
    assert (
        "lines 3, 6: rating must be a finite number, got 'good'; correct it or leave the row out"
        in refuse(ratings=text.encode())
    )


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no named pipes here")
def test_a_pipe_is_refused_at_once(tmp_path: Path) -> None:
    os.mkfifo(path := tmp_path / "ratings.csv")
    with pytest.raises(ValueError, match=r"ratings\.csv: must be a regular file"):
        read_ratings(path, "ratings.csv")
