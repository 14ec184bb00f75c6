"""Ratings joined with their stimuli, labels and further metrics: one tidy table, or one clear line about what is wrong.

Conventions: ratings run from 0 to 100; one row per judgement; recording, reducer, level, role and the metrics
of a stimulus come from the manifest. `reference_id` names another stimulus, or `surface`, or is empty. A dissimilarity
has no direction, so it is about whichever of the two stimuli is not the reference. Nothing is repaired and nothing is
dropped silently: what is left out, or assumed because a column is missing, is in `Table.notes`.

A study whose participants differ, in how they hold the tool for example, writes `participants.csv` with a column for
each such factor. Its columns become columns of the judgements; no test compares groups of people.

Any numeric column of the manifest is a metric (`feel321.analysis.table.metrics`). Further metrics are the rotation
statistics of the metrics, the metrics of signals as they were delivered, and counterparts that no orientation of the
sensor changes. A stimulus has them
from the manifest, from the ratings (the mean over its judgements), or from the caller. They are explored, so no primary
analysis and no correction for several tests holds them, unless the analysis declares them as its metrics.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from feel321.analysis.table import metrics as metrics_of
from feel321.analysis.table import notes as remarks
from feel321.analysis.table import roster, schema
from feel321.analysis.table.items import OTHER, ROLE, STIMULUS, TEST, Table
from feel321.analysis.table.sheets import (
    Further,
    Source,
    open_source,
    read_info,
    read_manifest,
    read_ratings,
)
from feel321.doors import as_path, describe
from feel321.names import REDUCER_NAMES
from feel321.types import MetricInfo, PathLike

if TYPE_CHECKING:
    from pandas import DataFrame, Series

__all__ = ["Further", "Table", "read_table"]

RATINGS_FILE, MANIFEST_FILE = "ratings.csv", "stimuli/manifest.csv"
"""Tables of a study, in its folder."""

ECHOED = ("recording", "reducer", "level")
"""Columns that both files may hold and must then agree on."""

OPTIONAL = (
    "protocol", "response_time_s", schema.AMPLITUDE, schema.SENSATION, schema.ERROR, schema.SOURCE,
    *schema.LABELS,
)  # fmt: skip
"""Columns that judgements keep where there are any."""

SURFACED, UNLISTED = "the real surface", "what the manifest does not list"
FOREIGN = "a stimulus of another recording"


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

    Examples
    --------
    >>> import pandas as pd
    >>> from feel321 import analysis
    >>> ratings = pd.DataFrame({"participant": list("aabb"), "stimulus_id": list("xyxy"), "scale": "realism",
    ...     "trial": [1, 2, 1, 2], "rating": [20, 70, 30, 90]})
    >>> manifest = pd.DataFrame({"stimulus_id": list("xy"), "recording": "tap", "reducer": ["mag321", "dft321"],
    ...     "level": "as_is", "role": "test", "temporal_match": [0.2, 0.9]})
    >>> analysis.read_table(ratings, manifest).metrics
    ('temporal_match',)
    """
    if manifest is None:
        ratings, manifest = find_tables(ratings)
    judged, listed = open_source(ratings, "ratings"), open_source(manifest, "manifest")
    rivals = further.rivals if further else ()
    stimuli, planned, notes = read_manifest(listed, metrics, sources=sources, further=further)
    known, beyond = read_info(stimuli, info, listed, names=(*planned, *rivals))
    stimuli = _label(stimuli, further.labels if further else None).set_index(STIMULUS)
    rows, more_notes = read_ratings(*judged)
    _check_stimuli(rows, stimuli, names=(judged.what, listed.what))
    stimuli, joined = _join_further(stimuli, rows, further, names=(judged.what, listed.what))
    rows = _turn_pairs(rows, stimuli, judged.what)
    rows = rows.drop(columns=[name for name in rows if name in stimuli]).join(stimuli, on=STIMULUS)
    rows[ROLE] = _find_roles(rows, stimuli)
    rows["matched"] = _find_references(rows, stimuli).isin(["", SURFACED, UNLISTED])
    rows["reference_reducer"] = rows["reference_id"].map(stimuli["reducer"]).fillna("")
    notes += [*beyond, *joined, *more_notes, *_note_rows(rows, stimuli, planned)]
    rows, explored, compared, lacking = _select_columns(rows, planned, rivals, given=further)
    rows, more_notes = roster.join_labels(rows, judged.given)
    rows, on_rigs = roster.join_rigs(rows, judged.given)
    notes += [*lacking, *more_notes, *on_rigs]
    listing = _list_stimuli(stimuli, rows, listed, metrics=[*planned, *explored, *compared])
    return Table(rows, planned, tuple(notes), explored, compared, known, listing)


def _list_stimuli(
    stimuli: DataFrame, rows: DataFrame, listed: Source, *, metrics: Sequence[str]
) -> DataFrame:
    """List the stimuli with their metrics; where pairs were compared, with every number that the manifest has."""
    labels = [name for name in schema.LABELS if name in stimuli]
    sheet = stimuli[["source", *ECHOED, ROLE, *dict.fromkeys(metrics), *labels]]
    if (rows["scale"] == schema.PAIRED).any():
        more = metrics_of.read_attributes(listed.given)
        sheet = sheet.join(more[[name for name in more if name not in sheet]])
    return sheet


