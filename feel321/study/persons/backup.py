"""Backups of a study: a consistent copy while sessions run, restored without those who have withdrawn since.

A backup is a folder: `objects/`, each file once under its SHA-256; `backup.json`, which says what the files are called;
`withdrawn.json`, the codes of those who withdrew. `backup.json` is replaced in one step once all it names is on the
disk: whatever is interrupted leaves the old backup or the new one. What no name needs any longer is removed after it.

What may be ahead of a journal is copied after it (answers apart, delivered samples), what may not is copied before
(ledger, checkpoints, tables); of a journal its whole lines; of SQLite by its own backup.
"""

from __future__ import annotations

import hashlib
import json
import re
import sqlite3
from contextlib import closing, suppress
from dataclasses import dataclass, replace
from datetime import datetime
from functools import partial
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Any

from feel321.files import (
    TEMPORARY,
    UNFINISHED,
    digest_file,
    hold_lock,
    make_folder,
    sweep,
    sync_folder,
    temporary_folder,
    write_bytes,
    write_text,
)
from feel321.study.folder import LEDGER_FILE, SETTINGS_FILE, StudyFolder
from feel321.study.ledger import database, progress, slots
from feel321.study.persons import places, removal, vault
from feel321.study.persons.answers import ANSWERS_FILE
from feel321.study.persons.outputs import (
    MANIFEST,
    OBJECTS,
    OUTPUTS_FILE,
    RESULTS,
    WITHDRAWN,
    note_withdrawn,
    read_withdrawn,
    record_output,
)
from feel321.study.persons.withdrawal import withdraw_participant
from feel321.study.session.journal import SESSION_FILE, find_cut, list_journals
from feel321.study.session.plan import TOMBSTONE_FILE

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    from feel321.study.session.journal import Clock

    Files = dict[str, dict[str, Any]]

FORMAT = 1

_FIRST = ("ledger", "log", "ratings", "roster", "answers", "matches", "checkpoints")
"""Kinds of places that may lag behind journals and not run ahead."""

_OF_LEDGER = re.compile(r"(sessions|rehearsals)/ledger\.(?!folder).*")

_TRIES = 5

_CHAIN = "checkpoints.jsonl"


@dataclass(frozen=True, slots=True)
class BackedUp:
    """What a backup or a restore did: files and bytes in all, those that were new, and what was left out and why."""

    files: int
    size: int
    new: int
    notes: tuple[str, ...]


def back_up(
    study: StudyFolder,
    target: Path,
    *,
    now: Clock,
    follow: Callable[[int, int], None] | None = None,
) -> BackedUp:
    """Copy a study into a backup folder, also while its sessions run; the former backup there is replaced by it."""
    _check_apart(study.path, target)
    former = read_manifest(target) if (target / MANIFEST).exists() else None
    if former and former["study"] != str(study.path.resolve()):
        raise ValueError(
            f"{target}: holds the backup of {former['study']}; name another folder, one per study"
        )
    if former is None and target.is_dir() and {one.name for one in target.iterdir()} - _OWN:
        raise FileExistsError(f"{target}: holds other files; name a new or empty folder")
    make_folder(target / OBJECTS, private=True)
    with hold_lock(target / ".lock", busy="a backup is being written here; let it finish"):
        sweep(target)
        record_output(study, "backup", target, files=(), now=now)
        copy = _Copy(study, target, follow)
        copy.run()
        note_withdrawn(target, removal.list_withdrawn(study))
        _write_manifest(target, study, copy, now=now)
        _drop_unnamed(target, {one["sha256"] for one in copy.files.values()})
    size = sum(one["size"] for one in copy.files.values())
    return BackedUp(len(copy.files), size, copy.new, tuple(copy.notes))


_OWN = {OBJECTS, WITHDRAWN, ".lock"}
"""What a first backup that was interrupted has left in its folder."""


def _check_apart(study: Path, target: Path) -> None:
    one, other = study.resolve(), target.resolve()
    if one == other or one in other.parents or other in one.parents:
        raise ValueError(
            f"{target}: must not contain the study or lie in it; name a folder elsewhere"
        )


