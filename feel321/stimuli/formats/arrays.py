"""Recordings in array files (NumPy, MATLAB), and the sidecar files that describe them.

A damaged element of version 5 makes scipy's compiled reader read outside its tables, which ends the whole process:
no error to translate, a study's build gone. So the elements are walked first, and scipy is given a file of nothing
but those plain arrays whose types and sizes hold. A child process that may die would guard as well, but costs a
start of Python per file.
"""

import io
import json
import math
import os
import re
import struct
import tomllib
import zipfile
import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from feel321 import intake
from feel321.stimuli.formats import common, tables
from feel321.stimuli.recording import AXES, check_rate
from feel321.types import Samples

ACCELERATION_KEYS = ("acceleration", "accel", "acc", "data", "tmp")
"""Names of an array of all three axes; `tmp` is that of the LMT-69 tapping recordings."""


@dataclass(frozen=True, slots=True)
class Head:
    """What an array's header promises."""

    shape: tuple[int, ...]
    dtype: np.dtype[Any]

    @property
    def size(self) -> int:
        """Number of values."""
        return math.prod(self.shape)

    @property
    def n_bytes(self) -> int:
        """Bytes of the values in the file."""
        return self.size * self.dtype.itemsize


def read_npz(path: Path, request: common.ReadingOptions) -> common.Decoded:
    """Read an NPZ archive by the names of its arrays: their headers first, then those arrays that are wanted."""
    with intake.open_regular(path) as file:
        intake.check_bytes(path.stat().st_size, path.name)
        with common.foreign_errors("an NPZ archive"):
            check_directory(file)
            with zipfile.ZipFile(file) as archive:
                heads = {name: _peek(archive, name) for name in list_members(archive)}
        wanted = choose_wanted(heads, request)
        with common.foreign_errors("an NPZ archive"), zipfile.ZipFile(file) as archive:
            arrays = {name: _extract(archive, name) for name in wanted}
    return decode_arrays(arrays, request)


FORMAT: Any = np.lib.format


DIRECTORY = struct.Struct("<4s4H2IH")
MOST_MEMBERS = 1000
"""The end of an archive's directory, and as many files as it may list."""


def check_directory(file: BinaryIO) -> None:
    """Refuse a directory of more files than any recording has, before it is read."""
    size = file.seek(0, os.SEEK_END)
    file.seek(max(0, size - DIRECTORY.size - 2**16))
    tail = file.read()
    at = tail.rfind(b"PK\x05\x06")
    if at < 0 or at + DIRECTORY.size > len(tail):
        raise ValueError("it has no directory")
    _, _, _, _, n_members, n_bytes, _, _ = DIRECTORY.unpack_from(tail, at)
    is_larger = tail[max(0, at - 20) : at].startswith(
        b"PK\x06\x07"
    )  # which says so in another place
    if is_larger or n_members > MOST_MEMBERS or n_bytes > 2**20:
        raise ValueError(f"its directory lists more than {MOST_MEMBERS} files")
    file.seek(0)


def list_members(archive: zipfile.ZipFile) -> list[str]:
    """List the names of the arrays; two of one name are refused, and names of places."""
    names = [entry.filename for entry in archive.infolist()]
    if doubled := {name for name in names if names.count(name) > 1}:
        raise ValueError(f"several files are called {intake.clip(min(doubled))!r}")
    if paths := [name for name in names if re.search(r"[/\\:]|^\.\.", name)]:
        raise ValueError(f"a file's name is a path, {intake.clip(paths[0])!r}")
    return [name.removesuffix(".npy") for name in names if name.endswith(".npy")]


def read_head(stream: IO[bytes]) -> Head:
    """Read an array's header, which is short; only numbers and texts are arrays here."""
    major, _ = FORMAT.read_magic(stream)
    place = stream.tell()
    length = int.from_bytes(stream.read(2 if major == 1 else 4), "little")
    if major not in {1, 2} or length > LONGEST_HEAD:
        raise ValueError(f"a header of version {major} and {length} bytes")
    stream.seek(place)
    read = FORMAT.read_array_header_1_0 if major == 1 else FORMAT.read_array_header_2_0
    shape, _, dtype = read(stream)
    if dtype.hasobject:
        raise ValueError("it holds Python objects, which are never loaded")
    return Head(shape, dtype)


