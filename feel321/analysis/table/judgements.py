"""`ratings.csv` and `manifest.csv`, strictly read: every judgement and every stimulus.

Conventions: `reference_id` names another stimulus, or `surface`, or is empty. A dissimilarity has no direction, so
whichever of the two is not the reference is what the judgement is about.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from feel321.analysis.table.items import read_sources
from feel321.analysis.table.schema import (
    HIGHEST,
    LOWEST,
    STAND_INS,
    describe_explored,
    describe_further,
    describe_manifest,
    describe_ratings,
)
from feel321.analysis.table.sheet import (
    ANSWERED,
    PAIR,
    PAIRED,
    check_names,
    list_names,
    note_alike,
    note_lost,
    note_scales,
    note_underruns,
    read_flags,
    read_known,
    read_metric,
    read_numbers,
    read_sheet,
    refuse_lines,
    shorten,
)
from feel321.protocols.trial import SURFACE

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence
    from pathlib import Path

    from pandas import DataFrame, Series

# `ratings.csv`, from feel321 or from elsewhere: every judgement, strictly read.

JUDGEMENT = ("participant", "session", "protocol", "scale", "block", "stimulus_id", "reference_id")
"""What, with its trial, may occur once only. The stimulus belongs to it: a page of stimuli is one trial; and where
repeats are counted instead, so does what it was judged against."""


def read_ratings(path: Path) -> tuple[DataFrame, list[str]]:
    """Read every judgement that counts."""
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
    refuse_lines(
        outside,
        what,
        why="in column 'rating', allowed is 0 to 100; rescale what was asked on another scale",
    )
    unclear = ratings[(sheet["scale"] == ANSWERED) & ~ratings.isin([LOWEST, HIGHEST])]
    refuse_lines(
        unclear,
        what,
        why=f"in column 'rating' of scale '{ANSWERED}', allowed is 100 (right) or 0 (wrong)",
    )
    return ratings


def _read_times(cells: Series, what: str) -> Series:
    # A time may be unknown: it is no part of the answer.
    times = read_known(cells, what)
    refuse_lines(
        cells[times < 0],
        what,
        why=f"in column '{cells.name}', allowed is 0 or more, in seconds, or nothing",
    )
    return times


def _read_counts(cells: Series, what: str) -> Series:
    counts = read_numbers(cells.mask(cells == "", "0"), what)
    odd = cells[(counts < 0) | (counts % 1 != 0)]
    refuse_lines(
        odd, what, why=f"in column '{cells.name}', allowed is a count (0, 1, 2, ...) or nothing"
    )
    return counts


def _leave_rejected(sheet: DataFrame, what: str) -> tuple[DataFrame, list[str]]:
    if "rejected" not in sheet:
        return sheet, []
    rejected = read_flags(sheet["rejected"], what)
    if rejected.all():
        raise ValueError(
            f"{what}: all {len(sheet)} judgements are marked as rejected; one must be valid"
        )
    if not rejected.any():
        return sheet, []
    notes = [f"{int(rejected.sum())} judgements marked as rejected are left out."]
    return sheet[~rejected].copy(), [*notes, *note_lost(sheet["participant"], rejected)]


def _leave_simulated(sheet: DataFrame, what: str) -> tuple[DataFrame, list[str]]:
    if "simulated" not in sheet:
        return sheet.assign(simulated=False), []
    simulated = read_flags(sheet["simulated"], what)
    both = sheet.loc[
        simulated & sheet["participant"].isin(sheet.loc[~simulated, "participant"]), "participant"
    ]
    refuse_lines(
        both,
        what,
        why="in column 'participant' as simulated, but as a person in other lines; allowed is one",
    )
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


# `manifest.csv` as an analysis needs it: what every stimulus is, and how well it matches its recording.

ROLES = ("test", "reference", "anchor")
IDENTITY = ("stimulus_id", "recording", "reducer")
AMPLITUDE, GAIN, SENSATION = "rms_m_s2", "gain", "sensation_level_db"
NOT_METRICS = frozenset({
    *IDENTITY,
    "level",
    "role",
    "source",
    "file",
    "sha256",
    "recording_sha256",
})
MOSTLY = 0.5
"""Share of a column's cells that are numbers where the column is meant to hold numbers."""


