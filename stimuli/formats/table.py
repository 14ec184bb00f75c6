"""CSV, TSV and TXT tables: a header or column numbers, a time column or a given rate."""

from __future__ import annotations

from decimal import Decimal
from typing import TYPE_CHECKING

import numpy as np

from stimuli.formats.columns import Columns, count_columns, find_columns, pick_columns
from stimuli.formats.decoded import Decoded
from stimuli.formats.text import Table, lay_out, read_numbers, read_text, split_row

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from stimuli.formats.decoded import Request

CLUSTER_LABELS = ("time", "X", "Y", "Z")
CLUSTER_RATE_HZ = 6000.0
CLUSTER_NOTE = (
    "header and rate are those of the Cluster Haptic Texture Database: unit taken as g (unit=... says otherwise)"
)


def read_table(path: Path, request: Request) -> Decoded:
    """Read three columns of acceleration, and time if there is a column for it.

    Parameters
    ----------
    path : Path
        A delimited text file.
    request : Request
        Columns as the caller names them; the rate where no column holds time.

    Returns
    -------
    Decoded
        Samples, time stamps and the unit named by the header.

    Raises
    ------
    ValueError
        If the columns cannot be told, or a cell is no number; the line is named.
    """
    table = lay_out(read_text(path))
    columns = choose_columns(table, request)
    if columns.time is None:
        return Decoded(read_numbers(table, columns.axes), columns.unit, first_line=table.first_line)
    values = read_numbers(table, (columns.time, *columns.axes))
    second = columns.time_unit_s or 1.0
    time_s = values[0] * second
    unit, notes = columns.unit, _time_notes(columns, time_s)
    if request.unit is None and unit is None and _is_cluster(table, time_s):
        unit, notes = "g", (*notes, CLUSTER_NOTE)
    return Decoded(
        values[1:],
        unit,
        time_s=time_s,
        time_step_s=second * _printed_step(table, columns.time),
        first_line=table.first_line,
        notes=notes,
    )


def choose_columns(table: Table, request: Request) -> Columns:
    """Choose the columns: as asked for, else by the header, else the only three.

    Parameters
    ----------
    table : Table
        The layout.
    request : Request
        What the caller says.

    Returns
    -------
    Columns
        Where the samples stand.
    """
    if request.columns is not None:
        return pick_columns(request.columns, labels=table.labels, n_columns=table.n_columns)
    return find_columns(table.labels) if table.labels else count_columns(table.n_columns)


def _printed_step(table: Table, column: int) -> float:
    """Return the last printed place of the time stamps: where they are longest, at the end, many at once."""
    rows = table.text.rsplit("\n", 100)[-100:]
    cells = [split_row(row, table.delimiter)[column].replace(table.decimal, ".") for row in rows]
    places = [Decimal(cell).as_tuple().exponent for cell in cells]
    return float(10.0 ** min(place for place in places if isinstance(place, int)))


def _time_notes(columns: Columns, time_s: NDArray[np.float64]) -> tuple[str, ...]:
    """Notice milliseconds that pass for seconds: no vibration is sampled that slowly."""
    slowest_hz = 40.0  # twice the 20 Hz where the match metrics begin
    if columns.time_unit_s is not None or time_s.size < 2 or np.ptp(time_s) <= 0:  # noqa: PLR2004 - an interval
        return ()
    rate_hz = (time_s.size - 1) / float(np.ptp(time_s))
    if rate_hz >= slowest_hz:
        return ()
    note = f"the time column names no unit: taken as s, which gives {rate_hz:g} Hz; if it is ms, call it time_ms"
    return (note,)


def _is_cluster(table: Table, time_s: NDArray[np.float64]) -> bool:
    if table.labels != CLUSTER_LABELS or np.ptp(time_s) <= 0:
        return False
    rate_hz = (time_s.size - 1) / float(np.ptp(time_s))
    return abs(rate_hz / CLUSTER_RATE_HZ - 1) < 0.1  # noqa: PLR2004 - nominal, so a tenth either way
