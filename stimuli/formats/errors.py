"""Where foreign exceptions become one clear line: file name, what was got, what is allowed, what to do."""

from __future__ import annotations

from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path


@contextmanager
def file_named(path: Path) -> Iterator[None]:
    """Put the file's name before every refusal raised inside.

    Parameters
    ----------
    path : Path
        The file that is read.

    Yields
    ------
    None
        Nothing; whatever is raised inside is named.

    Raises
    ------
    ValueError
        The one raised inside, its message preceded by the name, in one line.
    OSError
        If the operating system refuses the file.
    """
    prefix = f"{path.name}: "
    try:
        yield
    except ValueError as error:
        raise ValueError(prefix + _one_line(str(error).removeprefix(prefix))) from error
    except OSError as error:
        reason = error.strerror or str(error).removeprefix(prefix)
        raise type(error)(f"{prefix}{reason}") from error


@contextmanager
def foreign_errors(what: str) -> Iterator[None]:
    """Translate whatever a library raises at a damaged file.

    Parameters
    ----------
    what : str
        What the file should have been, with its article.

    Yields
    ------
    None
        Nothing; whatever is raised inside is translated.

    Raises
    ------
    ValueError
        In place of any error raised inside, except those of the operating system.
    """
    try:
        yield
    except Exception as error:  # libraries raise anything at damaged files, even UnboundLocalError
        if isinstance(error, OSError) and error.errno:  # the system's own; libraries raise theirs without a number
            raise
        reason = (str(error).strip() or type(error).__name__).splitlines()[0]
        raise ValueError(
            f"cannot be read as {what} ({reason}); the file is damaged or of another kind, copy or export it again"
        ) from error


def _one_line(text: str) -> str:
    """Spell out what cannot be printed: a file's own names may hold line feeds and worse."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode("ascii") for c in text)
