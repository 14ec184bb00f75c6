"""What stays of a participant who withdrew: a code that is not used again, and digests of what was removed."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING

from study.files import write_text
from study.ledger.sightings import Anchor
from study.session.chain import digest
from study.session.opening import TOMBSTONE_FILE

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path
    from typing import Any

REMOVING, REMOVED = "removing", "removed"

LOCK_FILE = ".lock"
"""Held while a session runs or a participant leaves."""


@dataclass(frozen=True, slots=True)
class Tombstone:
    """What stays of a participant who withdrew.

    Parameters
    ----------
    participant : str
        The participant's code.
    number : int
        The number in the design that the participant had.
    simulated : bool
        Whether the participant was simulated.
    utc : str
        When the participant withdrew, ISO 8601.
    reason : str
        Why, if that was said.
    journals : tuple of Anchor
        How long each journal was, and the digest of its last line: proof of a copy, without its content.
    state : str
        `removing` as long as not all data are gone, then `removed`.
    """

    participant: str
    number: int
    simulated: bool
    utc: str
    reason: str
    journals: tuple[Anchor, ...]
    state: str


def write_tombstone(folder: Path, tombstone: Tombstone) -> None:
    """Write a tombstone and seal it with its digest, replacing the one that is there.

    Parameters
    ----------
    folder : Path
        The participant's folder.
    tombstone : Tombstone
        What stays.
    """
    entry = asdict(tombstone)
    sealed = entry | {"sha256": _digest(entry)}
    write_text(folder / TOMBSTONE_FILE, json.dumps(sealed, indent=1, ensure_ascii=False) + "\n")


def read_tombstone(folder: Path) -> Tombstone | None:
    """Read a tombstone.

    Parameters
    ----------
    folder : Path
        The participant's folder.

    Returns
    -------
    Tombstone or None
        None if there is none: the participant did not withdraw.

    Raises
    ------
    ValueError
        If there is something else under its name, or it was changed after it was written.
    """
    path = folder / TOMBSTONE_FILE
    if not path.exists():
        return None
    try:
        entry = json.loads(path.read_bytes())
        is_sealed = entry.pop("sha256") == _digest(entry)
        tombstone = Tombstone(**entry | {"journals": tuple(Anchor(**anchor) for anchor in entry["journals"])})
    except (AttributeError, KeyError, TypeError, ValueError, RecursionError):
        is_sealed, tombstone = False, None
    if not is_sealed:
        raise ValueError(
            f"{path}: got no tombstone, or one that was changed after it was written; restore the file from a copy"
        )
    return tombstone


def find_leftovers(folder: Path) -> list[str]:
    """Find what lies beside a tombstone: nothing of someone who withdrew may stay, or come back with a copy.

    Parameters
    ----------
    folder : Path
        A participant's folder.

    Returns
    -------
    list of str
        One line per file besides the tombstone and the lock; none if there is no tombstone.
    """
    if not (folder / TOMBSTONE_FILE).exists():
        return []
    kept = {folder / TOMBSTONE_FILE, folder / LOCK_FILE}
    files = {path for path in folder.rglob("*") if path.is_symlink() or not path.is_dir()}
    return [f"{path}: lies beside a tombstone, the participant withdrew; remove it" for path in sorted(files - kept)]


def _digest(entry: Mapping[str, Any]) -> str:
    return digest(json.dumps(entry, sort_keys=True))
