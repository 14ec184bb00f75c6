from __future__ import annotations

import re
import tomllib
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from pydantic import ValidationError

from feel321.protocols.tasks import make_task
from feel321.protocols.trial import Flow
from feel321.stimuli.condition import Conditioning
from feel321.stimuli.recording import Recording
from feel321.stimuli.sets.recipe import Recipe
from feel321.stimuli.synthesis import SCENES
from feel321.stimuli.wav import write_wav
from feel321.study.actuator.rig import read_rig
from feel321.study.all_settings import FILES, Setting, list_settings, read_meanings, write_list
from feel321.study.cli import main
from feel321.study.folder import create_study, read_template, require_study
from feel321.study.observer.model import ObserverModel
from feel321.study.session.plan import Design, Stale
from feel321.study.settings.fields import TomlTable, list_tables
from feel321.study.settings.read import make_design, make_recipe, open_recordings, read_settings
from feel321.study.settings.schema import SceneTable, Settings

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from feel321.study.folder import StudyFolder

ALL = Path(__file__).with_name("all_settings.toml").read_text(encoding="utf-8")
ALL_OF_THE_RIG = Path(__file__).with_name("all_rig_settings.toml").read_text(encoding="utf-8")
"""Files with every key, those without a default as comments."""

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
    scenes = [{"scene": name} for name in SCENES]
    for text in (read_template(), ALL):
        template = read(text)
        name = {"name": template.study.name}
        assert template == Settings.model_validate({"study": name, "recordings": scenes})


def test_a_study_is_called_as_its_folder_until_it_has_a_name(tmp_path: Path) -> None:
    study = create_study(tmp_path / "oak")
    assert read_settings(study.settings).study.name == "oak"
    study.settings.write_text('[study]\nname = "pine"\n' + SHORTEST, encoding="utf-8")
    assert read_settings(study.settings).study.name == "pine"


def test_new_files_are_short(tmp_path: Path) -> None:
    study = create_study(tmp_path / "oak")
    assert len(study.settings.read_text(encoding="utf-8").splitlines()) <= 45
    assert len(study.rig.read_text(encoding="utf-8").splitlines()) <= 25
    assert read_rig(study.rig) == read_rig(write(tmp_path / "rig.toml", ALL_OF_THE_RIG))


def write(path: Path, text: str) -> Path:
    path.write_text(text, encoding="utf-8")
    return path


def test_the_template_names_every_key_in_its_table(
    read: Callable[[str], Settings], tmp_path: Path
) -> None:
    (tmp_path / "corpus").mkdir()
    (tmp_path / "corpus" / "a.wav").touch()
    # Keys without a default stand there as comments.
    text = re.sub(r"^# (\w+ = |\[)", r"\1", ALL, flags=re.MULTILINE)
    assert set(list_keys(Settings)) <= set(list_written(tomllib.loads(text)))
    read(text)


def list_keys(table: type[TomlTable], place: str = "") -> Iterator[str]:
    """List every key of a table and of those in it; of scenes only what the template writes."""
    for name, field in table.model_fields.items():
        inner = [one for one in list_tables(field.annotation) if one is not SceneTable]
        for one in inner:
            yield from list_keys(one, f"{place}{name}.")
        if not inner:
            yield place + name


def place(one: Setting) -> str:
    return ".".join(filter(None, (one.table.strip("[]").replace(".NAME", ""), one.key)))


@pytest.mark.parametrize("file", FILES)
def test_every_setting_has_a_meaning_and_every_meaning_a_setting(file: str) -> None:
    listed = list_settings(file)
    assert [one for one in listed if not one.meaning or not one.allowed] == []
    assert {meaning.replace(".NAME", "") for meaning in read_meanings(file)} == set(
        map(place, listed)
    )


