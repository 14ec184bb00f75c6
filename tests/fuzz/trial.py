"""One parser in its scratch folder, ready for any number of inputs."""

from __future__ import annotations

import hashlib
import os
import shutil
import tempfile
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tests.fuzz.law import Broken, law
from tests.fuzz.parsers import PARSERS

if TYPE_CHECKING:
    from collections.abc import Iterator

    from tests.fuzz.parsers import Parser

FOUND = Path(__file__).parent / "found"
"""Inputs that once broke the law, by parser; each is tried again in every run."""

MEMORY = Path("/dev/shm")  # noqa: S108 - a folder of our own is made in it
"""Where files cost nothing."""


class Trial:
    """A parser, and the folder that its inputs are written to."""

    def __init__(self, name: str, scratch: Path, study: Path) -> None:
        self.parser: Parser = PARSERS[name]
        self.scratch, self.path = scratch, self.parser.prepare(scratch, study)
        self.inputs = [*self.parser.seeds(study), *list_found(name)]

    def __call__(self, content: bytes) -> object:
        """Try an input; Broken says how the law was broken."""
        self.path.write_bytes(self.parser.dress(content))
        before = self._list_files()
        value = self._read(self.path)
        if self._list_files() != before:
            raise Broken(f"the folder holds {self._list_files() ^ before} after reading")
        if value is not None and self.parser.write is not None:
            self._check_again(value)
        return value

    def _read(self, path: Path) -> Any:
        own = self.parser
        with law(lines=own.lines, bounded=own.bounded, typed=own.typed):
            return self.parser.read(path)
        return None  # a refusal, which the law has judged

    def _check_again(self, value: Any) -> None:
        """Check that what is written of a value is read as that value."""
        with law(lines=self.parser.lines, bounded=False, writes=True):
            self.parser.write(value, self.path)  # type: ignore[misc]  # the caller looked
            again = self._read(self.path)
            if not is_same(value, again):
                raise Broken(f"written and read again, {value!r:.300} is {again!r:.300}")

    def _list_files(self) -> set[str]:
        return {name for _, folders, files in os.walk(self.scratch) for name in (*folders, *files)}


def is_same(one: Any, other: Any) -> bool:
    if isinstance(one, tuple):
        return len(one) == len(other) and all(map(is_same, one, other))
    if isinstance(one, np.ndarray):
        return np.array_equal(one.astype(np.float32), other.astype(np.float32), equal_nan=True)
    return bool(one == other) or repr(one) == repr(other)


def list_found(name: str) -> list[bytes]:
    """List the inputs that once broke the law."""
    return [path.read_bytes() for path in sorted((FOUND / fold(name)).glob("*"))]


def fold(name: str) -> str:
    return name.replace(", ", "-").replace(" ", "_")


def keep(name: str, content: bytes, place: Path = FOUND) -> Path:
    """Keep an input that broke the law."""
    path = place / fold(name) / hashlib.sha256(content).hexdigest()[:12]
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content)
    return path


@contextmanager
def trying(name: str, study: Path) -> Iterator[Trial]:
    """Make the scratch folder of a parser, and remove it."""
    place = MEMORY if MEMORY.is_dir() else None
    scratch = Path(tempfile.mkdtemp(prefix="fuzz-", dir=place))
    try:
        yield Trial(name, scratch, study)
    finally:
        shutil.rmtree(scratch)
