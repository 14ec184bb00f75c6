"""Remove a person's files: never through a link; files that cannot be removed are listed."""

from __future__ import annotations

import csv
import json
from collections.abc import Iterator
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

from feel321.files import digest_file, sweep, sweep_temporary, sync_folder
from feel321.study.ledger import progress
from feel321.study.persons import places
from feel321.study.persons.outputs import (
    MANIFEST,
    OBJECTS,
    OUTPUTS_FILE,
    RESULTS,
    WrittenOutput,
    note_withdrawn,
    read_outputs,
    settle_outputs,
)
from feel321.study.session.plan import TOMBSTONE_FILE

if TYPE_CHECKING:
    from collections.abc import Collection

    from feel321.study.folder import StudyFolder


def drop_link(path: Path) -> Iterator[str]:
    """Remove a link, and name what it leads to: that is left as it is."""
    if path.is_symlink():
        target = path.resolve()
        path.unlink()
        yield f"{path}: was a link and is removed; {target} is left, remove the participant's data there"


def clear_folder(folder: Path, *, keep: Collection[Path] = ()) -> tuple[list[str], list[str]]:
    """Remove everything in a folder but what is to be kept; returns the names, and what was said of links."""
    removed: list[str] = []
    said: list[str] = []
    for path in reversed(list(_walk(folder))):
        if path in keep:
            continue
        removed.append(path.relative_to(folder).as_posix())
        if path.is_symlink():
            said += drop_link(path)
        elif path.is_dir():
            path.rmdir()
        else:
            path.unlink()
    sync_folder(folder)
    return sorted(removed), said


def _walk(folder: Path) -> Iterator[Path]:
    for path in sorted(folder.iterdir()):
        yield path
        if path.is_dir() and not path.is_symlink():
            yield from _walk(path)


def clear_unfinished(study: StudyFolder) -> Iterator[str]:
    """Remove what killed runs left, in the study and in the system's temporary folder; name what a live one holds."""
    sweep(study.path)
    sweep_temporary()
    for place in places.list_places(study):
        if place.path.is_symlink() and place.kind == "unfinished":
            yield from drop_link(place.path)
        elif place.kind == "unfinished" and place.path.exists():
            yield f"{place.path}: is still being written; when it is finished, run feel321 audit"


def clear_results(study: StudyFolder) -> Iterator[str]:
    """Remove the folders of results that were made of ratings; yield what there is to do."""
    for name in RESULTS:
        if (folder := study.path / name).is_symlink():
            yield from drop_link(folder)
        elif folder.is_dir() and _holds_ratings(folder):
            yield from clear_result(folder)


def clear_result(folder: Path) -> Iterator[str]:
    """Remove the files of one folder of results."""
    from feel321.analysis.report.folder import remove_results

    remove_results(folder)
    verb = {"report": "analyze", "advice": "advise"}.get(folder.name, folder.name)
    yield f"{folder}: was removed because it held the participant's data; make it again: feel321 {verb}"
    if folder.exists():
        yield f"{folder}: holds other files; remove those with the participant's data"


def _holds_ratings(folder: Path) -> bool:
    """Whether results were made of ratings; a chart of recordings alone takes hours and holds nobody's."""
    rated = folder / "tables" / "rated.csv"
    if folder.name != "chart" or not rated.is_file():
        return True
    return len(rated.read_bytes().splitlines()) > 1


def clear_outputs(study: StudyFolder) -> Iterator[str]:
    """Remove what verbs wrote elsewhere, as far as it is here and as they wrote it; name the rest, and the backups."""
    gone: list[WrittenOutput] = []
    stale: list[WrittenOutput] = []
    for output in read_outputs(study):
        is_backup = output.verb == "backup"
        clear = _clear_backup if is_backup else _clear_output
        is_own = output.study in {"", str(study.path.resolve())}
        left = list(clear(study, output)) if is_own or is_backup else [_describe_foreign(output)]
        yield from left
        (stale if left else gone).append(output)
    if gone or stale:
        settle_outputs(study, gone=gone, stale=stale)


def _describe_foreign(output: WrittenOutput) -> str:
    return (
        f"{output.path}: was written from {output.study}, of which this is a copy, or which was moved here; remove the "
        "participant's data there"
    )


def _clear_backup(study: StudyFolder, output: WrittenOutput) -> Iterator[str]:
    if not _is_here(output):
        yield _describe_away(study, output)
        return
    try:
        note_withdrawn(output.path, list_withdrawn(study))
    except OSError as error:
        yield f"{output.path}: the withdrawal could not be noted there ({error})"
    yield f"{output.path}: is a backup with the participant's data; {_again(study, output)}"


def list_stale(study: StudyFolder) -> Iterator[str]:
    """Name backups that still hold data of those who withdrew, and what was away when they did."""
    gone = set(list_withdrawn(study))
    for output in read_outputs(study) if gone else ():
        if output.stale and not _is_here(output):
            yield _describe_away(study, output)
        elif output.verb == "backup" and (held := sorted(gone & _list_backed_up(output.path))):
            who = ", ".join(held)
            yield f"{output.path}: is a backup with data of {who}, who withdrew; {_again(study, output)}"


