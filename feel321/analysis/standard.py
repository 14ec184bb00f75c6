"""ITU-T P.1401: how well a metric predicts mean votes, through a monotone mapping, and whether another does better.

Conventions: votes have shape (items, raters), NaN where a rater did not vote; an item is a stimulus, its mean
vote the MOS; a metric has one value per item. The standard takes items for independent: stimuli of one
recording are not, so its intervals and tests are for comparison with the literature, and conclusions come
from `correlate`.

Monotone means on the whole interval, not on a grid of it: a 0..1 metric tested in steps of 0.1 hides a turn
between two steps.
"""

from collections.abc import Iterator
from typing import NamedTuple, get_args

import numpy as np
from numpy.polynomial import Polynomial
from numpy.typing import ArrayLike, NDArray

from feel321.analysis.arrays import (
    FLAT,
    PERFECT,
    Values,
    check_labels,
    find_p,
    fisher_interval,
    read_array,
    read_groups,
)
from feel321.analysis.table.items import Table, is_tidy, make_items
from feel321.doors import check_name
from feel321.records import Statistic
from feel321.types import Direction

UNIT = (0.0, 1.0)

PARAMETERS = {0: 1, 1: 2, 3: 4}
"""Order of the mapping -> degrees of freedom that the standard takes off the number of items."""

NORMAL_QUANTILE = 1.96
"""The standard's rounded quantile; also for an item's interval from 30 votes on."""

MANY_VOTES = 30
FEW_ITEMS = 30
"""With fewer items a cubic bends to noise: the first order leads."""


def fit_monotone_cubic(
    x: Values, y: Values, *, span: tuple[float, float], sign: int = 0
) -> Polynomial:
    """Least-squares cubic that rises, or falls, over all of an interval; by sign 1, -1, or 0 for whichever fits better.

    Notes
    -----
    With u = (x - low) / (high - low), the cubics that rise on the interval are those whose slope is q(u) =
    (α + β u)² + γ² u (1 - u), Lukács' form of a quadratic that is nowhere negative on [0, 1] (Szegő 1975, theorem
    1.21.1). They form a convex cone, so the fit is unique. Where the unconstrained cubic is not monotone, the answer
    lies on the cone's border: q(0) = 0, q(1) = 0, or q(u) = k (u - t)² touching 0 inside. The first two are least
    squares with two non-negative weights; for the third, the share of variance explained is a ratio of polynomials in
    t, whose stationary points are the roots of a quintic. All are solved exactly, without a grid and without
    an iteration that could stop early.
    """
    u = (x - span[0]) / (span[1] - span[0])
    cubic = Polynomial.fit(u, y, 3, domain=UNIT, window=UNIT)
    slope = cubic.deriv()
    turn = slope.deriv()
    inner = -turn.coef[0] / turn.coef[1] if turn.coef[1] else 0.0
    extremes = slope(np.array([*UNIT, inner if 0 < inner < 1 else 0.0]))
    rises, falls = bool((extremes >= 0).all()), bool((extremes <= 0).all())
    if not ((rises and sign >= 0) or (falls and sign <= 0)):
        # The best rising or falling cubic among those whose slope is 0 somewhere.
        rising = _list_candidates(u, y) if sign >= 0 else ()
        falling = (-cubic for cubic in _list_candidates(u, -y)) if sign <= 0 else ()
        cubic = min((*rising, *falling), key=lambda cubic: float(((y - cubic(u)) ** 2).sum()))
    return Polynomial(cubic.coef, domain=span, window=UNIT)


def _list_candidates(u: Values, y: Values) -> Iterator[Polynomial]:
    from scipy.optimize import nnls

    def centre(cubic: Polynomial) -> Polynomial:
        return cubic + float(y.mean() - cubic(u).mean())

    bow = Polynomial([0, 0, 1 / 2, -1 / 3])  # slope u (1 - u)
    # Slopes u² and (1 - u)².
    for corner in (Polynomial([0, 0, 0, 1 / 3]), Polynomial([0, 1, -1, 1 / 3])):
        columns = np.stack([bow(u), corner(u)], axis=1)
        weights, _ = nnls(columns - columns.mean(axis=0), y - y.mean())
        yield centre(weights[0] * bow + weights[1] * corner)
    for touch in _find_touching_points(u, y):
        shape = Polynomial([0, touch**2, -touch, 1 / 3])  # slope (u - touch)²
        column = shape(u) - shape(u).mean()
        yield centre(max(0.0, column @ y / (column @ column)) * shape)