def _note_rows(rows: DataFrame, stimuli: DataFrame, planned: Sequence[str]) -> Iterator[str]:
    """Say what ratings lack, and what about them is odd."""
    yield from remarks.note_gaps(rows, stimuli)
    yield from _note_references(rows, stimuli)
    yield from remarks.note_sources(rows)
    yield from remarks.note_lookalikes(rows)
    yield from remarks.note_lacking(rows, planned)


def _label(manifest: DataFrame, labels: DataFrame | None) -> DataFrame:
    """Give every stimulus the interaction and sample of its recording, where the manifest has none."""
    given = (
        {} if labels is None else {name: labels[name] for name in schema.LABELS if name in labels}
    )
    for name, said in given.items():
        if name not in manifest:
            manifest[name] = manifest["recording"].map(said).fillna("").astype(str)
    return manifest


def _select_columns(
    rows: DataFrame, planned: Sequence[str], rivals: Sequence[str], *, given: Further | None
) -> tuple[DataFrame, tuple[str, ...], tuple[str, ...], list[str]]:
    """Select the columns of a table; also the metrics that are explored and compared, and notes."""
    tests = rows[rows[ROLE] == TEST]
    _refuse_lacking(tests, planned, given)
    known = [name for name in metrics_of.describe_explored(planned) if name in tests]
    explored = tuple(name for name in known if tests[name].notna().all())
    compared, lacking = _leave_incomplete(tests, [*planned, *rivals] if rivals else ())
    selected = rows[[
        "participant", STIMULUS, "reference_id", "reference_reducer", OTHER, "source", *ECHOED, ROLE, "matched",
        "scale", "repeat", "rating", "simulated", *(name for name in OPTIONAL if name in rows and name not in planned),
        *dict.fromkeys([*planned, *explored, *compared]),
    ]]  # fmt: skip
    return selected.reset_index(drop=True), explored, compared, lacking


def _leave_incomplete(tests: DataFrame, rivals: Sequence[str]) -> tuple[tuple[str, ...], list[str]]:
    """Leave out rivals that some rated test stimulus has no value of: on other stimuli they are not comparable."""
    rivals = tuple(dict.fromkeys(rivals))
    bare = [name for name in rivals if tests[name].isna().any()]
    if not bare:
        return rivals, []
    note = f"Not compared, because some rated test stimuli have no value: {', '.join(bare)}."
    return tuple(name for name in rivals if name not in bare), [note]


def find_tables(ratings: PathLike | DataFrame) -> tuple[Path, Path]:
    """Find the tables of a study, by its folder or its ratings."""
    if not isinstance(ratings, str | os.PathLike):
        raise TypeError(
            f"ratings must be a path, of a study, where no manifest is given, got {describe(ratings)}; give the "
            "manifest too, a path or a DataFrame"
        )
    path = as_path(ratings, "ratings")
    if not path.is_file():
        return path / RATINGS_FILE, path / MANIFEST_FILE
    for manifest in (path.with_name("manifest.csv"), path.parent / MANIFEST_FILE):
        if manifest.is_file():
            return path, manifest
    raise FileNotFoundError(
        f"{path}: no manifest.csv beside it, nor stimuli/manifest.csv; pass the manifest as second argument"
    )


# What was judged against what, and what of it the metrics describe.


def _check_stimuli(ratings: DataFrame, manifest: DataFrame, *, names: tuple[str, str]) -> None:
    what, listed = names
    must, do = f"be a stimulus of {listed}", "is it the manifest of these stimuli?"
    for name in (STIMULUS, OTHER):
        strangers = ratings.loc[
            ~ratings[name].isin([*manifest.index, *[""] * (name == OTHER)]), name
        ]
        schema.refuse_lines(strangers, what, must=must, do=do)
    arms = (ratings[name].map(manifest["recording"]) for name in (STIMULUS, OTHER))
    foreign = ratings.loc[(ratings[OTHER] != "") & (next(arms) != next(arms)), OTHER]
    schema.refuse_lines(foreign, what, must="be of the same recording as stimulus_id")
    for name in [name for name in ECHOED if name in ratings]:
        of_stimulus = ratings[STIMULUS].map(manifest[name])
        differing = ratings.loc[ratings[name] != of_stimulus, name]
        if len(differing):
            must = f"be {schema.shorten(of_stimulus[differing.index[0]])}, as {listed} says of that stimulus"
            schema.refuse_lines(differing, what, must=must, do="correct whichever is wrong")


def _turn_pairs(ratings: DataFrame, manifest: DataFrame, what: str) -> DataFrame:
    """Let every dissimilarity be about the stimulus that was compared with the reference."""
    is_paired = (ratings["scale"] == schema.PAIRED) & (ratings["reference_id"] != "")
    others = ratings.loc[is_paired, "reference_id"]
    must = f"be a stimulus of the manifest, or empty, in a {schema.PAIRED}"
    schema.refuse_lines(others[~others.isin(manifest.index)], what, must=must)
    backward = is_paired & (ratings[STIMULUS].map(manifest[ROLE]) == "reference")
    ids = [STIMULUS, "reference_id"]
    turned = ratings.copy()
    turned.loc[backward, ids] = ratings.loc[backward, ids[::-1]].to_numpy()
    return turned


