"""Recordings in array files (NumPy, MATLAB).

What a file promises is compared with the limit before it is read, and with what it holds. A MATLAB file is met in a
child process (`matlab.py`), whose memory and time are limited.
"""

import io
import math
import os
import subprocess
import sys
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from feel321 import intake
from feel321.stimuli.formats import common
from feel321.types import Samples

ACCELERATION_KEYS = ("acceleration", "accel", "acc", "data", "tmp")
"""Names of an array of all three axes; `tmp` is that of the LMT-69 tapping recordings."""

MOST_MEMBERS = 1000
"""So many files may an archive list."""

FACT_BYTES = 10_000
"""An array of one value, such as a rate, takes no more, its header included."""

CHILD_S = 300.0
"""So long may a MATLAB file take to be read."""

FORMAT: Any = np.lib.format


def read_npz(path: Path, request: common.ReadingOptions) -> common.Decoded:
    """Read an NPZ archive by the names of its arrays, of which only those are read that are wanted."""
    content = intake.read_bytes(path)
    with common.foreign_errors("an NPZ archive"):
        if content.count(b"PK\x01\x02") > MOST_MEMBERS:
            raise ValueError(f"its directory lists more than {MOST_MEMBERS} files")
        archive = zipfile.ZipFile(io.BytesIO(content))
        entries = {entry.filename.removesuffix(".npy"): entry for entry in archive.infolist()}
        if len(entries) < len(archive.infolist()):
            raise ValueError("several files have one name")
        shapes = {
            name: _read_shape(archive.open(one), one.file_size)
            for name, one in entries.items()
            if one.filename != name
        }
    columns = [name for name, shape in shapes.items() if math.prod(shape) != 1]
    place = _choose(columns, request, found=tuple(shapes))
    used = [columns[i] for i in (*place.axes, *([] if place.time is None else [place.time]))]
    facts = {*common.RATE_KEYS, *common.UNIT_KEYS}
    used += [
        name
        for name in shapes
        if name.casefold() in facts and entries[name].file_size <= FACT_BYTES and name not in used
    ]
    intake.check_bytes(sum(entries[name].file_size for name in used), "its arrays")
    with common.foreign_errors("an NPZ archive"):
        arrays = {}
        for name in used:
            with archive.open(entries[name]) as stream:
                arrays[name] = FORMAT.read_array(stream, allow_pickle=False)
                stream.read(1)  # at the end the checksum is compared
    return _decode(arrays, request)


def _read_shape(stream: IO[bytes], n_bytes: int) -> tuple[int, ...]:
    """Read an array's shape from its header, which is short; what it promises must be what there is."""
    version, _ = FORMAT.read_magic(stream)
    read = FORMAT.read_array_header_1_0 if version == 1 else FORMAT.read_array_header_2_0
    shape, _, dtype = read(stream)
    if dtype.hasobject:
        raise ValueError("it holds Python objects, which are never loaded")
    promised, present = math.prod(shape) * dtype.itemsize, n_bytes - stream.tell()
    if promised != present:
        raise ValueError(f"its header promises {promised} bytes of values, there are {present}")
    return tuple(shape)


def read_npy(path: Path, _: common.ReadingOptions) -> common.Decoded:
    """Read a single array."""
    content = intake.read_bytes(path)
    with common.foreign_errors("an NPY array"):
        _read_shape(io.BytesIO(content), len(content))
        array = np.load(io.BytesIO(content), allow_pickle=False)
    return common.Decoded(common.as_three_axes(_as_numbers(array, "the array")))


