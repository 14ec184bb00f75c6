"""Ratings joined with their stimuli, labels and further metrics: one tidy table, or one clear line about what is wrong.

Conventions: ratings run from 0 to 100; one row per judgement; recording, reducer, level, role and the metrics of a
stimulus come from the manifest. `reference_id` names another stimulus, or `surface`, or is empty. Factors in which
participants differ come from `participants.csv`; no test compares groups of people. Nothing is repaired and nothing is
dropped silently: what is left out, or assumed because a column is missing, is in `Table.notes`.

Any numeric column of the manifest is a metric. A stimulus has further metrics from the manifest, from the ratings (the
mean over its judgements), or from the caller. They are explored, so no primary analysis and no correction for several
tests holds them, unless the analysis declares them as its metrics.
"""

from __future__ import annotations

import csv
import os
import unicodedata
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pandas import DataFrame, Series

from feel321.analysis.table import columns as columns_of
from feel321.analysis.table import schema
from feel321.analysis.table.items import OTHER, ROLE, STIMULUS, TEST, Table, leave_rejected
from feel321.analysis.table.schema import refuse_lines, shorten
from feel321.analysis.words import name_some
from feel321.arguments import as_names, as_path, describe
from feel321.files import open_text
from feel321.types import REDUCER_NAMES, MetricInfo, PathLike

# Tables of a study, in its folder
RATINGS_FILE, MANIFEST_FILE = "ratings.csv", "stimuli/manifest.csv"
ROSTER_FILE = "participants.csv"
# Columns on what the participants felt the stimuli on, and what they are in words
RIG = {"rig": "rig", "calibration": "certificate of calibration"}
# Columns on the progress of a participant; all others, but for the participant's name, are labels
ROSTER = frozenset({
    "number", "simulated", "state", "sessions", "answered", "given_up", "total",
    "first_utc", "last_utc", "training_passed", *RIG,
})  # fmt: skip
# Columns that judgements keep where there are any
OPTIONAL = (
    "protocol", "response_time_s", schema.AMPLITUDE, schema.SENSATION, schema.ERROR, schema.SOURCE,
)  # fmt: skip
# What, with its trial, may occur once only. The stimulus belongs to it: a page of stimuli is one trial; and where
# repeats are counted instead, so does what it was judged against.
JUDGEMENT = (
    "participant", "session", "protocol", "scale", "block", STIMULUS, "reference_id", OTHER,
)  # fmt: skip
CROWDED = 0.2  # Share of ratings at the ends of the scale from which they are said to crowd there
SHORT = 10  # Points below which a scale's highest rating makes one doubt that it went to 100
SPACE = "Where a map of the dissimilarities can be made, see The space of what was felt."
SURFACED, UNLISTED = "the real surface", "what the manifest does not list"
FOREIGN = "a stimulus of another recording"


@dataclass(frozen=True, slots=True, eq=False)
class Further:
    """Further metrics that neither file holds, indexed by stimulus_id, and how they were computed.

    mountings: recording, reducer and metric with mean and quantiles over orientations of the sensor, if computed.
    """

    metrics: DataFrame
    notes: tuple[str, ...] = ()
    mountings: DataFrame | None = None


