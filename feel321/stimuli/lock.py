"""One writer at a time: a lock that ends with its process, however the process ends."""

from __future__ import annotations

from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path


@contextmanager
def hold_lock(path: Path, *, busy: str) -> Iterator[None]:
    """Hold the lock that a file stands for, or refuse at once."""
    from filelock import FileLock, Timeout

    lock = FileLock(path, timeout=0)
    try:
        lock.acquire()
    except Timeout:
        raise BlockingIOError(f"{path.parent}: {busy}") from None
    try:
        yield
    finally:
        lock.release()
