"""Modules are subjects: short chains of imports, and one meaning per class name."""

from __future__ import annotations

import ast
from collections import defaultdict
from functools import cache
from typing import TYPE_CHECKING, Any

import grimp  # what import-linter reads imports with

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

LONGEST_CHAIN = 14


def longest_chain(imports: Mapping[str, Iterable[str]]) -> list[str]:
    """The longest way from one module to the next along imports, of which there is no circle."""

    @cache
    def walk(module: str) -> tuple[str, ...]:
        ways = [walk(inner) for inner in sorted(imports.get(module, ()))]
        return (module, *max(ways, key=len, default=()))

    return list(max((walk(module) for module in imports), key=len))


def meanings(trees: Mapping[str, ast.Module]) -> dict[str, list[str]]:
    """Names of public classes that several modules define."""
    places = defaultdict(list)
    for path, tree in trees.items():
        for node in ast.walk(tree):
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                places[node.name].append(path)
    return {name: found for name, found in places.items() if len(found) > 1}


def test_chain_of_imports() -> None:
    """Lazy imports and those for the type checker count too."""
    graph = grimp.build_graph("feel321", cache_dir=None)
    chain = longest_chain({
        module: graph.find_modules_directly_imported_by(module)
        for module in graph.modules
        - {"feel321.__main__"}  # `python -m feel321` is another name of the command
    })
    assert len(chain) <= LONGEST_CHAIN, chain


def test_class_names_have_one_meaning(sources: Any) -> None:
    assert meanings({source.path: source.tree for source in sources}) == {}


def test_the_longest_chain_is_found() -> None:
    assert longest_chain({"a": ["b", "d"], "b": ["c"], "d": []}) == ["a", "b", "c"]


def test_a_name_with_two_meanings_is_found() -> None:
    trees = {
        path: ast.parse(text)
        for path, text in {
            "a.py": "class Plan: ...",
            "b.py": "class Plan: ...\nclass _Own: ...",
            "c.py": "class _Own: ...",
        }.items()
    }
    assert meanings(trees) == {"Plan": ["a.py", "b.py"]}
