"""Which columns hold x, y, z and time: by name, by number, never by guess."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

from stimuli.formats.decoded import already_reduced
from stimuli.formats.units import ACCELERATION_SPELLINGS, TIME_SPELLINGS, parse_unit, split_unit
from stimuli.recording import AXES

SENSOR = r"(?:a|acc|accel|acceleration|accelerometer)"
AXIS = re.compile(rf"(?:linear[\s_.-]*)?{SENSOR}?[\s_.-]*([xyz])[\s_.-]*(?:{SENSOR}|axis)?", re.IGNORECASE)
TIME = re.compile(r"t|time|times|time[\s_]?stamps?", re.IGNORECASE)
WITH_TIME = AXES + 1


@dataclass(frozen=True, slots=True)
class Columns:
    """Where the samples and the time stamps stand.

    Parameters
    ----------
    axes : tuple of int
        The columns of x, y, z, counted from 0; only one where it holds all three, as arrays may.
    time : int, optional
        The column of the time stamps.
    unit : str, optional
        The unit named by the columns, a key of `stimuli.recording.UNITS`.
    time_unit_s : float, optional
        Size of the named unit of time in s; None where the column names none.
    """

    axes: tuple[int, ...]
    time: int | None = None
    unit: str | None = None
    time_unit_s: float | None = None


def find_columns(labels: Sequence[str]) -> Columns:
    """Find x, y, z and time by their labels.

    Parameters
    ----------
    labels : sequence of str
        The header, such as ``time_s, x_g, y_g, z_g``.

    Returns
    -------
    Columns
        Where they stand.

    Raises
    ------
    ValueError
        If an axis is missing or stands there twice, or the units differ or are unknown.

    Examples
    --------
    >>> find_columns(["t", "ax", "ay", "az"]).axes
    (1, 2, 3)
    """
    time = find_time(labels)
    found: dict[str, list[int]] = {"x": [], "y": [], "z": []}
    for i, label in enumerate(labels):
        if match := AXIS.fullmatch(split_unit(label, ACCELERATION_SPELLINGS)[0]):
            found[match[1].lower()].append(i)
    _check_axes_found(labels, found=found, time=time)
    axes = (found["x"][0], found["y"][0], found["z"][0])
    return name_units(labels, axes=axes, time=time)


def find_time(labels: Sequence[str]) -> int | None:
    """Find the time stamps by their label.

    Parameters
    ----------
    labels : sequence of str
        The header, or the names of arrays.

    Returns
    -------
    int or None
        Where they stand; None where nothing is called time.

    Raises
    ------
    ValueError
        If several are.
    """
    times = [i for i, label in enumerate(labels) if TIME.fullmatch(split_unit(label, TIME_SPELLINGS)[0])]
    _refuse_several(labels, what="time", places=times)
    return times[0] if times else None


def name_units(labels: Sequence[str], *, axes: tuple[int, ...], time: int | None) -> Columns:
    """Add the units that the labels of the chosen columns name.

    Parameters
    ----------
    labels : sequence of str
        The header, or the names of arrays.
    axes : tuple of int
        The columns of x, y, z.
    time : int or None
        The column of the time stamps.

    Returns
    -------
    Columns
        The same columns with their units.

    Raises
    ------
    ValueError
        If the units of the axes differ, or a unit is unknown.
    """
    for i in axes:
        if unit := split_unit(labels[i], ACCELERATION_SPELLINGS)[1]:
            parse_unit(unit)  # a bracket that is no unit may say volts: only columns=... overrules it
    return _with_units(labels, axes=axes, time=time)


def count_columns(n_columns: int) -> Columns:
    """Take three unlabelled columns as x, y, z; refuse any other number.

    Parameters
    ----------
    n_columns : int
        Number of columns of a table without a header.

    Returns
    -------
    Columns
        The three columns.

    Raises
    ------
    ValueError
        If there are not exactly three.
    """
    if n_columns == AXES:
        return Columns((0, 1, 2))
    if n_columns == 1:
        raise already_reduced("one column without a header")
    if n_columns < AXES:
        raise ValueError(f"got {n_columns} columns without a header, allowed is three axes x, y, z")
    raise ValueError(
        f"got {n_columns} columns without a header, which is ambiguous; "
        "say which they are, e.g. columns=(0, 1, 2, 3) for time, x, y, z or columns=(0, 1, 2) for x, y, z"
    )


def pick_columns(
    wanted: Sequence[str | int], *, labels: Sequence[str] | None, n_columns: int, whole: bool = False
) -> Columns:
    """Take the columns that the caller names.

    Parameters
    ----------
    wanted : sequence of str or int
        (x, y, z) or (time, x, y, z), by label or by number from 0.
    labels : sequence of str or None
        The header, if there is one.
    n_columns : int
        Number of columns of the table.
    whole : bool
        Whether one column may hold all three axes, as an array may: (acceleration,) or (time, acceleration).

    Returns
    -------
    Columns
        Where they stand.

    Raises
    ------
    ValueError
        If the number of columns is wrong, one is not there, or one is named twice.
    """
    counts = {1, 2, AXES, WITH_TIME} if whole else {AXES, WITH_TIME}
    if isinstance(wanted, str) or not isinstance(wanted, Sequence) or len(wanted) not in counts:
        more = "(acceleration,), (time, acceleration), " if whole else ""
        raise ValueError(f"got columns={wanted!r}, allowed is {more}(x, y, z) or (time, x, y, z)")
    places = tuple(_place(column, labels=labels, n_columns=n_columns) for column in wanted)
    if len(set(places)) < len(places):
        raise ValueError(f"got columns={tuple(wanted)!r}, which name one column twice; allowed is each one once")
    time, axes = (places[0], places[1:]) if len(places) in {2, WITH_TIME} else (None, places)
    return _with_units(labels, axes=axes, time=time) if labels else Columns(axes, time)


def _place(column: str | int, *, labels: Sequence[str] | None, n_columns: int) -> int:
    names = [label.strip().casefold() for label in labels or ()]
    if isinstance(column, str) and names.count(column.strip().casefold()) == 1:
        return names.index(column.strip().casefold())
    # The command line knows text only, so a number may come as text.
    if str(column).isdecimal() and int(column) < n_columns:
        return int(column)
    known = f"{', '.join(labels)}, or " if labels else ""
    raise ValueError(f"got the column {column!r}, allowed is {known}a number from 0 to {n_columns - 1}")


def _refuse_several(labels: Sequence[str], *, what: str, places: list[int]) -> None:
    if len(places) > 1:
        both = ", ".join(labels[i] for i in places)
        raise ValueError(f"got several columns for {what} ({both}); say which, columns=(time, x, y, z)")


def _check_axes_found(labels: Sequence[str], *, found: dict[str, list[int]], time: int | None) -> None:
    header = ", ".join(labels)
    for axis, places in found.items():
        _refuse_several(labels, what=axis, places=places)
    present = [axis for axis, places in found.items() if places]
    if len(present) == AXES:
        return
    if len(labels) - (time is not None) == 1:
        raise already_reduced(f"the columns {header}")
    missing = "no columns named x, y, z" if not present else f"only the axes {', '.join(present)}"
    raise ValueError(
        f"got {missing} in the header ({header}); allowed is three axes, named e.g. x, acc_y, az (m/s^2) "
        "or given as columns=(time, x, y, z)"
    )


def _with_units(labels: Sequence[str], *, axes: tuple[int, ...], time: int | None) -> Columns:
    units = {split_unit(labels[i], ACCELERATION_SPELLINGS)[1] for i in axes}
    named = {ACCELERATION_SPELLINGS.get(unit or "") for unit in units}
    if len(named) > 1:
        header = ", ".join(labels[i] for i in axes)
        raise ValueError(f"got axes in different units ({header}), allowed is one unit for all three")
    time_unit_s = None if time is None else _time_unit(labels[time])
    return Columns(axes, time, named.pop(), time_unit_s)


def _time_unit(label: str) -> float | None:
    unit = split_unit(label, TIME_SPELLINGS)[1]
    if unit is None:
        return None
    if unit not in TIME_SPELLINGS:
        raise ValueError(f"got the time column {label!r}, allowed units are s, ms, us, ns")
    return TIME_SPELLINGS[unit]
