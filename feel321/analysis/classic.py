"""Classic measures of the literature: ITU-T P.1401, correlations that share a variable, and those of repeated measures.

Conventions: votes have shape (items, raters), NaN where a rater did not vote; an item is a stimulus, its mean
vote the MOS; a metric has one value per item. All of these take items or rows for independent: stimuli of one
recording are not, so these intervals and tests are for comparison with the literature, and conclusions come
from `correlate`, `compare_metrics` and the mixed model.
"""

from collections.abc import Iterator

import numpy as np
from numpy.polynomial import Polynomial
from numpy.typing import ArrayLike
from scipy.optimize import nnls
from scipy.stats import chi2, norm, rankdata, t

from feel321.analysis.arrays import (
    FLAT,
    PERFECT,
    UPPER,
    Values,
    check_labels,
    read_array,
    read_groups,
)
from feel321.analysis.table.items import Table, is_tidy, make_items, open_tests
from feel321.records import Statistic

UNIT = (0.0, 1.0)
PARAMETERS = {0: 1, 1: 2, 3: 4}  # Order -> degrees of freedom that it takes off the items
NORMAL_QUANTILE = 1.96  # The standard's rounded one; also for an item's interval from 30 votes on
MANY_VOTES = 30
FEW_ITEMS = 30  # With fewer items a cubic bends to noise: the first order leads
FEWEST = 4  # Cases that Fisher's z and Williams' t need at least: both divide by n - 3
NAN = float("nan")


def fit_monotone_cubic(x: Values, y: Values, *, span: tuple[float, float]) -> Polynomial:
    """Least-squares cubic that rises, or falls, over all of an interval, whichever fits better.

    With u = (x - low) / (high - low), the cubics that rise on the interval are those whose slope is q(u) =
    (α + β u)² + γ² u (1 - u), Lukács' form of a quadratic that is nowhere negative on [0, 1] (Szegő 1975, theorem
    1.21.1). They form a convex cone, so the fit is unique. Where the unconstrained cubic is not monotone, the answer
    lies on the cone's border: q(0) = 0, q(1) = 0, or q(u) = k (u - t)². All are solved exactly, on the whole interval:
    a 0..1 metric tested in steps of 0.1 hides a turn between two steps.
    """
    u = (x - span[0]) / (span[1] - span[0])
    cubic = Polynomial.fit(u, y, 3, domain=UNIT, window=UNIT)
    slope = cubic.deriv()
    turns = slope.deriv().trim().roots().real
    extremes = slope(np.array([*UNIT, *turns[(turns > 0) & (turns < 1)]]))
    if extremes.min() < 0 < extremes.max():
        # The best rising or falling cubic among those whose slope is 0 somewhere.
        candidates = [*_list_candidates(u, y), *(-one for one in _list_candidates(u, -y))]
        cubic = min(candidates, key=lambda one: float(((y - one(u)) ** 2).sum()))
    return Polynomial(cubic.coef, domain=span, window=UNIT)


def _list_candidates(u: Values, y: Values) -> Iterator[Polynomial]:
    """List the best cubics on the cone's border.

    For slopes u² or (1 - u)² and u (1 - u), least squares with two non-negative weights; for k (u - t)², the share of
    variance explained is a ratio of polynomials in t, whose stationary points are the roots of a quintic.
    """

    def centre(cubic: Polynomial) -> Polynomial:
        return cubic + float(y.mean() - cubic(u).mean())

    bow = Polynomial([0, 0, 1 / 2, -1 / 3])
    for corner in (Polynomial([0, 0, 0, 1 / 3]), Polynomial([0, 1, -1, 1 / 3])):
        columns = np.stack([bow(u), corner(u)], axis=1)
        weights, _ = nnls(columns - columns.mean(axis=0), y - y.mean())
        yield centre(weights[0] * bow + weights[1] * corner)
    powers = np.stack([u**3 / 3, -(u**2), u])
    powers -= powers.mean(axis=1, keepdims=True)
    moments, with_y = powers @ powers.T, Polynomial(powers @ y)
    with_itself = Polynomial([np.fliplr(moments).trace(offset) for offset in range(2, -3, -1)])
    stationary = 2 * with_y.deriv() * with_itself - with_y * with_itself.deriv()
    # A root that rounding has made complex, or pushed out, is still a candidate: its fit decides.
    for touch in np.clip(stationary.trim().roots().real, *UNIT):
        shape = Polynomial([0, touch**2, -touch, 1 / 3])
        column = shape(u) - shape(u).mean()
        yield centre(max(0.0, column @ y / (column @ column)) * shape)


