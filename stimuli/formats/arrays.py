"""NPZ, NPY and MAT: named arrays to a recording."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from stimuli.formats.columns import AXIS, TIME
from stimuli.formats.decoded import Decoded, as_three_axes, stack_axes
from stimuli.formats.errors import foreign_errors
from stimuli.formats.units import ACCELERATION_SPELLINGS, TIME_SPELLINGS, parse_unit, split_unit

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from numpy.typing import NDArray

    from stimuli.formats.decoded import Request

ACCELERATION_KEYS = ("acceleration", "accel", "acc", "data", "tmp")
"""Names of an array of all three axes; `tmp` is that of the LMT-69 tapping recordings."""

RATE_KEYS = ("rate_hz", "fs", "rate", "sample_rate", "samplerate", "sampling_rate", "fs_hz")
UNIT_KEYS = ("unit", "units")


def read_npz(path: Path, _: Request) -> Decoded:
    """Read an NPZ archive by the names of its arrays.

    Parameters
    ----------
    path : Path
        The archive.

    Returns
    -------
    Decoded
        What its arrays say.

    Raises
    ------
    ValueError
        If the archive is damaged, or holds no three axes.
    """
    # Opened here, because numpy leaves it open when the archive is damaged.
    with foreign_errors("an NPZ archive"), path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
        arrays = {name: archive[name] for name in archive.files}
    return decode_arrays(arrays)


def read_npy(path: Path, _: Request) -> Decoded:
    """Read a single array.

    Parameters
    ----------
    path : Path
        An NPY file of shape (3, n_samples) or (n_samples, 3).

    Returns
    -------
    Decoded
        The samples; rate and unit are the caller's to give.

    Raises
    ------
    ValueError
        If the file is damaged or truncated, or holds no three axes.
    """
    # Mapped first: a header that promises more than the file holds is refused before anything is allocated.
    with foreign_errors("an NPY array"):
        array = np.array(np.load(path, mmap_mode="r", allow_pickle=False))
    return Decoded(as_three_axes(as_numbers(array, "the array")))


def read_mat(path: Path, _: Request) -> Decoded:
    """Read a MATLAB file of version 4 to 7 by the names of its variables.

    Parameters
    ----------
    path : Path
        The file.

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

    with foreign_errors("a MATLAB file"):
        variables = loadmat(path, squeeze_me=True)
    return decode_arrays({name: np.asarray(value) for name, value in variables.items() if name[:2] != "__"})


def decode_arrays(arrays: Mapping[str, NDArray[Any]]) -> Decoded:
    """Find samples, rate, time and unit among named arrays.

    Parameters
    ----------
    arrays : mapping of str to ndarray
        ``acceleration`` of shape (3, n) or (n, 3), or ``x``, ``y``, ``z``; beside them ``rate_hz`` (``fs``,
        ``rate``), ``time`` in s (``time_ms``...) and ``unit``.

    Returns
    -------
    Decoded
        What they say.

    Raises
    ------
    ValueError
        If no three axes are there, or an array is not of numbers.
    """
    named = {name.casefold(): array for name, array in arrays.items()}
    rate = next((named[key] for key in RATE_KEYS if key in named), None)
    unit = next((named[key] for key in UNIT_KEYS if key in named), None)
    time_s, step_s = _decode_time(arrays)
    return Decoded(
        _find_acceleration(arrays),
        None if unit is None else parse_unit(str(np.asarray(unit).squeeze())),
        None if rate is None else _scalar(rate, "the rate"),
        time_s=time_s,
        time_step_s=step_s,
    )


def as_numbers(array: NDArray[Any], what: str) -> NDArray[np.float64]:
    """Convert real numbers to float64; refuse texts, objects and complex numbers.

    Parameters
    ----------
    array : ndarray
        Anything.
    what : str
        What it is, for the message.

    Returns
    -------
    ndarray of float64
        The same numbers.

    Raises
    ------
    ValueError
        If they are not real numbers.
    """
    if array.dtype.kind not in "fiu":
        raise ValueError(f"got values of type {array.dtype} in {what}, allowed are real numbers")
    return array.astype(np.float64)


def _find_acceleration(arrays: Mapping[str, NDArray[Any]]) -> NDArray[np.float64]:
    for key in ACCELERATION_KEYS:
        if name := next((name for name in arrays if name.casefold() == key), None):
            return as_three_axes(as_numbers(np.squeeze(arrays[name]), repr(name)))
    axes: dict[str, NDArray[np.float64]] = {}
    for name, array in arrays.items():
        if match := AXIS.fullmatch(split_unit(name, ACCELERATION_SPELLINGS)[0]):
            axes[match[1].lower()] = as_numbers(array.ravel(), repr(name))
    if not axes:
        found = ", ".join(arrays) or "nothing"
        raise ValueError(f"got arrays named {found}; allowed is 'acceleration' (3, n), or 'x', 'y' and 'z'")
    return stack_axes(axes)


def _decode_time(arrays: Mapping[str, NDArray[Any]]) -> tuple[NDArray[np.float64] | None, float]:
    for name, array in arrays.items():
        bare, unit = split_unit(name, TIME_SPELLINGS)
        if TIME.fullmatch(bare) and array.size > 1:
            second = TIME_SPELLINGS.get(unit or "s", 1.0)
            stamps = as_numbers(array.ravel(), repr(name)) * second
            coarse = array.dtype.type if array.dtype.kind == "f" else np.float64
            return stamps, float(np.spacing(coarse(np.abs(array).max()))) * second
    return None, 0.0


def _scalar(array: NDArray[Any], what: str) -> float:
    if np.size(array) != 1:
        raise ValueError(f"got {np.size(array)} values for {what}, allowed is one number")
    return float(as_numbers(np.asarray(array), what).item())
