"""Ratings joined with their stimuli, labels and further metrics: one tidy table, or one clear line about what is wrong.

Conventions: ratings run from 0 to 100; one row per judgement; recording, reducer, level, role and the metrics
of a stimulus come from the manifest. Nothing is repaired and nothing is dropped silently: what is left out,
or taken for granted because a column is missing, stands in `Table.notes`.

A study whose participants differ, in how they hold the tool for example, writes that table with a column for each such
factor. Its columns become columns of the judgements; no test compares groups of people.

They are the rotation statistics of the metrics, the metrics of signals as they were delivered, and counterparts that no
orientation of the sensor changes (`analysis.table.schema.FURTHER`). A stimulus has them from the manifest, from the
ratings (the mean over its judgements), or from whoever asks for the report. They are explored: no primary analysis and
no correction for several tests holds them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from feel321.analysis.table.items import note_sources
from feel321.analysis.table.judgements import (
    AMPLITUDE,
    ROLES,
    SENSATION,
    find_matched,
    find_roles,
    note_references,
    read_manifest,
    read_ratings,
    turn_pairs,
)
from feel321.analysis.table.schema import (
    HIGHEST,
    LOWEST,
    Column,
    describe_explored,
    describe_further,
)
from feel321.analysis.table.sheet import (
    LARGEST,
    list_names,
    note_gaps,
    note_lookalikes,
    read_header,
    read_sheet,
    refuse_lines,
)

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence
    from pathlib import Path

    from pandas import DataFrame

# Groups of participants: what `participants.csv`, beside the ratings, says of who judged.

ROSTER_FILE = "participants.csv"
ROSTER = frozenset({
    "number",
    "simulated",
    "state",
    "sessions",
    "done",
    "total",
    "first_utc",
    "last_utc",
    "training_passed",
})
"""Columns that tell how far a participant has come; all others, but for the participant's name, are labels."""


def join_labels(rows: DataFrame, ratings_path: Path) -> tuple[DataFrame, list[str]]:
    """Add a column for each label of the participants."""
    path = ratings_path.with_name(ROSTER_FILE)
    names = _list_labels(path, rows) if path.is_file() else []
    if not names:
        return rows, []
    schema = {
        "participant": Column("who", needed=True),
        **{name: Column("a label") for name in names},
    }
    sheet, _ = read_sheet(path, schema)
    doubled = sheet.loc[sheet["participant"].duplicated(), "participant"]
    refuse_lines(
        doubled,
        path.name,
        why="in column 'participant', but an earlier line lists it already; keep one",
    )
    labels = sheet.set_index("participant")
    joined = rows.join(labels, on="participant").fillna(dict.fromkeys(labels, ""))
    return joined, [_tell_groups(joined, name) for name in names]


def _list_labels(path: Path, rows: DataFrame) -> list[str]:
    header = read_header(path)
    return [name for name in header if name and name not in ROSTER | {*rows, "participant"}]


def _tell_groups(rows: DataFrame, name: str) -> str:
    groups = rows.groupby(name)["participant"].nunique()
    told = ", ".join(
        f"{list_names([str(group)]) if group else 'unknown'} {count}"
        for group, count in groups.items()
    )
    return f"Participants differ in {list_names([name])} ({ROSTER_FILE}; participants: {told}): no test compares them."


# Further metrics: what else may predict ratings, beside the metrics that the analysis was planned for.


@dataclass(frozen=True, slots=True, eq=False)
class Further:
    """Further metrics that neither file holds.

    Parameters
    ----------
    metrics : DataFrame
        Indexed by stimulus_id; columns of `feel321.analysis.table.schema.describe_further`.
    notes : tuple of str
        How they were computed, or why they were not, one sentence each.
    """

    metrics: DataFrame
    notes: tuple[str, ...] = ()


