"""A package's face shows exactly what its `__all__` names (ruff's RUF022 keeps the order)."""

from __future__ import annotations

import ast
import builtins
import doctest
import importlib
import inspect
import sys
import types
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from collections.abc import Iterator

ROOMS = ("feel321.analysis", "feel321.protocols", "feel321.stimuli", "feel321.study")


def faults(package: types.ModuleType) -> list[str]:
    promised = list(getattr(package, "__all__", []))
    shown = [name for name, value in vars(package).items() if is_public(name, value)]
    return [
        *(f"{name}: in __all__, not there" for name in promised if not hasattr(package, name)),
        *(f"{name}: there, not in __all__" for name in shown if name not in promised),
        *(["a name stands twice in __all__"] if len(promised) != len(set(promised)) else []),
    ]


def is_public(name: str, value: object) -> bool:
    """Modules appear on a package as soon as somebody imports them; `annotations` is the future's import."""
    return (
        not name.startswith("_")
        and not isinstance(value, types.ModuleType)
        and name != "annotations"
    )


@pytest.mark.parametrize("room", ROOMS)
def test_face(room: str) -> None:
    assert faults(importlib.import_module(room)) == []


@pytest.mark.parametrize(
    ("code", "expected"),
    [
        ("__all__ = ['a', 'b']; a = b = 1", []),
        ("__all__ = ['a']", ["a: in __all__, not there"]),
        ("__all__ = ['a']; a = b = 1", ["b: there, not in __all__"]),
        ("__all__ = ['a', 'a']; a = 1", ["a name stands twice in __all__"]),
        ("import math; _a = 1", []),
    ],
)
def test_a_false_face_is_found(code: str, expected: list[str]) -> None:
    package = types.ModuleType("package")
    exec(code, vars(package))  # noqa: S102  a module made of this file's own text
    assert faults(package) == expected


def test_tab_shows_the_face_only() -> None:
    for room in ROOMS:
        face = importlib.import_module(room)
        assert dir(face) == sorted(face.__all__)


def shown() -> Iterator[tuple[str, object]]:
    """Everything a face shows that has a docstring, by its dotted name."""
    for room in ROOMS:
        face = importlib.import_module(room)
        for name in face.__all__:
            thing = getattr(face, name)
            if inspect.isclass(thing) or inspect.isfunction(thing):
                yield f"{room}.{name}", thing


def private_types(thing: object) -> Iterator[str]:
    """Names in the signatures of a function, or of a class's public methods, that no face shows."""
    module = sys.modules[thing.__module__]
    tree = ast.parse(Path(str(module.__file__)).read_text(encoding="utf-8"))
    node = next(one for one in ast.walk(tree) if getattr(one, "name", "") == thing.__name__)
    origins = {
        alias.asname or alias.name: one.module or ""
        for one in ast.walk(tree)
        if isinstance(one, ast.ImportFrom)
        for alias in one.names
    }
    for name in annotated_names(node):
        own = origins.get(name, thing.__module__).startswith("feel321")
        if own and name not in PUBLIC and not hasattr(builtins, name):
            yield name


def annotated_names(node: ast.AST) -> Iterator[str]:
    inner = getattr(node, "body", []) if isinstance(node, ast.ClassDef) else [node]
    for function in inner:
        if isinstance(function, ast.FunctionDef) and not function.name.startswith("_"):
            arguments = function.args
            every = [
                *arguments.posonlyargs,
                *arguments.args,
                *arguments.kwonlyargs,
                arguments.vararg,
            ]
            notes = [one.annotation for one in every if one is not None] + [function.returns]
            for note in filter(None, notes):
                yield from (one.id for one in ast.walk(note) if isinstance(one, ast.Name))


PUBLIC = {
    name
    for face in (*ROOMS, "feel321.types", "feel321.results", "feel321.jobs")
    for name in importlib.import_module(face).__all__
} | {"np", "pd"}


@pytest.mark.parametrize(("name", "thing"), list(shown()))
def test_types_in_signatures_are_public(name: str, thing: object) -> None:
    assert {f"{name}: {private}" for private in private_types(thing)} == set()


@pytest.mark.parametrize(("name", "thing"), list(shown()))
def test_examples_run_as_they_are_pasted(
    name: str, thing: object, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    flags = doctest.NORMALIZE_WHITESPACE | doctest.ELLIPSIS
    runner = doctest.DocTestRunner(optionflags=flags, verbose=False)
    test = doctest.DocTestParser().get_doctest(inspect.getdoc(thing) or "", {}, name, None, None)
    assert runner.run(test).failed == 0
