"""The two CSV files of an analysis, ratings and manifest, each read and checked by itself.

What is left out, or assumed because a column is missing, becomes a note. `feel321.analysis.table.reading` joins them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from feel321.analysis.table import metrics as metrics_of
from feel321.analysis.table import notes as remarks
from feel321.analysis.table import schema
from feel321.analysis.table.items import OTHER, ROLE, STIMULUS, TEST, leave_rejected
from feel321.doors import as_names, as_path
from feel321.types import MetricInfo, PathLike

if TYPE_CHECKING:
    from pandas import DataFrame, Series

JUDGEMENT = (
    "participant",
    "session",
    "protocol",
    "scale",
    "block",
    STIMULUS,
    "reference_id",
    OTHER,
)
"""What, with its trial, may occur once only. The stimulus belongs to it: a page of stimuli is one trial; and where
repeats are counted instead, so does what it was judged against."""


@dataclass(frozen=True, slots=True, eq=False)
class Further:
    """Further metrics that neither file holds, indexed by stimulus_id, and how they were computed.

    rivals: metrics, columns of these or of the manifest, that are to be compared with those of the primary analysis.
    mountings: recording, reducer and metric with mean and quantiles over orientations of the sensor, if computed.
    labels: interaction and sample of each recording, by its name, where the manifest does not say them.
    """

    metrics: DataFrame
    notes: tuple[str, ...] = ()
    rivals: tuple[str, ...] = ()
    mountings: DataFrame | None = None
    labels: DataFrame | None = None


class Source(NamedTuple):
    """A table's file, or the table in memory, and what messages call it."""

    given: Path | DataFrame
    what: str


def open_source(given: PathLike | DataFrame, what: str) -> Source:
    """Take a path or a table, and what messages call it."""
    from pandas import DataFrame

    if isinstance(given, DataFrame):
        return Source(given, what)
    path = as_path(given, what)
    return Source(path, path.name)


# `ratings.csv`, from feel321 or from elsewhere.


def read_ratings(source: Path | DataFrame, what: str) -> tuple[DataFrame, list[str]]:
    """Read every judgement that counts."""
    columns = {**schema.RATINGS, **metrics_of.describe_further()}
    sheet, notes = schema.read_sheet(source, what, columns)
    sheet, more_notes = _leave_rejected(sheet, what)  # which needs no rating
    notes += more_notes
    for name in [str(name) for name in sheet if name != "rejected"]:
        schema.read_column(sheet, name, what, kind=columns[name].kind)
    sheet, more_notes = _leave_simulated(sheet, what)
    notes += more_notes
    unclear = sheet.loc[
        (sheet["scale"] == schema.ANSWERED)
        & ~sheet["rating"].isin([schema.LOWEST, schema.HIGHEST]),
        "rating",
    ]
    schema.refuse_lines(
        unclear, what, must=f"be 100 (right) or 0 (wrong) on scale '{schema.ANSWERED}'"
    )
    for name in ("reference_id", OTHER):
        if name not in sheet:
            sheet[name] = ""
    _check_choices(sheet, what)
    notes += [*_check_doubles(sheet, what), *remarks.note_scales(sheet)]
    if "underruns" in sheet and len(broken := sheet.loc[sheet["underruns"] > 0, "participant"]):
        notes.append(
            f"{len(broken)} judgements of {broken.nunique()} participants were made on an interrupted playback "
            "(underruns): they count; mark them as rejected to leave them out."
        )
    if "repeat" not in sheet:
        alike = ["participant", STIMULUS, "reference_id", OTHER, "scale"]
        sheet["repeat"] = (sheet.groupby(alike).cumcount() + 1).astype(str)
    return sheet, notes


def _check_choices(sheet: DataFrame, what: str) -> None:
    """Refuse choices that name no second stimulus, or no winner, and a second stimulus where nothing is chosen."""
    is_choice = sheet["scale"].isin(schema.CHOSEN)
    scales = " or ".join(map(repr, schema.CHOSEN))
    unclear = sheet.loc[
        is_choice & ~sheet["rating"].isin([schema.LOWEST, schema.HIGHEST]), "rating"
    ]
    must = f"be 100 (stimulus_id was chosen) or 0 ({OTHER} was chosen) on scale {scales}"
    schema.refuse_lines(unclear, what, must=must)
    same = (sheet[OTHER] == "") | (sheet[OTHER] == sheet[STIMULUS])
    must = f"name the second of the two stimuli on scale {scales}"
    schema.refuse_lines(sheet.loc[is_choice & same, OTHER], what, must=must)
    idle = sheet.loc[~is_choice & (sheet[OTHER] != ""), OTHER]
    schema.refuse_lines(idle, what, must=f"be empty but on scale {scales}")


