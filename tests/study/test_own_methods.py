"""A lab's own reducers, metrics and protocols take part in every step; a change of them, or a fault, is named."""

import json
from pathlib import Path
from typing import Any

import pytest

from feel321.protocols.tasks import PROTOCOLS
from feel321.stimuli.sets.manifest import find_methods
from feel321.study.analyze import read_study_table
from feel321.study.cli import main
from feel321.study.evidence.freeze import list_info
from feel321.study.folder import StudyFolder
from feel321.study.settings.read import read_settings, read_study_texts
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


SETTINGS = """\
[[recordings]]
scene = "bumps"
duration_s = 0.5

[[recordings]]
scene = "hard_taps"
duration_s = 0.5

[stimuli]
reducers = ["dft321", "say321"]
anchors = false

[session]
protocols = ["methods/mine.py:grit"]

[session.rehearsal]
training = 0
practice = 0

[metrics.snr]
higher = "worse"
unit = "dB"
"""

CODE = """\
from feel321.protocols.tasks import Protocol
from feel321.protocols.trial import Comparison, Judgement, Part


def compare(items, task):
    return [
        Comparison((Part("test", i.stimulus_id),), (Judgement("test", i.stimulus_id),))
        for i in items
    ]


TEXTS = {
    "question": "How gritty?", "low_label": "Not", "high_label": "Very", "title": "Grit",
    "text": "Feel it, then move the marker.",
}


def half(judgement, answer, parts):
    return answer / 2


grit = Protocol("grit", compare, texts=TEXTS, score=half)
"""


@pytest.fixture
def grit(tmp_path: Path) -> Study:
    (tmp_path / "methods").mkdir()
    (tmp_path / "methods" / "mine.py").write_text(CODE)
    (tmp_path / "study.toml").write_text(SETTINGS)
    return Study.open(tmp_path)


def test_every_step_takes_a_protocol_of_the_lab(
    grit: Study, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = grit.folder.path
    assert main(["check", str(folder)]) == 0
    grit.build()
    grit.simulate(2, rng=1)
    plan = json.loads((folder / "sessions" / "sim001" / "plan.json").read_text())
    own = PROTOCOLS["grit"].sha256
    assert plan["methods"] == read_header(folder)["methods"]
    assert plan["methods"] == {"protocol.grit": own}
    ratings = grit.ratings()
    assert {*ratings.protocol} == {*ratings.scale} == {"grit"}
    assert len(ratings) == 2 * 2 * 3  # participants, recordings, two reducers and the recording
    assert ratings.rating.between(0, 50).all()  # by its own score
    assert grit.audit().findings == ()
    assert len(grit.status().participants) == 2

    (folder / "methods" / "mine.py").write_text(CODE.replace("answer / 2", "answer / 4"))
    capsys.readouterr()
    assert main(["simulate", str(folder), "--participants", "2"]) == 1
    assert "methods.protocol.grit" in capsys.readouterr().err
    (folder / "methods" / "mine.py").unlink()
    assert any("there is no file methods/mine.py" in one for one in grit.audit().findings)


def test_texts_come_from_the_protocol(grit: Study) -> None:
    folder = grit.folder.path
    settings = read_settings(grit.folder.settings)
    texts = read_study_texts(settings, folder)
    assert texts["scales"]["grit"]["low_label"] == "Not"
    assert texts["pages"]["instructions.grit"]["title"] == "Grit"


@pytest.mark.parametrize(
    ("before", "after", "message"),
    [
        ("grit = Protocol(", "grit = (lambda *a, **k: 5)(", "must be a feel321.protocols.tasks.Protocol, got"),
        ('Protocol("grit"', 'Protocol("sand"', "is named 'sand'; the two must be the same"),
        ("return [", "1 / 0\n    return [", "ZeroDivisionError: division by zero (methods/mine.py, l"),
        ("return [", "return 5, [", "must make Comparisons of Parts and Judgements, got 5"),
        ('Judgement("test", i', 'Judgement("tset", i', "judges 'tset', which is not one of its parts"),
        ('Part("test", i.stimulus_id)', 'Part("test", "oak")', "stimuli that it was not given: oak"),
        ("compare, texts", "compare, ('slow',), texts", "timings must be of strict, replay, free"),
        ("How gritty?", "{} gritty?", "texts['question'] must be words without braces"),
        (" texts=TEXTS,", "", "protocol grit has no question, low_label, high_label, title, text"),
        ("from feel", "import sys; sys.exit(3)\nfrom feel", "it called sys.exit(3)"),
    ],
)  # fmt: skip
def test_a_bad_protocol_is_one_line(
    grit: Study, capsys: pytest.CaptureFixture[str], before: str, after: str, message: str
) -> None:
    assert before in CODE
    (grit.folder.path / "methods" / "mine.py").write_text(CODE.replace(before, after, 1))
    assert main(["check", str(grit.folder.path)]) == 1
    printed = "".join(capsys.readouterr())
    assert message in printed
    assert "Traceback" not in printed
    assert printed.count("grit") < 6


def test_a_taken_name_and_options_of_unknown_tasks_are_refused(grit: Study) -> None:
    text = SETTINGS.replace("mine.py:grit", "mine.py:realism")
    grit.folder.settings.write_text(text)
    with pytest.raises(ValueError, match="'realism' is taken by one of feel321's own"):
        read_settings(grit.folder.settings)
    grit.folder.settings.write_text(f"{SETTINGS}[tasks.sand]\nsurface = false\n")
    with pytest.raises(ValueError, match=r"must be one of .*preference, grit"):
        read_settings(grit.folder.settings)
    grit.folder.settings.write_text(f'{SETTINGS}[tasks.grit]\ntiming = "strict"\n')
    assert read_settings(grit.folder.settings).session.protocols == ("grit",)


def test_what_study_toml_declares_of_metrics_reaches_the_report(grit: Study) -> None:
    (info,) = list_info(read_settings(grit.folder.settings)).values()
    assert (info.label, info.higher, info.unit) == ("snr", "worse", "dB")
