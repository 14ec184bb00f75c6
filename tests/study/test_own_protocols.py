"""A protocol of the lab's own takes part in every step, with its digest; a bad one is refused in one line."""

import json
from pathlib import Path

import pytest

from feel321.protocols.tasks import PROTOCOLS
from feel321.study.analyze import list_info
from feel321.study.cli import main
from feel321.study.settings.read import read_settings, read_study_texts
from feel321.study.study import Study

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
def study(tmp_path: Path) -> Study:
    (tmp_path / "methods").mkdir()
    (tmp_path / "methods" / "mine.py").write_text(CODE)
    (tmp_path / "study.toml").write_text(SETTINGS)
    return Study.open(tmp_path)


def test_every_step_takes_a_protocol_of_the_lab(
    study: Study, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = study.folder.path
    assert main(["check", str(folder)]) == 0
    study.build()
    study.simulate(2, rng=1)
    plan = json.loads((folder / "sessions" / "sim001" / "plan.json").read_text())
    own = PROTOCOLS["grit"].sha256
    assert plan["methods"] == study.journal("sim001")["data"][0]["methods"]
    assert plan["methods"] == {"protocol.grit": own}
    ratings = study.ratings()
    assert {*ratings.protocol} == {*ratings.scale} == {"grit"}
    assert len(ratings) == 2 * 2 * 3  # participants, recordings, two reducers and the recording
    assert ratings.rating.between(0, 50).all()  # by its own score
    assert study.audit().findings == ()
    assert len(study.status().participants) == 2

    (folder / "methods" / "mine.py").write_text(CODE.replace("answer / 2", "answer / 4"))
    capsys.readouterr()
    assert main(["simulate", str(folder), "--participants", "2"]) == 1
    assert "methods.protocol.grit" in capsys.readouterr().err
    (folder / "methods" / "mine.py").unlink()
    assert any("there is no file methods/mine.py" in one for one in study.audit().findings)


def test_texts_come_from_the_protocol_a_file_of_texts_or_the_settings(study: Study) -> None:
    folder = study.folder.path
    settings = read_settings(study.folder.settings)
    texts = read_study_texts(settings, folder)
    assert texts["scales"]["grit"]["low_label"] == "Not"
    assert texts["pages"]["instructions.grit"]["title"] == "Grit"
    (folder / "texts.toml").write_text(
        '[scales.grit]\nquestion = "Körnig?"\nlow_label = "Nein"\nhigh_label = "Ja"\n'
        '[pages."instructions.grit"]\ntitle = "Korn"\ntext = "Fühlen."\n'
    )
    study.with_settings({"session.language": "texts.toml"})
    texts = read_study_texts(read_settings(study.folder.settings), folder)
    assert texts["scales"]["grit"]["low_label"] == "Nein"
    assert texts["pages"]["instructions.grit"]["title"] == "Korn"


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
    study: Study, capsys: pytest.CaptureFixture[str], before: str, after: str, message: str
) -> None:
    assert before in CODE
    (study.folder.path / "methods" / "mine.py").write_text(CODE.replace(before, after, 1))
    assert main(["check", str(study.folder.path)]) == 1
    printed = "".join(capsys.readouterr())
    assert message in printed
    assert "Traceback" not in printed
    assert printed.count("grit") < 6


def test_a_taken_name_and_options_of_unknown_tasks_are_refused(study: Study) -> None:
    text = SETTINGS.replace("mine.py:grit", "mine.py:realism")
    study.folder.settings.write_text(text)
    with pytest.raises(ValueError, match="'realism' is taken by one of feel321's own"):
        read_settings(study.folder.settings)
    study.folder.settings.write_text(f"{SETTINGS}[tasks.sand]\nsurface = false\n")
    with pytest.raises(ValueError, match=r"must be one of .*preference, grit"):
        read_settings(study.folder.settings)
    study.folder.settings.write_text(f'{SETTINGS}[tasks.grit]\ntiming = "strict"\n')
    assert read_settings(study.folder.settings).session.protocols == ("grit",)


def test_what_study_toml_declares_of_metrics_reaches_the_report(study: Study) -> None:
    (info,) = list_info(read_settings(study.folder.settings)).values()
    assert (info.label, info.higher, info.unit) == ("snr", "worse", "dB")
