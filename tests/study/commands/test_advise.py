from __future__ import annotations

import json
from typing import TYPE_CHECKING

import numpy as np
import pytest

from feel321.study.cli import main
from feel321.study.settings.edit import edit_settings

if TYPE_CHECKING:
    from pathlib import Path

STUDY = """
[study]
seed = 3
[[recordings]]
scene = "constrained_drag"
duration_s = 0.5
[[recordings]]
scene = "circular_motion"
duration_s = 0.5
"""


@pytest.fixture
def study(tmp_path: Path) -> Path:
    folder = tmp_path / "study"
    folder.mkdir()
    (folder / "study.toml").write_text(STUDY)
    return folder


def test_one_line_per_scene_and_where_the_page_is(
    study: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["advise", str(study)]) == 0
    first, second, common, page = capsys.readouterr().out.splitlines()
    assert first.startswith("constrained_drag: pca321, runner-up pca321_matched, margin ")
    assert second.startswith("circular_motion: pca321_matched, ")
    assert common.startswith("pca321_matched suffices for both scenes")
    assert page == str(study / "advice" / "index.html")
    assert (study / "advice" / "index.html").is_file()


def test_json_holds_the_record_behind_the_order(
    study: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["advise", str(study), "--online", "--json", "-o", str(study / "elsewhere")]) == 0
    content = json.loads(capsys.readouterr().out)
    budget = {"latency_ms": 45.0, "block_ms": 64 / 48, "device_ms": 5.0}
    tried = {"mounting": "any", "mountings": 72, "segment_s": 2.0}
    assert content["context"] == pytest.approx({"online": True, "axes": 1, **budget, **tried})
    assert content["seed"] == 3
    record = next(row for row in content["measures"] if row["reducer"] == "dft321_windowed")
    assert {"state", "latency_ms", "operations", "parameters", "order"} <= set(record)
    assert content == json.loads((study / "elsewhere" / "results.json").read_text(encoding="utf-8"))


def test_segments_are_advised_one_by_one(study: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert (
        main(["advise", str(study), "--segment", "0.25", "--tolerance", "0.3", "--seed", "8"]) == 0
    )
    assert capsys.readouterr().out.count(" 0.25-0.50 s: ") == 2


def test_another_seed_gives_the_same_answers(
    study: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    answers = []
    for seed in ("1", "2"):
        assert main(["advise", str(study), "--seed", seed, "--json"]) == 0
        rows = json.loads(capsys.readouterr().out)["scenes"]
        answers.append([row["answer"] for row in rows])  # runners-up may be as good as each other
    assert answers[0] == answers[1]


def test_ratings_of_the_study_are_used(study: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (study / "stimuli").mkdir()
    reducers = {"pca321": 20.0, "dft321": 90.0}
    manifest = [f"constrained_drag-{name},constrained_drag,{name},0.5,0.5" for name in reducers]
    head = "stimulus_id,recording,reducer,spectral_match,temporal_match"
    (study / "stimuli" / "manifest.csv").write_text("\n".join([head, *manifest]) + "\n")
    rng = np.random.default_rng(0)
    rows = [
        f"P{person},constrained_drag-{name},realism,{repeat},{mean + 3 * rng.standard_normal():.1f}"
        for person in range(8)
        for name, mean in reducers.items()
        for repeat in (1, 2)
    ]
    (study / "ratings.csv").write_text(
        "\n".join(["participant,stimulus_id,scale,repeat,rating", *rows]) + "\n"
    )
    assert main(["advise", str(study), "--json"]) == 0
    unchosen = json.loads(capsys.readouterr().out)
    assert {one["basis"] for one in unchosen["scenes"]} == {"metrics"}
    edit_settings(study / "study.toml", {"analysis.margin": 5.0})
    assert main(["advise", str(study), "--json"]) == 0
    drag, circle = json.loads(capsys.readouterr().out)["scenes"]
    assert (drag["answer"], drag["basis"]) == ("dft321", "metrics and ratings")
    assert "pca321, is not shown to feel like dft321" in drag["reason"]
    assert circle["basis"] == "metrics"


@pytest.mark.parametrize(
    ("options", "code", "message"),
    [
        (["--axes", "4"], 2, "'--axes': 4 is not in the range 1<=x<=3"),
        (
            ["--latency-ms", "5"],
            2,
            "--latency-ms must be left out offline, where nobody waits, got 5; add --online",
        ),
        (
            ["--online", "--latency-ms", "-5"],
            2,
            "--latency-ms must be a finite time of 0 ms or more, got -5",
        ),
        (
            ["--online", "--latency-ms", "nan"],
            2,
            "'--latency-ms': 'nan' is not a number in the range",
        ),
        (["--tolerance", "22"], 2, "--tolerance must be above 0 and below 1, got 22"),
        (["--segment", "0.01"], 2, "--segment must be 0.1 s or more, got 0.01"),
        (["--segment", "soon"], 2, "'soon' is not a valid float"),
        (["--recordings", "nowhere.csv"], 1, "nowhere.csv"),
    ],
)
def test_doors(
    study: Path, capsys: pytest.CaptureFixture[str], options: list[str], code: int, message: str
) -> None:
    assert main(["advise", str(study), *options]) == code
    told = capsys.readouterr().err.splitlines()
    assert len(told) == 1
    assert message in told[0]
    assert not (study / "advice").exists()


def test_bad_options_are_refused_before_anything_is_read(
    study: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["advise", str(study), "--recordings", "nowhere.csv", "--axes", "4"]) == 2
    assert "'--axes': 4 is not in the range 1<=x<=3" in capsys.readouterr().err


def test_silent_recordings_only_are_refused(
    study: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    silent = study / "silent.npz"
    np.savez(silent, acceleration=np.zeros((3, 4000)), rate_hz=4000.0, unit="m/s^2")
    (study / "study.toml").unlink()
    assert main(["advise", str(study), "--recordings", str(silent)]) == 1
    assert "recordings must have motion from 20 to 1000 Hz" in capsys.readouterr().err
    assert not (study / "advice").exists()


def test_a_folder_without_a_study_says_so(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["advise", str(tmp_path)]) == 1
    assert len(capsys.readouterr().err.splitlines()) == 1
