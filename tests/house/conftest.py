"""What the guards look at: the project's tracked files, and the syntax trees of its four rooms."""

from __future__ import annotations

import ast
import subprocess
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[2]
ROOMS = ("analysis", "protocols", "stimuli", "study")


@dataclass(frozen=True, slots=True)
class Source:
    """A Python file, read and parsed."""

    path: str
    text: str
    tree: ast.Module


def parse(path: Path) -> Source:
    text = path.read_text(encoding="utf-8")
    return Source(path.relative_to(ROOT).as_posix(), text, ast.parse(text))


@pytest.fixture(scope="session")
def root() -> Path:
    return ROOT


@pytest.fixture(scope="session")
def rooms() -> tuple[str, ...]:
    return ROOMS


@pytest.fixture(scope="session")
def sources() -> tuple[Source, ...]:
    """Every module of the four rooms."""
    return tuple(parse(path) for path in sorted((ROOT / "feel321").rglob("*.py")))


@pytest.fixture(scope="session")
def test_sources() -> tuple[Source, ...]:
    return tuple(parse(path) for path in sorted((ROOT / "tests").rglob("*.py")))


@pytest.fixture(scope="session")
def pyproject() -> dict[str, Any]:
    return tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))


@pytest.fixture(scope="session")
def tracked() -> tuple[Path, ...]:
    """The files under version control that stand on disk."""
    if not (ROOT / ".git").exists():
        pytest.skip("NO GIT CHECKOUT: what is tracked cannot be told")
    listing = subprocess.run(
        ["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True, check=True
    )
    return tuple(
        path for name in listing.stdout.split("\0") if name and (path := ROOT / name).is_file()
    )
