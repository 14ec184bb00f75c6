"""Correlations of ratings with metrics over items, with two-way intervals.

Stimuli are a sample too: metrics vary only between stimuli, and stimuli cluster in recordings. An interval
over participants alone treats these recordings as the only ones there will ever be; it covers the truth about
half the time. Conclusions therefore come from the two-way interval, for which participants and recordings are
both drawn anew; the narrower one is reported beside it, by name, for comparison with the literature.
"""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from itertools import combinations
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from pandas import DataFrame

from feel321.analysis import resampling
from feel321.analysis.agreement import SMALLEST, find_ceiling
from feel321.analysis.arrays import PERFECT, Values, check_draws
from feel321.analysis.contrasts.compare import stimulus_means
from feel321.analysis.table.items import Items, Table, choose_arms, make_items
from feel321.arguments import as_rng, check_name
from feel321.records import Statistic
from feel321.types import MetricInfo, Rng

SIZES = ("n_participants", "n_recordings", "n_sources", "n_missing")  # What a result tells of items


def correlate(  # noqa: PLR0913 - which rows, and how
    ratings: Table | DataFrame,
    metric: str,
    *,
    scale: str | None = None,
    level: str | None = None,
    method: str = "pearson",
    draws: int = 2000,
    rng: Rng = 0,
) -> Statistic:
    """Correlate mean ratings with a metric over test stimuli.

    Parameters
    ----------
    ratings : Table or DataFrame
        Ratings, one row per judgement: participant, recording, rating, the metric's column, and stimulus_id or reducer
        (and level). Rows whose role is not ``test`` are left out.
    metric : str
        Column to correlate with.
    scale, level : str, optional
        Which ratings; needed where there are several scales or levels.
    method : str
        ``pearson``, ``spearman`` or ``kendall`` (tau-b) over all stimuli; ``within``, ``within_spearman`` or
        ``within_kendall`` within each recording, averaged over Fisher's z.
    draws : int
        Number of bootstrap draws, at least 2; 2000 or more for results to be published.
    rng : int or Generator
        Seed, or source of randomness; the same state gives the same result to the last bit.

    Returns
    -------
    Statistic
        ``value``; ``low high``, the 95 % two-way interval, the one to conclude from; ``n_items``; ``ceiling``,
        sqrt(ICC(C,k)), which a perfect metric would reach with ratings as noisy as these (within recordings for the
        within methods), and ``disattenuated``, value / ceiling, NaN for ranks; ``draws`` that were defined;
        ``participants_low participants_high``, which takes these stimuli for the only ones; ``n_participants
        n_recordings n_sources n_missing metric method``; ``notes``, why anything is NaN.

    Notes
    -----
    A stimulus's rating is the mean over participants of each participant's mean over repeats. With R
    recordings (sources, where several come from one), T the correlation and T* its bootstrap draws, the interval is
    tanh(atanh T ± t(.975, R - 1) sqrt(R / (R - 1)) SD(atanh T*)). With P participants, fewer than R, P takes the place
    of R: with R in both places it covered the truth in 67 % (P = 2) and 76 % (P = 3) of simulated studies. A draw is
    undefined, and left out, if it has fewer than three different stimuli, a constant, or all points on one line.

    The within methods compare stimuli of the same recording only, which is the claim about a metric of reducers: with
    z_r = atanh of the correlation in recording r, tanh(Σ z_r / R), over the recordings in which it is defined. By ranks
    a perfect z_r of n items counts as 1 - 6 / (n (n² - 1)). The mean z leans to the far side by about
    r / (2 (n_r - 1)); the intervals of ``within`` are drawn about the mean z less that.

    References
    ----------
    Silver & Dunlap (1987), doi 10.1037/0021-9010.72.1.146; Owen (2007), The pigeonhole bootstrap, doi
    10.1214/07-AOAS122.

    Examples
    --------
    >>> import pandas as pd
    >>> from feel321 import analysis
    >>> tidy = pd.DataFrame({"participant": list("aaaabbbb"), "recording": list("rrssrrss"),
    ...     "reducer": ["mag321", "dft321"] * 4, "spectral_match": [0.2, 1, 0.4, 1] * 2,
    ...     "rating": [20, 70, 35, 90, 25, 80, 30, 75]})
    >>> result = analysis.correlate(tidy, "spectral_match", rng=1)
    >>> round(result.value, 2), result.n_items
    (0.99, 4)
    """
    items = make_items(choose_arms(ratings, scale, level), (metric,))
    (found,) = correlate_items(items, (metric,), method, draws=draws, rng=rng)
    return found.associate(metric)


