"""How far people agree, and how consistent each of them is.

Agreement: Krippendorff's alpha, intraclass correlations, and the noise ceiling that they set for metrics. A table has
shape (targets, raters), NaN where a rater did not rate a target; a target with fewer than two ratings does not count.
For reliabilities, targets are stimuli, raters are participants, and no cell is missing. The package `krippendorff`
makes a table of targets x values x values: gigabytes for ratings from a slider, where every value is another one. The
sums below are linear in the number of ratings, but on a ratio scale.

Consistency: in the rater model of ITU-T P.913 a vote is the quality of the stimulus, plus the bias of the rater, plus
noise of the rater's own standard deviation, the inconsistency. Raters then count by how consistent they are, none is
thrown out, and one who answers at random stands out by an inconsistency that no other rater's is like. Expertise is
judged against a permutation null, in the manner of Report ITU-R BS.2300; its measures are defined here, because the
data need not be balanced.
"""

import math

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray
from pandas import DataFrame, factorize
from scipy.stats import f as fisher
from scipy.stats import rankdata, t

from feel321.analysis.arrays import FLAT, UPPER, Values, check_columns, read_array, read_numbers
from feel321.analysis.resampling import FEWEST_ITEMS, weighted_pearson
from feel321.analysis.table.items import (
    STIMULUS,
    Items,
    Table,
    as_votes,
    choose_arms,
    is_tidy,
    leave_rejected,
    name_stimuli,
    open_ratings,
    refuse_pooled,
)
from feel321.arguments import check_name
from feel321.records import Statistic

NAN = float("nan")
CHUNK = 1_000_000  # Pairs of values compared at a time
LEVELS = ("nominal", "ordinal", "interval", "ratio")  # Of measurement
AXES = ("targets", "raters")
SMALLEST = 2  # Ratings that can agree; targets and raters that a variance needs at least
COMPLETE = 0.5  # Share of the stimuli that everyone must have rated for a ceiling of all of them
SETTLED = 1e-8  # Change of all qualities, over the spread of the votes, at which projections stop
MOST_ROUNDS = 10_000
NOISE = 1e-8  # Share of the variance of the votes added to squared inconsistencies: nobody is exact
LONE = 0.5  # Share of all weights at which one rater is all that counts: the estimates run away
FEWEST_VOTES, FEWEST_RATERS = 3, 3
FEWEST_COMPARED = 6  # Raters below which nobody knows how far honest ones differ
FALSE_ALARM = 0.05  # Chance that anybody is said to stand out among honest raters
MOST_APART = 0.25  # Share of raters who may stand out; with more, they are not the exception
FLOOR, PERMUTATIONS = 0.95, 499  # Share of permutations that an expert's measure exceeds; number
MEASURES = ("discrimination", "reliability", "agreement")
Codes = NDArray[np.intp]


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
        low, high = fisher.ppf(UPPER, n - 1, freedom), fisher.ppf(UPPER, freedom, n - 1)
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
        upper, lower = float(fisher.ppf(UPPER, n - 1, df)), float(fisher.ppf(UPPER, df, n - 1))
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
        sqrt(ICC(C,k)), 0 to 1; NaN where targets do not differ beyond noise: there is nothing to predict then.

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


def noise_ceiling_within(table: Values, groups: Codes) -> float:
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