def read_manifest(
    path: Path, *, sources: Mapping[str, str] | None = None, metrics: Sequence[str] | None = None
) -> tuple[DataFrame, tuple[str, ...], list[str]]:
    """Read the manifest's columns that an analysis needs.

    sources: recording -> what it was made from, where the manifest has no such column.
    """
    from feel321.stimuli.match import METRICS, PLANNED

    sheet, notes = read_sheet(path, describe_manifest(metrics or PLANNED))
    planned, more_notes = _choose_metrics(sheet, metrics, path)
    notes += more_notes
    notes += _fill_column(sheet, "level", value="as_is", what=path.name)
    notes += _fill_column(sheet, "role", value="test", what=path.name)
    _check_identity(sheet, path.name)
    for name in (*planned, *(name for name in describe_explored(planned) if name in sheet)):
        sheet[name] = _read_metric(
            sheet, name, what=path.name, needed=name in planned or name not in METRICS
        )
    if AMPLITUDE in sheet:
        sheet[AMPLITUDE] = _read_amplitude(sheet[AMPLITUDE], path.name)
    notes += _note_strength(sheet, path.name)
    sheet["source"] = read_sources(sheet, sources or {}, what=path.name)
    notes += [note for name in METRICS if name in sheet for note in _note_excess(sheet, name)]
    return sheet.set_index("stimulus_id"), planned, notes + _name_strangers(sheet)


def _choose_metrics(
    sheet: DataFrame, metrics: Sequence[str] | None, path: Path
) -> tuple[tuple[str, ...], list[str]]:
    """Find the columns that the primary analysis is about; only the default pair may be incomplete."""
    from feel321.stimuli.match import PLANNED

    if metrics is not None and tuple(metrics) != PLANNED:
        _refuse_missing(sheet, metrics, path)
        return tuple(metrics), []
    found = [name if name in sheet else STAND_INS.get(name, name) for name in PLANNED]
    if not any(name in sheet for name in found):
        allowed = f"at least one of the columns {', '.join(PLANNED)} is needed, or a metric of your own by its name"
        raise ValueError(f"{path.name}: got no metric; {allowed} (--metric); {_list_numeric(path)}")
    absent = [name for name in found if name not in sheet]
    told = [
        f"{path.name} has nothing in a column '{name}', so that metric is not reported."
        for name in absent
    ]
    return tuple(name for name in found if name in sheet), told


def _refuse_missing(sheet: DataFrame, metrics: Sequence[str], path: Path) -> None:
    if not metrics or len(set(metrics)) < len(metrics):
        raise ValueError(
            f"metrics: got {', '.join(metrics) or 'none'}, allowed is one name or more, each once"
        )
    for name in metrics:
        if name not in sheet or name in NOT_METRICS or not _is_numeric(sheet[name]):
            instead = STAND_INS.get(name)
            why = (
                f" (built before it existed: build the set again, or use {instead})"
                if instead in sheet
                else ""
            )
            what = "no numbers in column" if name in sheet else "no column"
            raise ValueError(
                f"{path.name}: got {what} {shorten(name)} as a metric{why}; {_list_numeric(path)}"
            )


def _list_numeric(path: Path) -> str:
    """List what may be used as a metric, of all columns of the file."""
    import pandas as pd

    whole = pd.read_csv(path, dtype=str, na_filter=False, encoding="utf-8-sig").loc[
        :, lambda frame: frame.ne("").any()
    ]
    names = [str(name) for name in whole if name not in NOT_METRICS and _is_numeric(whole[name])]
    return f"its numeric columns are {', '.join(names)}" if names else "it has no numeric column"


def _is_numeric(cells: Series) -> bool:
    import pandas as pd

    filled = cells[cells != ""]
    return bool(len(filled)) and bool(
        pd.to_numeric(filled, errors="coerce").notna().mean() > MOSTLY
    )


def _check_identity(sheet: DataFrame, what: str) -> None:
    for name in (*IDENTITY, "level"):
        check_names(sheet[name], what)
    odd = sheet.loc[~sheet["role"].isin(ROLES), "role"]
    refuse_lines(odd, what, why=f"in column 'role', allowed is {', '.join(ROLES)}")
    doubled = sheet.loc[sheet["stimulus_id"].duplicated(), "stimulus_id"]
    refuse_lines(
        doubled,
        what,
        why="in column 'stimulus_id', but an earlier line lists it already; keep one of them",
    )


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
    refuse_lines(
        lacking,
        what,
        why=f"in column '{name}', allowed is a finite number; mend it or leave the row out",
    )
    return read_metric(sheet[name], what)


