from __future__ import annotations

import re
import tomllib
from dataclasses import MISSING, fields, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from pydantic import ValidationError

from feel321.protocols.tasks import PROTOCOLS, make_task
from feel321.protocols.trial import Flow
from feel321.stimuli.condition import Conditioning
from feel321.stimuli.recording import Recording
from feel321.stimuli.sets.recipe import Recipe
from feel321.stimuli.synthesis import SCENES
from feel321.stimuli.wav import write_wav
from feel321.study.folder import create_study, read_template, require_study
from feel321.study.observer.judging import ObserverModel
from feel321.study.session.opening import Stale
from feel321.study.session.plan import Design
from feel321.study.settings.fields import Table
from feel321.study.settings.read import (
    TABLES,
    make_design,
    make_recipe,
    make_stale,
    open_recordings,
    read_settings,
)
from feel321.study.settings.schema import (
    FileTable,
    ObserverTable,
    SceneTable,
    Settings,
    SourceTable,
    TaskTable,
)

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from feel321.study.folder import StudyFolder

SHORTEST = '[[recordings]]\nscene = "bumps"\n'
TEN = list("abcdefghij")


@pytest.fixture
def read(tmp_path: Path) -> Callable[[str], Settings]:
    def read_text(text: str) -> Settings:
        (tmp_path / "study.toml").write_text(text, encoding="utf-8")
        return read_settings(tmp_path / "study.toml")

    return read_text


def test_the_template_states_every_default_and_names_every_scene(
    read: Callable[[str], Settings],
) -> None:
    template = read(read_template())
    scenes = [{"scene": name} for name in SCENES]
    assert template == Settings.model_validate({"recordings": scenes})


def test_the_template_names_every_key_in_its_table(read: Callable[[str], Settings]) -> None:
    # Keys without a default stand there as comments.
    text = re.sub(r"^# (\w+ = |\[)", r"\1", read_template(), flags=re.MULTILINE)
    content = tomllib.loads(text)
    assert set(content) == set(Settings.model_fields)
    assert set(content["tasks"]["similarity"]) == set(TaskTable.model_fields)
    for place, table in TABLES.items():
        if place and place[0] not in {"recordings", "tasks"}:
            entry: Any = content
            for name in place:
                entry = entry[name]
            assert set(entry) == set(table.model_fields)
    assert set(content["recordings"][0]) == set(TABLES["recordings", "file"].model_fields)
    read(text)


def test_every_table_is_known_to_the_suggestions() -> None:
    own = {
        table
        for table in Table.__subclasses__()
        if table.__module__.startswith("feel321.study.settings.")
    }
    known = {Settings, SceneTable, FileTable, *own} - {SourceTable}
    assert set(TABLES.values()) == known
    assert {place[1] for place in TABLES if place[:1] == ("tasks",) and len(place) > 1} == set(
        PROTOCOLS
    )


def test_defaults_are_those_of_the_rules_and_the_observer(read: Callable[[str], Settings]) -> None:
    settings = read(SHORTEST)
    design = make_design(settings)
    assert (design.flow, make_stale(settings)) == (Flow(), Stale())
    assert design.tasks == tuple(
        make_task(name, training=4, practice=2) for name in ("realism", "similarity")
    )
    defaults = {
        field.name: field.default for field in fields(ObserverModel) if field.default is not MISSING
    }
    assert settings.analysis.metrics[0] == defaults.pop("spectral_metric")
    assert settings.observer.model_dump().items() >= defaults.items()
    assert {*ObserverTable.model_fields, "spectral_metric"} == {
        field.name for field in fields(ObserverModel)
    }


