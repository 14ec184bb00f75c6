"""The cluster bootstrap over participants and recordings, and the weighted correlations it draws.

Drawing participants with replacement is the same as weighting each by how often they were drawn; the item
means of every draw are then one matrix product. Recordings are drawn likewise, all their stimuli together,
because stimuli of one recording resemble each other.
"""

import zlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from feel321.analysis.arrays import FLAT, PERFECT, UPPER, Values, check_draws
from feel321.analysis.table.items import Items

BLOCK = 4_000_000  # Numbers that an array of draws may hold: 32 MB
STILL = 1e-12  # Spread of draws up to which they are all the same but for rounding error
FEWEST_ITEMS = 3  # Two points always lie on a line
TIED = 40  # Binary digits of a mean that count for its rank: what is below 1e-12 is rounding
MOST_UNDEFINED = 0.1  # Share of draws that may be undefined; with more, the rest is no fair sample


@dataclass(frozen=True, slots=True)
class Choices:
    """Choices that were made before the ratings were seen.

    draws: bootstrap draws per interval and random pairings per permutation test. margin: difference in points that
    does not matter; None: equivalence is not tested.
    """

    draws: int = 2000
    margin: float | None = None
    seed: int = 0

    def __post_init__(self) -> None:
        """Refuse what cannot be."""
        check_draws(self.draws)
        if self.margin is not None and not 0 < self.margin < np.inf:
            got = f"got {self.margin}"
            raise ValueError(f"margin must be above 0, in points of the scale, or None; {got}")

    def make_rng(self, *names: str) -> np.random.Generator:
        """Make the generator of one result, its own: another metric or section does not change its interval."""
        # Points within names are escaped: no two lists of names give the same path.
        path = ".".join(one.replace("%", "%25").replace(".", "%2E") for one in names)
        return np.random.default_rng([self.seed, zlib.crc32(path.encode())])


