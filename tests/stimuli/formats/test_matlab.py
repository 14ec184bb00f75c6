from __future__ import annotations

import io
import struct
import zlib
from typing import TYPE_CHECKING

import numpy as np
import pytest
from scipy.io import savemat
from scipy.sparse import csc_array

from feel321.stimuli.formats.arrays import HEADER_BYTES, keep_plain_arrays
from feel321.stimuli.formats.read import read_recording
from feel321.stimuli.recording import UNITS

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray


def _mat(variables: dict[str, object], *, compressed: bool = False) -> bytes:
    stream = io.BytesIO()
    savemat(stream, variables, do_compression=compressed)
    return stream.getvalue()


def _element(kind: int, body: bytes, order: str = "<") -> bytes:
    return struct.pack(f"{order}II", kind, len(body)) + body + bytes(-len(body) % 8)


def _matrix(
    values: bytes, *, kind: int = 9, shape: tuple[int, ...] = (3, 2), array_class: int = 6
) -> bytes:
    parts = [
        _element(6, struct.pack("<II", array_class, 0)),
        _element(5, struct.pack(f"<{len(shape)}i", *shape)),
        _element(1, b"tmp"),
        _element(kind, values),
    ]
    return b"".join(parts)


HEADER = _mat({})
VALUES = np.arange(6.0).tobytes()


def test_other_variables_do_not_matter(tmp_path: Path, signal: NDArray[np.float64]) -> None:
    others: dict[str, object] = {
        "settings": {"gain": signal, "note": "a"},
        "cells": np.array([1, "a"], dtype=object),
        "grid": csc_array(np.eye(3)),
        "phase": signal * 1j,
        "text": "µm",
        "none": "",
    }
    for compressed in (False, True):
        variables = {**others, "acceleration": signal, "fs": 1000, "unit": "g"}
        (tmp_path / "a.mat").write_bytes(_mat(variables, compressed=compressed))
        recording = read_recording(tmp_path / "a.mat")
        np.testing.assert_array_equal(recording.acceleration, signal * UNITS["g"])


def test_big_endian_and_small_integers_are_read(tmp_path: Path) -> None:
    words = _element(6, struct.pack(">II", 6, 0), ">") + _element(5, struct.pack(">ii", 3, 2), ">")
    # A name so short that it stands inside its tag.
    name = struct.pack(">I", 3 << 16 | 1) + b"tmp\0"
    body = words + name + _element(3, np.array([1, 2, 3, -4, 5, 6], ">i2").tobytes(), ">")
    (tmp_path / "a.mat").write_bytes(HEADER[:124] + b"\x01\x00MI" + _element(14, body, ">"))
    recording = read_recording(tmp_path / "a.mat", rate_hz=1000)
    np.testing.assert_array_equal(recording.acceleration, [[1, -4], [2, 5], [3, 6]])


def test_the_file_given_to_scipy_is_the_same_if_all_is_plain(signal: NDArray[np.float64]) -> None:
    plain = _mat({"acceleration": signal, "unit": "g"})
    assert keep_plain_arrays(plain) == plain
    packed = _mat({"acceleration": signal, "unit": "g"}, compressed=True)
    assert keep_plain_arrays(packed)[HEADER_BYTES:] == plain[HEADER_BYTES:]