def read_table(
    ratings: PathLike | DataFrame,
    manifest: PathLike | DataFrame | None = None,
    *,
    metrics: Sequence[str] | None = None,
    sources: Mapping[str, str] | None = None,
    further: Further | None = None,
    info: Mapping[str, MetricInfo] | None = None,
) -> Table:
    """Read ratings and manifest into one tidy table.

    Parameters
    ----------
    ratings : path or DataFrame
        ``ratings.csv`` from anywhere: participant, stimulus_id, scale and rating are enough. Labels of the participants
        are read from ``participants.csv`` beside it, if there is one. Or a study's folder, which holds both tables.
    manifest : path or DataFrame, optional
        ``manifest.csv``: stimulus_id, recording, reducer and at least one metric are enough. Left out for a study.
    metrics : sequence of str, optional
        Numeric columns of the manifest, or of `further`, that the primary analysis is about; if left out,
        ``spectral_match_bounded`` (``spectral_match`` where missing) and ``temporal_match``. Others are explored.
    sources : Mapping of str to str, optional
        Recording -> what it was made from, where several are one, turned, cut or edited, and the manifest has no column
        ``source`` that says so.
    further : Further, optional
        Metrics that neither file holds: those named in `metrics` are planned, the others are explored.
    info : Mapping of str to MetricInfo, optional
        What metrics declare: which way each points, its bounds, label and unit. ``manifest.json`` beside the manifest
        may say it too; nothing said: higher is better, no bounds. A value beyond a declared bound is refused.

    Returns
    -------
    Table
        The rows, and notes on them.
    """
    if manifest is None:
        ratings, manifest = find_tables(ratings)
    (judged, what), (listed, where) = _open(ratings, "ratings"), _open(manifest, "manifest")
    given = further or Further(DataFrame())
    stimuli, planned, notes = _read_manifest(listed, where, metrics=metrics, given=given)
    known = [*planned, *columns_of.describe_explored(planned)]
    held = [name for name in known if name in stimuli or name in planned]
    declared, stated = columns_of.gather_info(held, info, listed)
    notes += columns_of.refuse_unbounded(stimuli, where, info=declared, stated=stated)
    _add_sources(stimuli, where, sources or {})
    stimuli = stimuli.set_index(STIMULUS)
    rows, more_notes = read_ratings(judged, what)
    _check_stimuli(rows, stimuli, what=what, listed=where)
    stimuli, joined = _join_further(stimuli, rows, given, what=what, listed=where)
    notes += [*given.notes, *joined, *more_notes]
    rows, told = _join_stimuli(rows, stimuli, what)
    notes += [*note_gaps(rows, stimuli, planned), *note_scales(rows)]
    notes += [*told, *note_sources(rows), *note_lookalikes(rows)]
    explored = _choose_further(rows, planned, given=given)
    columns = [*planned, *explored]
    optional = [name for name in OPTIONAL if name in rows and name not in columns]
    rows = rows[[
        "participant", STIMULUS, "reference_id", "reference_reducer", OTHER, "source", *schema.NAMING, ROLE, "matched",
        "scale", "repeat", "rating", "simulated", *optional, *columns,
    ]].reset_index(drop=True)  # fmt: skip
    rows = _join_roster(rows, judged, notes)
    sheet = stimuli[["source", *schema.NAMING, ROLE, *columns]]
    if (rows["scale"] == schema.PAIRED).any():
        more = columns_of.read_attributes(listed)
        sheet = sheet.join(more[[name for name in more if name not in sheet]])
    return Table(rows, planned, tuple(notes), explored, declared, sheet)


def find_tables(ratings: PathLike | DataFrame) -> tuple[Path, Path]:
    """Find the tables of a study, by its folder or its ratings."""
    if not isinstance(ratings, str | os.PathLike):
        got = f"got {describe(ratings)}; give the manifest too, a path or a DataFrame"
        raise TypeError(f"ratings must be a path, of a study, where no manifest is given, {got}")
    path = as_path(ratings, "ratings")
    if not path.is_file():
        return path / RATINGS_FILE, path / MANIFEST_FILE
    for manifest in (path.with_name("manifest.csv"), path.parent / MANIFEST_FILE):
        if manifest.is_file():
            return path, manifest
    why = "no manifest.csv beside it, nor stimuli/manifest.csv"
    raise FileNotFoundError(f"{path}: {why}; pass the manifest as second argument")


def _open(given: PathLike | DataFrame, what: str) -> tuple[Path | DataFrame, str]:
    """Take a table's path, or the table in memory, and what messages call it."""
    if isinstance(given, str | os.PathLike):
        return Path(given), Path(given).name
    if not hasattr(given, "columns"):
        raise TypeError(f"{what} must be a path or a DataFrame, got {describe(given)}")
    return given, what


