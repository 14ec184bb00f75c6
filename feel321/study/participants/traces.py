"""What holds a participant's data besides their folder: rehearsals, tables, results, and what verbs wrote elsewhere.

`outputs.jsonl` lists what verbs wrote outside of the study; results inside are made private.
"""

import csv
import json
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from datetime import datetime
from pathlib import Path

from feel321 import files
from feel321.files import make_folder, write_text
from feel321.study.folder import StudyFolder
from feel321.study.participants import roster
from feel321.study.participants.answers import ANSWERS_FILE
from feel321.study.ratings import MATCHES_FILE, WIDE
from feel321.study.session.journal import Clock

OUTPUTS_FILE = "outputs.jsonl"

RESULTS = ("report", "tradeoff", "power")
"""Folders of results in a study that ratings may be in, unless another name was given."""

TABLES = ("ratings.csv", roster.ROSTER_FILE, ANSWERS_FILE, MATCHES_FILE)


def list_results(study: StudyFolder) -> Iterator[Path]:
    """List the folders of results made of ratings; a trade-off of recordings alone takes long and holds nobody's."""
    for folder in (study.path / name for name in RESULTS):
        is_unrated = folder.name == "tradeoff" and not (folder / "tables" / "people.csv").is_file()
        if folder.is_symlink() or (folder.is_dir() and not is_unrated):
            yield folder


def find_data_left(study: StudyFolder) -> Iterator[str]:
    """Find data of those who withdrew in every place but their own folder, which the audit looks at by itself."""
    names, last = _find_withdrawn(study)
    for name in names:
        finish = f"who withdrew; finish: feel321 withdraw {study.path} --participant {name}"
        places = {
            study.path / "rehearsals" / name: f"is of a rehearsal of {name}",
            study.path / WIDE / f"{name}.csv": f"is of {name}",
        }
        yield from (f"{path}: {what}, {finish}" for path, what in places.items() if path.exists())
        for table in (study.path / one for one in TABLES):
            text = table.read_text(encoding="utf-8", errors="replace") if table.is_file() else ""
            if any(row.get("participant") == name for row in csv.DictReader(text.splitlines())):
                yield f"{table}: holds rows of {name}, {finish}"
    for folder in list_results(study) if last else ():
        from feel321.analysis.report.folder import list_own

        for path in (folder / name for name in list_own(folder)):
            if path.stat().st_mtime < datetime.fromisoformat(last).timestamp():
                yield f"{path}: was made before somebody withdrew; remove it, and make it again"


def list_stale(study: StudyFolder) -> Iterator[str]:
    """Name what verbs wrote outside of the study before somebody withdrew, as far as it is there."""
    outputs = list_outputs(study, before=_find_withdrawn(study)[1])
    yield from (text for path, text in outputs if path.exists())


def _find_withdrawn(study: StudyFolder) -> tuple[list[str], str]:
    """Find who withdrew, and when the last did who had recorded something; empty if nobody."""
    stones = dict[str, roster.Tombstone]()
    for folder in study.participants:
        with suppress(ValueError):  # reported by whoever looks at the folder
            if stone := roster.read_tombstone(folder):
                stones[folder.name] = stone
    times = [one.utc for one in stones.values() if one.journals]
    return [*stones], max(times, key=datetime.fromisoformat, default="")


@contextmanager
def recording_output(study: StudyFolder, verb: str, path: Path, *, now: Clock) -> Iterator[None]:
    """Record where a verb writes, before it does; the study's own folders of results need no record.

    A report among journals or stimuli would be taken for one of them.
    """
    path = path.resolve()
    kept = {study.path / name for name in ("sessions", "rehearsals", "stimuli", "calibration")}
    if study.settings.is_file() and {one.resolve() for one in kept} & {path, *path.parents}:
        raise ValueError(f"{path}: holds what {verb} reads; name a folder outside of it")
    if not study.settings.is_file() or _is_own(study, path):
        with closing_results(study, path):
            yield
        return
    new = {"verb": verb, "path": str(path), "utc": now().isoformat(timespec="seconds")}
    before = _read_outputs(study)
    others = [one for one in before if (one["verb"], one["path"]) != (verb, str(path))]
    _write_outputs(study, [*others, new])
    try:
        yield
    except BaseException:
        if not path.exists():  # nothing was written
            _write_outputs(study, others)
        raise


def _write_outputs(study: StudyFolder, rows: list[dict[str, str]]) -> None:
    text = "".join(f"{json.dumps(one, ensure_ascii=False)}\n" for one in rows)
    write_text(study.path / OUTPUTS_FILE, text, private=True)


def _read_outputs(study: StudyFolder) -> list[dict[str, str]]:
    path = study.path / OUTPUTS_FILE
    try:
        lines = path.read_text(encoding="utf-8").splitlines() if path.is_file() else []
        rows = [json.loads(line) for line in lines]
        _ = [(one["verb"], one["path"], datetime.fromisoformat(one["utc"])) for one in rows]
    except (KeyError, TypeError, ValueError, RecursionError) as error:
        text = f"not as feel321 wrote it ({error}); restore it from a copy"
        raise ValueError(f"{path}: {text}") from None
    return rows


def list_outputs(study: StudyFolder, *, before: str) -> Iterator[tuple[Path, str]]:
    """List what was written until a time, each with what there is to do when somebody withdrew since."""
    for one in _read_outputs(study):
        if before and datetime.fromisoformat(one["utc"]) <= datetime.fromisoformat(before):
            wrote = f"{one['path']}: {one['verb']} wrote there before a participant withdrew"
            remedy = f"remove the participant's data there and its line in {OUTPUTS_FILE}"
            yield Path(one["path"]), f"{wrote}; write it anew, or {remedy}"


def _is_own(study: StudyFolder, path: Path) -> bool:
    return path.resolve().parent == study.path.resolve() and path.name in RESULTS


@contextmanager
def closing_results(study: StudyFolder, folder: Path) -> Iterator[None]:
    """Make a study's own folder of results private before anything is in it, and its files once they are written."""
    if os.name == "nt" or not study.settings.is_file() or not _is_own(study, folder):
        yield
        return
    is_shared = study.sessions.is_dir() and files.is_of_group(study.sessions)
    is_new, mode = not folder.exists(), 0o750 if is_shared else 0o700
    make_folder(folder, private=True)
    folder.chmod(mode)
    try:
        yield
    finally:
        for path in (one for one in folder.rglob("*") if not one.is_symlink()):
            path.chmod(mode if path.is_dir() else mode & 0o640)
        if is_new and not any(folder.iterdir()):
            folder.rmdir()
