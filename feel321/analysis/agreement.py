"""How far people agree: Krippendorff's alpha, intraclass correlations, and the noise ceiling that they set for metrics.

Conventions: a table has shape (targets, raters), NaN where a rater did not rate a target; a target with fewer than two
ratings does not count. For reliabilities, targets are stimuli, raters are participants, and no cell is missing.

The package `krippendorff` makes a table of targets x values x values: gigabytes for ratings from a slider, where every
value is another one. The sums below are linear in the number of ratings, but on a ratio scale.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pandas import factorize
from scipy.stats import f, rankdata

from feel321.analysis.arrays import FLAT, UPPER, Values, read_array
from feel321.analysis.table.items import Items, Table, as_votes
from feel321.arguments import check_name
from feel321.records import Statistic

NAN = float("nan")
CHUNK = 1_000_000  # Pairs of values compared at a time
LEVELS = ("nominal", "ordinal", "interval", "ratio")  # Of measurement
AXES = ("targets", "raters")
SMALLEST = 2  # Ratings that can agree; targets and raters that a variance needs at least
COMPLETE = 0.5  # Share of the stimuli that everyone must have rated for a ceiling of all of them


def krippendorff_alpha(table: Table | ArrayLike, *, level: str = "interval") -> float:
    """Agreement of raters on targets: Krippendorff's alpha.

    Parameters
    ----------
    table : Table, DataFrame or array_like, shape (targets, raters)
        Ratings; or numbers, NaN where missing; on a nominal scale also names, None where missing.
    level : str
        ``nominal`` (names), ``ordinal`` (order), ``interval`` (distances: rating scales) or ``ratio``
        (proportions; no negative values).

    Returns
    -------
    float
        1 for perfect agreement, 0 for what chance gives, below 0 for systematic disagreement; NaN where all
        ratings are the same: agreement cannot be distinguished from a scale nobody used.

    Notes
    -----
    α = 1 - D_o / D_e. With m_u ratings of target u and n in all::

        D_o = 1/n Σ_u 1/(m_u - 1) Σ_{i≠j in u} δ²(v_i, v_j)      D_e = 1/(n (n - 1)) Σ_{i≠j} δ²(v_i, v_j)

    δ² is [v ≠ w], the squared difference of mid-ranks, (v - w)², or ((v - w)/(v + w))². Unlike ICC(C,k), it is
    about single ratings, penalises raters who use the scale at different heights, and allows missing cells.

    References
    ----------
    Hayes & Krippendorff (2007), Communication Methods and Measures 1, 77-89, doi 10.1080/19312450709336664.

    Examples
    --------
    >>> from feel321 import analysis
    >>> nan = float("nan")
    >>> table = [[1, 1, nan, 1], [2, 2, 3, 2], [3, 3, 3, 3], [3, 3, 3, 3], [2, 2, 2, 2], [1, 2, 3, 4],
    ...     [4, 4, 4, 4], [1, 1, 2, 1], [2, 2, 2, 2], [nan, 5, 5, 5], [nan, nan, 1, 1], [nan, nan, 3, nan]]
    >>> [round(analysis.krippendorff_alpha(table, level=level), 3) for level in ("nominal", "ordinal")]
    [0.743, 0.815]
    """
    check_name(level, LEVELS, "level")
    given = as_votes(table)
    cells = np.asarray(given, dtype=object)
    may_be_named = level == "nominal" and cells.ndim == len(AXES)
    if may_be_named and any(isinstance(one, str) for one in cells.flat):
        number = factorize(cells.ravel())[0].reshape(cells.shape)
        given = np.where(number < 0, NAN, number)
    ratings = read_array(given, what="table", axes=AXES, missing=True)
    if level == "ratio" and (ratings < 0).any():
        got = f"got {np.nanmin(ratings)}; use level='interval'"
        raise ValueError(f"table must not be negative on a ratio scale, {got}")
    pairable = ratings[np.isfinite(ratings).sum(axis=1) >= SMALLEST]
    if not len(pairable):
        raise ValueError(f"table must have a target with two ratings, got {len(ratings)} without")
    seen = np.isfinite(pairable)
    values, sizes = pairable[seen], seen.sum(axis=1)
    if level == "ordinal":
        values = rankdata(values)
    expected = _sum_pairs(values, level)
    if expected <= FLAT * len(values) * float((values**2).sum()):
        return NAN
    own = np.split(values, np.cumsum(sizes)[:-1])
    observed = sum(_sum_pairs(one, level) / (len(one) - 1) for one in own)
    return float(1 - (len(values) - 1) * observed / expected)


def _sum_pairs(values: Values, level: str) -> float:
    """Sum the squared distances of all pairs, both ways round."""
    distinct, counts = np.unique(values, return_counts=True)
    if level == "nominal":
        return float(len(values) ** 2 - (counts**2).sum())
    if level != "ratio":
        return float(2 * len(values) * ((values - values.mean()) ** 2).sum())
    step, found = max(1, CHUNK // len(distinct)), 0.0
    for at in range(0, len(distinct), step):
        part = distinct[at : at + step, None]
        total = part + distinct
        share = np.divide(part - distinct, total, out=np.zeros_like(total), where=total > 0)
        found += float(counts[at : at + step] @ share**2 @ counts)
    return found


def intraclass(table: Table | ArrayLike) -> Statistic:
    """Intraclass correlations of a complete table.

    Parameters
    ----------
    table : Table, DataFrame or array_like, shape (targets, raters)
        Ratings, or numbers with no cell missing, at least 2 by 2.

    Returns
    -------
    Statistic
        In McGraw and Wong's names ``icc_1_1 icc_a_1 icc_c_1`` of one rater's rating and ``icc_1_k icc_a_k icc_c_k`` of
        the mean over all raters, NaN where every rating is the same; each with its 95 % interval (``icc_1_1_low``,
        ``icc_1_1_high`` and so on), NaN where ratings have no error; ``n_targets n_raters``.

    Notes
    -----
    Model: rating = target + rater + error. With n targets and k raters, the mean squares of targets R, raters
    C, residual E, and of ratings within targets W give::

        ICC(1,1) = (R - W) / (R + (k-1) W)                     ICC(1,k) = (R - W) / R
        ICC(A,1) = (R - E) / (R + (k-1) E + k (C - E)/n)       ICC(A,k) = (R - E) / (R + (C - E)/n)
        ICC(C,1) = (R - E) / (R + (k-1) E)                     ICC(C,k) = (R - E) / R

    One-way (1) is for raters who differ from target to target. Intervals are exact F intervals for (1) and (C), and
    Satterthwaite's approximation for (A), for targets and raters that are independent draws. **Stimuli made from a few
    recordings are not:** in 400 simulated studies with such clusters they covered 86 to 89 %.

    References
    ----------
    Shrout & Fleiss (1979), doi 10.1037/0033-2909.86.2.420; McGraw & Wong (1996), doi 10.1037/1082-989X.1.1.30.

    Examples
    --------
    >>> from feel321 import analysis
    >>> shrout_fleiss = [[9, 2, 5, 8], [6, 1, 3, 2], [8, 4, 6, 8], [7, 1, 2, 6], [10, 5, 6, 9], [6, 2, 4, 7]]
    >>> icc = analysis.intraclass(shrout_fleiss)
    >>> round(icc.icc_a_1, 2), round(icc.icc_c_k, 2)
    (0.29, 0.91)
    >>> round(icc.icc_a_1_low, 3), round(icc.icc_a_1_high, 3)
    (0.019, 0.761)
    """
    ratings = _read_complete(table)
    n, k = ratings.shape
    of_targets, of_raters = (ratings.mean(axis=axis, keepdims=True) for axis in (1, 0))
    rounding, grand = FLAT * float((ratings**2).sum()), ratings.mean()

    def square(deviations: Values, freedom: int) -> float:
        total = float((deviations**2).sum())
        return total / freedom if total > rounding else 0.0

    targets, raters = k * square(of_targets - grand, n - 1), n * square(of_raters - grand, k - 1)
    error = square(ratings - of_targets - of_raters + grand, (n - 1) * (k - 1))
    within = square(ratings - of_targets, n * (k - 1))
    values: dict[str, float] = {}
    bias = (raters - error) / n
    for form, noise, shift in (("1", within, 0.0), ("a", error, bias), ("c", error, 0.0)):
        values[f"icc_{form}_1"] = _ratio(targets - noise, targets + (k - 1) * noise + k * shift)
        # Where targets differ so little that their mean's variance comes out negative, the ratio would pass 1.
        values[f"icc_{form}_k"] = _ratio(targets - noise, max(targets + shift, 0.0))
    for form, noise, freedom in (("1", within, n * (k - 1)), ("c", error, (n - 1) * (k - 1))):
        ratio = targets / noise if noise and targets else NAN
        low, high = f.ppf(UPPER, n - 1, freedom), f.ppf(UPPER, freedom, n - 1)
        for end, limit in (("low", ratio / float(low)), ("high", ratio * float(high))):
            values[f"icc_{form}_1_{end}"] = (limit - 1) / (limit + k - 1)
            values[f"icc_{form}_k_{end}"] = 1 - 1 / limit
    agreed = (NAN, NAN)
    if error:
        rater_weight = k * values["icc_a_1"] * raters / error
        error_weight = n * (1 + (k - 1) * values["icc_a_1"]) - k * values["icc_a_1"]
        spread = (n - 1) * rater_weight**2 + error_weight**2
        df = (k - 1) * (n - 1) * (rater_weight + error_weight) ** 2 / spread
        rest = k * raters + (k * n - k - n) * error
        upper, lower = float(f.ppf(UPPER, n - 1, df)), float(f.ppf(UPPER, df, n - 1))
        agreed = (
            _ratio(n * (targets - upper * error), upper * rest + n * targets),
            _ratio(n * (lower * targets - error), rest + n * lower * targets),
        )
    for end, limit in zip(("low", "high"), agreed, strict=True):
        # Spearman and Brown's step from one rater to the mean of k; unbounded where it has a pole.
        below = 1 + limit * (k - 1)
        of_mean = float("-inf") if below <= 0 else k * limit / below
        values |= {f"icc_a_1_{end}": limit, f"icc_a_k_{end}": of_mean}
    return Statistic("Intraclass", **values, n_targets=n, n_raters=k)


def _read_complete(table: Table | ArrayLike) -> Values:
    ratings = read_array(as_votes(table), what="table", axes=AXES)
    if min(ratings.shape) < SMALLEST:
        raise ValueError(f"table must be at least 2 targets by 2 raters, got shape {ratings.shape}")
    return ratings


def _ratio(part: float, whole: float) -> float:
    return part / whole if whole else NAN


def noise_ceiling(table: Table | ArrayLike) -> float:
    """Correlation that a perfect predictor would reach with mean ratings as noisy as these.

    Parameters
    ----------
    table : Table, DataFrame or array_like, shape (targets, raters)
        As for `intraclass`.

    Returns
    -------
    float
        sqrt(ICC(C,k)), 0 to 1; NaN where targets do not differ beyond noise: there is nothing to predict
        then.

    Notes
    -----
    The square root of the mean's reliability bounds its correlation with anything (Spearman 1904, doi
    10.2307/1412159). Consistency is the right form because a correlation ignores how high a rater's ratings
    are.

    Examples
    --------
    >>> from feel321 import analysis
    >>> round(analysis.noise_ceiling([[1, 2], [3, 5], [6, 6]]), 3)
    0.975
    """
    ratings = _read_complete(table)
    return noise_ceiling_within(ratings, np.zeros(len(ratings), np.intp))


def find_ceiling(items: Items, *, within: bool) -> tuple[float, list[str]]:
    """Noise ceiling of the mean ratings, NaN where there is none, as far as everyone rated the same stimuli."""
    complete = np.isfinite(items.ratings).all(axis=0)
    if items.n_participants < SMALLEST or complete.sum() < SMALLEST:
        return NAN, ["No noise ceiling: it needs two participants who rated the same two stimuli."]
    if complete.mean() < COMPLETE:
        few = f"only {complete.sum()} of {items.n_items} stimuli were rated by everyone"
        return NAN, [f"No noise ceiling: {few}."]
    groups = items.recordings[complete] * within
    ceiling = noise_ceiling_within(items.ratings[:, complete].T, groups)
    where = " of the same recording" if within else ""
    notes = {
        f"The noise ceiling rests on the {complete.sum()} stimuli that every participant rated, r on all "
        f"{items.n_items}; r / ceiling is left out.": not complete.all(),
        f"No noise ceiling: mean ratings do not differ between stimuli{where} beyond noise.": np.isnan(
            ceiling
        ),
    }
    return ceiling, [note for note, holds in notes.items() if holds]


def noise_ceiling_within(table: Values, groups: NDArray[np.intp]) -> float:
    """Correlation within groups of targets that a perfect predictor would reach with mean ratings as noisy as these.

    table: (targets, raters); groups: (targets,); gives sqrt((R - E) / R), 0 to 1. Each group has its own two-way
    analysis of variance, targets x raters, and the sums of squares are pooled: with n_g targets and k raters, R has
    Σ (n_g - 1) degrees of freedom and the residual E k - 1 times as many. What raises all targets of a group, for
    everyone or for one rater, is neither signal nor noise here. With one group it is `noise_ceiling`.
    """
    by_target, n_raters = np.zeros(table.shape), table.shape[1]
    for number in np.unique(groups):
        own = table[groups == number]
        by_target[groups == number] = own - own.mean(axis=0)
    targets = by_target.mean(axis=1, keepdims=True)
    signal, noise = float((targets**2).sum()) * n_raters, float(((by_target - targets) ** 2).sum())
    if signal <= FLAT * float((table**2).sum()):
        return NAN
    reliability = 1 - noise / (n_raters - 1) / signal
    return float(np.sqrt(reliability)) if reliability > 0 else NAN
