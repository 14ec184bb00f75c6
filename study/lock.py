"""One writer at a time: a lock that ends with its process, however the process ends."""

from __future__ import annotations

import os
import sys
from contextlib import contextmanager
from typing import TYPE_CHECKING

if sys.platform == "win32":  # pragma: no cover - proven on Windows only
    import msvcrt
else:
    import fcntl

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path


@contextmanager
def hold_lock(path: Path) -> Iterator[None]:
    """Hold the lock that a file stands for, or refuse at once.

    The file itself stays: taking it away would let a third writer lock a new one beside the second's.

    Parameters
    ----------
    path : Path
        The lock file; created if missing.

    Yields
    ------
    None
        While the lock is held.

    Raises
    ------
    BlockingIOError
        If another process, or another part of this one, holds it.
    """
    descriptor = os.open(path, os.O_CREAT | os.O_RDWR, 0o644)
    try:
        try:
            _lock(descriptor)
        except OSError:
            raise BlockingIOError(
                f"{path.parent}: another session is writing here; let it finish or stop it first"
            ) from None
        yield
    finally:
        os.close(descriptor)


if sys.platform == "win32":  # pragma: no cover - proven on Windows only

    def _lock(descriptor: int) -> None:
        msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)

else:

    def _lock(descriptor: int) -> None:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
