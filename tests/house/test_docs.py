"""The documentation site: its reference is complete, by the faces and registries that it is generated from."""

from __future__ import annotations

import re
import shlex
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cyclopts import CycloptsError

from feel321.analysis.table.dictionary import read_dictionary
from feel321.stimuli.condition import Conditioning, condition
from feel321.stimuli.match import spectral_match, temporal_match
from feel321.stimuli.reducers.registry import REDUCERS
from feel321.stimuli.synthesis import SCENES, make_scene
from feel321.study.all_settings import FILES, list_settings
from feel321.study.cli import APP, VERBS, main


@pytest.fixture
def site(root: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """Import a module of docs/docsite, which is no part of the package."""
    monkeypatch.syspath_prepend(root / "docs")

    def find(name: str) -> Any:
        pytest.importorskip("sphinx", reason='NO SPHINX: pip install -c constraints.txt ".[docs]"')
        return import_module(f"docsite.{name}")

    return find


def test_every_public_name_is_described_once(site: Any, tmp_path: Path) -> None:
    reference = site("reference")
    reference.write_faces(tmp_path)
    modules = [name for names in reference.FACES.values() for name in names]
    assert set(modules) > {
        f"feel321.{room}" for room in ("analysis", "protocols", "stimuli", "study")
    }
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


def test_every_verb_and_option_is_in_the_reference(site: Any, tmp_path: Path) -> None:
    site("reference").write_verbs(tmp_path / "verbs.rst")
    text = (tmp_path / "verbs.rst").read_text()
    for verb in VERBS:
        _, _, section = text.partition(f"\n{verb}\n{'-' * len(verb)}\n")
        section, _, _ = section.partition("\n---")
        options = [one.name for one in APP[verb].assemble_argument_collection() if not one.children]
        shown = [name for name in options if name.startswith("-")]
        assert [name for name in shown if name not in section] == [], verb
        assert f"feel321 {verb}" in section


def test_every_page_is_in_the_index(site: Any, root: Path) -> None:
    reference = site("reference")
    assert {f"{name}.md" for name in reference.PAGES} == {
        path.name for path in (root / "docs").glob("*.md")
    }
    reference.write_index(root / "docs" / "index.rst")
    text = (root / "docs" / "index.rst").read_text(encoding="utf-8")
    assert all(f":doc:`{name}`" in text for name in (*reference.PAGES, *reference.REFERENCE))


def test_every_column_of_every_table_is_in_the_reference(site: Any, tmp_path: Path) -> None:
    site("reference").write_tables(tmp_path / "tables.rst")
    text = (tmp_path / "tables.rst").read_text(encoding="utf-8")
    assert [row for row in read_dictionary() if f"* - ``{row.column}``" not in text] == []


def test_a_page_is_written_only_where_it_changes(site: Any, tmp_path: Path) -> None:
    page = tmp_path / "page.rst"
    site("text").write(page, "Words.")
    before = page.stat().st_mtime_ns
    site("text").write(page, "Words.")
    assert page.stat().st_mtime_ns == before
    site("text").write(page, "Other words.")
    assert page.read_text() == "Other words.\n"


def test_every_setting_is_in_the_reference(site: Any, tmp_path: Path) -> None:
    site("settings").write_settings(tmp_path / "settings.rst")
    text = (tmp_path / "settings.rst").read_text(encoding="utf-8")
    for file in FILES:
        assert [one for one in list_settings(file) if f"* - ``{one.key}``" not in text] == []


def test_every_reducer_and_metric_has_formula_and_failure(site: Any, tmp_path: Path) -> None:
    methods = site("methods")
    methods.write_reducers(tmp_path / "reducers.rst")
    methods.write_metrics(tmp_path / "metrics.rst")
    for kind, names in (("reducers", methods.REDUCERS), ("metrics", methods.METRICS)):
        assert set(methods.WORDS[kind]) == set(names)
        text = (tmp_path / f"{kind}.rst").read_text(encoding="utf-8")
        assert "]_" not in text
        for name in names:
            _, _, section = text.partition(f"\n{name}\n{'-' * len(name)}\n")
            formula, _, failure = section.partition("**When it ")
            assert len(formula.split()) > 14, name
            assert methods.WORDS[kind][name]["fails"] in failure
    assert set(methods.DRAWN) < set(methods.REDUCERS)


def test_the_scores_that_are_shown_are_those_of_the_scenes(site: Any) -> None:
    methods = site("methods")
    shown = {row[0].strip("`"): row[1:] for row in methods._list_scenes()}
    assert list(shown) == list(SCENES)
    for name, cells in shown.items():
        scene = condition(make_scene(name), Conditioning())
        samples, rate = scene.acceleration, scene.rate_hz
        for reducer, cell in zip(methods.COMPARED, cells, strict=True):
            reduced = REDUCERS[reducer](samples, rate)
            pair = spectral_match(samples, reduced, rate), temporal_match(samples, reduced)
            assert [float(one) for one in cell.split("/")] == pytest.approx(pair, abs=0.006)


POOR = 0.75
"""A match that is poor: where a page says that a reducer fails, one of the two is not above."""


def test_each_reducer_fails_where_its_page_says(site: Any) -> None:
    methods = site("methods")
    found = {
        name: methods.measure(name, methods.BATTERY[words["scene"]].make(1))[1:]
        for name, words in methods.WORDS["reducers"].items()
    }
    assert {name: pair for name, pair in found.items() if min(pair) > POOR} == {}


RUN = {"match", "new", "reduce", "status"}
"""Verbs that take less than a second; the others' arguments are parsed only, and the tutorial runs most of them."""


@dataclass(frozen=True, slots=True)
class Call:
    """A call of the command line on a page."""

    page: str
    words: list[str]


@pytest.fixture(scope="module")
def calls(root: Path) -> list[Call]:
    return [
        Call(page.name, shlex.split(line.removeprefix("$ "), comments=True)[1:])
        for page in [root / "README.md", *sorted((root / "docs").glob("*.md"))]
        for block in re.findall(
            r"^```(?:sh|console)\n(.*?)^```", page.read_text(encoding="utf-8"), re.M | re.S
        )
        for line in block.splitlines()
        if re.match(r"(\$ )?feel321 ", line)
    ]


def parse(words: list[str]) -> None:
    """Read a verb's arguments as the program would, without running it."""
    APP.parse_args(words)


def test_every_command_of_every_page_is_valid_and_the_quick_ones_run(
    calls: list[Call], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert len(calls) > 50
    monkeypatch.chdir(tmp_path)
    drag = make_scene("texture_drag", duration_s=0.5)
    columns = np.vstack([np.arange(drag.n_samples) / drag.rate_hz, drag.acceleration / 9.80665])
    for name in ("oak.csv", "vinyl.csv"):
        np.savetxt(name, columns.T, delimiter=",", header="time_s,x,y,z", comments="")
    for name in ("oak-study", "my-study"):
        assert main(["new", name]) == 0
    for call in calls:
        verb = call.words[0]
        if "--watch" in call.words:  # ends by Ctrl-C only
            continue
        if verb == "new" and Path(call.words[1]).exists():
            continue
        if verb in RUN:
            assert main(call.words) == 0, call
        else:
            parse(call.words)


def test_a_wrong_argument_is_found() -> None:
    with pytest.raises(CycloptsError, match="into float"):
        parse(["doctor", "--seconds", "long"])
    with pytest.raises(CycloptsError, match="requires an argument"):
        parse(["match", "oak.csv"])
