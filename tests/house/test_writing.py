"""Folders, moves and temporary files are made in `feel321/files.py` only, which makes their names durable."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

ALWAYS = {"mkdir", "makedirs", "mkdtemp", "mkstemp", "touch", "write_text", "write_bytes"}
ALWAYS |= {"TemporaryDirectory", "NamedTemporaryFile", "TemporaryFile", "replace", "rename"}
OURS = {"files", "dataclasses"}
LEFT_OUT = {
    ("analysis/report/folder.py", "write_text"),  # into a stage that `move_files` makes durable
    ("stimuli/sets/build.py", "rename"),  # parts of a build that nobody finished, out of the way
    ("study/export/dataset.py", "rename"),  # a whole folder in the place of another one
    ("study/checkpoints.py", "rename"),  # a whole folder, where none is
    ("study/study.py", "replace"),  # of values in a data frame
}


def list_writes(code: str) -> Iterator[str]:
    """List the calls that would make or move a name."""
    for node in ast.walk(ast.parse(code)):
        if not isinstance(node, ast.Call):
            continue
        call = node.func
        name = getattr(call, "attr", getattr(call, "id", ""))
        of = getattr(getattr(call, "value", None), "id", "")
        moves = len(node.args) == (2 if of == "os" else 1) and not node.keywords
        is_word = any(isinstance(one, ast.Constant | ast.Dict) for one in node.args)
        if name in {"replace", "rename"} and (not moves or is_word or isinstance(call, ast.Name)):
            continue
        if name in ALWAYS and of not in OURS and not (isinstance(call, ast.Name) and "_" in name):
            yield name


def test_only_files_writes(root: Path) -> None:
    package = root / "feel321"
    found = {
        (path.relative_to(package).as_posix(), name)
        for path in package.rglob("*.py")
        if path != package / "files.py"
        for name in list_writes(path.read_text(encoding="utf-8"))
    }
    assert found == LEFT_OUT, "go through feel321/files.py"


@pytest.mark.parametrize(
    "code",
    [
        "path.mkdir(parents=True)",
        "os.makedirs(path)",
        "tempfile.mkdtemp()",
        "with TemporaryDirectory() as a: pass",
        "os.rename(a, b)",
        "os.replace(a, b)",
        "path.replace(target)",
        "path.with_suffix('.a').rename(target)",
        "(a / b).write_text(text)",
    ],
)
def test_a_write_is_found(code: str) -> None:
    assert list(list_writes(code))


@pytest.mark.parametrize(
    "code",
    [
        "text.replace(a, b)",
        "frame.rename(columns=a)",
        "frame.rename('a')",
        "dataclasses.replace(a, b=c)",
        "files.write_text(path, text)",
    ],
)
def test_other_words_pass(code: str) -> None:
    assert not list(list_writes(code))
