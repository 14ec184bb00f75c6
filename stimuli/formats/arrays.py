"""NPZ and NPY: named arrays to a recording."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from stimuli.formats.columns import AXIS, Columns, find_columns, find_time, name_units, pick_columns
from stimuli.formats.decoded import Decoded, as_three_axes, stack_axes
from stimuli.formats.errors import foreign_errors
from stimuli.formats.keys import RATE_KEYS, UNIT_KEYS, one_value
from stimuli.formats.units import ACCELERATION_SPELLINGS, parse_unit, split_unit
from stimuli.recording import AXES

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from stimuli.formats.decoded import Request

ACCELERATION_KEYS = ("acceleration", "accel", "acc", "data", "tmp")
"""Names of an array of all three axes; `tmp` is that of the LMT-69 tapping recordings."""


def read_npz(path: Path, request: Request) -> Decoded:
    """Read an NPZ archive by the names of its arrays.

    Parameters
    ----------
    path : Path
        The archive.
    request : Request
        Which arrays, rate and unit, where the archive holds several.

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
    return decode_arrays(arrays, request)


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


def decode_arrays(arrays: Mapping[str, NDArray[Any]], request: Request) -> Decoded:
    """Find samples, rate, time and unit among named arrays.

    Parameters
    ----------
    arrays : mapping of str to ndarray
        ``acceleration`` of shape (3, n) or (n, 3), or ``x``, ``y``, ``z``; beside them ``rate_hz`` (``fs``,
        ``rate``), ``time`` in s (``time_ms``...) and ``unit``.
    request : Request
        Which arrays, rate and unit, where there are several.

    Returns
    -------
    Decoded
        What they say.

    Raises
    ------
    ValueError
        If no three axes are there, what is meant cannot be told, or an array is not of numbers.
    """
    columns = {name: array for name, array in arrays.items() if array.size != 1}
    place = choose_arrays(columns, request, found=tuple(arrays))
    names = tuple(columns)
    time_s, step_s = (None, 0.0) if place.time is None else _stamps(columns, names[place.time], place)
    return Decoded(
        _stack(columns, [names[i] for i in place.axes]),
        _unit(arrays, request, by_name={names[place.axes[0]]: place.unit} if place.unit else {}),
        one_value(
            {name: _scalar(array, "the rate") for name, array in arrays.items() if name.casefold() in RATE_KEYS},
            argument="rate_hz",
            requested=request.rate_hz,
        ),
        time_s=time_s,
        time_step_s=step_s,
    )


def choose_arrays(columns: Mapping[str, NDArray[Any]], request: Request, *, found: Sequence[str]) -> Columns:
    """Choose the arrays of samples and time: as asked for, else by their names.

    Parameters
    ----------
    columns : mapping of str to ndarray
        The arrays that are no single value.
    request : Request
        What the caller says.
    found : sequence of str
        The names of all arrays, for the message.

    Returns
    -------
    Columns
        Where they stand among `columns`.

    Raises
    ------
    ValueError
        If none or several could be meant.
    """
    labels = tuple(columns)
    if request.columns is not None:
        return pick_columns(request.columns, labels=labels, n_columns=len(labels), whole=True)
    bare = [split_unit(label, ACCELERATION_SPELLINGS)[0] for label in labels]
    wholes = [i for i, name in enumerate(bare) if name.casefold() in ACCELERATION_KEYS]
    axes = {match[1].lower(): i for i, name in enumerate(bare) if (match := AXIS.fullmatch(name))}
    candidates = [*wholes, *(axes.values() if len(axes) == AXES else ())]
    if wholes and len(candidates) > 1:
        several = ", ".join(labels[i] for i in candidates)
        raise ValueError(
            f"got several arrays for the acceleration ({several}); "
            f"say which, e.g. columns=({labels[wholes[0]]!r},) or columns=(x, y, z)"
        )
    if not wholes and not axes:
        named = ", ".join(found) or "nothing"
        raise ValueError(
            f"got arrays named {named}; allowed is 'acceleration' (3, n), or 'x', 'y' and 'z', or columns=(name,)"
        )
    return name_units(labels, axes=(wholes[0],), time=find_time(labels)) if wholes else find_columns(labels)


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
    with np.errstate(over="ignore", invalid="ignore"):  # what is not finite is refused where its place is known
        return array.astype(np.float64)


def _stack(columns: Mapping[str, NDArray[Any]], names: Sequence[str]) -> NDArray[np.float64]:
    if len(names) == 1:
        return as_three_axes(as_numbers(columns[names[0]], repr(names[0])))
    return stack_axes({axis: _vector(columns[name], name) for axis, name in zip("xyz", names, strict=True)})


def _vector(array: NDArray[Any], name: str) -> NDArray[np.float64]:
    if max(array.shape) != array.size:  # MATLAB knows no vectors, only rows and columns
        raise ValueError(f"got an array of shape {array.shape} for {name!r}, allowed is one value per sample")
    return as_numbers(array.ravel(), repr(name))


def _stamps(columns: Mapping[str, NDArray[Any]], name: str, place: Columns) -> tuple[NDArray[np.float64], float]:
    stamps, second = _vector(columns[name], name), place.time_unit_s or 1.0
    coarse = columns[name].dtype.type if columns[name].dtype.kind == "f" else np.float64
    return stamps * second, float(np.spacing(coarse(np.abs(stamps).max(initial=0.0)))) * second


def _unit(arrays: Mapping[str, NDArray[Any]], request: Request, *, by_name: Mapping[str, str]) -> str | None:
    said = {name: array for name, array in arrays.items() if name.casefold() in UNIT_KEYS}
    units = {name: parse_unit(str(array.squeeze())) for name, array in said.items()}
    requested = None if request.unit is None else parse_unit(request.unit)
    return one_value({**units, **by_name}, argument="unit", requested=requested)


def _scalar(array: NDArray[Any], what: str) -> float:
    if np.size(array) != 1:
        raise ValueError(f"got {np.size(array)} values for {what}, allowed is one number")
    return float(as_numbers(np.asarray(array), what).item())
