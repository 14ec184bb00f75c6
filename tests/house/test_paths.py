"""No tracked file knows the machine it was written on, and no pin knows a registry."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from pathlib import Path

# A root folder that only a particular machine has; a path that goes on from a word or a dot is relative.
MACHINE = re.compile(
    r"(?<![\w.~/-])/(?:work|root|home|Users|tmp/\w+|opt/(?:pypi|wheels))[\w-]*/[\w.-]+"
)
PIN = re.compile(r"[A-Za-z0-9][\w.-]*==[\w.+!]+")
HOST = re.compile(r"https?://|--|(?:^|\W)file:|@")


def machine_paths(name: str, text: str) -> list[str]:
    lines = enumerate(text.splitlines(), 1)
    return [
        f"{name}:{number} {match[0]}" for number, line in lines for match in MACHINE.finditer(line)
    ]


def text_of(path: Path) -> str:
    """A file's text; what is no UTF-8 (recordings, pictures) has none."""
    try:
        return path.read_text(encoding="utf-8")
    except UnicodeDecodeError:
        return ""


def test_no_machine_paths(tracked: tuple[Path, ...], root: Path) -> None:
    names = [(path.relative_to(root).as_posix(), text_of(path)) for path in tracked]
    assert [found for name, text in names for found in machine_paths(name, text)] == []


def test_constraints_are_names_and_versions(root: Path) -> None:
    lines = (root / "constraints.txt").read_text(encoding="utf-8").splitlines()
    assert [line for line in lines if not line.startswith("#") and not PIN.fullmatch(line)] == []
    assert [line for line in lines if HOST.search(line)] == []


@pytest.mark.parametrize(
    ("parts", "found"),
    [
        (("open('", "/work", "/main/x')"), 1),
        (("", "/home", "/someone/study"), 1),
        (("<", "/root", "/page.md>"), 1),
        (("", "/opt", "/wheels/numpy.whl"), 1),
        (("shared", "/home", "/a"), 0),
        (("https://example.org", "/home", "/a"), 0),
        (("a / b", "", ""), 0),
    ],
)
def test_a_machine_path_is_found(parts: tuple[str, ...], found: int) -> None:
    assert len(machine_paths("m.py", "".join(parts))) == found


@pytest.mark.parametrize(
    "line", ["numpy @ file://numpy.whl", "numpy>=2", "--index-url https://example.org"]
)
def test_a_loose_pin_is_found(line: str) -> None:
    assert not PIN.fullmatch(line)
