"""What was last seen of a journal: how many lines, and the digest of the last of them.

The chain inside a journal cannot tell that whole lines are missing at its end; whoever kept an anchor can.
"""

from __future__ import annotations

from dataclasses import dataclass
from shlex import quote
from typing import TYPE_CHECKING

from study.session.chain import START, digest

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path


@dataclass(frozen=True, slots=True)
class Anchor:
    """What was seen of a journal.

    Parameters
    ----------
    journal : str
        Name of the file in the participant's folder.
    lines : int
        Number of whole lines.
    tip : str
        SHA-256 of the last of them; 64 zeros if there was none.
    """

    journal: str
    lines: int
    tip: str


def read_anchor(path: Path) -> Anchor:
    """Look at a journal as it is now, whether or not its chain holds.

    Parameters
    ----------
    path : Path
        The journal.

    Returns
    -------
    Anchor
        What is to be seen of it.
    """
    lines = _read_lines(path)
    return Anchor(path.name, len(lines), digest(lines[-1]) if lines else START)


def find_cut(anchor: Anchor, folder: Path) -> str:
    """Tell what is missing of a journal since it was last seen.

    Parameters
    ----------
    anchor : Anchor
        What was seen.
    folder : Path
        The participant's folder.

    Returns
    -------
    str
        One line; empty if everything that was seen is there.
    """
    path = folder / anchor.journal
    if not path.is_file():
        return f"{path}: is gone, {anchor.lines} lines of it were seen"
    lines = _read_lines(path)
    if len(lines) < anchor.lines:
        return f"{path}: ends with line {len(lines)}, {anchor.lines} lines of it were seen"
    if anchor.lines and digest(lines[anchor.lines - 1]) != anchor.tip:
        return f"{path}, line {anchor.lines}: is not the line that was seen there"
    return ""


def check_anchors(anchors: Iterable[Anchor], folder: Path) -> None:
    """Refuse to go on with journals of which less is there than was seen.

    Parameters
    ----------
    anchors : iterable of Anchor
        What was seen.
    folder : Path
        The participant's folder.

    Raises
    ------
    ValueError
        If anything is missing, naming the first of it.
    """
    for anchor in anchors:
        if cut := find_cut(anchor, folder):
            rebuild = f"feel321 ledger {quote(str(folder.parent.parent))} --rebuild"
            raise ValueError(f"{cut}; restore it from a copy, or take it as it is: {rebuild}")


def _read_lines(path: Path) -> list[bytes]:
    return path.read_bytes().split(b"\n")[:-1]
