"""The tools behind `make check` refuse what they are there to refuse: each is fed one fault."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

ROOMS = ("analysis", "protocols", "stimuli", "study")
NESTED = """
    if a:
        for b in a:
            while b:
                if c:
                    return 1
    return 2
"""
BRANCHES = "    if a:\n        b += 1\n" * 8 + "    return b\n"


def ruff(root: Path, code: str) -> str:
    """Ruff's answer to a function of the given text in a module of `feel321/stimuli/`."""
    options = ["--output-format=json", "--stdin-filename=feel321/stimuli/x.py", "-"]
    command = [sys.executable, "-m", "ruff", "check", *options]
    text = f'"""A module."""\n\n{code}'
    return subprocess.run(
        command, cwd=root, input=text, text=True, capture_output=True, check=False
    ).stdout


def function(signature: str, body: str) -> str:
    return f'def f({signature}) -> int:\n    """Work."""\n{body}'


@pytest.mark.parametrize(
    ("code", "rule"),
    [
        (function("a: list[int], c: int", NESTED), "PLR1702"),
        (function("a: int, b: int", BRANCHES), "C901"),
        (function("a: int, b: int, c: int, d: int", "    return a\n"), "PLR0917"),
        (
            function("a: int, *, b: int, c: int, d: int, e: int, f: int, g: int", "    return a\n"),
            "PLR0913",
        ),
        (function("a: bool", "    return int(a)\n"), "FBT001"),
        (function("a: int", "    print(a)\n    return a\n"), "T201"),
        ("def f(a: int) -> int:\n    return a\n", "D103"),
        ('__all__ = ["b", "a"]\na = b = 1\n', "RUF022"),
        ("import stimuli\n", "TID251"),
        ("from analysis.table import Table\n", "TID251"),
    ],
)
def test_ruff(code: str, rule: str, root: Path) -> None:
    assert f'"{rule}"' in ruff(root, code)


def test_ruff_lets_good_code_pass(root: Path) -> None:
    good = function("a: int, *, b: int", "    return a + b\n")
    assert ruff(root, good).strip() == "[]"


def copy_with(tmp_path: Path, root: Path, files: dict[str, str]) -> Path:
    """A tree of the four rooms, empty but for `files`, under the project's own contracts."""
    (tmp_path / "pyproject.toml").write_bytes((root / "pyproject.toml").read_bytes())
    for package in (".", *ROOMS):
        (tmp_path / "feel321" / package).mkdir()
        (tmp_path / "feel321" / package / "__init__.py").touch()
    for name, text in files.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text, encoding="utf-8")
    return tmp_path


def tool(name: str, *arguments: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    program = Path(sys.executable).with_name(name)
    return subprocess.run(
        [program, *arguments], cwd=cwd, text=True, capture_output=True, check=False
    )


@pytest.mark.parametrize(
    ("files", "broken"),
    [
        ({}, 0),
        (
            {
                "feel321/study/screen/__init__.py": "",
                "feel321/study/screen/window.py": "import psychopy\n",
            },
            0,
        ),
        ({"feel321/study/session.py": "def f():\n    import psychopy\n"}, 1),
        ({"feel321/stimuli/sound.py": "from sounddevice import play\n"}, 1),
        ({"feel321/stimuli/a.py": "import feel321.protocols\n"}, 1),
        ({"feel321/protocols/a.py": "import feel321.stimuli\n"}, 1),
        ({"feel321/analysis/a.py": "def f():\n    import feel321.study\n"}, 1),
        (
            {
                "feel321/stimuli/a.py": "import feel321.stimuli.b\n",
                "feel321/stimuli/b.py": "import feel321.stimuli.a\n",
            },
            1,
        ),
    ],
)
def test_floors(files: dict[str, str], broken: int, root: Path, tmp_path: Path) -> None:
    done = tool("lint-imports", "--no-cache", "--no-logo", cwd=copy_with(tmp_path, root, files))
    assert f"{broken} broken" in done.stdout
    assert done.returncode == int(broken > 0)


def test_nothing_goes_uncovered(pyproject: Any) -> None:
    assert "omit" not in pyproject["tool"]["coverage"]["run"]


@pytest.mark.parametrize(("lines", "code"), [(6, 0), (9, 8)])
def test_duplicates(lines: int, code: int, root: Path, tmp_path: Path) -> None:
    text = "".join(f"value_{number} = {number} * {number}\n" for number in range(lines))
    tree = copy_with(tmp_path, root, {"feel321/stimuli/a.py": text, "feel321/analysis/b.py": text})
    assert tool("pylint", "feel321", cwd=tree).returncode == code