def _leave_rejected(sheet: DataFrame, what: str) -> tuple[DataFrame, list[str]]:
    schema.read_column(sheet, "rejected", what, kind="flag")
    left, notes = leave_rejected(sheet, what=what)
    lost = sorted(set(sheet["participant"]) - set(left["participant"]))
    gone = f"Participants without a valid judgement, who do not count: {remarks.list_names(lost)}."
    return left.copy(), [*notes, gone] if lost else list(notes)


def _leave_simulated(sheet: DataFrame, what: str) -> tuple[DataFrame, list[str]]:
    if "simulated" not in sheet:
        return sheet.assign(simulated=False), []
    simulated, who = sheet["simulated"], sheet["participant"]
    both = who[simulated & who.isin(who[~simulated])]
    schema.refuse_lines(both, what, must="be simulated in all of its lines or in none")
    if simulated.all() or not simulated.any():
        return sheet, []
    note = (
        f"{int(simulated.sum())} judgements of {who[simulated].nunique()} simulated participants are left out, because "
        "people rated too; to analyse them, bring a table of them alone."
    )
    return sheet[~simulated].copy(), [note]


def _check_doubles(sheet: DataFrame, what: str) -> list[str]:
    """Refuse what occurs twice: a trial names a judgement; without trials its repeat does."""
    counted = next((name for name in ("trial", "repeat") if name in sheet), None)
    if not counted:
        repeats = "rows alike in participant, stimulus, reference and scale are taken as repeats"
        return [f"{what} has nothing in a column 'trial' or 'repeat': {repeats}."]
    key = [name for name in (*JUDGEMENT, counted) if name in sheet]
    doubled = sheet.loc[sheet.duplicated(key), counted]
    must = f"occur once with the same {', '.join(key[:-1])}"
    schema.refuse_lines(doubled, what, must=must, do="keep one of the lines")
    if counted == "repeat" or "repeat" not in sheet:
        return []
    if not (count := int(sheet.duplicated([*key[:-1], "repeat"]).sum())):
        return []
    return [
        f"{count} judgements differ from an earlier one in their trial only: each counts as a further repeat."
    ]


# `manifest.csv`: what every stimulus is, and how well it matches its recording.


def read_manifest(
    source: Source,
    metrics: Sequence[str] | None,
    *,
    sources: Mapping[str, str] | None,
    further: Further | None,
) -> tuple[DataFrame, tuple[str, ...], list[str]]:
    """Read the manifest's columns that an analysis needs; also the planned metrics, and notes."""
    metrics, what = None if metrics is None else as_names(metrics, "metrics"), source.what
    rivals = further.rivals if further else ()
    more = list(map(str, further.metrics)) if further else []
    columns = metrics_of.describe_manifest([*(metrics or schema.PLANNED), *rivals])
    sheet, notes = schema.read_sheet(*source, columns)
    planned, more_notes = _choose_metrics(sheet, metrics, source, more=more)
    notes += more_notes
    for name, value in (("level", "as_is"), (ROLE, TEST)):
        if name not in sheet:
            sheet[name] = value
            notes.append(
                f"{what} has nothing in a column '{name}': every stimulus is taken as '{value}'."
            )
    for name in (*schema.IDENTITY, "level"):
        schema.read_column(sheet, name, what, kind="name")
    schema.refuse_lines(
        sheet.loc[~sheet[ROLE].isin(schema.ROLES), ROLE],
        what,
        must=f"be one of {', '.join(schema.ROLES)}",
    )
    schema.refuse_doubled(sheet, STIMULUS, what)
    _read_metrics(sheet, planned, what, rivals=rivals)
    for name in schema.FACTS:
        if name not in {*planned, *rivals}:
            schema.read_column(sheet, name, what, kind=columns[name].kind)
    sheet["source"] = _read_sources(sheet, sources or {}, what)
    notes += remarks.note_stimuli(sheet)
    return sheet, planned, notes


