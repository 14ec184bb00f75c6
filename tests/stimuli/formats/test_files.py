import hashlib
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.io import wavfile

from feel321.stimuli.formats.read import read_recording
from feel321.stimuli.recording import STANDARD_GRAVITY
from feel321.stimuli.wav import write_wav

Signal = NDArray[np.float64]


# --- WAV ---


def test_float_wav_is_in_the_unit_of_its_sidecar(tmp_path: Path, signal: Signal) -> None:
    write_wav(tmp_path / "a.wav", signal, 20000)
    (tmp_path / "a.json").write_text('{"unit": "g", "rate_hz": 19999.57, "axes": ["x", "y", "z"]}')
    recording = read_recording(tmp_path / "a.wav")
    np.testing.assert_array_equal(
        recording.acceleration, signal.astype("f4").astype("f8") * STANDARD_GRAVITY
    )
    assert (recording.rate_hz, recording.name, recording.warnings) == (19999.57, "a", ())
    both = (tmp_path / "a.wav").read_bytes() + (tmp_path / "a.json").read_bytes()
    assert recording.sha256 == hashlib.sha256(both).hexdigest()


def test_a_sidecar_may_name_more_channels_in_any_order(tmp_path: Path, signal: Signal) -> None:
    write_wav(tmp_path / "a.wav", np.vstack([signal, signal[:1]])[[3, 2, 1, 0]], 8000)
    (tmp_path / "a.json").write_text('{"unit": "m/s2", "axes": ["force", "z", "y", "x"]}')
    recording = read_recording(tmp_path / "a.wav")
    np.testing.assert_array_equal(recording.acceleration, signal.astype(np.float32))


def test_integer_wav_is_a_fraction_of_full_scale(tmp_path: Path) -> None:
    counts = np.array([[-32768, 0, 16384], [0, 1, 2], [5, 6, 7]], np.int16)
    wavfile.write(tmp_path / "a.wav", 8000, counts.T)
    np.testing.assert_allclose(
        read_recording(tmp_path / "a.wav", full_scale=16, unit="g").acceleration,
        counts / 32768 * 16 * STANDARD_GRAVITY,
    )
    bare = read_recording(tmp_path / "a.wav", unit="g")
    assert any("full scale taken as 1.0" in line for line in bare.warnings)
    (tmp_path / "a.json").write_text('{"unit": "g", "full_scale": 2}')
    np.testing.assert_allclose(
        read_recording(tmp_path / "a.wav").acceleration[0], counts[0] / 16384 * STANDARD_GRAVITY
    )


@pytest.mark.parametrize(
    ("sidecar", "arguments", "message"),
    [
        ({"rate_hz": 8020}, {}, "header says 8000 Hz and the sidecar 8020 Hz"),
        ({"unit": "ft"}, {}, r"sidecar a\.json: the unit must be .*got 'ft'"),
        ({"unit": "g"}, {"unit": "mg"}, "gives the unit 'g', but unit='mg'"),
        ({"rate_hz": "fast"}, {}, "sidecar .*finite number .*got 'fast'"),
        ({"axes": ["x", "y"]}, {}, 'must be a list with "x", "y" and "z" once each'),
        ({"axes": ["x", "y", "z", "force"]}, {}, "got 3 for 4 axes"),
        ({"full_scale": 4}, {}, "full_scale .*these are float"),
        ({"full_scale": 4}, {"full_scale": 5.0}, "full_scale=5, but the sidecar says 4"),
        ({}, {"columns": (0, 1, 2)}, "columns .*got a wav file"),
        ({"unt": "g", "Fs": 8000}, {}, "sidecar a.json: .*unit, rate_hz, axes.*got 'unt', 'Fs'"),
        ({"unit": "g", "units": "mg"}, {}, "sidecar a.json: unit and units mean the same"),
    ],
)
def test_a_wav_that_contradicts_what_is_said_of_it_is_refused(
    tmp_path: Path, signal: Signal, sidecar: object, arguments: dict[str, Any], message: str
) -> None:
    write_wav(tmp_path / "a.wav", signal, 8000)
    (tmp_path / "a.json").write_text(json.dumps(sidecar))
    with pytest.raises(ValueError, match=rf"^a\.wav: .*{message}"):
        read_recording(tmp_path / "a.wav", **arguments)


# --- HaTT ---


def _hatt(signal: Signal, *, nested: bool = False, mark: str = " ", extra: str = "") -> str:
    texts = [mark.join(map(repr, axis.tolist())) for axis in signal]
    if nested:
        body = (
            "<Accel>"
            + "".join(f"<{a}>{t}</{a}>" for a, t in zip("XYZ", texts, strict=True))
            + "</Accel>"
        )
    else:
        body = "".join(f"<Accel{a}>{t}</Accel{a}>" for a, t in zip("XYZ", texts, strict=True))
    return f'<?xml version="1.0"?>\n<Recording><Force><X>1</X><Y>2</Y></Force>{body}{extra}</Recording>'