# `ratings.csv`, from feel321 or from elsewhere.


def read_ratings(source: Path | DataFrame, what: str) -> tuple[DataFrame, list[str]]:
    """Read every judgement that counts."""
    kinds = {**schema.RATINGS, **dict.fromkeys(columns_of.FURTHER, schema.METRIC)}
    sheet, notes = schema.read_sheet(source, what, kinds, needed=schema.NEEDED[0])
    schema.read_column(sheet, "rejected", what, kind=schema.FLAG)
    left, left_out = leave_rejected(sheet, what=what)  # which needs no rating
    notes += left_out
    if lost := sorted(set(sheet["participant"]) - set(left["participant"])):
        names = list_names(lost)
        notes.append(f"Participants without a valid judgement, who do not count: {names}.")
    sheet = left.drop(columns="rejected", errors="ignore").copy()
    for name in map(str, sheet):
        schema.read_column(sheet, name, what, kind=kinds[name])
    missing: dict[str, Any] = {"simulated": False, "reference_id": "", OTHER: ""}
    sheet = sheet.assign(**{name: one for name, one in missing.items() if name not in sheet})
    simulated, who = sheet["simulated"], sheet["participant"]
    both = who[simulated & who.isin(who[~simulated])]
    refuse_lines(both, what, must="be simulated in all of its lines or in none")
    if simulated.any() and not simulated.all():
        gone = f"{int(simulated.sum())} judgements of {who[simulated].nunique()} simulated participants"
        how = "because people rated too; to analyse them, bring a table of them alone"
        notes.append(f"{gone} are left out, {how}.")
        sheet = sheet[~simulated].copy()
    _check_answers(sheet, what)
    notes += [*_check_doubles(sheet, what), *note_ratings(sheet)]
    if "repeat" not in sheet:
        alike = ["participant", STIMULUS, "reference_id", OTHER, "scale"]
        sheet["repeat"] = (sheet.groupby(alike).cumcount() + 1).astype(str)
    return sheet, notes


def _check_answers(sheet: DataFrame, what: str) -> None:
    """Refuse answers neither right nor wrong, choices without a winner or a second stimulus, and a second elsewhere."""
    is_choice, scales = sheet["scale"].isin(schema.CHOSEN), " or ".join(map(repr, schema.CHOSEN))
    unclear = ~sheet["rating"].isin([schema.LOWEST, schema.HIGHEST])
    same = (sheet[OTHER] == "") | (sheet[OTHER] == sheet[STIMULUS])
    is_answer = sheet["scale"] == schema.ANSWERED
    rules = (
        ("rating", is_answer & unclear, f"be 100 (right) or 0 (wrong) on scale '{schema.ANSWERED}'"),
        ("rating", is_choice & unclear, f"be 100 (stimulus_id was chosen) or 0 ({OTHER} was chosen) on scale {scales}"),
        (OTHER, is_choice & same, f"name the second of the two stimuli on scale {scales}"),
        (OTHER, ~is_choice & (sheet[OTHER] != ""), f"be empty but on scale {scales}"),
    )  # fmt: skip
    for name, bad, must in rules:
        refuse_lines(sheet.loc[bad, name], what, must=must)


def _check_doubles(sheet: DataFrame, what: str) -> Iterator[str]:
    """Refuse what occurs twice: a trial names a judgement; without trials its repeat does."""
    counted = next((name for name in ("trial", "repeat") if name in sheet), None)
    if not counted:
        repeats = "rows alike in participant, stimulus, reference and scale are taken as repeats"
        yield f"{what} has nothing in a column 'trial' or 'repeat': {repeats}."
        return
    key = [name for name in (*JUDGEMENT, counted) if name in sheet]
    must = f"occur once with the same {', '.join(key[:-1])}"
    doubled = sheet.loc[sheet.duplicated(key), counted]
    refuse_lines(doubled, what, must=must, do="keep one of the lines")
    count = int(sheet.duplicated([*key[:-1], "repeat"]).sum()) if "repeat" in sheet else 0
    if count and "trial" in sheet:
        how = "each counts as a further repeat"
        yield f"{count} judgements differ from an earlier one in their trial only: {how}."