def _read_amplitude(cells: Series, what: str) -> Series:
    # It may be unknown: only a refined metric asks for it, and does without.
    known = read_known(cells, what)
    refuse_lines(
        cells[known < 0],
        what,
        why=f"in column '{cells.name}', allowed is 0 or more, in m/s², or nothing",
    )
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
        scope = (
            "one gain for the whole set"
            if low == high
            else "one gain per recording"
            if within == 1
            else "gains"
        )
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
    from feel321.stimuli.reducers.registry import REDUCERS

    tests = sheet.loc[sheet["role"] == "test", "reducer"]
    strangers = sorted(set(tests) - set(REDUCERS))
    return (
        [f"Reducers unknown to feel321, analysed as named: {list_names(strangers)}."]
        if strangers
        else []
    )


# What was judged against what: the stimulus that a judgement is about, and the role it had there.

SURFACED, UNLISTED = "the real surface", "what the manifest does not list"
FOREIGN = "a stimulus of another recording"


def turn_pairs(ratings: DataFrame, manifest: DataFrame, *, what: str) -> DataFrame:
    """Let every dissimilarity be about the stimulus that was compared with the reference."""
    is_paired = (ratings["scale"] == PAIRED) & (ratings["reference_id"] != "")
    others = ratings.loc[is_paired, "reference_id"]
    unknown = (
        f"in column 'reference_id' of a {PAIRED}, which must be empty or a stimulus of the manifest"
    )
    refuse_lines(others[~others.isin(manifest.index)], what, why=unknown)
    backward = is_paired & (ratings["stimulus_id"].map(manifest["role"]) == "reference")
    ids = ["stimulus_id", "reference_id"]
    turned = ratings.copy()
    turned.loc[backward, ids] = ratings.loc[backward, ids[::-1]].to_numpy()
    return turned


def find_roles(rows: DataFrame, manifest: DataFrame) -> Series:
    """Find the role that each stimulus had in its judgement."""
    is_same = rows["stimulus_id"] == rows["reference_id"]
    roles = rows["role"].mask(is_same & (rows["role"] == "test"), "reference")
    is_pair = (rows["scale"] == PAIRED) & (rows["reference_id"] != "") & ~is_same
    return roles.mask(is_pair & (rows["reference_id"].map(manifest["role"]) != "reference"), PAIR)


def find_matched(rows: DataFrame, manifest: DataFrame) -> Series:
    """Tell of which judgements the metrics speak: they say how well a stimulus matches its own recording."""
    whole = {name: _tell_reference(name, manifest) for name in rows["reference_id"].unique()}
    told = rows["reference_id"].map(whole)
    return told.isin(["", SURFACED, UNLISTED]) & ~_is_foreign(rows, manifest)


def note_references(rows: DataFrame, manifest: DataFrame) -> Iterator[str]:
    """Say which judgements had another reference than the metrics have, or none that is known."""
    nameless = int(((rows["scale"] == PAIRED) & (rows["reference_id"] == "")).sum())
    if nameless:
        yield f"{nameless} judgements of scale '{PAIRED}' name no reference_id: they are taken as from the reference."
    whole = {name: _tell_reference(name, manifest) for name in rows["reference_id"].unique()}
    told = rows.assign(
        reference=rows["reference_id"].map(whole).mask(_is_foreign(rows, manifest), FOREIGN)
    )
    told = told[(told["role"] != PAIR) & (told["reference"] != "")]
    for (scale, reference), part in told.groupby(["scale", "reference"]):
        against = f"{len(part)} judgements were made against {reference}"
        fate = (
            "" if reference in {SURFACED, UNLISTED} else ": none enters an association or a slope"
        )
        yield f"Scale '{scale}': {against}; the metrics compare with the recording{fate}."


def _is_foreign(rows: DataFrame, manifest: DataFrame) -> Series:
    of_reference = rows["reference_id"].map(manifest["recording"])
    return of_reference.notna() & (of_reference != rows["recording"])


def _tell_reference(name: str, manifest: DataFrame) -> str:
    """Name a reference in words, unless it is the recording itself or nothing is said of it."""
    from feel321.stimuli.reducers.registry import REDUCERS

    if name in ("", SURFACE):
        return name and SURFACED
    if name not in manifest.index:
        return UNLISTED
    reducer, role = manifest.loc[name, ["reducer", "role"]]
    return (
        ""
        if role == "reference" and reducer not in REDUCERS
        else f"what '{reducer}' made of the recording"
    )
