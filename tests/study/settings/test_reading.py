"""What `study.toml` says reaches recordings, recipe, texts and design; and the list of all settings."""

import re
import tomllib
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from feel321.protocols.tasks import make_task
from feel321.protocols.texts import CATALOG, Question, make_scales, read_texts
from feel321.protocols.trial import Flow
from feel321.stimuli.condition import Conditioning
from feel321.stimuli.recording import Recording
from feel321.stimuli.sets.recipe import Recipe
from feel321.stimuli.synthesis import SCENES, make_scene
from feel321.stimuli.wav import write_wav
from feel321.study.actuator.rig import read_rig
from feel321.study.all_settings import FILES, list_settings, read_meanings, write_list
from feel321.study.cli import main
from feel321.study.folder import StudyFolder, create_study, read_template
from feel321.study.observer import ObserverModel
from feel321.study.session.plan import Design, Stale
from feel321.study.session.ports import Surface
from feel321.study.settings.read import (
    find_language,
    list_surfaces,
    make_design,
    make_recipe,
    open_recordings,
    read_settings,
    read_study_texts,
    turn_recording,
)
from feel321.study.settings.schema import Settings

SHORTEST = '[[recordings]]\nscene = "bumps"\n'
SCENE = '[[recordings]]\nscene = "bumps"\nduration_s = 0.5\n'


@pytest.fixture
def read(tmp_path: Path) -> Callable[[str], Settings]:
    """Read settings, with ; between their lines."""

    def read_text(text: str) -> Settings:
        lines = text.replace("; ", "\n")
        (tmp_path / "study.toml").write_text(lines, encoding="utf-8")
        return read_settings(tmp_path / "study.toml")

    return read_text


def test_the_template_states_every_default_and_names_every_scene(
    read: Callable[[str], Settings],
) -> None:
    template = read(read_template().replace("; ", ", "))
    scenes = [{"scene": name} for name in SCENES]
    study = {"name": template.study.name}
    assert template == Settings.model_validate({"study": study, "recordings": scenes})


def test_a_new_study_is_short_and_called_as_its_folder(tmp_path: Path) -> None:
    study = create_study(tmp_path / "oak")
    assert len(study.settings.read_text(encoding="utf-8").splitlines()) <= 45
    assert len(study.rig.read_text(encoding="utf-8").splitlines()) <= 25
    assert read_rig(study.rig).device.name == "file"
    assert read_settings(study.settings).study.name == "oak"
    with pytest.raises(FileExistsError, match=r"study\.toml: already exists and is not over"):
        create_study(tmp_path / "oak")


@pytest.mark.parametrize("file", FILES)
def test_every_setting_has_a_meaning_and_every_meaning_a_setting(file: str) -> None:
    listed = list_settings(file)
    assert [one for one in listed if not one.meaning or not one.allowed] == []
    places = {".".join(filter(None, (one.table.strip("[]"), one.key))) for one in listed}
    assert set(read_meanings(file)) == places


def test_the_list_says_what_each_may_be_as_it_is_refused(
    capsys: pytest.CaptureFixture[str],
) -> None:
    listed = {f"{one.table}.{one.key}": one for one in list_settings("study.toml")}
    assert listed["[session].order"].allowed == "williams, blocked, random"
    assert listed["[stimuli].levels"].allowed == "a list of as_is, equal_intensity"
    assert listed["[session].repeats"].allowed == "whole number from 1 to 1000"
    assert listed["[rig].full_scale_m_s2"].unit == "m/s²"
    assert listed["[session.threshold].frequencies_hz"].default == "required"
    assert main(["new", "--all-settings"]) == 0
    out = capsys.readouterr().out
    for file in FILES:
        assert tomllib.loads(write_list(file)) == {}
        assert write_list(file).strip() in out


def test_the_defaults_of_the_list_are_those_that_hold(read: Callable[[str], Settings]) -> None:
    given = [one for one in list_settings("study.toml") if one.default not in {"", "required"}]
    plain = r"\[(study|stimuli|rig|session|observer|analysis)(\.(?!threshold|matching)\w+)?\]"
    text = SHORTEST
    for table in dict.fromkeys(one.table for one in given if re.fullmatch(plain, one.table)):
        keys = [f"{one.key} = {one.default}\n" for one in given if one.table == table]
        text += f"{table}\n{''.join(keys)}"
    assert read(text) == read(SHORTEST)


def test_defaults_are_those_of_the_rules_and_the_observer(read: Callable[[str], Settings]) -> None:
    settings = read(SHORTEST)
    design = make_design(settings)
    assert (design.flow, settings.session.stale) == (Flow(), Stale())
    tasks = [make_task(name, training=4, practice=2) for name in ("realism", "similarity")]
    assert design.tasks == tuple(tasks)
    assert settings.analysis.metrics[0] == ObserverModel().spectral_metric
    assert make_recipe(settings) == Recipe(seed=settings.study.seed)
    with pytest.raises(ValidationError, match="frozen"):
        settings.study.seed = 4  # type: ignore[misc] - that it is refused is the point


