"""Arrays by their names (NPZ, MATLAB); MATLAB files are read in a process of their own, which damage may end."""

import hashlib
import io
import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.io import savemat
from scipy.sparse import csc_array

from feel321.stimuli.formats.read import read_recording
from feel321.stimuli.recording import UNITS
from tests.stimuli.formats.hostile import pack_mat

SIGNAL = np.random.default_rng(5).normal(size=(3, 40))
AXES = dict(zip("xyz", SIGNAL, strict=True))
ACC = {f"acc_{axis}": values for axis, values in AXES.items()}
OTHER = {axis: 1000 * values for axis, values in ACC.items()}
TIME = np.arange(40) / 100


def _write(path: Path, arrays: dict[str, Any]) -> Path:
    savemat(path, arrays) if path.suffix == ".mat" else np.savez(path, **arrays)
    return path


@pytest.mark.parametrize(
    ("arrays", "arguments", "unit"),
    [
        ({"ACC": SIGNAL.T, "fs": np.array([100]), "units": np.array(["g"])}, {}, "g"),
        ({**AXES, "rate": 100, "unit": "G"}, {}, "g"),
        ({**ACC, "time": TIME, "unit": "g"}, {}, "g"),
        ({"tmp": SIGNAL.T, "time_ms": 1000 * TIME, "unit": "g"}, {}, "g"),
        ({"data": SIGNAL, "t": (5 + TIME).astype(np.float32), "unit": "g"}, {}, "g"),
        ({f"{axis}_g": values for axis, values in AXES.items()}, {}, "g"),
        ({f"acc_{axis}_mg": values for axis, values in AXES.items()}, {"unit": "mg"}, "mg"),
        ({"acceleration_g": SIGNAL}, {}, "g"),
        ({"acceleration_g": SIGNAL, "unit": "g"}, {}, "g"),
        ({"acceleration": SIGNAL, "unit": "g", "units": " G"}, {}, "g"),
        ({**AXES, **OTHER}, {"columns": ("x", "y", "z"), "unit": "g"}, "g"),
        ({"acceleration": 5 * SIGNAL, "data": SIGNAL}, {"columns": ("data",), "unit": "g"}, "g"),
        ({"acceleration": 5 * SIGNAL, **AXES}, {"columns": ("x", "y", "z"), "unit": "g"}, "g"),
        ({"acceleration": SIGNAL, "x": SIGNAL[0]}, {"unit": "g"}, "g"),
        ({"recorded": SIGNAL}, {"columns": ("recorded",), "unit": "g"}, "g"),
        ({"recorded_g": SIGNAL}, {"columns": (0,)}, "g"),
    ],
)
@pytest.mark.parametrize("suffix", [".npz", ".mat"])
def test_the_meant_arrays_are_read_in_their_unit(
    tmp_path: Path, suffix: str, arrays: dict[str, Any], arguments: dict[str, Any], unit: str
) -> None:
    has_rate = bool({"fs", "rate", "time", "time_ms", "t"} & arrays.keys())
    path = _write(tmp_path / f"a{suffix}", arrays if has_rate else {**arrays, "rate_hz": 100.0})
    recording = read_recording(path, **arguments)
    np.testing.assert_array_equal(recording.acceleration, SIGNAL * UNITS[unit])
    assert recording.rate_hz == pytest.approx(100, rel=1e-4)
    assert recording.sha256 == hashlib.sha256(path.read_bytes()).hexdigest()
    assert not any("no unit" in line for line in recording.warnings)


