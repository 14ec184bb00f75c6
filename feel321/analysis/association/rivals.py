"""Which of many metrics predicts ratings best: out of fold, for other people, recordings and reducers, for how many.

Of twenty uninformative metrics one will correlate by chance, and the best of twenty informative ones is
flattered by having been picked. So every metric is judged on recordings that had no part in fitting it, all intervals
hold together, and what is said to be best, or better than level alone, is said at 5 % for all metrics together.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from feel321.analysis.agreement import find_ceiling
from feel321.analysis.arrays import FLAT, PERFECT, Values, check_draws
from feel321.analysis.association.correlate import find_sign
from feel321.analysis.resampling import BLOCK, bootstrap_margin, draw_counts, weighted_ranks
from feel321.analysis.table.items import Items, Table, choose_metrics, make_items
from feel321.doors import as_rng, check_name
from feel321.records import Statistic

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from pandas import DataFrame

    from feel321.types import MetricInfo, Rng

LEVEL = 0.05
"""Chance of any false statement of one kind about any of the metrics."""

BASELINES = ("level_difference", "level_as_played")
"""Metrics that know of nothing but the strength of a stimulus, the first that there is."""

FEWEST_PEOPLE, FEWEST_RECORDINGS, FEWEST_METRICS, FEWEST_DRAWN = 3, 4, 2, 2
"""Below, the spread between people or recordings is all but unknown, and nothing is left to fit to."""

SIMULATED = 10_000
"""Draws of a multivariate t distribution behind a critical value: known to about 1 % of it."""

FEWEST_REDUCERS = 5
"""Below, what holds for other reducers cannot be told."""

STILL = 1e-9
"""Standard errors below this are those of two metrics that say the same."""

METHODS = ("pearson", "spearman")


class _Scores(NamedTuple):
    """Correlations out of fold, (n_metrics, draws), and of whichever metric the other recordings choose, (draws,).

    chosen: (n_recordings, draws), number of the metric that the others choose. fitted: as values, but in fold.
    """

    out: Values
    honest: Values
    chosen: Values
    fitted: Values


def rank_metrics(  # noqa: PLR0913 - one per choice
    ratings: Table | DataFrame,
    metrics: Sequence[str] | None = None,
    *,
    baseline: str | None = None,
    method: str = "pearson",
    draws: int = 2000,
    rng: Rng = 0,
    info: Mapping[str, MetricInfo] | None = None,
) -> Statistic:
    """Rank metrics by how well they predict ratings, corrected for how many were tried.

    Parameters
    ----------
    ratings : Table or DataFrame
        Ratings of one scale and level, as for `correlate`. Rows whose role is not ``test`` are left out.
    metrics : sequence of str, optional
        Columns to rank, two or more; a Table's rivals, or its metrics where it has none, if left out.
    baseline : str, optional
        The metric that others must beat; ``level_difference`` or ``level_as_played`` where there is one, if
        left out.
    method : str
        ``pearson``, or ``spearman``: metrics as ranks within their recording, for those with outliers.
    draws : int
        Bootstrap draws for the interval of ``honest_value``, at least 2.
    rng : int or Generator
        Seed, or source of randomness.
    info : Mapping of str to MetricInfo, optional
        What metrics declare, above all which way they point; a Table's own if left out.

    Returns
    -------
    Statistic
        ``table``, indexed by metric, the best first: value low high, the out-of-fold correlation with its simultaneous
        95 % interval, and p, adjusted for all metrics; share, value / ceiling; over_baseline over_low over_high
        over_p; may_be_best, whether it belongs to the 95 % confidence set of the best metric; chosen, the share of
        folds in which the other recordings would choose it; fitted, the correlation within recordings of all stimuli,
        where the slope may have any sign. ``best alone candidates``: that set; ``baseline``, and which metrics are
        ``better``; ``honest_value honest_low honest_high``: what picking the best is worth; ``ceiling``, sizes, and
        ``notes``.

    Raises
    ------
    ValueError
        If there are fewer than 3 participants, 4 recordings or 2 metrics that vary within recordings.

    Notes
    -----
    **Out of fold.** With x and y a metric and the mean ratings, less their means in recording r, and b the slope
    of y on x by least squares in all recordings but r (and those of its source), the prediction of r is b x. A metric
    may only predict in the direction that it declares: otherwise b is 0 there. The value is
    Σ_r Σ b x y / sqrt(Σ_r Σ (b x)² Σ_r Σ y²), the correlation of predicted with rated differences. With
    ``honest_value`` each recording is predicted by the metric that correlates best over the others.

    **Intervals** hold for other participants, recordings (sources) and reducers. The variance of Fisher's z of the
    values is that of clustering by all three factors, V_P + V_R + V_M - V_PR - V_PM - V_RM + V_PRM, from the
    influence of each rating, each part times G / (G - 1) for G groups, and never less than that of one factor.
    The correction for their number is the single-step maximum of t statistics under a multivariate t with U - 1
    degrees of freedom, U the smallest of the three numbers. Three families, each at 5 %: every value against 0; every
    metric against the baseline; and, for the confidence set of the best metric, each metric as the control of all
    others, one-sided (multiple comparisons with the best). With fewer than 5 reducers there is no interval and no p.
    Where no reducer made stimuli of several recordings, the factors are participants and recordings. ``honest_value``
    has the interval of a bootstrap of all factors, which errs on the wide side.

    In simulated studies of 12 people, 8 recordings, 6 reducers and 12 metrics of which none says anything, any was said
    to be better than the baseline in 1.7 to 2.8 %, where reducers differ by up to 8 points for reasons that no metric
    knows; a metric that explains 25 points per unit of itself was found in 53 to 76 %.

    References
    ----------
    Hothorn, Bretz & Westfall (2008), doi 10.1002/bimj.200810425; Hsu (1984), doi 10.1214/aos/1176346732; Cameron,
    Gelbach & Miller (2011), doi 10.1198/jbes.2010.07136.

    Examples
    --------
    >>> import numpy as np, pandas as pd
    >>> from feel321 import analysis
    >>> rng = np.random.default_rng(1)
    >>> good, bad, loud = rng.uniform(0, 1, (3, 48))
    >>> rows = pd.DataFrame({"participant": np.repeat(np.arange(8), 48), "recording": np.tile(np.arange(48) // 6, 8),
    ...     "reducer": np.tile(np.arange(48) % 6, 8), "good": np.tile(good, 8), "bad": np.tile(bad, 8),
    ...     "loud": np.tile(loud, 8)})
    >>> rows["rating"] = 20 + 60 * rows["good"] + rng.normal(0, 8, len(rows))
    >>> ranking = analysis.rank_metrics(rows, ["bad", "good", "loud"], baseline="loud", draws=200)
    >>> ranking.best, ranking.alone, ranking.better
    ('good', True, ('good',))
    """
    check_draws(draws)
    check_name(method, METHODS, "method")
    own = ratings.rivals if isinstance(ratings, Table) and metrics is None else ()
    given = choose_metrics(ratings, metrics or own or None)
    items = make_items(ratings, given)
    declared = ratings.info if isinstance(ratings, Table) else {}
    info, generator = info or declared, as_rng(rng)
    signs = np.array([find_sign(info, name) for name in given])
    items = replace(items, metrics=items.metrics * signs[:, None])
    names, items = _leave_flat(given, items, ranked=method == "spearman")
    flat = [name for name in given if name not in names]
    control = _choose_control(items, names, baseline)
    whole = _score(items, np.ones((1, items.n_participants)), np.ones((1, items.n_recordings)))
    is_few = 0 < items.n_reducers < FEWEST_REDUCERS
    # Participants, sources or reducers, whichever are fewest, limit what is known.
    units = min(items.n_participants, items.n_sources, items.n_reducers or items.n_sources)
    spreads = () if is_few else find_spreads(items)
    judged = _Judged(whole, spreads, freedom=units - 1, rng=generator)
    ceiling, more = find_ceiling(items, within=True)
    table = judged.tabulate(names, control)
    table["share"] = table["value"] / (np.nan if items.n_missing else ceiling)
    table = table.sort_values(["value", "fitted"], ascending=False, kind="stable")
    better = table.index[(table["over_p"] < LEVEL) & (table["over_baseline"] > 0)]
    middle, margin = float(_to_z(whole.honest)[0]), np.nan
    if not is_few:
        margin = bootstrap_margin(_to_z(_draw(items, draws=draws, rng=generator).honest), units)
    notes = [f"Not ranked, because constant within recordings: {', '.join(flat)}."] if flat else []
    few = f"{items.n_reducers} reducers, where {FEWEST_REDUCERS} are needed for an interval."
    alone = "No reducer made stimuli of several recordings: intervals are for other participants and recordings."
    limits = [few] * is_few + [alone] * (not items.n_reducers)
    return Statistic(
        "Ranking", table=table, best=str(table.index[0]), alone=bool(table["may_be_best"].sum() == 1),
        candidates=tuple(map(str, table.index[table["may_be_best"]])),
        baseline=names[control] if control is not None else "", better=tuple(map(str, better)),
        honest_value=float(whole.honest[0]), honest_low=float(np.tanh(middle - margin)),
        honest_high=float(np.tanh(middle + margin)), ceiling=ceiling, n_participants=items.n_participants,
        n_recordings=items.n_recordings, n_sources=items.n_sources, n_reducers=items.n_reducers, n_items=items.n_items,
        draws=draws, method=method, notes=(*items.notes, *notes, *more, *limits),
    )  # fmt: skip


def _leave_flat(
    names: Sequence[str], items: Items, *, ranked: bool
) -> tuple[tuple[str, ...], Items]:
    """Centre metrics, or their ranks, within recordings; leave out those that do not vary there."""
    centred = items.metrics.copy()
    for number in range(items.n_recordings):
        own = items.recordings == number
        if ranked:
            centred[:, own] = weighted_ranks(centred[:, own], np.ones(int(own.sum())))
        centred[:, own] -= centred[:, own].mean(axis=1, keepdims=True)
    varies = (centred**2).sum(axis=1) > FLAT * (items.metrics**2).sum(axis=1)
    left = tuple(name for name, moves in zip(names, varies, strict=True) if moves)
    return left, replace(items, metrics=centred[varies])


def _choose_control(items: Items, names: Sequence[str], baseline: str | None) -> int | None:
    """Find the number of the metric that others must beat, None if there is none; refuse what cannot be ranked."""
    for count, least, what in (
        (items.n_participants, FEWEST_PEOPLE, "participants"),
        (items.n_sources, FEWEST_RECORDINGS, "recordings of their own"),
        (len(names), FEWEST_METRICS, "metrics that vary within recordings"),
    ):
        if count < least:
            raise ValueError(
                f"ratings must have {least} {what} or more to rank metrics, got {count}"
            )
    if baseline is not None:
        return list(names).index(check_name(baseline, names, "baseline"))
    return next((list(names).index(name) for name in BASELINES if name in names), None)


def _draw(items: Items, *, draws: int, rng: np.random.Generator) -> _Scores:
    size = items.n_items + items.n_recordings * len(items.metrics)
    block, found = max(1, BLOCK // size), []
    for start in range(0, draws, block):
        number = min(block, draws - start)
        people = draw_counts(items.n_participants, number, rng=rng)
        scenes = draw_counts(items.n_sources, number, rng=rng)[:, items.of_source]
        kinds = draw_counts(items.n_reducers, number, rng=rng) if items.n_reducers else None
        found.append(_score(items, people, scenes, reducers=kinds))
    return _Scores(*(np.concatenate(part, axis=-1) for part in zip(*found, strict=True)))


def _score(
    items: Items, people: Values, scenes: Values, *, reducers: Values | None = None
) -> _Scores:
    """Correlate out of fold, with how often each counts.

    people: (draws, n_participants); scenes: (draws, n_recordings); reducers: (draws, n_reducers), once each if None.
    """
    xy, xx, yy = _sum_products(items, people, reducers)
    counts = scenes.T[..., None]
    # What is left of a sum without a recording and all others of its source.
    together = (items.of_source[:, None] == items.of_source[None, :]).astype(np.float64)
    rest_xy, rest_xx, rest_yy = (
        (counts * one).sum(axis=0) - np.tensordot(together, counts * one, axes=1)
        for one in (xy, xx, yy)
    )
    some = rest_xx > FLAT * xx.max(initial=0.0)
    slope = np.maximum(np.divide(rest_xy, rest_xx, out=np.zeros_like(rest_xy), where=some), 0.0)
    size = np.sqrt(rest_xx * rest_yy)
    fit = np.divide(rest_xy, size, out=np.full_like(rest_xy, -1.0), where=some & (size > 0))
    best = fit.argmax(axis=-1)

    def correlate(product: Values, square: Values) -> Values:
        scale = np.sqrt((counts * square).sum(axis=0) * (counts * yy).sum(axis=0))
        top = (counts * product).sum(axis=0)
        value: Values = np.divide(top, scale, out=np.zeros_like(top), where=scale > 0)
        return value

    values = correlate(slope * xy, slope**2 * xx).T
    own_slope, own_xy, own_xx = (
        np.take_along_axis(one, best[..., None], axis=-1) for one in (slope, xy, xx)
    )
    honest = correlate(own_slope * own_xy, own_slope**2 * own_xx)[:, 0]
    # Of one recording alone, however often it was drawn, nothing else predicts anything.
    drawn = (scenes > 0).astype(np.float64) @ together > 0
    lonely = np.array([len(np.unique(items.of_source[row])) < FEWEST_DRAWN for row in drawn])
    if reducers is not None:
        lonely |= (reducers > 0).sum(axis=1) < FEWEST_DRAWN
    fitted = correlate(xy, xx).T
    return _Scores(np.where(lonely, np.nan, values), np.where(lonely, np.nan, honest), best, fitted)


def _sum_products(
    items: Items, people: Values, reducers: Values | None
) -> tuple[Values, Values, Values]:
    """Sum products of centred metrics x and mean ratings y: xy, xx (n_recordings, draws, n_metrics), yy (.., 1)."""
    seen = np.isfinite(items.ratings)
    votes = people @ seen.astype(np.float64)
    sums = people @ np.where(seen, items.ratings, 0.0)
    means = np.divide(sums, votes, out=np.zeros_like(sums), where=votes > 0)
    weights = (votes > 0).astype(np.float64)
    if reducers is not None and items.reducers is not None:
        weights *= reducers[:, items.reducers]
    found = []
    for number in range(items.n_recordings):
        own = items.recordings == number
        x, weight, y = items.metrics[:, own].T, weights[:, own], means[:, own]
        total = np.maximum(weight.sum(axis=1, keepdims=True), 1.0)
        y = y - (weight * y).sum(axis=1, keepdims=True) / total
        found.append((
            (weight * y) @ x,
            weight @ x**2 - (weight @ x) ** 2 / total,
            (weight * y**2).sum(axis=1, keepdims=True),
        ))
    xy, xx, yy = (np.array(part) for part in zip(*found, strict=True))
    return xy, np.maximum(xx, 0.0), yy


def find_influences(items: Items) -> Values:
    """Differentiate z of every metric by the weight of every rating: (n_metrics, n_participants, n_items).

    A rating's weight w moves the mean of its stimulus, and the weight that the stimulus has among others. Summed over
    the ratings of a person, recording or reducer: the derivative by how often those are drawn.
    """
    people, scenes = np.ones((1, items.n_participants)), np.arange(items.n_recordings)
    xy, xx, yy = (one[:, 0].T for one in _sum_products(items, people, None))
    apart = (items.of_source[:, None] != items.of_source[None, :]).astype(np.float64)
    rest_xy, rest_xx = xy @ apart, xx @ apart
    some = (rest_xx > FLAT * xx.max(initial=0.0)) & (rest_xy > 0)
    per_xx = np.divide(1.0, rest_xx, out=np.zeros_like(rest_xx), where=some)
    slope = rest_xy * per_xx
    top, square, total = ((slope * xy).sum(axis=1), (slope**2 * xx).sum(axis=1), float(yy.sum()))
    moves = (square > 0) & (total > 0)
    size = np.where(moves, np.sqrt(square * total), np.inf)
    square = np.where(moves, square, np.inf)
    value = np.clip(top / size, -PERFECT, PERFECT)
    # Of value = top / sqrt(square total), by the sums of one recording: its own part, and that in others' slopes.
    by_xy = (slope + (xy * per_xx) @ apart) / size[:, None]
    by_xy -= (value / square)[:, None] * ((slope * xx * per_xx) @ apart)
    by_xx = -((xy * slope * per_xx) @ apart) / size[:, None]
    by_xx -= (value / square)[:, None] * (slope**2 / 2 - (slope**2 * xx * per_xx) @ apart)
    by_yy = -np.where(moves, value, 0.0) / (2 * max(total, STILL))
    seen = np.isfinite(items.ratings)
    votes = np.maximum(seen.sum(axis=0), 1)
    from_item = np.where(seen, items.ratings - np.nansum(items.ratings, axis=0) / votes, 0.0)
    found = np.zeros((len(items.metrics), *items.ratings.shape))
    for scene in scenes:
        own = np.flatnonzero((items.recordings == scene) & seen.any(axis=0))
        x, y = items.metrics[:, own], np.nansum(items.ratings[:, own], axis=0) / votes[own]
        x, y = x - x.mean(axis=1, keepdims=True), y - y.mean()
        each_xy, each_xx = by_xy[:, [scene]], by_xx[:, [scene]]
        of_weight = each_xy * x * y + each_xx * x**2 + by_yy[:, None] * y**2
        of_mean = each_xy * x + 2 * by_yy[:, None] * y
        found[:, :, own] = (of_weight / items.n_participants)[:, None, :]
        found[:, :, own] += (of_mean / votes[own])[:, None, :] * from_item[:, own]
    of_z: Values = found / (1 - value**2)[:, None, None]
    return of_z


def find_spreads(items: Items) -> tuple[Values, ...]:
    """Find the covariance of z between metrics, for other people, recordings and reducers; then of each alone.

    Each (n_metrics, n_metrics). What several factors share is counted once: V_P + V_R + V_M - V_PR - V_PM - V_RM +
    V_PRM, with G / (G - 1) for G groups.
    """
    influences = find_influences(items).reshape(len(items.metrics), -1)
    person, item = np.divmod(np.arange(influences.shape[1]), items.n_items)
    factors = [person, items.of_source[items.recordings][item]]
    if items.reducers is not None:
        factors.append(items.reducers[item])
    spread, alone = np.zeros((len(influences),) * 2), []
    for number in range(1, len(factors) + 1):
        for chosen in combinations(factors, number):
            codes = np.unique(np.stack(chosen), axis=1, return_inverse=True)[1].ravel()
            sums = np.stack([np.bincount(codes, row) for row in influences])
            product = sums @ sums.T * (sums.shape[1] / max(sums.shape[1] - 1, 1))
            spread += (-1.0) ** (number - 1) * product
            alone += [product] if number == 1 else []
    return spread, *alone


class _Judged:
    """What the spread of values says of them and their differences, all at once."""

    def __init__(
        self, whole: _Scores, spreads: tuple[Values, ...], *, freedom: int, rng: np.random.Generator
    ) -> None:
        self.whole, self.z, self.spreads = whole, _to_z(whole.out[:, 0]), spreads
        if spreads:
            values, vectors = np.linalg.eigh(spreads[0])
            root = vectors * np.sqrt(np.maximum(values, 0.0))
            normal = rng.standard_normal((SIMULATED, len(root))) @ root.T
            self.simulated = normal / np.sqrt(rng.chisquare(freedom, (SIMULATED, 1)) / freedom)
            self.simulated_spread = root @ root.T

    def _measure(self, contrasts: Values) -> tuple[Values, Values]:
        """Measure the standard errors of contrasts, never less than for one factor alone, and those simulated."""
        most, own = (
            np.zeros(len(contrasts)),
            ((contrasts @ self.simulated_spread) * contrasts).sum(1),
        )
        for spread in self.spreads:
            most = np.maximum(most, ((contrasts @ spread) * contrasts).sum(axis=1))
        return np.sqrt(most), np.sqrt(np.maximum(own, 0.0))

    def test(self, contrasts: Values) -> tuple[Values, Values, Values]:
        """Estimate contrasts of z, (n, n_metrics), with simultaneous margins and adjusted p."""
        found = contrasts @ self.z
        if not self.spreads:
            none = np.full(len(found), np.nan)
            return found, none, none
        se, own = self._measure(contrasts)
        moves = (se > STILL) & (own > STILL)
        largest = np.abs(self.simulated @ contrasts.T / np.where(moves, own, np.inf)).max(axis=1)
        above = SIMULATED - np.searchsorted(
            np.sort(largest), np.abs(found / np.where(moves, se, np.inf))
        )
        margin = np.where(moves, np.quantile(largest, 1 - LEVEL) * se, np.nan)
        return found, margin, np.where(moves, (above + 1) / (SIMULATED + 1), 1.0)

    def find_candidates(self) -> list[bool]:
        """Find which metrics may be the best: no other is better by more than chance, each in turn the control."""
        if not self.spreads:
            return [True] * len(self.z)
        found, each = [], np.eye(len(self.z))
        for number in range(len(self.z)):
            contrasts = each - each[number]
            se, own = self._measure(contrasts)
            moves = (se > STILL) & (own > STILL)
            ahead = self.simulated @ contrasts.T / np.where(moves, own, np.inf)
            limit = np.quantile(ahead.max(axis=1), 1 - LEVEL)
            found.append(bool((contrasts @ self.z / np.where(moves, se, np.inf)).max() <= limit))
        return found

    def tabulate(self, names: Sequence[str], control: int | None) -> DataFrame:
        """List the metrics with their values, what they have over the control, and whether they may be the best."""
        import pandas as pd

        each = np.eye(len(names))
        z, margin, p = self.test(each)
        folds = self.whole.chosen[:, 0]
        columns = {
            "value": self.whole.out[:, 0], "fitted": self.whole.fitted[:, 0],
            "low": np.tanh(z - margin), "high": np.tanh(z + margin), "p": p,
            "may_be_best": self.find_candidates(),
            "chosen": np.bincount(folds, minlength=len(names)) / len(folds),
        }  # fmt: skip
        over = {
            key: np.full(len(names), np.nan)
            for key in ("over_baseline", "over_low", "over_high", "over_p")
        }
        if control is not None:
            rows = np.arange(len(names)) != control
            ahead, margin, p = self.test((each - each[control])[rows])
            middle = (z[rows] + z[control]) / 2
            for key, z_ahead in (
                ("baseline", ahead),
                ("low", ahead - margin),
                ("high", ahead + margin),
            ):
                over[f"over_{key}"][rows] = np.tanh(middle + z_ahead / 2) - np.tanh(
                    middle - z_ahead / 2
                )
            over["over_p"][rows] = p
        return pd.DataFrame(
            {**columns, **over}, index=pd.Series(names, name="metric", dtype=object)
        )


def _to_z(values: Values) -> Values:
    z: Values = np.arctanh(np.clip(values, -PERFECT, PERFECT))
    return z
