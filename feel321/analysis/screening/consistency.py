"""The rater model of ITU-T P.913: each rater's bias and inconsistency, and the quality of each stimulus without them.

A vote is the quality of the stimulus, plus the bias of the rater, plus noise of the rater's own standard deviation,
the inconsistency. Raters then count by how consistent they are, none is thrown out, and one who answers at random
stands out by an inconsistency that no other rater's is like.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from feel321.analysis.arrays import Values, check_columns, read_array, read_numbers
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

if TYPE_CHECKING:
    from pandas import DataFrame

SETTLED = 1e-8
"""Norm of the change of all qualities, over the spread of the votes, at which the projections stop."""

MOST_ROUNDS = 10_000
FLOOR = 1e-8
"""Added to squared inconsistencies, over the variance of the votes: a rater without noise would be all that counts."""

LONE = 0.5
"""Share of all weights at which one rater is all that counts: the estimates have run away."""

FEWEST_VOTES, FEWEST_RATERS = 3, 3
FEWEST_COMPARED = 6
"""Raters below which none can stand out: nobody knows how far honest ones differ."""

LEVEL = 0.05  # Chance that anybody is said to stand out among raters who differ as honest ones do
MOST_APART = 0.25
"""Share of raters who may stand out; with more of them it is not they who are the exception."""


class _Votes(NamedTuple):
    """Votes one by one: points, number of the rater and of the stimulus, and the names of both."""

    points: Values
    rater: NDArray[np.intp]
    item: NDArray[np.intp]
    raters: tuple[str, ...]
    items: tuple[str, ...]


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

    Raises
    ------
    ValueError
        If there are fewer than 3 raters or stimuli, or raters have rated fewer than 3 stimuli, or none twice.

    Notes
    -----
    ``vote = quality of the stimulus + bias of the rater + inconsistency of the rater x N(0, 1)``, by alternating
    projection, as ``MLE_CO_AP2`` of SUREAL: from mean votes, in turn biases (mean residual of a rater, less their
    mean), inconsistencies (standard deviation of a rater's residuals, ddof 0) and qualities (means of votes less
    bias, weighted by one over inconsistency squared), until qualities settle. Standard errors: inconsistency / sqrt(n)
    of a bias and inconsistency / sqrt(2 n) of an inconsistency; of a quality the standard deviation of the stimulus's
    residuals over sqrt(n) (``se``), and one over the root of the summed weights (``se_raters``, SUREAL's
    ``MLE_CO_AP``). With few raters the likelihood may grow without bound; where one has half of all weights, all count
    alike instead, and a note says so.

    Who stands apart: honest raters differ in inconsistency by a factor that is about log-normal, so the logarithms are
    tested by Rosner's generalised extreme studentised deviate, one-sided, for up to a quarter of the raters, at 5 % for
    the whole panel: several bad raters do not hide each other.

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
    import pandas as pd

    votes = _read(ratings, scale, level)
    counts, n_items = np.bincount(votes.rater), np.bincount(votes.item)
    quality, bias, spread, rounds, lone = _project(votes)
    residual = votes.points - quality[votes.item] - bias[votes.rater]
    n, n_parameters = len(votes.points), len(quality) + 2 * len(bias)
    held = np.maximum(spread, math.sqrt(FLOOR) * votes.points.std())
    likely = -np.log(held) - math.log(2 * math.pi) / 2
    loglikelihood = float((likely[votes.rater] - (residual / held[votes.rater]) ** 2 / 2).mean())
    weights = np.ones_like(held) if lone else 1 / held**2
    means = np.bincount(votes.item, residual) / n_items
    own = np.bincount(votes.item, (residual - means[votes.item]) ** 2) / n_items
    apart, notes = find_apart(spread)
    people = pd.Index(votes.raters, name="participant", dtype=object)
    raters = pd.DataFrame({
        "bias": bias, "bias_se": spread / np.sqrt(counts), "inconsistency": spread,
        "inconsistency_se": spread / np.sqrt(2 * counts), "n": counts, "weight": weights / weights.sum(),
        "apart": apart,
    }, index=people)  # fmt: skip
    se_raters = 1 / np.sqrt(np.bincount(votes.item, 1 / held[votes.rater] ** 2))
    stimuli = pd.DataFrame(
        {"quality": quality, "se": np.sqrt(own / n_items), "se_raters": se_raters, "n": n_items},
        index=pd.Index(votes.items, name=STIMULUS, dtype=object),
    )
    return Statistic(
        "RaterModel", raters=raters, stimuli=stimuli,
        apart=tuple(votes.raters[place] for place in np.argsort(-spread, kind="stable") if apart[place]),
        loglikelihood=loglikelihood, aic=2 * n_parameters / n - 2 * loglikelihood,
        bic=math.log(n) * n_parameters / n - 2 * loglikelihood,
        n_ratings=n, n_parameters=n_parameters, n_rounds=rounds, notes=(*notes, *lone),
    )  # fmt: skip


def find_apart(inconsistency: Values) -> tuple[NDArray[np.bool_], list[str]]:
    """Find raters whose inconsistency is unlike the others': Rosner's test of the logarithms, one-sided."""
    from scipy.stats import t

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


def _read(ratings: Table | DataFrame | ArrayLike, scale: str | None, level: str | None) -> _Votes:
    from pandas import factorize

    if is_tidy(ratings):
        table, _ = leave_rejected(name_stimuli(open_ratings(choose_arms(ratings, scale, level))))
        check_columns(table, ["participant", STIMULUS, "rating"], "ratings")
        refuse_pooled(table)
        values = read_numbers(table["rating"], what="ratings, 'rating'")
        (rater, raters), (item, items) = (
            factorize(table[name].to_numpy(), sort=True) for name in ("participant", STIMULUS)
        )
    else:
        given = read_array(ratings, what="ratings", axes=("items", "raters"), missing=True)
        item, rater = np.nonzero(np.isfinite(given))
        values = given[item, rater]
        (rater, raters), (item, items) = (factorize(one, sort=True) for one in (rater, item))
    for what, numbers, least in (("raters", rater, FEWEST_RATERS), ("stimuli", item, FEWEST_VOTES)):
        if (count := int(numbers.max(initial=-1)) + 1) < least:
            raise ValueError(f"ratings must be of {least} {what} or more, got {count}")
    poor = np.flatnonzero(np.bincount(rater) < FEWEST_VOTES)
    if len(poor):
        got = f"got fewer of {raters[poor[0]]}; leave them out"
        raise ValueError(f"raters must have {FEWEST_VOTES} ratings or more, {got}")
    if not np.isfinite(values).all() or np.ptp(values) == 0:
        raise ValueError("ratings must be finite and differ, got others; leave them out")
    return _Votes(values, rater, item, tuple(map(str, raters)), tuple(map(str, items)))


def _project(votes: _Votes) -> tuple[Values, Values, Values, int, list[str]]:
    """Estimate all; with equal weights, and a note, where one rater alone counts and the likelihood is unbounded."""
    found = _alternate(votes, floor=FLOOR)
    weights = 1 / (found[2] ** 2 + FLOOR * votes.points.var())
    if weights.max() < LONE * weights.sum():
        return *found, []
    who = votes.raters[int(weights.argmax())]
    alone = f"Weighted by consistency, {who} alone would determine the qualities"
    note = f"{alone}, as happens with few raters; all raters count alike instead."
    return *_alternate(votes, floor=math.inf), [note]


def _alternate(votes: _Votes, *, floor: float) -> tuple[Values, Values, Values, int]:
    """Estimate qualities, biases and inconsistencies in turn; an infinite floor makes all weights equal."""
    values, rater, item = votes.points, votes.rater, votes.item
    counts, n_items = np.bincount(rater), np.bincount(item)
    quality, size = np.bincount(item, values) / n_items, float(values.std())
    alike = np.ones(len(counts))
    for rounds in range(1, MOST_ROUNDS + 1):
        before, residual = quality, values - quality[item]
        means = np.bincount(rater, residual) / counts
        bias = means - means.mean()
        spread = np.sqrt(np.bincount(rater, (residual - means[rater]) ** 2) / counts)
        each = 1 / (spread**2 + floor * size**2) if math.isfinite(floor) else alike
        weights = each[rater]
        quality = np.bincount(item, weights * (values - bias[rater])) / np.bincount(item, weights)
        if np.linalg.norm(quality - before) < SETTLED * size:
            return quality, bias, spread, rounds
    why = f"got none after {MOST_ROUNDS} rounds: too few are shared by raters"
    raise ValueError(f"ratings must settle on qualities, {why}")
