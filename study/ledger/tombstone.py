"""What stays of a participant who withdrew: a code that is not used again, and digests of what was removed."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING

from study.files import write_text
from study.ledger.sightings import Anchor
from study.session.opening import TOMBSTONE_FILE

if TYPE_CHECKING:
    from pathlib import Path

REMOVING, REMOVED = "removing", "removed"


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
    """Write a tombstone, replacing the one that is there.

    Parameters
    ----------
    folder : Path
        The participant's folder.
    tombstone : Tombstone
        What stays.
    """
    write_text(folder / TOMBSTONE_FILE, json.dumps(asdict(tombstone), indent=1, ensure_ascii=False) + "\n")


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
        If there is something else under its name.
    """
    path = folder / TOMBSTONE_FILE
    if not path.exists():
        return None
    try:
        entry = json.loads(path.read_bytes())
        return Tombstone(**entry | {"journals": tuple(Anchor(**anchor) for anchor in entry["journals"])})
    except (KeyError, TypeError, ValueError):
        raise ValueError(f"{path}: got no tombstone, or a damaged one; restore the file from a copy") from None