def rater_model(
    ratings: Table | DataFrame | ArrayLike, *, scale: str | None = None, level: str | None = None
) -> Statistic:
    """Estimate the bias and inconsistency of each rater, and the quality of each stimulus without them.

    Parameters
    ----------
    ratings : Table, DataFrame or array_like, shape (items, raters)
        One row per rating: participant, stimulus_id (or recording and reducer), rating. All stimuli count, hidden
        references and anchors too: they say as much about a rater as others. Or votes, NaN where missing.
    scale, level : str, optional
        Which ratings; needed where there are several scales or levels.

    Returns
    -------
    Statistic
        ``raters``, a table by participant: bias and inconsistency, in points, with their standard errors bias_se and
        inconsistency_se; n, the number of ratings; weight, the share in the qualities; apart, whether the rater's
        inconsistency is unlike the others'; biases sum to zero. ``stimuli``, by stimulus: quality, in points; se, from
        the spread of the stimulus's own residuals, which is wider where people disagree; se_raters, from the raters'
        inconsistencies; n. ``apart``, raters whose inconsistency is unlike the others', the least consistent first;
        ``loglikelihood aic bic``, per rating; ``n_ratings n_parameters n_rounds notes``.

    Notes
    -----
    ``vote = quality of the stimulus + bias of the rater + inconsistency of the rater x N(0, 1)``, by alternating
    projection, as ``MLE_CO_AP2`` of SUREAL: in turn biases (mean residuals of a rater), inconsistencies (standard
    deviations of them, ddof 0) and qualities (means of votes less bias, weighted by one over inconsistency squared),
    until qualities settle. ``bias_se`` is inconsistency / sqrt(n), ``inconsistency_se`` inconsistency / sqrt(2 n);
    ``se_raters`` is that of ``MLE_CO_AP``. With few raters the likelihood may grow without bound; where one has half of
    all weights, all count alike instead, and a note says so.

    Inconsistencies of honest raters are about log-normal, so their logarithms are tested by Rosner's generalised
    extreme studentised deviate, one-sided, for up to a quarter of the raters, at 5 % for the whole panel: several bad
    raters do not hide each other.

    References
    ----------
    ITU-T P.913 (2021), section 12.6; Li, Bampis, Janowski & Katsavounidis (2020), A simple model for subject behavior
    in subjective experiments, doi 10.2352/ISSN.2470-1173.2020.11.HVEI-131; Rosner (1983), Technometrics 25, 165-172,
    doi 10.1080/00401706.1983.10487848.

    Examples
    --------
    >>> import numpy as np
    >>> from feel321 import analysis
    >>> rng = np.random.default_rng(1)
    >>> noise = rng.normal(0, [5, 5, 5, 5, 5, 5, 5, 30], (60, 8))
    >>> votes = rng.uniform(20, 80, (60, 1)) + [9, -3, -3, -3, 0, 0, 0, 0] + noise
    >>> model = analysis.rater_model(votes)
    >>> model.apart, round(model.raters["bias"].iloc[0])
    (('7',), 9)
    """
    points, rater, item, raters, items = _read(ratings, scale, level)
    counts, n_items, notes = np.bincount(rater), np.bincount(item), list[str]()
    noise = NOISE * float(points.var())
    quality, bias, spread, rounds = _alternate(points, rater, item, floor=noise)
    weights = 1 / (spread**2 + noise)
    if weights.max() >= LONE * weights.sum():
        alone = f"Weighted by consistency, {raters[int(weights.argmax())]} alone would determine the qualities"
        notes.append(f"{alone}, as happens with few raters; all raters count alike instead.")
        quality, bias, spread, rounds = _alternate(points, rater, item, floor=math.inf)
    residual = points - quality[item] - bias[rater]
    n, n_parameters = len(points), len(quality) + 2 * len(bias)
    held = np.maximum(spread, math.sqrt(noise))
    likely = -np.log(held) - math.log(2 * math.pi) / 2
    loglikelihood = float((likely[rater] - (residual / held[rater]) ** 2 / 2).mean())
    weights = np.ones_like(held) if notes else 1 / held**2
    means = np.bincount(item, residual) / n_items
    own = np.bincount(item, (residual - means[item]) ** 2) / n_items
    apart, lacking = find_apart(spread)
    of_raters = DataFrame({
        "bias": bias, "bias_se": spread / np.sqrt(counts), "inconsistency": spread,
        "inconsistency_se": spread / np.sqrt(2 * counts), "n": counts, "weight": weights / weights.sum(),
        "apart": apart,
    }, index=pd.Index(raters, name="participant", dtype=object))  # fmt: skip
    se_raters = 1 / np.sqrt(np.bincount(item, 1 / held[rater] ** 2))
    stimuli = DataFrame(
        {"quality": quality, "se": np.sqrt(own / n_items), "se_raters": se_raters, "n": n_items},
        index=pd.Index(items, name=STIMULUS, dtype=object),
    )
    return Statistic(
        "RaterModel", raters=of_raters, stimuli=stimuli,
        apart=tuple(raters[place] for place in np.argsort(-spread, kind="stable") if apart[place]),
        loglikelihood=loglikelihood, aic=2 * n_parameters / n - 2 * loglikelihood,
        bic=math.log(n) * n_parameters / n - 2 * loglikelihood,
        n_ratings=n, n_parameters=n_parameters, n_rounds=rounds, notes=(*lacking, *notes),
    )  # fmt: skip


