"""Files that promise more than they hold, or hold more than anyone wants: small to write, large to read."""

import io
import struct
import zipfile
import zlib
from collections.abc import Callable

import numpy as np

HEADER = b"MATLAB 5.0 MAT-file".ljust(124) + struct.pack("<H", 0x0100) + b"IM"


def pack_npy(
    shape: tuple[int, ...], *, dtype: str = "<f8", body: bytes = b"", head: str = ""
) -> bytes:
    """An array's file whose header promises a shape, whatever follows."""
    text = head or repr({"descr": dtype, "fortran_order": False, "shape": shape})
    return b"\x93NUMPY\x02\x00" + struct.pack("<I", len(text) + 1) + text.encode() + b"\n" + body


def pack_zip(**members: bytes) -> bytes:
    """An archive of some files."""
    archive = io.BytesIO()
    with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED) as file:
        for name, content in members.items():
            file.writestr(name.replace("__", "."), content)
    return archive.getvalue()


def pack_wav(n_bytes: int, *, present: int, channels: int = 3) -> bytes:
    """A float32 WAV file whose header promises some bytes."""
    layout = struct.pack("<HHIIHH", 3, channels, 10000, 10000 * 4 * channels, 4 * channels, 32)
    chunks = b"fmt " + struct.pack("<I", 16) + layout + b"data" + struct.pack("<I", n_bytes)
    return b"RIFF" + struct.pack("<I", 36 + present) + b"WAVE" + chunks + bytes(present)


def pack_mat(n_bytes: int, copies: int) -> bytes:
    """A MATLAB file of variables that inflate to many zeros each."""
    body = zlib.compress(struct.pack("<II", 14, n_bytes) + bytes(n_bytes), 9)
    return HEADER + copies * (struct.pack("<II", 15, len(body)) + body)


def bend_size(content: bytes, size: int) -> bytes:
    """Change the size that an archive's directory gives its first file."""
    at = content.index(b"PK\x01\x02") + 24
    return content[:at] + struct.pack("<I", size) + content[at + 4 :]


FINE = pack_npy((3, 100), body=np.random.default_rng(1).normal(size=300).tobytes())
ZEROS = 8 * 3 * 50_000_000

HOSTILE: dict[str, tuple[str, Callable[[], bytes], str]] = {
    "wav: promises 4 GB": ("a.wav", lambda: pack_wav(2**32 - 4, present=64), "promises 357913941 samples"),
    "wav: 60 000 channels": ("a.wav", lambda: pack_wav(64_000, present=64_000, channels=16_000), "16000 for 3 axes"),
    "npy: promises 2 TB": ("a.npy", lambda: pack_npy((3, 2**36)), "as an NPY array"),
    "npy: header of 4 GB": ("a.npy", lambda: b"\x93NUMPY\x02\x00\xff\xff\xff\xff" + bytes(64), "as an NPY array"),
    "npz: zeros that inflate to 1.2 GB": (
        "a.npz",
        lambda: pack_zip(acceleration__npy=pack_npy((3, 50_000_000), body=bytes(ZEROS))),
        "its arrays: 1,200 MB, at most",
    ),
    "npz: promises 1.2 GB that are not there": (
        "a.npz",
        lambda: bend_size(pack_zip(acceleration__npy=pack_npy((3, 50_000_000))), ZEROS + 70),
        "its arrays: 1,200 MB, at most",
    ),
    "npz: objects": ("a.npz", lambda: pack_zip(acceleration__npy=pack_npy((3,), dtype="|O")), "Object arrays"),
    "npz: a file that is no array": ("a.npz", lambda: pack_zip(notes__txt=b"1"), "array must be named"),
    "mat: 40 variables of 60 MB": ("a.mat", lambda: pack_mat(60_000_000, 40), "cannot be read as a MATLAB file"),
    "csv: a line of 30 MB": ("a.csv", lambda: b"1," * 15_000_000, "longer than 1048576 bytes"),
    "csv: 200 000 columns": ("a.csv", lambda: b"1," * 200_000 + b"1\n", "at most 1000 columns"),
    "csv: a cell of 9 000 letters": ("a.csv", lambda: b"x,y,z\n1,2,3\n1,2," + b"a" * 9_000, "got 'a{57}...'"),
    "csv: a column called [[[...": ("a.csv", lambda: b"x,y," + b"[" * 5000 + b"\n1,2,3\n", r"\.\.\."),
    "csv: time stamps of a century": (
        "a.csv",
        lambda: b"time_s,x,y,z\n" + b"".join(b"%d,1,2,%d\n" % (i if i < 99 else 10**10, i % 7) for i in range(100)),
        "promises 10,000,000,001 samples",
    ),
    "csv: Latin-1": ("a.csv", lambda: b"x,y,z\n1,2,3\n1,2,\xb5\n", r"line 3 holds the byte 0xb5, .* byte 17"),
    "csv: UTF-16": (
        "a.csv", lambda: "x,y,z\n1,2,3\n".encode("utf-16"), "UTF-16 or UTF-32; save the file as UTF-8",
    ),
    "csv: zero byte": ("a.csv", lambda: b"x,y,z\n" + b"1,2,3\n" * 2000 + b"1,\0,3\n", "line 2002 holds a zero byte"),
    "xml: 2 000 000 tags": ("a.xml", lambda: b"<a>" + b"<b/>" * 2_000_000 + b"</a>", "more than 10000 tags"),
    "xml: 100 000 levels": ("a.xml", lambda: b"<a>" * 100_000, "more than 10000 tags"),
    "xml: a number of 5 000 letters": (
        "a.xml",
        lambda: b"<a><SampleRate>9</SampleRate><AccelX>1 [" + b"[" * 5000 + b"</AccelX><AccelY/><AccelZ/></a>",
        "not a number",
    ),
    "xml: an entity": ("a.xml", lambda: b"<!DOCTYPE a [<!ENTITY b 'c'>]><a/>", "entities, which are not read"),
    "ide: an element of 1 TB": ("a.ide", lambda: b"\x1aE\xdf\xa3\x04\xff\xff\xff\xff\xff" + bytes(64), "enDAQ"),
}  # fmt: skip
"""What it is -> its name, its content, and what the refusal says."""
