"""One door for every format: detect, decode, settle unit and sampling, inspect, keep the digest."""

from __future__ import annotations

import hashlib
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from stimuli.formats.arrays import read_npy, read_npz
from stimuli.formats.decoded import Decoded, Request
from stimuli.formats.detect import detect_format
from stimuli.formats.errors import file_named
from stimuli.formats.hatt import read_hatt
from stimuli.formats.ide import read_ide
from stimuli.formats.inspect import inspect_samples
from stimuli.formats.lmt import read_lmt
from stimuli.formats.matlab import read_mat
from stimuli.formats.sampling import settle_sampling
from stimuli.formats.table import read_table
from stimuli.formats.units import settle_unit
from stimuli.formats.wav import read_wav_recording
from stimuli.recording import UNITS, Recording, check_finite

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence

READERS: Mapping[str, Callable[[Path, Request], Decoded]] = {
    "wav": read_wav_recording,
    "table": read_table,
    "npz": read_npz,
    "npy": read_npy,
    "mat": read_mat,
    "hatt": read_hatt,
    "lmt": read_lmt,
    "ide": read_ide,
}
"""Format name -> reader, the only list of formats."""


def read_recording(
    path: str | Path,
    *,
    rate_hz: float | None = None,
    unit: str | None = None,
    columns: Sequence[str | int] | None = None,
    full_scale: float | None = None,
    resample: bool = False,
) -> Recording:
    """Read a three-axis recording of any known format.

    Parameters
    ----------
    path : str or Path
        WAV, CSV, TSV, TXT, NPZ, NPY, MAT, HaTT XML, any axis of an LMT-108 triple, or enDAQ IDE. The content
        decides first, the suffix second.
    rate_hz : float, optional
        Sampling rate in Hz, where the file does not say; must agree within 1 % where it does.
    unit : {"m/s^2", "g", "mg"}, optional
        Unit of the samples, where the file does not say; must agree where it does.
    columns : sequence of str or int, optional
        (time, x, y, z) or (x, y, z) of a table, by name or by number from 0. Of an NPZ or MAT file also
        (time, acceleration) or (acceleration,).
    full_scale : float, optional
        What full scale of an integer WAV means, in the unit.
    resample : bool
        Make irregular sampling regular, instead of refusing it.

    Returns
    -------
    Recording
        Acceleration in m/s², its rate, and in `warnings` whatever was assumed, done or noticed.

    Raises
    ------
    ValueError
        If the file cannot be read as a three-axis recording; the message says what was got, what is
        allowed and what to do.
    OSError
        If there is no such file.
    """
    source = Path(path)
    request = Request(rate_hz, unit, columns, full_scale, resample)
    with file_named(source):
        decoded = _decode(source, request)
        unit_found, unit_notes = settle_unit(decoded.unit, unit)
        with np.errstate(over="ignore", invalid="ignore"):  # what is not finite is refused in the next line
            acceleration = decoded.acceleration * UNITS[unit_found]
        check_finite(acceleration, "acceleration")
        sampled = settle_sampling(replace(decoded, acceleration=acceleration), request)
        return Recording(
            sampled.acceleration,
            sampled.rate_hz,
            name=decoded.name or source.stem,
            warnings=(
                *unit_notes,
                *decoded.notes,
                *sampled.notes,
                *inspect_samples(acceleration, sampled.rate_hz),
            ),
            sha256=_digest(decoded.sources or (source,)),
        )


def _decode(path: Path, request: Request) -> Decoded:
    if path.is_dir():
        raise IsADirectoryError("got a folder, allowed is one recording file; name a file in it")
    if not path.exists():
        raise FileNotFoundError(f"got no such file in {path.parent}; check the name and the folder")
    kind = detect_format(path)
    if request.columns is not None and kind not in {"table", "npz", "mat"}:
        raise ValueError(f"got columns for a {kind} file, allowed is columns for tables, NPZ and MAT; leave it out")
    if request.full_scale is not None and kind != "wav":
        raise ValueError(f"got full_scale for a {kind} file, allowed is only for integer WAV; leave it out")
    return READERS[kind](path, request)


def _digest(paths: Iterable[Path]) -> str:
    digest = hashlib.sha256()
    for path in paths:
        digest.update(path.read_bytes())
    return digest.hexdigest()
