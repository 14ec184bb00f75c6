"""Everything that a face shows has a docstring that numpydoc finds nothing wrong with."""

from __future__ import annotations

import ast
import importlib
import inspect
from typing import TYPE_CHECKING, Any

import pytest
from numpydoc.docscrape import NumpyDocString, get_doc_object
from numpydoc.validate import Validator, validate

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

ROOMS = ("analysis", "protocols", "stimuli", "study")
DEFINITIONS = (ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)


class HouseValidator(Validator):
    """Numpydoc's rules, with the house's view of what a caller passes.

    Ports are never called; a table of study.toml is explained in study.toml; a record may list its fields as
    attributes; what starts with _ is private.
    """

    def __init__(self, obj_name: str) -> None:
        super().__init__(get_doc_object(Validator._load_obj(obj_name)))

    @property
    def signature_parameters(self) -> tuple[str, ...]:
        if getattr(self.obj, "_is_protocol", False) or hasattr(self.obj, "model_fields"):
            return ()
        told = {name for name, _, _ in NumpyDocString(self.clean_doc)["Attributes"]}
        return tuple(
            name for name in super().signature_parameters if name[0] != "_" and name not in told
        )


def module_name(path: str) -> str:
    return path.removesuffix(".py").removesuffix("/__init__").replace("/", ".")


def definitions(node: ast.Module | ast.ClassDef) -> Iterator[Any]:
    return (
        inner
        for inner in node.body
        if isinstance(inner, DEFINITIONS) and not inner.name.startswith("_")
    )


def public_names(path: str, tree: ast.Module) -> Iterator[str]:
    """Dotted names of a module's public classes and functions, and of its public classes' public methods."""
    module = module_name(path)
    for node in definitions(tree):
        yield f"{module}.{node.name}"
        if isinstance(node, ast.ClassDef):
            yield from (f"{module}.{node.name}.{inner.name}" for inner in definitions(node))


def faults(name: str, checks: set[str]) -> list[str]:
    """What numpydoc holds against a docstring, `all` but the listed codes."""
    errors = validate(name, HouseValidator)["errors"]
    return [f"{name}: {code} {text}" for code, text in errors if code not in checks]


def shown_names() -> set[str]:
    """Dotted names, where they are defined, of the functions and classes in the faces' `__all__`."""
    faces = [importlib.import_module(f"feel321.{room}") for room in ROOMS]
    things = [getattr(face, name) for face in faces for name in face.__all__]
    return {
        f"{thing.__module__}.{thing.__qualname__}"
        for thing in things
        if inspect.isclass(thing) or inspect.isfunction(thing)
    }


def test_every_module_says_what_it_is(sources: Any) -> None:
    assert [source.path for source in sources if ast.get_docstring(source.tree) is None] == []


def test_every_public_docstring_keeps_the_form(sources: Any, pyproject: Any) -> None:
    checks = set(pyproject["tool"]["numpydoc_validation"]["checks"])
    shown = shown_names()
    names = [
        name
        for source in sources
        for name in public_names(source.path, source.tree)
        if any(name == one or name.startswith(f"{one}.") for one in shown)
    ]
    assert len(names) > len(shown) / 2
    assert [fault for name in names for fault in faults(name, checks)] == []


SNIPPET = '''
def f(a, b):
    """Add.

    Parameters
    ----------
    a, c : int
        Terms.

    Returns
    -------
    int
        The sum.
    """

class K:
    """A thing."""
    def g(self):
        """Return one."""
        return 1
    def _h(self):
        return 1
'''


@pytest.mark.parametrize(
    ("name", "codes"),
    [
        ("house_snippet.f", ["PR01", "PR02"]),
        ("house_snippet.K", []),
        ("house_snippet.K.g", ["RT01"]),
    ],
)
def test_a_false_docstring_is_found(
    name: str, codes: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    tmp_path.joinpath("house_snippet.py").write_text(SNIPPET, encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    found = faults(name, {"ES01", "SA01", "EX01"})
    assert [fault.split()[1] for fault in found] == codes


def test_private_names_are_left_alone() -> None:
    assert list(public_names("a/b.py", ast.parse(SNIPPET))) == ["a.b.f", "a.b.K", "a.b.K.g"]
