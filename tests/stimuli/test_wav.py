import struct
from pathlib import Path

import numpy as np
import pytest
from scipy.io import wavfile

from feel321.stimuli.wav import read_wav, write_wav


@pytest.mark.parametrize("shape", [(1,), (7,), (3, 500), (1, 4), (2, 3)])
def test_what_is_written_is_read_back_to_float32(tmp_path: Path, shape: tuple[int, ...]) -> None:
    samples = np.random.default_rng(1).normal(size=shape) * 1e3
    write_wav(tmp_path / "a.wav", samples, 48000.0)
    back, rate = read_wav(tmp_path / "a.wav")
    assert rate == 48000
    assert back.dtype == np.float64
    np.testing.assert_array_equal(back, samples.astype(np.float32).reshape(back.shape))
    assert back.shape == (shape if shape[0] > 1 else shape[-1:])  # one channel has no channel axis


def test_a_damaged_file_is_refused_in_one_way_only(tmp_path: Path) -> None:
    write_wav(tmp_path / "a.wav", np.random.default_rng(2).normal(size=(3, 8)), 8000)
    whole, rng = (tmp_path / "a.wav").read_bytes(), np.random.default_rng(2)
    messages: list[str] = []
    for _ in range(400):
        damaged = bytearray(whole)
        for place in rng.integers(0, 60, size=rng.integers(1, 4)):
            damaged[place] = rng.choice([0, 1, 255, rng.integers(256)])
        (tmp_path / "b.wav").write_bytes(damaged)
        try:
            read_wav(tmp_path / "b.wav")
        except ValueError as error:
            messages.append(str(error))
    assert 100 < len(messages) < 400
    assert all(message.startswith("b.wav: ") for message in messages)


@pytest.mark.parametrize(
    ("stored", "fractions"),
    [
        (np.array([0, 128, 255], np.uint8), [-1, 0, 127 / 128]),
        (np.array([-32768, 0, 16384], np.int16), [-1, 0, 0.5]),
        (np.array([-(2**31), 0, 2**30], np.int32), [-1, 0, 0.5]),
    ],
)
def test_integers_are_fractions_of_full_scale(
    tmp_path: Path, stored: np.ndarray, fractions: list[float]
) -> None:
    wavfile.write(tmp_path / "a.wav", 8000, stored)
    np.testing.assert_array_equal(read_wav(tmp_path / "a.wav")[0], fractions)


def _header(data_bytes: int, *, coding: int = 1, channels: int = 1, frame_bytes: int = 1) -> bytes:
    layout = struct.pack(
        "<HHIIHH", coding, channels, 8000, 8000 * frame_bytes, frame_bytes, 8 * frame_bytes
    )
    data = struct.pack("<4sI", b"data", data_bytes)
    size = min(36 + data_bytes, 2**32 - 1)
    return b"RIFF" + struct.pack("<I8sI", size, b"WAVEfmt ", 16) + layout + data


def test_a_truncated_file_is_refused_with_both_numbers(tmp_path: Path) -> None:
    write_wav(tmp_path / "a.wav", np.zeros((3, 10)), 8000)
    (tmp_path / "a.wav").write_bytes((tmp_path / "a.wav").read_bytes()[:-30])
    with pytest.raises(
        ValueError, match=r"a\.wav: the header promises 10 samples, the file holds 7"
    ):
        read_wav(tmp_path / "a.wav")


def test_a_header_of_two_to_the_31_samples_is_refused_without_allocating(tmp_path: Path) -> None:
    (tmp_path / "a.wav").write_bytes(_header(2**31) + b"12345")
    with pytest.raises(
        ValueError, match="the header promises 2147483648 samples, the file holds 5"
    ):
        read_wav(tmp_path / "a.wav")


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "ends inside its header"),
        (b"RIFF\x00\x00\x00\x00WAVEdata\x00\x00\x00\x00", "before any format chunk"),
        (_header(8, channels=0, frame_bytes=0), "above 0, got 0, 8000 Hz, 0 bytes"),
        (
            _header(4, coding=7) + b"abcd",
            "WAV coding 0x0007 of 8 bits is not read; save as PCM or float",
        ),
        (_header(4, channels=3) + b"abcd", "frames of 1 bytes for 3 channels of 8 bits"),
        (b"RIFF" + bytes(4) + _header(4)[8:] + b"abcd", "chunks that cannot be read"),
        (_header(0), "holds no samples"),
    ],
)
def test_what_is_not_a_wav_file_is_refused(tmp_path: Path, content: bytes, message: str) -> None:
    (tmp_path / "a.wav").write_bytes(content)
    with pytest.raises(ValueError, match=rf"a\.wav: .*{message}"):
        read_wav(tmp_path / "a.wav")


@pytest.mark.parametrize(
    ("samples", "rate", "message"),
    [
        ([], 8000, "shape"),
        ([np.nan], 8000, "must be finite"),
        ([1e39], 8000, "float32"),
        ([1.0], 8000.5, "whole number"),
    ],
)
def test_what_a_wav_cannot_hold_is_refused(
    tmp_path: Path, samples: list[float], rate: float, message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        write_wav(tmp_path / "a.wav", samples, rate)
    assert not list(tmp_path.iterdir())
