"""README and documentation: complete, linked, and every command, option, import and setting in them exists."""

import re
import shlex
import tomllib
from importlib import import_module
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import pytest

from feel321.analysis.table.columns import read_dictionary
from feel321.stimuli.condition import Conditioning, condition
from feel321.stimuli.match import spectral_match, temporal_match
from feel321.stimuli.reducers.registry import REDUCERS
from feel321.stimuli.synthesis import SCENES, make_scene
from feel321.study.actuator.rig import read_rig
from feel321.study.all_settings import FILES, list_settings
from feel321.study.cli import APP, VERBS, main
from feel321.study.folder import create_study
from feel321.study.settings.read import add_methods, read_settings

POOR = 0.75
"""A match that is poor: where a page says that a reducer fails, one of the two is not above."""

RIG = 'device = { name = "file" }\nlimits = { peak_m_s2 = 100.0, rms_m_s2 = 50.0, duration_s = 30.0 }\n'
RECORDING = '[[recordings]]\nscene = "bumps"\n'
RUN = {"match", "new", "reduce", "status"}
"""Verbs that take less than a second; the others' arguments are parsed only, and the tutorial runs most of them."""


@pytest.fixture
def site(root: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """Import a module of docs/docsite, which is no part of the package."""
    monkeypatch.syspath_prepend(root / "docs")

    def find(name: str) -> Any:
        pytest.importorskip("sphinx", reason='NO SPHINX: pip install -c constraints.txt ".[docs]"')
        return import_module(f"docsite.{name}")

    return find


@pytest.fixture(scope="module")
def blocks(pages: dict[str, str]) -> list[tuple[str, str, str]]:
    """Page, language and text of every fenced block."""
    return [
        (page, language, text)
        for page, whole in pages.items()
        for language, text in re.findall(r"^```(\w*)\n(.*?)^```", whole, re.MULTILINE | re.DOTALL)
    ]


@pytest.fixture
def lab(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The current folder, with the files that the pages' examples name."""
    monkeypatch.chdir(tmp_path)
    drag = make_scene("texture_drag")
    columns = np.vstack([np.arange(drag.n_samples) / drag.rate_hz, drag.acceleration / 9.80665])
    for name in ("oak.csv", "vinyl.csv"):
        np.savetxt(name, columns.T, delimiter=",", header="time_s,x,y,z", comments="")
    return tmp_path


def test_every_public_name_is_described_once(site: Any, tmp_path: Path) -> None:
    reference = site("reference")
    reference.write_faces(tmp_path)
    modules = [name for names in reference.FACES.values() for name in names]
    text = "\n".join(page.read_text() for page in tmp_path.glob("*.rst"))
    described = re.findall(r"^\.\. (?:autoclass|autofunction|py:data):: (\w+)$", text, re.MULTILINE)
    things = {
        id(getattr(import_module(one), name)): name
        for one in modules
        for name in import_module(one).__all__
    }
    assert sorted(described) == sorted(things.values())
    listed = re.findall(r":py:obj:`(\w+) <[\w.]+>`\n +- (.+)", text)
    assert sorted(name for name, purpose in listed if purpose.strip()) == sorted(described)


def test_every_verb_column_and_setting_is_in_the_reference(site: Any, tmp_path: Path) -> None:
    reference = site("reference")
    reference.write_verbs(tmp_path / "verbs.rst")
    reference.write_tables(tmp_path / "tables.rst")
    site("settings").write_settings(tmp_path / "settings.rst")
    names = ("verbs", "tables", "settings")
    verbs, tables, settings = ((tmp_path / f"{name}.rst").read_text() for name in names)
    for verb in VERBS:
        section = verbs.partition(f"\n{verb}\n{'-' * len(verb)}\n")[2].partition("\n---")[0]
        options = [
            one.name
            for one in APP[verb].assemble_argument_collection()
            if one.parse and not one.children
        ]
        assert [one for one in options if one.startswith("-") and one not in section] == [], verb
    assert [row for row in read_dictionary() if f"* - ``{row.column}``" not in tables] == []
    listed = [one.key for file in FILES for one in list_settings(file)]
    assert [key for key in listed if f"* - ``{key}``" not in settings] == []


def test_every_page_is_in_the_index_and_linked_from_the_readme(
    site: Any, root: Path, pages: dict[str, str]
) -> None:
    reference = site("reference")
    assert {"README.md", *(f"docs/{name}.md" for name in reference.PAGES)} == set(pages)
    reference.write_index(root / "docs" / "index.rst")
    text = (root / "docs" / "index.rst").read_text(encoding="utf-8")
    assert all(f":doc:`{name}`" in text for name in (*reference.PAGES, *reference.REFERENCE))
    linked = set(re.findall(r"\]\((docs/[\w-]+\.md)\)", pages["README.md"]))
    assert linked == set(pages) - {"README.md"}


def test_scores_and_failures_are_those_of_the_scenes(site: Any) -> None:
    methods = site("methods")
    assert set(methods.WORDS["reducers"]) == set(methods.REDUCERS)
    assert set(methods.WORDS["metrics"]) == set(methods.METRICS)
    shown = {row[0].strip("`"): row[1:] for row in methods._list_scenes()}
    assert list(shown) == list(SCENES)
    for name, cells in shown.items():
        scene = condition(make_scene(name), Conditioning())
        samples, rate = scene.acceleration, scene.rate_hz
        for reducer, cell in zip(methods.COMPARED, cells, strict=True):
            reduced = REDUCERS[reducer](samples, rate)
            pair = spectral_match(samples, reduced, rate), temporal_match(samples, reduced)
            assert [float(one) for one in cell.split("/")] == pytest.approx(pair, abs=0.006)
    found = {
        name: methods.measure(name, methods.BATTERY[words["scene"]].make(1))[1:]
        for name, words in methods.WORDS["reducers"].items()
    }
    assert {name: pair for name, pair in found.items() if min(pair) > POOR} == {}


@pytest.mark.usefixtures("lab")
def test_every_command_is_valid_and_the_quick_ones_run(
    blocks: list[tuple[str, str, str]], pages: dict[str, str]
) -> None:
    for name in ("oak-study", "my-study"):
        assert main(["new", name]) == 0
    for line in (line for _, _, text in blocks for line in text.splitlines()):
        if not re.match(r"(\$ )?feel321 ", line):
            continue
        words = shlex.split(line.removeprefix("$ "), comments=True)[1:]
        if words[0] not in RUN:
            APP.parse_args(words)
        elif "--watch" not in words and not (words[0] == "new" and Path(words[1]).exists()):
            assert main(words) == 0, words
    named = set(re.findall(r"(?<!from )\bfeel321 ([a-z]+)\b", "\n".join(pages.values())))
    assert set(VERBS) <= named


def test_every_link_leads_somewhere_and_every_picture_is_shown(
    root: Path, pages: dict[str, str]
) -> None:
    names = ("CHANGELOG.md", "CONTRIBUTING.md", "SECURITY.md")
    others = {name: (root / name).read_text(encoding="utf-8") for name in names}
    dead, seen = [], set()
    for page, text in (pages | others).items():
        for target in re.findall(r"\]\((?!https:)([^)\s]+)\)", text):
            name, _, heading = target.partition("#")
            file = (root / page).parent / name if name else root / page
            seen.add(file)
            told = re.findall(r"^#+ (.*)$", file.read_text("utf-8"), re.M) if heading else []
            anchors = [re.sub(r"[^\w -]", "", one.lower()).replace(" ", "-") for one in told]
            if not file.is_file() or (heading and heading not in anchors):
                dead.append((page, target))
    assert dead == []
    assert {path for kind in ("png", "svg") for path in (root / "docs").rglob(f"*.{kind}")} <= seen


def test_every_python_block_runs(lab: Path, blocks: list[tuple[str, str, str]]) -> None:
    (lab / "stimuli").mkdir()
    rng = np.random.default_rng(0)
    stimuli = [(f"{scene}-{name}", scene, name) for scene in "abcd" for name in list(REDUCERS)[:4]]
    manifest = [f"{','.join(names)},{rng.random()},{rng.random()}" for names in stimuli]
    header = "stimulus_id,recording,reducer,spectral_match_bounded,temporal_match"
    (lab / "stimuli" / "manifest.csv").write_text("\n".join([header, *manifest]))
    ratings = [
        f"p{who},{names[0]},realism,{rng.uniform(20, 80)}" for who in range(4) for names in stimuli
    ]
    head = "participant,stimulus_id,scale,rating"
    (lab / "ratings.csv").write_text("\n".join([head, *ratings]))
    for page, language, text in blocks:
        if language == "python":
            exec(compile(text, page, "exec"), {})  # noqa: S102 - that a reader may paste it is the point
    plt.close("all")


def test_every_setting_is_accepted(blocks: list[tuple[str, str, str]], tmp_path: Path) -> None:
    """What a page shows of study.toml or rig.toml is read once what it leaves out is added."""
    add_methods(create_study(tmp_path))  # whose files pages name
    (tmp_path / "corpus").mkdir()
    for number in range(20):
        (tmp_path / "corpus" / f"tap{number}.wav").touch()
    study, rig = tmp_path / "study.toml", tmp_path / "rig.toml"
    for text in (text for _, language, text in blocks if language == "toml"):
        given = tomllib.loads(text)
        if {"actuators", "keys", "sync"} & given.keys():
            rig.write_text(RIG + text, encoding="utf-8")
            read_rig(rig)
        else:
            study.write_text(("" if "recordings" in given else RECORDING) + text, encoding="utf-8")
            read_settings(study)
