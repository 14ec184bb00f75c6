"""Set-up is written down once: the pins, the reasons of dependencies and system packages, the wheel."""

import re
import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path
from typing import Any

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name


@pytest.fixture(scope="module")
def pins(root: Path) -> set[str]:
    lines = (root / "constraints.txt").read_text(encoding="utf-8").splitlines()
    own = [line for line in lines if not line.startswith("#")]
    assert [line for line in own if not re.fullmatch(r"[A-Za-z0-9][\w.-]*==[\w.+!]+", line)] == []
    return {canonicalize_name(line.split("==")[0]) for line in own}


@pytest.fixture(scope="module")
def required(pyproject: Any) -> list[str]:
    project = pyproject["project"]
    groups = [project["dependencies"], *project["optional-dependencies"].values()]
    return sorted({canonicalize_name(Requirement(line).name) for group in groups for line in group})


def run(*command: str, cwd: Path) -> str:
    done = subprocess.run(command, cwd=cwd, text=True, capture_output=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_everything_required_is_pinned(required: list[str], pins: set[str]) -> None:
    assert set(required) - pins == set()


def test_every_dependency_has_its_reason_and_no_other_is_listed(
    root: Path, required: list[str]
) -> None:
    text = (root / "CONTRIBUTING.md").read_text(encoding="utf-8")
    cells = re.findall(r"^\|([^|]+)\|", text.partition("## Dependencies")[2], re.MULTILINE)
    explained = [canonicalize_name(name) for name in re.findall(r"`([\w.-]+)`", "".join(cells))]
    assert sorted(explained) == required
    lines = (root / ".ci" / "packages.txt").read_text(encoding="utf-8").splitlines()
    assert [one for one in lines if not re.fullmatch(r"[a-z0-9][a-z0-9.+-]+  # .{10,}", one)] == []


def test_wheel_and_sdist_hold_the_package_and_no_stranger(root: Path, tmp_path: Path) -> None:
    """The links at the top level must not hide folders from the builder."""
    run(sys.executable, "-m", "hatchling", "build", "-d", str(tmp_path), cwd=root)
    (wheel,), (sdist,) = tmp_path.glob("*.whl"), tmp_path.glob("*.tar.gz")
    own = {
        path.relative_to(root).as_posix()
        for path in (root / "feel321").rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }
    with zipfile.ZipFile(wheel) as archive:
        assert {name for name in archive.namelist() if ".dist-info/" not in name} == own
    with tarfile.open(sdist) as archive:
        held = {name.partition("/")[2] for name in archive.getnames()}
    assert own | {"tests/house/test_setup.py", "tests/conftest.py"} <= held
    check = ["-m", "check_wheel_contents", "--config", "pyproject.toml", str(wheel)]
    assert "OK" in run(sys.executable, *check, cwd=root)
