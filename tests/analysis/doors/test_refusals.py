"""What cannot be analysed gets one line that names file, line and column, what was got, and what to do."""

from __future__ import annotations

import csv
import gzip
import io
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
import pytest

from feel321.analysis.table.reading import read_table

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

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
    (
        lambda _: b"",
        "the file is empty; its first line must name the columns participant, stimulus_id, scale, rating",
    ),
    (lambda t: t.splitlines()[0].encode(), "got no rows below the header"),
    (
        lambda t: t.replace(",", ";").encode(),
        "its columns are separated by semicolons: save it with commas, and with",
    ),
    (lambda t: t.replace(",", "\t").encode(), "its columns are separated by tabs"),
    (lambda t: t.replace(",", "|").encode(), "its columns are separated by bars"),
    (lambda t: t.encode("utf-16"), "got UTF-16 text, allowed is UTF-8; save it as CSV (UTF-8)"),
    (lambda t: t.encode("utf-16-le"), "got bytes that are no UTF-8 text (zeros)"),
    (lambda t: t.replace("p2", "J\xf6rg").encode("latin-1"), "not UTF-8 text (invalid"),
    (
        lambda t: gzip.compress(t.encode()),
        "got a gzip file, allowed is plain text; unpack it first",
    ),
    (
        lambda t: b"PK\x03\x04" + t.encode(),
        "got an Excel or other zipped file, allowed is plain text; save the sheet",
    ),
    (lambda t: b"\xd0\xcf\x11\xe0" + t.encode(), "got an old Excel file"),
    (
        lambda t: t.encode() + b"\n" * 600 + b"\0",
        "line 610: got a zero byte, allowed is text; is the file damaged?",
    ),
    (lambda t: t.replace("p1", '"p1', 1).encode(), "not a regular CSV file, mend lines or quotes"),
    (
        lambda t: t.replace("p1", '"p1"x', 1).encode(),
        "not a regular CSV file, mend lines or quotes",
    ),
    (
        lambda t: t.replace("p1", "p" * 200_000, 1).encode(),
        "not a regular CSV file, mend lines or quotes (field larger",
    ),
    (
        lambda t: ("# my ratings\n" + t).encode(),
        "line 1: column participant, stimulus_id, scale, rating is missing; got",
    ),
    (
        lambda t: ("sep=,\n" + t).encode(),
        "line 1: column participant, stimulus_id, scale, rating is missing; got",
    ),
    (lambda t: ("\n" + t).encode(), "line 1 is blank; its first line must name the columns"),
    (
        lambda _: b"<!DOCTYPE html>\n<p>",
        "its first line must name the columns, separated by commas",
    ),
    (
        lambda t: t.encode()[:-30],
        "line 9: got 12 cells, but the header has 18; is the file cut off?",
    ),
    (lambda t: (t + "total,8\n").encode(), "line 10: got 2 cells, but the header has 18"),
    (
        lambda t: t.replace("10.5", "10,5").encode(),
        "line 2: got 19 cells, but the header has 18; put a cell that holds",
    ),
]


@pytest.mark.parametrize(("damage", "message"), FOREIGN)
def test_files_that_are_no_comma_separated_text(
    refuse: Callable[..., str], texts: dict[str, str], damage: Callable[[str], bytes], message: str
) -> None:
    told = refuse(ratings=damage(texts["ratings"]))
    assert told.startswith("ratings.csv")
    assert message in told