MAT_REFUSALS = {
    "version": (HEADER[:124] + b"\x00\x03IM", "its header names no version 5"),
    "order": (HEADER[:126] + b"??", "its header names no version 5"),
    "half a tag": (HEADER + b"\x0e\x00\x00", "unpack_from requires"),
    "no variable": (HEADER + _element(9, VALUES), "an element of type 9 where a variable should be"),
    "too large": (HEADER + struct.pack("<II", 14, 2**31) + VALUES, "element of 2147483648 bytes where 48 are left"),
    "small element": (HEADER + struct.pack("<I", 9 << 16 | 14) + VALUES, "a small element of 9 bytes"),
    "wrong part": (HEADER + _element(14, _element(9, bytes(8))), "type 9 where type 6 should be"),
    "flags": (HEADER + _element(14, _matrix(VALUES).replace(_element(6, bytes([6, *bytes(7)])), _element(6, bytes(4)))),
              "an array whose flags or sizes are damaged"),
    "one size": (HEADER + _element(14, _matrix(VALUES, shape=(6,))), "an array whose flags or sizes are damaged"),
    "type of values": (HEADER + _element(14, _matrix(VALUES, kind=255)), "values of type 255 in an array of numbers"),
    "type of letters": (
        HEADER + _element(14, _matrix(VALUES, array_class=4)),
        "values of type 9 in an array of text",
    ),
    "too few values": (HEADER + _element(14, _matrix(VALUES[:-8])), r"40 bytes of values for the shape \(3, 2\)"),
    "too many values": (HEADER + _element(14, _matrix(VALUES + VALUES)), "96 bytes of values for the shape"),
    "less than nothing": (HEADER + _element(14, _matrix(VALUES, shape=(-3, -2))), r"for the shape \(-3, -2\)"),
    "letters that are missing": (
        HEADER + _element(14, _matrix(b"g", kind=16, shape=(1, 2**31 - 1), array_class=4)),
        "1 bytes of values for the shape",
    ),
    "twice": (HEADER + 2 * _element(14, _matrix(VALUES)), "two variables are called tmp"),
    "name of two lines": (HEADER + _element(14, _matrix(VALUES).replace(b"tmp", b"a\nb")), r"got a\\nb; or say"),
    "half compressed": (HEADER + _element(15, zlib.compress(VALUES)[:-6]), "a compressed variable that is cut short"),
    "not compressed": (HEADER + _element(15, VALUES), "while decompressing data"),
}  # fmt: skip


@pytest.mark.parametrize("case", MAT_REFUSALS)
def test_damaged_elements_are_refused_before_scipy_sees_them(tmp_path: Path, case: str) -> None:
    content, message = MAT_REFUSALS[case]
    (tmp_path / "a.mat").write_bytes(content)
    with pytest.raises(ValueError, match=rf"^a\.mat: .*{message}"):
        read_recording(tmp_path / "a.mat", rate_hz=1000)


def test_what_inflates_without_end_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FEEL321_LARGEST_MB", "1")
    bomb = HEADER + _element(15, zlib.compress(_element(14, bytes(10**6))))
    with pytest.raises(ValueError, match="above 1000000 bytes"):
        keep_plain_arrays(bomb)


def _damaged(content: bytes, rng: np.random.Generator) -> bytes:
    """Change one to four bytes behind the header, more often in tags than in values, inside compression too."""
    behind = bytearray(content[HEADER_BYTES:])
    for _ in range(rng.integers(1, 5)):
        place = rng.integers(min(len(behind), rng.choice([24, 90, 10**6])))
        behind[place] = rng.choice([
            0,
            20,
            255,
            rng.integers(256),
            behind[place] ^ 1 << rng.integers(8),
        ])
    if rng.random() < 0.3:
        return content[:HEADER_BYTES] + _element(15, zlib.compress(behind))
    return content[:HEADER_BYTES] + bytes(behind)


def test_damage_is_read_or_refused_and_never_ends_the_process(
    tmp_path: Path, signal: NDArray[np.float64]
) -> None:
    rng = np.random.default_rng(11)
    variables = {"acceleration": signal, "fs": 1000, "unit": "g", "x": {"y": 1}}
    whole = [_mat(variables), _mat(variables, compressed=True)]
    messages: list[str] = []
    for i in range(600):
        (tmp_path / "a.mat").write_bytes(_damaged(whole[i % 2], rng))
        try:
            read_recording(tmp_path / "a.mat")
        except ValueError as error:
            messages.append(str(error))
    assert 200 < len(messages) < 600
    assert all(message.startswith("a.mat: ") and "\n" not in message for message in messages)