def join_further(
    manifest: DataFrame, ratings: DataFrame, handed: DataFrame | None, *, names: tuple[str, str]
) -> tuple[DataFrame, list[str]]:
    """Give every stimulus the further metrics that there are."""
    known = describe_further()
    judged = [name for name in known if name in ratings]
    found = manifest
    if judged:
        means = ratings.groupby("stimulus_id")[judged].mean()
        _refuse_doubled(found, means, f"{names[1]} and {names[0]}")
        found = found.join(means)
    if handed is not None:
        _check_handed(handed)
        _refuse_doubled(found, handed, "the files and what was handed over")
        found = found.join(handed)
    average = f"in {names[0]} it is told per judgement; a stimulus has the mean over its judgements that tell it"
    return found, [f"'{name}': {average}." for name in judged]


def _refuse_doubled(manifest: DataFrame, more: DataFrame, what: str) -> None:
    doubled = [str(name) for name in more if name in manifest]
    if doubled:
        raise ValueError(
            f"{what}: got '{doubled[0]}' in both; keep one, or a stimulus would have two values of it"
        )


def _check_handed(handed: DataFrame) -> None:
    allowed = describe_further()
    for name in handed:
        if name not in allowed:
            raise ValueError(
                f"further metrics: got column {name!r}, allowed is one of {', '.join(allowed)}"
            )
        values = handed[name].to_numpy(np.float64)
        if not (np.isnan(values) | (np.abs(values) <= LARGEST)).all():
            raise ValueError(
                f"further metrics: got infinite or huge values of '{name}'; allowed are finite ones"
            )
    if not handed.index.is_unique:
        raise ValueError(
            "further metrics: got a stimulus twice in the index; allowed is one row per stimulus_id"
        )


def list_further(rows: DataFrame, metrics: Sequence[str]) -> tuple[str, ...]:
    """List the metrics that every rated test stimulus has and that the primary analysis is not about."""
    tests, explored = rows["role"] == "test", describe_explored(metrics)
    return tuple(name for name in explored if name in rows and rows.loc[tests, name].notna().all())


def note_lacking(rows: DataFrame, metrics: Sequence[str]) -> Iterator[str]:
    """Say which further metrics some rated test stimuli lack."""
    tests = rows[rows["role"] == "test"]
    for name in (name for name in describe_explored(metrics) if name in rows):
        lacking = tests.loc[tests[name].isna(), "stimulus_id"].unique()
        if len(lacking):
            told = f"{len(lacking)} rated test stimuli have none, first {list_names([str(lacking[0])])}"
            yield f"'{name}' is not reported: {told}."


# Ratings married to their stimuli: one tidy table, or one clear line about what is wrong.

__all__ = ["HIGHEST", "LOWEST", "ROLES", "Table", "order_reducers", "read_table"]

ECHOED = ("recording", "reducer", "level")
"""Columns that both files may hold and must then agree on."""


@dataclass(frozen=True, slots=True, eq=False)
class Table:
    """Ratings and metrics, side by side.

    Parameters
    ----------
    rows : DataFrame
        One row per judgement: participant, stimulus_id, reference_id and reference_reducer (may be empty), source,
        recording, reducer, level, role, matched, scale, repeat, rating, simulated, protocol and response_time_s if
        there are any, one column per metric and further metric, rms_m_s2 if there is one, and one per label of the
        participants (`join_labels`). The role is the one that the stimulus had in that judgement (`find_roles`);
        matched tells whether the metrics speak of that judgement (`find_matched`); a dissimilarity is about the
        stimulus compared with the reference.
    metrics : tuple of str
        The metrics that the primary analysis is about, as they were declared.
    notes : tuple of str
        What was left out and what was assumed, one sentence each.
    further : tuple of str
        Columns of metrics that are explored only (`feel321.analysis.table.reading`).
    """

    rows: DataFrame
    metrics: tuple[str, ...]
    notes: tuple[str, ...]
    further: tuple[str, ...] = ()