def _list_backed_up(target: Path) -> set[str]:
    """List whose sessions or rehearsals a backup holds; nobody's where it cannot be read, which `restore` says."""
    try:
        names = [name.split("/") for name in json.loads((target / MANIFEST).read_bytes())["files"]]
    except (OSError, KeyError, TypeError, ValueError):
        return set()
    return {name[1] for name in names if len(name) > 2 and name[-1] != TOMBSTONE_FILE}  # noqa: PLR2004 - room, code, name


def _is_here(output: WrittenOutput) -> bool:
    if output.verb == "backup":
        return (output.path / OBJECTS).is_dir()
    paths = (output.path / name if name != "." else output.path for name in output.files)
    return any(path.exists() for path in paths) if output.files else output.path.parent.is_dir()


def _describe_away(study: StudyFolder, output: WrittenOutput) -> str:
    what, mend = (
        "what {0.verb} wrote there",
        "withdraw again, or remove the participant's data there",
    )
    if output.verb == "backup":
        what, mend = "a backup with the participant's data", _again(study, output)
    return (
        f"{output.path}: {what.format(output)} is not here now; bring it back, then {mend}; if it is gone for good, "
        f"take its line out of {study.path / OUTPUTS_FILE}"
    )


def list_withdrawn(study: StudyFolder) -> dict[str, str]:
    """List who withdrew, and when; at no time where the tombstone cannot be read, which is found elsewhere."""
    found = {}
    for folder in study.participants:
        if (folder / TOMBSTONE_FILE).exists():
            found[folder.name] = ""
            with suppress(ValueError):
                stone = progress.read_tombstone(folder)
                found[folder.name] = stone.utc if stone else ""
    return found


def _again(study: StudyFolder, output: WrittenOutput) -> str:
    return f"remove them there too: feel321 backup {study.path} --to {output.path}"


def _clear_output(study: StudyFolder, output: WrittenOutput) -> Iterator[str]:
    if output.path.is_symlink():
        yield f"{output.path}: has become a link; remove the participant's data behind it"
        return
    if not _is_here(output):
        yield _describe_away(study, output)
    if not output.files and output.path.exists():
        yield f"{output.path}: {output.verb} was interrupted there; remove the participant's data in it"
    for name, sha256 in output.files.items():
        path = output.path / name if name != "." else output.path
        if path.is_symlink():
            yield from drop_link(path)
        elif path.is_file() and digest_file(path) != sha256:
            yield f"{path}: was changed since {output.verb} wrote it; remove the participant's data in it"
        else:
            path.unlink(missing_ok=True)
    inner = {output.path / name for name in output.files if name != "."}
    folders = {one for path in inner for one in path.parents if one.is_relative_to(output.path)}
    for folder in sorted(folders, reverse=True):
        with suppress(OSError):  # holds other files, or is gone
            folder.rmdir()


def find_data_left(study: StudyFolder) -> Iterator[str]:
    """Find data of those who withdrew in every place but their own folder, which the audit looks at by itself."""
    stones = {}
    for folder in study.participants:
        if (folder / TOMBSTONE_FILE).exists():
            with suppress(ValueError):  # reported by whoever looks at the folder
                stones[folder.name] = progress.read_tombstone(folder)
    if not stones:
        return
    dates = [one.utc for one in stones.values() if one and one.journals]
    newest = max(map(datetime.fromisoformat, dates), default=None)
    yield from _find_returned(study, min(stones))
    for place in places.list_places(study):
        for participant in stones:
            if why := _find_trace(place, participant, study):
                yield f"{place.path}: {why} {participant}, who withdrew; finish: {_withdraw(study, participant)}"
        if newest and place.kind in {"results", "output"} and _is_older(place.path, newest):
            yield f"{place.path}: was made before somebody withdrew; remove it, and make it again"


def _find_returned(study: StudyFolder, participant: str) -> Iterator[str]:
    """Find what was away at a withdrawal and is here again as it was written; any withdrawal finishes it."""
    mend = f"was written before somebody withdrew and has come back; finish: {_withdraw(study, participant)}"
    for output in read_outputs(study):
        paths = {
            output.path / name if name != "." else output.path: digest
            for name, digest in output.files.items()
        }
        if output.stale and any(p.is_file() and digest_file(p) == sha for p, sha in paths.items()):
            yield f"{output.path}: {mend}"


def _withdraw(study: StudyFolder, participant: str) -> str:
    return f"feel321 withdraw {study.path} --participant {participant}"


def _find_trace(place: places.DataPlace, participant: str, study: StudyFolder) -> str:
    if (
        participant in place.participants
        and place.path.parts[len(study.path.parts)] == "rehearsals"
    ):
        return "is of a rehearsal of"
    if place.path.suffix == ".csv" and place.kind in {"ratings", "roster", "answers", "matches"}:
        with place.path.open(encoding="utf-8", newline="", errors="replace") as file:
            if any(row.get("participant") == participant for row in csv.DictReader(file)):
                return "holds rows of"
    return ""


def _is_older(path: Path, utc: datetime) -> bool:
    if path.name != "results.json":
        return False
    return datetime.fromtimestamp(path.lstat().st_mtime, UTC) < utc
