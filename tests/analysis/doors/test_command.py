"""The command itself: one line for what cannot be, and a page for what little can be."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from feel321.analysis.report.write import write_report
from feel321.study.cli import main

Change = Callable[[pd.DataFrame], pd.DataFrame]
Capture = pytest.CaptureFixture[str]

FEW = ("mag321", "pca321", "dft321", "original", "anchor_low")


def edit(path: Path, change: Change) -> None:
    change(pd.read_csv(path, dtype=str, na_filter=False)).to_csv(path, index=False)


@pytest.fixture
def small(files: Callable[..., object]) -> object:
    """Three people, three recordings, three reducers."""
    study = files(participants=3, recordings=3, repeats=2, scales=("realism",))
    for path in (study.ratings, study.manifest):
        edit(path, lambda frame: frame[frame["reducer"].isin(FEW)])
    return study


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return tmp_path / "a folder"


def spoil(study: object, how: str) -> None:
    for path in (study.ratings,) if "ratings" in how else (study.manifest,):
        text = path.read_text()
        path.unlink()
        if "folder" in how:
            path.mkdir()
        if "semicolons" in how:
            path.write_text(text.replace(",", ";"))
        if "dangling" in how:
            path.symlink_to(path.with_name("nowhere"))
        if "cut" in how:
            path.write_text(text[: len(text) // 2].rstrip("\n,"))
        if "twice" in how:
            path.write_text(text + text.split("\n", 1)[1])


@pytest.mark.parametrize(
    ("how", "message"),
    [
        ("ratings missing", "ratings.csv: No such file or directory; check the name"),
        ("ratings folder", "ratings.csv: is a folder, not a file; check the name"),
        ("ratings dangling", "ratings.csv: No such file or directory"),
        ("ratings semicolons", "ratings.csv, line 1: column participant, stimulus_id, scale, rating is missing; got"),
        ("ratings cut", "ratings.csv, line "),
        ("ratings twice", "and 87 more: trial must occur once with the same"),
        ("manifest missing", "manifest.csv: No such file or directory"),
        ("manifest twice", "and 12 more: stimulus_id must be listed once, got 'rec0_mag321_as_is'"),
    ],
)  # fmt: skip
def test_what_cannot_be_read_is_one_line_and_no_report(
    small: object, tmp_path: Path, capsys: Capture, how: str, message: str
) -> None:
    spoil(small, how)
    out = tmp_path / "report"
    tables = ["--ratings", str(small.ratings), "--manifest", str(small.manifest), "--out", str(out)]
    assert main(["analyze", *tables]) == 1
    told = capsys.readouterr()
    assert told.out == ""
    (line,) = told.err.splitlines()
    assert line.startswith("feel321: ")
    assert message in line
    assert "unexpected" not in line
    assert not out.exists()


def set_ratings(make: Callable[[pd.DataFrame], object]) -> Change:
    return lambda frame: frame.assign(rating=make(frame))


REDUCED = {
    "one participant": (lambda f: f[f["participant"] == "p00"], "One participant only: no interval"),
    "one recording": (lambda f: f[f["recording"] == "rec0"], "One recording only: no two-way interval"),
    "one reducer": (lambda f: f[f["reducer"] == "dft321"], "reducers are not compared. Only one was rated, 'dft321'."),
    "one of each": (
        lambda f: f[(f["recording"] == "rec0") & (f["participant"] == "p00")],
        "got one participant and one recording",
    ),
    "one judgement": (lambda f: f[f["reducer"] == "dft321"].iloc[:1], "No correlation: it needs 3 test stimuli, got"),
    "all alike": (set_ratings(lambda _: "50"), "no primary model. data must have a response with scatter"),
    "each rater alike": (
        set_ratings(lambda f: f["participant"].map({"p00": "5", "p01": "50", "p02": "95"})),
        "got a response that the random effects give exactly",
    ),
    "one rater alike": (
        set_ratings(lambda f: f["rating"].mask(f["participant"] == "p00", "50")),
        "Associations leave out 18 judgements of stimuli with role 'anchor'.",
    ),
    "hardly anything": (lambda f: f.iloc[:: len(f) // 7], "participant x stimulus cells hold no rating."),
    "everyone once": (
        lambda f: f.assign(participant=[f"q{number}" for number in range(len(f))]), "no primary model. data must have",
    ),
    "own recording each": (
        lambda f: f[f["recording"].str[-1] == f["participant"].str[-1]], "participant x stimulus cells hold no rating."
    ),
    "no partner": (lambda f: f.assign(scale="dissimilarity"), "dissimilarity, as is: no map. No judgement names two"),
    "against a reducer": (
        lambda f: f.assign(reference_id=f["recording"] + "_dft321_as_is"),
        "were made against what 'dft321' made of the recording; the metrics compare with the recording: none enters",
    ),
    "right or wrong": (
        lambda f: f.assign(scale="abx", rating=np.where(f.index % 3, "100", "0")), "none of its 90 judgements enters",
    ),
}  # fmt: skip


SLOW = {
    "one participant", "one recording", "one rater alike", "everyone once", "own recording each", "extreme",
    "alike",
}  # fmt: skip
"""Those that have a mixed model, which is fitted many times over."""


def list_cases(cases: dict[str, tuple[Change, str]]) -> list[object]:
    return [
        pytest.param(*case, id=name, marks=[pytest.mark.soak] if name in SLOW else [])
        for name, case in cases.items()
    ]


@pytest.mark.usefixtures("sketched")
@pytest.mark.parametrize(("change", "note"), list_cases(REDUCED))
def test_what_little_there_is_becomes_a_page(
    small: object, folder: Path, change: Change, note: str
) -> None:
    edit(small.ratings, change)
    results = write_report(small.ratings, small.manifest, folder, draws=2, rng=0)
    assert any(note in told for told in results.notes)
    assert all("\n" not in told for told in results.notes)
    assert results.headline
    assert (folder / "index.html").is_file()
    written = json.loads((folder / "results.json").read_text(encoding="utf-8"))
    assert written["notes"] == list(results.notes)
