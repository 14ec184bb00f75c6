"""A dataset's folder: whole or absent, and never in the place of anything but an earlier export."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path
from typing import TYPE_CHECKING

from feel321.files import digest_file, make_folder, sync_folder

if TYPE_CHECKING:
    from collections.abc import Mapping

CRATE = "ro-crate-metadata.json"
"""Lists every file of a dataset with its digest, by which an earlier export is known."""

MARKS = {"#feel321", "#seal"}
"""What the crate of every export names, and no other program's does."""

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
    known = _read_digests(folder)
    own = {CRATE} if known else set()
    for name in sorted(found - own):
        if name not in known or (folder / name).is_symlink():
            said = "which no export wrote"
        elif digest_file(folder / name) != known[name]:
            said = "which was changed after it was exported"
        else:
            continue
        raise FileExistsError(
            f"{folder}: holds {name!r}, {said}; move it away, or choose another folder"
        )
    if found and not known:
        raise FileExistsError(
            f"{folder}: holds {CRATE!r} of another program; choose another folder"
        )


def _read_digests(folder: Path) -> dict[str, str]:
    """Read the digest of each file of an earlier export; nothing where feel321 did not write the crate."""
    try:
        graph = json.loads((folder / CRATE).read_bytes())["@graph"]
        if not {entry["@id"] for entry in graph} >= MARKS:
            return {}
        return {str(one["@id"]): str(one["sha256"]) for one in graph if "sha256" in one}
    except (OSError, ValueError, TypeError, LookupError, AttributeError, RecursionError):
        return {}


def write_folder(folder: Path, files: Mapping[str, Content]) -> None:
    """Write all files beside their place and then move them there together; an earlier export gives way."""
    check_target(folder)
    make_folder(folder.parent)
    tidy(folder)
    new, old = (folder.with_name(f".{folder.name}.{os.getpid()}.{end}") for end in ("part", "old"))
    make_folder(new, private=True)
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


def tidy(folder: Path) -> None:
    """Remove what a killed export left beside the folder; an earlier export that it had moved away comes back."""
    for place in sorted(folder.parent.glob(f".{folder.name}.*")):
        number, _, end = place.name.removeprefix(f".{folder.name}.").partition(".")
        if end not in {"part", "old"} or not number.isdecimal() or _is_running(int(number)):
            continue
        if end == "old" and not folder.exists():
            place.rename(folder)
        shutil.rmtree(place, ignore_errors=True)


def _is_running(process: int) -> bool:
    if os.name == "nt" or process == os.getpid():  # to ask would end it there
        return process != os.getpid()
    try:
        os.kill(process, 0)
    except OSError as error:
        return isinstance(error, PermissionError)
    return True


def _write(path: Path, content: Content) -> None:
    make_folder(path.parent, private=True)
    with open(os.open(path, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o600), "wb") as file:  # noqa: PTH123 - private at once
        if isinstance(content, bytes):
            file.write(content)
        else:
            with content.open("rb") as source:
                shutil.copyfileobj(source, file)
        file.flush()
        os.fsync(file.fileno())
