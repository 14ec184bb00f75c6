"""Files: what is read from outside, what is written whole or not at all, and one writer at a time.

What is read are regular files only, no more of them than a limit, and text that is UTF-8. What is written is whole or
absent: nobody ever meets half a table, plan or report.
"""

import codecs
import csv
import errno
import hashlib
import io
import math
import os
import re
import secrets
import shutil
import stat
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from filecmp import cmp
from itertools import chain
from pathlib import Path
from typing import Any, BinaryIO, TextIO

LIMIT = "FEEL321_LARGEST_MB"
LARGEST_MB = 512  # of a file, and of its samples as float64: half an hour of three axes at 10 kHz
TEXT_SHARE = 4  # a text must be so many times smaller: while read, it takes several times its size
SMALL_BYTES = 2**22  # of settings, texts and facts beside recordings
MOST_DIGITS = 4000  # of a number in those: parsers take memory for digits
LONGEST_ROW = 2**20  # bytes in a line of a table: thousands of columns

WIDE_TEXT = {codecs.BOM_UTF32_LE: "UTF-32", codecs.BOM_UTF16_LE: "UTF-16", codecs.BOM_UTF16_BE: "UTF-16"}  # fmt: skip
KINDS = {stat.S_IFIFO: "a named pipe (fifo)", stat.S_IFSOCK: "a socket"}  # all else is a device
GROUP = 0o050  # bits of a folder that its group may read and enter
LOOK_S = 0.2  # how long a lock is waited for: `is_held` takes it for an instant, which must refuse nobody
LONGEST_REFUSAL = 1000  # characters: a file may hold anything, and be long
# How a cell begins that a spreadsheet would run, or that was kept from it.
FORMULA = re.compile(r"'*[=+@\t\r-]")
UNFINISHED = re.compile(r"\..+\.\d+(\.\w+)?\.part")  # `.NAME.PID.TOKEN.part`, while NAME is written
TEMPORARY = re.compile(r"feel321-\d+-\w+")  # temporary folders: `feel321-PID-TOKEN`


class TooLargeError(ValueError):
    """A file is above the limit, which is no sign of damage."""


def read_limit() -> int:
    """Read the bytes that a file may hold or its samples take, which a setting of the environment may change."""
    text = os.environ.get(LIMIT, "")
    with suppress(ValueError):
        if not text or 1 <= float(text) <= 2**30:
            return round(float(text or LARGEST_MB) * 1e6)
    raise ValueError(f"{LIMIT} must be a number of megabytes from 1 to {2**30}, got {clip(text)!r}")


def clip(text: str, most: int = 60) -> str:
    """Cut a text that goes into a message."""
    return text if len(text) <= most else f"{text[: most - 3]}..."


def word_fault(error: ValueError, *, is_blind: bool = False) -> str:
    """Word what is wrong with a file that does not fit its model: the first fault, where it is and what was got.

    is_blind: what was got is not shown: it may be a rating, a condition or an answer.
    """
    from pydantic import ValidationError

    if not isinstance(error, ValidationError):
        return str(error)
    first = error.errors(include_url=False)[0]
    place, got = ".".join(map(str, first["loc"])), f", got {clip(repr(first['input']))}"
    return f"{place}: {first['msg']}{'' if is_blind else got}" if place else first["msg"]


def check_bytes(n_bytes: int, what: str, *, most: int | None = None) -> None:
    """Refuse what would take more memory than the limit, before it is taken."""
    limit = read_limit()
    most = limit if most is None else min(most, limit)
    if n_bytes > most:
        how = "cut it into shorter ones"
        if most == limit:
            how += f", or set {LIMIT}={math.ceil(n_bytes / 1e6)} in the environment if it is right"
        what = f"{what}: {n_bytes / 1e6:,.0f} MB, at most {most / 1e6:,.0f} MB are read"
        raise TooLargeError(f"{what}; {how}")


