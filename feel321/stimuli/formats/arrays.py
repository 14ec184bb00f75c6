"""Recordings in array files (NumPy, MATLAB), and the sidecar files that describe them.

A damaged element of version 5 makes scipy's compiled reader read outside its tables, which ends the whole process:
no error to translate, a study's build gone. So the elements are walked first, and scipy is given a file of nothing
but those plain arrays whose types and sizes hold. A child process that may die would guard as well, but costs a
start of Python per file.
"""

import io
import json
import math
import struct
import tomllib
import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from feel321.stimuli.formats import common, tables
from feel321.stimuli.recording import AXES, check_rate
from feel321.types import Samples

ACCELERATION_KEYS = ("acceleration", "accel", "acc", "data", "tmp")
"""Names of an array of all three axes; `tmp` is that of the LMT-69 tapping recordings."""


def read_npz(path: Path, request: common.ReadingOptions) -> common.Decoded:
    """Read an NPZ archive by the names of its arrays."""
    # Opened here, because numpy leaves it open when the archive is damaged.
    with (
        common.foreign_errors("an NPZ archive"),
        path.open("rb") as file,
        np.load(file, allow_pickle=False) as archive,
    ):
        arrays = {name: archive[name] for name in archive.files}
        if odd := [name for name, array in arrays.items() if isinstance(array, bytes)]:
            raise ValueError(f"{odd[0]} is not an array")
    return decode_arrays(arrays, request)


def read_npy(path: Path, _: common.ReadingOptions) -> common.Decoded:
    """Read a single array."""
    # Mapped first: a header that promises more than the file holds is refused before anything is allocated.
    with common.foreign_errors("an NPY array"):
        array = np.array(np.load(path, mmap_mode="r", allow_pickle=False))
    return common.Decoded(common.as_three_axes(as_numbers(array, "the array")))


def decode_arrays(
    arrays: Mapping[str, NDArray[Any]], request: common.ReadingOptions
) -> common.Decoded:
    """Find samples, rate, time and unit among named arrays."""
    columns = {name: array for name, array in arrays.items() if array.size != 1}
    place = choose_arrays(columns, request, found=tuple(arrays))
    names = tuple(columns)
    time_s, step_s = (
        (None, 0.0) if place.time is None else _read_stamps(columns, names[place.time], place)
    )
    rates = {name: array for name, array in arrays.items() if name.casefold() in common.RATE_KEYS}
    said = {name: array for name, array in arrays.items() if name.casefold() in common.UNIT_KEYS}
    units = {name: common.parse_unit(str(array.squeeze())) for name, array in said.items()}
    if place.unit:
        units[names[place.axes[0]]] = place.unit
    return common.Decoded(
        _stack(columns, [names[i] for i in place.axes]),
        common.one_value(
            units,
            argument="unit",
            requested=None if request.unit is None else common.parse_unit(request.unit),
        ),
        common.one_value(
            {name: _as_scalar(array, "the rate") for name, array in rates.items()},
            argument="rate_hz",
            requested=request.rate_hz,
        ),
        time_s=time_s,
        time_step_s=step_s,
    )


def choose_arrays(
    columns: Mapping[str, NDArray[Any]], request: common.ReadingOptions, *, found: Sequence[str]
) -> tables.Columns:
    """Choose the arrays of samples and time: as asked for, else by their names."""
    labels = tuple(columns)
    if request.columns is not None:
        return tables.pick_columns(
            request.columns, labels=labels, n_columns=len(labels), whole=True
        )
    bare = [common.split_unit(label, common.ACCELERATION_SPELLINGS)[0] for label in labels]
    wholes = [i for i, name in enumerate(bare) if name.casefold() in ACCELERATION_KEYS]
    axes = {
        match[1].lower(): i for i, name in enumerate(bare) if (match := tables.AXIS.fullmatch(name))
    }
    candidates = [*wholes, *(axes.values() if len(axes) == AXES else ())]
    if wholes and len(candidates) > 1:
        several = ", ".join(labels[i] for i in candidates)
        raise ValueError(
            f"several arrays may be the acceleration ({several}); "
            f"say which, e.g. columns=({labels[wholes[0]]!r},) or columns=(x, y, z)"
        )
    if not wholes and not axes:
        named = ", ".join(found) or "nothing"
        raise ValueError(
            f"an array must be named 'acceleration' (3, n), or three 'x', 'y' and 'z', got {named}; "
            "or say columns=(name,)"
        )
    return (
        tables.add_units(labels, axes=(wholes[0],), time=tables.find_time(labels))
        if wholes
        else tables.find_columns(labels)
    )


def as_numbers(array: NDArray[Any], what: str) -> Samples:
    """Convert real numbers to float64; refuse texts, objects and complex numbers."""
    if array.dtype.kind not in "fiu":
        raise ValueError(f"{what} must be real numbers, got values of type {array.dtype}")
    # What is not finite is refused where its place is known.
    with np.errstate(over="ignore", invalid="ignore"):
        return array.astype(np.float64)