# `manifest.csv`: what every stimulus is, and how well it matches its recording.


def _read_manifest(
    source: Path | DataFrame, what: str, *, metrics: Sequence[str] | None, given: Further
) -> tuple[DataFrame, tuple[str, ...], list[str]]:
    """Read the manifest's columns that an analysis needs; also the planned metrics, and notes."""
    metrics = None if metrics is None else as_names(metrics, "metrics")
    kinds = columns_of.describe_manifest(metrics or schema.PLANNED)
    sheet, notes = schema.read_sheet(source, what, kinds, needed=schema.NEEDED[1])
    planned = _choose_metrics(sheet, metrics, source, what=what, more=set(map(str, given.metrics)))
    notes += [
        f"{what} has nothing in a column '{name}', so that metric is not reported."
        for name in schema.PLANNED
        if not metrics and not {name, schema.STAND_INS.get(name)} & {*planned}
    ]
    for name, value in (("level", "as_is"), (ROLE, TEST)):
        if name not in sheet:
            sheet[name] = value
            taken = f"every stimulus is taken as '{value}'"
            notes.append(f"{what} has nothing in a column '{name}': {taken}.")
    for name in (STIMULUS, *schema.NAMING):
        schema.read_column(sheet, name, what, kind=schema.NAME)
    strange = sheet.loc[~sheet[ROLE].isin(schema.ROLES), ROLE]
    refuse_lines(strange, what, must=f"be one of {', '.join(schema.ROLES)}")
    schema.refuse_doubled(sheet, STIMULUS, what)
    for name in [*planned, *columns_of.describe_explored(planned)]:
        # The reference need not have a metric: it is what the others are matched against.
        if name in sheet and name in {*planned, *columns_of.FURTHER}:
            bare = sheet.loc[(sheet[name] == "") & (sheet[ROLE] == TEST), name]
            do = "correct it or leave the row out"
            refuse_lines(bare, what, must="be a finite number", do=do)
        schema.read_column(sheet, name, what, kind=schema.METRIC)
    for name in set(schema.FACTS) - {*planned}:
        schema.read_column(sheet, name, what, kind=kinds[name])
    return sheet, planned, notes


def _add_sources(sheet: DataFrame, what: str, sources: Mapping[str, str]) -> None:
    """Name the source of each stimulus: as the manifest or else the caller says, or its recording itself."""
    recording = sheet["recording"]
    if "source" not in sheet:
        sheet["source"] = recording.map(lambda name: sources.get(name, name))
    sheet["source"] = sheet["source"].mask(sheet["source"] == "", recording)
    other = sheet["source"] != sheet.groupby("recording")["source"].transform("first")
    do = "an earlier line of its recording has another"
    refuse_lines(sheet.loc[other, "source"], what, must="be one per recording", do=do)


def _choose_metrics(
    sheet: DataFrame, metrics: Sequence[str] | None, source: Path | DataFrame,
    *, what: str, more: set[str],
) -> tuple[str, ...]:  # fmt: skip
    """Find the columns that the primary analysis is about; only the default pair may be incomplete."""

    def list_numeric() -> str:
        names = columns_of.list_numeric(schema.read_cells(source))
        listed = f"its numeric columns are {', '.join(names)}"
        return listed if names else "it has no numeric column"

    if metrics is None or tuple(metrics) == schema.PLANNED:
        pairs = [(name, schema.STAND_INS.get(name, name)) for name in schema.PLANNED]
        instead = [name if name in sheet else stand_in for name, stand_in in pairs]
        if found := tuple(name for name in instead if name in sheet):
            return found
        must = f"at least one of the columns {', '.join(schema.PLANNED)} is needed"
        own = "or a metric of your own by its name (--metric)"
        raise ValueError(f"{what}: got no metric; {must}, {own}; {list_numeric()}")
    if not metrics or len(set(metrics)) < len(metrics):
        got = ", ".join(metrics) or "none"
        raise ValueError(f"metrics must be one name or more, each once, got {got}")
    known = more | set(columns_of.list_numeric(sheet))
    for name in (name for name in metrics if name not in known):
        stand_in, why = schema.STAND_INS.get(name), ""
        if stand_in in sheet:
            why = f" (build the set again, or use {stand_in})"
        elif name in columns_of.ROTATIONS:
            why = " (feel321 analyze computes it in a study, from the recordings of its set)"
        lacks = "no numbers in column" if name in sheet else "no column"
        got = f"got {lacks} {shorten(name)} as a metric{why}"
        raise ValueError(f"{what}: {got}; {list_numeric()}")
    return tuple(metrics)