def read_mat(path: Path, request: common.ReadingOptions) -> common.Decoded:
    """Read a MATLAB file of version 4 to 7 by the names of its variables."""
    with intake.open_regular(path):
        limit = intake.read_limit()
    intake.check_bytes(path.stat().st_size, path.name)
    child = str(Path(__file__).with_name("matlab.py"))
    words = [sys.executable, "-P", child, os.path.abspath(path), str(limit)]  # noqa: PTH100 - links stay as they are
    one_thread = os.environ | {"OPENBLAS_NUM_THREADS": "1"}  # each maps memory of its own
    with common.foreign_errors("a MATLAB file"):
        try:
            done = subprocess.run(words, capture_output=True, timeout=CHILD_S, check=False, env=one_thread)  # noqa: S603 - our own program  # fmt: skip
        except subprocess.TimeoutExpired:
            raise ValueError(f"it takes longer than {CHILD_S:g} s") from None
        if done.returncode:
            said = done.stderr.decode(errors="replace").strip().rpartition("\n")[2]
            if said.startswith("MemoryError"):
                raise intake.TooLargeError(
                    f"its variables take more than {limit / 1e6:,.0f} MB; keep the recording alone, or set a larger "
                    f"{intake.LIMIT} in the environment"
                )
            raise ValueError(intake.clip(said, 200) or "it ends the program that reads it")
        with np.load(io.BytesIO(done.stdout), allow_pickle=False) as archive:
            arrays = dict(archive)
    return _decode(arrays, request)


def _decode(arrays: Mapping[str, NDArray[Any]], request: common.ReadingOptions) -> common.Decoded:
    """Find samples, rate, time and unit among named arrays."""
    columns = {name: array for name, array in arrays.items() if array.size != 1}
    place = _choose([*columns], request, found=tuple(arrays))
    names = tuple(columns)
    axes = [names[i] for i in place.axes]
    if len(axes) == 1:
        samples = common.as_three_axes(_as_numbers(columns[axes[0]], repr(axes[0])))
    else:
        vectors = {axis: _vector(columns, name) for axis, name in zip("xyz", axes, strict=True)}
        samples = common.stack_axes(vectors)
    time_s, step_s = None, 0.0
    if place.time is not None:
        name, second = names[place.time], place.time_unit_s or 1.0
        stamps = _vector(columns, name)
        coarse = columns[name].dtype.type if columns[name].dtype.kind == "f" else np.float64
        time_s = stamps * second
        step_s = float(np.spacing(coarse(np.abs(stamps).max(initial=0.0)))) * second
    rates, units = {}, {}
    for name, array in arrays.items():
        if name.casefold() in common.RATE_KEYS:
            if array.size != 1:
                raise ValueError(f"the rate must be one number, got {array.size} values")
            rates[name] = float(_as_numbers(array, "the rate").item())
        elif name.casefold() in common.UNIT_KEYS:
            units[name] = common.parse_unit(str(array.squeeze()))
    if place.unit:
        units[axes[0]] = place.unit
    wanted = None if request.unit is None else common.parse_unit(request.unit)
    return common.Decoded(
        samples,
        common.one_value(units, argument="unit", requested=wanted),
        common.one_value(rates, argument="rate_hz", requested=request.rate_hz),
        time_s=time_s,
        time_step_s=step_s,
    )


def _choose(
    labels: Sequence[str], request: common.ReadingOptions, *, found: Sequence[str]
) -> common.Columns:
    """Choose the arrays of samples and time: as asked for, else by their names."""
    if request.columns is not None:
        return common.pick_columns(
            request.columns, labels=labels, n_columns=len(labels), whole=True
        )
    bare = [common.split_unit(label, common.ACCELERATION_SPELLINGS)[0] for label in labels]
    if not any(common.AXIS.fullmatch(name) or name.casefold() in ACCELERATION_KEYS for name in bare):  # fmt: skip
        named = ", ".join(found) or "nothing"
        raise ValueError(
            f"an array must be named 'acceleration' (3, n), or three 'x', 'y' and 'z', got {named}; "
            "or say columns=(name,)"
        )
    return common.find_columns(labels, wholes=ACCELERATION_KEYS)


def _vector(columns: Mapping[str, NDArray[Any]], name: str) -> Samples:
    array = columns[name]
    if max(array.shape) != array.size:  # MATLAB knows no vectors, only rows and columns
        raise ValueError(f"{name!r} must have one value per sample, got shape {array.shape}")
    return _as_numbers(array.ravel(), repr(name))


def _as_numbers(array: NDArray[Any], what: str) -> Samples:
    """Convert real numbers to float64; refuse texts, objects and complex numbers."""
    if array.dtype.kind not in "fiu":
        raise ValueError(f"{what} must be real numbers, got values of type {array.dtype}")
    intake.check_bytes(8 * array.size, what)
    # What is not finite is refused where its place is known.
    with np.errstate(over="ignore", invalid="ignore"):
        return array.astype(np.float64)
