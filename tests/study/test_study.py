"""The study as Python shows it: the same steps and the same files as the verbs."""

import re
from pathlib import Path

import numpy as np
import pytest

from feel321.study import Study
from feel321.study.cli import main
from feel321.study.settings.read import change_settings

SHORT = """\
[study]  # a pilot
seed = 5
[[recordings]]
scene = "bumps"
duration_s = 0.5
[[recordings]]
scene = "hard_taps"
duration_s = 0.5
[stimuli]
reducers = ["sax321", "dft321"]  # few
[session.rehearsal]
training = 0
practice = 0
"""


@pytest.fixture(scope="module")
def pilot(tmp_path_factory: pytest.TempPathFactory) -> Study:
    """A small study that two simulated participants finished."""
    folder: Path = tmp_path_factory.mktemp("pilot")
    (folder / "study.toml").write_text(SHORT, encoding="utf-8")
    study = Study.open(str(folder))
    study.build()
    assert study.simulate(2, 7).to_dict()["ratings"] == len(study.ratings())
    return study


def test_a_study_is_created_once_and_opened_by_its_path(tmp_path: Path) -> None:
    study = Study.create(tmp_path / "a", like="park2019")
    assert study.settings.study.name == "park2019"
    assert repr(study) == f"Study.open('{tmp_path / 'a'}')"
    with pytest.raises(FileExistsError, match="already"):
        Study.create(tmp_path / "a")
    with pytest.raises(FileNotFoundError, match=r"no study\.toml in"):
        Study.open(tmp_path)
    with pytest.raises(TypeError, match="path must be a path"):
        Study.open(3)  # type: ignore[arg-type] - that it is refused is the point


def test_steps_find_what_the_verbs_find(pilot: Study, capsys: pytest.CaptureFixture[str]) -> None:
    found, audit, folder = pilot.check(), pilot.audit(), str(pilot.folder.path)
    assert found.problems == ()
    assert set(found.to_frame()["kind"]) <= {"warning", "remark", "note"}
    assert main(["audit", folder]) == 0
    assert audit.sentence in capsys.readouterr().out
    assert audit.findings == ()
    status = pilot.status()
    assert repr(status) == "Status(2 finished)"
    assert status.to_frame()["state"].tolist() == ["finished"] * 2
    assert status.to_dict()["participants"][0]["participant"] == "sim001"
    assert main(["status", folder]) == 0
    assert capsys.readouterr().out == status.summary() + "\n"
    assert len(pilot.table().rows) == (~pilot.ratings()["rejected"]).sum()


def test_what_is_no_list_no_code_and_no_place_is_refused(pilot: Study) -> None:
    before = sorted(pilot.folder.path.rglob("*"))
    with pytest.raises(TypeError, match="remotes must be a list of names, got the text"):
        pilot.audit(remotes="usb.git")
    with pytest.raises(ValueError, match="participant 3 has no session here; known: sim001, "):
        pilot.withdraw(participant=3, is_sure=True)  # type: ignore[arg-type] - that it is refused is the point
    for place in ("sessions", "stimuli/mine", "rehearsals"):
        with pytest.raises(ValueError, match=r"holds what analyze reads; name a folder outside"):
            pilot.analyze(out=pilot.folder.path / place)
    assert sorted(pilot.folder.path.rglob("*")) == before


def test_settings_are_changed_in_their_place(tmp_path: Path) -> None:
    (tmp_path / "study.toml").write_text(SHORT, encoding="utf-8")
    study = Study.open(tmp_path).with_settings({
        "study.seed": 6,
        "stimuli.reducers": ["sax321"],
        "session.rehearsal.practice": None,
        "observer.noise_sd": 4.5,
    })
    settings = study.settings
    assert (settings.study.seed, settings.stimuli.reducers) == (6, ("sax321",))
    assert (settings.session.rehearsal.practice, settings.observer.noise_sd) == (2, 4.5)
    text = study.folder.settings.read_text(encoding="utf-8")
    assert "[study]  # a pilot" in text
    assert 'reducers = ["sax321"]  # few' in text
    for change, message in (
        ({"session.order": "latin"}, "study.toml: session.order must be one of williams"),
        ({"sesion.order": "random"}, "sesion: unknown setting; did you mean session"),
        (
            {"recordings.name": "x"},
            "recordings.name: recordings is not a table of settings; edit study.toml",
        ),
        ({"seed": 1}, "settings must have names such as"),
        ({"rig.headroom": float("nan")}, "rig.headroom must be text, a number, true or false"),
        ({"study.name": tmp_path}, "study.name must be text, a number"),
    ):
        with pytest.raises(ValueError, match=re.escape(message)):
            study.with_settings(change)
    assert study.folder.settings.read_text(encoding="utf-8") == text


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ("[ session ]  # a\n  repeats = 2  # b\n", "[ session ]  # a\n  repeats = 3  # b\n"),
        ('[session]\n"repeats" = 2\n', '[session]\n"repeats" = 3\n'),
        ("", "[session]\nrepeats = 3\n"),
        ("session.repeats = 2  # a\n", "session.repeats = 3  # a\n"),
        ("session = { repeats = 2 }\n", "session = { repeats = 3 }\n"),
        (
            '[session]\nconsent = """\n[rig]\n"""\nrepeats = 2\n',
            '[session]\nconsent = """\n[rig]\n"""\nrepeats = 3\n',
        ),
    ],
)
def test_a_setting_is_changed_in_whatever_form_it_is_written(before: str, after: str) -> None:
    assert change_settings(before, {"session.repeats": np.int64(3)}) == after


def test_line_ends_stay_and_a_broken_file_is_named(tmp_path: Path) -> None:
    path = tmp_path / "study.toml"
    path.write_bytes(b"\xef\xbb\xbf" + SHORT.replace("\n", "\r\n").encode())
    study = Study.open(tmp_path).with_settings({"study.seed": 6, "rig.headroom": 0.5})
    assert (study.settings.study.seed, study.settings.rig.headroom) == (6, 0.5)
    assert (
        path.read_bytes().count(b"\r\n") == path.read_bytes().count(b"\n") == SHORT.count("\n") + 3
    )
    path.write_text("[study\n", encoding="utf-8")
    with pytest.raises(
        ValueError, match=r"study\.toml: not valid TOML \(.*line 1.*\); fix that place"
    ):
        study.with_settings({"study.seed": 6})


def test_draws_are_as_declared_unless_asked_for_and_the_seed_is_the_studys(
    pilot: Study, monkeypatch: pytest.MonkeyPatch
) -> None:
    chosen: list[dict[str, object]] = []
    monkeypatch.setattr("feel321.study.analyze.write_report", lambda *_, **how: chosen.append(how))
    monkeypatch.setattr("feel321.study.export.write_methods", lambda *_: None)
    pilot.analyze()
    pilot.analyze(draws=7)
    assert [(how["draws"], how["rng"]) for how in chosen] == [(2000, 5), (7, 5)]


def test_an_analysis_after_a_change_accounts_for_all_that_it_wrote(pilot: Study) -> None:
    """The methods section, too, belongs to the checkpoint of its analysis."""
    pilot.analyze(draws=10)
    pilot.seal(reason="before")
    pilot.with_settings({"publication.title": "Another title"}).analyze(draws=10)
    (found,) = Study.open(pilot.folder.path).audit().findings
    assert found.startswith(f"{pilot.folder.settings}: was changed")