# What was judged against what, and what of it the metrics describe.


def _check_stimuli(ratings: DataFrame, manifest: DataFrame, *, what: str, listed: str) -> None:
    must, do = f"be a stimulus of {listed}", "is it the manifest of these stimuli?"
    for name in (STIMULUS, OTHER):
        known = [*manifest.index, *[""] * (name == OTHER)]
        refuse_lines(ratings.loc[~ratings[name].isin(known), name], what, must=must, do=do)
    one, other = (ratings[name].map(manifest["recording"]) for name in (STIMULUS, OTHER))
    foreign = ratings.loc[(ratings[OTHER] != "") & (one != other), OTHER]
    refuse_lines(foreign, what, must="be of the same recording as stimulus_id")
    for name in [name for name in schema.NAMING if name in ratings]:
        of_stimulus = ratings[STIMULUS].map(manifest[name])
        differing = ratings.loc[ratings[name] != of_stimulus, name]
        if len(differing):
            right = shorten(of_stimulus[differing.index[0]])
            must = f"be {right}, as {listed} says of that stimulus"
            refuse_lines(differing, what, must=must, do="correct whichever is wrong")


def _join_stimuli(
    rows: DataFrame, stimuli: DataFrame, what: str
) -> tuple[DataFrame, Iterator[str]]:
    """Put beside each judgement its stimulus, the role that it had there, and whether the metrics describe it.

    Metrics say how well a stimulus matches its own recording: they describe judgements against that only.
    """
    is_paired = (rows["scale"] == schema.PAIRED) & (rows["reference_id"] != "")
    others = rows.loc[is_paired, "reference_id"]
    must = f"be a stimulus of the manifest, or empty, in a {schema.PAIRED}"
    refuse_lines(others[~others.isin(stimuli.index)], what, must=must)
    # A dissimilarity is about the stimulus that was compared with the reference.
    backward = is_paired & (rows[STIMULUS].map(stimuli[ROLE]) == "reference")
    ids, rows = [STIMULUS, "reference_id"], rows.copy()
    rows.loc[backward, ids] = rows.loc[backward, ids[::-1]].to_numpy()
    rows = rows.drop(columns=[name for name in rows if name in stimuli]).join(stimuli, on=STIMULUS)
    reference, is_same = rows["reference_id"], rows[STIMULUS] == rows["reference_id"]
    is_pair = is_paired & ~is_same & (reference.map(stimuli[ROLE]) != "reference")
    roles = rows[ROLE].mask(is_same & (rows[ROLE] == TEST), "reference")
    rows[ROLE] = roles.mask(rows["scale"].isin(schema.CHOSEN) | is_pair, schema.PAIR)
    known = dict.fromkeys(reference.unique(), UNLISTED) | {"": "", schema.SURFACE: SURFACED}
    for name in set(known) & set(stimuli.index):
        reducer, role = stimuli.loc[name, ["reducer", ROLE]]
        whole = role == "reference" and reducer not in REDUCER_NAMES
        known[name] = "" if whole else f"what '{reducer}' made of the recording"
    of_reference = reference.map(stimuli["recording"])
    is_foreign = of_reference.notna() & (of_reference != rows["recording"])
    references = reference.map(known).mask(is_foreign, FOREIGN)
    rows["matched"] = references.isin(["", SURFACED, UNLISTED])
    rows["reference_reducer"] = reference.map(stimuli["reducer"]).fillna("")
    return rows, _note_references(rows, references)