SESSION = """sample = "ridges"; [study]; seed = 9
[stimuli]; reducers = ["pca321", "dft321"]; levels = ["as_is", "equal_intensity"]
[session]; protocols = ["abx", "similarity"]; repeats = 2; order = "blocked"
rehearsal = { training = 1, practice = 0, pass_share = 1, rounds = 2 }
breaks = { every_trials = "off", every_min = "off", break_s = 1, rest_s = 2 }
quality = { min_response_s = 0, max_attempts = 1, reject = [], gap_s = 0.1 }
stale = { after_h = "off", policy = "restart" }
[[session.questions]]; name = "n"; kind = "number"; question = "N"; low = 1; high = 2.5
when = "after"; personal = true; required = false
[tasks.abx]; timing = "strict"; reference = "dft321"
[tasks.similarity]; reference = "surface"
[between]; grip = ["pen", "power"]; level = ["equal_intensity"]
"""


def test_every_setting_of_the_session_reaches_the_design(read: Callable[[str], Settings]) -> None:
    settings = read(SHORTEST + SESSION)
    asked = {"low": 1.0, "high": 2.5, "when": "after", "personal": True, "required": False}
    flow = Flow(
        break_trials=None, break_min=None, break_s=1.0, rest_s=2.0, training_pass=1.0,
        training_rounds=2, min_response_s=0.0, max_attempts=1, reject=(), gap_s=0.1,
    )  # fmt: skip
    assert make_design(settings) == Design(
        seed=9,
        order="blocked",
        repeats=2,
        tasks=(
            make_task("abx", timing="strict", reference="dft321", training=1),
            make_task("similarity", reference="surface", training=1),
        ),
        between={"grip": ("pen", "power"), "level": ("equal_intensity",)},
        flow=flow,
        questions=(Question("n", "number", "N", **asked),),
    )
    assert settings.session.stale == Stale(after_h=None, policy="restart")


STIMULI = """[study]; seed = 4
[stimuli]; reducers = ["pca321"]; levels = ["equal_intensity"]; anchors = false
reference = "dft321"; gain = 2.0; fade_s = 0.02
[stimuli.conditioning]; remove_offset = false; high_pass_hz = "off"; low_pass_hz = 500
crop_s = [0.1, 0.4]
[rig]; rate_hz = 44100; full_scale_m_s2 = 60; headroom = 0.5
"""


def test_every_setting_of_the_stimuli_reaches_the_recipe(read: Callable[[str], Settings]) -> None:
    steps = Conditioning(
        remove_offset=False, high_pass_hz=None, low_pass_hz=500.0, crop_s=(0.1, 0.4)
    )
    assert make_recipe(read(SHORTEST + STIMULI)) == Recipe(
        conditioning=steps, reducers=("pca321",), levels=("equal_intensity",), anchors=False,
        reference="dft321", gain=2.0, fade_s=0.02, rate_hz=44100.0, full_scale_m_s2=60.0,
        headroom=0.5, seed=4,
    )  # fmt: skip


def test_recordings_come_in_order_under_their_names(study: StudyFolder) -> None:
    write_wav(study.path / "tap.two.wav", [[0.0, 1.0]] * 3, 8000)
    text = '[[recordings]]\nfile = "tap.two.wav"\nunit = "g"\n'
    text += '[[recordings]]\nscene = "bumps"\nname = "b"\nduration_s = 0.1\n'
    study.settings.write_text(text, encoding="utf-8")
    tap, bumps = open_recordings(read_settings(study.settings), study.path)
    assert (tap.name, tap.rate_hz, tap.acceleration[1, 1]) == ("tap.two", 8000.0, 9.80665)
    assert (bumps.name, bumps.n_samples) == ("b", 1000)
    text = '[[recordings]]\nfile = "a.csv"\n[[recordings]]\nfile = "b.csv"'
    study.settings.write_text(text, encoding="utf-8")
    with pytest.raises(ValueError, match=r"recording 'a': .*\nrecording 'b': "):
        open_recordings(read_settings(study.settings), study.path)


