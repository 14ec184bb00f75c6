"""What is read from outside: regular files only, no more of them than a limit, and text that is UTF-8."""

import codecs
import errno
import io
import math
import os
import re
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO, TextIO

LIMIT = "FEEL321_LARGEST_MB"
LARGEST_MB = 512  # of a file, and of its samples as float64: half an hour of three axes at 10 kHz
TEXT_SHARE = 4  # a text must be so many times smaller: while read, it takes several times its size
SMALL_BYTES = 2**22  # of settings, texts and facts beside recordings
MOST_DIGITS = 4000  # of a number in those: parsers take memory for digits
LONGEST_LINE = 2**20  # bytes in a line of a table: thousands of columns

WIDE_TEXT = {codecs.BOM_UTF32_LE: "UTF-32", codecs.BOM_UTF16_LE: "UTF-16", codecs.BOM_UTF16_BE: "UTF-16"}  # fmt: skip
KINDS = {stat.S_IFIFO: "a named pipe (fifo)", stat.S_IFSOCK: "a socket"}  # all else is a device


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


def word_fault(error: ValueError) -> str:
    """Word what is wrong with a file that does not fit its model: the first fault, where it is and what was got."""
    from pydantic import ValidationError

    if not isinstance(error, ValidationError):
        return str(error)
    first = error.errors(include_url=False)[0]
    place, got = ".".join(map(str, first["loc"])), clip(repr(first["input"]))
    return f"{place}: {first['msg']}, got {got}" if place else first["msg"]


def check_bytes(n_bytes: int, what: str, *, most: int | None = None) -> None:
    """Refuse what would take more memory than the limit, before it is taken."""
    limit = read_limit()
    most = limit if most is None else min(most, limit)
    if n_bytes > most:
        how = "cut it into shorter ones"
        if most == limit:
            how += f", or set {LIMIT}={math.ceil(n_bytes / 1e6)} in the environment if it is right"
        raise TooLargeError(
            f"{what}: {n_bytes / 1e6:,.0f} MB, at most {most / 1e6:,.0f} MB are read; {how}"
        )


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
        raise ValueError(
            f"{path.name}: must be a regular file, got {got}; copy its content into a file"
        )
    # Nor is what may have been put in its place just now.
    further = sum(getattr(os, name, 0) for name in ("O_NONBLOCK", "O_NOCTTY"))
    return open(path, "rb", opener=lambda name, flags: os.open(name, flags | further))


def read_bytes(path: Path, *, most: int | None = None) -> bytes:
    """Read a regular file whole, if it is no larger than the limit; what it gains meanwhile is left."""
    with open_regular(path) as file:
        size = os.fstat(file.fileno()).st_size
        check_bytes(size, path.name, most=most)
        return file.read(size)  # allocates as much as it is asked for


def read_text(path: Path, *, most: int | None = None) -> str:
    """Read a text in UTF-8, with or without byte-order mark; a wrong byte is named with its line."""
    return decode(read_bytes(path, most=most), path.name)


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
    text = read_text(path, most=SMALL_BYTES)
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
    while len(content) - start > LONGEST_LINE:
        piece = content[start : start + LONGEST_LINE + 1]
        end = max(piece.rfind(b"\n"), piece.rfind(b"\r"))
        if end < 0:
            line = content.count(b"\n", 0, start) + 1
            raise ValueError(
                f"line {line} is longer than {LONGEST_LINE} bytes; a table has a row per sample: is it one?"
            )
        start += end + 1
