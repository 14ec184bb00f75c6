"""Whoever switches a rule off says why, beside the switch."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

# Written apart, so that this file is no finding of its own.
SWITCH = re.compile(
    r"#\s*(?:no" r"qa\b|type:\s*ig" r"nore\b|pragma:\s*no\b|(?:pylint|mypy|ruff|numpydoc)[:\s]).*"
)
NAMED = r"noqa: [A-Z]+\d+(?:, ?[A-Z]+\d+)*|type: ignore\[[\w, -]+\]|pragma: no (?:cover|branch)"
REASONED = re.compile(rf"#\s*(?:{NAMED})[\s#:,;(-]+\w.{{9,}}")
LISTS = re.compile(r"^(?:ignore|extend-ignore|checks|omit|exclude_also|ignore_imports|\".*\") = \[")


def bare_switches(path: str, text: str) -> list[str]:
    """Comments that switch a rule off without naming the rule and a reason."""
    lines = enumerate(text.splitlines(), 1)
    found = ((number, match[0]) for number, line in lines if (match := SWITCH.search(line)))
    return [
        f"{path}:{number} {comment}" for number, comment in found if not REASONED.match(comment)
    ]


def unexplained_entries(text: str) -> list[str]:
    """Lines of a linter's exclusion lists that hold codes and no comment."""
    return [line.strip() for line in listed_lines(text) if '"' in line and "#" not in line]


def listed_lines(text: str) -> Iterator[str]:
    inside = False
    for line in text.splitlines():
        opens = LISTS.match(line) is not None
        if inside or (opens and "]" in line):
            yield line
        inside = (inside or opens) and "]" not in line.partition("#")[0]


def test_switches_in_code(sources: Any, test_sources: Any) -> None:
    files = [*sources, *test_sources]
    assert [found for source in files for found in bare_switches(source.path, source.text)] == []


def test_lists_in_pyproject(root: Path) -> None:
    assert unexplained_entries((root / "pyproject.toml").read_text(encoding="utf-8")) == []


def comment(*words: str) -> str:
    return f"x = 1  # {''.join(words)}"


@pytest.mark.parametrize(
    ("line", "found"),
    [
        (comment("no", "qa"), 1),
        (comment("no", "qa: S603"), 1),
        (comment("no", "qa: S603  the program is our own"), 0),
        (comment("no", "qa: S603, S607  # the program is our own"), 0),
        (comment("type: ", "ignore"), 1),
        (comment("type: ", "ignore[arg-type]"), 1),
        (comment("type: ", "ignore[arg-type]  # the stub is wrong"), 0),
        (comment("prag", "ma: no cover"), 1),
        (comment("prag", "ma: no cover - needs a sound card"), 0),
        (comment("a remark"), 0),
    ],
)
def test_a_bare_switch_is_found(line: str, found: int) -> None:
    assert len(bare_switches("m.py", line)) == found


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ('ignore = [\n    "S101",\n]\n', ['"S101",']),
        ('ignore = [\n    "S101",  # tests\n]\n', []),
        ('"tests/**" = [\n    "D",\n]\n', ['"D",']),
        ('ignore = ["S101"]\n', ['ignore = ["S101"]']),
        ('ignore = ["S101"]  # tests\nmarkers = ["soak"]\n', []),
        ('select = [\n    "D",\n]\n', []),
    ],
)
def test_an_unexplained_entry_is_found(text: str, found: list[str]) -> None:
    assert unexplained_entries(text) == found
