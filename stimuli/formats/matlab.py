"""MAT files of version 4 to 7: named arrays to a recording.

A damaged element of version 5 makes scipy's compiled reader read outside its tables, which ends the whole process:
no error to translate, a study's build gone. So the elements are walked first, and scipy is given a file of nothing
but those plain arrays whose types and sizes hold. A child process that may die would guard as well, but costs a
start of Python per file.
"""

from __future__ import annotations

import io
import math
import struct
import zlib
from typing import TYPE_CHECKING

import numpy as np

from stimuli.formats.arrays import decode_arrays
from stimuli.formats.errors import foreign_errors

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from stimuli.formats.decoded import Decoded, Request

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


def read_mat(path: Path, request: Request) -> Decoded:
    """Read a MATLAB file of version 4 to 7 by the names of its variables.

    Parameters
    ----------
    path : Path
        The file.
    request : Request
        Which variables, rate and unit, where the file holds several.

    Returns
    -------
    Decoded
        What its variables say.

    Raises
    ------
    ValueError
        If the file is damaged, or holds no three axes.
    """
    from scipy.io import loadmat

    content = path.read_bytes()
    with foreign_errors("a MATLAB file"):
        if 0 not in content[:4]:  # the mark of version 4, which scipy reads in Python
            content = keep_plain_arrays(content)
        variables = loadmat(io.BytesIO(content))  # type: ignore[arg-type]  # the stubs leave out open files
    return decode_arrays({name: np.asarray(value) for name, value in variables.items() if name[:2] != "__"}, request)


def keep_plain_arrays(content: bytes) -> bytes:
    """Return a version 5 file of the same arrays of numbers and texts, inflated and proved whole.

    Parameters
    ----------
    content : bytes
        A file of version 5 to 7.

    Returns
    -------
    bytes
        The file without structures, cells, objects and sparse arrays.

    Raises
    ------
    ValueError
        If an element's type or size cannot be, or two variables share a name.
    """
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
        raise ValueError(f"an element of {size} bytes where {max(len(content) - start, 0)} are left")
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