def test_the_list_has_every_key_and_what_it_may_be_as_it_is_refused() -> None:
    listed = {place(one): one for one in list_settings("study.toml")}
    assert set(listed) >= {key for key in list_keys(Settings) if "conditions." not in key}
    assert listed["session.order"].allowed == "williams, blocked, random"
    assert listed["stimuli.levels"].allowed == "a list of as_is, equal_intensity"
    assert listed["session.repeats"].allowed == "whole number from 1 to 1000"
    assert listed["rig.full_scale_m_s2"].unit == "m/s²"
    assert listed["session.threshold.frequencies_hz"].default == "required"


@pytest.mark.parametrize("file", FILES)
def test_the_list_of_all_settings_is_toml_once_its_comments_are_taken_away(file: str) -> None:
    text = write_list(file)
    assert tomllib.loads(text) == {}
    for one in list_settings(file):
        assert f"\n# {one.key} = " in text


def test_the_command_line_prints_both_lists(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["new", "--all-settings"]) == 0
    out = capsys.readouterr().out
    assert all(write_list(file).strip() in out for file in FILES)


def test_the_defaults_of_the_list_are_those_that_hold(read: Callable[[str], Settings]) -> None:
    plain = [
        one for one in list_settings("study.toml") if re.fullmatch(r"\[\w+(\.\w+)?\]", one.table)
    ]
    given = [
        one for one in plain if one.default not in {"", "required"} and "NAME" not in one.table
    ]
    optional = (
        "[session.threshold]",
        "[session.matching]",
        "[publication]",
        "[paper",
        "[stations]",
    )
    text = SHORTEST
    for table in dict.fromkeys(one.table for one in given if not one.table.startswith(optional)):
        keys = [f"{one.key} = {one.default}\n" for one in given if one.table == table]
        text += f"{table}\n{''.join(keys)}"
    assert read(text) == read(SHORTEST)


TERMS = "observer.reducers"


def list_written(content: dict[str, Any], place: str = "") -> Iterator[str]:
    for name, value in content.items():
        several = name in {"claims", "published", "authors"} and isinstance(value, list)
        entry = value[0] if several else value
        if name == "recordings" and isinstance(value, list):
            entry = {key: one for table in value for key, one in table.items()}
        if name == "questions":
            entry = {key: one for table in value for key, one in table.items()}
        if name == "tasks":
            entry = value["similarity"] | value["triplet"]
        if name == "scales" and isinstance(value, dict):
            entry = value["roughness"]
        if not place and name in {"reducers", "metrics"}:
            (entry,) = value.values()  # one of the lab's own
        held = {"between", "formats", "options", "numbers"}
        if isinstance(entry, dict) and name not in held and place + name != TERMS:
            yield from list_written(entry, f"{place}{name}.")
        else:
            yield place + name


def test_defaults_are_those_of_the_rules_and_the_observer(read: Callable[[str], Settings]) -> None:
    settings = read(SHORTEST)
    design = make_design(settings)
    assert (design.flow, Stale(**settings.session.stale.model_dump())) == (Flow(), Stale())
    assert design.tasks == tuple(
        make_task(name, training=4, practice=2) for name in ("realism", "similarity")
    )
    assert settings.analysis.metrics[0] == ObserverModel().spectral_metric


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
    assert Stale(**settings.session.stale.model_dump()) == Stale(after_h=None, policy="restart")


def test_the_shortest_study_gives_the_recipe_of_the_stimuli_room(
    read: Callable[[str], Settings],
) -> None:
    settings = read(SHORTEST)
    assert make_recipe(settings) == Recipe(seed=settings.study.seed)


