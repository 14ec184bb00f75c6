"""A dataset's folder: whole or absent, and never in the place of anything but an earlier export."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path
from typing import TYPE_CHECKING

from feel321.files import make_folder, sync_folder

if TYPE_CHECKING:
    from collections.abc import Mapping

CRATE = "ro-crate-metadata.json"
"""Lists every file of a dataset, by which an earlier export is known."""

Content = bytes | Path
"""What a file holds: bytes, or another file that it is a copy of."""


def list_files(folder: Path) -> set[str]:
    """List the files in a folder, by their paths in it."""
    return {path.relative_to(folder).as_posix() for path in folder.rglob("*") if not path.is_dir()}


def check_target(folder: Path) -> None:
    """Refuse a folder that holds anything but an earlier export."""
    if folder.is_symlink() or (folder.exists() and not folder.is_dir()):
        raise FileExistsError(
            f"{folder}: must be a folder, got a file or link; choose another name"
        )
    found = list_files(folder) if folder.is_dir() else set()
    try:
        crate = json.loads((folder / CRATE).read_bytes()) if CRATE in found else {}
        known = {entry["@id"] for entry in crate.get("@graph", ())}
    except (ValueError, TypeError, LookupError, AttributeError):
        known = set()
    if strange := sorted(found - known - ({CRATE} if known else set())):
        raise FileExistsError(
            f"{folder}: holds {strange[0]!r}, which no export wrote; move it away, or choose another folder"
        )


def write_folder(folder: Path, files: Mapping[str, Content]) -> None:
    """Write all files beside their place and then move them there together; an earlier export gives way."""
    check_target(folder)
    make_folder(folder.parent)
    new, old = (folder.with_name(f".{folder.name}.{os.getpid()}.{end}") for end in ("part", "old"))
    shutil.rmtree(new, ignore_errors=True)
    try:
        for name, content in sorted(files.items()):
            _write(new / name, content)
        for inner in [new, *(path for path in new.rglob("*") if path.is_dir())]:
            sync_folder(inner)
        if folder.exists():
            folder.rename(old)
        new.rename(folder)
        sync_folder(folder.parent)
    finally:
        if old.exists() and not folder.exists():
            old.rename(folder)
        shutil.rmtree(new, ignore_errors=True)
        shutil.rmtree(old, ignore_errors=True)


def _write(path: Path, content: Content) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("wb") as file:
        if isinstance(content, bytes):
            file.write(content)
        else:
            with content.open("rb") as source:
                shutil.copyfileobj(source, file)
        file.flush()
        os.fsync(file.fileno())