class _Copy:
    """A backup while it is made."""

    def __init__(
        self, study: StudyFolder, target: Path, follow: Callable[[int, int], None] | None
    ) -> None:
        self.study, self.target, self.follow = study, target, follow
        self.files: Files = {}
        self.folders: list[str] = []
        self.notes: list[str] = []
        self.left: set[str] = set()
        self.new = 0

    def run(self) -> None:
        """Copy in the order in which nothing is ahead of the journal that names it."""
        before = {path.name for path in self.study.participants}
        first = self.copy_first()
        kept = {"", *before, *self.list_noted()}  # who came later is in the next backup
        everything = [path for path in self.list_paths() if self.find_person(path) in kept]
        is_journal = SESSION_FILE.fullmatch
        for path in sorted(everything, key=lambda path: (not is_journal(path.name), path)):
            if path not in first:
                self.copy(path)
            if self.follow:
                self.follow(len(self.files), len(everything))
        # What journals name was written before them, but perhaps after the list above.
        for path in self.list_paths():
            is_new = self.name(path) not in self.files and not is_journal(path.name)
            if is_new and self.find_person(path) in kept:
                self.copy(path)

    def copy_first(self) -> set[Path]:
        """Copy what may lag behind journals; the chain is never older than the results that it knows."""
        first = {place.path for place in places.list_places(self.study) if place.kind in _FIRST}
        if vault.has_encrypted(self.study):  # earlier versions wrote them there in clear
            self.left.add(ANSWERS_FILE)
        for path in sorted(first):
            if not _is_of_sqlite(path):
                self.copy(path)
        for _ in range(_TRIES):
            if self.copy_results():
                break
        return first

    def copy_results(self) -> bool:
        """Copy the checkpoints, then the results; returns whether no checkpoint was taken in the meantime.

        An analysis that writes meanwhile has noted its beginning in the chain that is kept.
        """
        chain = self.study.path / _CHAIN
        self.copy(chain)
        self.files = {n: one for n, one in self.files.items() if n.split("/")[0] not in RESULTS}
        for path in self.list_paths(of_results=True):
            self.copy(path)
        kept = self.files.get(_CHAIN)
        return kept is None or digest_file(chain) == kept["sha256"]

    def is_first(self, path: Path) -> bool:
        """Whether a file is never copied after journals: one that comes up meanwhile is in the next backup."""
        name = self.name(path)
        return places.TABLES.get(name) in _FIRST or bool(_OF_LEDGER.fullmatch(name))

    def list_noted(self) -> set[str]:
        """List whom the ledger knew when it was copied."""
        sha256 = self.files.get(f"sessions/{LEDGER_FILE}", {}).get("sha256")
        return _read_codes(find_object(self.target, sha256)) if sha256 else set()

    def list_paths(self, *, of_results: bool = False) -> Iterator[Path]:
        """List what is in the study: links are named, and what is unfinished, locks or of SQLite's own is left out."""
        for path in places.walk(self.study.path):
            parts = path.relative_to(self.study.path).parts
            is_part = any(UNFINISHED.fullmatch(one) or TEMPORARY.fullmatch(one) for one in parts)
            if path.is_symlink():
                note = (
                    f"{path}: is a link, which is not followed; back up {path.resolve()} by itself"
                )
                self.notes += [note] if note not in self.notes else []
            elif (
                (parts[0] in RESULTS) == of_results
                and not (is_part or path.name.endswith(".lock") or _is_of_sqlite(path))
                and not self.is_first(path)
            ):
                yield path

    def find_person(self, path: Path) -> str:
        """Find whose folder a path is in; empty if nobody's."""
        parts = path.relative_to(self.study.path).parts
        return parts[1] if parts[0] == "sessions" and len(parts) > 2 else ""  # noqa: PLR2004 - sessions, code, name

    def name(self, path: Path) -> str:
        return path.relative_to(self.study.path).as_posix()

    def copy(self, path: Path) -> None:
        """Copy a file as it is now; one that went in the meantime was not to be kept."""
        if path.is_symlink() or self.name(path) in self.left:
            return
        with suppress(FileNotFoundError):
            content, mode = self.read(path), path.stat().st_mode & 0o777
            sha256 = hashlib.sha256(content).hexdigest()
            place = find_object(self.target, sha256)
            if not (place.is_file() and place.stat().st_size == len(content)):
                make_folder(place.parent, private=True)
                write_bytes(place, content, private=True)
                _read_object(self.target, sha256)
                self.new += 1
            self.files[self.name(path)] = {"sha256": sha256, "size": len(content), "mode": mode}

    def read(self, path: Path) -> bytes:
        content = path.read_bytes()
        if SESSION_FILE.fullmatch(path.name):
            return content[: content.rfind(b"\n") + 1]
        return _read_sqlite(path) if path.name == LEDGER_FILE else content