def _note_references(rows: DataFrame, references: Series) -> Iterator[str]:
    """Say which judgements had another reference than the metrics have, or none that is known."""
    nameless = int(((rows["scale"] == schema.PAIRED) & (rows["reference_id"] == "")).sum())
    if nameless:
        which = f"{nameless} judgements of scale '{schema.PAIRED}'"
        yield f"{which} name no reference_id: they are taken as from the reference."
    known = rows.assign(reference=references)
    known = known[(known[ROLE] != schema.PAIR) & (known["reference"] != "")]
    for (scale, reference), part in known.groupby(["scale", "reference"]):
        against = f"{len(part)} judgements were made against {reference}"
        is_usual = reference in {SURFACED, UNLISTED}
        fate = "" if is_usual else ": none enters an association or a slope"
        yield f"Scale '{scale}': {against}; the metrics compare with the recording{fate}."
        if reference == SURFACED and schema.GAIN in part:
            gains = part.loc[part[ROLE] != "anchor", schema.GAIN].dropna()
            span = " to ".join(dict.fromkeys(f"{end:.3g}" for end in (gains.min(), gains.max())))
            played = f"stimuli were played at {span} times the strength that was recorded"
            if (gains != 1).any():
                yield f"Scale '{scale}': beside the real surface, {played}: ratings mix strength with likeness."


# Further metrics, and labels of the participants.


def _join_further(
    manifest: DataFrame, ratings: DataFrame, given: Further, *, what: str, listed: str
) -> tuple[DataFrame, list[str]]:
    """Give every stimulus the further metrics that there are."""
    must = "further metrics must"
    for name in given.metrics:
        if name not in columns_of.FURTHER:
            names = ", ".join(columns_of.FURTHER)
            raise ValueError(f"{must} be of the columns {names}, got column {name!r}")
        if not ~(np.abs(given.metrics[name].to_numpy(np.float64)) > schema.LARGEST).any():
            raise ValueError(f"{must} be finite, got infinite or huge values of '{name}'")
    if not given.metrics.index.is_unique:
        raise ValueError(f"{must} have one row per stimulus_id, got a stimulus twice")
    judged = [name for name in columns_of.FURTHER if name in ratings]
    means = ratings.groupby(STIMULUS)[[*judged, "rating"]].mean()[judged]
    both = {f"{listed} and {what}": means, "the files and the further metrics given": given.metrics}
    for where, more in both.items():
        if doubled := [str(name) for name in more if name in manifest]:
            do = "keep one, or a stimulus would have two values of it"
            raise ValueError(f"{where}: got '{doubled[0]}' in both; {do}")
        manifest = manifest.join(more)
    mean = f"in {what} it is given per judgement; a stimulus has the mean over its judgements that hold it"
    return manifest, [f"'{name}': {mean}." for name in judged]


def _choose_further(
    rows: DataFrame, planned: tuple[str, ...], *, given: Further
) -> tuple[str, ...]:
    """Choose the metrics that are explored: all test stimuli must have them, as they must the planned ones."""
    tests = rows[rows[ROLE] == TEST]
    for name in (name for name in planned if name in given.metrics):
        lacking = tests.loc[tests[name].isna(), STIMULUS].unique()
        if len(lacking):
            first = shorten(str(lacking[0]))
            got = f"got {name!r}, which {len(lacking)} rated test stimuli lack, first {first}"
            do = "name another metric, or leave them out"
            raise ValueError(f"metrics: {got}; {do}. {' '.join(given.notes)}")
    known = [name for name in columns_of.describe_explored(planned) if name in tests]
    return tuple(name for name in known if tests[name].notna().all())


