"""Who may read the places that hold data of people: what is open to more than it should be, and closing it."""

from __future__ import annotations

import os
import stat
from shlex import quote
from typing import TYPE_CHECKING

from feel321.study.persons import places
from feel321.study.persons.outputs import RESULTS

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from feel321.study.folder import StudyFolder


def list_wide(study: StudyFolder) -> Iterator[tuple[Path, int, int]]:
    """List files and folders that more people may read than should: path, mode, and the mode that they should have.

    What lies outside the study is the lab's own matter.
    """
    if os.name == "nt":
        return
    allowed = 0o750 if study.asks_for("group_readable") else 0o700
    kept = [
        p.path for p in places.list_places(study) if p.kind not in {"output", "backup", "temporary"}
    ]
    folders = {study.path / name for name in ("sessions", "rehearsals", *RESULTS)}
    folders |= {one for path in kept for one in path.parents if folders.intersection(one.parents)}
    for path in sorted(one for one in (*folders, *kept) if one.exists() and not one.is_symlink()):
        mode = stat.S_IMODE(path.stat().st_mode)
        least = allowed if path.is_dir() else allowed & 0o640
        if mode & ~least & 0o077:
            yield path, mode, mode & least | least & 0o700


def describe_wide(study: StudyFolder) -> Iterator[str]:
    """Say in one line that places are open to more people than they should be."""
    if found := list(list_wide(study)):
        path, mode, _ = found[0]
        yield (
            f"{len(found)} files and folders of participants are open to others, such as {path} (mode {mode:04o}); "
            f"close them: feel321 inventory {quote(str(study.path))} --tighten"
        )


def tighten(study: StudyFolder) -> list[Path]:
    """Close what more people may read than should, and return it; nothing is opened, and links stay as they are."""
    found = list(list_wide(study))
    for path, _, least in found:
        path.chmod(least)
    return [path for path, *_ in found]