def _stack(columns: Mapping[str, NDArray[Any]], names: Sequence[str]) -> Samples:
    if len(names) == 1:
        return common.as_three_axes(as_numbers(columns[names[0]], repr(names[0])))
    return common.stack_axes({
        axis: _vector(columns[name], name) for axis, name in zip("xyz", names, strict=True)
    })


def _vector(array: NDArray[Any], name: str) -> Samples:
    if max(array.shape) != array.size:  # MATLAB knows no vectors, only rows and columns
        raise ValueError(f"{name!r} must have one value per sample, got shape {array.shape}")
    return as_numbers(array.ravel(), repr(name))


def _read_stamps(
    columns: Mapping[str, NDArray[Any]], name: str, place: tables.Columns
) -> tuple[Samples, float]:
    stamps, second = _vector(columns[name], name), place.time_unit_s or 1.0
    coarse = columns[name].dtype.type if columns[name].dtype.kind == "f" else np.float64
    return stamps * second, float(np.spacing(coarse(np.abs(stamps).max(initial=0.0)))) * second


def _as_scalar(array: NDArray[Any], what: str) -> float:
    if np.size(array) != 1:
        raise ValueError(f"{what} must be one number, got {np.size(array)} values")
    return float(as_numbers(np.asarray(array), what).item())


HEADER_BYTES = 128
BYTE_ORDERS = {b"IM": "<", b"MI": ">"}
VERSION = 0x0100
"""Where a file's elements begin, and what stands at the end of its header."""

ITEM_BYTES = {1: 1, 2: 1, 3: 2, 4: 2, 5: 4, 6: 4, 7: 4, 9: 8, 12: 8, 13: 8}
TEXT_TYPES = {1: 1, 2: 1, 4: 2, 16: 1, 17: 2, 18: 4}
"""Types of elements, each with its bytes per value; at least so many per letter where UTF-8 and UTF-16 vary."""

INT8, INT32, UINT32, MATRIX, COMPRESSED = 1, 5, 6, 14, 15
CHAR_CLASS, NUMBER_CLASSES = 4, range(6, 16)
COMPLEX_FLAG = 0x0800
"""Types of elements, and classes and a flag of arrays, by their numbers in the MAT-file format."""

LARGEST_BYTES = 2**30
"""So much an array may inflate to: more than an hour of three axes at 10 kHz."""


def read_mat(path: Path, request: common.ReadingOptions) -> common.Decoded:
    """Read a MATLAB file of version 4 to 7 by the names of its variables."""
    from scipy.io import loadmat

    content = path.read_bytes()
    with common.foreign_errors("a MATLAB file"):
        if 0 not in content[:4]:  # the mark of version 4, which scipy reads in Python
            content = keep_plain_arrays(content)
        variables = loadmat(io.BytesIO(content))  # type: ignore[arg-type]  # the stubs leave out open files
    return decode_arrays(
        {name: np.asarray(value) for name, value in variables.items() if name[:2] != "__"}, request
    )


def keep_plain_arrays(content: bytes) -> bytes:
    """Return a version 5 file of the same arrays of numbers and texts, inflated and proved whole."""
    order = BYTE_ORDERS.get(content[126:HEADER_BYTES])
    if order is None or struct.unpack_from(f"{order}H", content, 124) != (VERSION,):
        raise ValueError("its header names no version 5")
    kept, names = [content[:HEADER_BYTES]], set[bytes]()
    for matrix in _matrices(content, order):
        name, plain = _check_matrix(matrix, order)
        if name in names:
            raise ValueError(f"two variables are called {name.decode('latin-1')}")
        names.add(name)
        if plain and name:
            kept.append(struct.pack(f"{order}II", MATRIX, len(matrix)) + matrix)
    return b"".join(kept)


def _matrices(content: bytes, order: str) -> Iterator[bytes]:
    at = HEADER_BYTES
    while at < len(content):
        kind, body, at = _element(content, at, order)
        if kind == COMPRESSED:
            kind, body, _ = _element(_inflate(body), 0, order)
        if kind != MATRIX:
            raise ValueError(f"an element of type {kind} where a variable should be")
        yield body


def _inflate(body: bytes) -> bytes:
    stream = zlib.decompressobj()
    inflated = stream.decompress(body, LARGEST_BYTES)
    if not stream.eof:
        raise ValueError(f"a compressed variable that is cut short or above {LARGEST_BYTES} bytes")
    return inflated


def _element(content: bytes, at: int, order: str) -> tuple[int, bytes, int]:
    """Return the type and the body of an element, and where the next one may begin."""
    kind, size = struct.unpack_from(f"{order}II", content, at)
    start = at + 8
    if kind > 0xFFFF:  # noqa: PLR2004 - a small element: size and type share four bytes, the body has the others
        kind, size, start = kind & 0xFFFF, kind >> 16, at + 4
        if size > 4:  # noqa: PLR2004 - these others
            raise ValueError(f"a small element of {size} bytes")
    if start + size > len(content):
        raise ValueError(
            f"an element of {size} bytes where {max(len(content) - start, 0)} are left"
        )
    return kind, content[start : start + size], start + size


