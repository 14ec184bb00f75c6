"""`outputs.jsonl`: files that commands wrote elsewhere from a study, so that a withdrawal can find them."""

from __future__ import annotations

import json
import os
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING

from feel321.files import digest_file, make_folder, write_text

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping

    from feel321.study.folder import StudyFolder
    from feel321.study.session.journal import Clock

OUTPUTS_FILE = "outputs.jsonl"

WITHDRAWN = "withdrawn.json"
"""File in the folder of a backup: the codes of those who are not to come back."""

MANIFEST, OBJECTS = "backup.json", "objects"
"""Names in the folder of a backup."""

RESULTS = ("report", "chart", "advice", "power")
"""Folders of results in a study that ratings may be in, unless another name was given."""


@dataclass(frozen=True, slots=True)
class WrittenOutput:
    """What a verb wrote: where, when, and the digest of each file by its name in that folder.

    stale: whether somebody withdrew since, and it could not be cleared; study: where the study was, for a copy of it
    must not clear what the original wrote.
    """

    verb: str
    path: Path
    utc: str
    files: dict[str, str]
    stale: bool = False
    study: str = ""


@contextmanager
def recording_output(study: StudyFolder, verb: str, path: Path, *, now: Clock) -> Iterator[None]:
    """Record what a verb writes in a folder, or the one file: that it begins, and in the end the digest of each file.

    Neither the study's own folders of results need it, nor ratings from elsewhere, for which there is no study.
    """
    path = path.resolve()
    if not study.settings.is_file() or _is_own(study, path):
        with closing_results(study, path):
            yield
        return
    record_output(study, verb, path, files=(), now=now)
    yield
    record_output(study, verb, path, files=list_written(path), now=now)


def _is_own(study: StudyFolder, path: Path) -> bool:
    return path.resolve().parent == study.path.resolve() and path.name in RESULTS


@contextmanager
def closing_results(study: StudyFolder, folder: Path) -> Iterator[None]:
    """Make a study's own folder of results private before anything is in it, and its files once they are written."""
    if os.name == "nt" or not study.settings.is_file() or not _is_own(study, folder):
        yield
        return
    is_new, mode = not folder.exists(), 0o750 if study.asks_for("group_readable") else 0o700
    make_folder(folder, private=True)
    folder.chmod(mode)
    try:
        yield
    finally:
        for path in folder.rglob("*"):
            if not path.is_symlink():
                path.chmod(mode if path.is_dir() else mode & 0o640)
        if is_new and not any(folder.iterdir()):
            folder.rmdir()


def record_output(
    study: StudyFolder, verb: str, path: Path, *, files: Iterable[Path], now: Clock
) -> None:
    """Record the files that a verb has written in a folder; in place of an earlier entry of both."""
    path = path.resolve()
    named = {_name(file, path): digest_file(file) for file in files}
    utc, place = now().isoformat(timespec="seconds"), str(study.path.resolve())
    others = [one for one in read_outputs(study) if (one.verb, one.path) != (verb, path)]
    _write(study, [*others, WrittenOutput(verb, path, utc, named, study=place)])


def list_written(path: Path) -> list[Path]:
    """List what was written in a folder: what its `results.json` names, or all that is in it."""
    if not path.is_dir():
        return [path] if path.is_file() else []
    try:
        named = json.loads((path / "results.json").read_bytes())["files"]
        found = [path / name for name in named]
    except (OSError, KeyError, TypeError, ValueError):
        found = sorted(path.rglob("*"))
    return [file for file in found if file.is_file() and not file.is_symlink()]


def read_outputs(study: StudyFolder) -> list[WrittenOutput]:
    """Read what was recorded; a file that cannot be read is refused."""
    path = study.path / OUTPUTS_FILE
    if not path.is_file():
        return []
    try:
        lines = [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]
        return [
            WrittenOutput(**{
                **o,
                "path": Path(o["path"]),
                "files": dict(o["files"]),
                "stale": bool(o.get("stale")),
            })
            for o in lines
        ]
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise ValueError(
            f"{path}: not as feel321 wrote it ({error}); restore it from a copy"
        ) from None


def settle_outputs(
    study: StudyFolder, *, gone: Iterable[WrittenOutput], stale: Iterable[WrittenOutput]
) -> None:
    """Take out of the record what was removed, and mark what a withdrawal could not clear."""
    removed, marked = list(gone), list(stale)
    left = [one for one in read_outputs(study) if one not in removed]
    _write(study, [replace(one, stale=one.stale or one in marked) for one in left])


def read_withdrawn(target: Path) -> dict[str, str]:
    """Read who is not to come back, and since when; earlier versions wrote the codes only."""
    path = target / WITHDRAWN
    if not path.exists():
        return {}
    try:
        entry = json.loads(path.read_bytes())
        times = dict.fromkeys(entry, "") if isinstance(entry, list) else dict(entry)
        _ = [datetime.fromisoformat(utc) for utc in times.values() if utc]
    except (TypeError, ValueError):
        raise ValueError(
            f"{path}: must say which codes withdrew and when; restore it from a copy"
        ) from None
    return times


def note_withdrawn(target: Path, gone: Mapping[str, str]) -> None:
    """Add who withdrew, and when, to the list beside a backup."""
    text = json.dumps({**read_withdrawn(target), **gone}, indent=1, sort_keys=True)
    write_text(target / WITHDRAWN, f"{text}\n", private=True)


def _name(file: Path, folder: Path) -> str:
    return file.resolve().relative_to(folder).as_posix() if file.resolve() != folder else "."


def _write(study: StudyFolder, outputs: Iterable[WrittenOutput]) -> None:
    lines = [
        json.dumps(asdict(one) | {"path": str(one.path)}, ensure_ascii=False) for one in outputs
    ]
    write_text(study.path / OUTPUTS_FILE, "".join(f"{line}\n" for line in lines), private=True)