def test_every_setting_of_the_session_reaches_the_design(read: Callable[[str], Settings]) -> None:
    settings = read(
        SHORTEST
        + """
        sample = "ridges"
        [study]
        seed = 9
        [stimuli]
        reducers = ["pca321", "dft321"]
        levels = ["as_is", "equal_intensity"]
        [session]
        protocols = ["abx", "similarity"]
        repeats = 2
        order = "blocked"
        [session.rehearsal]
        training = 1
        practice = 0
        pass_share = 1
        rounds = 2
        [session.breaks]
        every_trials = "off"
        every_min = "off"
        break_s = 1
        rest_s = 2
        [session.quality]
        min_response_s = 0
        max_attempts = 1
        reject = []
        gap_s = 0.1
        [session.stale]
        after_h = "off"
        policy = "restart"
        [tasks.abx]
        timing = "strict"
        reference = "dft321"
        [tasks.similarity]
        reference = "surface"
        [between]
        grip = ["pen", "power"]
        level = ["equal_intensity"]
        """
    )
    assert make_design(settings) == Design(
        seed=9,
        order="blocked",
        repeats=2,
        tasks=(
            make_task("abx", timing="strict", reference="dft321", training=1),
            make_task("similarity", reference="surface", training=1),
        ),
        between={"grip": ("pen", "power"), "level": ("equal_intensity",)},
        flow=Flow(
            break_trials=None,
            break_min=None,
            break_s=1.0,
            rest_s=2.0,
            training_pass=1.0,
            training_rounds=2,
            min_response_s=0.0,
            max_attempts=1,
            reject=(),
            gap_s=0.1,
        ),
    )
    assert make_stale(settings) == Stale(after_h=None, policy="restart")


def test_the_shortest_study_gives_the_recipe_of_the_stimuli_room(
    read: Callable[[str], Settings],
) -> None:
    assert make_recipe(read(SHORTEST)) == Recipe()


