"""RULES: the one list of screening rules, with the source and the limit of each.

References
----------
.. [1] J. W. Tukey, Exploratory Data Analysis, 1977: hinges and fences.
.. [2] R. Pfister et al., Good things peak in pairs: a note on the bimodality coefficient, Frontiers in Psychology 4,
   2013, 700. doi:10.3389/fpsyg.2013.00700
.. [3] Recommendation ITU-R BS.1534-3 (2015), Method for the subjective assessment of intermediate quality level of
   audio systems, on post-screening of assessors.
"""

from __future__ import annotations

from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np

from feel321.analysis.arrays import read_numbers
from feel321.analysis.resampling import FEWEST_ITEMS, FLAT
from feel321.analysis.screening.judgements import (
    FEWEST_JUDGEMENTS,
    HIGHEST,
    SAME_POINTS,
    tell_shares,
    tell_values,
)
from feel321.protocols.mushra import MUSHRA

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping

    from numpy.typing import ArrayLike
    from pandas import DataFrame, Series

    from feel321.analysis.screening.judgements import Judgements

# Rules about a participant among the others, and two descriptions of how ratings of one item are spread.

REACH = 1.5
"""Fences stand this many hinge spreads outside the hinges."""

FEWEST_RATERS = 5
"""With fewer values no fence can leave one out, or a shape be told."""

UNIMODAL = 5 / 9
"""Multimodality coefficient of evenly spread values; above it, ratings may have more than one peak."""


def tukey_hinges(values: ArrayLike) -> tuple[float, float]:
    """Medians of the lower and the upper half; for odd n the median belongs to both.

    values: (n,), finite numbers, at least one.

    Examples
    --------
    >>> tukey_hinges([1, 2, 3, 4, 5])
    (2.0, 4.0)
    >>> tukey_hinges([1, 2, 3, 4, 5, 6])
    (2.0, 5.0)
    """
    ordered = np.sort(read_numbers(values, what="values").ravel())
    if not len(ordered) or not np.isfinite(ordered).all():
        raise ValueError(
            f"values: got {len(ordered)}, not all finite; allowed is one or more finite numbers"
        )
    half = (len(ordered) + 1) // 2
    return float(np.median(ordered[:half])), float(np.median(ordered[-half:]))


def tukey_fences(values: ArrayLike, *, step: float = 0.0) -> tuple[float, float]:
    """Find where outlying begins: 1.5 hinge spreads outside the hinges.

    Parameters
    ----------
    values : array_like, shape (n,)
        Finite numbers, at least one.
    step : float
        Points between neighbouring values of a scale of few steps: the hinge spread counts as one step at least, for
        where most raters choose one step, their neighbours on the next are no outliers.

    Returns
    -------
    tuple of float
        A value below the first or above the second is an outlier.

    Examples
    --------
    >>> tukey_fences([1, 2, 3, 4, 5])
    (-1.0, 7.0)
    """
    low, high = tukey_hinges(values)
    reach = REACH * max(high - low, step)
    return low - reach, high + reach


def multimodality(values: ArrayLike) -> float:
    """Tell from skewness and kurtosis whether values may have more than one peak.

    Parameters
    ----------
    values : array_like, shape (n,)
        Finite numbers.

    Returns
    -------
    float
        (g² + 1) / (k + 3 (n - 1)² / ((n - 2)(n - 3))), g the skewness and k the excess kurtosis, both corrected for
        sample size. Above 5/9 more than one peak is possible, as is strong skewness; NaN for fewer than 4 values and
        for values that are all the same.

    Raises
    ------
    ValueError
        If a value is not finite.

    Notes
    -----
    Use it to find items whose mean rating hides two camps of raters; look at their histogram before concluding. With
    fewer than some 20 raters it scatters widely.

    Examples
    --------
    >>> two_camps, one = [10, 11, 12, 13, 90, 91, 92, 93] * 4, [1, 3, 3, 4, 4, 4, 4, 5, 5, 7] * 3
    >>> round(multimodality(two_camps), 2), round(multimodality(one), 2)
    (0.85, 0.25)
    """
    from scipy.stats import kurtosis, skew

    given = read_numbers(values, what="values").ravel()
    n = len(given)
    if not np.isfinite(given).all():
        raise ValueError(
            f"values: got {int((~np.isfinite(given)).sum())} of {n} that are not finite; leave them out"
        )
    flat = n < 4 or ((given - given.mean()) ** 2).sum() <= FLAT * (given**2).sum()  # noqa: PLR2004 - divides by n - 3
    if flat:
        return float("nan")
    g, k = skew(given, bias=False), kurtosis(given, bias=False)
    return float((g**2 + 1) / (k + 3 * (n - 1) ** 2 / ((n - 2) * (n - 3))))


