"""`manifest.csv` as an analysis needs it: what every stimulus is, and how well it matches its recording."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from analysis.gaps import list_names
from analysis.schema import MANIFEST, Column
from analysis.sheet import check_names, read_numbers, read_sheet, refuse_lines
from analysis.sources import read_sources

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from pandas import DataFrame

ROLES = ("test", "reference", "anchor")
IDENTITY = ("stimulus_id", "recording", "reducer")
LARGEST = 1e12
"""What no metric reaches in size; squares of much larger numbers are no numbers any more."""


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
        Indexed by stimulus_id: recording, source, reducer, level, role and one column per metric.
    metrics : tuple of str
        The metrics found, in the order of `stimuli.match.METRICS`.
    notes : list of str
        What was assumed.

    Raises
    ------
    ValueError
        If a column or cell is not as it must be, or a stimulus is listed twice.
    """
    from stimuli.match import METRICS

    known = {name: Column("how well a stimulus matches its recording") for name in METRICS}
    sheet, notes = read_sheet(path, {**MANIFEST, **known})
    metrics = tuple(name for name in METRICS if name in sheet)
    if not metrics:
        allowed = f"at least one of the columns {', '.join(METRICS)} is needed"
        raise ValueError(f"{path.name}: got no metric; {allowed}: feel321 match computes them")
    absent = [name for name in METRICS if name not in sheet]
    notes += [f"{path.name} has nothing in a column '{name}', so that metric is not reported." for name in absent]
    notes += _fill_column(sheet, "level", value="as_is", what=path.name)
    notes += _fill_column(sheet, "role", value="test", what=path.name)
    _check_identity(sheet, path.name)
    for name in metrics:
        sheet[name] = _read_metric(sheet, name, what=path.name)
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


def _read_metric(sheet: DataFrame, name: str, *, what: str) -> np.ndarray:
    # The reference need not have a metric: it is what the others are matched against.
    blank = (sheet[name] == "") & (sheet["role"] != "test")
    values = np.full(len(sheet), np.nan)
    values[~blank] = read_numbers(sheet.loc[~blank, name], what)
    huge = sheet.loc[np.abs(values) > LARGEST, name]
    refuse_lines(huge, what, why=f"in column '{name}', allowed is 1 or less and no more than {LARGEST:g} in size")
    return values


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
