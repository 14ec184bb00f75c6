"""What every parser owes to whatever bytes it is given.

It returns a value, or raises ValueError or OSError with a message of printable lines; in less than `CPU_S` of the
processor and `MEMORY_BYTES` more than before; and it writes, removes, starts and calls nothing.
"""

from __future__ import annotations

import contextlib
import os
import resource
import signal
import sys
import traceback
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NoReturn

if TYPE_CHECKING:
    from collections.abc import Iterator

CPU_S: Final = 2.0
MEMORY_BYTES: Final = 300 * 2**20
LONGEST: Final = 4000
"""Characters of a message: a parser may name what it found, not repeat it."""

WRITES = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_APPEND
TOUCHES = frozenset({
    "os.rename", "os.remove", "os.mkdir", "os.rmdir", "os.truncate", "os.link", "os.symlink", "os.chmod", "os.system",
    "os.fork", "os.exec", "os.posix_spawn", "subprocess.Popen", "socket.connect", "socket.bind", "shutil.rmtree",
})  # fmt: skip
"""Audit events of what no parser does."""


LEDGER = "/ledger.sqlite"
"""SQLite opens its file for writing whatever it is asked."""


class Broken(AssertionError):  # noqa: N818 - the law is
    """The law is broken."""


class Hung(BaseException):
    """Too much of the processor was taken; no `except Exception` stops it."""


_watched: list[str] | None = None


def _watch(event: str, arguments: tuple[Any, ...]) -> None:
    if _watched is None:
        return
    if event in TOUCHES:
        _watched.append(f"{event} {arguments}")
    elif event == "open":
        path, _, flags = arguments
        name = str(path)
        is_ours = "__pycache__" not in name and not name.endswith(LEDGER)
        if isinstance(flags, int) and flags & WRITES and is_ours:
            _watched.append(f"open {name} for writing")


sys.addaudithook(_watch)


@contextlib.contextmanager
def _touching_nothing() -> Iterator[None]:
    global _watched  # noqa: PLW0603 - a hook cannot be taken off, only told to look away
    _watched = []
    try:
        yield
        if _watched:
            raise Broken("; ".join(_watched))
    finally:
        _watched = None


def _hang(_signal: int, _frame: object) -> NoReturn:
    raise Hung


@contextlib.contextmanager
def _in_time() -> Iterator[None]:
    before = signal.signal(signal.SIGVTALRM, _hang)
    signal.setitimer(signal.ITIMER_VIRTUAL, CPU_S)
    try:
        yield
    except Hung:
        raise Broken(f"took more than {CPU_S:g} s of the processor") from None
    finally:
        signal.setitimer(signal.ITIMER_VIRTUAL, 0)
        signal.signal(signal.SIGVTALRM, before)


@contextlib.contextmanager
def _in_space() -> Iterator[None]:
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    most = pages * resource.getpagesize() + MEMORY_BYTES
    resource.setrlimit(resource.RLIMIT_AS, (most, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))


def find_cause(error: BaseException | None) -> BaseException | None:
    """Find a lack of memory behind an error that was worded as another."""
    while error is not None and not isinstance(error, MemoryError):
        error = error.__cause__ or error.__context__
    return error


def check_refusal(
    error: BaseException, lines: int, *, typed: bool = False, bounded: bool = True
) -> None:
    """Check that an error is one of those a parser may raise, and can be printed."""
    if bounded and find_cause(error) is not None:
        raise Broken(f"asked for more than {MEMORY_BYTES >> 20} MB") from error
    if not isinstance(error, ValueError | OSError):
        where = traceback.extract_tb(error.__traceback__)[-1]
        raise Broken(
            f"{type(error).__name__}: {error} ({where.filename}:{where.lineno})"
        ) from error
    text = str(error)
    if typed and text:
        return
    found = text.split("\n")
    if not text or len(found) > lines or not all(map(str.isprintable, found)):
        raise Broken(f"a message that is not {lines} printable lines: {text!r}") from error
    if len(text) > LONGEST * lines:
        raise Broken(f"a message of {len(text)} characters: {text[:200]!r}") from error


@contextlib.contextmanager
def law(
    *, lines: int = 1, bounded: bool = True, writes: bool = False, typed: bool = False
) -> Iterator[None]:
    """Hold whatever runs inside to the law; a refusal ends it quietly. bounded: in space too. writes: it may write.

    typed: the words that are refused are those of whoever reads the refusal."""
    with warnings.catch_warnings(), contextlib.ExitStack() as limits:
        warnings.simplefilter("ignore")
        if not writes:
            limits.enter_context(_touching_nothing())
        if bounded:
            limits.enter_context(_in_space())
        limits.enter_context(_in_time())
        try:
            yield
        except Broken:
            raise
        except Exception as error:  # noqa: BLE001 - each is judged
            check_refusal(error, lines, typed=typed, bounded=bounded)
