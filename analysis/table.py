"""Ratings married to their stimuli: one tidy table, or one clear line about what is wrong.

Conventions: ratings run from 0 to 100; one row per judgement; recording, reducer, level, role and the metrics
of a stimulus come from the manifest. Nothing is repaired and nothing is dropped silently: what is left out,
or taken for granted because a column is missing, stands in `Table.notes`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from analysis.gaps import note_gaps, note_lookalikes, note_lost
from analysis.pairs import find_matched, find_roles, note_references, turn_pairs
from analysis.sheet import read_flags, read_numbers, read_sheet, refuse_lines

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

    from pandas import DataFrame, Series

LOWEST, HIGHEST = 0.0, 100.0
"""The ends of every rating scale."""

ROLES = ("test", "reference", "anchor")
NEEDED = ("participant", "stimulus_id", "scale", "rating")
JUDGEMENT = ("participant", "session", "protocol", "scale", "block", "stimulus_id", "reference_id")
"""What, with its trial, may occur once only. The stimulus belongs to it: a page of stimuli is one trial; and where
repeats are counted instead, so does what it was judged against."""

IDENTITY = ("stimulus_id", "recording", "reducer")
ECHOED = ("recording", "reducer", "level")
"""Columns that both files may hold and must then agree on."""


@dataclass(frozen=True, slots=True, eq=False)
class Table:
    """Ratings and metrics, side by side.

    Parameters
    ----------
    rows : DataFrame
        One row per judgement: participant, stimulus_id, reference_id (may be empty), recording, reducer, level, role,
        matched (whether the metrics speak of it, `find_matched`), scale, repeat, rating, simulated, response_time_s if there is one, then one column per metric. The role is the
        one that the stimulus had in that judgement (`find_roles`), and a dissimilarity is about the stimulus compared
        with the reference.
    metrics : tuple of str
        The metric columns, in the order of `stimuli.match.METRICS`.
    notes : tuple of str
        What was left out and what was assumed, one sentence each.
    """

    rows: DataFrame
    metrics: tuple[str, ...]
    notes: tuple[str, ...]


def read_table(ratings_path: Path, manifest_path: Path) -> Table:
    """Read ratings and manifest into one tidy table.

    Parameters
    ----------
    ratings_path : Path
        ``ratings.csv`` from anywhere: participant, stimulus_id, scale and rating are enough.
    manifest_path : Path
        ``manifest.csv``: stimulus_id, recording, reducer and at least one metric are enough.

    Returns
    -------
    Table
        The rows and what there is to say about them.

    Raises
    ------
    ValueError
        If a column, cell, stimulus, role or trial is not as it must be; names the file and the lines.
    OSError
        If a file cannot be opened.
    """
    manifest, metrics, notes = read_manifest(manifest_path)
    ratings, more_notes = _read_ratings(ratings_path)
    strangers = ratings.loc[~ratings["stimulus_id"].isin(manifest.index), "stimulus_id"]
    unknown = f"in column 'stimulus_id', which {manifest_path.name} does not know"
    refuse_lines(strangers, ratings_path.name, why=unknown)
    for name in [name for name in ECHOED if name in ratings]:
        differing = ratings.loc[ratings[name] != ratings["stimulus_id"].map(manifest[name]), name]
        otherwise = f"in column '{name}', but {manifest_path.name} says otherwise of that stimulus"
        refuse_lines(differing, ratings_path.name, why=otherwise)
    turned = turn_pairs(ratings, manifest, what=ratings_path.name)
    rows = turned.drop(columns=list(ECHOED), errors="ignore").join(manifest, on="stimulus_id")
    rows["role"] = find_roles(rows, manifest)
    rows["matched"] = find_matched(rows, manifest)
    notes += [*more_notes, *note_gaps(rows, manifest), *note_references(rows, manifest), *note_lookalikes(rows)]
    judged = ["role", "matched", "scale", "repeat", "rating", "simulated"]
    timed = [name for name in ("response_time_s",) if name in rows]
    order = ["participant", "stimulus_id", "reference_id", *ECHOED, *judged, *timed, *metrics]
    return Table(rows[order].reset_index(drop=True), metrics, tuple(notes))


def read_manifest(path: Path) -> tuple[DataFrame, tuple[str, ...], list[str]]:
    """Read the manifest's columns that an analysis needs.

    Parameters
    ----------
    path : Path
        ``manifest.csv``.

    Returns
    -------
    manifest : DataFrame
        Indexed by stimulus_id: recording, reducer, level, role and one column per metric.
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

    sheet = read_sheet(path, required=IDENTITY, optional=("level", "role", *METRICS))
    metrics = tuple(name for name in METRICS if name in sheet)
    if not metrics:
        raise ValueError(f"{path.name}: got no metric; at least one column of {', '.join(METRICS)} is needed")
    absent = [name for name in METRICS if name not in sheet]
    notes = [f"{path.name} has no column '{name}', so that metric is not reported." for name in absent]
    notes += _fill_column(sheet, "level", value="as_is", what=path.name)
    notes += _fill_column(sheet, "role", value="test", what=path.name)
    _check_identity(sheet, path.name)
    for name in metrics:
        sheet[name] = _read_metric(sheet, name, what=path.name)
    notes += [note for name in metrics for note in _note_excess(sheet, name)]
    return sheet.set_index("stimulus_id"), metrics, notes + _name_strangers(sheet)