LONGEST_HEAD = 10_000


def _peek(archive: zipfile.ZipFile, name: str) -> Head:
    with archive.open(f"{name}.npy") as stream:
        head, begun = read_head(stream), stream.tell()
    promised = archive.getinfo(f"{name}.npy").file_size - begun
    if head.n_bytes != promised:
        raise ValueError(
            f"{name}: its header promises {head.n_bytes} bytes, the archive {promised}"
        )
    return head


def choose_wanted(heads: Mapping[str, Head], request: common.ReadingOptions) -> list[str]:
    """Choose what is read of an archive, by name and size alone: samples, time, and single values."""
    columns = {name: head for name, head in heads.items() if head.size != 1}
    place = choose_arrays(columns, request, found=tuple(heads))
    names = tuple(columns)
    wanted = [names[i] for i in (*place.axes, *([] if place.time is None else [place.time]))]
    promised = max(heads[name].size for name in wanted)
    intake.check_samples(promised, len(wanted))
    intake.check_bytes(sum(heads[name].n_bytes for name in wanted), "its arrays")
    return [name for name, head in heads.items() if name in wanted or _is_fact(name, head)]


def _is_fact(name: str, head: Head) -> bool:
    is_asked = name.casefold() in {*common.RATE_KEYS, *common.UNIT_KEYS}
    return is_asked and head.n_bytes <= LONGEST_HEAD


def _extract(archive: zipfile.ZipFile, name: str) -> NDArray[Any]:
    with archive.open(f"{name}.npy") as stream:
        array: NDArray[Any] = FORMAT.read_array(stream, allow_pickle=False)
        stream.read(1)  # at the end the checksum is compared
    return array


def read_npy(path: Path, _: common.ReadingOptions) -> common.Decoded:
    """Read a single array."""
    with intake.open_regular(path) as file:
        intake.check_bytes(path.stat().st_size, path.name)
        with common.foreign_errors("an NPY array"):
            head = read_head(file)
            # A header that promises more than the file holds is refused before anything is allocated.
            if head.n_bytes != path.stat().st_size - file.tell():
                raise ValueError(f"its header promises {head.n_bytes} bytes of values")
    intake.check_samples(head.size, 1)
    array = np.load(path, mmap_mode="r", allow_pickle=False)
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
            {name: _read_rate(array) for name, array in rates.items()},
            argument="rate_hz",
            requested=request.rate_hz,
        ),
        time_s=time_s,
        time_step_s=step_s,
    )


def choose_arrays(
    columns: Mapping[str, object], request: common.ReadingOptions, *, found: Sequence[str]
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
    intake.check_bytes(8 * array.size, what)
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


def _read_rate(array: NDArray[Any]) -> float:
    if np.size(array) != 1:
        raise ValueError(f"the rate must be one number, got {np.size(array)} values")
    return float(as_numbers(np.asarray(array), "the rate").item())


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


def read_mat(path: Path, request: common.ReadingOptions) -> common.Decoded:
    """Read a MATLAB file of version 4 to 7 by the names of its variables."""
    from scipy.io import loadmat

    content = intake.read_bytes(path)
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
    kept, names, inflated = [content[:HEADER_BYTES]], set[bytes](), 0
    for matrix in _matrices(content, order):
        inflated += len(matrix)
        intake.check_bytes(inflated, "its variables")
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
    inflated = stream.decompress(body, limit := intake.read_limit())
    if not stream.eof:
        raise ValueError(
            f"a compressed variable that is cut short or above {limit} bytes ({intake.LIMIT} raises that)"
        )
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
    intake.check_bytes(8 * count, "a variable")


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
        name = present[0].name
        raise ValueError(f"sidecar {name}: {str(error).removeprefix(f'{name}: ')}") from None


def _parse_sidecar(path: Path) -> Sidecar:
    load = json.loads if path.suffix == ".json" else tomllib.loads
    text = intake.read_small(path)
    with common.foreign_errors(path.suffix[1:].upper()):
        entries: Any = load(text)
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
