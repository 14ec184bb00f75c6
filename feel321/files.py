"""Files that are whole or absent: nobody ever meets half a table, plan or report. And one writer at a time."""

import csv
import hashlib
import io
import os
import re
import secrets
import shutil
import sys
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from filecmp import cmp
from itertools import chain
from pathlib import Path
from typing import Any, BinaryIO

LOOK_S = 0.2
"""How long a lock is waited for: `is_held` takes it for an instant, which must refuse nobody."""


UNFINISHED = re.compile(r"\..+\.\d+(\.\w+)?\.part")
"""Names of files while they are written: `.NAME.PID.TOKEN.part`."""

TEMPORARY = re.compile(r"feel321-\d+-\w+")
"""Names of temporary folders: `feel321-PID-TOKEN`."""


def write_text(path: Path, text: str, *, private: bool = False) -> None:
    """Write a text file in one step, replacing the one that is there unless it holds just that."""
    _write(path, [text.encode()], private=private)


def write_table(
    path: Path, columns: Sequence[str], rows: Iterable[Mapping[str, Any]], *, private: bool = False
) -> int:
    """Write a CSV table in one step, and count its rows; what a row holds besides the columns is left out."""
    chunks = (line.encode() for line in list_csv(columns, rows))
    return _write(path, chunks, private=private) - 1


def list_csv(columns: Sequence[str], rows: Iterable[Mapping[str, Any]]) -> Iterator[str]:
    """Write a CSV table line by line, the head first."""
    text = io.StringIO(newline="")
    table = csv.DictWriter(text, columns, extrasaction="ignore")
    for row in chain([dict(zip(columns, columns, strict=True))], rows):
        table.writerow({name: defuse(cell) for name, cell in row.items()})
        yield text.getvalue()
        text.seek(0)
        text.truncate()


FORMULA = re.compile(r"'*[=+@\t\r-]")
"""How a cell begins that a spreadsheet would take for a formula, or that was kept from it."""


def defuse(cell: Any) -> Any:  # noqa: ANN401 - any cell of a table
    """Put an apostrophe before a text that a spreadsheet would run as a formula; numbers stay as they are.

    Examples
    --------
    >>> defuse("=1+1"), defuse("-3.5"), defuse("oak"), defuse(-3.5)
    ("'=1+1", '-3.5', 'oak', -3.5)
    """
    if not isinstance(cell, str) or not FORMULA.match(cell):
        return cell
    try:
        float(cell)
    except ValueError:
        return f"'{cell}"
    return cell


