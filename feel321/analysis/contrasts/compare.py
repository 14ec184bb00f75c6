"""Reducers compared by their ratings: means, contrasts, equivalence and non-inferiority with a margin fixed beforehand.

Conventions: hidden reference and anchors have their place here (their role marks them); repeats are averaged
first, then a participant's stimuli, then participants, so that nobody counts twice for having judged more.
"""

import math
from collections.abc import Sequence

import numpy as np
from pandas import DataFrame
from scipy.linalg import helmert
from scipy.stats import f as fisher
from scipy.stats import t

from feel321.analysis.arrays import UPPER, check_columns, read_numbers
from feel321.analysis.mixed.model import MixedFit, contrast, fit_mixed
from feel321.analysis.table.items import (
    Table,
    choose_arms,
    find_sources,
    leave_rejected,
    name_items,
    open_ratings,
    open_tests,
)
from feel321.analysis.table.schema import HIGHEST, LOWEST
from feel321.arguments import check_name
from feel321.records import Statistic

SIGNIFICANCE = 0.05


def equivalence(estimate: float, se: float, df: float, *, low: float, high: float) -> Statistic:
    """Test whether an estimate lies within a margin: two one-sided tests.

    Parameters
    ----------
    estimate : float
        A difference, or a contrast of a mixed model.
    se : float
        Its standard error, above 0.
    df : float
        Its degrees of freedom (Satterthwaite's, for a mixed model); infinity for a normal estimate.
    low, high : float
        Ends of the margin, in the estimate's unit, fixed before seeing data: the largest difference that
        would not matter. One that is computed from the ratings themselves grows with their noise.

    Returns
    -------
    Statistic
        ``estimate``; ``t_low p_low``, against `low`, and ``t_high p_high``, against `high`, one-sided; ``p``, the
        larger; ``low90 high90``, the 90 % interval, within the margin exactly if p < .05; ``low high equivalent``.

    Notes
    -----
    H0: the true value is at `low` or below, or at `high` or above. t_low = (estimate - low)/se and t_high =
    (estimate - high)/se, each against t(df), one-sided; p is the larger, and no correction is due because both must be
    rejected. A difference that is not significant is *not* evidence of equivalence, and an estimate may be both
    different from 0 and equivalent. One without a standard error (a singular fit) is refused. The test against `low`
    alone is that of non-inferiority, where higher is better (Piaggio et al. 2012, doi 10.1001/jama.2012.87802).

    References
    ----------
    Schuirmann (1987), doi 10.1007/BF01068419; Lakens (2017), doi 10.1177/1948550617697177.

    Examples
    --------
    Two reducers differ by 1.5 points, standard error 1.2, on 11 degrees of freedom; up to 5 do not matter:

    >>> from feel321 import analysis
    >>> result = analysis.equivalence(1.5, 1.2, 11, low=-5, high=5)
    >>> round(result.t_high, 3), round(result.p, 4), result.equivalent
    (-2.917, 0.007, True)
    """
    for name, value in {"estimate": estimate, "low": low, "high": high}.items():
        if not math.isfinite(value):
            raise ValueError(f"{name} must be a finite number, got {value}")
    if not 0 < se < math.inf:
        raise ValueError(f"se must be finite and above 0, got {se}; a singular fit tests nothing")
    if not df > 0:
        raise ValueError(f"df must be above 0, infinity for a normal estimate, got {df}")
    if low >= high:
        raise ValueError(f"low must be below high, got {low} with high {high}; swap them")
    t_low, t_high = (estimate - low) / se, (estimate - high) / se
    p_low, p_high = float(t.sf(t_low, df)), float(t.cdf(t_high, df))
    p, (low90, high90) = max(p_low, p_high), find_interval90(estimate, se, df)
    return Statistic(
        "Equivalence", estimate=estimate, t_low=t_low, p_low=p_low, t_high=t_high, p_high=p_high, p=p,
        low90=low90, high90=high90, low=low, high=high, equivalent=p < SIGNIFICANCE,
    )  # fmt: skip


def find_interval90(estimate: float, se: float, df: float) -> tuple[float, float]:
    """Find the 90 % interval, which lies within a margin exactly if two one-sided tests at 5 % show equivalence."""
    half = float(t.ppf(1 - SIGNIFICANCE, df)) * se
    return estimate - half, estimate + half


GROUP = ["scale", "level", "role", "reducer"]  # What a profile is split by


