"""Two reducers compared by their ratings: model, contrast and tests in one call."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from feel321.analysis.contrasts.equivalence import equivalence, non_inferiority
from feel321.analysis.mixed.model import contrast, fit_mixed
from feel321.analysis.table.items import Table, find_sources, name_items, open_ratings, open_tests
from feel321.doors import check_name
from feel321.records import Result

if TYPE_CHECKING:
    from pandas import DataFrame

CELL = ["participant", "recording", "reducer", "item"]

GROUPS = {
    "participant": ["participant"], "recording": ["recording"], "item": ["item"], "source": ["source"],
    "participant:recording": ["participant", "recording"], "participant:which": ["participant", "reducer"],
    "source:which": ["source", "reducer"],
}  # fmt: skip
"""Spreads of the model of reducers -> the columns that they are over."""


@dataclass(frozen=True, slots=True, repr=False, eq=False)
class ReducerDifference(Result):
    """Difference between the mean ratings of two reducers, and whether it matters.

    Parameters
    ----------
    first, second : str
        The reducers; the difference is first minus second.
    estimate, se, df, p : float
        Difference in points, its standard error, Satterthwaite's degrees of freedom, and two-sided p.
    low, high : float
        95 % interval of the difference.
    margin_low, margin_high : float
        The largest differences that would not matter.
    p_equivalence, p_non_inferiority : float
        That the difference lies within the margin; that the first is not worse than the second by more than it.
    equivalent, non_inferior : bool
        Whether these are below .05.
    n : int
        Participant x stimulus cells.
    formula : str
        The mixed model.
    notes : tuple of str
        Where the margin comes from, and what was left out.
    """

    first: str
    second: str
    estimate: float
    se: float
    df: float
    p: float
    low: float
    high: float
    margin_low: float
    margin_high: float
    p_equivalence: float
    p_non_inferiority: float
    equivalent: bool
    non_inferior: bool
    n: int
    formula: str
    notes: tuple[str, ...] = ()


def compare_reducers(
    ratings: Table | DataFrame,
    first: str,
    second: str,
    *,
    margin: float | None = None,
    low: float | None = None,
    high: float | None = None,
) -> ReducerDifference:
    """Compare the ratings of two reducers: fit a mixed model, contrast it, and test the difference against a margin.

    Parameters
    ----------
    ratings : Table or DataFrame
        Ratings of one scale and level: participant, recording, reducer, stimulus_id, rating.
    first, second : str
        The reducers.
    margin : float, optional
        Largest difference in points that would not matter, fixed before seeing data. Left out, half the standard
        deviation with which people repeat their ratings.
    low, high : float, optional
        The same where both sides differ, instead of `margin`: -5 and 5 are a margin of 5.

    Returns
    -------
    ReducerDifference
        The difference with its interval and tests.

    Notes
    -----
    Model: rating = reducer + random effects of participants, recordings, sources, stimuli, and participants'
    recordings and reducers, as far as each has several rows; repeats are averaged first. All reducers are in the
    model: they share its spreads. Tests as in `equivalence` and `non_inferiority`, on Satterthwaite's degrees of
    freedom.

    Examples
    --------
    >>> import numpy as np
    >>> import pandas as pd
    >>> from feel321 import analysis
    >>> rows = pd.DataFrame([(p, r, m) for p in "abcdef" for r in "tuvw" for m in ("dft321", "pca321")],
    ...     columns=["participant", "recording", "reducer"])
    >>> noise = np.random.default_rng(1).normal(0, 4, len(rows))
    >>> rows = rows.assign(stimulus_id=rows["recording"] + rows["reducer"],
    ...     rating=50 + 20 * (rows["reducer"] == "dft321") + noise)
    >>> found = analysis.compare_reducers(rows, "dft321", "pca321", margin=5)
    >>> round(found.estimate), found.equivalent, found.non_inferior
    (20, False, True)
    """
    rows, notes = open_tests(name_items(open_ratings(ratings)), named=["recording", "reducer"])
    rated = sorted(rows["reducer"].unique())
    for name, what in ((first, "first"), (second, "second")):
        check_name(name, rated, what)
    if first == second:
        raise ValueError(f"second must be another reducer than the first, got {second!r} twice")
    (low, high), more_notes = _find_margin(rows, margin, (low, high))
    cells = rows.groupby(CELL, observed=True)["rating"].mean().reset_index()
    codes = {name: f"c{number}" for number, name in enumerate(rated)}
    sources = cells["recording"].map(find_sources(rows))
    cells = cells.assign(source=sources, which=cells["reducer"].map(codes))
    fit = fit_mixed(formula := _write_formula(cells), cells)
    found = contrast(fit, {f"which{codes[first]}": 1, f"which{codes[second]}": -1})
    numbers = found.estimate, found.se, found.df
    same = equivalence(*numbers, low=low, high=high)
    worse = non_inferiority(*numbers, margin=low)
    return ReducerDifference(
        first, second, *numbers, found.p, found.low, found.high, low, high,
        p_equivalence=same.p, p_non_inferiority=worse.p, equivalent=same.equivalent,
        non_inferior=worse.non_inferior, n=len(cells), formula=formula, notes=(*notes, *more_notes),
    )  # fmt: skip


def _find_margin(
    rows: DataFrame, margin: float | None, ends: tuple[float | None, float | None]
) -> tuple[tuple[float, float], tuple[str, ...]]:
    low, high = ends
    if low is not None and high is not None and margin is None:
        return (low, high), ()
    if low is not None or high is not None:
        raise ValueError("margin must be one number, or low and high both, got another combination")
    if margin is None:
        cells = rows.groupby(["participant", "item"], observed=True)["rating"]
        freedom = int((cells.size() - 1).sum())
        squares = float(((rows["rating"] - cells.transform("mean")) ** 2).sum())
        if not squares > 0:
            raise ValueError(
                "margin must be given, because nobody rated a stimulus twice differently; fix it in points"
            )
        margin = float(np.sqrt(squares / freedom)) / 2
        note = "The margin is half the standard deviation with which people repeat their ratings."
        return (-margin, margin), (note,)
    if not margin > 0:
        raise ValueError(f"margin must be above 0 points, got {margin}")
    return (-margin, margin), ()


def _write_formula(cells: DataFrame) -> str:
    """Write the model; a spread that has one row per level is in the residual already."""
    sizes = {name: len(cells.drop_duplicates(columns)) for name, columns in GROUPS.items()}
    kept = [name for name, size in sizes.items() if 1 < size < len(cells)]
    dropped: tuple[str, ...] = ()
    if sizes["recording"] == 1:
        dropped += ("item", "participant:recording")
    if sizes["source"] in {1, sizes["recording"]}:
        dropped += ("source", "source:which")
    if sizes["participant"] == 1:
        dropped += ("participant", "participant:recording", "participant:which")
    if not (kept := [name for name in kept if name not in dropped]):
        raise ValueError(
            "ratings must be of several participants or recordings, got one of each: "
            "nothing is left to judge a difference by"
        )
    return " + ".join(["rating ~ 0 + which", *(f"(1 | {name})" for name in kept)])
