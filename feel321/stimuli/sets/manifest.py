"""The manifest of a stimulus set: one row per stimulus, and the recipe that made it.

`manifest.csv` holds the rows; `manifest.json` the same, the recipe, the software's versions, and the unit of every
column. Both are written last, whole or not at all, so a set with a manifest is complete.
"""

from __future__ import annotations

import csv
import hashlib
import io
import json
import math
import os
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

ROLES = ("test", "reference", "anchor")

COLUMN_UNITS = {
    "stimulus_id": "name, unique in the set",
    "recording": "name",
    "reducer": "name of a reducer, 'original' for the three-axis recording, or name of an anchor",
    "level": "name of the level arm",
    "role": "test, reference or anchor",
    "file": "path relative to the manifest",
    "rate_hz": "Hz",
    "n_samples": "samples per channel",
    "duration_s": "s",
    "peak": "largest magnitude in the file, 1 = full scale",
    "rms_m_s2": "m/s^2, root mean square that the actuators are to give (of all channels together)",
    "gain": "m/s^2 played per m/s^2 recorded; per m/s^2 of an anchor that was made as strong as its recording",
    "spectral_match": "1 = identical energy spectra; conditioned recording and reduced signal, before level and rate",
    "temporal_match": "1 = perfectly correlated with every axis (as for spectral_match)",
    "clipped": "samples limited at full scale",
    "sha256": "digest of the file",
    "recording_sha256": "digest of the recording's source",
    "spectral_match_bounded": "0 to 1, 1 = identical energy spectra; deviations relative to the stronger of the two",
    "sensation_level_db": "dB over the detection threshold of the recipe, as it will be played, in its loudest 200 ms",
}


@dataclass(frozen=True, slots=True)
class Stimulus:
    """One row of the manifest; what each field means, and its unit, stands in `COLUMN_UNITS`.

    Parameters
    ----------
    stimulus_id, recording, reducer, level, role, file : str
        What it is, and where.
    rate_hz, n_samples, duration_s : float, int, float
        How long it is.
    peak, rms_m_s2, gain : float
        How strong it is.
    spectral_match, temporal_match : float
        How well it matches its recording.
    clipped : int
        How many samples were limited.
    sha256, recording_sha256 : str
        Digests of the file and of its source.
    spectral_match_bounded : float
        As the other matches; NaN in a set that an earlier version built.
    sensation_level_db : float
        How strong it is felt; NaN for silence, and in a set that an earlier version built.
    """

    stimulus_id: str
    recording: str
    reducer: str
    level: str
    role: str
    file: str
    rate_hz: float
    n_samples: int
    duration_s: float
    peak: float
    rms_m_s2: float
    gain: float
    spectral_match: float
    temporal_match: float
    clipped: int
    sha256: str
    recording_sha256: str
    spectral_match_bounded: float = math.nan
    sensation_level_db: float = math.nan


@dataclass(frozen=True, slots=True)
class StimulusSet:
    """A built set.

    Parameters
    ----------
    folder : Path
        Where it is.
    stimuli : tuple of Stimulus
        Its stimuli, in the manifest's order.
    sha256 : str
        Digest of `manifest.csv`.
    """

    folder: Path
    stimuli: tuple[Stimulus, ...]
    sha256: str


COLUMNS = tuple(field.name for field in fields(Stimulus))
FURTHER = COLUMNS[COLUMNS.index("recording_sha256") + 1 :]
"""Columns of further metrics: a set that an earlier version built may lack them, and a cell may be empty."""
_READ_AS = {
    field.name: {"float": float, "int": int, "str": str}[str(field.type)]
    for field in fields(Stimulus)
}


def write_manifest(
    folder: Path, stimuli: Sequence[Stimulus], *, details: Mapping[str, Any]
) -> StimulusSet:
    """Write `manifest.json`, then `manifest.csv`, each whole or not at all."""
    rows = [describe_row(stimulus) for stimulus in stimuli]
    text = io.StringIO(newline="")
    writer = csv.DictWriter(text, COLUMNS, lineterminator="\r\n")
    writer.writeheader()
    writer.writerows(rows)
    table = text.getvalue().encode()
    whole = {"columns": COLUMN_UNITS, "stimuli": rows, **details}
    write_bytes(
        folder / "manifest.json", (json.dumps(whole, indent=1, sort_keys=True) + "\n").encode()
    )
    write_bytes(folder / "manifest.csv", table)
    return StimulusSet(folder, tuple(stimuli), hashlib.sha256(table).hexdigest())


def describe_row(stimulus: Stimulus) -> dict[str, Any]:
    """Give a row as CSV and JSON hold it: a number that is not known is an empty cell, or null.

    Returns column -> value, or None.
    """
    row = asdict(stimulus)
    return row | {name: None for name in FURTHER if math.isnan(row[name])}


def read_stimuli(folder: str | Path) -> StimulusSet:
    """Read a built stimulus set.

    Parameters
    ----------
    folder : str or Path
        Where `build_stimuli` built it.

    Returns
    -------
    StimulusSet
        Its stimuli, in the manifest's order.

    Raises
    ------
    FileNotFoundError
        If there is no manifest.
    ValueError
        If the manifest is not one; the message names the line.
    """
    path = Path(folder) / "manifest.csv"
    if not path.is_file():
        raise FileNotFoundError(
            f"{path}: there is no manifest; build the stimulus set first (feel321 build)"
        )
    table = path.read_bytes()
    try:
        rows = list(csv.DictReader(io.StringIO(table.decode(), newline=""), strict=True))
    except (UnicodeDecodeError, csv.Error) as error:
        raise ValueError(
            f"{path}: not a CSV table in UTF-8 ({error}); build the set again"
        ) from None
    stimuli = tuple(_row(row, f"{path}, line {line}") for line, row in enumerate(rows, start=2))
    if not stimuli:
        raise ValueError(f"{path}: holds no stimulus; build the set again")
    return StimulusSet(Path(folder), stimuli, hashlib.sha256(table).hexdigest())


def write_bytes(path: Path, content: bytes) -> None:
    """Write a file whole or not at all."""
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        with part.open("wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())  # or a power cut could leave the name without the content
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)


def _row(row: dict[str, str], place: str) -> Stimulus:
    wrong = [
        name
        for name in COLUMNS
        if row.get(name) is None and not (name in FURTHER and name not in row)
    ]
    wrong += [str(name) for name in row if name not in COLUMNS]
    if wrong:
        raise ValueError(
            f"{place}: wrong or missing columns {', '.join(wrong)}; allowed are {', '.join(COLUMNS)}"
        )
    try:
        values = {
            name: _READ_AS[name](cell) for name, cell in row.items() if cell or name not in FURTHER
        }
    except ValueError as error:
        raise ValueError(f"{place}: {error}; build the set again") from None
    if Path(values["file"]).name != values["file"]:
        raise ValueError(
            f"{place}: got file {values['file']!r}, allowed is a name in the set's own folder"
        )
    return Stimulus(**values)