def _find_touching_points(u: Values, y: Values) -> Values:
    """Where inside [0, 1] a slope k (u - t)² may best touch 0: stationary points of the variance explained."""
    powers = np.stack([u**3 / 3, -(u**2), u])
    powers -= powers.mean(axis=1, keepdims=True)
    moments = powers @ powers.T
    with_y = Polynomial(powers @ y)
    with_itself = Polynomial([np.fliplr(moments).trace(offset) for offset in range(2, -3, -1)])
    stationary = 2 * with_y.deriv() * with_itself - with_y * with_itself.deriv()
    # A root that rounding has made complex, or pushed out, is still a candidate: its fit decides.
    return np.clip(stationary.trim().roots().real, *UNIT)


class _Votes(NamedTuple):
    """Items: metric, mean vote, half its interval, the mapping's order, and its direction (0: either)."""

    x: Values
    mos: Values
    interval: Values
    order: int
    sign: int = 0


def p1401(
    votes: Table | ArrayLike,
    metric: str | ArrayLike,
    *,
    order: int = 3,
    groups: ArrayLike | None = None,
    higher: Direction | None = None,
) -> Statistic:
    """Judge a metric against votes as ITU-T P.1401 does.

    Parameters
    ----------
    votes : Table, DataFrame or array_like, shape (items, raters)
        Ratings of one scale, whose references and anchors are left out; or votes, NaN where missing, but at least two
        per item.
    metric : str or array_like, shape (items,)
        A column of the ratings; or the metric's value of each item, in the order of the votes' rows.
    order : int
        Of the mapping from metric to MOS: 3 for the monotone cubic, 1 for a straight line, 0 for none (the
        metric is already on the votes' scale).
    groups : array_like, shape (items,), optional
        What each item belongs to, usually its recording (``"recording"`` for ratings). Given, every item is predicted
        by a mapping fitted without its group; without it, the errors are those of a mapping fitted to the same
        items, and flatter the metric.
    higher : {"better", "worse"}, optional
        Which way the metric points: the mapping may only rise, or only fall. Whichever fits better if left out.

    Returns
    -------
    Statistic
        ``plcc plcc_low plcc_high``, Pearson correlation of MOS with the mapped metric and its 95 % interval by Fisher's
        z; ``srocc``, Spearman correlation of MOS with the metric itself; ``rmse rmse_low rmse_high`` after mapping, in
        votes' units, with a chi-square interval; ``rmse_star``, the same of what each error exceeds its item's
        interval by; ``outlier_ratio outlier_ratio_sd``; ``coefficients`` a + b x + c x² + d x³ of the mapping fitted to
        all items; ``order n_items``; ``rmse_n1 rmse_star_n1``, on n_items - 1 degrees of freedom, as one edition prints
        them; ``mos interval mapped``, (n_items,); ``held_out notes``.

    Notes
    -----
    Per item with n votes and standard deviation s (n - 1): MOS, and ci = q s / √n with q = t(.975, n - 1)
    below 30 votes and 1.96 from there on. The mapping is least squares and monotone over the metric's whole
    range. A metric that goes against its declared direction is mapped to a constant, and has no PLCC. Out of fold, a
    cubic is held at its end for items beyond the range that it was fitted on, where it would shoot off; a note counts
    them. With
    e = MOS - MOSp and d = 4 (cubic), 2 (line) or 1 (none, and out of fold: nothing was fitted to the item)::

        rmse  = √(Σ e² / (N - d))
        rmse* = √(Σ max(0, |e| - ci)² / (N - d))
        outlier ratio = #(|e| > ci) / N,  sd √(OR (1 - OR) / N)
        interval of PLCC = tanh(atanh r ± 1.96 / √(N - 3))

    After a least-squares mapping PLCC cannot be negative: look at SROCC for the direction, and at the
    out-of-fold PLCC for the truth. With fewer than 30 items report order 1 first.

    References
    ----------
    ITU-T Recommendation P.1401 (2020), Methods, metrics and procedures for statistical evaluation,
    qualification and comparison of objective quality prediction models.

    Examples
    --------
    >>> from feel321 import analysis
    >>> votes = [[10, 20, 15], [30, 25, 20], [50, 40, 45], [55, 60, 50], [80, 75, 70], [85, 95, 90]]
    >>> result = analysis.p1401(votes, [0.1, 0.2, 0.45, 0.5, 0.8, 0.9], order=1)
    >>> round(result.plcc, 4), round(result.srocc, 4), round(result.rmse, 3), result.outlier_ratio
    (0.9957, 1.0, 2.966, 0.0)
    >>> [round(coefficient, 2) for coefficient in result.coefficients]
    [6.48, 90.21]
    """
    from scipy.stats import chi2, rankdata

    if is_tidy(votes) and isinstance(metric, str):
        items = make_items(votes, [metric])
        votes, metric = items.ratings.T, items.metrics[0]
        groups = items.recordings if isinstance(groups, str) else groups
    check_labels(votes, metric, what="metric")
    sign = 0
    if higher is not None:
        sign = 1 if check_name(higher, get_args(Direction), "higher") == "better" else -1
    given = _read_votes(votes, metric, order)._replace(sign=sign)
    mapping, notes = _fit_mapping(given, np.ones(len(given.x), bool)), list[str]()
    mapped = np.asarray(mapping(given.x), np.float64)
    if groups is not None:
        mapped, notes = _map_out_of_fold(given, groups)
    n, mos = len(given.x), given.mos
    errors = np.abs(mos - mapped)
    errors[errors**2 <= FLAT * float((mos**2).sum())] = 0.0
    excess = np.maximum(0.0, errors - given.interval)
    freedom = n - PARAMETERS[order if groups is None else 0]

    def root_mean_square(of: Values, freedom: int) -> float:
        return float(np.sqrt((of**2).sum() / freedom))

    rmse = root_mean_square(errors, freedom)
    plcc, undefined = _correlate(mos, mapped)
    low, high = fisher_interval(plcc, n - 3, quantile=NORMAL_QUANTILE)
    rmse_low, rmse_high = (rmse * np.sqrt(freedom / chi2.ppf([0.975, 0.025], freedom))).tolist()
    ratio = float((errors > given.interval).mean())
    notes += undefined
    if abs(plcc) >= PERFECT:
        notes.append("The correlation is perfect to rounding and has no interval.")
    if order > 1 and n < FEW_ITEMS:
        notes.append(
            f"With {n} items, fewer than {FEW_ITEMS}, a cubic bends to noise: report order 1 first."
        )
    coefficients, in_x = np.zeros(max(order, 1) + 1), mapping.convert().coef
    coefficients[: len(in_x)] = in_x
    return Statistic(
        "P1401", plcc=plcc, plcc_low=low, plcc_high=high, srocc=_correlate(rankdata(mos), rankdata(given.x))[0],
        rmse=rmse, rmse_low=rmse_low, rmse_high=rmse_high, rmse_star=root_mean_square(excess, freedom),
        outlier_ratio=ratio, outlier_ratio_sd=float(np.sqrt(ratio * (1 - ratio) / n)),
        coefficients=tuple(coefficients.tolist()), order=order, n_items=n,
        rmse_n1=root_mean_square(errors, n - 1), rmse_star_n1=root_mean_square(excess, n - 1),
        mos=mos, interval=given.interval, mapped=mapped, held_out=groups is not None, notes=tuple(notes),
    )  # fmt: skip


