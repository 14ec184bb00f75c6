"""Candidates for a refined metric, their folds, and the nested cross-validation that chooses among them.

Every least-squares fit and every squared error is made of sums over items. These are taken once per fold of
recordings; leaving a fold out is then a subtraction, and all draws are worked on at once.

Candidates are few, of few parameters, in order of simplicity. Every stimulus is predicted by what other people said of
other recordings, and a candidate is chosen by recordings that none was fitted to.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from feel321.analysis.arrays import FLAT, Values

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from feel321.analysis.table.items import Items

EXPONENTS = (0.5, 2.0)
"""Of metrics from 0 to 1, values below 0 counting as 0: differences near 0, or near 1, are made to count for more."""

MOST_COLUMNS = 4
"""Terms of the largest sum: with eight or so recordings, more weights than that are noise."""

EQUAL = "equal weights"
CONSTANT = 1e-10

GROUPS = 4
"""Groups that people are split into, each left out in turn."""

FOLDS = 10
"""Sources of recordings are left out one by one; more than this, in as many groups: the time grows with its square."""

RIDGE = 1e-9
"""Share of the mean square that keeps fits defined where metrics are the same: they then share the weight."""


@dataclass(frozen=True, slots=True)
class Refinement:
    """A way to make one metric of several."""

    name: str
    columns: tuple[int, ...]
    parameters: int

    @property
    def used(self) -> list[int]:
        """Places of its terms among the moments: the intercept's 1 first, the rating last."""
        return [0, *(column + 1 for column in self.columns), -1]


@dataclass(frozen=True, slots=True, eq=False)
class Basis:
    """What candidates are sums of.

    columns: (n_items, n_columns); scales: (n_columns,), NaN of the sum of equal weights, which has no unit.
    """

    names: tuple[str, ...]
    columns: Values
    scales: Values
    candidates: tuple[Refinement, ...]
    notes: tuple[str, ...]


class Split(NamedTuple):
    """Groups that are left out together; people: (n_participants,), items: (n_items,)."""

    people: NDArray[np.intp]
    items: NDArray[np.intp]


class Means(NamedTuple):
    """Mean ratings of each item per draw and group of people; all of shape (draws, groups, n_items)."""

    others: Values
    own: Values
    known: NDArray[np.bool_]
    share: Values


class SearchData(NamedTuple):
    """What stays the same in every draw."""

    items: Items
    basis: Basis
    split: Split
    within: bool


class Searched(NamedTuple):
    """What came out, per draw.

    chosen: (draws, groups, folds); fits: (n_candidates, draws, groups, folds, m); correlations,
    errors: (1 + n_candidates, draws); as_it_is: (n_candidates, draws), NaN for the others.
    """

    chosen: NDArray[np.intp]
    fits: Values
    correlations: Values
    errors: Values
    as_it_is: Values


def make_basis(
    names: Sequence[str], values: Values, *, n_plain: int, groups: NDArray[np.intp] | None
) -> Basis:
    """List the candidates that metrics of these values, (n_features, n_items), allow; groups: (n_items,)."""
    columns = dict(zip(names, values, strict=True))
    for name in names[:n_plain]:
        for exponent in EXPONENTS:
            columns[f"{name} ^ {exponent:g}"] = np.clip(columns[name], 0, None) ** exponent
    groups = np.zeros(values.shape[1], dtype=np.intp) if groups is None else groups
    counts = np.bincount(groups)
    centred = {
        name: column - (np.bincount(groups, column) / counts)[groups]
        for name, column in columns.items()
    }
    kept = {
        name: column
        for name, column in centred.items()
        if np.ptp(column) > CONSTANT * np.abs(columns[name]).max()
    }
    notes = tuple(f"'{name}' does not vary and is left out." for name in names if name not in kept)
    plain = [name for name in names[:n_plain] if name in kept]
    standard = {name: column / column.std() for name, column in kept.items()}
    if len(plain) > 1:
        standard[EQUAL] = np.sum([standard[name] for name in plain], axis=0)
    varying = [name for name in names if name in kept]
    candidates = tuple(_list_candidates(tuple(standard), plain, varying))
    scales = np.array([kept[name].std() if name in kept else np.nan for name in standard])
    stacked = np.array(list(standard.values())).T if standard else np.empty((values.shape[1], 0))
    return Basis(tuple(standard), stacked, scales, candidates, notes)


