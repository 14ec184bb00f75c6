"""A package's face shows exactly what its `__all__` names (ruff's RUF022 keeps the order)."""

from __future__ import annotations

import importlib
import types

import pytest

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
