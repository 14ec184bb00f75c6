"""`outputs.jsonl`: what verbs wrote of a study besides its own tables, to be found when somebody withdraws."""

from __future__ import annotations

import json
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from feel321.files import digest_file, write_text

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

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

    stale: whether somebody withdrew since, and it could not be cleared.
    """

    verb: str
    path: Path
    utc: str
    files: dict[str, str]
    stale: bool = False


@contextmanager
def recording_output(study: StudyFolder, verb: str, path: Path, *, now: Clock) -> Iterator[None]:
    """Record what a verb writes in a folder, or the one file: that it begins, and in the end the digest of each file.

    Neither the study's own folders of results need it, nor ratings from elsewhere, for which there is no study.
    """
    path = path.resolve()
    is_own = path.parent == study.path.resolve() and path.name in RESULTS
    if not study.settings.is_file() or is_own:
        yield
        return
    record_output(study, verb, path, files=(), now=now)
    yield
    record_output(study, verb, path, files=list_written(path), now=now)


def record_output(
    study: StudyFolder, verb: str, path: Path, *, files: Iterable[Path], now: Clock
) -> None:
    """Record the files that a verb has written in a folder; in place of an earlier entry of both."""
    path = path.resolve()
    named = {_name(file, path): digest_file(file) for file in files}
    utc = now().isoformat(timespec="seconds")
    others = [one for one in read_outputs(study) if (one.verb, one.path) != (verb, path)]
    _write(study, [*others, WrittenOutput(verb, path, utc, named)])


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
            WrittenOutput(
                o["verb"], Path(o["path"]), o["utc"], dict(o["files"]), bool(o.get("stale"))
            )
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


def read_withdrawn(target: Path) -> set[str]:
    """Read the codes that are not to come back."""
    path = target / WITHDRAWN
    if not path.exists():
        return set()
    try:
        return set(map(str, json.loads(path.read_bytes())))
    except (TypeError, ValueError):
        raise ValueError(f"{path}: must be a list of codes; restore it from a copy") from None


def note_withdrawn(target: Path, codes: Iterable[str]) -> None:
    """Add codes to the list beside a backup."""
    known = read_withdrawn(target)
    write_text(target / WITHDRAWN, json.dumps(sorted(known.union(codes))) + "\n", private=True)


def _name(file: Path, folder: Path) -> str:
    return file.resolve().relative_to(folder).as_posix() if file.resolve() != folder else "."


def _write(study: StudyFolder, outputs: Iterable[WrittenOutput]) -> None:
    lines = [
        json.dumps(asdict(one) | {"path": str(one.path)}, ensure_ascii=False) for one in outputs
    ]
    write_text(study.path / OUTPUTS_FILE, "".join(f"{line}\n" for line in lines), private=True)
