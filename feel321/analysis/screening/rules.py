"""RULES: the one list of screening rules, with the source and the limit of each; and the measures behind them.

Rules without a standard as their source are extensions, with limits by convention.

References
----------
.. [1] J. W. Tukey, Exploratory Data Analysis, 1977: hinges and fences.
.. [2] R. Pfister et al., Good things peak in pairs: a note on the bimodality coefficient, Frontiers in Psychology 4,
   2013, 700. doi:10.3389/fpsyg.2013.00700
.. [3] Recommendation ITU-R BS.1534-3 (2015), Method for the subjective assessment of intermediate quality level of
   audio systems, on post-screening of assessors.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import partial
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from feel321.analysis.arrays import FLAT, read_numbers
from feel321.analysis.resampling import FEWEST_ITEMS
from feel321.analysis.screening.judgements import FLOOR, SAME_POINTS, Judgements
from feel321.analysis.table.schema import HIGHEST
from feel321.doors import check_name, describe
from feel321.extensions import Method, call, find_method

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import ArrayLike
    from pandas import DataFrame, Series

FEWEST_JUDGEMENTS = 8
"""With fewer judgements, or pairs of them, a habit cannot be told from chance."""

REACH = 1.5
"""Fences stand this many hinge spreads outside the hinges."""

FEWEST_RATERS = 5
"""With fewer values no fence can leave one out, or a shape be seen."""

UNIMODAL = 5 / 9
"""Multimodality coefficient of evenly spread values; above it, ratings may have more than one peak."""

ALL_BUT = 0.95
"""Share of ratings at one step from which on nobody is taken to have used the scale."""

ONE_SIDED = 1.6448536269514722
"""95 % point of the normal distribution."""

FASTEST_S = 0.5
"""Nobody feels, weighs and answers in less."""

EXCELLENT = 90.0
"""The hidden reference is to be rated at least this, the mid anchor at most."""

MOST_RATERS = 0.25
"""If a larger share of raters puts the mid anchor above `EXCELLENT`, the excerpt was hardly degraded by it."""

MIDDLE = 50.0
"""What the low anchor may be rated at most, in the extension."""


def tukey_hinges(values: ArrayLike) -> tuple[float, float]:
    """Medians of the lower and the upper half; for odd n the median belongs to both."""
    ordered = np.sort(read_numbers(values, what="values").ravel())
    if not len(ordered) or not np.isfinite(ordered).all():
        raise ValueError(
            f"values must be one or more finite numbers, got {len(ordered)}, not all finite"
        )
    half = (len(ordered) + 1) // 2
    return float(np.median(ordered[:half])), float(np.median(ordered[-half:]))


def tukey_fences(values: ArrayLike, *, step: float = 0.0) -> tuple[float, float]:
    """Find where outlying begins: 1.5 hinge spreads outside the hinges.

    On a scale of few steps the hinge spread counts as one step at least: where most raters choose one step, their
    neighbours on the next are no outliers.
    """
    low, high = tukey_hinges(values)
    reach = REACH * max(high - low, step)
    return low - reach, high + reach


def multimodality(values: ArrayLike) -> float:
    """Measure by skewness and kurtosis whether values may have more than one peak.

    (g² + 1) / (k + 3 (n - 1)² / ((n - 2)(n - 3))), g the skewness and k the excess kurtosis, both corrected for
    sample size. Above 5/9 more than one peak is possible, as is strong skewness; NaN for fewer than 4 values and
    for values that are all the same. Use it to find items whose mean rating hides two camps of raters; look at their
    histogram before concluding. With fewer than some 20 raters it scatters widely.

    Examples
    --------
    >>> two_camps, one = [10, 11, 12, 13, 90, 91, 92, 93] * 4, [1, 3, 3, 4, 4, 4, 4, 5, 5, 7] * 3
    >>> round(multimodality(two_camps), 2), round(multimodality(one), 2)
    (0.85, 0.25)
    """
    given = read_numbers(values, what="values").ravel()
    n = len(given)
    if not np.isfinite(given).all():
        raise ValueError(
            f"values must be finite, got {int((~np.isfinite(given)).sum())} of {n} that are not; leave them out"
        )
    centred = given - given.mean() if n else given
    if n < 4 or (centred**2).sum() <= FLAT * (given**2).sum():  # noqa: PLR2004 - divides by n - 3
        return float("nan")
    # SciPy's skew and kurtosis take a hundred times as long for so few values.
    square, cube, fourth = (float((centred**power).mean()) for power in (2, 3, 4))
    g = cube / square**1.5 * np.sqrt(n * (n - 1)) / (n - 2)
    k = ((n + 1) * (fourth / square**2 - 3) + 6) * (n - 1) / ((n - 2) * (n - 3))
    return float((g**2 + 1) / (k + 3 * (n - 1) ** 2 / ((n - 2) * (n - 3))))


# What each rule finds of every participant: a table of count, n, share (NaN without judgements), limit and hit.


def compare_values(
    count: Series, n: Series, share: Series, *, limit: float | np.ndarray, below: bool = False
) -> DataFrame:
    """Compare a value of each participant with its limit; NaN flags nobody."""
    values = share.to_numpy(np.float64)
    limits = np.broadcast_to(np.asarray(limit, dtype=np.float64), share.shape)
    # 3 of 20 is 15 %, not more; a hair of rounding must not decide otherwise.
    clear = np.abs(values - limits) > 1e-12  # noqa: PLR2004 - rounding of one division
    hit = clear & ((values < limits) if below else (values > limits))
    columns = {"count": count.astype(int), "n": n.astype(int), "share": values}
    return pd.DataFrame({**columns, "limit": limits, "hit": hit}, index=share.index)


def _count_bad(judgements: Judgements, rows: DataFrame, bad: Series, *, limit: float) -> DataFrame:
    """Count how often each participant did what a rule forbids, and compare the share with its limit."""
    grouped = bad.groupby(rows["participant"].to_numpy(), observed=True)
    count = grouped.sum().reindex(judgements.participants, fill_value=0)
    n = grouped.size().reindex(judgements.participants, fill_value=0)
    return compare_values(count, n, count / n.where(n > 0), limit=limit)


def share_undegraded(judgements: Judgements) -> Series:
    """Share of raters who put the mid anchor of each excerpt above 90, repeats averaged."""
    mid = judgements.of_kind("mid")
    means = mid.groupby(["excerpt", "participant"], observed=True)["rating"].mean()
    return (means > EXCELLENT).groupby("excerpt").mean()


def _select_counted(judgements: Judgements, kind: str) -> DataFrame:
    rows, shares = judgements.of_kind(kind), share_undegraded(judgements)
    return rows[~rows["excerpt"].isin(shares.index[shares > MOST_RATERS])]


def _hidden_reference(judgements: Judgements, limit: float) -> DataFrame:
    rows = _select_counted(judgements, "reference")
    return _count_bad(judgements, rows, rows["rating"] < EXCELLENT, limit=limit)


def _mid_anchor(judgements: Judgements, limit: float) -> DataFrame:
    rows = _select_counted(judgements, "mid")
    return _count_bad(judgements, rows, rows["rating"] > EXCELLENT, limit=limit)


def _low_anchor(judgements: Judgements, limit: float) -> DataFrame:
    rows = judgements.of_kind("low")
    return _count_bad(judgements, rows, rows["rating"] > MIDDLE, limit=limit)


def _too_fast(judgements: Judgements, limit: float) -> DataFrame:
    timed = judgements.rows.assign(time=judgements.rows.get("response_time_s", np.nan))
    timed = timed[timed["time"].notna()]
    return _count_bad(judgements, timed, timed["time"] < FASTEST_S, limit=limit)


def _outliers(judgements: Judgements, limit: float) -> DataFrame:
    """Find raters outside the fences of too many items."""
    means = judgements.means()
    means = means.loc[:, means.notna().sum() >= FEWEST_RATERS]
    steps = judgements.rows.groupby("item")["step"].max().reindex(means.columns)
    pairs = zip(means, steps, strict=True)
    fences = [tukey_fences(means[item].dropna(), step=step) for item, step in pairs]
    low, high = np.array(fences).reshape(-1, 2).T
    outside = means.lt(low, axis=1) | means.gt(high, axis=1)
    count, n = outside.sum(axis=1), means.notna().sum(axis=1)
    return compare_values(count, n, count / n.where(n > 0), limit=limit)


def _reversed_scale(judgements: Judgements, limit: float) -> DataFrame:
    """Correlate with the mean of the others; NaN for fewer than 8 items and for constant ratings."""
    means = judgements.means()
    n_others = (means.notna().sum() - means.notna()).replace(0, np.nan)
    others = ((means.sum() - means.fillna(0.0)) / n_others).where(means.notna())
    n = others.notna().sum(axis=1)
    found = [_correlate(means.loc[who], others.loc[who]) for who in means.index]
    r = pd.Series(found, index=means.index)
    return compare_values(n, n, r.where(n >= FEWEST_JUDGEMENTS), limit=limit, below=True)


def _correlate(own: Series, other: Series) -> float:
    one, two = own.to_numpy(np.float64), other.to_numpy(np.float64)
    both = np.isfinite(one) & np.isfinite(two)
    if both.sum() < FEWEST_ITEMS or np.ptp(one[both]) == 0 or np.ptp(two[both]) == 0:
        return float("nan")
    return float(np.corrcoef(one[both], two[both])[0, 1])


def _straight_lining(judgements: Judgements, limit: float) -> DataFrame:
    """Find raters who leave the slider at one place.

    On a scale of few steps, where a lenient rater uses the top step often, the limit is half as far from 1.
    """

    def count_densest(ratings: Series) -> int:
        ordered = np.sort(ratings.to_numpy(np.float64))
        after = np.searchsorted(ordered, ordered + SAME_POINTS, side="right")
        return int((after - np.arange(len(ordered))).max())

    grouped = judgements.of_kind("test").groupby("participant", observed=True)["rating"]
    count = grouped.agg(count_densest).reindex(judgements.participants, fill_value=0)
    n = grouped.size().reindex(judgements.participants, fill_value=0)
    share = count / n.where(n >= FEWEST_JUDGEMENTS)
    usual = tukey_fences(share.dropna())[1] if share.notna().any() else limit
    widened = max(limit, min(ALL_BUT, max((1 + limit) / 2, usual)))
    limits = np.where(judgements.rounding().to_numpy() > 0, widened, limit)
    return compare_values(count, n, share, limit=limits)


def _test_retest(judgements: Judgements, limit: float) -> DataFrame:
    """Correlate second ratings with first ones: random clicking shows as none.

    NaN for fewer than 8 pairs, and where somebody's first or second ratings are all the same.
    """
    pairs = judgements.first_two()
    whose, times = pairs["participant"], pairs[["first", "second"]]
    centred = times - times.groupby(whose, observed=True).transform("mean")
    products = centred**2
    products = products.assign(both=centred["first"] * centred["second"])
    sums = products.groupby(whose, observed=True).sum().reindex(judgements.participants)
    n = whose.value_counts().reindex(judgements.participants, fill_value=0)
    constant = sums[["first", "second"]].min(axis=1) <= FLAT * HIGHEST**2 * n
    r = (sums["both"] / (sums["first"] * sums["second"]).mask(constant) ** 0.5).clip(-1, 1)
    variance = (sums[["first", "second"]].mean(axis=1) / n.where(n > 0)).mask(constant)
    left = (1 - judgements.rounding() / variance).clip(0, 1).fillna(1.0).to_numpy()
    shown = np.tanh(ONE_SIDED / np.sqrt(n.clip(lower=FEWEST_JUDGEMENTS).to_numpy() - 3))
    floor = np.minimum(limit, shown) * (left if limit > 0 else 1.0)
    return compare_values(n, n, r.where(n >= FEWEST_JUDGEMENTS), limit=floor, below=True)


def _repeat_sd(judgements: Judgements, limit: float) -> DataFrame:
    """Find raters who rate the same stimulus far apart: random clicking."""
    pairs = judgements.first_two()
    squares = ((pairs["first"] - pairs["second"]) ** 2).groupby(pairs["participant"], observed=True)
    n = squares.size().reindex(judgements.participants, fill_value=0)
    share = np.sqrt(squares.mean().reindex(judgements.participants) / 2) / HIGHEST
    widened = np.sqrt(limit**2 + judgements.rounding().to_numpy() / HIGHEST**2)
    return compare_values(n, n, share.where(n >= FEWEST_JUDGEMENTS), limit=widened)


def check_expertise(gauge: DataFrame, judgements: Judgements, limit: float) -> DataFrame:
    """Find raters who are no better than their own shuffled ratings; gauge: as `gauge_raters` gives it."""
    defined = gauge[gauge["value"].notna()]
    return _count_bad(judgements, defined, defined["p"] > 1 - FLOOR, limit=limit)


STANDARD, EXTENSION = "ITU-R BS.1534-3", "extension"

EXPERTISE = "expertise"
"""The rule that needs a source of randomness."""

EXPERTISE_LIMIT = 0.5
"""More than half of its measures, that is two of three, are no better than chance."""


@dataclass(frozen=True, slots=True)
class Rule:
    """A rule about raters; find: judgements and limit -> table by participant, None where it takes a gauge."""

    says: str
    source: str
    limit: float
    find: Callable[[Judgements, float], DataFrame] | None
    needs: str
    protocols: tuple[str, ...] = ()


SIGHTED = ("mushra",)
"""Protocols that show the reference beside the stimuli. Limits near the end of the scale presuppose that: somebody who
rates realism by itself, or a similarity from memory, has no reason to put the original at 90 or above."""

RULES: Mapping[str, Rule] = MappingProxyType(
    {
        "hidden_reference": Rule(
            "hidden reference below 90 on more than {limit:.0%} of items",
            STANDARD, 0.15, _hidden_reference, "MUSHRA ratings of a stimulus with role 'reference'", SIGHTED,
        ),
        "mid_anchor": Rule(
            "mid anchor above 90 on more than {limit:.0%} of items",
            STANDARD, 0.15, _mid_anchor, "MUSHRA ratings of an anchor named mid", SIGHTED,
        ),
        "low_anchor": Rule(
            "low anchor above 50 on more than {limit:.0%} of items",
            EXTENSION, 0.15, _low_anchor, "MUSHRA ratings of an anchor named low", SIGHTED,
        ),
        "straight_lining": Rule(
            "more than {limit:.0%} of ratings within 2 points of each other",
            EXTENSION, 0.5, _straight_lining, "8 ratings of test stimuli",
        ),
        "test_retest": Rule(
            "correlation of first and second ratings below {limit:g}, or what so many pairs show to be above zero",
            EXTENSION, 0.3, _test_retest, "8 test stimuli rated twice, not all alike",
        ),
        "repeat_sd": Rule(
            "standard deviation of repeated ratings above {limit:.0%} of the scale",
            EXTENSION, 0.2, _repeat_sd, "8 test stimuli rated twice",
        ),
        "reversed_scale": Rule(
            "correlation with the mean of the others below {limit:g}",
            EXTENSION, -0.3, _reversed_scale, "8 test stimuli that others rated too, not all alike",
        ),
        "too_fast": Rule(
            "more than {limit:.0%} of answers within 0.5 s",
            EXTENSION, 0.15, _too_fast, "column 'response_time_s'",
        ),
        "outliers": Rule(
            "outside Tukey's fences on more than {limit:.0%} of test stimuli",
            EXTENSION, 0.15, _outliers, "test stimuli that 5 raters rated",
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
    """Settle which rules apply and their limits: name -> limit, in the order of `RULES`.

    Examples
    --------
    >>> choose_limits(["mid_anchor"], random=False), choose_limits({"mid_anchor": 0.2}, random=False)
    ({'mid_anchor': 0.15}, {'mid_anchor': 0.2})
    """
    if rules is None:
        return {name: rule.limit for name, rule in RULES.items() if random or name != EXPERTISE}
    wanted = [rules] if isinstance(rules, str) else list(rules)
    if not wanted:
        raise ValueError(f"rules must name one or more of {', '.join(RULES)}; got no rule")
    for name in wanted:
        check_name(name, RULES, "rules")
    if EXPERTISE in wanted and not random:
        raise ValueError(
            f"rules must go without {EXPERTISE!r}, or with rng for its permutations; got it without rng"
        )
    own = dict(rules) if isinstance(rules, Mapping) else {}
    for name, limit in own.items():
        if not -1 <= limit <= 1:
            raise ValueError(
                f"rules must have limits from -1 to 1, a share, not per cent; got the limit {limit} for {name!r}"
            )
    return {
        name: float(own.get(name, rule.limit)) for name, rule in RULES.items() if name in wanted
    }


# A lab's own rules: a function of the ratings that returns a number per participant, flagged above its ``limit``.


def find_rules(given: Iterable[object], folder: Path | None = None) -> tuple[Method, ...]:
    """Find a lab's own rules: functions, places in the study's folder or in packages, entry points."""
    found = tuple(find_method("screening rule", one, taken=RULES, folder=folder) for one in given)
    names = [method.name for method in found]
    if doubled := sorted({name for name in names if names.count(name) > 1}):
        raise ValueError(
            f"screening rules must have names of their own, got more than one {', '.join(doubled)}"
        )
    return found


def make_rule(method: Method) -> Rule:
    """Make a rule of a lab's function and what its attributes declare."""
    function = method.load()
    if not callable(function):
        raise TypeError(f"{method}: must be a function of the ratings, got {describe(function)}")
    limit, says = getattr(function, "limit", None), getattr(function, "says", method.name)
    if isinstance(limit, bool) or not isinstance(limit, int | float) or not np.isfinite(limit):
        raise ValueError(
            f"{method}: limit must be a number, got {describe(limit)}; write {method.name}.limit = 0.15"
        )
    try:
        str(says).format(limit=limit)
    except (LookupError, ValueError, AttributeError) as error:
        raise ValueError(
            f"{method}: says must be words, with {{limit}} for the limit, got {says!r} ({error})"
        ) from None
    needs = str(getattr(function, "needs", "what its function needs"))
    source = f"the lab's own, {method.place}"
    return Rule(str(says), source, float(limit), partial(_find, method), needs)


def _find(method: Method, judgements: Judgements, limit: float) -> DataFrame:
    ratings, everyone = judgements.given, judgements.participants
    told = call(method, method.load(), ratings.copy())
    if told is None:
        raise TypeError(
            f"{method}: must return a number per participant, got None; does it return anything?"
        )
    try:
        found = pd.Series(told, dtype=np.float64)
    except (TypeError, ValueError):
        raise TypeError(
            f"{method}: must return a number per participant, got {describe(told)}"
        ) from None
    if unknown := [one for one in found.index if one not in everyone]:
        raise ValueError(
            f"{method}: must return a number per participant of the ratings, got one for {unknown[0]!r}"
        )
    if not found.index.is_unique or np.isinf(found).any():
        raise ValueError(
            f"{method}: must return one finite number per participant, or NaN where the rule does not apply"
        )
    n = ratings.groupby("participant", observed=True).size().reindex(everyone, fill_value=0)
    return compare_values(n, n, found.reindex(everyone), limit=limit)