def _find_roles(rows: DataFrame, manifest: DataFrame) -> Series:
    """Find the role that each stimulus had in its judgement."""
    is_same = rows[STIMULUS] == rows["reference_id"]
    is_choice = rows["scale"].isin(schema.CHOSEN)
    roles = rows[ROLE].mask(is_same & (rows[ROLE] == TEST), "reference")
    is_pair = (rows["scale"] == schema.PAIRED) & (rows["reference_id"] != "") & ~is_same
    return roles.mask(
        is_choice | is_pair & (rows["reference_id"].map(manifest[ROLE]) != "reference"), schema.PAIR
    )


def _find_references(rows: DataFrame, manifest: DataFrame) -> Series:
    """Name every judgement's reference in words, unless it is the recording itself or nothing is said of it.

    Metrics say how well a stimulus matches its own recording: they describe judgements against that only.
    """
    known = {"": "", schema.SURFACE: SURFACED}
    for name in set(rows["reference_id"].unique()) - set(known):
        known[name] = UNLISTED
        if name in manifest.index:
            reducer, role = manifest.loc[name, ["reducer", ROLE]]
            whole = role == "reference" and reducer not in REDUCER_NAMES
            known[name] = "" if whole else f"what '{reducer}' made of the recording"
    of_reference = rows["reference_id"].map(manifest["recording"])
    is_foreign = of_reference.notna() & (of_reference != rows["recording"])
    return rows["reference_id"].map(known).mask(is_foreign, FOREIGN)


def _note_references(rows: DataFrame, manifest: DataFrame) -> Iterator[str]:
    """Say which judgements had another reference than the metrics have, or none that is known."""
    nameless = int(((rows["scale"] == schema.PAIRED) & (rows["reference_id"] == "")).sum())
    if nameless:
        which = f"{nameless} judgements of scale '{schema.PAIRED}'"
        yield f"{which} name no reference_id: they are taken as from the reference."
    known = rows.assign(reference=_find_references(rows, manifest))
    known = known[(known[ROLE] != schema.PAIR) & (known["reference"] != "")]
    for (scale, reference), part in known.groupby(["scale", "reference"]):
        against = f"{len(part)} judgements were made against {reference}"
        fate = ": none enters an association or a slope"
        fate = "" if reference in {SURFACED, UNLISTED} else fate
        yield f"Scale '{scale}': {against}; the metrics compare with the recording{fate}."
        if reference == SURFACED:
            yield from remarks.note_gains(part)


# Further metrics.


def _join_further(
    manifest: DataFrame, ratings: DataFrame, given: Further | None, *, names: tuple[str, str]
) -> tuple[DataFrame, list[str]]:
    """Give every stimulus the further metrics that there are."""
    judged = [name for name in metrics_of.describe_further() if name in ratings]
    parts = (
        [(ratings.groupby(STIMULUS)[judged].mean(), " and ".join(names[::-1]))] if judged else []
    )
    if given is not None:
        _check_given(given)
        parts.append((given.metrics, "the files and the further metrics given"))
    for more, where in parts:
        if doubled := [str(name) for name in more if name in manifest]:
            raise ValueError(
                f"{where}: got '{doubled[0]}' in both; keep one, or a stimulus would have two values of it"
            )
        manifest = manifest.join(more)
    mean = f"in {names[0]} it is given per judgement; a stimulus has the mean over its judgements that hold it"
    return manifest, [*(given.notes if given else ()), *(f"'{name}': {mean}." for name in judged)]


def _refuse_lacking(tests: DataFrame, planned: Sequence[str], given: Further | None) -> None:
    """Refuse a planned metric that some rated test stimulus lacks, with what is known of the reason."""
    if given is None:
        return
    for name in (name for name in planned if name in given.metrics):
        lacking = tests.loc[tests[name].isna(), STIMULUS].unique()
        if len(lacking):
            why = " ".join(given.notes)
            raise ValueError(
                f"metrics: got {name!r}, which {len(lacking)} rated test stimuli lack, first "
                f"{schema.shorten(str(lacking[0]))}; name another metric, or leave them out. {why}".rstrip()
            )


def _check_given(given: Further) -> None:
    metrics, allowed = given.metrics, [*metrics_of.describe_further(), *given.rivals]
    for name in metrics:
        if name not in allowed:
            raise ValueError(
                f"further metrics must be of the columns {', '.join(allowed)}, got column {name!r}"
            )
        values = metrics[name].to_numpy(np.float64)
        if not (np.isnan(values) | (np.abs(values) <= schema.LARGEST)).all():
            raise ValueError(
                f"further metrics must be finite, got infinite or huge values of '{name}'"
            )
    if not metrics.index.is_unique:
        raise ValueError("further metrics must have one row per stimulus_id, got a stimulus twice")
