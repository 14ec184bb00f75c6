"""Further metrics: what else may predict ratings, beside the metrics that the analysis was planned for.

They are the rotation statistics of the metrics, the metrics of signals as they were delivered, and counterparts that no
orientation of the sensor changes (`analysis.table.schema.FURTHER`). A stimulus has them from the manifest, from the
ratings (the mean over its judgements), or from whoever asks for the report. They are explored: no primary analysis and
no correction for several tests holds them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from analysis.table.gaps import list_names
from analysis.table.schema import describe_explored, describe_further
from analysis.table.sheet import LARGEST

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from pandas import DataFrame


@dataclass(frozen=True, slots=True, eq=False)
class Further:
    """Further metrics that neither file holds.

    Parameters
    ----------
    metrics : DataFrame
        Indexed by stimulus_id; columns of `analysis.table.schema.describe_further`.
    notes : tuple of str
        How they were computed, or why they were not, one sentence each.
    """

    metrics: DataFrame
    notes: tuple[str, ...] = ()


def join_further(
    manifest: DataFrame, ratings: DataFrame, handed: DataFrame | None, *, names: tuple[str, str]
) -> tuple[DataFrame, list[str]]:
    """Give every stimulus the further metrics that there are.

    Parameters
    ----------
    manifest : DataFrame
        Stimuli, indexed by stimulus_id.
    ratings : DataFrame
        Judgements that count: stimulus_id.
    handed : DataFrame or None
        Values that neither file holds, indexed by stimulus_id.
    names : tuple of str
        What the files of ratings and stimuli are called.

    Returns
    -------
    manifest : DataFrame
        The same, and a column for each further metric of the other two.
    notes : list of str
        Which ones were averaged over judgements.

    Raises
    ------
    ValueError
        If a metric comes from two places, or what is handed over is none or not finite.
    """
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
        raise ValueError(f"{what}: got '{doubled[0]}' in both; keep one, or a stimulus would have two values of it")


def _check_handed(handed: DataFrame) -> None:
    allowed = describe_further()
    for name in handed:
        if name not in allowed:
            raise ValueError(f"further metrics: got column {name!r}, allowed is one of {', '.join(allowed)}")
        values = handed[name].to_numpy(np.float64)
        if not (np.isnan(values) | (np.abs(values) <= LARGEST)).all():
            raise ValueError(f"further metrics: got infinite or huge values of '{name}'; allowed are finite ones")
    if not handed.index.is_unique:
        raise ValueError("further metrics: got a stimulus twice in the index; allowed is one row per stimulus_id")


def list_further(rows: DataFrame, metrics: Sequence[str]) -> tuple[str, ...]:
    """List the metrics that every rated test stimulus has and that the primary analysis is not about.

    Parameters
    ----------
    rows : DataFrame
        Judgements: role, and columns of metrics.
    metrics : sequence of str
        Those of the primary analysis.

    Returns
    -------
    tuple of str
        In the order of `analysis.table.schema.describe_explored`.
    """
    tests, explored = rows["role"] == "test", describe_explored(metrics)
    return tuple(name for name in explored if name in rows and rows.loc[tests, name].notna().all())


def note_lacking(rows: DataFrame, metrics: Sequence[str]) -> Iterator[str]:
    """Say which further metrics some rated test stimuli lack.

    Parameters
    ----------
    rows : DataFrame
        Judgements: stimulus_id, role, and columns of metrics.
    metrics : sequence of str
        Those of the primary analysis.

    Yields
    ------
    str
        One sentence each.
    """
    tests = rows[rows["role"] == "test"]
    for name in (name for name in describe_explored(metrics) if name in rows):
        lacking = tests.loc[tests[name].isna(), "stimulus_id"].unique()
        if len(lacking):
            told = f"{len(lacking)} rated test stimuli have none, first {list_names([str(lacking[0])])}"
            yield f"'{name}' is not reported: {told}."
