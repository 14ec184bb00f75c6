"""Linear mixed models: `fit_mixed`, and `contrast` for sums and differences of its effects."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING

import numpy as np

from feel321.analysis.mixed.design import build_design
from feel321.analysis.mixed.optimum import Balanced, find_frame, find_optimum, find_slope
from feel321.analysis.mixed.profile import (
    Profile,
    find_coefficients,
    find_modes,
    find_sigma,
    find_spreads,
    hold_threads,
)

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from numpy.typing import NDArray
    from pandas import DataFrame

    from feel321.analysis.mixed.design import Block, Design, Term
    from feel321.analysis.mixed.profile import State

# How well a combination of fixed effects is known: Satterthwaite's degrees of freedom.

STEP = 1e-4
"""Share of a relative spread, or of 1 if that is more, by which it is moved: beside 10 000, 0.0001 is rounding."""

FLAT = 1e-8
"""Curvature below this carries no information: a spread at its boundary."""

CONFIDENCE = 0.95


@dataclass(frozen=True, slots=True)
class Uncertainty:
    """What the variance of any combination of fixed effects follows from.

    covariance: (n_fixed, n_fixed); slopes: (n_theta + 1, n_fixed, n_fixed); parameters: (n_theta +
    1, n_theta + 1).
    """

    covariance: NDArray[np.float64]
    slopes: NDArray[np.float64]
    parameters: NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Estimate:
    """A number with its t test against 0.

    Parameters
    ----------
    estimate, se : float
        The value and its standard error.
    df : float
        Satterthwaite's degrees of freedom.
    t, p : float
        estimate / se, and its two-sided probability.
    low, high : float
        95 % interval, estimate ± t(.975, df) se.
    """

    estimate: float
    se: float
    df: float
    t: float
    p: float
    low: float
    high: float


def find_uncertainty(profile: Profile, best: State) -> Uncertainty:
    """Find out how the fixed effects' covariance hangs on the spreads, and how well those are known.

    Notes
    -----
    With f(theta, log s) the deviance before s is profiled out, the spreads' covariance is 2 H⁻¹, H the matrix of
    second derivatives, none of which hangs on units; directions in which H is not positive carry no information
    and are left out, as lmerTest does. Derivatives along theta are central differences of the exact slope. A penalty
    of -2 log theta adds 2 / theta².
    """
    sigma, size, unit = (
        find_sigma(profile, best),
        profile.n_theta,
        np.maximum(np.abs(best.theta), 1),
    )
    covariance = find_coefficients(profile, best)[1] * sigma**2
    hessian = np.zeros((size + 1, size + 1))
    slopes = np.empty((size + 1, *covariance.shape))
    for place, shift in enumerate(np.diag(STEP * unit)):
        above, below = profile.evaluate(best.theta + shift), profile.evaluate(best.theta - shift)
        rise = find_slope(profile, above, above.rss / sigma**2) - find_slope(
            profile, below, below.rss / sigma**2
        )
        hessian[place, :size] = rise * unit / (2 * STEP)
        hessian[place, size] = hessian[size, place] = -(above.rss - below.rss) / STEP / sigma**2
        wider = find_coefficients(profile, above)[1] - find_coefficients(profile, below)[1]
        slopes[place] = wider * sigma**2 / (2 * STEP)
    held = np.flatnonzero(profile.penalised)
    hessian[held, held] += 2 * (unit[held] / best.theta[held]) ** 2
    hessian[size, size] = 4 * profile.weight
    slopes[size] = 2 * covariance
    return Uncertainty(covariance, slopes, 2 * _invert((hessian + hessian.T) / 2))


def _invert(hessian: NDArray[np.float64]) -> NDArray[np.float64]:
    values, vectors = np.linalg.eigh(hessian)
    kept = values > FLAT
    inverse: NDArray[np.float64] = (vectors[:, kept] / values[kept]) @ vectors[:, kept].T
    return inverse


def estimate_sum(
    effects: NDArray[np.float64], weights: NDArray[np.float64], uncertainty: Uncertainty
) -> Estimate:
    """Estimate a weighted sum of fixed effects.

    effects: (n_fixed,); weights: (n_fixed,).

    Notes
    -----
    With v = w' C w and g its derivatives with respect to the spreads, whose covariance is A, the degrees of
    freedom are 2 v² / g' A g.

    References
    ----------
    Satterthwaite (1946), doi 10.2307/3002019; Kuznetsova, Brockhoff & Christensen (2017), lmerTest, Journal
    of Statistical Software 82(13), doi 10.18637/jss.v082.i13.
    """
    from scipy.stats import t as student

    value = float(weights @ effects)
    variance = float(weights @ uncertainty.covariance @ weights)
    slope = np.einsum("i,kij,j->k", weights, uncertainty.slopes, weights)
    df = float(2 * variance**2 / (slope @ uncertainty.parameters @ slope))
    se = float(np.sqrt(variance))
    margin = float(student.ppf((1 + CONFIDENCE) / 2, df)) * se
    p = float(2 * student.sf(abs(value / se), df))
    return Estimate(value, se, df, value / se, p, value - margin, value + margin)


BOUND = 1 - 1e-6
"""A correlation beyond this is one of ±1 but for rounding."""


@dataclass(frozen=True, slots=True)
class MixedFit:
    """A linear mixed model, fitted.

    Parameters
    ----------
    formula : str
        As it was given.
    reml : bool
        Whether the likelihood was the restricted one.
    fixed : DataFrame
        Fixed effects, indexed by ``term``: estimate, se, df (Satterthwaite), t, p, low and high (95 %).
    variances : DataFrame
        Spreads of the random effects: group, term, sd. The residual is apart.
    correlations : DataFrame
        Correlations within ``(1 + x | group)``: group, first, second, correlation; NaN where a spread is 0.
    residual_sd : float
        Standard deviation of the residual.
    criterion : float
        -2 log restricted likelihood at its maximum (lme4's REML criterion), or -2 log likelihood; without the penalty,
        where there is one.
    singular : bool
        Whether a spread is estimated as zero, or effects as perfectly tied to each other.
    marginal_r2, conditional_r2 : float
        Share of the variance that the fixed effects explain, and that fixed and random effects explain.
    effects : DataFrame
        Predicted random effects (BLUPs): group, level, term, value.
    fitted, residuals : ndarray, shape (n_rows,)
        Prediction with the random effects, and the response minus it.
    uncertainty : Uncertainty
        What `contrast` works from.
    n_rows : int
        Number of observations.
    n_levels : Mapping of str to int
        Number of levels of every grouping factor.
    notes : tuple of str
        What is unusual about the fit, one sentence each.
    """

    formula: str
    reml: bool
    fixed: DataFrame
    variances: DataFrame
    correlations: DataFrame
    residual_sd: float
    criterion: float
    singular: bool
    marginal_r2: float
    conditional_r2: float
    effects: DataFrame
    fitted: NDArray[np.float64]
    residuals: NDArray[np.float64]
    uncertainty: Uncertainty
    n_rows: int
    n_levels: Mapping[str, int]
    notes: tuple[str, ...] = ()


def fit_mixed(
    formula: str, data: DataFrame, *, reml: bool = True, penalty: Sequence[str] = ()
) -> MixedFit:
    """Fit a linear mixed model.

    Parameters
    ----------
    formula : str
        In lme4's notation: ``y ~ x + (1 + x | subject) + (1 | item)``. Fixed: ``+ - : * / ^ 0 1 I()`` and
        functions such as ``log``; words and categories get treatment coding against their first level, and
        names as in R (``recipeB``). Random: ``(1 | g)``, ``(x | g)`` correlated, ``(x || g)`` not, ``(0 + x | g)``,
        ``(1 | a:b)``, ``(1 | a/b)``.
    data : DataFrame
        One row per observation, no gaps in the columns used.
    reml : bool
        Restricted maximum likelihood, right for everything but the comparison of models with different fixed
        parts, for which give False.
    penalty : sequence of str
        Grouping factors whose spreads are kept away from zero, such as those with few levels.

    Returns
    -------
    MixedFit
        Fixed effects with Satterthwaite's t tests, spreads, predictions.

    Raises
    ------
    ValueError
        If the formula cannot be read, a column is missing or has gaps, the data cannot tell the effects apart
        (one level only, a level for every row, effects that are sums of others), or leave no residual.
    TypeError
        If the data are no DataFrame.

    Notes
    -----
    Model: y = X b + Z u + e, with u ~ N(0, G) independent between groups and levels, e ~ N(0, s² I). Use it where
    observations share people, recordings or stimuli; a person's slope belongs into the brackets whenever the
    claim is about people in general (without, its standard error is several times too small). Do not use it
    for grouping factors of two or three levels if their spread is the question, nor for ratings piled up at
    the ends of the scale.

    The deviance is profiled and minimised over relative spreads (Bates et al. 2015) with its exact slope; where every
    participant rated every stimulus equally often, it is the same function of two small matrices (see `balanced`);
    degrees of freedom are Satterthwaite's, as in lmerTest. With few levels a spread is often estimated as zero when it
    is only unknown; for the factors named in `penalty`, -2 log of the spread is added to the deviance,
    which is the mode under a gamma(2, λ) prior with λ -> 0 (Chung et al. 2013). It enters the degrees of freedom too,
    not the criterion. A spread of zero (a singular fit) is normal in
    small studies: it stays in the model as zero, and the notes say so. R² is Nakagawa's and Schielzeth's with
    Johnson's extension to slopes: the fixed predictions' variance, plus the mean over rows of the random
    effects' variance, plus s².

    References
    ----------
    Bates, Mächler, Bolker & Walker (2015), Fitting linear mixed-effects models using lme4, Journal of
    Statistical Software 67(1), doi 10.18637/jss.v067.i01. Kuznetsova et al. (2017), doi
    10.18637/jss.v082.i13. Chung, Rabe-Hesketh, Dorie, Gelman & Liu (2013), A nondegenerate penalized likelihood
    estimator for variance parameters in multilevel models, Psychometrika 78, 685-709, doi
    10.1007/s11336-013-9328-2. Nakagawa & Schielzeth (2013), doi 10.1111/j.2041-210x.2012.00261.x; Johnson (2014),
    doi 10.1111/2041-210X.12225.

    Examples
    --------
    Four people, three ratings each.

    >>> import pandas as pd
    >>> data = pd.DataFrame({"who": list("aaabbbcccddd"), "x": [0, 1, 2] * 4,
    ...     "y": [1.0, 2, 3, 3, 5, 6, 2, 2, 4, 5, 7, 8]})
    >>> fit = fit_mixed("y ~ x + (1 | who)", data)
    >>> fit.fixed.round(2)
                 estimate    se    df     t     p   low  high
    term
    (Intercept)      2.75  1.07  3.15  2.58  0.08 -0.56  6.06
    x                1.25  0.16  7.00  7.64  0.00  0.86  1.64
    >>> fit.variances.round(2)
      group         term    sd
    0   who  (Intercept)  2.09
    >>> round(fit.residual_sd, 2), round(fit.criterion, 2), fit.singular
    (0.46, 29.93, False)
    """
    design = build_design(formula, data)
    profile = Profile(design, reml=reml, penalty=penalty)
    frame = find_frame(design)
    quick = Balanced(design, frame, reml=reml, penalty=penalty) if frame else profile
    with hold_threads(profile.n_random):
        found = find_optimum(quick)
        uncertainty = find_uncertainty(quick, found)
        best = profile.evaluate(found.theta)
    coefficients, _ = find_coefficients(profile, best)
    variances, correlations = _table_spreads(profile, best)
    fitted, effects = _predict(profile, best)
    zero = _name_zeros(
        variances, correlations, boundary=bool((best.theta[profile.diagonal] == 0).any())
    )
    marginal, conditional = _explain_variance(profile, best)
    return MixedFit(
        formula=formula,
        reml=reml,
        fixed=_table_fixed(design, coefficients, uncertainty),
        variances=variances,
        correlations=correlations,
        residual_sd=find_sigma(profile, best),
        criterion=profile.deviance(best),
        singular=bool(zero),
        marginal_r2=marginal,
        conditional_r2=conditional,
        effects=effects,
        fitted=fitted,
        residuals=design.response - fitted,
        uncertainty=uncertainty,
        n_rows=profile.n_rows,
        n_levels={factor.name: len(factor.levels) for factor in design.factors},
        notes=tuple(zero),
    )


def contrast(fit: MixedFit, weights: Mapping[str, float]) -> Estimate:
    """Estimate a weighted sum of fixed effects, such as the difference of two slopes.

    Parameters
    ----------
    fit : MixedFit
        The model.
    weights : Mapping of str to float
        Term -> weight; terms left out count 0.

    Returns
    -------
    Estimate
        Value, standard error, Satterthwaite's df, t, p and the 95 % interval.

    Raises
    ------
    ValueError
        If a term is not in the model, or no weight is other than 0.

    Notes
    -----
    The same as lmerTest's ``contest1D``: the covariance of the effects is accounted for, and the degrees of
    freedom are those of the contrast, not of either effect.

    Examples
    --------
    >>> import pandas as pd
    >>> data = pd.DataFrame({"who": list("aaabbbcccddd"), "x": list("uvw") * 4,
    ...     "y": [1.0, 2, 4, 3, 5, 6, 2, 2, 4, 5, 7, 8]})
    >>> fit = fit_mixed("y ~ x + (1 | who)", data)
    >>> difference = contrast(fit, {"xw": 1, "xv": -1})
    >>> round(difference.estimate, 2), round(difference.se, 2), round(difference.df, 1)
    (1.5, 0.35, 6.0)
    """
    terms = list(fit.fixed.index)
    if strangers := [name for name in weights if name not in terms]:
        raise ValueError(
            f"weights: got {strangers[0]!r}, allowed are the model's terms: {', '.join(terms)}"
        )
    values = np.array([float(weights.get(name, 0)) for name in terms])
    if not np.isfinite(values).all() or not values.any():
        raise ValueError(
            f"weights: got {dict(weights)}, allowed are finite numbers, one of them other than 0"
        )
    return estimate_sum(fit.fixed["estimate"].to_numpy(), values, fit.uncertainty)


def _table_fixed(
    design: Design, coefficients: NDArray[np.float64], uncertainty: Uncertainty
) -> DataFrame:
    import pandas as pd

    rows = [
        asdict(estimate_sum(coefficients, row, uncertainty)) for row in np.eye(len(coefficients))
    ]
    return pd.DataFrame(rows, index=pd.Index(design.names, name="term"))


def _in_order(
    profile: Profile, values: list[NDArray[np.float64]]
) -> Iterator[tuple[Block, NDArray[np.float64]]]:
    """Blocks with what belongs to them, in the order of the formula."""
    names = [factor.name for factor in profile.design.factors]
    pairs = zip(profile.blocks, values, strict=True)
    return iter(sorted(pairs, key=lambda pair: names.index(pair[0].factor.name)))


def _table_spreads(profile: Profile, best: State) -> tuple[DataFrame, DataFrame]:
    import pandas as pd

    sigma = find_sigma(profile, best)
    spreads, ties = [], []
    for block, covariance in _in_order(profile, find_spreads(profile, best)):
        for term, places in _cut(block):
            part = covariance[places, places] * sigma**2
            names, group = term.names, block.factor.name
            spreads += [
                (group, name, sd) for name, sd in zip(names, np.sqrt(np.diag(part)), strict=True)
            ]
            ties += [
                (group, names[i], names[j], _correlate(part, i, j))
                for j in range(len(names))
                for i in range(j)
            ]
    return (
        pd.DataFrame(spreads, columns=["group", "term", "sd"]),
        pd.DataFrame(ties, columns=["group", "first", "second", "correlation"]).astype({
            "correlation": float
        }),
    )


def _cut(block: Block) -> Iterator[tuple[Term, slice]]:
    """Cut a factor's effects into its terms."""
    start = 0
    for term in block.factor.terms:
        yield term, slice(start, start + len(term.names))
        start += len(term.names)


def _correlate(covariance: NDArray[np.float64], first: int, second: int) -> float:
    size = float(np.sqrt(covariance[first, first] * covariance[second, second]))
    return float(np.clip(covariance[first, second] / size, -1, 1)) if size > 0 else float("nan")


def _predict(profile: Profile, best: State) -> tuple[NDArray[np.float64], DataFrame]:
    import pandas as pd

    fitted = profile.design.fixed @ find_coefficients(profile, best)[0]
    tables = []
    for block, values in _in_order(profile, find_modes(profile, best)):
        fitted = fitted + np.sum(block.factor.columns * values[block.factor.index], axis=1)
        names = [name for term in block.factor.terms for name in term.names]
        effects = {
            "level": np.tile(block.factor.levels, len(names)),
            "term": np.repeat(names, block.n_levels),
        }
        tables.append(
            pd.DataFrame({"group": block.factor.name, **effects, "value": values.T.ravel()})
        )
    return fitted, pd.concat(tables, ignore_index=True)


def _explain_variance(profile: Profile, best: State) -> tuple[float, float]:
    """Nakagawa's marginal and conditional R²."""
    residual = find_sigma(profile, best) ** 2
    fixed = float(np.var(profile.design.fixed @ find_coefficients(profile, best)[0], ddof=1))
    random = 0.0
    for block, covariance in zip(profile.blocks, find_spreads(profile, best), strict=True):
        values = block.factor.columns
        random += residual * float(np.mean(np.einsum("ni,ij,nj->n", values, covariance, values)))
    total = fixed + random + residual
    return fixed / total, (fixed + random) / total


def _name_zeros(variances: DataFrame, correlations: DataFrame, *, boundary: bool) -> list[str]:
    """Say what makes a fit singular; nothing for a regular one."""
    zero = [f"{row.term} over {row.group}" for row in variances[variances["sd"] == 0].itertuples()]
    perfect = correlations[correlations["correlation"].abs() > BOUND]
    tied = [f"{row.first} and {row.second} over {row.group}" for row in perfect.itertuples()]
    notes = []
    if zero:
        notes.append(
            f"Singular fit: the spread of {'; '.join(zero)} is estimated as zero, and kept."
        )
    if tied:
        notes.append(
            f"Singular fit: the effects {'; '.join(tied)} are estimated as perfectly correlated."
        )
    if boundary and not notes:
        notes.append("Singular fit: some random effects are estimated as weighted sums of others.")
    return notes