def find_apart(inconsistency: Values) -> tuple[NDArray[np.bool_], list[str]]:
    """Find raters whose inconsistency is unlike the others': Rosner's test of the logarithms, one-sided."""
    apart = np.zeros(len(inconsistency), dtype=bool)
    if len(inconsistency) < FEWEST_COMPARED:
        few = f"{FEWEST_COMPARED} raters are needed to estimate how much honest ones differ"
        return apart, [f"Unusually inconsistent raters cannot be found: {few}."]
    with np.errstate(divide="ignore"):
        logs = np.log(inconsistency)
    # One without any noise has no logarithm, and is not what this test looks for.
    logs[~np.isfinite(logs)] = logs[np.isfinite(logs)].min(initial=0.0)
    left, found = np.argsort(logs, kind="stable"), 0
    for number in range(1, int(MOST_APART * len(logs)) + 1):
        size = len(logs) - number + 1
        own = logs[left[:size]]
        deviate = (own[-1] - own.mean()) / max(own.std(ddof=1), np.finfo(float).tiny)
        quantile = float(t.isf(FALSE_ALARM / size, size - 2))
        limit = (size - 1) * quantile / math.sqrt((size - 2 + quantile**2) * size)
        found = number if deviate > limit else found
    apart[left[len(logs) - found :]] = True
    return apart, []


def _read(
    ratings: Table | DataFrame | ArrayLike, scale: str | None, level: str | None
) -> tuple[Values, Codes, Codes, list[str], list[str]]:
    """Read votes one by one, the numbers of their raters and items, and the names of both."""
    if is_tidy(ratings):
        table, _ = leave_rejected(name_stimuli(open_ratings(choose_arms(ratings, scale, level))))
        check_columns(table, ["participant", STIMULUS, "rating"], "ratings")
        refuse_pooled(table)
        values = read_numbers(table["rating"], what="ratings, 'rating'")
        columns = [table[name].to_numpy() for name in ("participant", STIMULUS)]
    else:
        given = read_array(ratings, what="ratings", axes=("items", "raters"), missing=True)
        item, rater = np.nonzero(np.isfinite(given))
        values = given[item, rater]
        columns = [rater, item]
    (rater, raters), (item, items) = (pd.factorize(one, sort=True) for one in columns)
    for what, numbers, least in (("raters", rater, FEWEST_RATERS), ("stimuli", item, FEWEST_VOTES)):
        if (count := int(numbers.max(initial=-1)) + 1) < least:
            raise ValueError(f"ratings must be of {least} {what} or more, got {count}")
    poor = np.flatnonzero(np.bincount(rater) < FEWEST_VOTES)
    if len(poor):
        got = f"got fewer of {raters[poor[0]]}; leave them out"
        raise ValueError(f"raters must have {FEWEST_VOTES} ratings or more, {got}")
    if not np.isfinite(values).all() or np.ptp(values) == 0:
        raise ValueError("ratings must be finite and differ, got others; leave them out")
    return values, rater, item, list(map(str, raters)), list(map(str, items))


def _alternate(
    values: Values, rater: Codes, item: Codes, *, floor: float
) -> tuple[Values, Values, Values, int]:
    """Estimate qualities, biases and inconsistencies in turn; an infinite floor makes all weights equal."""
    counts, n_items, size = np.bincount(rater), np.bincount(item), float(values.std())
    quality = np.bincount(item, values) / n_items
    for rounds in range(1, MOST_ROUNDS + 1):
        before, residual = quality, values - quality[item]
        means = np.bincount(rater, residual) / counts
        bias = means - means.mean()
        spread = np.sqrt(np.bincount(rater, (residual - means[rater]) ** 2) / counts)
        each = 1 / (spread**2 + floor) if math.isfinite(floor) else np.ones(len(counts))
        weights = each[rater]
        quality = np.bincount(item, weights * (values - bias[rater])) / np.bincount(item, weights)
        if np.linalg.norm(quality - before) < SETTLED * size:
            return quality, bias, spread, rounds
    why = f"got none after {MOST_ROUNDS} rounds: too few are shared by raters"
    raise ValueError(f"ratings must settle on qualities, {why}")


