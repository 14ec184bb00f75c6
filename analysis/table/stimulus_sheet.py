"""`manifest.csv` as an analysis needs it: what every stimulus is, and how well it matches its recording."""

from __future__ import annotations

from typing import TYPE_CHECKING

from analysis.table.gaps import list_names
from analysis.table.schema import PRIMARY, describe_further, describe_manifest
from analysis.table.sheet import check_names, read_known, read_metric, read_sheet, refuse_lines
from analysis.table.sources import read_sources

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from pandas import DataFrame, Series

ROLES = ("test", "reference", "anchor")
IDENTITY = ("stimulus_id", "recording", "reducer")
AMPLITUDE, GAIN, SENSATION = "rms_m_s2", "gain", "sensation_level_db"


def read_manifest(
    path: Path, *, sources: Mapping[str, str] | None = None
) -> tuple[DataFrame, tuple[str, ...], list[str]]:
    """Read the manifest's columns that an analysis needs.

    Parameters
    ----------
    path : Path
        ``manifest.csv``.
    sources : Mapping of str to str, optional
        Recording -> what it was made from, where the manifest has no such column.

    Returns
    -------
    manifest : DataFrame
        Indexed by stimulus_id: recording, source, reducer, level, role, one column per metric, and, where the file has
        them, rms_m_s2, sensation_level_db, gain and further metrics (`describe_further`).
    metrics : tuple of str
        The primary metrics found, in the order of `PRIMARY`.
    notes : list of str
        What was assumed.

    Raises
    ------
    ValueError
        If a column or cell is not as it must be, or a stimulus is listed twice.
    """
    sheet, notes = read_sheet(path, describe_manifest())
    metrics = tuple(name for name in PRIMARY if name in sheet)
    if not metrics:
        allowed = f"at least one of the columns {', '.join(PRIMARY)} is needed"
        raise ValueError(f"{path.name}: got no metric; {allowed}: feel321 match computes them")
    absent = [name for name in PRIMARY if name not in sheet]
    notes += [f"{path.name} has nothing in a column '{name}', so that metric is not reported." for name in absent]
    notes += _fill_column(sheet, "level", value="as_is", what=path.name)
    notes += _fill_column(sheet, "role", value="test", what=path.name)
    _check_identity(sheet, path.name)
    for name in (*metrics, *(name for name in describe_further() if name in sheet)):
        sheet[name] = _read_metric(sheet, name, what=path.name)
    if AMPLITUDE in sheet:
        sheet[AMPLITUDE] = _read_amplitude(sheet[AMPLITUDE], path.name)
    notes += _note_strength(sheet, path.name)
    sheet["source"] = read_sources(sheet, sources or {}, what=path.name)
    notes += [note for name in metrics for note in _note_excess(sheet, name)]
    return sheet.set_index("stimulus_id"), metrics, notes + _name_strangers(sheet)


def _check_identity(sheet: DataFrame, what: str) -> None:
    for name in (*IDENTITY, "level"):
        check_names(sheet[name], what)
    odd = sheet.loc[~sheet["role"].isin(ROLES), "role"]
    refuse_lines(odd, what, why=f"in column 'role', allowed is {', '.join(ROLES)}")
    doubled = sheet.loc[sheet["stimulus_id"].duplicated(), "stimulus_id"]
    refuse_lines(doubled, what, why="in column 'stimulus_id', but an earlier line lists it already; keep one of them")


def _fill_column(sheet: DataFrame, name: str, *, value: str, what: str) -> list[str]:
    if name in sheet:
        return []
    sheet[name] = value
    return [f"{what} has nothing in a column '{name}': every stimulus is taken as '{value}'."]


def _read_metric(sheet: DataFrame, name: str, *, what: str) -> Series:
    # The reference need not have a metric: it is what the others are matched against.
    lacking = sheet.loc[(sheet[name] == "") & (sheet["role"] == "test"), name]
    refuse_lines(lacking, what, why=f"in column '{name}', allowed is a finite number; mend it or leave the row out")
    return read_metric(sheet[name], what)


def _read_amplitude(cells: Series, what: str) -> Series:
    # It may be unknown: only a refined metric asks for it, and does without.
    known = read_known(cells, what)
    refuse_lines(cells[known < 0], what, why=f"in column '{cells.name}', allowed is 0 or more, in m/s², or nothing")
    return known


def _note_strength(sheet: DataFrame, what: str) -> list[str]:
    """Read gains and sensation levels, where there are any, and say by which gains stimuli were played."""
    notes = []
    for name in (GAIN, SENSATION):
        if name in sheet:
            sheet[name] = read_known(sheet[name], what)
    as_is = sheet[sheet["level"] == "as_is"]
    if GAIN in sheet and as_is[GAIN].notna().any():
        low, high = as_is[GAIN].min(), as_is[GAIN].max()
        within = as_is.groupby("recording")[GAIN].nunique().max()
        scope = "one gain for the whole set" if low == high else "one gain per recording" if within == 1 else "gains"
        values = f"{low:.3g}" if low == high else f"{low:.3g} to {high:.3g}"
        notes.append(f"Stimuli as is were played with {scope}: {values} m/s² per m/s² recorded.")
    if SENSATION in sheet and (weak := int((sheet[SENSATION] < 0).sum())):
        notes.append(f"{weak} of {len(sheet)} stimuli were played below the detection threshold.")
    return notes


def _note_excess(sheet: DataFrame, name: str) -> list[str]:
    above = sheet.loc[sheet[name] > 1, "stimulus_id"]
    if above.empty:
        return []
    first = list_names([above.iloc[0]])
    return [f"'{name}' is above 1, which no match can be, for {len(above)} stimuli, first {first}."]


def _name_strangers(sheet: DataFrame) -> list[str]:
    from stimuli.reduce import REDUCERS

    tests = sheet.loc[sheet["role"] == "test", "reducer"]
    strangers = sorted(set(tests) - set(REDUCERS))
    return [f"Reducers unknown to feel321, analysed as named: {list_names(strangers)}."] if strangers else []