def judge_outliers(judgements: Judgements, limit: float) -> DataFrame:
    """Find raters whose ratings lie outside the fences of too many items.

    limit: on a scale of few steps a hinge spread counts as one step at least.
    """
    means = judgements.means()
    means = means.loc[:, means.notna().sum() >= FEWEST_RATERS]
    steps = judgements.rows.groupby("item")["step"].max().reindex(means.columns)
    fences = np.array([
        tukey_fences(means[item].dropna(), step=step)
        for item, step in zip(means, steps, strict=True)
    ]).reshape(-1, 2)
    outside = means.lt(fences[:, 0], axis=1) | means.gt(fences[:, 1], axis=1)
    count, n = outside.sum(axis=1), means.notna().sum(axis=1)
    return tell_values(count, n, count / n.where(n > 0), limit=limit)


def judge_reversed_scale(judgements: Judgements, limit: float) -> DataFrame:
    """Find raters who rate high what the others rate low.

    Returns naN for fewer than 8 items and for constant ratings.
    """
    import pandas as pd

    means = judgements.means()
    others = (means.sum() - means.fillna(0.0)) / (means.notna().sum() - means.notna()).replace(
        0, np.nan
    )
    others = others.where(means.notna())
    n = others.notna().sum(axis=1)
    r = pd.Series(
        [_correlate(means.loc[name], others.loc[name]) for name in means.index], index=means.index
    )
    return tell_values(n, n, r.where(n >= FEWEST_JUDGEMENTS), limit=limit, below=True)


def _correlate(own: object, other: object) -> float:
    one, two = np.asarray(own, dtype=np.float64), np.asarray(other, dtype=np.float64)
    both = np.isfinite(one) & np.isfinite(two)
    if both.sum() < FEWEST_ITEMS or np.ptp(one[both]) == 0 or np.ptp(two[both]) == 0:
        return float("nan")
    return float(np.corrcoef(one[both], two[both])[0, 1])


# Rules about one participant at a time: none of them is in a standard, and each says so.

ALL_BUT = 0.95
"""Share of ratings at one step from which on nobody is taken to have used the scale."""

ONE_SIDED = 1.6448536269514722
"""95 % point of the normal distribution."""

FASTEST_S = 0.5
"""Nobody feels, weighs and answers in less."""


def judge_straight_lining(judgements: Judgements, limit: float) -> DataFrame:
    """Find raters who leave the slider at one place.

    limit: on a scale of few steps, where a lenient rater uses the top step often, it is half as far
    from 1.
    """
    grouped = judgements.of_kind("test").groupby("participant", observed=True)["rating"]
    count = grouped.agg(_count_densest).reindex(judgements.participants, fill_value=0)
    n = grouped.size().reindex(judgements.participants, fill_value=0)
    share = count / n.where(n >= FEWEST_JUDGEMENTS)
    usual = tukey_fences(share.dropna())[1] if share.notna().any() else limit
    widened = max(limit, min(ALL_BUT, max((1 + limit) / 2, usual)))
    return tell_values(
        count, n, share, limit=np.where(judgements.rounding().to_numpy() > 0, widened, limit)
    )


def _count_densest(ratings: object) -> int:
    ordered = np.sort(np.asarray(ratings, dtype=np.float64))
    return int(
        (
            np.searchsorted(ordered, ordered + SAME_POINTS, side="right") - np.arange(len(ordered))
        ).max()
    )


