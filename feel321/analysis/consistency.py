"""Consistency of raters: the rater model of ITU-T P.913, and expertise beside shuffled ratings.

In the rater model a vote is the quality of the stimulus, plus the bias of the rater, plus noise of the rater's own
standard deviation, the inconsistency. Raters then count by how consistent they are, none is thrown out, and one who
answers at random stands out by an inconsistency that no other rater's is like. Expertise is judged against a
permutation null, in the manner of Report ITU-R BS.2300; its measures are defined here, because the data need not be
balanced.
"""

import math

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray
from scipy.stats import t

from feel321.analysis.arrays import Values, check_columns, read_array, read_numbers
from feel321.analysis.resampling import FEWEST_ITEMS, weighted_pearson
from feel321.analysis.table.items import (
    STIMULUS,
    Table,
    choose_arms,
    is_tidy,
    leave_rejected,
    name_stimuli,
    open_ratings,
    refuse_pooled,
)
from feel321.records import Statistic

SETTLED = 1e-8  # Norm of the change of all qualities, over the spread of the votes, at which the projections stop
MOST_ROUNDS = 10_000
NOISE = 1e-8  # Share of the variance of the votes added to squared inconsistencies: nobody is exact
LONE = 0.5  # Share of all weights at which one rater is all that counts: the estimates run away
FEWEST_VOTES, FEWEST_RATERS = 3, 3
FEWEST_COMPARED = 6  # Raters below which nobody knows how far honest ones differ
LEVEL = 0.05  # Chance that anybody is said to stand out among raters who differ as honest ones do
MOST_APART = 0.25  # Share of raters who may stand out; with more of them it is not they who are the exception
FLOOR, PERMUTATIONS = 0.95, 499  # Share of permutations that an expert's measure exceeds; number
MEASURES = ("discrimination", "reliability", "agreement")
Codes = NDArray[np.intp]


def rater_model(
    ratings: Table | pd.DataFrame | ArrayLike, *, scale: str | None = None, level: str | None = None
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
    of_raters = pd.DataFrame({
        "bias": bias, "bias_se": spread / np.sqrt(counts), "inconsistency": spread,
        "inconsistency_se": spread / np.sqrt(2 * counts), "n": counts, "weight": weights / weights.sum(),
        "apart": apart,
    }, index=pd.Index(raters, name="participant", dtype=object))  # fmt: skip
    se_raters = 1 / np.sqrt(np.bincount(item, 1 / held[rater] ** 2))
    stimuli = pd.DataFrame(
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
        quantile = float(t.isf(LEVEL / size, size - 2))
        limit = (size - 1) * quantile / math.sqrt((size - 2 + quantile**2) * size)
        found = number if deviate > limit else found
    apart[left[len(logs) - found :]] = True
    return apart, []


def _read(
    ratings: Table | pd.DataFrame | ArrayLike, scale: str | None, level: str | None
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


def gauge_raters(
    tests: pd.DataFrame, means: pd.DataFrame, *, rng: np.random.Generator
) -> pd.DataFrame:
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
    people = [
        (who, own["item"].to_numpy(), own["rating"].to_numpy())
        for who, own in tests.groupby("participant", observed=True)
    ]
    between = [_mean_squares(item, rating[None])[1][0] for _, item, rating in people]
    panel_square = float(np.nanmean(between)) if np.isfinite(between).any() else float("nan")
    found: list[tuple[object, str, float, float, float]] = []
    for who, item, rating in people:
        shuffled = rng.permuted(np.broadcast_to(rating, (PERMUTATIONS, len(rating))), axis=1)
        averages, square, within = _mean_squares(item, np.vstack([rating, shuffled]))
        others = means.drop(index=who).mean().reindex(np.unique(item)).to_numpy()
        shared = np.isfinite(others)
        agreement = np.full(len(averages), np.nan)
        if shared.sum() >= FEWEST_ITEMS:
            weights = np.ones(int(shared.sum()))
            agreement = weighted_pearson(averages[:, shared], others[shared], weights=weights)
        with np.errstate(invalid="ignore", divide="ignore"):
            measured = square / within, panel_square / within, agreement
        for name, values in zip(MEASURES, measured, strict=True):
            value, null = float(values[0]), values[1:][~np.isnan(values[1:])]
            floor = p = np.nan
            if not np.isnan(value) and len(null):
                floor = float(np.quantile(null, FLOOR, method="higher"))
                p = (1 + int((null >= value).sum())) / (1 + len(null))
            found.append((who, name, value, floor, p))
    gauge = pd.DataFrame(found, columns=["participant", "measure", "value", "floor", "p"])
    return gauge.assign(participant=pd.Categorical(gauge["participant"], means.index))


def _mean_squares(item: NDArray[np.intp], ratings: Values) -> tuple[Values, Values, Values]:
    """Average each item, and take the mean squares between items and within; NaN for constants and without repeats."""
    _, place, counts = np.unique(item, return_inverse=True, return_counts=True)
    starts = np.cumsum(counts) - counts
    order = np.argsort(place, kind="stable")
    means = np.add.reduceat(ratings[:, order], starts, axis=1) / counts
    n_items, spare = len(counts), len(place) - len(counts)
    nothing = np.full(len(ratings), np.nan)
    if n_items < 2 or not spare:  # noqa: PLR2004 - a variance needs two
        return means, nothing, nothing
    grand = ratings.mean(axis=1, keepdims=True)
    between = (counts * (means - grand) ** 2).sum(axis=1) / (n_items - 1)
    within = ((ratings - means[:, place]) ** 2).sum(axis=1) / spare
    constant = np.ptp(ratings, axis=1) == 0
    return means, np.where(constant, np.nan, between), np.where(constant, np.nan, within)