def check_samples(n_samples: int, n_axes: int, rate_hz: float | None = None) -> None:
    """Refuse samples of a header that would take more memory than the limit, before they are read."""
    seconds = f", {n_samples / rate_hz:,.0f} s" if rate_hz else ""
    promised = f"promises {n_samples:,} samples of {n_axes} channels{seconds}"
    check_bytes(8 * n_samples * n_axes, promised)


def open_regular(path: Path) -> BinaryIO:
    """Open a regular file to read it; a pipe, device or socket is refused at once, never waited for."""
    mode = path.stat().st_mode
    if stat.S_ISDIR(mode):
        raise IsADirectoryError(errno.EISDIR, "is a folder, not a file", str(path))
    if not stat.S_ISREG(mode):
        got = KINDS.get(stat.S_IFMT(mode), "a device")
        must = f"{path.name}: must be a regular file, got {got}"
        raise ValueError(f"{must}; copy its content into a file")
    # Nor is what may have been put in its place just now.
    further = sum(getattr(os, name, 0) for name in ("O_NONBLOCK", "O_NOCTTY"))
    return open(path, "rb", opener=lambda name, flags: os.open(name, flags | further))


def read_bytes(path: Path, *, most: int | None = None) -> bytes:
    """Read a regular file whole, if it is no larger than the limit; what it gains meanwhile is left."""
    with open_regular(path) as file:
        size = os.fstat(file.fileno()).st_size
        check_bytes(size, path.name, most=most)
        return file.read(size)  # allocates as much as it is asked for


def read_text(path: Path) -> str:
    """Read a text in UTF-8, with or without byte-order mark; a wrong byte is named with its line."""
    return decode(read_bytes(path), path.name)


@contextmanager
def open_text(path: Path) -> Iterator[TextIO]:
    """Open a table in UTF-8 to read it row by row, its line ends as they are; a wrong byte is named with its line."""
    with open_regular(path) as file, io.TextIOWrapper(file, "utf-8-sig", newline="") as text:
        try:
            yield text
        except UnicodeDecodeError:
            read_text(path)  # which names the line
            raise


def read_small(path: Path) -> str:
    """Read a text of settings or facts, which are never large, nor are its numbers."""
    text = decode(read_bytes(path, most=SMALL_BYTES), path.name)
    if found := re.search(rf"[0-9_]{{{MOST_DIGITS}}}", text):
        line = text.count("\n", 0, found.start()) + 1
        raise ValueError(
            f"{path.name}: line {line} holds a number of more than {MOST_DIGITS} digits"
        )
    return text


def decode(content: bytes, name: str) -> str:
    """Decode a text of a file of that name."""
    for mark, kind in WIDE_TEXT.items():
        if content.startswith(mark):
            raise ValueError(f"{name}: the text is in {kind}; save the file as UTF-8")
    text, at = "", content.find(b"\0")
    what, remedy = "a zero byte (byte {} of the file), as no text does", "is it damaged?"
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        at = len(content) - len(error.object) + error.start  # the mark is left out
        what = f"the byte 0x{content[at]:02x}, which is not UTF-8 (perhaps Latin-1; byte {{}} of the file)"
        remedy = "save the file as UTF-8"
    if at >= 0:
        line = content.count(b"\n", 0, at) + 1
        raise ValueError(f"{name}: line {line} holds {what.format(at + 1)}; {remedy}")
    return text


def check_lines(content: bytes) -> None:
    """Refuse a text with a line that is longer than any table's."""
    start = 0
    while len(content) - start > LONGEST_ROW:
        piece = content[start : start + LONGEST_ROW + 1]
        end = max(piece.rfind(b"\n"), piece.rfind(b"\r"))
        if end < 0:
            line = content.count(b"\n", 0, start) + 1
            what = f"line {line} is longer than {LONGEST_ROW} bytes"
            raise ValueError(f"{what}; a table has a row per sample: is it one?")
        start += end + 1