def _is_of_sqlite(path: Path) -> bool:
    return path.name.startswith(f"{LEDGER_FILE}-")


def _read_sqlite(path: Path) -> bytes:
    """Read a database as it is between two transactions, whoever writes to it."""
    with temporary_folder() as folder:
        with (
            closing(sqlite3.connect(path)) as file,
            closing(sqlite3.connect(folder / "copy")) as to,
        ):
            file.backup(to)
        return (folder / "copy").read_bytes()


def find_object(target: Path, sha256: str) -> Path:
    """Find where a file is kept."""
    return target / OBJECTS / sha256[:2] / sha256


def _read_object(target: Path, sha256: str) -> bytes:
    path = find_object(target, sha256)
    content = path.read_bytes()
    if hashlib.sha256(content).hexdigest() != sha256:
        raise ValueError(
            f"{path}: is damaged (its SHA-256 does not match); check the disk, back up again"
        )
    return content


def _write_manifest(target: Path, study: StudyFolder, copy: _Copy, *, now: Clock) -> None:
    folders = [path for path in study.path.rglob("*") if path.is_dir() and not path.is_symlink()]
    kept = [path for path in folders if not any(path.iterdir())]
    entry = {
        "format": FORMAT,
        "study": str(study.path.resolve()),
        "utc": now().isoformat(timespec="seconds"),
        "folders": sorted(copy.name(path) for path in kept),
        "files": dict(sorted(copy.files.items())),
    }
    text = json.dumps(entry | {"sha256": _digest(entry)}, indent=1)
    write_text(target / MANIFEST, f"{text}\n", private=True)


def _digest(entry: object) -> str:
    return hashlib.sha256(json.dumps(entry, sort_keys=True).encode()).hexdigest()


def read_manifest(target: Path) -> dict[str, Any]:
    """Read and check what a backup says of itself."""
    path = target / MANIFEST
    try:
        entry: dict[str, Any] = json.loads(path.read_bytes())
        is_ours = entry.pop("sha256") == _digest(entry) and entry["format"] == FORMAT
    except FileNotFoundError:
        raise FileNotFoundError(f"{path}: no backup is there; name the folder of one") from None
    except (AttributeError, KeyError, TypeError, ValueError):
        is_ours = False
    if not is_ours:
        raise ValueError(f"{path}: not a whole backup as feel321 writes it; take another copy")
    for name in (*entry["files"], *entry["folders"]):
        if PurePosixPath(name).is_absolute() or ".." in PurePosixPath(name).parts:
            raise ValueError(
                f"{path}: names {name!r}, which is outside of a study; take another copy"
            )
    return entry


def _drop_unnamed(target: Path, named: set[str]) -> None:
    """Remove what no file of the backup is any longer, such as the data of those who withdrew."""
    for path in (target / OBJECTS).glob("*/*"):
        if path.name not in named:
            path.unlink()
    for folder in (target / OBJECTS).iterdir():
        with suppress(OSError):
            folder.rmdir()
    sync_folder(target / OBJECTS)


