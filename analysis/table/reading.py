"""Ratings married to their stimuli: one tidy table, or one clear line about what is wrong.

Conventions: ratings run from 0 to 100; one row per judgement; recording, reducer, level, role and the metrics
of a stimulus come from the manifest. Nothing is repaired and nothing is dropped silently: what is left out,
or taken for granted because a column is missing, stands in `Table.notes`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from analysis.table.further import join_further, list_further, note_lacking
from analysis.table.gaps import list_names, note_gaps, note_lookalikes
from analysis.table.judgement_sheet import read_ratings
from analysis.table.labels import join_labels
from analysis.table.pairs import find_matched, find_roles, note_references, turn_pairs
from analysis.table.schema import HIGHEST, LOWEST
from analysis.table.sheet import refuse_lines
from analysis.table.sources import note_sources
from analysis.table.stimulus_sheet import AMPLITUDE, ROLES, SENSATION, read_manifest

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence
    from pathlib import Path

    from pandas import DataFrame

    from analysis.table.further import Further

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
        Columns of metrics that are explored only (`analysis.table.further`).
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
    manifest, told = join_further(manifest, ratings, further.metrics if further else None, names=names)
    notes += [*(further.notes if further else ()), *told]
    turned = turn_pairs(ratings, manifest, what=ratings_path.name)
    echoed = [name for name in turned if name in manifest]
    rows = turned.drop(columns=echoed).join(manifest, on="stimulus_id")
    rows["role"] = find_roles(rows, manifest)
    rows["matched"] = find_matched(rows, manifest)
    rows["reference_reducer"] = rows["reference_id"].map(manifest["reducer"]).fillna("")
    notes += [*more_notes, *note_gaps(rows, manifest), *note_references(rows, manifest), *note_sources(rows)]
    notes += [*note_lookalikes(rows), *note_lacking(rows, planned)]
    explored = list_further(rows, planned)
    judged = ["role", "matched", "scale", "repeat", "rating", "simulated"]
    optional = ["protocol", "response_time_s", AMPLITUDE, SENSATION]
    optional = [name for name in optional if name in rows and name not in planned]
    identity = ["participant", "stimulus_id", "reference_id", "reference_reducer", "source"]
    rows = rows[[*identity, *ECHOED, *judged, *optional, *planned, *explored]].reset_index(drop=True)
    labelled, more_notes = join_labels(rows, ratings_path)
    return Table(labelled, planned, (*notes, *more_notes), explored)


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