# Files that are written.


def defuse(cell: Any) -> Any:  # noqa: ANN401 - any cell of a table
    """Put an apostrophe before a text that a spreadsheet would run as a formula; numbers stay as they are."""
    if not isinstance(cell, str) or not FORMULA.match(cell):
        return cell
    try:
        float(cell)
    except ValueError:
        return f"'{cell}"
    return cell


def list_csv(columns: Sequence[str], rows: Iterable[Mapping[str, Any]]) -> Iterator[str]:
    """Write a CSV table line by line, the head first."""
    text = io.StringIO(newline="")
    table = csv.writer(text)
    for row in chain([dict(zip(columns, columns, strict=True))], rows):
        cells = [row.get(name, "") for name in columns]
        table.writerow([defuse(cell) if isinstance(cell, str) else cell for cell in cells])
        yield text.getvalue()
        text.seek(0)
        text.truncate()


def digest_file(path: Path) -> str:
    """Compute the SHA-256 of a file."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


# Files that are written whole. private: nobody but its owner may read it, from its first byte (see `find_mode`).


def write_text(path: Path, text: str, *, private: bool = False) -> None:
    """Write a text file in one step, replacing the one that is there unless it holds just that."""
    _write(path, [text.encode()], private=private)


def write_bytes(path: Path, content: bytes, *, private: bool = False) -> None:
    """Write a file in one step, replacing the one that is there unless it holds just that."""
    _write(path, [content], private=private)


def write_table(
    path: Path, columns: Sequence[str], rows: Iterable[Mapping[str, Any]], *, private: bool = False
) -> int:
    """Write a CSV table in one step, and count its rows; what a row holds besides the columns is left out."""
    chunks = (line.encode() for line in list_csv(columns, rows))
    return _write(path, chunks, private=private) - 1


def create_text(path: Path, text: str, *, private: bool = False) -> None:
    """Write a text file where none is yet."""
    if path.exists():
        what = f"{path}: already exists and is not overwritten"
        raise FileExistsError(f"{what}; move it away or use it")
    write_text(path, text, private=private)


def create_file(path: Path, *, private: bool = False) -> None:
    """Begin an empty file; one that is there is refused."""
    flags = os.O_CREAT | os.O_EXCL | os.O_WRONLY
    os.close(os.open(path, flags, find_mode(path, private=private)))


def _write(path: Path, chunks: Iterable[bytes], *, private: bool) -> int:
    """Write a file beside its target, on the same file system, which takes its name as a whole; counts the chunks."""

    def begin() -> Path:
        part = path.with_name(f".{path.name}.{os.getpid()}.{secrets.token_hex(4)}.part")
        create_file(part, private=private)
        return part

    count = 0
    with _naming(path), _claim(begin) as part:
        with part.open("wb") as file:
            for count, chunk in enumerate(chunks, start=1):  # noqa: B007 - the last one counts
                file.write(chunk)
            file.flush()
            is_open = private and os.name != "nt" and path.is_file() and path.stat().st_mode & 0o027
            if path.is_file() and not is_open and cmp(part, path, shallow=False):
                return count
            os.fsync(file.fileno())
        part.replace(path)
        sync_folder(path.parent)
    return count


@contextmanager
def _naming(path: Path) -> Iterator[None]:
    """Name the file in an error: a full disk is reported without a name, most else with that of the unfinished file."""
    try:
        yield
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(path)) from error


def find_mode(path: Path, *, private: bool) -> int:
    """Find the mode of a new file: of a private one 0600, or 0640 in a folder that is its group's and nobody else's."""
    return 0o666 if not private else 0o640 if is_of_group(path.parent) else 0o600


def is_of_group(folder: Path) -> bool:
    """Check whether its group may read a folder, and nobody else besides its owner."""
    return folder.stat().st_mode & (GROUP | 0o007) == GROUP


def make_folder(path: Path, *, private: bool = False) -> None:
    """Make a folder and those above it that are missing; private ones have mode 0700, or 0750 in one that is so."""
    for folder in reversed([one for one in (path, *path.parents) if not one.is_dir()]):
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


def sync_folder(folder: Path) -> None:
    """Make a new file's name survive a power cut, where the system can promise that."""
    if os.name != "nt":  # Windows opens no folders and needs no such call
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


