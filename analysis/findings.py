"""Everything that is computed from a table of ratings, before a word or a picture is made of it."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np

from analysis.association.correlate import Association, Difference, compare_metrics, correlate
from analysis.contrasts.profile import participant_means, profile_reducers, stimulus_means
from analysis.resampling.bootstrap import METHODS
from analysis.table.scales import APART, PAIR

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pandas import DataFrame

    from analysis.table.reading import Table


@dataclass(frozen=True, slots=True, eq=False)
class Panel:
    """Findings on the test stimuli of one scale and one level.

    Parameters
    ----------
    scale, level : str
        Which ratings.
    associations : tuple of Association
        Per metric and method.
    differences : tuple of Difference
        Per pair of metrics and method.
    stimuli : DataFrame
        One row per test stimulus: stimulus_id, recording, reducer, mean, low, high, n_participants, each
        metric.
    """

    scale: str
    level: str
    associations: tuple[Association, ...]
    differences: tuple[Difference, ...]
    stimuli: DataFrame


@dataclass(frozen=True, slots=True, eq=False)
class Findings:
    """Everything computed from a table.

    Parameters
    ----------
    panels : tuple of Panel
        Per scale and level, without the scales of `APART`. Levels are kept apart because a louder arm may be
        rated higher for being louder.
    profile : DataFrame
        What `profile_reducers` returns, all roles; pairs of two test stimuli left out.
    participants : DataFrame
        What `participant_means` returns, of the same.
    scales : tuple of str
        All that were rated, by alphabet.
    """

    panels: tuple[Panel, ...]
    profile: DataFrame
    participants: DataFrame
    scales: tuple[str, ...]


def analyse(table: Table, *, draws: int, rng: np.random.Generator) -> Findings:
    """Compute everything that a report shows.

    Parameters
    ----------
    table : Table
        Ratings and metrics.
    draws : int
        Bootstrap draws per interval.
    rng : Generator
        Source of randomness.

    Returns
    -------
    Findings
        Associations per scale and level; profiles of all reducers.

    Raises
    ------
    ValueError
        If no test stimulus was rated.
    """
    rows = table.rows
    refuse_untested(table)
    rated = rows[(rows["role"] == "test") & ~rows["scale"].isin(APART)]
    groups = rated.groupby(["scale", "level"], observed=True)
    panels = tuple(make_panel(part, table.metrics, draws=draws, rng=rng) for _, part in groups)
    single = rows[rows["role"] != PAIR]
    return Findings(panels, profile_reducers(single), participant_means(single), tuple(sorted(rows["scale"].unique())))


def refuse_untested(table: Table) -> None:
    """Refuse ratings of references and anchors alone.

    Parameters
    ----------
    table : Table
        What was rated.

    Raises
    ------
    ValueError
        If no test stimulus was rated, alone or in a pair.
    """
    if not table.rows["role"].isin(["test", PAIR]).any():
        raise ValueError("ratings: got none of a stimulus with role 'test'; at least one is needed")


def make_panel(part: DataFrame, metrics: tuple[str, ...], *, draws: int, rng: np.random.Generator) -> Panel:
    """Correlate the ratings of one scale and one level with every metric, by every method.

    Parameters
    ----------
    part : DataFrame
        Tidy table of their test stimuli.
    metrics : tuple of str
        Columns to correlate with.
    draws : int
        Bootstrap draws per interval.
    rng : Generator
        Source of randomness.

    Returns
    -------
    Panel
        Associations, differences and stimuli.
    """
    # The same draws for every metric and method: a further metric changes nothing, and metrics that say the same get
    # the same intervals.
    seed = int(rng.integers(2**63))
    one = [(metric, method) for metric in metrics for method in METHODS]
    two = [(first, second, method) for first, second in combinations(metrics, 2) for method in METHODS]
    of_stimuli = part.drop_duplicates("stimulus_id").set_index("stimulus_id")[list(metrics)]
    return Panel(
        scale=str(part["scale"].iloc[0]),
        level=str(part["level"].iloc[0]),
        associations=tuple(
            correlate(part, metric, method=method, draws=draws, rng=np.random.default_rng(seed))
            for metric, method in one
        ),
        differences=tuple(
            compare_metrics(part, first, second, method=method, draws=draws, rng=np.random.default_rng(seed))
            for first, second, method in two
        ),
        stimuli=stimulus_means(part).join(of_stimuli, on="stimulus_id"),
    )


def stack_records(panels: Sequence[Panel], kind: str) -> DataFrame:
    """Lay associations or differences out as a table to be written.

    Parameters
    ----------
    panels : sequence of Panel
        All of them.
    kind : str
        ``associations`` or ``differences``.

    Returns
    -------
    DataFrame
        One row each.
    """
    import pandas as pd

    return pd.DataFrame(
        [
            {"scale": panel.scale, "level": panel.level, **asdict(record), "notes": " ".join(record.notes)}
            for panel in panels
            for record in getattr(panel, kind)
        ]
    )
