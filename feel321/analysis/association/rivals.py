"""Which of many metrics predicts ratings best: out of fold, for other people, recordings and reducers, for how many.

Of twenty uninformative metrics one will correlate by chance, and the best of twenty informative ones is
flattered by having been picked. So every metric is judged on recordings that had no part in fitting it, all intervals
hold together, and what is said to be best, or better than level alone, is said at 5 % for all metrics together.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np

from feel321.analysis.agreement import find_ceiling
from feel321.analysis.arrays import FLAT, PERFECT, Values
from feel321.analysis.association.correlate import find_sign
from feel321.analysis.resampling import weighted_ranks
from feel321.analysis.table.items import Items, Table, choose_metrics, make_items
from feel321.doors import as_rng, check_name
from feel321.records import Statistic

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from numpy.typing import NDArray
    from pandas import DataFrame

    from feel321.types import MetricInfo, Rng

LEVEL = 0.05
"""Chance of any false statement of one kind about any of the metrics."""

BASELINES = ("level_difference", "level_as_played")
"""Metrics that know of nothing but the strength of a stimulus, the first that there is."""

FEWEST = {"participants": 3, "recordings of their own": 4, "metrics that vary within recordings": 2}
"""Below, the spread between people or recordings is all but unknown, and nothing is left to fit to."""

FEWEST_REDUCERS = 5
"""Below, what holds for other reducers cannot be told."""

SIMULATED = 10_000
"""Draws of a multivariate t distribution behind a critical value: known to about 1 % of it."""

STILL = 1e-9
"""Standard errors below this are those of two metrics that say the same."""

METHODS = ("pearson", "spearman")


def rank_metrics(
    ratings: Table | DataFrame,
    metrics: Sequence[str] | None = None,
    *,
    baseline: str | None = None,
    method: str = "pearson",
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
        ``better``; ``honest_value``: what picking the best is worth; ``ceiling``, sizes, and ``notes``.

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
    degrees of freedom, U the smallest of the three numbers, at 5 % each: every value against 0; every metric against
    the baseline; each metric as the control of all others, one-sided (multiple comparisons with the best). With fewer
    than 5 reducers there is no interval and no p.

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
    >>> ranking = analysis.rank_metrics(rows, ["bad", "good", "loud"], baseline="loud")
    >>> ranking.best, ranking.alone, ranking.better
    ('good', True, ('good',))
    """
    check_name(method, METHODS, "method")
    own = ratings.rivals if isinstance(ratings, Table) and metrics is None else ()
    given = choose_metrics(ratings, metrics or own or None)
    declared = ratings.info if isinstance(ratings, Table) else {}
    items, info = make_items(ratings, given), info or declared
    signs = np.array([find_sign(info, name) for name in given])
    items = replace(items, metrics=items.metrics * signs[:, None])
    names, items = _leave_flat(given, items, ranked=method == "spearman")
    counts = (items.n_participants, items.n_sources, len(names))
    for count, (what, least) in zip(counts, FEWEST.items(), strict=True):
        if count < least:
            raise ValueError(
                f"ratings must have {least} {what} or more to rank metrics, got {count}"
            )
    if baseline is None:
        baseline = next((name for name in BASELINES if name in names), "")
    else:
        check_name(baseline, names, "baseline")
    is_few = 0 < items.n_reducers < FEWEST_REDUCERS
    # Participants, sources or reducers, whichever are fewest, limit what is known.
    units = min(items.n_participants, items.n_sources, items.n_reducers or items.n_sources)
    folds = Folds(items)
    spreads = () if is_few else tuple(folds.find_spreads())
    family = _Family(folds.z, spreads, freedom=units - 1, rng=as_rng(rng))
    table, (ceiling, notes) = _tabulate(names, folds, family), find_ceiling(items, within=True)
    table = table.join(family.compare(names, baseline))
    table["share"] = table["value"] / (np.nan if items.n_missing else ceiling)
    table = table.sort_values(["value", "fitted"], ascending=False, kind="stable")
    better = table.index[(table["over_p"] < LEVEL) & (table["over_baseline"] > 0)]
    if flat := [name for name in given if name not in names]:
        notes = [f"Not ranked, because constant within recordings: {', '.join(flat)}.", *notes]
    if is_few:
        notes.append(
            f"{items.n_reducers} reducers, where {FEWEST_REDUCERS} are needed for an interval."
        )
    if not items.n_reducers:
        notes.append(
            "No reducer made stimuli of several recordings: intervals are for other participants and recordings."
        )
    return Statistic(
        "Ranking", table=table, best=str(table.index[0]), alone=bool(table["may_be_best"].sum() == 1),
        candidates=tuple(map(str, table.index[table["may_be_best"]])), baseline=baseline,
        better=tuple(map(str, better)), honest_value=folds.honest, ceiling=ceiling, n_items=items.n_items,
        n_participants=items.n_participants, n_recordings=items.n_recordings, n_sources=items.n_sources,
        n_reducers=items.n_reducers, method=method, notes=(*items.notes, *notes),
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


def _tabulate(names: Sequence[str], folds: Folds, family: _Family) -> DataFrame:
    import pandas as pd

    z, margin, p = family.test(np.eye(len(names)))
    return pd.DataFrame(
        {
            "value": folds.out, "fitted": folds.fitted, "low": np.tanh(z - margin), "high": np.tanh(z + margin),
            "p": p, "may_be_best": family.find_candidates(),
            "chosen": np.bincount(folds.best, minlength=len(names)) / len(folds.best),
        },
        index=pd.Series(names, name="metric", dtype=object),
    )  # fmt: skip


class Folds:
    """Correlations with metrics that were fitted without each recording, and what moves them.

    xy, xx: sums of products of centred metrics and mean ratings, (n_metrics, n_recordings); yy: (n_recordings,).
    out, fitted (in fold): (n_metrics,); honest: of whichever metric the other recordings choose, best.
    """

    def __init__(self, items: Items) -> None:
        self.items, self.seen = items, np.isfinite(items.ratings)
        self.votes = np.maximum(self.seen.sum(axis=0), 1)
        self.means = np.nansum(items.ratings, axis=0) / self.votes
        sums = [(x @ y, (x**2).sum(axis=1), float(y @ y)) for _, x, y in self._list_recordings()]
        self.xy, self.xx, self.yy = (np.array(part).T for part in zip(*sums, strict=True))
        # Recordings of other sources than each.
        sources = items.of_source
        self.apart = (sources[:, None] != sources[None, :]).astype(np.float64)
        rest_xy, rest_xx, rest_yy = (one @ self.apart for one in (self.xy, self.xx, self.yy))
        some = rest_xx > FLAT * self.xx.max(initial=0.0)
        slope = np.divide(rest_xy, rest_xx, out=np.zeros_like(rest_xy), where=some)
        self.slope, self.moves = np.maximum(slope, 0.0), some & (rest_xy > 0)
        self.per_xx = np.divide(1.0, rest_xx, out=np.zeros_like(rest_xx), where=self.moves)
        size = np.sqrt(rest_xx * rest_yy)
        fit = np.divide(rest_xy, size, out=np.full_like(rest_xy, -1.0), where=some & (size > 0))
        self.best = fit.argmax(axis=0)
        self.out = self._correlate(self.slope * self.xy, self.slope**2 * self.xx)
        self.fitted = self._correlate(self.xy, self.xx)
        own = self.best, np.arange(len(self.best))
        chosen, square = self.slope[own] * self.xy[own], self.slope[own] ** 2 * self.xx[own]
        self.honest = float(self._correlate(chosen[None], square[None])[0])
        self.z = np.arctanh(np.clip(self.out, -PERFECT, PERFECT))

    def _list_recordings(self) -> Iterator[tuple[NDArray[np.intp], Values, Values]]:
        """List the rated stimuli of each recording, their metrics and mean ratings, centred."""
        for number in range(self.items.n_recordings):
            own = np.flatnonzero((self.items.recordings == number) & self.seen.any(axis=0))
            x, y = self.items.metrics[:, own], self.means[own]
            yield own, x - x.mean(axis=1, keepdims=True), y - y.mean()

    def _correlate(self, product: Values, square: Values) -> Values:
        top, scale = product.sum(axis=1), np.sqrt(square.sum(axis=1) * self.yy.sum())
        found: Values = np.divide(top, scale, out=np.zeros_like(top), where=scale > 0)
        return found

    def find_influences(self) -> Values:
        """Differentiate z of every metric by the weight of every rating: (n_metrics, n_participants, n_items).

        A rating's weight w moves the mean of its stimulus, and the weight that the stimulus has among others. Summed
        over the ratings of a person, recording or reducer: the derivative by how often those are drawn.
        """
        items, slope, per_xx, apart = self.items, self.slope, self.per_xx, self.apart
        square, total = (slope**2 * self.xx).sum(axis=1), float(self.yy.sum())
        moves = (square > 0) & (total > 0)
        size = np.where(moves, np.sqrt(square * total), np.inf)
        square = np.where(moves, square, np.inf)
        value = np.clip((slope * self.xy).sum(axis=1) / size, -PERFECT, PERFECT)
        # Of value = top / sqrt(square total), by the sums of one recording: its own part, and that in others' slopes.
        by_xy = (slope + (self.xy * per_xx) @ apart) / size[:, None]
        by_xy -= (value / square)[:, None] * ((slope * self.xx * per_xx) @ apart)
        by_xx = -((self.xy * slope * per_xx) @ apart) / size[:, None]
        within = slope**2 / 2 - (slope**2 * self.xx * per_xx) @ apart
        by_xx -= (value / square)[:, None] * within
        by_yy = -np.where(moves, value, 0.0) / (2 * max(total, STILL))
        from_item = np.where(self.seen, items.ratings - self.means, 0.0)
        found = np.zeros((len(items.metrics), *items.ratings.shape))
        for scene, (own, x, y) in enumerate(self._list_recordings()):
            each_xy, each_xx = by_xy[:, [scene]], by_xx[:, [scene]]
            of_weight = each_xy * x * y + each_xx * x**2 + by_yy[:, None] * y**2
            of_mean = each_xy * x + 2 * by_yy[:, None] * y
            found[:, :, own] = (of_weight / items.n_participants)[:, None, :]
            found[:, :, own] += (of_mean / self.votes[own])[:, None, :] * from_item[:, own]
        of_z: Values = found / (1 - value**2)[:, None, None]
        return of_z

    def find_spreads(self) -> Iterator[Values]:
        """Find the covariance of z between metrics, for other people, recordings and reducers; then of each alone.

        Each (n_metrics, n_metrics). What several factors share is counted once, with G / (G - 1) for G groups.
        """
        items = self.items
        influences = self.find_influences().reshape(len(items.metrics), -1)
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
        yield spread
        yield from alone


class _Family:
    """Statements on values of z and their differences that hold together; none without spreads."""

    def __init__(
        self, z: Values, spreads: tuple[Values, ...], *, freedom: int, rng: np.random.Generator
    ) -> None:
        self.z, self.spreads = z, spreads
        if spreads:
            values, vectors = np.linalg.eigh(spreads[0])
            root = vectors * np.sqrt(np.maximum(values, 0.0))
            normal = rng.standard_normal((SIMULATED, len(root))) @ root.T
            self.simulated = normal / np.sqrt(rng.chisquare(freedom, (SIMULATED, 1)) / freedom)
            self.simulated_spread = root @ root.T

    def _measure(self, contrasts: Values) -> tuple[Values, Values]:
        """Measure the standard errors of contrasts, never less than for one factor alone, and simulate their t.

        Infinite for contrasts of metrics that say the same.
        """
        squares = [((contrasts @ one) * contrasts).sum(axis=1) for one in self.spreads]
        own = ((contrasts @ self.simulated_spread) * contrasts).sum(axis=1)
        se, own = np.sqrt(np.maximum(np.max(squares, axis=0), 0.0)), np.sqrt(np.maximum(own, 0.0))
        moves = (se > STILL) & (own > STILL)
        return np.where(moves, se, np.inf), self.simulated @ contrasts.T / np.where(
            moves, own, np.inf
        )

    def test(self, contrasts: Values) -> tuple[Values, Values, Values]:
        """Estimate contrasts of z, (n, n_metrics), with simultaneous margins and adjusted p."""
        found = contrasts @ self.z
        if not self.spreads:
            none = np.full(len(found), np.nan)
            return found, none, none
        se, simulated = self._measure(contrasts)
        largest = np.abs(simulated).max(axis=1)
        above = SIMULATED - np.searchsorted(np.sort(largest), np.abs(found / se))
        margin = np.where(np.isfinite(se), np.quantile(largest, 1 - LEVEL) * se, np.nan)
        return found, margin, np.where(np.isfinite(se), (above + 1) / (SIMULATED + 1), 1.0)

    def find_candidates(self) -> list[bool]:
        """Find which metrics may be the best: no other is better by more than chance, each in turn the control."""
        if not self.spreads:
            return [True] * len(self.z)
        found, each = [], np.eye(len(self.z))
        for number in range(len(self.z)):
            contrasts = each - each[number]
            se, simulated = self._measure(contrasts)
            limit = np.quantile(simulated.max(axis=1), 1 - LEVEL)
            found.append(bool((contrasts @ self.z / se).max() <= limit))
        return found

    def compare(self, names: Sequence[str], control: str) -> DataFrame:
        """Tabulate what every metric has over the control, as differences of correlations; NaN without one."""
        import pandas as pd

        index = pd.Series(names, name="metric", dtype=object)
        columns = ["over_baseline", "over_low", "over_high", "over_p"]
        if not control:
            return pd.DataFrame(np.nan, index=index, columns=columns)
        place, each = list(names).index(control), np.eye(len(names))
        rows = np.arange(len(names)) != place
        ahead, margin, p = self.test((each - each[place])[rows])
        middle = (self.z[rows] + self.z[place]) / 2
        ends = np.stack([ahead, ahead - margin, ahead + margin])
        values = np.vstack([np.tanh(middle + ends / 2) - np.tanh(middle - ends / 2), p])
        found = pd.DataFrame(values.T, index=index[rows], columns=columns)
        return found.reindex(index)
