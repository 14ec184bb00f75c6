"""What stands on disk is what is imported: the wheel holds `feel321` and nothing else."""

from __future__ import annotations

import subprocess
import sys
import tarfile
import zipfile
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from pathlib import Path


@pytest.fixture(scope="module")
def wheel(root: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("wheel")
    run("-m", "hatchling", "build", "-t", "wheel", "-d", str(folder), cwd=root)
    (built,) = folder.glob("*.whl")
    return built


def run(*arguments: str, cwd: Path) -> str:
    done = subprocess.run(
        [sys.executable, *arguments], cwd=cwd, text=True, capture_output=True, check=False
    )
    if done.returncode:
        pytest.fail(f"{' '.join(arguments)}: {done.stdout}{done.stderr}")
    return done.stdout


def files_in(wheel: Path) -> set[str]:
    with zipfile.ZipFile(wheel) as archive:
        return {name for name in archive.namelist() if ".dist-info/" not in name}


def check_contents(wheel: Path, *, cwd: Path) -> str:
    return run("-m", "check_wheel_contents", "--config", "pyproject.toml", str(wheel), cwd=cwd)


def test_every_file_of_the_rooms_is_in_the_wheel(
    wheel: Path, root: Path, tracked: tuple[Path, ...]
) -> None:
    names = {path.relative_to(root).as_posix() for path in tracked}
    assert {name for name in names if name.startswith("feel321/")} - files_in(wheel) == set()


def test_top_level(wheel: Path) -> None:
    assert {name.split("/")[0] for name in files_in(wheel)} == {"feel321"}


def test_the_sdist_holds_the_whole_package(
    root: Path, tmp_path: Path, tracked: tuple[Path, ...]
) -> None:
    """The links at the top level must not hide folders from the builder."""
    run("-m", "hatchling", "build", "-t", "sdist", "-d", str(tmp_path), cwd=root)
    (built,) = tmp_path.glob("*.tar.gz")
    with tarfile.open(built) as archive:
        held = {name.partition("/")[2] for name in archive.getnames()}
    names = {path.relative_to(root).as_posix() for path in tracked}
    assert {name for name in names if name.startswith(("feel321/", "tests/"))} - held == set()


def test_the_top_level_shows_the_rooms(root: Path, rooms: tuple[str, ...]) -> None:
    """Each is a link that works wherever the checkout stands; without links it is a file of that text."""
    for room in rooms:
        link = root / room
        told = (
            link.readlink().as_posix()
            if link.is_symlink()
            else link.read_text(encoding="utf-8").strip()
        )
        assert told == f"feel321/{room}"


def test_check_wheel_contents(wheel: Path, root: Path) -> None:
    assert "OK" in check_contents(wheel, cwd=root)


def test_a_stranger_at_the_top_is_found(wheel: Path, root: Path, tmp_path: Path) -> None:
    changed = tmp_path / wheel.name
    with zipfile.ZipFile(wheel) as source, zipfile.ZipFile(changed, "w") as target:
        for name in source.namelist():
            stranger = b"utils.py,,\n" if name.endswith("/RECORD") else b""
            target.writestr(name, source.read(name) + stranger)
        target.writestr("utils.py", "x = 1\n")
    with pytest.raises(pytest.fail.Exception, match="utils"):
        check_contents(changed, cwd=root)