def restore(target: Path, to: Path, *, now: Clock) -> BackedUp:
    """Bring a study back from a backup to a new place, without those who withdrew since; a second call goes on.

    It is built beside its place and moved there last.
    """
    manifest = read_manifest(target)
    if to.is_symlink() or (to.exists() and (not to.is_dir() or any(to.iterdir()))):
        raise FileExistsError(
            f"{to}: already exists, and nothing is overwritten; name a new folder"
        )
    live = StudyFolder(Path(manifest["study"]))
    gone = read_withdrawn(target) | removal.list_withdrawn(live)
    stage = StudyFolder(to.with_name(f"{to.name}.restoring"))
    make_folder(stage.path)
    with hold_lock(
        stage.path.with_name(f".{to.name}.lock"), busy="it is being restored; let it finish"
    ):
        sweep(stage.path)
        here = _choose(manifest["files"], {*gone})
        _drop_others(stage.path, here)
        new = _bring_all_back(target, stage, here)
        for name in manifest["folders"]:
            make_folder(stage.path / name)
        _catch_up(stage)
        notes = _withdraw_again(stage, gone, now=now)
        if to.exists():
            to.rmdir()
        stage.path.replace(to)
        sync_folder(to.parent)
    stage.path.with_name(f".{to.name}.lock").unlink(missing_ok=True)
    return BackedUp(len(here), sum(one["size"] for one in here.values()), new, tuple(notes))


def _choose(files: Files, gone: set[str]) -> Files:
    """Choose what comes back: nothing of those who withdrew since, and then no table or result that they are in."""
    stones = {name.split("/")[1] for name in files if name.endswith(f"/{TOMBSTONE_FILE}")}
    since = gone - stones
    here = {
        name: one for name, one in files.items() if not since.intersection(name.split("/")[1:2])
    }
    if len(here) == len(files):
        return files
    derived = {*places.TABLES} - {_CHAIN, OUTPUTS_FILE}
    return {
        name: one
        for name, one in here.items()
        if name not in derived and name.split("/")[0] not in RESULTS
    }


def _drop_others(stage: Path, here: Files) -> None:
    """Remove what an interrupted restore of another backup, or the withdrawals in it, put there."""
    for path in list(places.walk(stage)):
        if path.relative_to(stage).as_posix() not in here:
            path.unlink()


def _bring_all_back(target: Path, stage: StudyFolder, here: Files) -> int:
    """Bring files back, the settings first, for they say who may read the rest; counts those that were not there."""
    new = 0
    for name in sorted(here, key=lambda name: (name != SETTINGS_FILE, name)):
        path, facts = stage.path / name, here[name]
        new += not path.is_file()
        top = name.split("/")[0]
        if top in {"sessions", "rehearsals"}:
            replace(stage, is_rehearsal=top == "rehearsals").make_sessions()
        make_folder(path.parent, private=top in {"sessions", "rehearsals"})
        content = _read_object(target, facts["sha256"])
        write_bytes(path, content, private=not facts["mode"] & 0o007)
        path.chmod(facts["mode"])
    return new


def _catch_up(stage: StudyFolder) -> None:
    """Let the ledger follow journals that went on while it was copied; what is cut is left for the audit to find."""
    if not stage.ledger.is_file():
        return
    ledger = database.open_ledger(stage.ledger)
    for entry in database.read_ledger(ledger):
        folder = stage.sessions / entry.participant
        if not list_journals(folder) or (folder / TOMBSTONE_FILE).exists():
            continue
        if any(find_cut(anchor, folder) for anchor in entry.anchors):
            continue
        with suppress(OSError, ValueError):  # damaged, which the audit finds
            own = replace(
                slots.make_entry(progress.read_progress(folder)),
                claimed_utc=entry.claimed_utc,
                station=entry.station,
            )
            if own != entry:
                slots.enter(ledger, entry.participant, own)


def _withdraw_again(stage: StudyFolder, gone: Mapping[str, str], *, now: Clock) -> list[str]:
    """Withdraw those who left since, as of when they did; earlier versions noted no time."""
    notes: list[str] = []
    known = {path.name for path in stage.participants}
    known |= _read_codes(stage.ledger) if stage.ledger.is_file() else set()
    for code in sorted(gone.keys() & known - removal.list_withdrawn(stage).keys()):
        clock = partial(datetime.fromisoformat, gone[code]) if gone[code] else now
        withdraw_participant(stage, code, now=clock, reason="withdrew after the backup")
        notes.append(f"participant {code}: withdrew after the backup and was not brought back")
    return notes


def _read_codes(ledger: Path) -> set[str]:
    """Read whom a ledger knows; nobody where it has no tables yet."""
    with closing(sqlite3.connect(ledger)) as file, suppress(sqlite3.OperationalError):
        return {row[0] for row in file.execute("SELECT participant FROM participants")}
    return set()
