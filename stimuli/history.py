"""What an earlier build left in `manifest.json`: read to spare work, never trusted further than that."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import PurePath
from typing import TYPE_CHECKING

from stimuli.manifest import Stimulus
from stimuli.render import Measured

if TYPE_CHECKING:
    from pathlib import Path


@dataclass(frozen=True, slots=True)
class History:
    """An earlier build.

    Parameters
    ----------
    rows : dict
        Stimulus id -> row.
    keys : dict
        Stimulus id -> the key it was rendered under.
    measured : dict
        Key -> what was measured on the rendered stimulus.
    """

    rows: dict[str, Stimulus] = field(default_factory=dict)
    keys: dict[str, str] = field(default_factory=dict)
    measured: dict[str, Measured] = field(default_factory=dict)


def read_history(folder: Path) -> History:
    """Read what an earlier build left; a manifest that is missing or damaged only costs building anew.

    Parameters
    ----------
    folder : Path
        The set's folder.

    Returns
    -------
    History
        What can be used; rows that name a file outside the folder cannot.
    """
    from pydantic import TypeAdapter

    try:
        details = json.loads((folder / "manifest.json").read_bytes())
        known = [{name: cell for name, cell in row.items() if cell is not None} for row in details["stimuli"]]
        stimuli = TypeAdapter(list[Stimulus]).validate_python(known)
        keys = TypeAdapter(dict[str, str]).validate_python(details["keys"])
        measured = TypeAdapter(dict[str, Measured]).validate_python(details["measured"])
    except (OSError, ValueError, TypeError, KeyError, AttributeError, RecursionError):
        return History()
    own = {row.stimulus_id: row for row in stimuli if PurePath(row.file).name == row.file == f"{row.stimulus_id}.wav"}
    return History(own, keys, measured)
