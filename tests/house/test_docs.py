"""The documentation site: its reference is complete, by the faces and registries that it is generated from."""

from __future__ import annotations

import re
from importlib import import_module
from typing import TYPE_CHECKING, Any

import pytest

from feel321.study.cli import feel321

if TYPE_CHECKING:
    from pathlib import Path


@pytest.fixture
def site(root: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """Import a module of docs/docsite, which is no part of the package."""
    monkeypatch.syspath_prepend(root / "docs")

    def find(name: str) -> Any:
        pytest.importorskip("sphinx", reason='NO SPHINX: pip install -c constraints.txt ".[docs]"')
        return import_module(f"docsite.{name}")

    return find


def test_every_public_name_has_a_page(site: Any, tmp_path: Path) -> None:
    reference = site("reference")
    reference.write_faces(tmp_path)
    rooms = {f"feel321.{room}" for room in ("analysis", "protocols", "stimuli", "study")}
    assert set(reference.FACES) > rooms
    for face in reference.FACES:
        names = set(import_module(face).__all__)
        assert {page.stem for page in (tmp_path / face).glob("*.rst")} == {*names, "index"}
        listed = re.findall(
            r":doc:`(\w+) <\1>`\n +- (.+)", (tmp_path / face / "index.rst").read_text()
        )
        assert {name for name, purpose in listed if purpose.strip()} == names


def test_every_verb_and_option_is_in_the_reference(site: Any, tmp_path: Path) -> None:
    site("reference").write_commands(tmp_path / "commands.rst", feel321)
    text = (tmp_path / "commands.rst").read_text()
    for verb, command in feel321.commands.items():
        _, _, section = text.partition(f".. _verb-{verb}:\n")
        section, _, _ = section.partition(".. _verb-")
        options = {name for each in command.params for name in each.opts if name.startswith("-")}
        assert {name for name in options if name not in section} == set(), verb
        assert f"   feel321 {verb}" in section


def test_a_page_is_written_only_where_it_changes(site: Any, tmp_path: Path) -> None:
    page = tmp_path / "page.rst"
    site("text").write(page, "Words.")
    before = page.stat().st_mtime_ns
    site("text").write(page, "Words.")
    assert page.stat().st_mtime_ns == before
    site("text").write(page, "Other words.")
    assert page.read_text() == "Other words.\n"