def compare_metrics(  # noqa: PLR0913 - as `correlate`
    ratings: Table | DataFrame,
    first: str,
    second: str,
    *,
    scale: str | None = None,
    level: str | None = None,
    method: str = "pearson",
    draws: int = 2000,
    rng: Rng = 0,
) -> Statistic:
    """Compare two metrics by how strongly mean ratings correlate with each.

    Parameters
    ----------
    ratings : Table or DataFrame
        As for `correlate`.
    first, second : str
        Columns to compare.
    scale, level, method : str, optional
        As for `correlate`.
    draws : int
        Number of bootstrap draws, at least 2.
    rng : int or Generator
        Seed, or source of randomness.

    Returns
    -------
    Statistic
        ``value``, the first correlation minus the second; ``low high``, its 95 % two-way interval; the same as a
        difference of Fisher's z: ``z_value z_low z_high``; ``first_value second_value``, sizes and ``notes`` as of
        `correlate`.

    Notes
    -----
    Both correlations are recomputed in every draw, so their dependence is accounted for. With d = atanh r1 -
    atanh r2, the interval is d ± t(.975, R - 1) sqrt(R / (R - 1)) SD(d*), P in the place of R as for
    `correlate`. It is expressed as a difference of correlations by d -> tanh(m + d / 2) - tanh(m - d / 2), m the mean
    of the two z.
    """
    if first == second:
        raise ValueError(f"second must be another metric than the first, got {second!r} twice")
    names = (first, second)
    items = make_items(choose_arms(ratings, scale, level), names)
    (found,) = correlate_items(items, names, method, draws=draws, rng=rng)
    return found.compare(*names)


class Correlated(NamedTuple):
    """Items, the names of their metrics, and the correlations with these in every draw."""

    items: Items
    metrics: tuple[str, ...]
    method: str
    drawn: resampling.Draws

    def associate(self, metric: str) -> Statistic:
        """Correlate with one metric."""
        items, drawn, place = self.items, self.drawn, self.metrics.index(metric)
        how, notes = resampling.METHODS[self.method], list(self._explain(metric))
        value, two_way, people = (part[place] for part in drawn[:3])
        lean = resampling.measure_lean(items, self.method, drawn)[place]
        middle = float(resampling.fisher_z(value) - lean)
        units = resampling.count_scarcest(items, drawn.of_recordings[[place]])
        (low, high), (narrow_low, narrow_high) = (
            np.tanh(middle + resampling.bootstrap_margin(part, n) * np.array([-1, 1])).tolist()
            for part, n in ((two_way, units), (people, items.n_participants))
        )
        ceiling, more_notes = find_ceiling(items, within=how.within)
        if not np.isnan(value):
            notes += _explain_undrawn(two_way, "two-way")
            notes += _explain_undrawn(people, "participants-only")
        divisible = not how.ranked and not items.n_missing
        return Statistic(
            "Association", value=float(value), low=low, high=high, n_items=items.n_items, ceiling=ceiling,
            disattenuated=float(value) / ceiling if divisible else float("nan"),
            draws=int(np.isfinite(two_way).sum()), participants_low=narrow_low, participants_high=narrow_high,
            **{name: getattr(items, name) for name in SIZES},
            metric=metric, method=self.method, notes=(*notes, *more_notes),
        )  # fmt: skip

    def compare(self, first: str, second: str) -> Statistic:
        """Compare the correlations with two metrics."""
        items, notes = self.items, list(self._explain(first, second))
        places = [self.metrics.index(name) for name in (first, second)]
        point, two_way, within = (self.drawn[part][places] for part in (0, 1, 3))
        (z_first, z_second), differences = resampling.fisher_z(point), np.subtract(*two_way)
        if np.isfinite(point).all():
            notes += _explain_undrawn(differences, "two-way")
        units = resampling.count_scarcest(items, within)
        margin = resampling.bootstrap_margin(differences, units)
        lean = np.subtract(*resampling.measure_lean(items, self.method, self.drawn)[places])
        z_range = z_first - z_second - lean + np.array([-margin, margin])
        middle = (z_first + z_second) / 2
        low, high = np.tanh(middle + z_range / 2) - np.tanh(middle - z_range / 2)
        return Statistic(
            "Difference", value=float(point[0] - point[1]), low=float(low), high=float(high),
            z_value=float(z_first - z_second), z_low=float(z_range[0]), z_high=float(z_range[1]),
            first_value=float(point[0]), second_value=float(point[1]), n_items=items.n_items,
            **{name: getattr(items, name) for name in SIZES}, draws=int(np.isfinite(differences).sum()),
            first=first, second=second, method=self.method, notes=tuple(notes),
        )  # fmt: skip

    def _explain(self, *metrics: str) -> Iterator[str]:
        """Say what was left out, which interval the size does not allow, and why a correlation is not defined."""
        items = self.items
        yield from items.notes
        if items.n_missing:
            yield f"{items.n_missing} of {items.ratings.size} participant x stimulus cells hold no rating."
        if items.n_participants < SMALLEST:
            yield "One participant only: no interval, the spread between people is unknown."
        if items.n_recordings < SMALLEST:
            yield "One recording only: no two-way interval, the spread between recordings is unknown."
        elif items.n_sources < SMALLEST:
            yield "All recordings come from one source: no two-way interval, the spread between sources is unknown."
        elif items.n_sources < items.n_recordings:
            yield f"Two-way intervals draw the {items.n_sources} sources of the {items.n_recordings} recordings."
        for metric in metrics:
            yield from self._explain_metric(metric)

    def _explain_metric(self, metric: str) -> Iterator[str]:
        """Say why the correlation with a metric is not defined, or which recordings it does not rest on, or how."""
        items, row = self.items, self.metrics.index(metric)
        point, within = self.drawn.point[row], self.drawn.of_recordings[row]
        n, defined = len(within), int(np.isfinite(within).sum())
        perfect = int((np.abs(within) >= PERFECT).sum())
        where = f"where it takes three rated stimuli that differ in mean rating and in '{metric}'"
        why = "the mean rating is the same for every stimulus"
        if items.n_items < resampling.FEWEST_ITEMS:
            why = f"it needs {resampling.FEWEST_ITEMS} test stimuli, got {items.n_items}"
        elif np.ptp(items.metrics[row]) == 0:
            why = f"'{metric}' is the same for every stimulus"
        said = {
            f"No correlation: {why}.": not n and np.isnan(point),
            f"No correlation within any of {n} recordings, {where}.": n > 0 and not defined,
            f"{n - defined} of {n} recordings are left out {where}.": 0 < defined < n,
            "One recording only has a correlation within: no two-way interval.": 0 < defined < SMALLEST <= n,
            f"In {perfect} of {n} recordings the correlation with '{metric}' is perfect: Fisher's z is held.":
                0 < perfect < n,
            f"No interval: the correlation with '{metric}' is perfect, and Fisher's z of that infinite.":
                abs(point) >= PERFECT,
        }  # fmt: skip
        yield from (note for note, holds in said.items() if holds)