def p1401(
    votes: Table | ArrayLike, metric: str | ArrayLike,
    *, order: int = 3, groups: ArrayLike | None = None,
) -> Statistic:  # fmt: skip
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
        by a mapping fitted without its group; without it, the errors flatter the metric.

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
    below 30 votes and 1.96 from there on. The mapping is least squares and monotone over the metric's range. With
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
    """
    if is_tidy(votes) and isinstance(metric, str):
        items = make_items(votes, [metric])
        votes, metric = items.ratings.T, items.metrics[0]
        groups = items.recordings if isinstance(groups, str) else groups
    check_labels(votes, metric, what="metric")
    table, x = _read_votes(votes, metric, order)
    counts, mos = np.isfinite(table).sum(axis=1), np.nanmean(table, axis=1)
    quantile = np.where(counts < MANY_VOTES, t.ppf(0.975, counts - 1), NORMAL_QUANTILE)
    interval = quantile * np.nanstd(table, axis=1, ddof=1) / np.sqrt(counts)
    mapping, notes = _fit_mapping(x, mos, order=order), list[str]()
    mapped = np.asarray(mapping(x), np.float64)
    if groups is not None:
        mapped, notes = _map_out_of_fold(x, mos, groups, order=order)
    n, errors = len(x), np.abs(mos - mapped)
    errors[errors**2 <= FLAT * float((mos**2).sum())] = 0.0
    squares = float((errors**2).sum())
    beyond = float((np.maximum(0.0, errors - interval) ** 2).sum())
    freedom = n - PARAMETERS[order if groups is None else 0]
    plcc, rmse = _correlate(mos, mapped), float(np.sqrt(squares / freedom))
    low, high = _find_interval(plcc, n - 3, NORMAL_QUANTILE)
    rmse_low, rmse_high = (rmse * np.sqrt(freedom / chi2.ppf([0.975, 0.025], freedom))).tolist()
    ratio = float((errors > interval).mean())
    if np.isnan(plcc):
        which = "mapped metric" if np.ptp(mos) > 0 else "votes"
        notes.append(f"No correlation: the {which} of all items are the same.")
    if abs(plcc) >= PERFECT:
        notes.append("The correlation is perfect to rounding and has no interval.")
    if order > 1 and n < FEW_ITEMS:
        few = f"With {n} items, fewer than {FEW_ITEMS}"
        notes.append(f"{few}, a cubic bends to noise: report order 1 first.")
    coefficients, in_x = np.zeros(max(order, 1) + 1), mapping.convert().coef
    coefficients[: len(in_x)] = in_x
    return Statistic(
        "P1401", plcc=plcc, plcc_low=low, plcc_high=high, srocc=_correlate(rankdata(mos), rankdata(x)),
        rmse=rmse, rmse_low=rmse_low, rmse_high=rmse_high, rmse_star=float(np.sqrt(beyond / freedom)),
        outlier_ratio=ratio, outlier_ratio_sd=float(np.sqrt(ratio * (1 - ratio) / n)),
        coefficients=tuple(coefficients.tolist()), order=order, n_items=n,
        rmse_n1=float(np.sqrt(squares / (n - 1))), rmse_star_n1=float(np.sqrt(beyond / (n - 1))),
        mos=mos, interval=interval, mapped=mapped, held_out=groups is not None, notes=tuple(notes),
    )  # fmt: skip


def _read_votes(votes: object, metric: object, order: int) -> tuple[Values, Values]:
    table = read_array(votes, what="votes", axes=("items", "raters"), missing=True)
    x = read_array(metric, what="metric", axes=("items",))
    if order not in PARAMETERS or isinstance(order, bool | float):
        must = "3 (monotone cubic), 1 (line) or 0 (no mapping)"
        raise ValueError(f"order must be {must}, got {order!r}")
    if len(table) != len(x):
        got = f"got {len(x)} values for {len(table)} items"
        raise ValueError(f"metric must have one value per item, {got}")
    counts = np.isfinite(table).sum(axis=1)
    # One degree of freedom for the errors, one for Fisher's z; a spread needs two votes.
    fewest, poor = max(PARAMETERS[order], 3) + 1, np.flatnonzero(counts < 2)  # noqa: PLR2004
    if poor.size or len(x) < fewest:
        place = f", item {poor[0]} with {counts[poor[0]]} votes" if poor.size else ""
        must = f"2 or more per item, of {fewest} items or more for order {order}"
        do = "leave such items out, or lower the order"
        raise ValueError(f"votes must be {must}, got {len(x)} items{place}; {do}")
    return table, x


def _fit_mapping(x: Values, mos: Values, *, order: int) -> Polynomial:
    """Fit the mapping of an order to some items."""
    if order == 0:
        return Polynomial([0.0, 1.0])
    needed, different = order + 1, len(np.unique(x))
    if different < needed:
        raise ValueError(
            f"metric must have {needed} different values over the items, and over those outside each group, for "
            f"order {order}, got {different}; lower the order"
        )
    span = float(x.min()), float(x.max())
    if order > 1:
        return fit_monotone_cubic(x, mos, span=span)
    return Polynomial.fit(x, mos, 1, domain=span, window=UNIT)


def _map_out_of_fold(
    x: Values, mos: Values, groups: ArrayLike, *, order: int
) -> tuple[Values, list[str]]:
    """Map every item by the others' groups, by a cubic no farther than their ends."""
    numbers, names = read_groups(groups, n=len(x), what="item")
    if len(names) < 2:  # noqa: PLR2004 - one to fit to, one to predict
        raise ValueError(f"groups must be two or more, got the one group {names[0]}; leave it out")
    mapped, n_beyond = np.empty_like(x), 0
    for place in range(len(names)):
        held = numbers == place
        known = np.clip(x[held], x[~held].min(), x[~held].max()) if order > 1 else x[held]
        mapped[held] = _fit_mapping(x[~held], mos[~held], order=order)(known)
        n_beyond += int((known != x[held]).sum())
    where = "beyond the metric's range in the other groups; the cubic is held at its end there"
    return mapped, [f"{n_beyond} items lie {where}."] if n_beyond else []