def test_every_setting_of_the_stimuli_reaches_the_recipe(read: Callable[[str], Settings]) -> None:
    recipe = make_recipe(
        read(
            SHORTEST
            + """
            [stimuli]
            reducers = ["pca321"]
            levels = ["equal_intensity"]
            anchors = false
            reference = "dft321"
            gain = 2.0
            fade_s = 0.02
            [stimuli.conditioning]
            remove_offset = false
            high_pass_hz = "off"
            low_pass_hz = 500
            crop_s = [0.1, 0.4]
            [rig]
            rate_hz = 44100
            full_scale_m_s2 = 60
            headroom = 0.5
            """
        )
    )
    assert recipe == Recipe(
        conditioning=Conditioning(
            remove_offset=False, high_pass_hz=None, low_pass_hz=500.0, crop_s=(0.1, 0.4)
        ),
        reducers=("pca321",),
        levels=("equal_intensity",),
        anchors=False,
        reference="dft321",
        gain=2.0,
        fade_s=0.02,
        rate_hz=44100.0,
        full_scale_m_s2=60.0,
        headroom=0.5,
    )


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "recordings: is missing; add it"),
        ("recordings = []", "recordings: got [], allowed is one name or more"),
        ("a = ", "got no TOML (Invalid value"),
        (SHORTEST + "[stimli]", "stimli: is no setting; did you mean stimuli?"),
        (
            SHORTEST + "[rig]\nzzz = 1",
            "rig.zzz: is no setting; allowed: rate_hz, full_scale_m_s2, headroom",
        ),
        (SHORTEST + "unit = 'g'", "recordings[1].unit: is no setting; allowed: name, sample,"),
        (
            SHORTEST + "[[recordings]]\nfile = 'a'\nunti = 'g'",
            "recordings[2].unti: is no setting; did you mean",
        ),
        (SHORTEST + "[[recordings]]\nname = 'a'", "recordings[2].file: is missing; add it"),
        (SHORTEST * 2, "recordings: allowed is each name once; more than once: bumps"),
        (SHORTEST + "name = 'a b'", "recordings: a recording's name must be up to 100 letters"),
        (SHORTEST + "name = 'a/b'", "recordings: a recording's name must be up to 100 letters"),
        (SHORTEST + f"name = '{'a' * 101}'", "must be up to 100 letters"),
        (SHORTEST * 2 + "name = 'Bumps'", "recordings: recording name 'Bumps' is there twice"),
        (
            "[[recordings]]\nscene = 'bumsp'",
            "recordings[1].scene: got 'bumsp', allowed: bumps, texture_drag,",
        ),
        (
            "[[recordings]]\nfile = 'a'\nunit = 'kg'",
            "recordings[1].unit: got 'kg', allowed: m/s^2, g, mg",
        ),
        (
            SHORTEST + "[stimuli]\nreducers = ['dft3211']",
            "stimuli.reducers[1]: got 'dft3211', allowed: sax321, say321",
        ),
        (SHORTEST + "[session]\nprotocols = ['realism', 'realism']", "more than once: realism"),
        (
            SHORTEST + "[stimuli]\nlevels = []",
            "stimuli.levels: got [], allowed is one name or more",
        ),
        (
            SHORTEST + "[stimuli]\nreference = 'x'",
            "stimuli.reference: got 'x', allowed: original, none, sax321",
        ),
        (
            SHORTEST + "[stimuli]\nlevels = ['loud']",
            "stimuli.levels[1]: got 'loud', allowed: as_is, equal_intensity",
        ),
        (
            SHORTEST + "[session]\nprotocols = ['x']",
            "session.protocols[1]: got 'x', allowed: realism, similarity",
        ),
        (
            SHORTEST + "[session]\nlanguage = 'xx'",
            "session.language: got 'xx', allowed: de, en, or a file beside",
        ),
        (
            SHORTEST + "[session]\nconsent = ' '",
            "session.consent: got ' ', allowed is a text that is not empty",
        ),
        (
            SHORTEST + "[session]\norder = 'latin'",
            "session.order: got 'latin', allowed: williams, blocked, random",
        ),
        (
            SHORTEST + "[session.rehersal]",
            "session.rehersal: is no setting; did you mean rehearsal?",
        ),
        (
            SHORTEST + "[session.breaks]\nevery_trials = 0",
            'got 0, allowed: greater than or equal to 1, or "off"',
        ),
        (
            SHORTEST + "[session.breaks]\nevery_min = 'never'",
            "got 'never', allowed: a valid number, or \"off\"",
        ),
        (
            SHORTEST + "[session.quality]\nreject = ['late']",
            "reject[1]: got 'late', allowed: underrun, clipped,",
        ),
        (
            SHORTEST + "[session.quality]\nreject = ['clipped', 'clipped']",
            "more than once: clipped",
        ),
        (
            SHORTEST + "[session.stale]\npolicy = 'x'",
            "policy: got 'x', allowed: warm_up, continue, restart",
        ),
        (SHORTEST + "[tasks.mushr]", "tasks.mushr: got 'mushr', allowed: realism, similarity,"),
        (
            SHORTEST + "[tasks.abx]\ntimming = 'strict'",
            "tasks.abx.timming: is no setting; did you mean timing?",
        ),
        (SHORTEST + "[tasks]\nabx = 3", "tasks.abx: got 3, allowed: a table"),
        (SHORTEST + "[between]\ngrip = []", "between.grip: got [], allowed is one name or more"),
        (
            SHORTEST + "[observer]\nlapse_rate = 2",
            "observer.lapse_rate: got 2, allowed: less than or equal to 1",
        ),
        (
            SHORTEST + "rotation = -1",
            "recordings[1].rotation: got -1, allowed: greater than or equal to 0",
        ),
        (
            SHORTEST + "[session]\nrepeats = 0",
            "session.repeats: got 0, allowed: greater than or equal to 1",
        ),
        (
            SHORTEST + "[session]\nrepeats = 1001",
            "session.repeats: got 1001, allowed: less than or equal to 1000",
        ),
        ("a = " + "[" * 99999, "got TOML that is nested too deeply; mend that place"),
        (f"[{'.'.join('a' * 3000)}]", "got TOML that is nested too deeply; mend that place"),
        (f"a = {'[' * 250}{']' * 250}", "got TOML that is nested too deeply; mend that place"),
        (SHORTEST + "[study]\nseed = '5'", "study.seed: got '5', allowed: a valid integer"),
        (SHORTEST + "[study]\nseed = true", "study.seed: got True, allowed: a valid integer"),
        (
            SHORTEST + "[study]\nname = 2026-01-01",
            "study.toml: got the date or time 2026-01-01, allowed are texts,",
        ),
        (
            SHORTEST + "sample = ' '",
            "recordings[1].sample: got ' ', allowed is a text that is not empty",
        ),
        (
            SHORTEST + "picture = ''",
            "recordings[1].picture: got '', allowed is a text that is not empty",
        ),
        (
            SHORTEST + "[between]\nLevels = ['as_is']",
            "between.Levels: got 'Levels', did you mean level? Allowed is",
        ),
        (
            SHORTEST + "[between]\nPROTOCOL = ['abx']",
            "between.PROTOCOL: got 'PROTOCOL', did you mean protocol?",
        ),
        (
            SHORTEST + "[between]\n'my grip' = ['a']",
            "between.my grip: got 'my grip', allowed are up to 40 letters",
        ),
        (
            SHORTEST + "[between]\n2nd = ['a']",
            "between.2nd: got '2nd', allowed are up to 40 letters (A-Z), digits",
        ),
        (
            SHORTEST + "[between]\nRating = ['a']",
            "got 'Rating', is a column of participants.csv or ratings.csv",
        ),
        (
            SHORTEST + "[between]\nstate = ['a']",
            "got 'state', is a column of participants.csv or ratings.csv already",
        ),
        (
            SHORTEST + "[between]\nlast_utc = ['a']",
            "got 'last_utc', is a column of participants.csv or ratings.csv",
        ),
        (
            SHORTEST + f"[between]\na = {TEN}\nb = {TEN}",
            "between: got 100 groups, allowed are at most 64; use fewer",
        ),
        (
            SHORTEST + "[session.quality]\nmin_response_s = 6",
            "got 6, allowed: less than or equal to 5",
        ),
        (SHORTEST + "[session.quality]\ngap_s = 31", "got 31, allowed: less than or equal to 30"),
        (
            SHORTEST + "[session.quality]\nmax_attempts = 101",
            "got 101, allowed: less than or equal to 100",
        ),
        (
            SHORTEST + "[session.breaks]\nevery_min = 1441",
            'got 1441, allowed: less than or equal to 1440, or "off"',
        ),
        (
            SHORTEST + "[session.breaks]\nbreak_s = 3601",
            "got 3601, allowed: less than or equal to 3600",
        ),
        (
            SHORTEST + "[session.breaks]\nrest_s = 3601",
            "got 3601, allowed: less than or equal to 3600",
        ),
        (
            SHORTEST + "[session.rehearsal]\ntraining = 101",
            "got 101, allowed: less than or equal to 100",
        ),
        (
            SHORTEST + "[session.rehearsal]\npractice = 101",
            "got 101, allowed: less than or equal to 100",
        ),
        (
            SHORTEST + "[session.rehearsal]\nrounds = 101",
            "got 101, allowed: less than or equal to 100",
        ),
        (
            SHORTEST + "[session.stale]\nafter_h = 1e300",
            'got 1e+300, allowed: less than or equal to 8760, or "off"',
        ),
        (
            SHORTEST + "[stimuli]\ngain = 1e300",
            "stimuli.gain: got 1e+300, allowed: less than or equal to 1000000",
        ),
        (
            SHORTEST + "[stimuli]\ngain = 1e-300",
            "stimuli.gain: got 1e-300, allowed: greater than or equal to 0.000001",
        ),
        (
            SHORTEST + "[rig]\nfull_scale_m_s2 = 1e7",
            "got 10000000.0, allowed: less than or equal to 1000000",
        ),
        (
            SHORTEST + "[study]\nseed = -1",
            "study.seed: got -1, allowed: greater than or equal to 0",
        ),
        (SHORTEST + "[rig]\nrate_hz = nan", "rig.rate_hz: got nan, allowed: "),
        (
            SHORTEST + "[stimuli.conditioning]\nhigh_pass_hz = 0",
            "stimuli.conditioning.high_pass_hz: got 0, allowed: ",
        ),
        (
            SHORTEST + "[analysis]\ndraws = 3",
            "analysis.draws: got 3, allowed: greater than or equal to 100",
        ),
    ],
)
def test_every_mistake_is_one_line_that_says_where_what_and_what_is_allowed(
    read: Callable[[str], Settings], text: str, message: str
) -> None:
    with pytest.raises(ValueError, match="^[^\n]*" + re.escape(message) + "[^\n]*$"):
        read(text)