# What a killed process leaves: every unfinished file and temporary folder is locked by its process while that lives.


@contextmanager
def temporary_folder(beside: Path | None = None) -> Iterator[Path]:
    """Give a folder of its owner alone, which ends with the block: in the system's place, or beside a path."""
    place = None if beside is None else beside.parent
    prefix = f"feel321-{os.getpid()}-"
    with _claim(lambda: Path(tempfile.mkdtemp(prefix=prefix, dir=place))) as folder:
        yield folder


def sweep(folder: Path) -> list[Path]:
    """Remove the unfinished files and temporary folders that killed processes left below a folder, and name them."""
    swept = []
    for name, folders, files in os.walk(folder):
        left = [one for one in folders if TEMPORARY.fullmatch(one)]
        parts = [one for one in files if UNFINISHED.fullmatch(one)]
        swept += [path for one in (*parts, *left) if _end(path := Path(name, one))]
        folders[:] = [one for one in folders if one not in left]
    return sorted(swept)


def sweep_temporary() -> list[Path]:
    """Do as `sweep`, with our folders in the system's place for temporary ones."""
    found = Path(tempfile.gettempdir()).glob("feel321-*")
    return sorted(one for one in found if TEMPORARY.fullmatch(one.name) and _end(one))


@contextmanager
def _claim(make: Callable[[], Path]) -> Iterator[Path]:
    """Make a file or folder, hold it, and remove what is left of it; made anew where it was swept in between."""
    hold = _hold(path := make(), wait=True)
    while not path.exists():  # pragma: no cover
        _let_go(hold)
        hold = _hold(path := make(), wait=True)
    try:
        yield path
    finally:
        if path.is_dir():
            shutil.rmtree(path, ignore_errors=True)
        else:
            path.unlink(missing_ok=True)
        _let_go(hold)


def _hold(path: Path, *, wait: bool = False) -> int:
    """Open and lock a file or folder for this process, however that ends; -1 where that cannot be, as on Windows."""
    descriptor = -1
    if sys.platform != "win32":
        import fcntl

        try:
            descriptor = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
            fcntl.flock(descriptor, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
        except OSError:  # a disk may know no locks
            _let_go(descriptor)
            return -1
    return descriptor


def _let_go(descriptor: int) -> None:
    if descriptor >= 0:
        os.close(descriptor)


def _end(path: Path) -> bool:
    """Remove what its process has left, and say whether it is gone; what is held, or not ours, stays."""
    hold = _hold(path)
    try:
        is_ours = hold >= 0 and os.fstat(hold).st_uid == os.getuid()
        if is_ours and path.is_dir():
            shutil.rmtree(path, ignore_errors=True)
        elif is_ours or (os.name == "nt" and path.is_file()):
            with suppress(OSError):  # as Windows says of an open file
                path.unlink(missing_ok=True)
        return not os.path.lexists(path)
    finally:
        _let_go(hold)


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
    """Put the file's name before every refusal raised inside, once, and make one line of it that can be printed."""
    prefix = f"{path.name}: "
    try:
        yield
    except ValueError as error:
        text = str(error).removeprefix(prefix)
        if len(text) > LONGEST_REFUSAL:
            text = f"{text[: LONGEST_REFUSAL // 2]} ... {text[-LONGEST_REFUSAL // 2 :]}"
        shown = (c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)
        raise ValueError(prefix + "".join(shown)) from error
    except OSError as error:
        raise type(error)(f"{prefix}{error.strerror or str(error).removeprefix(prefix)}") from error
