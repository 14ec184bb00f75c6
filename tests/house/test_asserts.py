"""No `assert` outside the tests: `python -O` removes it, and a user's mistake deserves a sentence."""

from __future__ import annotations

import ast
from typing import Any


def asserts(path: str, tree: ast.Module) -> list[str]:
    return [f"{path}:{node.lineno}" for node in ast.walk(tree) if isinstance(node, ast.Assert)]


def test_rooms_hold_no_assert(sources: Any) -> None:
    assert [found for source in sources for found in asserts(source.path, source.tree)] == []


def test_an_assert_is_found() -> None:
    assert asserts("m.py", ast.parse("def f(x):\n    assert x > 0\n")) == ["m.py:2"]