def participant_means(ratings: Table | DataFrame) -> DataFrame:
    """Mean rating that each participant gave each reducer."""
    ratings = _read_rows(ratings, [*GROUP, "participant", "stimulus_id"])
    cells = ratings.groupby([*GROUP, "participant", "stimulus_id"], observed=True)["rating"].mean()
    return cells.groupby([*GROUP, "participant"], observed=True).mean().reset_index()


def profile_reducers(ratings: Table | DataFrame) -> DataFrame:
    """Mean rating of each reducer with its interval over participants: a row per scale, level, role and reducer.

    The interval is mean ± t(.975, P - 1) SD / sqrt(P) over the P participants' means: it holds for other
    participants judging these recordings, not for other recordings. It ends where the scale ends. NaN for a single
    participant, and where all means are alike, as at an end of the scale: that does not show how people differ.
    """
    profile = _summarise(participant_means(ratings), GROUP)
    rows = _read_rows(ratings, GROUP).groupby(GROUP, observed=True)
    counts = rows.agg(n_stimuli=("stimulus_id", "nunique"), n_ratings=("rating", "size"))
    return profile.join(counts).reset_index()


def stimulus_means(ratings: Table | DataFrame) -> DataFrame:
    """Mean rating of each stimulus with its interval over participants."""
    key = ["scale", "level", "role", "recording", "reducer", "stimulus_id"]
    ratings = _read_rows(ratings, [*key, "participant"])
    cells = ratings.groupby([*key, "participant"], observed=True)["rating"].mean().reset_index()
    return _summarise(cells, key).reset_index()


def _read_rows(ratings: Table | DataFrame, names: list[str]) -> DataFrame:
    """Leave out rejected rows; refuse what would drop out of a mean unseen."""
    table = open_ratings(ratings)
    check_columns(table, [*names, "rating"], "ratings")
    rows, _ = leave_rejected(table)
    values = read_numbers(rows["rating"], what="ratings, 'rating'")
    if n := int((rows[names].isna().any(axis=1) | ~np.isfinite(values)).sum()):
        must = f"ratings must have {', '.join(names)} and a finite rating in each row"
        raise ValueError(f"{must}, got {n} without; leave them out")
    return rows.assign(rating=values)


def _summarise(means: DataFrame, key: list[str]) -> DataFrame:
    """Average participants' means; t interval over participants."""
    table = means.groupby(key, observed=True)["rating"].agg(["mean", "std", "size", "nunique"])
    n = table["size"].to_numpy(np.float64)
    spread = table["std"].where(table["nunique"] > 1).to_numpy(np.float64)
    with np.errstate(invalid="ignore"):
        margin = t.ppf(UPPER, n - 1) * spread / np.sqrt(n)
    table = table.rename(columns={"size": "n_participants"})
    table["low"] = (table["mean"] - margin).clip(lower=LOWEST)
    table["high"] = (table["mean"] + margin).clip(upper=HIGHEST)
    return table[["mean", "low", "high", "n_participants"]]


CELL = ["participant", "recording", "reducer", "item"]
# Spreads of the model of reducers -> the columns that they are over
GROUPS = {
    "participant": ["participant"], "recording": ["recording"], "item": ["item"],
    "participant:recording": ["participant", "recording"], "participant:which": ["participant", "reducer"],
    "source": ["source"], "source:which": ["source", "reducer"],
}  # fmt: skip