def _read_votes(votes: object, metric: object, order: int) -> _Votes:
    from scipy.stats import t

    table = read_array(votes, what="votes", axes=("items", "raters"), missing=True)
    counts = np.isfinite(table).sum(axis=1)
    poor = np.flatnonzero(counts < 2)  # noqa: PLR2004 - a spread needs two
    if poor.size:
        raise ValueError(
            f"votes must be 2 or more per item, for its confidence interval, got item {poor[0]} with "
            f"{counts[poor[0]]} votes ({poor.size} such items); leave it out"
        )
    x = read_array(metric, what="metric", axes=("items",))
    if order not in PARAMETERS or isinstance(order, bool | float):
        raise ValueError(
            f"order must be 3 (monotone cubic), 1 (line) or 0 (no mapping), got {order!r}"
        )
    if len(table) != len(x):
        raise ValueError(
            f"metric must have one value per item, got {len(x)} values for {len(table)} items"
        )
    # One degree of freedom for the errors, one for Fisher's z.
    fewest = max(PARAMETERS[order], 3) + 1
    if len(x) < fewest:
        raise ValueError(
            f"votes must be of {fewest} items or more for order {order}, got {len(x)}; lower the order"
        )
    _check_spread(x, order, where="items")
    quantile = np.where(counts < MANY_VOTES, t.ppf(0.975, counts - 1), NORMAL_QUANTILE)
    interval = quantile * np.nanstd(table, axis=1, ddof=1) / np.sqrt(counts)
    return _Votes(x, np.nanmean(table, axis=1), interval, order)


def _check_spread(x: Values, order: int, *, where: str) -> None:
    needed, different = max(order, 1) + 1, len(np.unique(x))
    if different < needed:
        raise ValueError(
            f"metric must have {needed} different values over the {where} for order {order}, got {different}; "
            "lower the order"
        )


def _fit_mapping(given: _Votes, chosen: NDArray[np.bool_]) -> Polynomial:
    x, mos = given.x[chosen], given.mos[chosen]
    span = float(x.min()), float(x.max())
    if given.order == 0:
        return Polynomial([0.0, 1.0])
    if given.order == 1:
        line = Polynomial.fit(x, mos, 1, domain=span, window=UNIT)
        against = line.coef[1] * given.sign < 0
        return Polynomial([mos.mean(), 0.0], domain=span, window=UNIT) if against else line
    return fit_monotone_cubic(x, mos, span=span, sign=given.sign)


