"""The verb stress, as a user meets it."""

from __future__ import annotations

import json
import re
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from feel321.analysis.tradeoff.stress import run
from feel321.analysis.tradeoff.stress.measures import measure_scene
from feel321.stimuli.reducers.registry import REDUCERS
from feel321.stimuli.synthesis import make_scene
from feel321.study.cli import main

if TYPE_CHECKING:
    from pathlib import Path

    from feel321.study.folder import StudyFolder

    Capture = pytest.CaptureFixture[str]


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    """Write an isotropic rumble on a large offset, as a file from a lab."""
    rumble = make_scene("isotropic_rumble", duration_s=0.4)
    table = np.column_stack([
        np.arange(rumble.n_samples) / rumble.rate_hz,
        rumble.acceleration.T + 50.0,
    ])
    path = tmp_path / "rumble.csv"
    np.savetxt(path, table, delimiter=",", header="time_s,x_m/s^2,y_m/s^2,z_m/s^2", comments="")
    return path


@pytest.fixture(autouse=True)
def few_takes(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two takes of every scene instead of forty."""

    def measure(*given: Any, **named: Any) -> Any:
        return measure_scene(*given, **{**named, "takes": 2})

    monkeypatch.setattr(run, "measure_scene", measure)


def test_figures_warnings_and_page(recording: Path, tmp_path: Path, capsys: Capture) -> None:
    target = tmp_path / "out"
    where = [str(tmp_path), "--recordings", str(recording), "-o", str(target)]
    assert main(["stress", *where, "--seed", "3", "--json"]) == 0
    out, err = capsys.readouterr()
    content = json.loads(out)
    assert content["inputs"]["seed"] == 3
    assert {cell["reducer"] for cell in content["cells"]} == set(REDUCERS)
    assert json.loads((target / "results.json").read_text(encoding="utf-8")) == content
    assert all((target / name).is_file() for name in content["files"])
    assert re.search(r"feel321: warning: rumble: 9\d.* % of the sensor's energy is offset", err)
    assert (
        "offset"
        in next(entry for entry in content["recordings"] if entry["name"] == "rumble")["near"]
    )


def test_the_default_folder_is_in_the_study(study: StudyFolder, capsys: Capture) -> None:
    """A study's own recordings, found as they came from the sensor, under the names that the study gives them."""
    assert main(["stress", str(study.path)]) == 0
    assert capsys.readouterr().out.strip() == str(study.path / "stress" / "index.html")
    content = json.loads((study.path / "stress" / "results.json").read_text(encoding="utf-8"))
    assert [one["name"] for one in content["recordings"]] == ["bumps", "hard_taps"]
    assert content["inputs"]["seed"] == 5
    assert not any("only the conditioned signal" in note for note in content["notes"])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["missing"], "missing: no such folder; check the name"),
        (["."], "or begin one with: feel321 new"),
        ([".", "--recordings", "none.csv"], "none.csv"),
        ([".", "--scenes", "--seed", "-1"], "Invalid value for '--seed'"),
    ],
)
def test_doors(
    arguments: list[str],
    message: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: Capture,
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["stress", *arguments]) in {1, 2}
    err = capsys.readouterr().err
    assert message in err
    assert len(err.splitlines()) == 1
    assert list(tmp_path.iterdir()) == []