REFUSALS = {
    "axes twice": ({**AXES, **OTHER}, {}, r"columns may be x \(x, acc_x\); say which, columns=\(time, x, y, z\)"),
    "two accelerations": (
        {"acceleration": SIGNAL, "data": SIGNAL}, {},
        r"several arrays may be the acceleration \(acceleration, data\); say which, e.g. columns=\('acceleration',\)",
    ),
    "axes beside": ({"data": SIGNAL, **AXES}, {}, r"several arrays may be the acceleration \(data, x, y, z\)"),
    "two rates": ({"data": SIGNAL, "fs": 2.0}, {}, r"that differ \(fs says 2.0, rate_hz says 100.0\)"),
    "two units": (
        {"data": SIGNAL, "unit": "g", "units": "mg"}, {},
        r"that differ \(unit says 'g', units says 'mg'\)",
    ),
    "mixed units": ({"x_g": TIME, "y_g": TIME, "z_mg": TIME}, {}, r"in one unit, got x_g, y_g, z_mg"),
    "no vector": ({"x": SIGNAL, "y": SIGNAL, "z": SIGNAL}, {}, r"'x' .*one value per sample, got shape \(3, 40\)"),
    "no such array": ({"data": SIGNAL}, {"columns": ("p",)}, "must be data, or a number from 0 to 0, got 'p'"),
    "reduced": ({"acceleration": np.ones(9)}, {}, "already reduced to one axis"),
    "four columns": ({"acceleration": np.ones((9, 4))}, {}, r"exactly three axes; got .*\(9, 4\)"),
    "empty": ({"acceleration": np.ones((3, 0))}, {}, "it is empty"),
    "two axes": ({"x": np.ones(9), "y": np.ones(9)}, {}, "only the axes x, y"),
    "unequal": (
        {"x": np.ones(9), "y": np.ones(9), "z": np.ones(8)}, {},
        r"equal length, got x 9, y 9, z 8 samples",
    ),
    "text": ({"acceleration": np.array([["a"] * 3] * 9)}, {}, "'acceleration' must be real numbers, .*<U1"),
    "NaN": ({"acceleration": np.full((3, 9), np.nan)}, {}, r"got 27 values that are not"),
    "no one rate": ({"data": SIGNAL, "rate_hz": [1, 2]}, {}, "the rate must be one number, got 2 values"),
    "clock stops": ({"data": SIGNAL, "t": np.zeros(40)}, {}, "must increase, got 0 after 0 s at sample 1"),
    "pickled": ({"acceleration": np.array([None] * 9)}, {}, "cannot be read as an NPZ archive .*Object arrays"),
    "above all numbers": ({"data": SIGNAL * 3e307}, {"unit": "g"}, "must be finite"),
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSALS)
def test_what_is_no_recording_or_may_mean_two_things_is_refused_by_name(
    tmp_path: Path, case: str
) -> None:
    arrays, arguments, message = REFUSALS[case]
    path = _write(tmp_path / "a.npz", {**arrays, "rate_hz": arrays.get("rate_hz", 100.0)})
    with pytest.raises(ValueError, match=rf"^a\.npz: .*{message}"):
        read_recording(path, **arguments)


@pytest.mark.parametrize(("late", "passes"), [(0.009, True), (0.011, False)])
def test_jitter_up_to_one_per_cent_of_the_period_passes(
    tmp_path: Path, late: float, passes: bool
) -> None:
    time = TIME.copy()
    time[20:] += late * 0.01
    path = _write(tmp_path / "a.npz", {"acceleration": SIGNAL, "time": time})
    if passes:
        assert read_recording(path).rate_hz == pytest.approx(100, rel=1e-3)
    else:
        with pytest.raises(
            ValueError, match=r"jitter up to 1\.1% of the 10 ms period, 1 of 39 intervals off"
        ):
            read_recording(path)


# Damaged MATLAB files.


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


EMPTY = _mat({})
VALUES = np.arange(6.0).tobytes()


def test_other_variables_do_not_matter(tmp_path: Path) -> None:
    others: dict[str, object] = {
        "settings": {"gain": SIGNAL, "note": "a"},
        "cells": np.array([1, "a"], dtype=object),
        "grid": csc_array(np.eye(3)),
        "phase": SIGNAL * 1j,
        "text": "µm",
        "none": "",
    }
    for compressed in (False, True):
        variables = {**others, "acceleration": SIGNAL, "fs": 1000, "unit": "g"}
        (tmp_path / "a.mat").write_bytes(_mat(variables, compressed=compressed))
        recording = read_recording(tmp_path / "a.mat")
        np.testing.assert_array_equal(recording.acceleration, SIGNAL * UNITS["g"])


DAMAGE = {
    "version": EMPTY[:124] + b"\x00\x03IM",
    "half a tag": EMPTY + b"\x0e\x00\x00",
    "no variable": EMPTY + _element(9, VALUES),
    "type of values": EMPTY + _element(14, _matrix(VALUES, kind=255)),
    "too few values": EMPTY + _element(14, _matrix(VALUES[:-8])),
    "too many values": EMPTY + _element(14, _matrix(VALUES + VALUES)),
    "twice": EMPTY + 2 * _element(14, _matrix(VALUES)),
    "half compressed": EMPTY + _element(15, zlib.compress(VALUES)[:-6]),
    "inflates without end": pack_mat(60_000_000, 2),
}


@pytest.mark.parametrize("case", DAMAGE)
def test_damage_is_refused_in_one_line(
    tmp_path: Path, case: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("FEEL321_LARGEST_MB", "1")
    (tmp_path / "a.mat").write_bytes(DAMAGE[case])
    with pytest.raises(ValueError, match=r"^a\.mat: cannot be read as a MATLAB file \([^\n]*$"):
        read_recording(tmp_path / "a.mat", rate_hz=1000)
