"""A study with methods of the lab's own, from `new --with methods` through every step; changes are named."""

import json
from pathlib import Path
from typing import Any

import pytest

from feel321.stimuli.sets.manifest import find_methods
from feel321.study.analyze import read_study_table
from feel321.study.cli import main
from feel321.study.folder import StudyFolder
from feel321.study.study import Study

SMALL = {
    "session.protocols": ["realism"],
    "session.rehearsal.training": 0,
    "session.rehearsal.practice": 0,
    "stimuli.reducers": ["dft321", "my321", "wav321"],
    "stimuli.anchors": False,
    "analysis.metrics": ["spectral_match_bounded", "snr"],
}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    path = tmp_path / "study"
    assert main(["new", str(path), "--methods"]) == 0
    text = (path / "study.toml").read_text()
    for scene in ("texture_drag", "constrained_drag", "isotropic_rumble", "circular_motion"):
        text = text.replace(f'[[recordings]]\nscene = "{scene}"\n', "")
    text = text.replace('scene = "bumps"', 'scene = "bumps"\nduration_s = 0.5')
    text = text.replace('scene = "hard_taps"', 'scene = "hard_taps"\nduration_s = 0.5')
    (path / "study.toml").write_text(text)
    Study.open(path).with_settings(SMALL)
    return path


def read_header(folder: Path) -> dict[str, Any]:
    """The header of the first journal of the first participant."""
    text = next(folder.glob("sessions/sim001/*.jsonl")).read_text(encoding="utf-8")
    return dict(json.loads(text.splitlines()[0])["data"])


def test_every_step_takes_the_labs_own_methods_and_a_change_of_them_is_named(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    study = Study.open(folder)
    assert main(["check", str(folder)]) == 0
    built = study.build()
    assert {one.reducer for one in built if one.role == "test"} == {"dft321", "my321", "wav321"}
    assert {one.recording for one in built} == {"bumps", "hard_taps", "tap"}
    digests = find_methods(built.folder)
    assert digests.keys() == {"my321", "wav321", "snr"}
    assert study.stimuli()["tap__reference__as_is"].metrics["snr"] == pytest.approx(100.0)
    study.simulate(2, rng=1)
    plan = json.loads((folder / "sessions" / "sim001" / "plan.json").read_text())
    header = read_header(folder)
    assert plan["methods"] == header["methods"] == digests
    assert study.audit().findings == ()
    journals = {path: path.read_bytes() for path in folder.glob("sessions/*/*.jsonl")}
    capsys.readouterr()

    with (folder / "methods" / "my321.py").open("a") as file:
        file.write("\n\ndef broken(:\n")
    for verb in ("check", "build", "simulate"):
        assert main([verb, str(folder)]) == 1
        assert "reducers.my321.sha256: built with" in "".join(capsys.readouterr())
    (finding,) = study.audit().findings
    assert finding.startswith(f"{folder / 'methods' / 'my321.py'}: was changed")
    study.seal(reason="tried something")
    assert study.audit().findings == ()
    assert {path: path.read_bytes() for path in folder.glob("sessions/*/*.jsonl")} == journals


PLACE = "methods/mine.py:my_match"
MINE = """
def my_match(acceleration, reduced, rate_hz):
    return -float(abs(reduced - acceleration.mean(axis=0)).mean())
"""


@pytest.mark.parametrize(
    ("measured", "declared"),
    [("", PLACE), (PLACE, "my_match"), (PLACE, PLACE), ("", "envelope_correlation")],
)
def test_a_metric_is_declared_once_wherever_it_is_named(
    study: StudyFolder, measured: str, declared: str
) -> None:
    (study.path / "methods").mkdir()
    (study.path / "methods" / "mine.py").write_text(MINE)
    text = study.settings.read_text().replace("[stimuli]", f'[stimuli]\nmetrics = ["{measured}"]')
    text = text.replace('metrics = [""]', "")
    metrics = f'metrics = ["{declared}", "temporal_match"]'
    study.settings.write_text(text.replace("[analysis]", f"[analysis]\n{metrics}"))
    one = Study.open(study.path)
    assert one.check().problems == ()
    one.build()
    assert one.check().problems == ()
    one.simulate(1, rng=1)
    name = declared.rpartition(":")[2]
    table = read_study_table(study)
    assert table.metrics == (name, "temporal_match")
    assert table.rows[name].notna().any()


def test_check_method_reports_each_check_and_fails_where_one_does(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (folder / "methods" / "bad.py").write_text(
        "def square321(acceleration, rate_hz):\n    return acceleration[0] ** 2\n"
    )
    assert main(["check", str(folder), "--method", "my321"]) == 0
    assert "reducer my321: all 8 checks passed" in capsys.readouterr().out
    assert main(["check", str(folder), "--method", "snr", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["kind"] == "metric"
    assert main(["check", str(folder), "--method", "methods/bad.py:square321"]) == 1
    printed = capsys.readouterr().out
    assert "FAILED  scaling: a signal 2 times as strong must give an output 2 times" in printed
    assert main(["check", str(folder), "--method", "dft321"]) == 1
    assert "dft321 is feel321's own" in capsys.readouterr().err