def test_all_mistakes_are_told_at_once(read: Callable[[str], Settings]) -> None:
    with pytest.raises(ValueError, match="is no setting") as caught:
        read(SHORTEST + "[rig]\nzzz = 1\nheadroom = 2\n[study]\nseed = 'a'")
    assert [line.split(":")[1] for line in str(caught.value).splitlines()] == [
        " study.seed",
        " rig.headroom",
        " rig.zzz",
    ]


def test_a_task_of_no_protocol_is_told_with_its_wrong_keys(read: Callable[[str], Settings]) -> None:
    with pytest.raises(ValueError, match="is no setting") as caught:
        read(SHORTEST + "[tasks.foo]\ntimming = 1")
    assert [line.split(" ")[1] for line in str(caught.value).splitlines()] == [
        "tasks.foo:",
        "tasks.foo.timming:",
    ]


def test_the_mark_that_some_editors_put_first_is_no_mistake(tmp_path: Path) -> None:
    (tmp_path / "study.toml").write_text(SHORTEST, encoding="utf-8-sig")
    assert read_settings(tmp_path / "study.toml").recordings[0].title == "bumps"


def test_factors_may_be_labels_of_any_kind(read: Callable[[str], Settings]) -> None:
    text = "[between]\ngrip_2 = ['pen', 'mit Öl']\nlevel = ['as_is']\nprotocol = ['realism']\nHand = ['l', 'r']"
    assert list(read(SHORTEST + text).between) == ["grip_2", "level", "protocol", "Hand"]
    assert len(read(f"{SHORTEST}[between]\na = {TEN[:8]}\nb = {TEN[:8]}").between) == 2


