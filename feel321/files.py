"""Files that are whole or absent: nobody ever meets half a table, plan or report. And one writer at a time."""

import csv
import hashlib
import io
import os
import sys
import uuid
import warnings
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from filecmp import cmp
from itertools import chain, count
from pathlib import Path
from typing import Any, BinaryIO

LOOK_S = 0.2
"""How long a lock is waited for: `is_held` takes it for an instant, which must refuse nobody."""


def write_text(path: Path, text: str) -> None:
    """Write a text file in one step, replacing the one that is there unless it holds just that."""
    write_bytes(path, text.encode())


def write_table(path: Path, columns: Sequence[str], rows: Iterable[Mapping[str, Any]]) -> int:
    """Write a CSV table in one step, and count its rows; what a row holds besides the columns is left out."""
    return write_chunks(path, list_csv(columns, rows)) - 1


def list_csv(columns: Sequence[str], rows: Iterable[Mapping[str, Any]]) -> Iterator[str]:
    """Write a CSV table line by line, the head first."""
    text = io.StringIO(newline="")
    table = csv.DictWriter(text, columns, extrasaction="ignore")
    for row in chain([dict(zip(columns, columns, strict=True))], rows):
        table.writerow(row)
        yield text.getvalue()
        text.seek(0)
        text.truncate()


def write_chunks(path: Path, chunks: Iterable[str]) -> int:
    """Write a text file as `write_text` does, but piece by piece, never in memory as a whole; counts the pieces."""
    written = count()

    def write(file: BinaryIO) -> None:
        for chunk, _ in zip(chunks, written, strict=False):
            file.write(chunk.encode())

    with _naming(path):
        _replace(path, write)
    return next(written)


LONG_TABLE = 100_000
"""Rows above which a table is written as Parquet too."""


def write_twin(path: Path, rows: int, *, text: Collection[str]) -> None:
    """Write a CSV table of so many rows as Parquet beside it, if it is long; warns where pyarrow is missing.

    text: columns whose cells stay as they are written; the others are numbers or flags, an empty cell of which is null.
    The CSV is what counts: the Parquet file holds its digest, and one that was written from an earlier one goes.
    """
    twin = path.with_suffix(".parquet")
    twin.unlink(missing_ok=True)
    if rows <= LONG_TABLE:
        return
    try:
        from pyarrow import csv as tables
        from pyarrow import float64, parquet, string, types
    except ImportError:
        how = "pip install feel321[parquet] for Parquet too"
        warnings.warn(f"{path.name}: {rows} rows, as CSV only; {how}", stacklevel=2)
        return
    convert = tables.ConvertOptions(
        column_types=dict.fromkeys(text, string()), null_values=[""], timestamp_parsers=[]
    )
    table = tables.read_csv(path, convert_options=convert)
    for place, column in enumerate(table.schema):
        if types.is_null(column.type):  # nothing but empty cells
            empty = table.column(place).cast(float64())
            table = table.set_column(place, column.name, empty)
    table = table.replace_schema_metadata({TWIN_OF: digest_file(path)})
    with _naming(twin):
        _replace(twin, lambda file: parquet.write_table(table, file))


TWIN_OF = b"feel321.csv_sha256"
"""In the metadata of a Parquet file: the digest of the CSV that it was written from."""


def digest_file(path: Path) -> str:
    """Compute the SHA-256 of a file."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def write_bytes(path: Path, content: bytes) -> None:
    """Write a file in one step, replacing the one that is there unless it holds just that."""
    with _naming(path):
        if not (path.is_file() and path.read_bytes() == content):
            _replace(path, lambda file: file.write(content))


def replace_bytes(path: Path, content: bytes) -> None:
    """Write a file in one step, whoever else writes it; after a power cut it may be damaged."""
    unfinished = path.with_name(f".{path.name}.{uuid.uuid4().hex}.part")
    try:
        unfinished.write_bytes(content)
        unfinished.replace(path)
    finally:
        unfinished.unlink(missing_ok=True)


@contextmanager
def _naming(path: Path) -> Iterator[None]:
    """Name the file in an error: a full disk is reported without a name, most else with that of the unfinished file."""
    try:
        yield
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(path)) from error


def create_text(path: Path, text: str) -> None:
    """Write a text file where none is yet."""
    if path.exists():
        raise FileExistsError(
            f"{path}: already exists and is not overwritten; move it away or use it"
        )
    write_text(path, text)


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
def hold_lock(path: Path, *, busy: str) -> Iterator[None]:
    """Hold the lock that a file stands for, or refuse; it ends with its process, however that ends."""
    from filelock import FileLock, Timeout

    lock = FileLock(path, timeout=LOOK_S)
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


def _replace(path: Path, write: Callable[[BinaryIO], object]) -> None:
    # Beside the target, so that the replacement stays on one file system and is atomic.
    unfinished = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        with unfinished.open("wb") as file:
            write(file)
            file.flush()
            os.fsync(file.fileno())
        if path.is_file() and cmp(unfinished, path, shallow=False):
            return
        unfinished.replace(path)
    finally:
        unfinished.unlink(missing_ok=True)
    sync_folder(path.parent)