def correlate_items(
    items: Items, metrics: tuple[str, ...], *methods: str, draws: int, rng: Rng
) -> list[Correlated]:
    """Correlate with all metrics of the items, by one method or several, in the same draws."""
    names = [check_name(method, resampling.METHODS, "method") for method in methods]
    check_draws(draws)
    found = resampling.draw_methods(items, names, draws=draws, rng=as_rng(rng))
    return [Correlated(items, metrics, method, drawn) for method, drawn in found.items()]


def _explain_undrawn(drawn: Values, kind: str) -> Iterator[str]:
    """Say how many draws gave no result, or that all gave the same."""
    undefined = int(np.isnan(drawn).sum())
    if undefined:
        many = undefined > resampling.MOST_UNDEFINED * drawn.size
        yield (
            f"{undefined} of {drawn.size} {kind} draws gave no correlation (fewer than three stimuli, a constant, or "
            f"all points on a line) and are left out{': too many for an interval' if many else ''}."
        )
    elif np.ptp(drawn) <= resampling.STILL:
        yield f"All {drawn.size} {kind} draws gave the same: no interval without spread."


def make_panel(
    part: DataFrame, metrics: tuple[str, ...],
    *, draws: int, rng: np.random.Generator, info: Mapping[str, MetricInfo] = MappingProxyType({}),
) -> Statistic:  # fmt: skip
    """Correlate the ratings of one scale and one level with every metric, by every method.

    Gives ``scale level``; ``associations`` and ``differences``, a Statistic each; and ``stimuli``, their mean ratings.
    """
    # The same draws for every metric and method: a further metric changes nothing, and metrics that say the same get
    # the same intervals.
    seed, items = int(rng.integers(2**63)), make_items(part, metrics)
    of = correlate_items(items, metrics, *resampling.METHODS, draws=draws, rng=seed)
    worse = [name in info and info[name].higher == "worse" for name in metrics]
    compared = of
    if any(worse):
        turned = replace(items, metrics=items.metrics * np.where(worse, -1.0, 1.0)[:, None])
        compared = correlate_items(turned, metrics, *resampling.METHODS, draws=draws, rng=seed)
    of_stimuli = part.drop_duplicates("stimulus_id").set_index("stimulus_id")[list(metrics)]
    pairs = list(combinations(metrics, 2))
    return Statistic(
        "Panel", scale=str(part["scale"].iloc[0]), level=str(part["level"].iloc[0]),
        associations=tuple(one.associate(metric) for metric in metrics for one in of),
        differences=tuple(one.compare(*pair) for pair in pairs for one in compared),
        stimuli=stimulus_means(part).join(of_stimuli, on="stimulus_id"),
    )  # fmt: skip