def judge_test_retest(judgements: Judgements, limit: float) -> DataFrame:
    """Find raters whose second ratings do not go with their first: random clicking.

    Returns naN for fewer than 8 pairs, and where a participant's first or second ratings are all
    the same, which `judge_straight_lining` is about.
    """
    pairs = judgements.first_two()
    whose, times = pairs["participant"], pairs[["first", "second"]]
    centred = times - times.groupby(whose, observed=True).transform("mean")
    products = centred.assign(
        both=centred["first"] * centred["second"], first=centred["first"] ** 2
    )
    sums = products.assign(second=centred["second"] ** 2).groupby(whose, observed=True).sum()
    sums = sums.reindex(judgements.participants)
    n = whose.value_counts().reindex(judgements.participants, fill_value=0)
    constant = sums[["first", "second"]].min(axis=1) <= FLAT * HIGHEST**2 * n
    r = (sums["both"] / (sums["first"] * sums["second"]).mask(constant) ** 0.5).clip(-1, 1)
    variance = (sums[["first", "second"]].mean(axis=1) / n.where(n > 0)).mask(constant)
    left = (1 - judgements.rounding() / variance).clip(0, 1).fillna(1.0).to_numpy()
    shown = np.tanh(ONE_SIDED / np.sqrt(n.clip(lower=FEWEST_JUDGEMENTS).to_numpy() - 3))
    floor = np.minimum(limit, shown) * (left if limit > 0 else 1.0)
    return tell_values(n, n, r.where(n >= FEWEST_JUDGEMENTS), limit=floor, below=True)


def judge_repeat_sd(judgements: Judgements, limit: float) -> DataFrame:
    """Find raters who rate the same stimulus far apart: random clicking."""
    pairs = judgements.first_two()
    squares = ((pairs["first"] - pairs["second"]) ** 2).groupby(pairs["participant"], observed=True)
    n = squares.size().reindex(judgements.participants, fill_value=0)
    share = np.sqrt(squares.mean().reindex(judgements.participants) / 2) / HIGHEST
    widened = np.sqrt(limit**2 + judgements.rounding().to_numpy() / HIGHEST**2)
    return tell_values(n, n, share.where(n >= FEWEST_JUDGEMENTS), limit=widened)


def judge_too_fast(judgements: Judgements, limit: float) -> DataFrame:
    """Find raters who answer faster than they can have felt."""
    rows = judgements.rows
    timed = rows.iloc[:0].assign(response_time_s=0.0)
    if "response_time_s" in rows:
        timed = rows[rows["response_time_s"].notna()]
    fast = timed["response_time_s"] < FASTEST_S
    return tell_shares(
        fast, timed["participant"], participants=judgements.participants, limit=limit
    )


# Rules about the hidden reference and the anchors: ITU-R BS.1534-3, and one extension of it.

EXCELLENT = 90.0
"""The hidden reference is to be rated at least this, the mid anchor at most."""

MOST_RATERS = 0.25
"""If a larger share of raters puts the mid anchor above `EXCELLENT`, the excerpt was hardly degraded by it."""

MIDDLE = 50.0
"""What the low anchor may be rated at most, in the extension."""


def share_undegraded(judgements: Judgements) -> Series:
    """Share of raters who put the mid anchor of each excerpt above 90, repeats averaged."""
    mid = judgements.of_kind("mid")
    means = mid.groupby(["excerpt", "participant"], observed=True)["rating"].mean()
    return (means > EXCELLENT).groupby("excerpt").mean()


def judge_hidden_reference(judgements: Judgements, limit: float) -> DataFrame:
    """Find raters who put the hidden reference below 90 too often (BS.1534-3)."""
    rows = _select_counted(judgements, "reference")
    return tell_shares(
        rows["rating"] < EXCELLENT,
        rows["participant"],
        participants=judgements.participants,
        limit=limit,
    )


def judge_mid_anchor(judgements: Judgements, limit: float) -> DataFrame:
    """Find raters who put the mid anchor above 90 too often (BS.1534-3)."""
    rows = _select_counted(judgements, "mid")
    return tell_shares(
        rows["rating"] > EXCELLENT,
        rows["participant"],
        participants=judgements.participants,
        limit=limit,
    )


def judge_low_anchor(judgements: Judgements, limit: float) -> DataFrame:
    """Find raters who put the low anchor above the middle of the scale too often (an extension, not BS.1534-3)."""
    rows = judgements.of_kind("low")
    return tell_shares(
        rows["rating"] > MIDDLE,
        rows["participant"],
        participants=judgements.participants,
        limit=limit,
    )


def _select_counted(judgements: Judgements, kind: str) -> DataFrame:
    rows, shares = judgements.of_kind(kind), share_undegraded(judgements)
    return rows[~rows["excerpt"].isin(shares.index[shares > MOST_RATERS])]


# RULES: the one list of screening rules, with where each comes from and where its limit stands.

STANDARD, EXTENSION = "ITU-R BS.1534-3", "extension"

EXPERTISE = "expertise"
"""The rule that needs a source of randomness."""

