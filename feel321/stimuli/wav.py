"""WAV files of our own: float32 out, any plain PCM or float WAV in.

Samples are in the file's own scale; which unit that is stands in a manifest or sidecar, never in the WAV.
"""

import io
import struct
import warnings
from pathlib import Path
from typing import BinaryIO, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from feel321.arguments import as_path, check_finite, check_rate, coerce_real
from feel321.files import check_samples, file_named, open_regular, write_bytes
from feel321.types import PathLike, Samples

BYTE_ORDERS = {b"RIFF": "<", b"RIFX": ">"}
"""The container names that are read, each with its byte order in `struct` notation."""

IEEE_FLOAT, PCM = 0x0003, 0x0001
EXTENSIBLE = 0xFFFE  # Codings in a format chunk; the last says that the true one stands further on
EXTENSIBLE_BYTES = 40  # The length of the longest format chunk

SAMPLE_BITS = {PCM: range(1, 65), IEEE_FLOAT: (32, 64)}
"""Codings that are read, each with the allowed bits per sample."""


class WavHeader(NamedTuple):
    """Format and length of a WAV file by its chunks, and the bytes that are present."""

    channels: int
    rate_hz: int
    frame_bytes: int
    is_float: bool
    data_bytes: int
    present_bytes: int


def write_wav(path: PathLike, samples: ArrayLike, rate_hz: float) -> None:
    """Write samples as a float32 WAV: the whole file or nothing, the same bytes every time.

    Parameters
    ----------
    path : str or path
        Where to write. The folder must exist; a file of that name is replaced in one step.
    samples : array_like, shape (n_samples,) or (channels, n_samples)
        Samples in any unit; rounded to float32.
    rate_hz : float
        Sampling rate in Hz, a whole number below 2**32, because a WAV header holds nothing else.

    Raises
    ------
    ValueError
        If the shape, the rate or a value cannot be stored.

    Examples
    --------
    >>> import tempfile
    >>> from feel321 import stimuli
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     stimuli.write_wav(f"{folder}/tap.wav", [0.0, 0.5, -0.25], 48000)
    ...     stimuli.read_wav(f"{folder}/tap.wav")
    (array([ 0.  ,  0.5 , -0.25]), 48000)
    """
    target = as_path(path)
    with file_named(target):
        content = encode_wav(samples, rate_hz)
    write_bytes(target, content)


def encode_wav(samples: ArrayLike, rate_hz: float) -> bytes:
    """Encode samples as the bytes of a float32 WAV."""
    from scipy.io import wavfile

    rate = check_rate(rate_hz)
    if rate != int(rate) or rate >= 2**32:
        got = f"got {rate!r} Hz"
        raise ValueError(f"the rate in a WAV header must be a whole number below 2**32, {got}")
    values = coerce_real(samples, "samples")
    if values.ndim not in {1, 2} or values.size == 0:
        got = f"got {values.shape}"
        raise ValueError(f"samples must have the shape (n,) or (channels, n), not empty; {got}")
    check_finite(values, "samples")
    with np.errstate(over="ignore"):
        frames = values.T.astype(np.float32)
    if not np.isfinite(frames).all():
        got = f"got a peak of {np.abs(values).max():g}"
        raise ValueError(f"samples must fit into float32 (3.4e38), {got}")
    frames = np.ascontiguousarray(frames)
    if rate * frames.dtype.itemsize * (frames.shape[1] if frames.ndim > 1 else 1) >= 2**32:
        got = f"got a rate of {rate:g} Hz; lower it"
        raise ValueError(f"the bytes of a second in a WAV header must be below 2**32, {got}")
    content = io.BytesIO()
    wavfile.write(content, int(rate), frames)
    return content.getvalue()


