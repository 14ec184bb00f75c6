"""What no tool's configuration says of the code: faces and their docstrings, and short chains of imports."""

import importlib
import inspect
import re
import subprocess
import types
from functools import cache
from pathlib import Path
from typing import Any

import grimp  # what import-linter reads imports with
import pytest
from numpydoc.docscrape import NumpyDocString, get_doc_object
from numpydoc.validate import Validator, validate

ROOMS = ("feel321.analysis", "feel321.protocols", "feel321.stimuli", "feel321.study")
LONGEST_CHAIN = 14
# A root folder that only a particular machine has; a path that goes on from a word or a dot is relative.
MACHINE = re.compile(
    r"(?<![\w.~/-])/(?:work|root|home|Users|tmp/\w+|opt/(?:pypi|wheels))[\w-]*/[\w.-]+"
)


@pytest.mark.parametrize("room", ROOMS)
def test_a_face_shows_what_all_names(room: str) -> None:
    face = importlib.import_module(room)
    shown = {
        name
        for name, value in vars(face).items()
        if not name.startswith("_") and not isinstance(value, types.ModuleType)
    }
    assert shown - {"annotations"} <= set(face.__all__)
    assert dir(face) == sorted(set(face.__all__))
    assert all(hasattr(face, name) for name in face.__all__)


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


def list_shown() -> list[str]:
    """List functions and classes of the faces, and these classes' own public methods, where they are defined."""
    names = []
    for room in ROOMS:
        face = importlib.import_module(room)
        for thing in (getattr(face, name) for name in face.__all__):
            if inspect.isclass(thing) or inspect.isfunction(thing):
                names.append(f"{thing.__module__}.{thing.__qualname__}")
            if inspect.isclass(thing):
                own = [name for name, one in vars(thing).items() if inspect.isfunction(one)]
                names += [f"{names[-1]}.{name}" for name in own if not name.startswith("_")]
    return names


def test_every_public_docstring_keeps_the_form(pyproject: Any) -> None:
    left_out = set(pyproject["tool"]["numpydoc_validation"]["checks"])
    faults = {name: validate(name, HouseValidator)["errors"] for name in list_shown()}
    assert [
        f"{name}: {code} {text}"
        for name, found in faults.items()
        for code, text in found
        if code not in left_out
    ] == []


def test_chains_of_imports_are_short() -> None:
    """Lazy imports and those for the type checker count too."""
    graph = grimp.build_graph("feel321", cache_dir=None)

    @cache
    def walk(module: str) -> tuple[str, ...]:
        inner = graph.find_modules_directly_imported_by(module)
        return (module, *max((walk(one) for one in sorted(inner)), key=len, default=()))

    # `python -m feel321` is another name of the command.
    longest = max((walk(one) for one in graph.modules - {"feel321.__main__"}), key=len)
    assert len(longest) <= LONGEST_CHAIN, longest


def test_no_file_names_a_machine(root: Path) -> None:
    if not (root / ".git").exists():
        pytest.skip("NO GIT CHECKOUT: what is tracked cannot be told")
    listing = subprocess.run(
        ["git", "ls-files", "-z"], cwd=root, capture_output=True, text=True, check=True
    )
    paths = [path for name in listing.stdout.split("\0") if (path := root / name).is_file()]
    texts = {path: path.read_text(encoding="utf-8", errors="replace") for path in paths}
    assert [
        (path, found[0]) for path, text in texts.items() if (found := MACHINE.search(text))
    ] == []