def _list_candidates(
    columns: tuple[str, ...], plain: list[str], features: list[str]
) -> Iterator[Refinement]:
    place = {name: number for number, name in enumerate(columns)}
    for name in plain:
        yield Refinement(name, (place[name],), 1)
    if EQUAL in place:
        yield Refinement(EQUAL, (place[EQUAL],), 1)
    for name in plain:
        powers = [f"{name} ^ {exponent:g}" for exponent in EXPONENTS]
        yield from (Refinement(power, (place[power],), 2) for power in powers if power in place)
    # Of sums of three and more, the one of everything is tried only: all of them would be a search.
    whole = [tuple(features)] if 2 < len(features) <= MOST_COLUMNS else []  # noqa: PLR2004 - pairs come before
    for terms in (*combinations(features, 2), *whole):
        if set(terms) & set(plain):
            yield Refinement(" + ".join(terms), tuple(place[name] for name in terms), len(terms))


def make_split(items: Items, rng: np.random.Generator) -> Split:
    """Split people and recordings at random."""
    people = rng.permutation(items.n_participants) % min(items.n_participants, GROUPS)
    folds = rng.permutation(items.n_sources) % min(items.n_sources, FOLDS)
    return Split(people, folds[items.of_source[items.recordings]])


def average_groups(items: Items, split: Split, counts: Values, *, within: bool) -> Means:
    """Average the ratings of each group, and of everyone outside it; counts: (draws, n_participants)."""
    seen = np.isfinite(items.ratings)
    ratings = np.where(seen, items.ratings - items.ratings[seen].mean(), 0.0)
    member = split.people == np.arange(split.people.max() + 1)[:, None]
    weights = counts[:, None] * member
    votes, sums = weights @ seen.astype(np.float64), weights @ ratings
    all_votes, all_sums = votes.sum(axis=1, keepdims=True), sums.sum(axis=1, keepdims=True)
    own, others = _divide(sums, votes), _divide(all_sums - sums, all_votes - votes)
    known = all_votes > votes
    if within:
        own = _center(own, votes > 0, items.recordings)
        others = _center(others, known, items.recordings)
    return Means(others, own, known, _divide(votes, np.broadcast_to(all_votes, votes.shape)))


def _divide(sums: Values, votes: Values) -> Values:
    return np.divide(sums, votes, out=np.zeros_like(sums), where=votes > 0)


def _center(means: Values, known: NDArray[np.bool_], recordings: NDArray[np.intp]) -> Values:
    belongs = (recordings[:, None] == np.arange(recordings.max() + 1)).astype(np.float64)
    centre = _divide((means * known) @ belongs, known @ belongs)
    return np.where(known, means - centre[..., recordings], 0.0)


def sum_moments(
    basis: Values, ratings: Values, weights: Values, *, folds: NDArray[np.intp]
) -> Values:
    """Sum the products of 1, the columns and the rating over the items of each fold.

    basis: (n_items, n_columns); ratings, weights: (..., n_items); returns (..., n_folds, m, m), m = n_columns + 2.
    """
    known = np.column_stack([np.ones(len(basis)), basis])
    size, n_folds = known.shape[1], int(folds.max()) + 1
    moments = np.empty((*ratings.shape[:-1], n_folds, size + 1, size + 1))
    for fold in range(n_folds):
        own = known[folds == fold]
        weight, rating = weights[..., folds == fold], ratings[..., folds == fold]
        squares = (own[:, :, None] * own[:, None, :]).reshape(len(own), -1)
        moments[..., fold, :-1, :-1] = (weight @ squares).reshape(*weight.shape[:-1], size, size)
        moments[..., fold, -1, :-1] = moments[..., fold, :-1, -1] = (weight * rating) @ own
        moments[..., fold, -1, -1] = (weight * rating**2).sum(axis=-1)
    return moments