def read_table(
    ratings_path: Path,
    manifest_path: Path,
    *,
    metrics: Sequence[str] | None = None,
    sources: Mapping[str, str] | None = None,
    further: Further | None = None,
) -> Table:
    """Read ratings and manifest into one tidy table.

    Parameters
    ----------
    ratings_path : Path
        ``ratings.csv`` from anywhere: participant, stimulus_id, scale and rating are enough (`describe_ratings`).
        Labels of the participants are read from ``participants.csv`` beside it, if there is one.
    manifest_path : Path
        ``manifest.csv``: stimulus_id, recording, reducer and at least one metric are enough (`describe_manifest`).
    metrics : sequence of str, optional
        Numeric columns of the manifest that the primary analysis is about; ``spectral_match_bounded`` and
        ``temporal_match`` if left out, and where the former is missing, ``spectral_match``. Other metrics are explored.
    sources : Mapping of str to str, optional
        Recording -> what it was made from, where several are one, turned, cut or edited, and the manifest has no column
        ``source`` that says so.
    further : Further, optional
        Metrics to explore that neither file holds.

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
    manifest, planned, notes = read_manifest(manifest_path, sources=sources, metrics=metrics)
    ratings, more_notes = read_ratings(ratings_path)
    names = ratings_path.name, manifest_path.name
    _check_stimuli(ratings, manifest, names=names)
    manifest, told = join_further(
        manifest, ratings, further.metrics if further else None, names=names
    )
    notes += [*(further.notes if further else ()), *told]
    turned = turn_pairs(ratings, manifest, what=ratings_path.name)
    echoed = [name for name in turned if name in manifest]
    rows = turned.drop(columns=echoed).join(manifest, on="stimulus_id")
    rows["role"] = find_roles(rows, manifest)
    rows["matched"] = find_matched(rows, manifest)
    rows["reference_reducer"] = rows["reference_id"].map(manifest["reducer"]).fillna("")
    notes += [
        *more_notes,
        *note_gaps(rows, manifest),
        *note_references(rows, manifest),
        *note_sources(rows),
    ]
    notes += [*note_lookalikes(rows), *note_lacking(rows, planned)]
    explored = list_further(rows, planned)
    judged = ["role", "matched", "scale", "repeat", "rating", "simulated"]
    optional = ["protocol", "response_time_s", AMPLITUDE, SENSATION]
    optional = [name for name in optional if name in rows and name not in planned]
    identity = ["participant", "stimulus_id", "reference_id", "reference_reducer", "source"]
    rows = rows[[*identity, *ECHOED, *judged, *optional, *planned, *explored]].reset_index(
        drop=True
    )
    labelled, more_notes = join_labels(rows, ratings_path)
    return Table(labelled, planned, (*notes, *more_notes), explored)


def order_reducers(names: Iterable[str]) -> list[str]:
    """Put reducer names into the order of `stimuli.reduce.REDUCERS`; unknown ones follow by alphabet.

    Examples
    --------
    >>> order_reducers(["mine", "dft321", "soc321", "dft321"])
    ['soc321', 'dft321', 'mine']
    """
    from feel321.stimuli.reducers.registry import REDUCERS

    found = set(names)
    return [name for name in REDUCERS if name in found] + sorted(found - set(REDUCERS))


def _check_stimuli(ratings: DataFrame, manifest: DataFrame, *, names: tuple[str, str]) -> None:
    what, listed = names
    strangers = ratings.loc[~ratings["stimulus_id"].isin(manifest.index), "stimulus_id"]
    unknown = f"in column 'stimulus_id', which {listed} does not know; is it the manifest of these stimuli?"
    refuse_lines(strangers, what, why=unknown)
    for name in [name for name in ECHOED if name in ratings]:
        of_stimulus = ratings["stimulus_id"].map(manifest[name])
        differing = ratings.loc[ratings[name] != of_stimulus, name]
        said = "" if differing.empty else list_names([of_stimulus[differing.index[0]]])
        otherwise = f"in column '{name}', but {listed} says {said} of that stimulus; mend whichever is wrong"
        refuse_lines(differing, what, why=otherwise)
