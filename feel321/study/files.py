"""Files that are whole or absent: nobody ever meets half a table, plan or report."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pathlib import Path


def write_text(path: Path, text: str) -> None:
    """Write a text file in one step, replacing the one that is there unless it holds just that."""
    try:
        if not (path.is_file() and path.read_bytes() == text.encode()):
            _replace(path, text)
    except OSError as error:
        # A full disk is reported without a name, most else with that of the unfinished file.
        raise OSError(error.errno, error.strerror, str(path)) from error


def create_text(path: Path, text: str) -> None:
    """Write a text file where none is yet."""
    if path.exists():
        raise FileExistsError(
            f"{path}: is there already, nothing is overwritten; move it away or use it"
        )
    write_text(path, text)


def sync_folder(folder: Path) -> None:
    """Make a new file's name survive a power cut, where the system can promise that."""
    if os.name == "nt":  # pragma: no cover - Windows opens no folders and needs no such call
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _replace(path: Path, text: str) -> None:
    # Beside the target, so that the replacement stays on one file system and is atomic.
    unfinished = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        with unfinished.open("w", encoding="utf-8", newline="") as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        unfinished.replace(path)
    finally:
        unfinished.unlink(missing_ok=True)
    sync_folder(path.parent)
