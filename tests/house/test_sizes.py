"""Modules and functions stay small enough to be read at one go."""

from __future__ import annotations

import ast
import io
import tokenize
from statistics import median, quantiles
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from collections.abc import Iterator

MODULE_LINES = 600
FUNCTION_LINES, FUNCTION_P90, FUNCTION_MEDIAN = 50, 30, 20
NESTING = 3
IMPORT_SHARE = 0.1

FUNCTIONS = (ast.FunctionDef, ast.AsyncFunctionDef)
DOCUMENTED = (*FUNCTIONS, ast.ClassDef, ast.Module)
BLOCKS = (
    ast.If,
    ast.For,
    ast.AsyncFor,
    ast.While,
    ast.With,
    ast.AsyncWith,
    ast.Try,
    ast.TryStar,
    ast.Match,
)
SPACE = {tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENDMARKER}
SILENT = SPACE | {tokenize.COMMENT}


def code_lines(text: str, tree: ast.Module) -> set[int]:
    """The numbers of the lines that hold code: no blank lines, no comments, no docstrings."""
    lines = {
        line
        for token in tokenize.generate_tokens(io.StringIO(text).readline)
        if token.type not in SILENT
        for line in range(token.start[0], token.end[0] + 1)
    }
    return lines - {line for node in ast.walk(tree) for line in docstring_lines(node)}


def docstring_lines(node: ast.AST) -> range:
    if not isinstance(node, DOCUMENTED) or ast.get_docstring(node) is None:
        return range(0)
    return line_range(node.body[0])


def line_range(node: ast.stmt) -> range:
    return range(node.lineno, (node.end_lineno or node.lineno) + 1)


def function_lengths(path: str, text: str) -> Iterator[tuple[str, int]]:
    tree = ast.parse(text)
    code = code_lines(text, tree)
    for node in ast.walk(tree):
        if isinstance(node, FUNCTIONS):
            yield f"{path}:{node.lineno} {node.name}", len(code.intersection(line_range(node)))


def depth(node: ast.AST, *, chained: bool = False) -> int:
    """How many blocks stand inside one another in `node`; an `elif` (`chained`) is not one deeper."""
    own = int(isinstance(node, BLOCKS) and not chained)
    inner = (depth(child, chained=is_elif(node, child)) for child in ast.iter_child_nodes(node))
    return own + max(inner, default=0)


def is_elif(node: ast.AST, child: ast.AST) -> bool:
    return isinstance(node, ast.If) and isinstance(child, ast.If) and node.orelse == [child]


def function_depths(path: str, tree: ast.Module) -> Iterator[tuple[str, int]]:
    for node in ast.walk(tree):
        if isinstance(node, FUNCTIONS):
            yield f"{path}:{node.lineno} {node.name}", depth(node)


def above(sizes: list[tuple[str, int]], limit: int) -> list[tuple[str, int]]:
    return [size for size in sizes if size[1] > limit]


def test_modules(sources: Any) -> None:
    lengths = [(source.path, len(source.text.splitlines())) for source in sources]
    assert above(lengths, MODULE_LINES) == []


def test_functions(sources: Any) -> None:
    lengths = [size for source in sources for size in function_lengths(source.path, source.text)]
    assert above(lengths, FUNCTION_LINES) == []
    assert quantiles([length for _, length in lengths], n=10)[-1] <= FUNCTION_P90
    assert median(length for _, length in lengths) <= FUNCTION_MEDIAN


def test_nesting(sources: Any) -> None:
    depths = [size for source in sources for size in function_depths(source.path, source.tree)]
    assert above(depths, NESTING) == []


def import_lines(tree: ast.Module) -> int:
    imports = (node for node in ast.walk(tree) if isinstance(node, ast.Import | ast.ImportFrom))
    return sum(len(line_range(node)) for node in imports)


def test_share_of_imports(sources: Any) -> None:
    code = sum(len(code_lines(source.text, source.tree)) for source in sources)
    assert sum(import_lines(source.tree) for source in sources) <= IMPORT_SHARE * code


SNIPPET = '''
def f(
    x: int,
) -> int:
    """One.

    Two.
    """
    # a reason

    text = """a
    b"""
    return x  # another
'''


def test_only_code_is_counted() -> None:
    assert list(function_lengths("m.py", SNIPPET)) == [("m.py:2 f", 6)]


@pytest.mark.parametrize(
    ("body", "expected"),
    [
        ("pass", 0),
        ("if a:\n  pass\n elif b:\n  pass\n elif c:\n  pass", 1),
        ("if a:\n  pass\n else:\n  if b:\n   pass\n  pass", 2),
        ("for a in b:\n  with c:\n   try:\n    pass\n   except d:\n    while e:\n     pass", 4),
    ],
)
def test_depth_counts_blocks_not_branches(body: str, expected: int) -> None:
    assert [found for _, found in function_depths("m.py", ast.parse(f"def f():\n {body}"))] == [
        expected
    ]


def test_imports_are_counted_wherever_they_stand() -> None:
    assert import_lines(ast.parse("import a\nfrom b import (\n  c,\n)\ndef f():\n  import d")) == 5