def order_reducers(names: Iterable[str]) -> list[str]:
    """Put reducer names into the order of `stimuli.reduce.REDUCERS`; unknown ones follow by alphabet.

    Parameters
    ----------
    names : iterable of str
        Names, repeated or not.

    Returns
    -------
    list of str
        Each name once.

    Examples
    --------
    >>> order_reducers(["mine", "dft321", "soc321", "dft321"])
    ['soc321', 'dft321', 'mine']
    """
    from stimuli.reduce import REDUCERS

    found = set(names)
    return [name for name in REDUCERS if name in found] + sorted(found - set(REDUCERS))


def _read_ratings(path: Path) -> tuple[DataFrame, list[str]]:
    judged = ("session", "protocol", "block", "trial", "repeat", "reference_id", "rejected", "simulated")
    sheet = read_sheet(path, required=NEEDED, optional=(*judged, "response_time_s", *ECHOED))
    sheet, notes = _leave_rejected(sheet, path.name)
    for name in ("participant", "stimulus_id", "scale"):
        _check_names(sheet, name, what=path.name)
    sheet["rating"] = read_numbers(sheet["rating"], path.name)
    outside = sheet.loc[~sheet["rating"].between(LOWEST, HIGHEST), "rating"]
    refuse_lines(outside, path.name, why="in column 'rating', allowed is 0 to 100")
    sheet["simulated"] = read_flags(sheet["simulated"], path.name) if "simulated" in sheet else False
    if "reference_id" not in sheet:
        sheet["reference_id"] = ""
    if "response_time_s" in sheet:
        sheet["response_time_s"] = _read_times(sheet["response_time_s"], path.name)
    # A trial names a judgement; without trials its repeat does, and without either nothing can be told apart.
    counted = next((name for name in ("trial", "repeat") if name in sheet), None)
    if counted:
        _refuse_doubles(sheet, counted, what=path.name)
    else:
        repeats = "rows alike in participant, stimulus, reference and scale are taken as repeats"
        notes.append(f"{path.name} has no column 'trial' or 'repeat': {repeats}.")
    if "repeat" not in sheet:
        alike = ["participant", "stimulus_id", "reference_id", "scale"]
        sheet["repeat"] = (sheet.groupby(alike).cumcount() + 1).astype(str)
    return sheet, notes


def _read_times(cells: Series, what: str) -> np.ndarray:
    # A time may be unknown: it is no part of the answer.
    times = np.full(len(cells), np.nan)
    times[cells != ""] = read_numbers(cells[cells != ""], what)
    refuse_lines(cells[times < 0], what, why=f"in column '{cells.name}', allowed is 0 or more, in seconds, or nothing")
    return times


def _leave_rejected(sheet: DataFrame, what: str) -> tuple[DataFrame, list[str]]:
    if "rejected" not in sheet:
        return sheet, []
    rejected = read_flags(sheet["rejected"], what)
    if rejected.all():
        raise ValueError(f"{what}: all {len(sheet)} judgements are marked as rejected; one must be valid")
    if not rejected.any():
        return sheet, []
    notes = [f"{int(rejected.sum())} judgements marked as rejected are left out."]
    return sheet[~rejected].copy(), [*notes, *note_lost(sheet["participant"], rejected)]


def _refuse_doubles(sheet: DataFrame, counted: str, *, what: str) -> None:
    key = [name for name in (*JUDGEMENT, counted) if name in sheet]
    doubled = sheet.loc[sheet.duplicated(key), counted]
    refuse_lines(doubled, what, why=f"in column '{counted}', but an earlier line has the same {', '.join(key)}")


def _check_identity(sheet: DataFrame, what: str) -> None:
    for name in IDENTITY:
        _check_names(sheet, name, what=what)
    odd = sheet.loc[~sheet["role"].isin(ROLES), "role"]
    refuse_lines(odd, what, why=f"in column 'role', allowed is {', '.join(ROLES)}")
    doubled = sheet.loc[sheet["stimulus_id"].duplicated(), "stimulus_id"]
    refuse_lines(doubled, what, why="in column 'stimulus_id', but an earlier line lists it already")


def _check_names(sheet: DataFrame, name: str, *, what: str) -> None:
    padded = sheet.loc[sheet[name] != sheet[name].str.strip(), name]
    refuse_lines(padded, what, why=f"in column '{name}', which must not begin or end with a blank")
    refuse_lines(sheet.loc[sheet[name] == "", name], what, why=f"in column '{name}', which must not be empty")


def _fill_column(sheet: DataFrame, name: str, *, value: str, what: str) -> list[str]:
    if name in sheet:
        return []
    sheet[name] = value
    return [f"{what} has no column '{name}': every stimulus is taken as '{value}'."]


def _read_metric(sheet: DataFrame, name: str, *, what: str) -> np.ndarray:
    # The reference need not have a metric: it is what the others are matched against.
    blank = (sheet[name] == "") & (sheet["role"] != "test")
    values = np.full(len(sheet), np.nan)
    values[~blank] = read_numbers(sheet.loc[~blank, name], what)
    return values


def _note_excess(sheet: DataFrame, name: str) -> list[str]:
    above = sheet.loc[sheet[name] > 1, "stimulus_id"]
    if above.empty:
        return []
    return [f"'{name}' is above 1, which no match can be, for {len(above)} stimuli, first '{above.iloc[0]}'."]


def _name_strangers(sheet: DataFrame) -> list[str]:
    from stimuli.reduce import REDUCERS

    tests = sheet.loc[sheet["role"] == "test", "reducer"]
    strangers = sorted(set(tests) - set(REDUCERS))
    return [f"Reducers unknown to feel321, analysed as named: {', '.join(strangers)}."] if strangers else []
