"""`ratings.csv`, from feel321 or from elsewhere: every judgement, strictly read."""

from __future__ import annotations

from typing import TYPE_CHECKING

from analysis.table.gaps import note_alike, note_lost, note_scales, note_underruns
from analysis.table.scales import ANSWERED
from analysis.table.schema import HIGHEST, LOWEST, describe_further, describe_ratings
from analysis.table.sheet import (
    check_names,
    read_flags,
    read_known,
    read_metric,
    read_numbers,
    read_sheet,
    refuse_lines,
)

if TYPE_CHECKING:
    from pathlib import Path

    from pandas import DataFrame, Series

JUDGEMENT = ("participant", "session", "protocol", "scale", "block", "stimulus_id", "reference_id")
"""What, with its trial, may occur once only. The stimulus belongs to it: a page of stimuli is one trial; and where
repeats are counted instead, so does what it was judged against."""


def read_ratings(path: Path) -> tuple[DataFrame, list[str]]:
    """Read every judgement that counts.

    Parameters
    ----------
    path : Path
        ``ratings.csv``.

    Returns
    -------
    sheet : DataFrame
        Indexed by line number; the columns of `describe_ratings` that there are and that are used, and reference_id,
        repeat and simulated in any case.
    notes : list of str
        What was left out or assumed.

    Raises
    ------
    ValueError
        If a column or cell is not as it must be, or a judgement occurs twice; names the lines.
    OSError
        If the file cannot be opened.
    """
    sheet, notes = read_sheet(path, describe_ratings())
    sheet, more_notes = _leave_rejected(sheet, path.name)
    notes += more_notes
    for name in ("participant", "stimulus_id", "scale"):
        check_names(sheet[name], path.name)
    sheet["rating"] = _read_ratings(sheet, path.name)
    sheet, more_notes = _leave_simulated(sheet, path.name)
    notes += more_notes
    if "reference_id" not in sheet:
        sheet["reference_id"] = ""
    if "response_time_s" in sheet:
        sheet["response_time_s"] = _read_times(sheet["response_time_s"], path.name)
    for name in (name for name in describe_further() if name in sheet):
        sheet[name] = read_metric(sheet[name], path.name)
    notes += [*_tell_apart(sheet, path.name), *note_scales(sheet)]
    if "underruns" in sheet:
        notes += note_underruns(sheet.assign(underruns=_read_counts(sheet["underruns"], path.name)))
    if "repeat" not in sheet:
        alike = ["participant", "stimulus_id", "reference_id", "scale"]
        sheet["repeat"] = (sheet.groupby(alike).cumcount() + 1).astype(str)
    return sheet, notes


def _read_ratings(sheet: DataFrame, what: str) -> Series:
    ratings = read_numbers(sheet["rating"], what)
    outside = ratings[~ratings.between(LOWEST, HIGHEST)]
    refuse_lines(outside, what, why="in column 'rating', allowed is 0 to 100; rescale what was asked on another scale")
    unclear = ratings[(sheet["scale"] == ANSWERED) & ~ratings.isin([LOWEST, HIGHEST])]
    refuse_lines(unclear, what, why=f"in column 'rating' of scale '{ANSWERED}', allowed is 100 (right) or 0 (wrong)")
    return ratings


def _read_times(cells: Series, what: str) -> Series:
    # A time may be unknown: it is no part of the answer.
    times = read_known(cells, what)
    refuse_lines(cells[times < 0], what, why=f"in column '{cells.name}', allowed is 0 or more, in seconds, or nothing")
    return times


def _read_counts(cells: Series, what: str) -> Series:
    counts = read_numbers(cells.mask(cells == "", "0"), what)
    odd = cells[(counts < 0) | (counts % 1 != 0)]
    refuse_lines(odd, what, why=f"in column '{cells.name}', allowed is a count (0, 1, 2, ...) or nothing")
    return counts


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


def _leave_simulated(sheet: DataFrame, what: str) -> tuple[DataFrame, list[str]]:
    if "simulated" not in sheet:
        return sheet.assign(simulated=False), []
    simulated = read_flags(sheet["simulated"], what)
    both = sheet.loc[simulated & sheet["participant"].isin(sheet.loc[~simulated, "participant"]), "participant"]
    refuse_lines(both, what, why="in column 'participant' as simulated, but as a person in other lines; allowed is one")
    if simulated.all() or not simulated.any():
        return sheet.assign(simulated=simulated), []
    people = sheet.loc[simulated, "participant"].nunique()
    note = (
        f"{int(simulated.sum())} judgements of {people} simulated participants are left out, because people rated too; "
        "to analyse them, bring a table of them alone."
    )
    return sheet[~simulated].assign(simulated=False), [note]


def _tell_apart(sheet: DataFrame, what: str) -> list[str]:
    """Refuse what occurs twice: a trial names a judgement; without trials its repeat does."""
    counted = next((name for name in ("trial", "repeat") if name in sheet), None)
    if not counted:
        repeats = "rows alike in participant, stimulus, reference and scale are taken as repeats"
        return [f"{what} has nothing in a column 'trial' or 'repeat': {repeats}."]
    check_names(sheet[counted], what)
    key = [name for name in (*JUDGEMENT, counted) if name in sheet]
    doubled = sheet.loc[sheet.duplicated(key), counted]
    earlier = f"but an earlier line has the same {', '.join(key)}; keep one of them"
    refuse_lines(doubled, what, why=f"in column '{counted}', {earlier}")
    if counted == "repeat" or "repeat" not in sheet:
        return []
    check_names(sheet["repeat"], what)
    return list(note_alike(sheet, [*key[:-1], "repeat"]))
