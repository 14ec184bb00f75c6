"""Classic tests of reducers beside the mixed model: repeated-measures ANOVA and Friedman's test.

Both take a participant's mean over recordings, or cells, for a datum: recordings are not drawn, so that their p is
about these recordings, and a participant with an empty cell is left out.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from feel321.analysis.arrays import check_columns
from feel321.analysis.mixed.model import contrast

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pandas import DataFrame

    from feel321.analysis.arrays import Values
    from feel321.analysis.mixed.model import MixedFit

FEWEST = 2
"""Participants, and levels of a factor, that a test needs."""

FRIEDMAN_LEVELS = 3
"""Levels that Friedman's test needs; with two it is a sign test."""

MOST_CELLS = 3000
"""Participants' cells: the design matrix of the ANOVA is dense and grows with their square."""


@dataclass(frozen=True, slots=True)
class RepeatedTest:
    """A test of one effect as a whole.

    test: anova, friedman or mixed (the mixed model's); effect: factors joined by " x "; statistic: F or Friedman's χ²;
    epsilon: Greenhouse and Geisser's, 1 where the variances of all differences are equal (sphericity), NaN for
    interactions and other tests; p_sphericity: p if that were so; p: with degrees of freedom times epsilon, where that
    is known.
    """

    test: str
    effect: str
    statistic: float
    df_1: float
    df_2: float
    epsilon: float
    p_sphericity: float
    p: float
    n_participants: int = 0
    n_left_out: int = 0


def compare_repeated(
    rows: DataFrame, *, within: tuple[str, ...] = ("reducer",)
) -> list[RepeatedTest]:
    """Compare the means of one or two factors within participants, by repeated-measures ANOVA and Friedman's test.

    rows: a rating per row with `participant`, `rating` and the factors; the first is what Friedman's test compares.

    References: Greenhouse & Geisser (1959), doi 10.1007/BF02289823.
    """
    from statsmodels.stats.anova import AnovaRM

    cells, left_out = _find_complete(rows, within)
    long = cells.melt(ignore_index=False, value_name="rating").reset_index()
    table = AnovaRM(long, "rating", "participant", within=list(within)).fit().anova_table
    found = []
    for effect, row in table.iterrows():
        names = str(effect).split(":")
        means = cells if len(within) == 1 else cells.T.groupby(level=names).mean().T
        epsilon = find_epsilon(means.to_numpy()) if len(names) == 1 else float("nan")
        f, *dfs = (float(row[name]) for name in ("F Value", "Num DF", "Den DF"))
        found.append(_correct(" x ".join(names), f, dfs, epsilon=epsilon))
    first = cells if len(within) == 1 else cells.T.groupby(level=within[0]).mean().T
    found += _rank(first.to_numpy(), within[0])
    return [replace(one, n_participants=len(cells), n_left_out=left_out) for one in found]


def _correct(effect: str, f: float, dfs: Sequence[float], *, epsilon: float) -> RepeatedTest:
    """Make the test of an effect, its degrees of freedom times epsilon where that is known."""
    from scipy.stats import f as fisher

    df_1, df_2 = dfs
    share = epsilon if np.isfinite(epsilon) else 1.0
    plain, corrected = (float(fisher.sf(f, one * df_1, one * df_2)) for one in (1.0, share))
    return RepeatedTest("anova", effect, f, df_1, df_2, epsilon, plain, corrected)


def _rank(cells: Values, effect: str) -> list[RepeatedTest]:
    """Make Friedman's test of (participants, levels)."""
    from scipy.stats import friedmanchisquare

    if cells.shape[1] < FRIEDMAN_LEVELS:
        return []
    chi, p = (float(one) for one in friedmanchisquare(*cells.T))
    none, df = float("nan"), float(cells.shape[1] - 1)
    return [RepeatedTest("friedman", effect, chi, df, none, none, none, p)]


def find_epsilon(cells: Values) -> float:
    """Find Greenhouse and Geisser's epsilon of (participants, levels): 1 is sphericity, 1 / (levels - 1) the least."""
    levels = cells.shape[1]
    centre = np.eye(levels) - 1 / levels
    spread = centre @ np.cov(cells, rowvar=False) @ centre
    square = float((spread**2).sum())
    return float(np.trace(spread) ** 2 / ((levels - 1) * square)) if square > 0 else float("nan")


def _find_complete(rows: DataFrame, within: tuple[str, ...]) -> tuple[DataFrame, int]:
    """Average every participant's cells, and leave out whoever lacks one."""
    check_columns(rows, ["participant", "rating", *within], "ratings")
    cells = rows.pivot_table("rating", "participant", list(within), observed=True)
    if any(len(rows[name].unique()) < FEWEST for name in within):
        raise ValueError(f"ratings must be of {FEWEST} levels or more of {' and '.join(within)}")
    sizes = np.prod([len(rows[name].unique()) for name in within])
    complete = cells.dropna()
    complete = complete if cells.shape[1] == sizes else complete.iloc[:0]
    if len(complete) < FEWEST:
        raise ValueError(
            f"{FEWEST} participants or more must have rated every {' x '.join(within)}, got {len(complete)}"
        )
    if complete.size > MOST_CELLS:
        raise ValueError(f"{complete.size} cells are more than the {MOST_CELLS} that are tried")
    if complete.sub(complete.mean(axis=1), axis=0).round(9).nunique().max() <= 1:
        raise ValueError(
            "all participants differ alike between levels: nothing is left to test against"
        )
    return complete, len(cells) - len(complete)


def compare_terms(fit: MixedFit, terms: Sequence[str]) -> RepeatedTest:
    """Test whether the terms of a mixed model's factor, one per level, are all alike: F with Satterthwaite's df.

    The contrasts are made independent by the eigenvectors of their covariance; F is the mean of their t², and the
    denominator's df is matched to that mean's expectation, as lmerTest's ``contestMD`` does.

    Source: Fai & Cornelius (1996), doi 10.1080/00949659608811740.
    """
    from scipy.linalg import helmert
    from scipy.stats import f as fisher

    places = [list(fit.fixed.index).index(name) for name in terms]
    basis = helmert(len(terms))
    covariance = basis @ fit.uncertainty.covariance[np.ix_(places, places)] @ basis.T
    turned = np.linalg.eigh(covariance)[1].T @ basis
    found = [contrast(fit, dict(zip(terms, weights.tolist(), strict=True))) for weights in turned]
    f, df_1 = float(np.mean([one.t**2 for one in found])), float(len(found))
    expected = sum(one.df / (one.df - 2) if one.df > 2 else np.inf for one in found)  # noqa: PLR2004 - F has a mean above
    df_2 = (
        2 * expected / (expected - df_1) if np.isfinite(expected) else min(one.df for one in found)
    )
    df_2 = found[0].df if len(found) == 1 else df_2
    none, p = float("nan"), float(fisher.sf(f, df_1, df_2))
    return RepeatedTest("mixed", "reducer", f, df_1, float(df_2), none, none, p)
