"""Votes: who chose which of two stimuli, and by how much the metrics of the two differ.

Conventions: a row is one choice, about the stimulus that was felt first (``stimulus_id``); ``other_id`` is the second
one; the rating is 100 where the first was chosen and 0 where the second was. Differences of metrics are first minus
second, turned so that a positive difference speaks for the first: a metric of which a larger value is worse is negated.
A metric is asked only about pairs of test stimuli whose reference is the recording itself or the real surface, which is
what metrics compare with; the recording itself and the anchors are far from everything and would flatter every metric.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from feel321.analysis.arrays import Values, check_columns
from feel321.analysis.table.items import OTHER, ROLE, STIMULUS, TEST, Table
from feel321.analysis.table.schema import CHOSEN, HIGHEST, LOWEST
from feel321.doors import as_names, check_name, describe

if TYPE_CHECKING:
    from numpy.typing import NDArray
    from pandas import DataFrame

    from feel321.types import Direction

    Codes = NDArray[np.intp]

NEEDED = ("participant", STIMULUS, OTHER, "rating")


@dataclass(frozen=True, slots=True, eq=False)
class Votes:
    """Votes as arrays, (n_votes,): numbers of participants, sources and pairs, and whether the first was chosen.

    pair: the two stimuli and their reference, whichever came first. turned: whether the first is the second of its
    pair by name. names: of the stimuli, which first and second number. differences: (n_votes, n_metrics).
    """

    participant: Codes
    source: Codes
    pair: Codes
    turned: NDArray[np.bool_]
    first: Codes
    second: Codes
    chose_first: NDArray[np.bool_]
    names: tuple[str, ...]
    metrics: tuple[str, ...]
    differences: Values
    notes: tuple[str, ...] = ()

    def __len__(self) -> int:
        """Count the votes."""
        return len(self.pair)

    @property
    def n_participants(self) -> int:
        """Participants who voted."""
        return int(self.participant.max(initial=-1)) + 1

    @property
    def n_sources(self) -> int:
        """Recordings, or what they were made from where several come from one."""
        return int(self.source.max(initial=-1)) + 1

    @property
    def n_units(self) -> int:
        """Participants or sources, whichever are fewer: intervals know no more than the scarcer of the two."""
        return min(self.n_participants, self.n_sources)


def gather_votes(
    ratings: Table | DataFrame,
    stimuli: DataFrame | None = None,
    *,
    scale: str | None = None,
    level: str | None = None,
    metrics: Sequence[str] | None = (),
    higher: Mapping[str, Direction] | None = None,
) -> Votes:
    """Gather the votes of one scale; with metrics, those that the metrics are asked about."""
    rows, listed, planned = _open(ratings, stimuli)
    if isinstance(ratings, Table):
        higher = {name: info.higher for name, info in ratings.info.items()} | dict(higher or {})
    rows = _select(rows, listed, scale=scale, level=level)
    names = planned if metrics is None else as_names(metrics, "metrics")
    notes: list[str] = []
    if names:
        check_columns(listed, names, "stimuli")
        rows, notes = _keep_comparable(rows, listed, names)
    return _number(rows, listed, metrics=names, higher=higher or {}, notes=notes)


def _open(
    ratings: Table | DataFrame, stimuli: DataFrame | None
) -> tuple[DataFrame, DataFrame, tuple[str, ...]]:
    from pandas import DataFrame

    if isinstance(ratings, Table):
        if stimuli is not None:
            raise ValueError(
                "stimuli must be left out with a Table, which has them; pass the Table alone"
            )
        if ratings.stimuli is None:
            raise ValueError(
                "ratings must be a Table that read_table made, got one without stimuli"
            )
        rows = ratings.rows[ratings.rows["scale"].isin(CHOSEN)]
        return rows, ratings.stimuli, ratings.metrics
    if not isinstance(ratings, DataFrame):
        raise TypeError(
            f"ratings must be a Table or a DataFrame, got {describe(ratings)}; read_table reads files"
        )
    if stimuli is None:
        raise ValueError(
            "stimuli must be given with a DataFrame of votes: a row per stimulus, with its metrics"
        )
    check_columns(ratings, NEEDED, "ratings")
    listed = stimuli.set_index(STIMULUS) if STIMULUS in stimuli else stimuli
    check_columns(listed, ["recording"], "stimuli")
    return ratings, listed, ()


def _select(
    rows: DataFrame, listed: DataFrame, *, scale: str | None, level: str | None
) -> DataFrame:
    for column, name in (("scale", scale), ("level", level)):
        if name is None:
            continue
        found = rows[column] if column in rows else rows[STIMULUS].map(listed[column])
        rows = rows[found == check_name(name, sorted(found.unique()), column)]
    if "scale" in rows and len(several := sorted(rows["scale"].unique())) > 1:
        raise ValueError(
            f"scale must be given where there are several, got {', '.join(several)}; name one"
        )
    if rows.empty:
        raise ValueError("ratings must hold a choice between two stimuli or more, got none")
    if not rows["rating"].isin([LOWEST, HIGHEST]).all():
        raise ValueError("ratings must be 100 (stimulus_id was chosen) or 0 (other_id was chosen)")
    for name in (STIMULUS, OTHER):
        if strangers := sorted(set(rows[name]) - set(listed.index)):
            raise ValueError(
                f"{name} must be a stimulus of the table of stimuli, got {strangers[0]!r}"
            )
    return rows


def _keep_comparable(
    rows: DataFrame, listed: DataFrame, metrics: Sequence[str]
) -> tuple[DataFrame, list[str]]:
    """Keep the votes between test stimuli that have all metrics, about the recording itself."""
    both = [rows[name] for name in (STIMULUS, OTHER)]
    is_matched = rows["matched"] if "matched" in rows else np.ones(len(rows), dtype=bool)
    is_test = np.ones(len(rows), dtype=bool)
    if ROLE in listed:
        is_test = np.logical_and(*(ids.map(listed[ROLE]).to_numpy() == TEST for ids in both))
    known = listed[list(metrics)].notna().all(axis=1)
    is_known = np.logical_and(*(ids.map(known).to_numpy(bool) for ids in both))
    kept = np.asarray(is_matched, dtype=bool) & is_test & is_known
    notes = []
    if lost := int((is_test & ~kept).sum()):
        notes.append(
            f"{lost} choices have another reference than the recording, or a stimulus without a value of some metric: "
            "no metric is tested on them."
        )
    if not kept.any():
        raise ValueError(notes[0] if notes else "No choice is between two test stimuli.")
    return rows[kept], notes


def _number(
    rows: DataFrame,
    listed: DataFrame,
    *,
    metrics: Sequence[str],
    higher: Mapping[str, Direction],
    notes: Sequence[str],
) -> Votes:
    import pandas as pd

    one, other = (rows[name].astype(str).to_numpy() for name in (STIMULUS, OTHER))
    names, codes = np.unique(np.concatenate([one, other]), return_inverse=True)
    first, second = np.split(codes.astype(np.intp), 2)
    if (first == second).any():
        raise ValueError(
            f"other_id must be another stimulus than stimulus_id, got {one[first == second][0]!r} twice"
        )
    about = (
        rows["reference_id"].fillna("")
        if "reference_id" in rows
        else pd.Series("", index=rows.index)
    )
    low, high = np.minimum(first, second), np.maximum(first, second)
    met = pd.MultiIndex.from_arrays([low, high, about.to_numpy()])
    origin = "source" if "source" in listed else "recording"
    signs = np.array([-1.0 if higher.get(name) == "worse" else 1.0 for name in metrics])
    values = listed.loc[names, list(metrics)].to_numpy(np.float64) * signs
    return Votes(
        participant=pd.factorize(rows["participant"])[0],
        source=pd.factorize(rows[STIMULUS].map(listed[origin]))[0],
        pair=pd.factorize(met)[0],
        turned=first > second,
        first=first,
        second=second,
        chose_first=(rows["rating"] == HIGHEST).to_numpy(),
        names=tuple(names.tolist()),
        metrics=tuple(metrics),
        differences=values[first] - values[second],
        notes=tuple(notes),
    )


def cluster_products(votes: Votes, scores: Values) -> tuple[Values, Values, Values]:
    """Add scores, (n_votes, n), by participant, source and both, and multiply the sums with themselves: (n, n) each.

    Each is corrected for the number of groups G by G / (G - 1).
    """
    cells = votes.participant * votes.n_sources + votes.source
    found = []
    for groups in (votes.participant, votes.source, cells):
        codes = np.unique(groups, return_inverse=True)[1]
        sums = np.stack([np.bincount(codes, column) for column in scores.T], axis=1)
        found.append(sums.T @ sums * (len(sums) / max(len(sums) - 1, 1)))
    one, other, both = (np.asarray(product, dtype=np.float64) for product in found)
    return one, other, both