def gauge_raters(tests: DataFrame, means: DataFrame, *, rng: np.random.Generator) -> DataFrame:
    """Measure how expert each rater is: participant, measure, value, floor (95 % of its null), p.

    From one rater's one-way analysis of variance, items against repeats, with mean squares M_items and M_repeats:
    discrimination is M_items / M_repeats (do stimuli differ for this rater beyond the rater's own noise?), reliability
    is the panel's average M_items / M_repeats (is the noise small against what there is to hear or feel?), agreement
    is Pearson's r with the mean of the others over items. Shuffling ratings over trials keeps how a rater uses the
    scale and destroys everything else. Rarely use it to exclude: raters who differ are not thereby wrong.

    tests: a row per rating (participant, item, rating); means: (participants, items).

    References
    ----------
    Lorho, Le Ray & Zacharov (2010), eGauge: a measure of assessor expertise in audio quality evaluations, AES 38th
    International Conference.
    """
    whose = tests.groupby("participant", observed=True)
    people = [(who, own["item"].to_numpy(), own["rating"].to_numpy()) for who, own in whose]
    between = [_mean_squares(item, rating[None])[1][0] for _, item, rating in people]
    panel_square = float(np.nanmean(between)) if np.isfinite(between).any() else NAN
    found: list[tuple[object, str, float, float, float]] = []
    for who, item, rating in people:
        shuffled = rng.permuted(np.broadcast_to(rating, (PERMUTATIONS, len(rating))), axis=1)
        averages, square, within = _mean_squares(item, np.vstack([rating, shuffled]))
        others = means.drop(index=who).mean().reindex(np.unique(item)).to_numpy()
        shared = np.isfinite(others)
        agreement = np.full(len(averages), NAN)
        if shared.sum() >= FEWEST_ITEMS:
            weights = np.ones(int(shared.sum()))
            agreement = weighted_pearson(averages[:, shared], others[shared], weights=weights)
        with np.errstate(invalid="ignore", divide="ignore"):
            measured = square / within, panel_square / within, agreement
        for name, values in zip(MEASURES, measured, strict=True):
            value, null = float(values[0]), values[1:][~np.isnan(values[1:])]
            floor = p = NAN
            if not np.isnan(value) and len(null):
                floor = float(np.quantile(null, FLOOR, method="higher"))
                p = (1 + int((null >= value).sum())) / (1 + len(null))
            found.append((who, name, value, floor, p))
    gauge = DataFrame(found, columns=["participant", "measure", "value", "floor", "p"])
    return gauge.assign(participant=pd.Categorical(gauge["participant"], means.index))


def _mean_squares(item: NDArray[np.intp], ratings: Values) -> tuple[Values, Values, Values]:
    """Average each item, and take the mean squares between items and within; NaN for constants and without repeats."""
    _, place, counts = np.unique(item, return_inverse=True, return_counts=True)
    starts = np.cumsum(counts) - counts
    order = np.argsort(place, kind="stable")
    means = np.add.reduceat(ratings[:, order], starts, axis=1) / counts
    n_items, spare = len(counts), len(place) - len(counts)
    nothing = np.full(len(ratings), NAN)
    if n_items < 2 or not spare:  # noqa: PLR2004 - a variance needs two
        return means, nothing, nothing
    grand = ratings.mean(axis=1, keepdims=True)
    between = (counts * (means - grand) ** 2).sum(axis=1) / (n_items - 1)
    within = ((ratings - means[:, place]) ** 2).sum(axis=1) / spare
    constant = np.ptp(ratings, axis=1) == 0
    return means, np.where(constant, NAN, between), np.where(constant, NAN, within)
