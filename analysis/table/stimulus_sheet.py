"""`manifest.csv` as an analysis needs it: what every stimulus is, and how well it matches its recording."""

from __future__ import annotations

from typing import TYPE_CHECKING

from analysis.table.gaps import list_names
from analysis.table.schema import PLANNED, STAND_INS, describe_explored, describe_manifest
from analysis.table.sheet import check_names, read_known, read_metric, read_sheet, refuse_lines, shorten
from analysis.table.sources import read_sources

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from pandas import DataFrame, Series

ROLES = ("test", "reference", "anchor")
IDENTITY = ("stimulus_id", "recording", "reducer")
AMPLITUDE, GAIN, SENSATION = "rms_m_s2", "gain", "sensation_level_db"
NOT_METRICS = frozenset({*IDENTITY, "level", "role", "source", "file", "sha256", "recording_sha256"})
MOSTLY = 0.5
"""Share of a column's cells that are numbers where the column is meant to hold numbers."""


def read_manifest(
    path: Path, *, sources: Mapping[str, str] | None = None, metrics: Sequence[str] | None = None
) -> tuple[DataFrame, tuple[str, ...], list[str]]:
    """Read the manifest's columns that an analysis needs.

    Parameters
    ----------
    path : Path
        ``manifest.csv``.
    sources : Mapping of str to str, optional
        Recording -> what it was made from, where the manifest has no such column.
    metrics : sequence of str, optional
        Columns that the primary analysis is about; `PLANNED` if left out.

    Returns
    -------
    manifest : DataFrame
        Indexed by stimulus_id: recording, source, reducer, level, role, one column per metric, and, where the file has
        them, rms_m_s2, sensation_level_db, gain and metrics that are explored (`describe_explored`).
    metrics : tuple of str
        The metrics of the primary analysis.
    notes : list of str
        What was assumed.

    Raises
    ------
    ValueError
        If a column or cell is not as it must be, a stimulus is listed twice, or a metric is missing.
    """
    from stimuli.match import METRICS

    sheet, notes = read_sheet(path, describe_manifest(metrics or PLANNED))
    planned, more_notes = _choose_metrics(sheet, metrics, path)
    notes += more_notes
    notes += _fill_column(sheet, "level", value="as_is", what=path.name)
    notes += _fill_column(sheet, "role", value="test", what=path.name)
    _check_identity(sheet, path.name)
    for name in (*planned, *(name for name in describe_explored(planned) if name in sheet)):
        sheet[name] = _read_metric(sheet, name, what=path.name, needed=name in planned or name not in METRICS)
    if AMPLITUDE in sheet:
        sheet[AMPLITUDE] = _read_amplitude(sheet[AMPLITUDE], path.name)
    notes += _note_strength(sheet, path.name)
    sheet["source"] = read_sources(sheet, sources or {}, what=path.name)
    notes += [note for name in METRICS if name in sheet for note in _note_excess(sheet, name)]
    return sheet.set_index("stimulus_id"), planned, notes + _name_strangers(sheet)


def _choose_metrics(sheet: DataFrame, metrics: Sequence[str] | None, path: Path) -> tuple[tuple[str, ...], list[str]]:
    """Find the columns that the primary analysis is about; only the default pair may be incomplete."""
    if metrics is not None and tuple(metrics) != PLANNED:
        _refuse_missing(sheet, metrics, path)
        return tuple(metrics), []
    found = [name if name in sheet else STAND_INS.get(name, name) for name in PLANNED]
    if not any(name in sheet for name in found):
        allowed = f"at least one of the columns {', '.join(PLANNED)} is needed, or a metric of your own by its name"
        raise ValueError(f"{path.name}: got no metric; {allowed} (--metric); {_list_numeric(path)}")
    absent = [name for name in found if name not in sheet]
    told = [f"{path.name} has nothing in a column '{name}', so that metric is not reported." for name in absent]
    return tuple(name for name in found if name in sheet), told


def _refuse_missing(sheet: DataFrame, metrics: Sequence[str], path: Path) -> None:
    if not metrics or len(set(metrics)) < len(metrics):
        raise ValueError(f"metrics: got {', '.join(metrics) or 'none'}, allowed is one name or more, each once")
    for name in metrics:
        if name not in sheet or name in NOT_METRICS or not _is_numeric(sheet[name]):
            instead = STAND_INS.get(name)
            why = f" (built before it existed: build the set again, or use {instead})" if instead in sheet else ""
            what = "no numbers in column" if name in sheet else "no column"
            raise ValueError(f"{path.name}: got {what} {shorten(name)} as a metric{why}; {_list_numeric(path)}")


def _list_numeric(path: Path) -> str:
    """List what may be used as a metric, of all columns of the file."""
    import pandas as pd

    whole = pd.read_csv(path, dtype=str, na_filter=False, encoding="utf-8-sig").loc[:, lambda frame: frame.ne("").any()]
    names = [str(name) for name in whole if name not in NOT_METRICS and _is_numeric(whole[name])]
    return f"its numeric columns are {', '.join(names)}" if names else "it has no numeric column"


def _is_numeric(cells: Series) -> bool:
    import pandas as pd

    filled = cells[cells != ""]
    return bool(len(filled)) and bool(pd.to_numeric(filled, errors="coerce").notna().mean() > MOSTLY)


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


def _read_metric(sheet: DataFrame, name: str, *, what: str, needed: bool) -> Series:
    # The reference need not have a metric: it is what the others are matched against.
    if not needed:
        return read_metric(sheet[name], what)
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