def digest_file(path: Path) -> str:
    """Compute the SHA-256 of a file."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def write_bytes(path: Path, content: bytes, *, private: bool = False) -> None:
    """Write a file in one step, replacing the one that is there unless it holds just that.

    private: nobody but its owner may read it, from its first byte (see `find_mode`).
    """
    _write(path, [content], private=private)


def _write(path: Path, chunks: Iterable[bytes], *, private: bool = False) -> int:
    """Write a file beside its target, which takes its name as a whole; counts the chunks."""
    count = 0
    with _naming(path), _unfinished(path, private=private) as (file, unfinished):
        for count, chunk in enumerate(chunks, start=1):  # noqa: B007 - the last one counts
            file.write(chunk)
        file.flush()
        is_open = private and os.name != "nt" and path.is_file() and path.stat().st_mode & 0o027
        if path.is_file() and not is_open and cmp(unfinished, path, shallow=False):
            return count
        os.fsync(file.fileno())
        if os.name == "nt":  # pragma: no cover - an open file is not moved there
            file.close()
        unfinished.replace(path)
        sync_folder(path.parent)
    return count


@contextmanager
def _unfinished(path: Path, *, private: bool) -> Iterator[tuple[BinaryIO, Path]]:
    """Open a file beside its target, so that the replacement stays on one file system and is atomic; it is held."""
    while True:
        place = path.with_name(f".{path.name}.{os.getpid()}.{secrets.token_hex(4)}.part")
        flags = os.O_CREAT | os.O_EXCL | os.O_WRONLY | getattr(os, "O_BINARY", 0)
        descriptor = os.open(place, flags, find_mode(path, private=private))
        _lock(descriptor, wait=True)
        if os.fstat(descriptor).st_nlink:
            break
        os.close(descriptor)  # pragma: no cover - swept between its making and its hold
    try:
        with os.fdopen(descriptor, "wb") as file:
            yield file, place
    finally:
        place.unlink(missing_ok=True)


@contextmanager
def _naming(path: Path) -> Iterator[None]:
    """Name the file in an error: a full disk is reported without a name, most else with that of the unfinished file."""
    try:
        yield
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(path)) from error


def find_mode(path: Path, *, private: bool) -> int:
    """Find the mode of a new file: of a private one 0600, or 0640 in a folder that is its group's and nobody else's.

    So a folder that a lab opens to its group hands that on. Windows knows no modes.
    """
    if not private:
        return 0o666
    return 0o640 if is_of_group(path.parent) else 0o600


GROUP = 0o050
"""Bits of a folder that its group may read and enter."""


def is_of_group(folder: Path) -> bool:
    """Check whether its group may read a folder, and nobody else besides its owner."""
    return folder.stat().st_mode & (GROUP | 0o007) == GROUP


def create_text(path: Path, text: str, *, private: bool = False) -> None:
    """Write a text file where none is yet."""
    if path.exists():
        raise FileExistsError(
            f"{path}: already exists and is not overwritten; move it away or use it"
        )
    write_text(path, text, private=private)


def create_file(path: Path, *, private: bool = False) -> None:
    """Begin an empty file whose name survives a power cut; one that is there is refused."""
    os.close(os.open(path, os.O_CREAT | os.O_EXCL | os.O_WRONLY, find_mode(path, private=private)))
    sync_folder(path.parent)


def make_folder(path: Path, *, private: bool = False) -> None:
    """Make a folder and those above it that are missing; each new name survives a power cut.

    private: nobody but their owner may enter the new ones (mode 0700; 0750 in a folder that is so). A folder that is
    there stays as it is.
    """
    missing = [one for one in (path, *path.parents) if not one.is_dir()]
    for folder in reversed(missing):
        mode = find_mode(folder, private=private)
        mode |= (mode & 0o444) >> 2  # who may read a folder may enter it
        with _naming(folder):
            folder.mkdir(mode=mode, exist_ok=True)
            sync_folder(folder.parent)


def move_files(moves: Mapping[Path, Path]) -> None:
    """Move files to other places of the same file system, in this order; contents and names survive a power cut."""
    for path in moves:
        with path.open("r+b") as file:
            os.fsync(file.fileno())
    for path, target in moves.items():
        path.replace(target)
    for folder in {target.parent for target in moves.values()}:
        sync_folder(folder)


@contextmanager
def temporary_folder(beside: Path | None = None) -> Iterator[Path]:
    """Give a folder of its owner alone, which ends with the block: in the system's place, or beside a path.

    It is held by its process: `sweep` removes one whose process was killed.
    """
    place = None if beside is None else beside.parent
    while True:
        folder = Path(tempfile.mkdtemp(prefix=f"feel321-{os.getpid()}-", dir=place))
        hold = _hold(folder)
        _lock(hold, wait=True)
        if folder.is_dir():
            break
        os.close(hold)  # pragma: no cover - swept between its making and its hold
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)
        if hold >= 0:
            os.close(hold)


def sweep(folder: Path) -> list[Path]:
    """Remove the unfinished files and temporary folders that killed processes left below a folder, and name them.

    What a live process holds stays, on whichever machine that shares the folder; links are not followed. Temporary
    folders are not swept on Windows, where nothing can hold them.
    """
    swept = []
    for name, folders, files in os.walk(folder):
        place = Path(name)
        swept += [place / one for one in files if UNFINISHED.fullmatch(one) and _end(place / one)]
        left = [one for one in folders if TEMPORARY.fullmatch(one)]
        swept += [place / one for one in left if _end(place / one)]
        folders[:] = [one for one in folders if one not in left]
    return sorted(swept)


def sweep_temporary() -> list[Path]:
    """Do as `sweep`, with our folders in the system's place for temporary ones."""
    found = Path(tempfile.gettempdir()).glob("feel321-*")
    return sorted(one for one in found if TEMPORARY.fullmatch(one.name) and _end(one))