def test_every_setting_of_the_stimuli_reaches_the_recipe(read: Callable[[str], Settings]) -> None:
    recipe = make_recipe(
        read(
            SHORTEST
            + """
            [study]
            seed = 4
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
        seed=4,
    )


MISTAKES = (
    ("[stimli]", "stimli: unknown setting; did you mean stimuli?"),
    ("[rig]; zzz = 1", "rig.zzz: unknown setting; known: rate_hz, full_scale_m_s2, headroom"),
    ("unit = 'g'", "recordings[1].unit: unknown setting; known: name, sample,"),
    ("[[recordings]]; file = 'a'; unti = 'g'", "recordings[2].unti: unknown setting; did you mean"),
    ("[[recordings]]; name = 'a'", "recordings[2].file: missing; add it"),
    ("name = 'a b'", "recordings: a recording's name must be up to 100 letters"),
    ("name = 'a/b'", "recordings: a recording's name must be up to 100 letters"),
    ("[stimuli]; reducers = ['dft3211']", "stimuli.reducers[1] must be one of sax321, say321"),
    ("[session]; protocols = ['realism', 'realism']", "more than once: realism"),
    ("[stimuli]; levels = []", "stimuli.levels must hold at least one name, got []"),
    ("[stimuli]; reference = 'x'", "stimuli.reference must be one of original, none, sax321"),
    ("[stimuli]; levels = ['loud']", "stimuli.levels[1] must be one of as_is, equal_intensity"),
    ("[session]; protocols = ['x']", "session.protocols[1] must be one of realism, similarity"),
    ("[session]; language = 'xx'", "session.language must be one of de, en, or a file beside"),
    ("[session]; consent = ' '", "session.consent must not be empty, got ' '"),
    ("[session]; order = 'latin'", "session.order must be one of williams, blocked, random"),
    ("[session.rehersal]", "session.rehersal: unknown setting; did you mean rehearsal?"),
    ("[session.breaks]; every_trials = 0", 'must be greater than or equal to 1 or "off", got 0'),
    ("[session.breaks]; every_min = 'never'", "must be a valid number or \"off\", got 'never'"),
    ("[session.quality]; reject = ['late']", "reject[1] must be one of underrun, clipped,"),
    ("[session.quality]; reject = ['clipped', 'clipped']", "more than once: clipped"),
    ("[session.stale]; policy = 'x'", "policy must be one of warm_up, continue, restart"),
    ("[tasks.mushr]", "tasks.mushr must be one of realism, similarity,"),
    ("[tasks.abx]; timming = 'strict'", "tasks.abx.timming: unknown setting; did you mean timing?"),
    ("[tasks]; abx = 3", "tasks.abx must be a table, got 3"),
    ("[between]; grip = []", "between.grip must hold at least one name, got []"),
    ("[observer]; lapse_rate = 2", "observer.lapse_rate must be less than or equal to 1, got 2"),
    ("rotation = -1", "recordings[1].rotation must be greater than or equal to 0, got -1"),
    ("[session]; repeats = 0", "session.repeats must be greater than or equal to 1, got 0"),
    ("[session]; repeats = 1001", "session.repeats must be less than or equal to 1000, got 1001"),
    ("[study]; seed = '5'", "study.seed must be a valid integer, got '5'"),
    ("[study]; seed = true", "study.seed must be a valid integer, got True"),
    ("[study]; name = 2026-01-01", "got the date or time 2026-01-01; put it in quotes"),
    ("sample = ' '", "recordings[1].sample must not be empty, got ' '"),
    ("picture = ''", "recordings[1].picture must not be empty, got ''"),
    ("[between]; Levels = ['as_is']", "between.Levels must be 'level' or a label"),
    ("[between]; PROTOCOL = ['abx']", "between.PROTOCOL must be 'protocol'"),
    ("[between]; 'my grip' = ['a']", "between.my grip must be up to 40 letters"),
    ("[between]; 2nd = ['a']", "between.2nd must be up to 40 letters (A-Z), digits"),
    ("[between]; Rating = ['a']", "Rating must not be a column of participants.csv or ratings.csv"),
    ("[between]; state = ['a']", "state must not be a column of participants.csv"),
    ("[between]; last_utc = ['a']", "last_utc must not be a column of participants.csv"),
    ("[session.quality]; min_response_s = 6", "must be less than or equal to 5, got 6"),
    ("[session.quality]; gap_s = 31", "must be less than or equal to 30, got 31"),
    ("[session.quality]; max_attempts = 101", "must be less than or equal to 100, got 101"),
    ("[session.breaks]; every_min = 1441", 'must be less than or equal to 1440 or "off", got 1441'),
    ("[session.breaks]; break_s = 3601", "must be less than or equal to 3600, got 3601"),
    ("[session.breaks]; rest_s = 3601", "must be less than or equal to 3600, got 3601"),
    ("[session.rehearsal]; training = 101", "must be less than or equal to 100, got 101"),
    ("[session.rehearsal]; practice = 101", "must be less than or equal to 100, got 101"),
    ("[session.rehearsal]; rounds = 101", "must be less than or equal to 100, got 101"),
    ("[session.stale]; after_h = 1e300", 'must be less than or equal to 8760 or "off", got 1e+300'),
    ("[stimuli]; gain = 1e300", "stimuli.gain must be less than or equal to 1000000 or "),
    ("[stimuli]; gain = 1e-300", "stimuli.gain must be greater than or equal to 0.000001 or "),
    ("[rig]; full_scale_m_s2 = 1e7", "must be less than or equal to 1000000, got 10000000.0"),
    ("[study]; seed = -1", "study.seed must be greater than or equal to 0, got -1"),
    ("[rig]; rate_hz = nan", "rig.rate_hz must be "),
    (
        "[stimuli.conditioning]; high_pass_hz = 0",
        "stimuli.conditioning.high_pass_hz must be greater than 0",
    ),
    ("[analysis]; draws = 3", "analysis.draws must be greater than or equal to 100, got 3"),
)
"""What is added to the shortest study, with ; between its lines, and what is said of it."""


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "recordings: missing; add it"),
        ("recordings = []", "recordings must hold at least one name, got []"),
        ("a = ", "not valid TOML (Invalid value"),
        (SHORTEST * 2, "recordings must hold each name once"),
        (SHORTEST + f"name = '{'a' * 101}'", "must be up to 100 letters"),
        (SHORTEST * 2 + "name = 'Bumps'", "recordings: recording name 'Bumps' is there twice"),
        (
            "[[recordings]]\nscene = 'bumsp'",
            "recordings[1].scene must be one of bumps, texture_drag,",
        ),
        (
            "[[recordings]]\nfile = 'a'\nunit = 'kg'",
            "recordings[1].unit must be one of m/s^2, g, mg",
        ),
        ("a = " + "[" * 99999, "nested too deeply; use fewer levels"),
        (f"[{'.'.join('a' * 3000)}]", "nested too deeply; use fewer levels"),
        (f"a = {'[' * 250}{']' * 250}", "nested too deeply; use fewer levels"),
        (SHORTEST + f"[between]\na = {TEN}\nb = {TEN}", "at most 64 groups, got 100; use fewer"),
        *((SHORTEST + added.replace("; ", "\n"), message) for added, message in MISTAKES),
    ],
)
def test_every_mistake_is_one_line_that_says_where_what_and_what_is_allowed(
    read: Callable[[str], Settings], text: str, message: str
) -> None:
    with pytest.raises(ValueError, match="^[^\n]*" + re.escape(message) + "[^\n]*$"):
        read(text)


def test_all_mistakes_are_told_at_once(read: Callable[[str], Settings]) -> None:
    with pytest.raises(ValueError, match="unknown setting") as caught:
        read(SHORTEST + "[rig]\nzzz = 1\nheadroom = 2\n[study]\nseed = 'a'")
    assert [line.split()[1].strip(":") for line in str(caught.value).splitlines()] == [
        "study.seed",
        "rig.headroom",
        "rig.zzz",
    ]


def test_a_task_of_no_protocol_is_told_with_its_wrong_keys(read: Callable[[str], Settings]) -> None:
    with pytest.raises(ValueError, match="unknown setting") as caught:
        read(SHORTEST + "[tasks.foo]\ntimming = 1")
    assert [line.split()[1].strip(":") for line in str(caught.value).splitlines()] == [
        "tasks.foo",
        "tasks.foo.timming",
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
        FileExistsError, match=r"study\.toml: already exists and is not overwritten"
    ):
        create_study(tmp_path / "new")
    assert study.settings.read_text(encoding="utf-8") == SHORTEST


def test_a_folder_without_settings_is_no_study(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match=r"no study\.toml in"):
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
