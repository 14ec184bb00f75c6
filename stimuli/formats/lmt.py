"""LMT-108 recordings (TU München): one text file per axis, one value per line, 10 kHz."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from stimuli.formats.decoded import Decoded, already_reduced, stack_axes
from stimuli.formats.text import lay_out, read_numbers, read_text

if TYPE_CHECKING:
    from pathlib import Path

    import numpy as np
    from numpy.typing import NDArray

    from stimuli.formats.decoded import Request

NAME = re.compile(r"(.+_(?:Movement|Tapping))_([XYZ])_((?:train|test)\d+)", re.IGNORECASE)
REDUCED_FOLDER = "accelscansdft321"
RATE_HZ = 10000.0
RATE_NOTE = "LMT-108 files name no rate: taken as the documented 10000 Hz (rate_hz=... says otherwise)"


def is_lmt(path: Path) -> bool:
    """Tell from the path whether a file belongs to the LMT-108 set.

    Parameters
    ----------
    path : Path
        A text file.

    Returns
    -------
    bool
        True for an axis of a triple, and for a file of the folder of reduced signals.
    """
    return path.suffix.lower() == ".txt" and bool(NAME.fullmatch(path.stem) or _is_reduced(path))


def read_lmt(path: Path, request: Request) -> Decoded:
    """Read one axis of a triple and its two sisters beside it.

    Parameters
    ----------
    path : Path
        Any of the three files.
    request : Request
        The rate, where it is not the documented 10 kHz.

    Returns
    -------
    Decoded
        The three axes.

    Raises
    ------
    ValueError
        If the file is already reduced, a sister is missing, or the lengths differ.
    """
    match = NAME.fullmatch(path.stem)
    if match is None or _is_reduced(path):
        raise already_reduced("a file of the folder AccelScansDFT321")
    head, axis, tail = match.groups()
    letters = "XYZ" if axis.isupper() else "xyz"
    sisters = {letter.lower(): path.with_name(f"{head}_{letter}_{tail}{path.suffix}") for letter in letters}
    if missing := [sister.name for sister in sisters.values() if not sister.is_file()]:
        raise ValueError(f"got no {' and no '.join(missing)} beside it, allowed is one file per axis x, y, z")
    known = request.rate_hz is not None
    return Decoded(
        stack_axes({axis: _read_axis(sister) for axis, sister in sisters.items()}),
        rate_hz=None if known else RATE_HZ,
        notes=() if known else (RATE_NOTE,),
        sources=tuple(sisters.values()),
        name=f"{head}_{tail}",
    )


def _is_reduced(path: Path) -> bool:
    return any(part.lower() == REDUCED_FOLDER for part in path.absolute().parts[:-1])


def _read_axis(path: Path) -> NDArray[np.float64]:
    table = lay_out(read_text(path))
    if table.n_columns != 1:
        raise ValueError(f"got {table.n_columns} columns in {path.name}, allowed is one value per line")
    return read_numbers(table, (0,)).ravel()