def read_wav(path: PathLike) -> tuple[Samples, int]:
    """Read a WAV file of float or integer samples.

    Parameters
    ----------
    path : str or path
        The file.

    Returns
    -------
    samples : ndarray of float64, shape (n_samples,) or (channels, n_samples)
        Float samples as they stand in the file; integer samples as fractions of full scale, -1 to 1.
    rate_hz : int
        Sampling rate in Hz.

    Raises
    ------
    ValueError
        If the file is not a WAV file, or holds fewer samples than its header promises.
    OSError
        If the file cannot be opened.
    """
    from scipy.io import wavfile

    source = as_path(path)
    read_wav_header(source)
    with warnings.catch_warnings():
        # Chunks that scipy does not know (cue points, author) are of no concern; lengths were checked above.
        warnings.simplefilter("ignore", wavfile.WavFileWarning)
        try:
            rate, frames = wavfile.read(source)
        except OSError:
            raise
        except Exception as error:  # at damaged chunks scipy raises anything: UnboundLocalError
            why = f"has chunks that cannot be read ({error})"
            raise ValueError(f"{source.name}: {why}; save it again as PCM or float") from error
    fractions = frames.astype(np.float64)
    if frames.dtype.kind != "f":
        full_scale = np.iinfo(frames.dtype).max + 1
        middle = 128 if frames.dtype == np.uint8 else 0  # 8-bit WAV is unsigned around 128
        fractions = (fractions - middle) / (full_scale - middle)
    return np.ascontiguousarray(fractions.T), int(rate)


def read_wav_header(path: Path) -> WavHeader:
    """Read and check a WAV file's header, without reading samples."""
    with file_named(path), open_regular(path) as file:
        try:
            header = _scan_chunks(file, path.stat().st_size)
        except struct.error:
            raise ValueError("the file ends inside its header; copy or export it again") from None
        both = header.data_bytes, header.present_bytes
        promised, present = (n // header.frame_bytes for n in both)
        if promised == 0:
            raise ValueError("the WAV file holds no samples; record or export it again")
        if header.present_bytes < header.data_bytes:
            got = f"the header promises {promised} samples, the file holds {present}"
            why = "it is truncated or its header is wrong"
            raise ValueError(f"{got}; {why}, copy or export it again")
        check_samples(promised, header.channels, header.rate_hz)
    return header


def _scan_chunks(file: BinaryIO, size: int) -> WavHeader:
    container, _, kind = struct.unpack("<4sI4s", file.read(12))
    if container not in BYTE_ORDERS or kind != b"WAVE":
        got = f"got {container!r}; export it as WAV"
        raise ValueError(f"the file must begin with RIFF and WAVE, {got}")
    order = BYTE_ORDERS[container]
    layout: tuple[int, int, int, bool] | None = None
    while True:
        name, length = struct.unpack(f"{order}4sI", file.read(8))
        if name == b"data":
            break
        start = file.tell()
        if name == b"fmt ":
            layout = _parse_format(file.read(min(length, EXTENSIBLE_BYTES)), order)
        file.seek(start + length + length % 2)  # chunks start at even places
    if layout is None:
        raise ValueError("the samples come before any format chunk; export it as WAV again")
    return WavHeader(*layout, length, min(length, size - file.tell()))


def _parse_format(body: bytes, order: str) -> tuple[int, int, int, bool]:
    coding, channels, rate, _, frame_bytes, bits = struct.unpack(f"{order}HHIIHH", body[:16])
    if coding == EXTENSIBLE:
        coding = struct.unpack(f"{order}H", body[24:26])[0]
    if 0 in {channels, rate, frame_bytes}:
        got = f"got {channels}, {rate} Hz, {frame_bytes} bytes"
        raise ValueError(f"channels, rate and frame size must be above 0, {got}")
    if coding not in SAMPLE_BITS or bits not in SAMPLE_BITS[coding]:
        do = "save as PCM or float"
        raise ValueError(f"the WAV coding 0x{coding:04x} of {bits} bits is not read; {do}")
    if frame_bytes != channels * -(-bits // 8):
        got = f"frames of {frame_bytes} bytes for {channels} channels of {bits} bits"
        do = "it is wrong, copy or export the file again"
        raise ValueError(f"the header gives {got}; {do}")
    return channels, rate, frame_bytes, coding == IEEE_FLOAT