def _check_matrix(body: bytes, order: str) -> tuple[bytes, bool]:
    """Return a variable's name, and whether it is a plain array, of which every element is checked."""
    flags, at = _part(body, 0, order, kind=UINT32)
    sizes, at = _part(body, at, order, kind=INT32)
    name, at = _part(body, at, order, kind=INT8)
    if len(flags) != 8 or len(sizes) % 4 or len(sizes) < 8:  # noqa: PLR2004 - two words; two sizes or more
        raise ValueError("an array whose flags or sizes are damaged")
    word = struct.unpack_from(f"{order}I", flags)[0]
    number = word & 0xFF
    if number != CHAR_CLASS and number not in NUMBER_CLASSES:
        return name, False
    shape = struct.unpack(f"{order}{len(sizes) // 4}i", sizes)
    for _ in range(2 if word & COMPLEX_FLAG else 1):
        kind, values, end = _element(body, at, order)
        at = _aligned(end)
        _check_values(values, kind, shape, is_text=number == CHAR_CLASS)
    return name, True


def _part(body: bytes, at: int, order: str, *, kind: int) -> tuple[bytes, int]:
    found, part, end = _element(body, at, order)
    if found != kind:
        raise ValueError(f"an element of type {found} where type {kind} should be")
    return part, _aligned(end)


def _aligned(end: int) -> int:
    return end + -end % 8


def _check_values(values: bytes, kind: int, shape: tuple[int, ...], *, is_text: bool) -> None:
    count = math.prod(shape)
    size = (TEXT_TYPES if is_text else ITEM_BYTES).get(kind)
    if size is None:
        raise ValueError(f"values of type {kind} in an array of {'text' if is_text else 'numbers'}")
    fits = len(values) >= count * size if is_text else len(values) == count * size
    if min(shape) < 0 or not fits:
        raise ValueError(f"{len(values)} bytes of values for the shape {shape}")


KEYS = ("unit", "rate_hz", "axes", "full_scale", *common.UNIT_KEYS, *common.RATE_KEYS)
ALLOWED = ", ".join(dict.fromkeys(KEYS))
"""Every entry that is read. Others are refused: a misspelt unit is worth a factor of 9.8."""


@dataclass(frozen=True, slots=True)
class Sidecar:
    """Facts that a WAV header cannot hold, in ``NAME.json`` or ``NAME.toml`` beside ``NAME.wav``."""

    path: Path | None = None
    unit: str | None = None
    rate_hz: float | None = None
    axes: Sequence[str] | None = None
    full_scale: float | None = None


def read_sidecar(path: Path) -> Sidecar:
    """Read the JSON or TOML file of the same name beside a file."""
    beside = [path.with_suffix(suffix) for suffix in (".json", ".toml")]
    present = [sidecar for sidecar in beside if sidecar.is_file()]
    if not present:
        return Sidecar()
    if len(present) > 1:
        names = " and ".join(sidecar.name for sidecar in present)
        raise ValueError(f"there must be one sidecar, got {names}; remove one of them")
    try:
        return _parse_sidecar(present[0])
    except ValueError as error:
        raise ValueError(f"sidecar {present[0].name}: {error}") from None


def _parse_sidecar(path: Path) -> Sidecar:
    load = json.loads if path.suffix == ".json" else tomllib.loads
    content = path.read_bytes()
    with common.foreign_errors(path.suffix[1:].upper()):
        entries: Any = load(content.decode("utf-8-sig"))
    if not isinstance(entries, dict):
        raise ValueError(f"must be a table with {ALLOWED}, got a {type(entries).__name__}")  # noqa: TRY004 - a file's fault, not a caller's
    if unknown := [key for key in entries if key not in KEYS]:
        raise ValueError(
            f"entries must be {ALLOWED}, got {', '.join(map(repr, unknown))}; correct or remove it"
        )
    unit, rate_hz = (_find_entry(entries, keys) for keys in (common.UNIT_KEYS, common.RATE_KEYS))
    full_scale = entries.get("full_scale")
    return Sidecar(
        path,
        None if unit is None else common.parse_unit(unit),
        None if rate_hz is None else check_rate(rate_hz),
        _parse_axes(entries.get("axes")),
        None if full_scale is None else check_rate(full_scale, "full_scale", ""),
    )


def _find_entry(entries: Mapping[str, Any], keys: Sequence[str]) -> Any:  # noqa: ANN401 - whatever stands there
    """Return the entry under one of several spellings."""
    present = [key for key in keys if entries.get(key) is not None]
    if len(present) > 1:
        raise ValueError(f"{' and '.join(present)} mean the same; remove all but one")
    return entries[present[0]] if present else None


def _parse_axes(axes: Any) -> tuple[str, ...] | None:  # noqa: ANN401 - whatever a JSON file holds
    if axes is None:
        return None
    names = tuple(str(axis).lower() for axis in axes) if isinstance(axes, list | str) else ()
    if sorted(name for name in names if name in {"x", "y", "z"}) != ["x", "y", "z"]:
        raise ValueError(f'axes must be a list with "x", "y" and "z" once each, got {axes!r}')
    return names