def test_settings_cannot_be_changed_after_reading(read: Callable[[str], Settings]) -> None:
    settings = read(SHORTEST)
    with pytest.raises(ValidationError, match="frozen"):
        settings.study.seed = 4  # type: ignore[misc] - that it is refused is the point


def test_recordings_come_in_order_under_their_names(study: StudyFolder) -> None:
    write_wav(study.path / "tap.two.wav", [[0.0, 1.0]] * 3, 8000)
    text = '[[recordings]]\nfile = "tap.two.wav"\nunit = "g"\n'
    text += '[[recordings]]\nscene = "bumps"\nname = "b"\nduration_s = 0.1\n'
    study.settings.write_text(text, encoding="utf-8")
    tap, bumps = open_recordings(read_settings(study.settings), study.path)
    assert (tap.name, tap.rate_hz, tap.acceleration[1, 1]) == ("tap.two", 8000.0, 9.80665)
    assert (bumps.name, bumps.n_samples) == ("b", 1000)
    assert isinstance(replace(tap, name="x"), Recording)


def test_recordings_that_cannot_be_read_are_all_named(study: StudyFolder) -> None:
    study.settings.write_text(
        '[[recordings]]\nfile = "a.csv"\n[[recordings]]\nfile = "b.csv"', encoding="utf-8"
    )
    with pytest.raises(ValueError, match=r"recording 'a': .*\nrecording 'b': "):
        open_recordings(read_settings(study.settings), study.path)


def test_a_new_study_is_never_made_over_an_old_one(tmp_path: Path) -> None:
    study = create_study(tmp_path / "new")
    study.settings.write_text(SHORTEST, encoding="utf-8")
    with pytest.raises(
        FileExistsError, match=r"study\.toml: is there already, nothing is overwritten"
    ):
        create_study(tmp_path / "new")
    assert study.settings.read_text(encoding="utf-8") == SHORTEST


def test_a_folder_without_settings_is_no_study(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match=r"got a folder without study\.toml"):
        require_study(tmp_path)


def test_every_reading_option_reaches_the_reader(
    read: Callable[[str], Settings], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls: list[tuple[Path, dict[str, Any]]] = []

    def read_recording(path: Path, **options: Any) -> Recording:
        calls.append((path, options))
        return Recording(np.ones((3, 9)), 1000.0, "x")

    monkeypatch.setattr("feel321.study.settings.read.read_recording", read_recording)
    options = {
        "rate_hz": 50.0,
        "unit": "g",
        "columns": ("x", 1, 2),
        "full_scale": 16.0,
        "resample": True,
    }
    text = "unit = 'g'\nrate_hz = 50.0\ncolumns = ['x', 1, 2]\nfull_scale = 16.0\nresample = true"
    recordings = open_recordings(
        read(f"[[recordings]]\nfile = 'a.wav'\nname = 'oak'\n{text}"), tmp_path
    )
    assert calls == [(tmp_path / "a.wav", options)]
    assert [recording.name for recording in recordings] == ["oak"]