def _correlate(mos: Values, other: Values) -> float:
    """Correlate; NaN where either is the same for all items."""
    flat = [((one - one.mean()) ** 2).sum() <= FLAT * (one**2).sum() for one in (mos, other)]
    return NAN if any(flat) else float(np.clip(np.corrcoef(mos, other)[0, 1], -1, 1))


def _find_interval(r: float, n: int, quantile: float) -> tuple[float, float]:
    """Find the interval of a correlation whose Fisher's z has the variance 1 / n; NaN where it is perfect or n is 0."""
    if n < 1 or not abs(r) < PERFECT:
        return NAN, NAN
    z, margin = np.arctanh(r), quantile / np.sqrt(n)
    return float(np.tanh(z - margin)), float(np.tanh(z + margin))


def compare_dependent(r_jk: float, r_jh: float, r_kh: float, n: int) -> Statistic:  # noqa: PLR0917 - the order of cocor
    """Compare two correlations of the same cases that share the variable j.

    Parameters
    ----------
    r_jk, r_jh : float
        The two correlations: of the ratings j with one metric k, and with another h.
    r_kh : float
        Correlation of the two metrics.
    n : int
        Number of cases, at least 4.

    Returns
    -------
    Statistic
        ``difference`` r_jk - r_jh; ``williams_t williams_df williams_p``, ``steiger_z steiger_p``, ``meng_z meng_p``,
        two-sided; ``zou_low zou_high``, the 95 % interval of the difference; ``notes``, why anything is NaN.

    Notes
    -----
    Model: n independent draws from a trivariate normal distribution. With r1 = r_jk, r2 = r_jh, r12 = r_kh,
    r̄ their mean, and z Fisher's transform::

        Williams  t(n - 3) = (r1 - r2) √((n - 1)(1 + r12) / (2 (n - 1)/(n - 3) |R| + r̄² (1 - r12)³))
                  |R| = 1 - r1² - r2² - r12² + 2 r1 r2 r12
        Steiger   Z = (z1 - z2) √(n - 3) / √(2 - 2c)
                  c = (r12 (1 - 2r̄²) - r̄² (1 - 2r̄² - r12²)/2) / (1 - r̄²)²
        Meng      Z = (z1 - z2) √((n - 3) / (2 (1 - r12) h)),  h = (1 - f q)/(1 - q)
                  q = (r1² + r2²)/2,  f = min(1, (1 - r12)/(2 (1 - q)))
        Zou       r1 - r2 ∓ √(a² + b² - 2 c a b), a and b the distances to Fisher's limits on that side,
                  c = ((r12 - r1 r2/2)(1 - r1² - r2² - r12²) + r12³) / ((1 - r1²)(1 - r2²))

    **Not for conclusions in this field.** Stimuli of one recording are not independent: with equal true
    correlations these tests find a difference in 19 to 36 % of studies. Use `compare_metrics`.

    References
    ----------
    Williams (1959), doi 10.1111/j.2517-6161.1959.tb00346.x; Steiger (1980), doi 10.1037/0033-2909.87.2.245; Meng,
    Rosenthal & Rubin (1992), doi 10.1037/0033-2909.111.1.172; Zou (2007), doi 10.1037/1082-989X.12.4.399.

    Examples
    --------
    Zou (2007), example of overlapping correlations:

    >>> from feel321 import analysis
    >>> result = analysis.compare_dependent(0.396, 0.179, 0.088, 66)
    >>> round(result.zou_low, 3), round(result.zou_high, 3)
    (-0.093, 0.517)
    """
    r1, r2, r12 = float(r_jk), float(r_jh), float(r_kh)
    # Of the three variables' correlation matrix; negative where no three variables correlate so.
    determinant = 1 - r1**2 - r2**2 - r12**2 + 2 * r1 * r2 * r12
    if not max(map(abs, (r1, r2, r12))) <= 1 or r12 >= PERFECT or not determinant >= PERFECT - 1:
        raise ValueError(
            f"r_jk, r_jh and r_kh must be -1 to 1, r_kh below 1 and possible with the others, got {r1}, {r2} and "
            f"{r12}: no three variables correlate like that; take all three from the same cases"
        )
    if not n >= FEWEST or n != np.floor(n) or np.isinf(n):
        raise ValueError(f"n must be a whole number of cases, {FEWEST} or more, got {n}")
    n, mean, notes = int(n), (r1 + r2) / 2, list[str]()
    spread = 2 * (n - 1) / (n - 3) * max(determinant, 0.0) + mean**2 * (1 - r12) ** 3
    williams = steiger = meng = low = high = NAN
    if spread > 1 - PERFECT:
        williams = float((r1 - r2) * np.sqrt((n - 1) * (1 + r12) / spread))
    else:
        notes.append("Williams' t is not defined: the three variables determine each other.")
    if max(abs(r1), abs(r2)) < PERFECT:
        apart, square = float(np.arctanh(r1) - np.arctanh(r2)), mean**2
        covariance = r12 * (1 - 2 * square) - square * (1 - 2 * square - r12**2) / 2
        steiger = apart * float(np.sqrt((n - 3) / (2 - 2 * covariance / (1 - square) ** 2)))
        q = (r1**2 + r2**2) / 2
        h = (1 - min(1.0, (1 - r12) / (2 * (1 - q))) * q) / (1 - q)
        meng = apart * float(np.sqrt((n - 3) / (2 * (1 - r12) * h)))
        (low1, high1), (low2, high2) = (_find_interval(r, n - 3, norm.ppf(UPPER)) for r in (r1, r2))
        c = (r12 - r1 * r2 / 2) * (1 - r1**2 - r2**2 - r12**2) + r12**3
        c /= (1 - r1**2) * (1 - r2**2)
        # max: rounding may push a vanishing sum of squares below 0
        down, up = (
            float(np.sqrt(max(0.0, one**2 + other**2 - 2 * c * one * other)))
            for one, other in ((r1 - low1, high2 - r2), (high1 - r1, r2 - low2))
        )
        low, high = r1 - r2 - down, r1 - r2 + up
    else:
        notes.append("A perfect correlation has no Fisher's z: no Steiger, Meng or Zou.")
    return Statistic(
        "Dependent", difference=r1 - r2, williams_t=williams, williams_df=n - 3,
        williams_p=float(2 * t.sf(abs(williams), n - 3)), steiger_z=steiger, steiger_p=float(2 * norm.sf(abs(steiger))),
        meng_z=meng, meng_p=float(2 * norm.sf(abs(meng))), zou_low=low, zou_high=high, notes=tuple(notes),
    )  # fmt: skip