RATINGS = [
    (lambda f: f.drop(columns="rating"), "line 1: column rating is missing; got"),
    (lambda f: f.rename(columns={"rating": "Rating"}), "got column 'Rating', allowed is 'rating'; rename or remove it"),
    (lambda f: f.rename(columns={"rejected": " rejected "}), "got column ' rejected ', allowed is 'rejected'"),
    (lambda f: f.rename(columns={"stimulus_id": "Stimulus ID"}), "got column 'Stimulus ID', allowed is 'stimulus_id'"),
    (lambda f: f.assign(again=f["rating"]).rename(columns={"again": "rating"}), "column rating appears more than once"),
    *((cell("rating", text), f"line 2: got {text!r} in column 'rating', allowed is a finite number; mend it or leave")
      for text in ("", "nan", "inf", "-inf", "1e400", "good", "50%", "10,5", "0x1A", "1_0", "1 0", "True", "５０")),
    (cell("rating", "-1"), "line 2: got -1 in column 'rating', allowed is 0 to 100; rescale what was asked on another"),
    (cell("rating", "101", 3), "line 5: got 101 in column 'rating', allowed is 0 to 100"),
    (cell("rating", "1e308"), "line 2: got 1e+308 in column 'rating', allowed is 0 to 100"),
    (cell("scale", "abx"), "got 10.5 in column 'rating' of scale 'abx', allowed is 100 (right) or 0 (wrong)"),
    (lambda f: pd.concat([f, f.iloc[[4]]]), "line 10: got '1' in column 'trial', but an earlier line has the same"),
    (lambda f: pd.concat([f, f.iloc[[4]]]).drop(columns="trial"), "line 10: got '1' in column 'repeat', but an earlie"),
    (cell("trial", ""), "line 2: got '' in column 'trial', which must not be empty; name it"),
    (cell("repeat", ""), "line 2: got '' in column 'repeat', which must not be empty"),
    (cell("stimulus_id", "ghost"), "line 2: got 'ghost' in column 'stimulus_id', which manifest.csv does not know; is"),
    (cell("stimulus_id", "g" * 999), "ggg' in column 'stimulus_id', which manifest.csv does not know"),
    (cell("reducer", "say321"), "got 'say321' in column 'reducer', but manifest.csv says 'mag321' of that stimulus"),
    (cell("recording", "s"), "got 's' in column 'recording', but manifest.csv says 'r' of that stimulus; mend"),
    (cell("level", ""), "got '' in column 'level', but manifest.csv says 'as_is' of that stimulus; mend"),
    (cell("participant", ""), "line 2: got '' in column 'participant', which must not be empty"),
    (cell("participant", "p1\u00a0"), "line 2: got 'p1\\xa0' in column 'participant', which must not begin or end wit"),
    (cell("participant", "p\n1"), "line 2: got 'p\\n1' in column 'participant', which must not hold line breaks"),
    (cell("scale", "real\x07ism"), "which must not hold line breaks or other control characters; remove them"),
    (cell("rejected", "perhaps"), "got 'perhaps' in column 'rejected', allowed is true, false, 1, 0, yes, no or nothi"),
    (lambda f: f.assign(rejected="yes"), "all 8 judgements are marked as rejected; one must be valid"),
    (cell("simulated", "?"), "got '?' in column 'simulated', allowed is true, false"),
    (cell("simulated", "true"), "line 2: got 'p1' in column 'participant' as simulated, but as a person in other line"),
    (cell("underruns", "-1"), "got '-1' in column 'underruns', allowed is a count (0, 1, 2, ...) or nothing"),
    (cell("underruns", "0.5"), "got '0.5' in column 'underruns', allowed is a count"),
    (cell("underruns", "many"), "got 'many' in column 'underruns', allowed is a finite number"),
    (cell("response_time_s", "-0.1"), "got '-0.1' in column 'response_time_s', allowed is 0 or more, in seconds"),
    (cell("response_time_s", "nan"), "got 'nan' in column 'response_time_s', allowed is a finite number"),
    (lambda f: f.assign(scale="dissimilarity", reference_id="ghost"), "got 'ghost' in column 'reference_id' of a diss"),
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
        "got column 'Spectral_Match', allowed is 'spec",
    ),
    (
        lambda f: f.drop(columns=["spectral_match", "temporal_match"]),
        "got no metric; at least one of the columns spec",
    ),
    (
        lambda f: f.assign(spectral_match="", temporal_match=""),
        "got no metric; at least one of the columns spectral",
    ),
    (
        lambda f: pd.concat([f, f.iloc[[0]]]),
        "line 6: got 'r_mag321' in column 'stimulus_id', but an earlier line lists",
    ),
    (
        cell("role", "Test"),
        "line 2: got 'Test' in column 'role', allowed is test, reference, anchor",
    ),
    (cell("role", ""), "line 2: got '' in column 'role', allowed is test, reference, anchor"),
    (
        cell("role", "test", 3),
        "line 5: got '' in column 'spectral_match', allowed is a finite number; mend it or leave",
    ),
    (
        cell("spectral_match", "nan"),
        "line 2: got 'nan' in column 'spectral_match', allowed is a finite number",
    ),
    (
        cell("temporal_match", "-inf", 1),
        "line 3: got '-inf' in column 'temporal_match', allowed is a finite number",
    ),
    (
        cell("spectral_match", "-1e300"),
        "got '-1e300' in column 'spectral_match', allowed is 1 or less and no more than",
    ),
    (cell("recording", ""), "line 2: got '' in column 'recording', which must not be empty"),
    (
        cell("reducer", "mag321 "),
        "got 'mag321 ' in column 'reducer', which must not begin or end with a blank",
    ),
    (cell("level", ""), "line 2: got '' in column 'level', which must not be empty"),
    (
        lambda f: f.assign(source=["a", "b", "c", "a"]),
        "line 3: got 'b' in column 'source', but an earlier line of its",
    ),
]


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
    assert "lines 3, 6: got 'good'" in refuse(ratings=text.encode())
