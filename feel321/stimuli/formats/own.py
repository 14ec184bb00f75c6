"""Recording formats of a lab's own: `f(path) -> Recording`, chosen by suffix."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from feel321 import intake
from feel321.doors import describe
from feel321.extensions import Method, call, find_method, list_entry_points
from feel321.stimuli.recording import Recording


def find_format(
    path: Path, *, folder: Path | None = None, declared: Mapping[str, str] | None = None
) -> Method | None:
    """Find the reader of a file's suffix, among those of a study and the entry points of `feel321.formats`."""
    suffix = path.suffix.lower().removeprefix(".")
    if suffix in (declared or {}):
        return find_method("format", (declared or {})[suffix], folder=folder)
    return find_method("format", suffix) if suffix in list_entry_points("format") else None


def read_own(method: Method, path: Path) -> Recording:
    """Read a file by a lab's reader; the digest is that of the file and the reader."""
    content = intake.read_bytes(path)
    found = call(method, method.load(), path, doing=f"given {path.name}")
    if not isinstance(found, Recording):
        raise TypeError(
            f"{path.name}: {method} must return a feel321.stimuli.Recording, got {describe(found)}"
        )
    digest = hashlib.sha256(content + method.sha256.encode()).hexdigest()
    return replace(found, name=found.name or path.stem, sha256=digest)