def sync_folder(folder: Path) -> None:
    """Make a new file's name survive a power cut, where the system can promise that."""
    if os.name == "nt":  # pragma: no cover - Windows opens no folders and needs no such call
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


@contextmanager
def hold_lock(path: Path, *, busy: str, wait_s: float = LOOK_S) -> Iterator[None]:
    """Hold the lock that a file stands for, or refuse; it ends with its process, however that ends."""
    from filelock import FileLock, Timeout

    lock = FileLock(path, timeout=wait_s, mode=find_mode(path, private=True))
    try:
        lock.acquire()
    except Timeout:
        raise BlockingIOError(f"{path.parent}: {busy}") from None
    try:
        yield
    finally:
        lock.release()


def is_held(path: Path) -> bool:
    """Check whether a live process holds a lock, without writing; yes where nobody may look."""
    if not path.exists():
        return False
    try:
        if sys.platform == "win32":
            from filelock import FileLock

            with FileLock(path, timeout=0):
                return False
        import fcntl

        with path.open("rb") as file:  # closing it lets go of the lock
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except OSError:  # a timeout is one
        return True
    return False


@contextmanager
def file_named(path: Path) -> Iterator[None]:
    """Put the file's name before every refusal raised inside, once: a reader raises bare sentences."""
    prefix = f"{path.name}: "
    try:
        yield
    except ValueError as error:
        text = str(error).removeprefix(prefix)
        raise ValueError(prefix + as_line(text)) from error
    except OSError as error:
        raise type(error)(f"{prefix}{error.strerror or str(error).removeprefix(prefix)}") from error


LONGEST_LINE = 1000
"""Characters of a refusal: a file may hold anything, and be long."""


def as_line(text: str) -> str:
    """Put a refusal on one line that can be printed: a file's own names may hold line feeds, or be endless."""
    if len(text) > LONGEST_LINE:
        text = f"{text[: LONGEST_LINE // 2]} ... {text[-LONGEST_LINE // 2 :]}"
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


def _hold(path: Path) -> int:
    """Open a file or folder that is there, for a lock; less than 0 if that cannot be."""
    if (
        os.name == "nt"
    ):  # pragma: no cover - an open file cannot be removed there, a folder cannot be held
        return -1
    try:
        return os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
    except OSError:
        return -1


def _lock(descriptor: int, *, wait: bool = False) -> bool:
    """Lock an open file for this process, however that ends; a disk that knows no locks says no."""
    if sys.platform == "win32":  # pragma: no cover - an open file is safe there anyway
        return True
    import fcntl

    with suppress(OSError):
        fcntl.flock(descriptor, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
        return True
    return False


def _end(path: Path) -> bool:
    """Remove what its process has left, and say whether it is gone; what is held, or not ours, stays."""
    if os.name == "nt":  # pragma: no cover - an open file is not removed there, a folder stays
        with suppress(OSError):
            path.unlink()
        return not path.exists()
    if path.is_symlink() or (hold := _hold(path)) < 0:
        return False
    try:
        is_ours = os.fstat(hold).st_uid == os.getuid()
        if not (is_ours and _lock(hold)):
            return False
        if path.is_dir():
            shutil.rmtree(path, ignore_errors=True)
        else:
            path.unlink(missing_ok=True)
        return not path.exists()
    finally:
        os.close(hold)