MOST_FOLDS = 200
"""Groups that are left out one at a time; of more, several together, or a corpus would take hours."""


def _map_out_of_fold(given: _Votes, groups: ArrayLike) -> tuple[Values, list[str]]:
    x, order = given.x, given.order
    numbers, names = read_groups(groups, n=len(x), what="item")
    if len(names) < 2:  # noqa: PLR2004 - one to fit to, one to predict
        raise ValueError(f"groups must be two or more, got the one group {names[0]}; leave it out")
    mapped, n_beyond, step = np.empty_like(x), 0, -(-len(names) // MOST_FOLDS)
    for first in range(0, len(names), step):
        held = (numbers >= first) & (numbers < first + step)
        if order:
            _check_spread(x[~held], order, where=f"items outside group {names[first]}")
        known = np.clip(x[held], x[~held].min(), x[~held].max()) if order > 1 else x[held]
        mapped[held] = _fit_mapping(given, ~held)(known)
        n_beyond += int((known != x[held]).sum())
    notes = [f"{len(names)} groups are left out {step} at a time."] if step > 1 else []
    if n_beyond:
        where = "beyond the metric's range in the other groups"
        notes.append(f"{n_beyond} items lie {where}; the cubic is held at its end there.")
    return mapped, notes


def _correlate(mos: Values, other: Values) -> tuple[float, list[str]]:
    for name, values in (("votes", mos), ("mapped metric", other)):
        if ((values - values.mean()) ** 2).sum() <= FLAT * (values**2).sum():
            return float("nan"), [f"No correlation: the {name} of all items are the same."]
    return float(np.clip(np.corrcoef(mos, other)[0, 1], -1, 1)), []


SIGNIFICANCE = 0.05


def compare_p1401(first: Statistic, second: Statistic) -> Statistic:
    """Test the differences between two metrics on the same votes as ITU-T P.1401 does, from results of `p1401`.

    With N items: Z = (z1 - z2) / √(2 / (N - 3)) of the PLCC; of the outlier ratios Z = (p1 - p2) / √(2 p (1 - p) / N)
    with p their mean; of the errors the larger square over the smaller, against F(.95; N - d, N - d) for rmse
    and F(.95; N, N) for rmse*. Putting the larger on top makes the standard's limit a test at 10 %, not 5 %;
    the p given here are two-sided.

    **Not for conclusions.** All four take items for independent and the two metrics' errors for unrelated: when stimuli
    cluster in recordings they find a difference in 13 to 27 % of studies where there is none; use `compare_metrics`.
    """
    from scipy.stats import f as fisher

    if not np.array_equal(first.mos, second.mos):
        raise ValueError("second must be on the votes of the first, got other items or raters")
    if (first.order, first.held_out) != (second.order, second.held_out):
        raise ValueError(
            f"second must have the mapping of the first (order {first.order}, held_out {first.held_out}), got order "
            f"{second.order}, held_out {second.held_out}; map both alike"
        )
    notes: list[str] = []
    n, freedom = first.n_items, first.n_items - PARAMETERS[0 if first.held_out else first.order]
    plcc_z = outlier_z = float("nan")
    if max(abs(first.plcc), abs(second.plcc)) < PERFECT:
        plcc_z = float((np.arctanh(first.plcc) - np.arctanh(second.plcc)) / np.sqrt(2 / (n - 3)))
    else:
        notes.append("No test of the correlations: one is perfect or not defined.")
    pooled = (first.outlier_ratio + second.outlier_ratio) / 2
    if pooled in {0.0, 1.0}:
        notes.append(
            "No test of the outlier ratios: no item, or every item, is an outlier with both metrics."
        )
    else:
        error = np.sqrt(2 * pooled * (1 - pooled) / n)
        outlier_z = float((first.outlier_ratio - second.outlier_ratio) / error)
    tests: dict[str, float] = {}
    for name, size in (("rmse", freedom), ("rmse_star", n)):
        errors, limit = (first[name], second[name]), float(fisher.ppf(1 - SIGNIFICANCE, size, size))
        ratio = p = float("nan")
        if min(errors) == 0:
            notes.append(f"No test of {name}: it is 0 for at least one metric.")
        else:
            ratio = float((max(errors) / min(errors)) ** 2)
            p = float(min(1.0, 2 * fisher.sf(ratio, size, size)))
        tests |= {f"{name}_f": ratio, f"{name}_limit": limit, f"{name}_p": p}
    return Statistic(
        "P1401Difference", plcc_z=plcc_z, plcc_p=find_p(plcc_z), outlier_z=outlier_z, outlier_p=find_p(outlier_z),
        **tests, n_items=n, notes=tuple(notes),
    )  # fmt: skip
