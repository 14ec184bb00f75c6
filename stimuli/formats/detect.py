"""Which format a file is, by its first bytes and only then by its suffix."""

from __future__ import annotations

from typing import TYPE_CHECKING

from stimuli.formats.lmt import is_lmt

if TYPE_CHECKING:
    from pathlib import Path

MAGIC = {
    b"RIFF": "wav", b"RIFX": "wav", b"RF64": "wav",
    b"PK\x03\x04": "npz", b"PK\x05\x06": "npz", b"\x93NUMPY": "npy",
    b"MATLAB 5.0": "mat", b"\x1aE\xdf\xa3": "ide",
}  # fmt: skip
"""First bytes and the format that they mean."""

HDF5 = (b"\x89HDF\r\n\x1a\n", b"MATLAB 7.3")
WIDE_TEXT = (b"\xff\xfe", b"\xfe\xff", b"\x00\x00\xfe\xff")
TABLE_SUFFIXES = (".csv", ".tsv", ".txt")
BINARY_SUFFIXES = (".wav", ".npz", ".npy", ".mat", ".ide")
SUFFIXES = (*TABLE_SUFFIXES, ".xml", *BINARY_SUFFIXES)
"""Every suffix that is read."""

TEXT_CONTROLS = frozenset(b"\t\n\v\f\r")
HEAD_BYTES = 4096


def detect_format(path: Path) -> str:
    """Tell a file's format.

    Parameters
    ----------
    path : Path
        The file.

    Returns
    -------
    str
        ``wav``, ``npz``, ``npy``, ``mat``, ``ide``, ``hatt``, ``lmt`` or ``table``.

    Raises
    ------
    ValueError
        If it is empty, of no known format, or text in an encoding that is not read.
    """
    with path.open("rb") as file:
        head = file.read(HEAD_BYTES)
    if not head:
        raise ValueError("got an empty file (0 bytes), allowed is a recording; copy or export it again")
    for magic, name in MAGIC.items():
        if head.startswith(magic):
            return name
    if head.startswith(HDF5):
        raise ValueError("got a MATLAB 7.3 or HDF5 file, allowed is an older MAT-file; save it with save(..., '-v7')")
    if head.startswith(WIDE_TEXT):
        raise ValueError("got text in UTF-16 or UTF-32, allowed is UTF-8; save the file as UTF-8")
    return _detect_text(path, head)


def _detect_text(path: Path, head: bytes) -> str:
    suffix = path.suffix.lower()
    is_text = all(byte >= ord(" ") or byte in TEXT_CONTROLS for byte in head)
    if suffix == ".mat" and not is_text:
        return "mat"  # version 4 has no first bytes of its own
    if not is_text:
        raise ValueError(f"got binary data of no known format (suffix {suffix!r}), allowed is {_allowed()}")
    if head.removeprefix(b"\xef\xbb\xbf").lstrip().startswith(b"<"):
        return "hatt"
    if is_lmt(path):
        return "lmt"
    if suffix in TABLE_SUFFIXES:
        return "table"
    if suffix in SUFFIXES:
        raise ValueError(f"got text in a {suffix} file; rename it to .csv if it is a table, or export it again")
    raise ValueError(f"got the unknown suffix {suffix!r}, allowed is {_allowed()}")


def _allowed() -> str:
    return " ".join(SUFFIXES)