def read_info(
    sheet: DataFrame,
    declared: Mapping[str, MetricInfo] | None,
    source: Source,
    *,
    names: Sequence[str],
) -> tuple[dict[str, MetricInfo], list[str]]:
    """Find what the metrics declare, and hold the manifest to their bounds; also note where ours are passed."""
    wanted = dict.fromkeys([*names, *metrics_of.describe_explored(())])
    given = [name for name in wanted if name in sheet or name in names]
    known, stated = metrics_of.gather_info(given, declared, source.given)
    return known, list(metrics_of.refuse_unbounded(sheet, source.what, info=known, stated=stated))


def _read_metrics(
    sheet: DataFrame, planned: Sequence[str], what: str, *, rivals: Sequence[str]
) -> None:
    known = dict.fromkeys([*planned, *rivals, *metrics_of.describe_explored(planned)])
    for name in (name for name in known if name in sheet):
        # The reference need not have a metric: it is what the others are matched against.
        if name in planned or name in metrics_of.describe_further():
            lacking = sheet.loc[(sheet[name] == "") & (sheet[ROLE] == TEST), name]
            do = "correct it or leave the row out"
            schema.refuse_lines(lacking, what, must="be a finite number", do=do)
        schema.read_column(sheet, name, what, kind="metric")


def _choose_metrics(
    sheet: DataFrame, metrics: Sequence[str] | None, source: Source, *, more: Sequence[str]
) -> tuple[tuple[str, ...], list[str]]:
    """Find the columns that the primary analysis is about; only the default pair may be incomplete."""
    if metrics is not None and tuple(metrics) != schema.PLANNED:
        _refuse_missing(sheet, metrics, source, more=more)
        return tuple(metrics), []
    found = [name if name in sheet else schema.STAND_INS.get(name, name) for name in schema.PLANNED]
    if not any(name in sheet for name in found):
        raise ValueError(
            f"{source.what}: got no metric; at least one of the columns {', '.join(schema.PLANNED)} is needed, or a "
            f"metric of your own by its name (--metric); {_list_numeric(source.given)}"
        )
    notes = [
        f"{source.what} has nothing in a column '{name}', so that metric is not reported."
        for name in found
        if name not in sheet
    ]
    return tuple(name for name in found if name in sheet), notes


def _refuse_missing(
    sheet: DataFrame, metrics: Sequence[str], source: Source, *, more: Sequence[str]
) -> None:
    if not metrics or len(set(metrics)) < len(metrics):
        raise ValueError(
            f"metrics must be one name or more, each once, got {', '.join(metrics) or 'none'}"
        )
    for name in metrics:
        if name in more or (name in sheet and name in metrics_of.list_numeric(sheet)):
            continue
        instead, why = schema.STAND_INS.get(name), ""
        if instead in sheet:
            why = f" (build the set again, or use {instead})"
        elif name in metrics_of.ROTATIONS:
            why = " (feel321 analyze computes it in a study, from the recordings that its set was built from)"
        lacks = "no numbers in column" if name in sheet else "no column"
        raise ValueError(
            f"{source.what}: got {lacks} {schema.shorten(name)} as a metric{why}; {_list_numeric(source.given)}"
        )


def _list_numeric(source: Path | DataFrame) -> str:
    """List what may be used as a metric, of all columns of the table."""
    names = metrics_of.list_numeric(schema.read_cells(source))
    return f"its numeric columns are {', '.join(names)}" if names else "it has no numeric column"


def _read_sources(sheet: DataFrame, sources: Mapping[str, str], what: str) -> Series:
    """Find what every stimulus's recording was made from."""
    if "source" not in sheet:
        return sheet["recording"].map(lambda name: sources.get(name, name))
    found = sheet["source"].mask(sheet["source"] == "", sheet["recording"])
    first = found.groupby(sheet["recording"]).transform("first")
    do = "an earlier line of its recording has another"
    schema.refuse_lines(
        found[found != first].rename("source"), what, must="be one per recording", do=do
    )
    return found
