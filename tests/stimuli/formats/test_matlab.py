"""MATLAB files, which are read in a process of their own: damage is refused and never ends the process."""

from __future__ import annotations

import io
import struct
import zlib
from typing import TYPE_CHECKING

import numpy as np
import pytest
from scipy.io import savemat
from scipy.sparse import csc_array

from feel321.stimuli.formats.read import read_recording
from feel321.stimuli.recording import UNITS
from tests.stimuli.formats.hostile import pack_mat

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray


def _mat(variables: dict[str, object], *, compressed: bool = False) -> bytes:
    stream = io.BytesIO()
    savemat(stream, variables, do_compression=compressed)
    return stream.getvalue()


def _element(kind: int, body: bytes, order: str = "<") -> bytes:
    return struct.pack(f"{order}II", kind, len(body)) + body + bytes(-len(body) % 8)


def _matrix(values: bytes, *, kind: int = 9, shape: tuple[int, ...] = (3, 2)) -> bytes:
    parts = [
        _element(6, struct.pack("<II", 6, 0)),
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


REFUSALS = {
    "version": HEADER[:124] + b"\x00\x03IM",
    "half a tag": HEADER + b"\x0e\x00\x00",
    "no variable": HEADER + _element(9, VALUES),
    "type of values": HEADER + _element(14, _matrix(VALUES, kind=255)),
    "too few values": HEADER + _element(14, _matrix(VALUES[:-8])),
    "too many values": HEADER + _element(14, _matrix(VALUES + VALUES)),
    "twice": HEADER + 2 * _element(14, _matrix(VALUES)),
    "half compressed": HEADER + _element(15, zlib.compress(VALUES)[:-6]),
    "inflates without end": pack_mat(60_000_000, 2),
}


@pytest.mark.parametrize("case", REFUSALS)
def test_damage_is_refused_in_one_line(
    tmp_path: Path, case: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("FEEL321_LARGEST_MB", "1")
    (tmp_path / "a.mat").write_bytes(REFUSALS[case])
    with pytest.raises(ValueError, match=r"^a\.mat: cannot be read as a MATLAB file \([^\n]*$"):
        read_recording(tmp_path / "a.mat", rate_hz=1000)
