"""The verb: what it writes and prints, on a small study; how it refuses."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import numpy as np
import pytest

from feel321.analysis.tradeoff.chart import compute, cost
from feel321.stimuli.sets.manifest import read_stimuli
from feel321.study.analyze import find_ratings
from feel321.study.cli import main
from feel321.study.folder import StudyFolder

if TYPE_CHECKING:
    from pathlib import Path

    Capture = pytest.CaptureFixture[str]

STUDY = """
[study]
seed = 5
[[recordings]]
scene = "bumps"
duration_s = 0.3
[stimuli]
reducers = ["soc321", "dft321"]
"""


@pytest.fixture
def study(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    folder = tmp_path / "study"
    folder.mkdir()
    (folder / "study.toml").write_text(STUDY)
    tiny = compute.Effort(
        "quick", longest_s=0.2, rotations=2, sweep_rotations=2, largest_n=5000, rounds=3
    )
    monkeypatch.setattr(compute, "QUICK", tiny)
    for name, short in (
        ("REFERENCE_N", 5000),
        ("RATE_DURATION_S", 0.1),
        ("CALLS", 5),
        ("FRAMES", 1),
    ):
        monkeypatch.setattr(cost, name, short)
    # Whole figures are saved in tests/analysis/chart.
    monkeypatch.setattr("feel321.analysis.report.folder.save_figure", save_nothing)
    return folder


def save_nothing(_figure: object, stem: Path) -> None:
    for suffix, text in ((".svg", '<svg xmlns="http://www.w3.org/2000/svg"></svg>'), (".png", "")):
        stem.with_name(f"{stem.name}{suffix}").write_text(text, encoding="utf-8")


def write_ratings(study: Path) -> None:
    """Ratings from elsewhere, for the study's own stimuli."""
    folder = StudyFolder(study)
    lines = ["participant,stimulus_id,scale,rating,trial"]
    tests = [row.stimulus_id for row in read_stimuli(folder.stimuli).stimuli if row.role == "test"]
    lines += [
        f"P0{person},{one},realism,{40 + 10 * k + person},{k}"
        for person in (1, 2)
        for k, one in enumerate(tests)
    ]
    folder.ratings.write_text("\n".join(lines) + "\n")


def test_a_study_without_ratings_is_charted_with_its_own_seed(study: Path, capsys: Capture) -> None:
    assert main(["chart", str(study)]) == 0
    assert capsys.readouterr().out == f"{study / 'chart' / 'index.html'}\n"
    chart = json.loads((study / "chart" / "results.json").read_text(encoding="utf-8"))
    assert (chart["seed"], chart["rated"]) == (5, [])
    assert [scene["name"] for scene in chart["scenes"]] == ["bumps"]


def test_ratings_recordings_seed_and_folder_are_taken_as_told(
    study: Path, tmp_path: Path, capsys: Capture
) -> None:
    assert main(["build", str(study)]) == 0
    write_ratings(study)
    other = tmp_path / "other.npz"
    samples = np.random.default_rng(0).standard_normal((3, 500))
    np.savez(other, acceleration=samples, rate_hz=2500.0, unit="m/s^2")
    capsys.readouterr()
    target = tmp_path / "elsewhere"
    options = ["--recordings", str(other), "-o", str(target), "--seed", "9", "--json"]
    assert main(["chart", str(study), *options]) == 0
    content = json.loads(capsys.readouterr().out)
    assert content == json.loads((target / "results.json").read_text(encoding="utf-8"))
    assert (content["seed"], [scene["name"] for scene in content["scenes"]]) == (
        9,
        ["bumps", "other"],
    )
    assert {row["reducer"]: row["mean"] for row in content["rated"]} == {
        "soc321": 41.5,
        "dft321": 51.5,
    }
    assert "figures/rated_realism_as_is.svg" in content["files"]


def test_ratings_are_found_once_there_are_any(study: Path) -> None:
    assert find_ratings(StudyFolder(study)) is None
    assert main(["build", str(study)]) == 0
    assert find_ratings(StudyFolder(study)) is None
    write_ratings(study)
    table = find_ratings(StudyFolder(study))
    assert table is not None
    assert sorted(table.rows["rating"]) == [41, 42, 51, 52]


def test_ratings_are_derived_from_the_journals_where_there_are_some(study: Path) -> None:
    assert main(["build", str(study)]) == 0
    assert main(["simulate", str(study), "--participants", "1", "--seed", "0"]) == 0
    folder = StudyFolder(study)
    folder.ratings.unlink()
    table = find_ratings(folder)
    assert table is not None
    assert bool(table.rows["simulated"].all())
    assert folder.ratings.is_file()


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (["{folder}/nowhere"], 1, "nowhere: no such folder; check the name"),
        (["{folder}"], 1, "or give --scenes or --recordings FILE, which need none"),
        (
            ["{folder}", "--recordings", "{folder}/nothing.csv"],
            1,
            "nothing.csv: there is no such file",
        ),
        (["{folder}", "--seed", "-1"], 2, "-1 is not in the range 0<=x"),
        (["{folder}", "--recordings", ""], 2, "a name must not be empty"),
    ],
)
def test_bad_use_is_one_line(
    arguments: list[str], code: int, message: str, tmp_path: Path, capsys: Capture
) -> None:
    assert main(["chart", *(argument.format(folder=tmp_path) for argument in arguments)]) == code
    out, err = capsys.readouterr()
    assert (out, len(err.splitlines())) == ("", 1)
    assert message in err