def fit_candidate(moments: Values, candidate: Refinement) -> Values:
    """Fit intercept and weights, (..., m), by least squares to moments, (..., m, m)."""
    coefficients = np.zeros(moments.shape[:-1])
    coefficients[..., candidate.used] = _fit(_take(moments, candidate))
    return coefficients


def _take(moments: Values, candidate: Refinement) -> Values:
    return np.ascontiguousarray(moments[..., candidate.used, :][..., candidate.used])


def _fit(moments: Values) -> Values:
    total, sums = moments[..., :1, 0], moments[..., 0, 1:]
    means = np.divide(sums, total, out=np.zeros_like(sums), where=total > 0)
    centred = moments[..., 1:, 1:] - means[..., :, None] * sums[..., None, :]
    matrix, product = centred[..., :-1, :-1], centred[..., :-1, -1:]
    size = np.trace(matrix, axis1=-2, axis2=-1)[..., None, None] / matrix.shape[-1]
    steady = matrix + RIDGE * np.eye(matrix.shape[-1]) * np.where(size > 0, size, 1.0)
    # Most candidates have one column, and a division takes a twentieth of a solution's time.
    weights = (product / steady if matrix.shape[-1] == 1 else np.linalg.solve(steady, product))[
        ..., 0
    ]
    level = means[..., -1:] - (means[..., :-1] * weights).sum(axis=-1, keepdims=True)
    return np.concatenate([level, weights, np.full_like(level, -1.0)], axis=-1)


def leave_out(moments: Values) -> Values:
    """Sum the moments, (..., n_folds, m, m), of all folds but one, for each."""
    others: Values = moments.sum(axis=-3, keepdims=True) - moments
    return others


def choose(
    moments: Values, candidates: Sequence[Refinement], *, nested: bool = False
) -> NDArray[np.intp]:
    """Choose the simplest candidate whose error is within one standard error of the least.

    moments: (..., n_folds, m, m).

    Notes
    -----
    Each candidate is fitted without a fold and its squared error on the fold taken. The standard error is that of
    the difference from the least over folds: what makes a recording hard for all candidates cancels out (the
    rule of Breiman et al. 1984, for paired errors).
    """
    errors = np.array([_cross_validate(_take(moments, one), nested=nested) for one in candidates])
    sizes = _nest(moments[..., :1, :1])[..., 0, 0] if nested else moments[..., 0, 0]
    least = errors.sum(axis=-1).argmin(axis=0)
    excess = errors - np.take_along_axis(errors, least[None, ..., None], axis=0)
    simple = np.array([one.parameters for one in candidates]).reshape(-1, *[1] * least.ndim)
    close = excess.sum(axis=-1) <= _standard_error(excess, sizes)
    near = close & (simple == np.where(close, simple, np.inf).min(axis=0))
    chosen: NDArray[np.intp] = np.where(near, errors.sum(axis=-1), np.inf).argmin(axis=0)
    return chosen


def _nest(moments: Values) -> Values:
    """Repeat the folds once per fold, that one emptied."""
    n_folds = moments.shape[-3]
    nested: Values = moments[..., None, :, :, :] * (1 - np.eye(n_folds))[:, :, None, None]
    return nested


def _cross_validate(moments: Values, *, nested: bool) -> Values:
    """Sum the squared errors of every fold, fitted to all others."""
    folds = _nest(moments) if nested else moments
    coefficients = _fit(leave_out(folds))
    errors: Values = np.einsum("...i,...ij,...j->...", coefficients, folds, coefficients)
    return errors


def _standard_error(excess: Values, sizes: Values) -> Values:
    """Give the standard error of the sum of an excess over folds of unequal size."""
    n, total = (sizes > 0).sum(axis=-1), sizes.sum(axis=-1)
    mean = np.divide(excess.sum(axis=-1), total, out=np.zeros(excess.shape[:-1]), where=total > 0)
    left = excess - sizes * mean[..., None]
    error: Values = np.sqrt((left**2).sum(axis=-1) * n / np.maximum(n - 1, 1))
    return error