def repeated_measures_correlation(
    x: Table | ArrayLike, y: str | ArrayLike, participant: ArrayLike | None = None
) -> Statistic:
    """Correlate x and y within participants.

    Parameters
    ----------
    x : Table, DataFrame or array_like, shape (n,)
        Ratings of test stimuli; or the values of one variable, one row per judgement.
    y : str or array_like, shape (n,)
        The metric that ratings are correlated with; or the other variable.
    participant : array_like, shape (n,), optional
        Who each row belongs to, unless x holds ratings.

    Returns
    -------
    Statistic
        ``r``, NaN where x or y does not vary within any participant; ``df p``, two-sided; ``low high``, the 95 %
        interval; ``n n_participants notes``.

    Notes
    -----
    Model: y = a line with one common slope and an intercept per participant, plus independent errors of equal
    spread. r is the correlation of x and y, each with its participant's mean taken off; with N rows and P
    participants df = N - P - 1, t = r √(df / (1 - r²)), and the interval is tanh(atanh r ± 1.96 / √(df - 1)):
    Fisher's z with n = df + 2 (rmcorr from 0.5 on; earlier releases and the paper took n = df).

    **Its p is not for conclusions here.** Rows of one stimulus are taken for independent evidence on the
    metric; when they are not, this test finds a relation in half of the studies where there is none.

    References
    ----------
    Bland & Altman (1995), doi 10.1136/bmj.310.6977.446; Bakdash & Marusich (2017), doi 10.3389/fpsyg.2017.00456.

    Examples
    --------
    Both participants rate better matches higher, though the one who felt the better matches rates lower overall:

    >>> x, y = [0.1, 0.2, 0.4, 0.6, 0.7, 0.9], [60, 65, 75, 30, 38, 45]
    >>> from feel321 import analysis
    >>> result = analysis.repeated_measures_correlation(x, y, ["a", "a", "a", "b", "b", "b"])
    >>> round(result.r, 3), result.df, round(result.p, 4)
    (0.987, 3, 0.0018)
    """
    if is_tidy(x) and isinstance(y, str):
        rows, _ = open_tests(x, (y,))
        x, y, participant = rows[y].to_numpy(), rows["rating"].to_numpy(), rows["participant"]
    check_labels(x, y, what="y")
    first, second = (read_array(one, what=name, axes=("n",)) for one, name in ((x, "x"), (y, "y")))
    names = np.asarray(participant).ravel()
    if not first.shape == second.shape == names.shape:
        got = f"got {len(first)}, {len(second)} and {names.size}"
        raise ValueError(f"x, y and participant must have one length, {got}")
    number, people = read_groups(names, n=len(names), what="row", of="participant")
    df = len(first) - len(people) - 1
    if df < 1:
        got = f"got {len(first)} rows of {len(people)} participants"
        raise ValueError(f"participant must have at least participants + 2 rows, {got}")
    rest, notes, r = [], list[str](), NAN
    for name, values in (("x", first), ("y", second)):
        rest.append(values - (np.bincount(number, values) / np.bincount(number))[number])
        if (rest[-1] ** 2).sum() <= FLAT * (values**2).sum():
            notes.append(f"No correlation: {name} does not vary within any participant.")
    one, other = rest
    if not notes:
        r = float(np.clip(one @ other / np.sqrt((one @ one) * (other @ other)), -1, 1))
    low, high = _find_interval(r, df - 1, norm.ppf(UPPER))
    if np.isnan(low):
        why = "the correlation is perfect, or fewer than 2 degrees of freedom are left"
        notes.append(f"No interval: {why}.")
    p = 0.0 if abs(r) >= PERFECT else float(2 * t.sf(abs(r) * np.sqrt(df / (1 - r**2)), df))
    return Statistic(
        "RepeatedMeasures", r=r, df=df, p=p, low=low, high=high, n=len(first), n_participants=len(people),
        notes=tuple(notes[:1]),
    )  # fmt: skip
