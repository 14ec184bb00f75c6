"""The verb: what it writes and prints, on a small study; how it refuses."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from feel321.analysis.tradeoff import cost, measure
from feel321.stimuli.sets.manifest import read_stimuli
from feel321.study.cli import main
from feel321.study.folder import StudyFolder
from feel321.study.settings.read import edit_settings

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
    tiny = measure.Effort(longest_s=0.2, mountings=2, draws=1, rounds=3, takes=0)
    monkeypatch.setattr(measure, "QUICK", tiny)
    monkeypatch.setattr(cost, "BLOCKS", 10)
    # Whole figures are saved in tests/analysis/tradeoff.
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


def read(folder: Path) -> dict[str, Any]:
    return json.loads((folder / "results.json").read_text(encoding="utf-8"))


OWN = """
[metrics.loudness]
use = "methods/own.py:loudness"
[reducers.twice]
use = "methods/own.py:twice"
"""
METHODS = """
def twice(acceleration, rate_hz):
    return 2 * acceleration[0]

def loudness(acceleration, reduced, rate_hz):
    return float((reduced ** 2).mean())
"""


def test_ratings_recordings_own_methods_seed_and_folder_are_taken_as_told(
    study: Path, tmp_path: Path, capsys: Capture
) -> None:
    edit_settings(study / "study.toml", {"analysis.margin": 5.0})
    (study / "methods").mkdir()
    (study / "methods" / "own.py").write_text(METHODS)
    (study / "study.toml").write_text((study / "study.toml").read_text() + OWN)
    assert main(["build", str(study)]) == 0
    write_ratings(study)
    other = tmp_path / "other.npz"
    samples = np.random.default_rng(0).standard_normal((3, 500))
    np.savez(other, acceleration=samples, rate_hz=2500.0, unit="m/s^2")
    capsys.readouterr()
    target = tmp_path / "elsewhere"
    options = ["--online", "--out", str(target), "--seed", "9", "--json"]
    assert main(["tradeoff", str(study), str(other), *options]) == 0
    content = json.loads(capsys.readouterr().out)
    assert content == read(target)
    assert [one["recording"] for one in content["choices"]] == ["bumps", "other"]
    assert {one["reducer"] for one in content["people"]} == {"soc321", "dft321"}
    expected = {"online": True, "latency_ms": None, "mounting": "any", "tolerance_db": 1.0}
    assert content["context"] == expected
    judged = {one["reducer"] for one in content["verdicts"]}
    assert {"twice", "dft321_windowed@20ms"} <= judged
    assert "dft321_windowed@50ms" not in judged
    assert "loudness" in {one["metric"] for one in content["points"]}


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (["{folder}/nowhere"], 1, "nowhere: no such study or recording; check the name"),
        ([], 1, "no study.toml in"),
        (["{folder}"], 1, ": a folder without study.toml; name a study, or recordings one by one"),
        (["--scenes", "--latency-ms", "5"], 2, "--latency-ms must be left out offline, got 5; add"),
        (["--scenes", "--tolerance-db", "22"], 2, "--tolerance-db must be above 0 and below 10"),
    ],
)
def test_bad_use_is_one_line(
    arguments: list[str], code: int, message: str, tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch, capsys: Capture,
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    given = [argument.format(folder=tmp_path) for argument in arguments]
    assert main(["tradeoff", *given]) == code
    out, err = capsys.readouterr()
    assert (out, len(err.splitlines())) == ("", 1)
    assert message in err
    assert list(tmp_path.iterdir()) == []