def score_draws(data: SearchData, *, people: Values, recordings: Values) -> Searched:
    """Choose, fit and predict anew in every draw; people, recordings: (draws, n_participants or n_recordings)."""
    items, basis, folds = data.items, data.basis, data.split.items
    means = average_groups(items, data.split, people, within=data.within)
    counts = recordings[:, items.recordings]
    moments = sum_moments(basis.columns, means.others, counts[:, None] * means.known, folds=folds)
    chosen = choose(moments, basis.candidates, nested=True)
    fits = np.array([fit_candidate(leave_out(moments), one) for one in basis.candidates])
    picked = np.take_along_axis(fits, chosen[None, ..., None], axis=0)
    scores = [_score(data, fit, means=means, counts=counts) for fit in (*picked, *fits)]
    correlations, errors = np.array(scores).transpose(1, 0, 2)
    plain = np.full((len(basis.candidates), len(people)), np.nan)
    for place, one in enumerate(basis.candidates):
        if len(one.columns) == 1:
            column = np.broadcast_to(basis.columns[:, one.columns[0]], means.own.shape)
            plain[place] = _correlate(means, column, counts)
    return Searched(chosen, fits, correlations, errors, plain)


def join_draws(parts: Sequence[Searched]) -> Searched:
    """Join what came out of several blocks of draws."""
    first, *others = zip(*parts, strict=True)
    return Searched(np.concatenate(first), *(np.concatenate(one, axis=1) for one in others))


def _score(
    data: SearchData, fits: Values, *, means: Means, counts: Values
) -> tuple[Values, Values]:
    """Correlate and compare what is predicted of each item without its fold and the group."""
    values = data.basis.columns
    weights, folds = fits[..., 1:-1], data.split.items
    combined = np.empty((*weights.shape[:-2], len(values)))
    for fold in range(weights.shape[-2]):
        combined[..., folds == fold] = weights[..., fold, :] @ values[folds == fold].T
    spread = np.sqrt(((weights @ (values.T @ values / len(values))) * weights).sum(axis=-1))
    spread, level = spread[..., folds], fits[..., 0][..., folds]
    # A metric's unit is its own affair: without this, folds would be mixed in different units.
    metric = np.divide(combined, spread, out=np.zeros_like(combined), where=spread > 0)
    error = (means.share * (means.own - combined - level)).sum(axis=1)
    count = counts * (means.share.sum(axis=1) > 0)
    mean_square = (count * error**2).sum(axis=-1) / count.sum(axis=-1)
    return _correlate(means, metric, counts), np.sqrt(mean_square)


def _correlate(means: Means, metric: Values, counts: Values) -> Values:
    """Correlate each group's ratings with the metric that was made without them."""
    weights, share = counts * (means.share.sum(axis=1) > 0), means.share
    total = weights.sum(axis=-1, keepdims=True)
    rated, valued = ((share * part).sum(axis=1) for part in (means.own, metric))
    middle_rated = (weights * rated).sum(axis=-1, keepdims=True) / total
    middle_valued = (weights * valued).sum(axis=-1, keepdims=True) / total
    centred = metric - middle_valued[:, None]
    products = share * (means.own - middle_rated[:, None]) * centred
    covariance = (weights * products.sum(axis=1)).sum(axis=-1)
    squares_rated = (weights * (rated - middle_rated) ** 2).sum(axis=-1)
    # Of each group's own metric: where groups contradict each other, their mean would be next to nothing.
    squares_valued = (weights * (share * centred**2).sum(axis=1)).sum(axis=-1)
    size_rated = (weights * rated**2).sum(axis=-1)
    size_valued = (weights * (share * metric**2).sum(axis=1)).sum(axis=-1)
    flat = (squares_rated <= FLAT * size_rated) | (squares_valued <= FLAT * size_valued)
    below = np.sqrt(np.where(flat, 1.0, squares_rated * squares_valued))
    correlation: Values = np.where(flat, np.nan, np.clip(covariance / below, -1, 1))
    return correlation