def _join_roster(rows: DataFrame, ratings: Path | DataFrame, notes: list[str]) -> DataFrame:
    """Add labels of the participants, and rigs where they differ, from the table beside the ratings."""
    path = ratings.with_name(ROSTER_FILE) if isinstance(ratings, Path) else None
    if path is None or not path.is_file():
        return rows
    with open_text(path) as file:
        header = next(csv.reader(file), [])
    known = {*rows, *ROSTER, "participant", ""}
    labels = [name for name in header if name in RIG or name not in known]
    kinds = {"participant": schema.NAME} | dict.fromkeys(labels, schema.TEXT)
    sheet, _ = schema.read_sheet(path, path.name, kinds, needed={"participant"})
    schema.refuse_doubled(sheet, "participant", path.name)
    sheet = sheet[sheet["participant"].isin(rows["participant"])].set_index("participant")
    for name in map(str, sheet):
        joined = rows.join(sheet[name], on="participant").fillna({name: ""})
        sizes = joined.groupby(name)["participant"].nunique().to_dict()
        if name in RIG and len(sizes) == 1:
            continue
        rows, write = joined, str if name in RIG else shorten
        told = ", ".join(f"{write(str(key)) if key else 'unknown'} {n}" for key, n in sizes.items())
        what = f"{RIG.get(name, shorten(name))} ({ROSTER_FILE}; participants: {told})"
        then = "see Robustness to other choices" if name in RIG else "no test compares them"
        notes.append(f"Participants differ in {what}: {then}.")
    return rows


# What a table lacks or may have confused is said, never repaired.


def list_names(names: Sequence[str]) -> str:
    """List names for a note; of more than three, the others are counted."""
    return name_some([shorten(name) for name in names])


def note_ratings(sheet: DataFrame) -> Iterator[str]:
    """Say which scales may have had other ends or were judged in several tasks, and which playbacks were broken."""
    for scale, rows in sheet.groupby("scale"):
        name, low, high = shorten(str(scale)), rows["rating"].min(), rows["rating"].max()
        if low < high <= SHORT:
            do = "if 100 was not its upper end, rescale them to 0 to 100"
            yield f"Ratings of scale {name} run from {low:g} to {high:g}: {do}."
        tasks = sorted(rows["protocol"].unique()) if "protocol" in rows else []
        if len(tasks) > 1:
            listed = list_names(tasks)
            yield f"Scale {name} was judged in {len(tasks)} protocols, which are taken together: {listed}."
    broken = sheet.loc[sheet["underruns"] > 0, "participant"] if "underruns" in sheet else ()
    if len(broken):
        which = f"{len(broken)} judgements of {len(set(broken))} participants"
        how = "they count; mark them as rejected to leave them out"
        yield f"{which} were made on an interrupted playback (underruns): {how}."


def note_sources(rows: DataFrame) -> Iterator[str]:
    """Say how many independent sources the rated recordings come from, where they are fewer."""
    tests = rows[ROLE] == TEST
    recordings, sources = (rows.loc[tests, name].nunique() for name in ("recording", "source"))
    start = f"The {recordings} recordings come from {sources} source{'s' if sources > 1 else ''}, turned, cut or edited"
    if sources == 1 < recordings:
        yield f"{start}: they are not independent, and the results do not extend to other sources."
    elif sources < recordings:
        what = "they are not independent, and what is said of others rests on sources"
        held = "mixed models hold what the recordings of a source share"
        yield f"{start}: {what}. Two-way intervals draw them; {held}, as a whole and reducer by reducer."