def test_every_reading_option_reaches_the_reader(
    read: Callable[[str], Settings], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls: list[tuple[Path, dict[str, Any]]] = []

    def read_recording(path: Path, **options: Any) -> Recording:
        calls.append((path, options))
        return Recording(np.ones((3, 9)), 1000.0, "x")

    monkeypatch.setattr("feel321.stimuli.formats.read.read_recording", read_recording)
    text = "unit = 'g'\nrate_hz = 50.0\ncolumns = ['x', 1, 2]\nfull_scale = 16.0\nresample = true"
    settings = read(f"[[recordings]]\nfile = 'a.wav'\nname = 'oak'\n{text}")
    assert [one.name for one in open_recordings(settings, tmp_path)] == ["oak"]
    options = {"rate_hz": 50.0, "unit": "g", "columns": ("x", 1, 2), "full_scale": 16.0}
    assert calls == [(tmp_path / "a.wav", options | {"resample": True})]


def find_turn(scene: str, rotation: int) -> np.ndarray:
    recording = make_scene(scene, duration_s=0.5)
    turned = turn_recording(recording, rotation)
    return np.linalg.lstsq(recording.acceleration.T, turned.acceleration.T, rcond=None)[0].T


def test_one_number_is_one_rotation_of_every_recording() -> None:
    turn = find_turn("bumps", 4)
    np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(turn) == pytest.approx(1.0)
    np.testing.assert_allclose(turn, find_turn("hard_taps", 4), atol=1e-9)
    assert np.abs(turn - find_turn("bumps", 5)).max() > 0.1
    bumps, taps = (make_scene(name, duration_s=0.5) for name in ("bumps", "hard_taps"))
    turned = [turn_recording(*one) for one in ((bumps, 0), (bumps, 1), (taps, 1))]
    assert len({bumps.sha256, *(one.sha256 for one in turned)}) == 4


def test_a_recording_is_named_after_its_orientation_unless_it_has_a_name(
    study: StudyFolder,
) -> None:
    text = f'{SCENE}{SCENE}rotation = 0\n{SCENE}rotation = 1\n{SCENE}rotation = 1\nname = "b"\n'
    study.settings.write_text(text, encoding="utf-8")
    recordings = open_recordings(read_settings(study.settings), study.path)
    assert [recording.name for recording in recordings] == ["bumps", "bumps-r0", "bumps-r1", "b"]
    same = [np.array_equal(a.acceleration, b.acceleration) for a, b in pairwise(recordings)]
    assert same == [False, False, True]


def test_surfaces_are_found_by_the_names_that_trials_know_them_by(study: StudyFolder) -> None:
    text = f'{SCENE}name = "oak"\nsample = "the oak board"\npicture = "pictures/oak.png"\n{SCENE}rotation = 2\n'
    study.settings.write_text(text, encoding="utf-8")
    assert list_surfaces(read_settings(study.settings), study.path) == {
        "oak": Surface("the oak board", study.path / "pictures" / "oak.png"),
        "bumps-r2": Surface(None, None),
    }


def test_scales_of_the_labs_own_reach_the_texts_and_the_tasks(
    tmp_path: Path, read: Callable[[str], Settings]
) -> None:
    settings = read(
        f"{SHORTEST}[scales.roughness]; question = 'How rough?'; low = 'smooth'; high = 'rough'; "
        "anchors = ['a', 'b']; [tasks.realism]; scales = ['realism', 'roughness']; "
        "gap_s = 0.1; answer_timeout_s = 4; onset_s = 10"
    )
    task = make_design(settings).tasks[0]
    assert task.scales == ("realism", "roughness")
    assert (task.gap_s, task.answer_timeout_s, task.onset_s) == (0.1, 4.0, 10.0)
    scale = make_scales(read_study_texts(settings, tmp_path))["roughness"]
    assert (scale.question, scale.low_label, scale.high_label) == ("How rough?", "smooth", "rough")
    assert scale.anchors == ("a", "b")


def test_a_scale_without_words_is_refused(read: Callable[[str], Settings]) -> None:
    with pytest.raises(ValueError, match=r"tasks.realism.scales: 'roughness' has no words; add"):
        read(f"{SHORTEST}[tasks.realism]\nscales = ['realism', 'roughness']\n")


def test_consent_and_language_may_be_the_labs_own(
    tmp_path: Path, read: Callable[[str], Settings]
) -> None:
    settings = read(f"{SHORTEST}[session]\nlanguage = 'de'\nconsent = 'Vorhaben 7'")
    pages, usual = read_study_texts(settings, tmp_path)["pages"], read_texts("de")["pages"]
    assert pages["consent"] == {"title": usual["consent"]["title"], "text": "Vorhaben 7"}
    assert {key for key in usual if pages[key] != usual[key]} == {"consent"}
    settings = read(f"{SHORTEST}[session]\nlanguage = 'fr.toml'")
    assert find_language(settings, tmp_path) == tmp_path / "fr.toml"
    english = (CATALOG / "en.toml").read_text(encoding="utf-8")
    french = english.replace("Welcome", "Bienvenue")
    (tmp_path / "fr.toml").write_text(french, encoding="utf-8")
    assert read_study_texts(settings, tmp_path)["pages"]["welcome"]["title"] == "Bienvenue"