EXPERTISE_LIMIT = 0.5
"""More than half of its measures, that is two of three, are no better than chance."""


@dataclass(frozen=True, slots=True)
class Rule:
    """A rule about raters.

    judge: judgements and limit -> table by participant.
    """

    says: str
    source: str
    limit: float
    judge: Callable[[Judgements, float], DataFrame] | None
    needs: str
    protocols: tuple[str, ...] = ()


SIGHTED = (MUSHRA.name,)
"""Protocols that show the reference beside the stimuli. Limits near the end of the scale presuppose that: somebody who
rates realism by itself, or a similarity from memory, has no reason to put the original at 90 or above."""

RULES: Mapping[str, Rule] = MappingProxyType(
    {
        "hidden_reference": Rule(
            "hidden reference below 90 on more than {limit:.0%} of items",
            STANDARD, 0.15, judge_hidden_reference, "MUSHRA ratings of a stimulus with role 'reference'", SIGHTED,
        ),
        "mid_anchor": Rule(
            "mid anchor above 90 on more than {limit:.0%} of items",
            STANDARD, 0.15, judge_mid_anchor, "MUSHRA ratings of an anchor named mid", SIGHTED,
        ),
        "low_anchor": Rule(
            "low anchor above 50 on more than {limit:.0%} of items",
            EXTENSION, 0.15, judge_low_anchor, "MUSHRA ratings of an anchor named low", SIGHTED,
        ),
        "straight_lining": Rule(
            "more than {limit:.0%} of ratings within 2 points of each other",
            EXTENSION, 0.5, judge_straight_lining, "8 ratings of test stimuli",
        ),
        "test_retest": Rule(
            "correlation of first and second ratings below {limit:g}, or what so many pairs show to be above zero",
            EXTENSION, 0.3, judge_test_retest, "8 test stimuli rated twice, not all alike",
        ),
        "repeat_sd": Rule(
            "standard deviation of repeated ratings above {limit:.0%} of the scale",
            EXTENSION, 0.2, judge_repeat_sd, "8 test stimuli rated twice",
        ),
        "reversed_scale": Rule(
            "correlation with the mean of the others below {limit:g}",
            EXTENSION, -0.3, judge_reversed_scale, "8 test stimuli that others rated too, not all alike",
        ),
        "too_fast": Rule(
            "more than {limit:.0%} of answers within 0.5 s",
            EXTENSION, 0.15, judge_too_fast, "column 'response_time_s'",
        ),
        "outliers": Rule(
            "outside Tukey's fences on more than {limit:.0%} of test stimuli",
            EXTENSION, 0.15, judge_outliers, "test stimuli that 5 raters rated",
        ),
        EXPERTISE: Rule(
            "more than {limit:.0%} of discrimination, reliability and agreement no better than shuffled ratings",
            "in the manner of Report ITU-R BS.2300", EXPERTISE_LIMIT, None, "test stimuli rated twice or by others too",
        ),
    }
)  # fmt: skip
"""Name -> rule, in the order of reports."""


def choose_limits(
    rules: Iterable[str] | Mapping[str, float] | None, *, random: bool
) -> dict[str, float]:
    """Settle which rules apply, and where their limits stand.

    Returns name -> limit, in the order of `RULES`.

    Examples
    --------
    >>> choose_limits(["mid_anchor"], random=False), choose_limits({"mid_anchor": 0.2}, random=False)
    ({'mid_anchor': 0.15}, {'mid_anchor': 0.2})
    """
    if rules is None:
        return {name: rule.limit for name, rule in RULES.items() if random or name != EXPERTISE}
    wanted = [rules] if isinstance(rules, str) else list(rules)
    own = dict(rules) if isinstance(rules, dict | MappingProxyType) else {}
    unknown = [name for name in wanted if name not in RULES]
    if unknown or not wanted:
        got = repr(unknown[0]) if unknown else "no rule"
        raise ValueError(f"rules: got {got}, allowed are {', '.join(RULES)}")
    if EXPERTISE in wanted and not random:
        raise ValueError(
            f"rules: got {EXPERTISE!r} without rng, which its permutations need; give a numpy Generator"
        )
    for name, limit in own.items():
        if not -1 <= limit <= 1:
            raise ValueError(
                f"rules: got the limit {limit} for {name!r}, allowed is -1 to 1; a share, not per cent"
            )
    return {
        name: float(own.get(name, rule.limit)) for name, rule in RULES.items() if name in wanted
    }
