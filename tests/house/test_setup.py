"""Set-up is written down once: the Makefile's commands, the pins, the system packages, the version."""

from __future__ import annotations

import re
import stat
import subprocess
import sys
from importlib.metadata import distributions, version
from typing import TYPE_CHECKING, Any

import pytest
from packaging.requirements import Requirement
from packaging.specifiers import SpecifierSet
from packaging.utils import canonicalize_name

if TYPE_CHECKING:
    from pathlib import Path

COMMANDS = {"demo", "test", "coverage", "check", "bench", "soak", "clean", "help"}


def make(root: Path, *arguments: str) -> str:
    command = ["make", "--no-print-directory", *arguments]
    return subprocess.run(command, cwd=root, text=True, capture_output=True, check=True).stdout


def requirements(project: dict[str, Any]) -> set[str]:
    groups = [project["dependencies"], *project["optional-dependencies"].values()]
    return {canonicalize_name(Requirement(line).name) for group in groups for line in group}


def pins(text: str) -> set[str]:
    return {canonicalize_name(line.split("==")[0]) for line in text.splitlines() if "==" in line}


def test_make_help_lists_every_command(root: Path) -> None:
    assert {line.split()[1] for line in make(root, "help").splitlines()} >= COMMANDS


@pytest.mark.parametrize("command", sorted(COMMANDS))
def test_every_command_is_a_target(root: Path, command: str) -> None:
    assert make(root, "-n", command)


def test_everything_required_is_pinned(root: Path, pyproject: Any) -> None:
    pinned = pins((root / "constraints.txt").read_text(encoding="utf-8"))
    assert requirements(pyproject["project"]) - pinned == set()


@pytest.mark.parametrize("python", ["3.11.0", "3.12.0"])
def test_no_pin_asks_for_a_later_python(root: Path, python: str) -> None:
    """Debian keeps a Python's first patch releases for years; a pin that wants a later one cannot install there."""
    pinned = pins((root / "constraints.txt").read_text(encoding="utf-8"))
    told = [each.metadata for each in distributions()]
    wanted = {canonicalize_name(each["Name"]): each.get("Requires-Python", "") for each in told}
    refusing = {name for name, asked in wanted.items() if not SpecifierSet(asked).contains(python)}
    assert {name: wanted[name] for name in refusing & pinned} == {}


def test_every_dependency_has_its_reason_and_no_other_is_listed(root: Path, pyproject: Any) -> None:
    text = (root / "CONTRIBUTING.md").read_text(encoding="utf-8")
    _, _, section = text.partition("## Dependencies")
    cells = re.findall(r"^\|([^|]+)\|", section, re.MULTILINE)
    explained = [canonicalize_name(name) for name in re.findall(r"`([\w.-]+)`", "".join(cells))]
    assert sorted(explained) == sorted(requirements(pyproject["project"]))


def test_every_system_package_has_its_reason(root: Path) -> None:
    lines = (root / ".ci" / "packages.txt").read_text(encoding="utf-8").splitlines()
    assert [
        line for line in lines if not re.fullmatch(r"[a-z0-9][a-z0-9.+-]+  # .{10,}", line)
    ] == []


@pytest.mark.parametrize("script", ["run", "make-venv", "apt-install"])
def test_scripts_run_and_parse(root: Path, script: str) -> None:
    path = root / ".ci" / script
    shell = path.read_text(encoding="utf-8").splitlines()[0].split("/")[-1].split()[-1]
    assert path.stat().st_mode & stat.S_IXUSR
    assert subprocess.run([shell, "-n", path], check=False).returncode == 0


def test_present_packages_install_nothing(root: Path) -> None:
    done = subprocess.run(
        [root / ".ci" / "apt-install", "dpkg"], text=True, capture_output=True, check=True
    )
    assert done.stdout == ""


def test_one_version(pyproject: Any, sources: Any) -> None:
    assert pyproject["project"]["dynamic"] == ["version"]
    number = version("feel321")
    told = [source.path for source in sources if f'"{number}"' in source.text]
    assert told == [pyproject["tool"]["hatch"]["version"]["path"]]


def test_changelog_starts_with_what_is_not_released(root: Path) -> None:
    text = (root / "CHANGELOG.md").read_text(encoding="utf-8")
    assert re.findall(r"^## \[(.+?)\]", text, re.MULTILINE)[:1] == ["Unreleased"]


@pytest.mark.parametrize(
    ("chosen", "left_out"), [([], "test_long"), (["-m", "soak"], "test_quick")]
)
def test_soak_tests_wait_to_be_asked(
    chosen: list[str], left_out: str, root: Path, tmp_path: Path
) -> None:
    (tmp_path / "conftest.py").write_bytes((root / "tests" / "conftest.py").read_bytes())
    (tmp_path / "test_both.py").write_text(
        "import pytest\ndef test_quick(): pass\n@pytest.mark.soak\ndef test_long(): pass\n",
        encoding="utf-8",
    )
    command = [
        sys.executable,
        "-m",
        "pytest",
        "-v",
        "-c",
        root / "pyproject.toml",
        *chosen,
        tmp_path,
    ]
    done = subprocess.run(command, cwd=tmp_path, text=True, capture_output=True, check=True)
    assert "1 passed, 1 deselected" in done.stdout
    assert left_out not in done.stdout