def compare_reducers(
    ratings: Table | DataFrame,
    first: str,
    second: str,
    *,
    scale: str | None = None,
    level: str | None = None,
    margin: float | None = None,
) -> Statistic:
    """Compare the ratings of two reducers: fit a mixed model, contrast it, and test the difference against a margin.

    Parameters
    ----------
    ratings : Table or DataFrame
        Ratings: participant, recording, reducer, stimulus_id, rating.
    first, second : str
        The reducers.
    scale, level : str, optional
        Which ratings; needed where there are several scales or levels.
    margin : float, optional
        Largest difference in points that would not matter, fixed before seeing data. Left out, neither equivalence nor
        non-inferiority is tested: a margin taken from the data grows with their noise.

    Returns
    -------
    Statistic
        ``first second``; ``estimate se df p``, the difference first minus second in points; ``low high low90 high90``,
        95 % and 90 % interval; ``margin p_equivalence p_non_inferiority``, NaN without a margin; ``equivalent
        non_inferior``, None without; ``n``, participant x stimulus cells; ``formula notes``.

    Notes
    -----
    Model: rating = reducer + random effects of participants, recordings, sources, stimuli, and participants'
    recordings and reducers, as far as each has several rows; repeats are averaged first. All reducers are in the
    model: they share its spreads. Tests as in `equivalence`, on Satterthwaite's degrees of freedom; non-inferiority is
    that the first is not worse than the second by the margin.
    """
    rows = open_ratings(choose_arms(ratings, scale, level))
    rows, notes = open_tests(name_items(rows), named=["recording", "reducer"])
    rated = sorted(rows["reducer"].unique())
    for name, what in ((first, "first"), (second, "second")):
        check_name(name, rated, what)
    if first == second:
        raise ValueError(f"second must be another reducer than the first, got {second!r} twice")
    if margin is not None and not margin > 0:
        raise ValueError(f"margin must be above 0 points, got {margin}")
    fit, terms, n = fit_reducers(rows, rated)
    found = contrast(fit, {terms[first]: 1, terms[second]: -1})
    numbers = found.estimate, found.se, found.df
    low90, high90 = find_interval90(*numbers)
    same = None if margin is None else equivalence(*numbers, low=-margin, high=margin)
    return Statistic(
        "ReducerDifference", first=first, second=second, estimate=found.estimate, se=found.se, df=found.df, p=found.p,
        low=found.low, high=found.high, low90=low90, high90=high90, margin=math.nan if margin is None else margin,
        p_equivalence=same.p if same else math.nan, p_non_inferiority=same.p_low if same else math.nan,
        equivalent=same.equivalent if same else None, non_inferior=same.p_low < SIGNIFICANCE if same else None,
        n=n, formula=fit.formula, notes=tuple(notes),
    )  # fmt: skip


def fit_reducers(rows: DataFrame, names: Sequence[str]) -> tuple[MixedFit, dict[str, str], int]:
    """Fit the model of `compare_reducers`; return it, the term of each reducer, and how many cells there are.

    A spread that has one row per level is in the residual already.
    """
    cells = rows.groupby(CELL, observed=True)["rating"].mean().reset_index()
    codes = {name: f"c{number}" for number, name in enumerate(names)}
    sources = cells["recording"].map(find_sources(rows))
    cells = cells.assign(source=sources, which=cells["reducer"].map(codes))
    sizes = {name: len(cells.drop_duplicates(columns)) for name, columns in GROUPS.items()}
    dropped: tuple[str, ...] = ()
    if sizes["recording"] == 1:
        dropped += ("item", "participant:recording")
    if sizes["source"] in {1, sizes["recording"]}:
        dropped += ("source", "source:which")
    if sizes["participant"] == 1:
        dropped += ("participant", "participant:recording", "participant:which")
    kept = [name for name, n in sizes.items() if 1 < n < len(cells) and name not in dropped]
    if not kept:
        must = "ratings must be of several participants or recordings, got one of each"
        raise ValueError(f"{must}: nothing is left to judge a difference by")
    formula = " + ".join(["rating ~ 0 + which", *(f"(1 | {name})" for name in kept)])
    terms = {name: f"which{code}" for name, code in codes.items()}
    return fit_mixed(formula, cells), terms, len(cells)


def compare_terms(fit: MixedFit, terms: Sequence[str]) -> Statistic:
    """Test whether the terms of a mixed model's factor, one per level, are all alike: F with Satterthwaite's df.

    The contrasts are made independent by the eigenvectors of their covariance; F is the mean of their t², and the
    denominator's df is matched to that mean's expectation, as lmerTest's ``contestMD`` does.

    Source: Fai & Cornelius (1996), doi 10.1080/00949659608811740.
    """
    places = [list(fit.fixed.index).index(name) for name in terms]
    basis = helmert(len(terms))
    covariance = basis @ fit.uncertainty.covariance[np.ix_(places, places)] @ basis.T
    turned = np.linalg.eigh(covariance)[1].T @ basis
    found = [contrast(fit, dict(zip(terms, weights.tolist(), strict=True))) for weights in turned]
    f, df_1 = float(np.mean([one.t**2 for one in found])), float(len(found))
    df_2 = min(one.df for one in found)
    if df_2 > 2 and len(found) > 1:  # noqa: PLR2004 - F has a mean above
        expected = sum(one.df / (one.df - 2) for one in found)
        df_2 = 2 * expected / (expected - df_1)
    p = float(fisher.sf(f, df_1, df_2))
    return Statistic("JointTest", statistic=f, df_1=df_1, df_2=float(df_2), p=p)