@pytest.mark.parametrize("nested", [False, True])
@pytest.mark.parametrize("mark", [" ", ",", "\n", ", "])
def test_hatt_axes_are_found_flat_or_nested(
    tmp_path: Path, signal: Signal, nested: bool, mark: str
) -> None:
    extra = "<SampleRate>10000</SampleRate><AccelUnits>m/s^2</AccelUnits>"
    (tmp_path / "a.xml").write_text(_hatt(signal, nested=nested, mark=mark, extra=extra))
    recording = read_recording(tmp_path / "a.xml")
    np.testing.assert_array_equal(recording.acceleration, signal)
    assert (recording.rate_hz, recording.warnings) == (10000, ())


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("<R><Accel>1 2 3</Accel></R>", "scalar Accel signal .*already reduced"),
        ("<R><AccelX>1 2</AccelX><AccelY>1 2</AccelY></R>", "only the axes x, y"),
        ("<R><AccelX>1 2</AccelX><AccelY>1 2</AccelY><AccelZ>1</AccelZ></R>", r"equal length, got x 2, y 2, z 1"),
        ("<R><AccelX>1 two</AccelX></R>", "a value of the x axis is not a number"),
        ("<R><AccelX>1</AccelX><AccelY>1</AccelY><AccelZ>1</AccelZ></R>", "no sampling rate"),
        ("<R><AccelX>1", "cannot be read as XML"),
        ('<!DOCTYPE R [<!ENTITY a "1">]><R><AccelX>&a;</AccelX></R>', "declares a document type or entities"),
    ],
)  # fmt: skip
def test_xml_that_is_no_recording_is_refused(tmp_path: Path, content: str, message: str) -> None:
    (tmp_path / "a.xml").write_text(content)
    with pytest.raises(ValueError, match=rf"^a\.xml: .*{message}"):
        read_recording(tmp_path / "a.xml")


# --- LMT-108 ---


def _write_lmt(folder: Path, signal: Signal) -> list[Path]:
    paths = [folder / f"G1RhombAluminumMesh_Movement_{axis}_train1.txt" for axis in "XYZ"]
    for path, values in zip(paths, signal, strict=True):
        path.write_text("\n".join(map(repr, values.tolist())) + "\n")
    return paths


@pytest.mark.parametrize("which", [0, 1, 2])
def test_any_axis_of_an_lmt_triple_finds_its_sisters(
    tmp_path: Path, signal: Signal, which: int
) -> None:
    paths = _write_lmt(tmp_path, signal)
    recording = read_recording(paths[which], unit="g")
    np.testing.assert_allclose(recording.acceleration, signal * STANDARD_GRAVITY, rtol=1e-15)
    assert recording.name == "G1RhombAluminumMesh_Movement_train1"
    assert recording.rate_hz == 10000
    assert (
        recording.sha256
        == hashlib.sha256(b"".join(path.read_bytes() for path in paths)).hexdigest()
    )
    assert any("documented 10000 Hz" in line for line in recording.warnings)
    assert read_recording(paths[which], unit="g", rate_hz=9000).rate_hz == 9000


# --- enDAQ ---


@pytest.mark.filterwarnings("ignore")  # idelib warns of elements that a minimal file leaves out
def test_the_fastest_accelerometer_of_an_ide_file_is_read(write_ide: Callable[..., Path]) -> None:
    counts = np.random.default_rng(1).integers(-3000, 3000, size=(500, 3))
    recording = read_recording(write_ide(counts))
    np.testing.assert_allclose(
        recording.acceleration, counts.T * 0.001 * STANDARD_GRAVITY, rtol=1e-12
    )
    assert recording.rate_hz == pytest.approx(20000)
    assert recording.warnings == ()


@pytest.mark.filterwarnings("ignore")
def test_lost_samples_of_an_ide_file_are_refused(write_ide: Callable[..., Path]) -> None:
    counts = np.random.default_rng(1).integers(-3000, 3000, size=(500, 3))
    path = write_ide(counts, lost_us=400)
    with pytest.raises(
        ValueError, match=r"recorder\.IDE: sampling must be regular .*the longest 0\.45 ms"
    ):
        read_recording(path)
    assert read_recording(path, resample=True).n_samples == 508


# --- what is no recording at all ---


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.csv", b"", r"empty \(0 bytes\)"),
        ("a.csv", b"\x00\x01\x02garbage", r"binary data of no known format \('\.csv'\)"),
        ("a.wav", b"x,y,z\n1,2,3\n", r"must not hold text; rename it to \.csv"),
        ("a.log", b"x,y,z\n1,2,3\n", r"one of \.csv \.tsv .*, got the suffix '\.log'"),
        ("a.mat", b"\x89HDF\r\n\x1a\n", r"MATLAB 7\.3 and HDF5 .*'-v7'"),
    ],
)
def test_what_is_no_recording_is_refused(
    tmp_path: Path, name: str, content: bytes, message: str
) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(ValueError, match=rf"^{name}: .*{message}"):
        read_recording(tmp_path / name)