def weighted_kendall(x: Values, y: Values, *, weights: Values) -> Values:
    """Kendall's tau-b along the last axis, each item counting as often as its weight says; NaN for constants.

    All arrays: (..., n_items). Over all pairs of the sample in which each item occurs as often as its weight says, with
    C pairs in the same order by x and by y, D in opposite order, and N_x, N_y pairs that differ in x, in y:
    (C - D) / sqrt(N_x N_y). An item and its own copies are tied in both (Kendall 1945, doi 10.1093/biomet/33.3.239).
    """
    step = max(1, BLOCK // (16 * max(1, y[0].size * y.shape[-1]))) if y.ndim > 1 else len(y)
    if len(y) > step:  # y and weights hold more draws than memory has pairs for
        axis = weights.ndim - y.ndim
        parts = [range(at, min(at + step, len(y))) for at in range(0, len(y), step)]
        found = [weighted_kendall(x, y[part], weights=weights.take(part, axis)) for part in parts]
        return np.concatenate(found, axis=axis)
    above = [(one[..., :, None] > one[..., None, :]).astype(np.float32) for one in (x, y)]
    # Each pair is counted both ways round.
    order_x, order_y = (one - one.swapaxes(-1, -2) for one in above)
    column = weights[..., None].astype(np.float32)

    def count(pairs: NDArray[np.float32]) -> Values:
        found: Values = (weights * (pairs @ column)[..., 0]).sum(axis=-1)
        return found

    differ_x, differ_y, surplus = map(count, (order_x**2, order_y**2, order_x * order_y))
    with np.errstate(invalid="ignore", divide="ignore"):
        tau = surplus / np.sqrt(differ_x) / np.sqrt(differ_y)
    return np.where((differ_x > 0) & (differ_y > 0), np.clip(tau, -1, 1), np.nan)


def weighted_pearson(x: Values, y: Values, *, weights: Values) -> Values:
    """Pearson's correlation along the last axis, each item counting as often as its weight says; NaN for constants.

    All arrays: (..., n_items).
    """
    # Divided by a power of two, which is exact, so that no square overflows.
    x, y = (np.ldexp(one, -np.frexp(np.abs(one).max(axis=-1, keepdims=True))[1]) for one in (x, y))
    total = weights.sum(axis=-1)

    def add(one: Values, other: Values) -> Values:
        return np.asarray(np.einsum("...i,...i->...", one, other))

    with np.errstate(invalid="ignore", divide="ignore"):
        mean_x, mean_y = (add(weights, one) / total for one in (x, y))
        from_mean_x, from_mean_y = x - mean_x[..., None], y - mean_y[..., None]
        weighted_x, weighted_y = weights * from_mean_x, weights * from_mean_y
        xx, yy = add(weighted_x, from_mean_x), add(weighted_y, from_mean_y)
        # By the law of parallel axes, what the squares of the values themselves add up to.
        flat_x = xx <= FLAT * (xx + total * mean_x**2)
        flat_y = yy <= FLAT * (yy + total * mean_y**2)
        r = add(weighted_x, from_mean_y) / (np.sqrt(xx) * np.sqrt(yy))
    return np.where(flat_x | flat_y, np.nan, np.clip(r, -1, 1))


def weighted_spearman(x: Values, y: Values, *, weights: Values) -> Values:
    """Spearman's rank correlation, as `weighted_pearson`."""
    return weighted_pearson(weighted_ranks(x, weights), weighted_ranks(y, weights), weights=weights)


def weighted_ranks(values: Values, weights: Values) -> Values:
    """Mid-ranks, from 1, along the last axis of a sample in which each item occurs as often as its weight says."""
    if values.ndim == 1:  # a metric, the same in all draws: who is below whom is known once
        below = (values < values[:, None]) + 0.5 * (values == values[:, None])
        return np.asarray(weights @ below.T + 0.5)
    order = np.argsort(values, axis=-1, kind="stable")
    ordered = np.take_along_axis(values, order, axis=-1)
    shape = np.broadcast_shapes(values.shape, weights.shape)
    order, ordered = np.broadcast_to(order, shape), np.broadcast_to(ordered, shape)
    weights = np.broadcast_to(weights, shape)
    upto = np.cumsum(np.take_along_axis(weights, order, axis=-1), axis=-1)
    before = np.concatenate([np.zeros_like(upto[..., :1]), upto[..., :-1]], axis=-1)
    rises = np.diff(ordered, axis=-1) > 0
    ends = np.ones((*rises.shape[:-1], 1), dtype=bool)
    # Both counts only grow, so a running maximum carries a tie's start forward and a running minimum its end back.
    start = np.where(np.concatenate([ends, rises], axis=-1), before, 0)
    start = np.maximum.accumulate(start, axis=-1)
    stop = np.where(np.concatenate([rises, ends], axis=-1), upto, np.inf)
    stop = np.minimum.accumulate(stop[..., ::-1], axis=-1)[..., ::-1]
    ranks = np.empty_like(upto)
    np.put_along_axis(ranks, order, (start + stop + 1) / 2, axis=-1)
    return ranks


class CorrelationMethod(NamedTuple):
    """How weighted items, x and y, are correlated along the last axis."""

    correlation: Callable[..., Values]
    ranked: bool
    within: bool


# The one list of correlations: name -> how; ``within`` is Pearson's
METHODS: Mapping[str, CorrelationMethod] = MappingProxyType({
    "pearson": CorrelationMethod(weighted_pearson, ranked=False, within=False),
    "spearman": CorrelationMethod(weighted_spearman, ranked=True, within=False),
    "kendall": CorrelationMethod(weighted_kendall, ranked=True, within=False),
    "within": CorrelationMethod(weighted_pearson, ranked=False, within=True),
    "within_spearman": CorrelationMethod(weighted_spearman, ranked=True, within=True),
    "within_kendall": CorrelationMethod(weighted_kendall, ranked=True, within=True),
})


def draw_counts(n_units: int, draws: int, *, rng: np.random.Generator) -> Values:
    """Count how often each unit occurs in each sample of as many units, drawn with replacement: (draws, n_units)."""
    return rng.multinomial(n_units, np.full(n_units, 1 / n_units), size=draws).astype(np.float64)


class Averages(NamedTuple):
    """Mean ratings of every item, and whether there are any: (draws, n_items)."""

    means: Values
    rated: NDArray[np.bool_]

    @classmethod
    def of(cls, items: Items, participants: Values) -> "Averages":
        """Average each item's ratings over the participants drawn, (draws, n_participants)."""
        seen = np.isfinite(items.ratings)
        votes = participants @ seen.astype(np.float64)
        sums = participants @ np.where(seen, items.ratings, 0.0)
        return cls(np.divide(sums, votes, out=np.zeros_like(sums), where=votes > 0), votes > 0)

    def order(self, how: CorrelationMethod) -> Values:
        """Give the means; for ranks as whole numbers, so that those that differ by rounding error only are tied."""
        if not how.ranked:
            return self.means
        exponent = np.frexp(np.abs(self.means).max(axis=-1, keepdims=True))[1]
        whole: Values = np.rint(np.ldexp(self.means, TIED - exponent))
        return whole

    def correlate(
        self, items: Items, how: CorrelationMethod, *, counts: Sequence[Values]
    ) -> list[Values]:
        """Correlate with every metric, (n_metrics, draws); counts: ways of counting recordings, (draws, n).

        NaN where a draw leaves the metric or the means constant, or fewer than three different items.
        """
        if how.within:
            parts = [self.correlate_recordings(items, metric, how) for metric in items.metrics]
            return [
                np.array([average_recordings(*part, counts=one) for part in parts])
                for one in counts
            ]
        weights = np.stack([one[:, items.recordings] * self.rated for one in counts])
        means, few = self.order(how), (weights > 0).sum(axis=-1) < FEWEST_ITEMS
        found = [how.correlation(metric, means, weights=weights) for metric in items.metrics]
        return list(np.where(few, np.nan, np.array(found)).swapaxes(0, 1))

    def correlate_recordings(
        self, items: Items, metric: Values, how: CorrelationMethod
    ) -> tuple[Values, Values]:
        """Correlate within each recording; also count the items that did: both of shape (draws, n_recordings)."""
        means, n_items = self.order(how), np.bincount(items.recordings)
        found = np.empty((len(means), items.n_recordings))
        sizes, order = np.empty_like(found), np.argsort(items.recordings, kind="stable")
        # Recordings of as many items are one array.
        for n_each in np.unique(n_items):
            places = np.flatnonzero(n_items == n_each)
            own = order[np.isin(items.recordings[order], places)].reshape(-1, n_each)
            weights = self.rated[:, own].astype(np.float64)
            sizes[:, places] = weights.sum(axis=-1)
            found[:, places] = how.correlation(metric[own], means[:, own], weights=weights)
        return np.where(sizes < FEWEST_ITEMS, np.nan, found), sizes


def average_recordings(correlations: Values, sizes: Values, *, counts: Values) -> Values:
    """Average the correlations of recordings, all (draws, n_recordings), over Fisher's z; NaN does not count.

    A perfect correlation has no z, yet among few items one by ranks is common and must neither be left out nor
    outweigh all others. One of n items counts as 1 - 6 / (n (n² - 1)), half way to the next lower correlation of ranks.
    """
    defined = np.isfinite(correlations)
    weights = counts * defined
    total = weights.sum(axis=-1)
    signs = np.where(np.abs(correlations) < PERFECT, 0.0, np.sign(correlations))
    with np.errstate(invalid="ignore", divide="ignore"):
        held = np.where(signs == 0, correlations, signs * (1 - 6 / (sizes * (sizes**2 - 1))))
        z = (weights * np.where(defined, np.arctanh(held), 0.0)).sum(axis=-1) / total
        mean_sign = (weights * np.where(defined, signs, 0.0)).sum(axis=-1) / total
    return np.where(np.abs(mean_sign) == 1, mean_sign, np.tanh(z))


def fisher_z(correlation: Values) -> Values:
    """Fisher's transform; NaN for a perfect correlation, which has none."""
    z: Values = np.arctanh(np.where(np.abs(correlation) < PERFECT, correlation, np.nan))
    return z


def bootstrap_margin(drawn: Values, n_units: int) -> float:
    """Half width of the 95 % interval of a statistic, from its bootstrap draws, (draws,).

    NaN if there is one unit only, more than a tenth of the draws are undefined (NaN), or all draws are the same, as
    ranks may be: that is no sign of certainty. Resampling U units understates a variance by (U - 1) / U
    and knows it on U - 1 degrees of freedom only; with the eight or so recordings of a study both matter.
    """
    from scipy.stats import t

    defined = drawn[np.isfinite(drawn)]
    too_many = len(drawn) - len(defined) > MOST_UNDEFINED * len(drawn)
    if too_many or min(n_units, len(defined)) < 2 or np.ptp(defined) <= STILL:  # noqa: PLR2004 - a spread needs two
        return float("nan")
    quantile = float(t.ppf(UPPER, n_units - 1))
    return quantile * float(np.sqrt(n_units / (n_units - 1)) * defined.std(ddof=1))


class Draws(NamedTuple):
    """The correlation with each metric, and Fisher's z of its draws.

    point: (n_metrics,); two_way, participants: (n_metrics, draws); of_recordings: (n_metrics, n_recordings).
    """

    point: Values
    two_way: Values
    participants: Values
    of_recordings: Values


def draw_methods(
    items: Items, methods: Iterable[str], *, draws: int, rng: np.random.Generator
) -> dict[str, Draws]:
    """Draw participants and recordings with replacement, and correlate by several methods in the same draws."""
    whole = Averages.of(items, np.ones((1, items.n_participants)))
    every, result = np.ones((1, items.n_recordings)), dict[str, Draws]()
    blocks: dict[str, list[Values]] = {method: [] for method in methods}
    block = max(1, BLOCK // max(items.n_participants, items.n_items))
    for start in range(0, draws, block):
        size = min(block, draws - start)
        # Participants are drawn first and recordings second, so that both intervals share the same participants.
        averages = Averages.of(items, draw_counts(items.n_participants, size, rng=rng))
        # A source comes with all its recordings, or not at all.
        scenes = draw_counts(items.n_sources, size, rng=rng)[:, items.of_source]
        for method, found in blocks.items():
            counts = (scenes, np.ones_like(scenes))
            drawn = averages.correlate(items, METHODS[method], counts=counts)
            found.append(fisher_z(np.stack(drawn)))
    for method, found in blocks.items():
        how, each = METHODS[method], np.empty((len(items.metrics), 0))
        (point,) = whole.correlate(items, how, counts=(every,))
        if how.within:
            each = np.concatenate([
                whole.correlate_recordings(items, row, how)[0] for row in items.metrics
            ])
        two_way, people = np.concatenate(found, axis=-1)
        result[method] = Draws(point[:, 0], two_way, people, each)
    return result


def measure_lean(items: Items, method: str, drawn: Draws) -> Values:
    """Measure how far mean Fisher's z over recordings leans from zero, as each has few stimuli: (n_metrics,)."""
    if METHODS[method].ranked or not METHODS[method].within:
        return np.zeros(len(items.metrics))
    sizes = np.bincount(items.recordings)
    leans = drawn.of_recordings / (2 * np.maximum(sizes - 1, 1))
    counts = np.maximum(np.isfinite(leans).sum(axis=1), 1)
    mean: Values = np.nan_to_num(leans, nan=0.0, posinf=0.0, neginf=0.0).sum(axis=1) / counts
    return mean


def count_scarcest(items: Items, within: Values) -> int:
    """Count the units that limit a two-way interval: whichever there are fewer of is known less well.

    within: (n_metrics, n_recordings), none where the correlation is not within recordings.
    """
    speaking = [len(np.unique(items.of_source[np.isfinite(row)])) for row in within if row.size]
    return min(items.n_participants, *(speaking or [items.n_sources]))