def note_gaps(rows: DataFrame, manifest: DataFrame, metrics: Sequence[str]) -> Iterator[str]:
    """Say which stimuli nobody rated or felt, and which metrics some of those that were rated lack."""
    apart, tests = rows[rows["scale"].isin(schema.APART)], rows[rows[ROLE] == TEST]
    rated = {*rows[STIMULUS], *apart["reference_id"], *apart["other_id"]}
    if unrated := [str(name) for name in manifest.index if name not in rated]:
        yield f"{len(unrated)} of {len(manifest)} stimuli of the manifest were rated by nobody: {list_names(unrated)}."
    if schema.SENSATION in manifest:
        weak = [str(name) for name in manifest.index[manifest[schema.SENSATION] < 0]]
        which = f"{len(weak)} of {len(manifest)} stimuli were played below the detection threshold"
        if weak:
            yield f"{which}: {list_names(weak)}."
    for name in (name for name in columns_of.describe_explored(metrics) if name in rows):
        lacking = tests.loc[tests[name].isna(), STIMULUS].unique()
        if len(lacking):
            first = shorten(str(lacking[0]))
            yield f"'{name}' is not reported: {len(lacking)} rated test stimuli have none, first {first}."


def note_scales(rows: DataFrame) -> Iterator[str]:
    """Say which scales have no rating of a test stimulus, and on which many are at an end."""
    tests = rows[rows[ROLE] == TEST]
    for scale in sorted({*rows["scale"]} - {*tests["scale"]} - {*schema.APART}):
        yield f"Scale {shorten(scale)} was rated on references and anchors only: it has no association."
    judged = tests[~tests["scale"].isin([schema.ANSWERED, *schema.CHOSEN])]
    for scale, own in judged.groupby("scale"):
        n = int(own["rating"].isin([schema.LOWEST, schema.HIGHEST]).sum())
        if n > CROWDED * len(own):
            which = f"{n} of {len(own)} ratings of test stimuli on scale {shorten(str(scale))} are 0 or 100"
            yield f"{which}: beyond the ends of the scale differences do not show, and slopes may be too small."


def note_lookalikes(rows: DataFrame) -> Iterator[str]:
    """Say which names look alike, but for what the eye does not see: capitals, accents' form, kinds of blanks."""

    def look(name: str) -> str:
        letters = unicodedata.normalize("NFKC", name)
        seen = "".join(letter for letter in letters if unicodedata.category(letter) != "Cf")
        return " ".join(seen.split()).casefold()

    for column in ("participant", STIMULUS, "recording", "reducer", "level", "scale"):
        looks = {name: look(name) for name in sorted(rows[column].unique())}
        times = Counter(looks.values())
        if alike := [name for name, seen in looks.items() if times[seen] > 1]:
            how = "that differ in capitals, accents or blanks only are taken as different"
            yield f"Names in column '{column}' {how}: {list_names(alike)}."


def note_apart(rows: DataFrame) -> Iterator[str]:
    """Say which scales enter no association, and why."""
    counts = rows["scale"].value_counts()
    for scale in (scale for scale in schema.APART if scale in counts):
        own, n = rows[rows["scale"] == scale], counts[scale]
        none = f"Scale '{scale}': none of its {n} judgements enters an association, because"
        pairs, turned = (int((own[ROLE] == role).sum()) for role in (schema.PAIR, TEST))
        if scale == schema.ANSWERED:
            what = "they are right (100) or wrong (0). The profile holds the percentage correct"
            yield f"{none} {what}; guessing gives 50."
        elif scale in schema.CHOSEN:
            where = "They are evaluated under Choices between two stimuli"
            yield f"{none} one of two stimuli was chosen. {where}."
        elif not turned:
            why = "a metric describes one stimulus and they compare two"
            held = f"The profile holds the {n - pairs} that compare with the reference"
            yield f"{none} {why}. {held}, and leaves out {pairs}. {SPACE}"
        else:
            yield (
                f"Scale '{scale}': {turned} of its {n} judgements compare a reduction with its original. Those enter "
                f"associations and slopes as a similarity, 100 less the dissimilarity (scale '{schema.RECAST}'): with "
                "the dissimilarity itself every slope and every correlation has the opposite sign. The other "
                f"{n - turned} (two reductions, identical pairs, anchors) enter none of them. {SPACE}"
            )
