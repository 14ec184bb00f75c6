"""Tables and settings that people edit are read through `feel321/intake.py`: regular files only, UTF-8, bounded."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

READS = {"open", "read_text", "read_bytes"}
EDITED = {"settings", "ratings", "manifest", "rig"}
STRICT = {
    "study/export/narrative.py",
    "study/settings/edit.py",
    "study/settings/fields.py",
    "study/workflow.py",
}
"""Modules that read such files by other names, too."""


def list_reads(code: str, *, strict: bool = False) -> Iterator[str]:
    """List the calls that open such a file past the door."""
    for node in ast.walk(ast.parse(code)):
        if isinstance(node, ast.Call) and isinstance(call := node.func, ast.Attribute):
            of = getattr(call.value, "attr", getattr(call.value, "id", ""))
            if call.attr in READS and of != "intake" and (strict or of in EDITED):
                yield ast.unparse(call)


def test_what_people_edit_comes_through_the_door(root: Path) -> None:
    package = root / "feel321"
    assert all((package / name).is_file() for name in STRICT)
    found = [
        f"{name}: {call}"
        for path in package.rglob("*.py")
        for name in [path.relative_to(package).as_posix()]
        for call in list_reads(path.read_text(encoding="utf-8"), strict=name in STRICT)
    ]
    assert not found, "go through feel321/intake.py"


@pytest.mark.parametrize("code", ["study.ratings.open()", "settings.read_text()"])
def test_a_read_is_found(code: str) -> None:
    assert list(list_reads(code))


@pytest.mark.parametrize("code", ["intake.read_small(settings)", "Study.open(path)"])
def test_the_door_passes(code: str) -> None:
    assert not list(list_reads(code))
