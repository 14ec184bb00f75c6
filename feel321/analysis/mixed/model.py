"""Linear mixed models: `fit_mixed`, and `contrast` for sums and differences of its effects."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pandas as pd
from pandas import DataFrame
from scipy.stats import t as student

from feel321.analysis.arrays import UPPER
from feel321.analysis.mixed import optimum
from feel321.analysis.mixed.design import MixedDesign, build_design
from feel321.arguments import describe
from feel321.records import Statistic
from feel321.types import Samples

NEAR = 1e-5  # A step of a spread after which second derivatives are computed anew
STEPS = 3  # Of Newton's method at most
POLISH = 0.1  # Longest such step, in units of a spread
ROUNDING = 1e-6  # What a deviance of some thousands is known to
FLAT = 1e-8  # Curvature below this carries no information: a spread at its boundary
BOUND = 1 - 1e-6  # A correlation beyond this is one of ±1 but for rounding


@dataclass(frozen=True, slots=True, eq=False)
class Uncertainty:
    """The fixed effects, and what the variance of any combination of them follows from.

    effects: (n_fixed,); covariance: (n_fixed, n_fixed); slopes: (n_theta + 1, n_fixed, n_fixed); parameters: (n_theta +
    1, n_theta + 1); most_df: largest degrees of freedom that are believed.
    """

    effects: Samples
    covariance: Samples
    slopes: Samples
    parameters: Samples
    most_df: float = np.inf

    def estimate(self, weights: Samples) -> Statistic:
        """Estimate a weighted sum of fixed effects; weights: (n_fixed,).

        With v = w' C w and g its derivatives with respect to the spreads, whose covariance is A, the degrees of
        freedom are 2 v² / g' A g (Satterthwaite 1946, doi 10.2307/3002019; lmerTest, doi 10.18637/jss.v082.i13).
        """
        variance = float(weights @ self.covariance @ weights)
        slope = np.einsum("i,kij,j->k", weights, self.slopes, weights)
        df = min(float(2 * variance**2 / (slope @ self.parameters @ slope)), self.most_df)
        value, se = float(weights @ self.effects), float(np.sqrt(variance))
        margin = float(student.ppf(UPPER, df)) * se
        p = float(2 * student.sf(abs(value / se), df))
        return Statistic(
            "Estimate", estimate=value, se=se, df=df, t=value / se, p=p, low=value - margin, high=value + margin
        )  # fmt: skip


def find_uncertainty(
    profile: optimum.Profile, best: optimum.State, *, most_df: float = np.inf
) -> tuple[optimum.State, Uncertainty]:
    """Compute how the fixed effects' covariance depends on the spreads, and how well those are known.

    The search stops where the deviance no longer falls but for rounding, 1e-5 or so beside the minimum: Newton's last
    steps come first. The spreads' covariance is 2 H⁻¹, H the second derivatives of the deviance before s is profiled
    out; directions in which H is not positive carry no information and are left out, as lmerTest does.
    """
    hessian, slopes = profile.differentiate(best)
    for _ in range(STEPS):
        unit, slope = np.maximum(np.abs(best.theta), 1), profile.find_slope(best)
        slope[profile.penalised] -= 2 / best.theta[profile.penalised]
        # The residual's spread follows the others.
        along = np.outer(hessian[:-1, -1], hessian[-1, :-1]) / hessian[-1, -1]
        free = np.flatnonzero(best.theta != 0)
        values, vectors = np.linalg.eigh((hessian[:-1, :-1] - along)[np.ix_(free, free)])
        steep = values > FLAT
        down = vectors[:, steep].T @ (slope * unit)[free] / values[steep]
        step = np.zeros_like(best.theta)
        step[free] = -(vectors[:, steep] @ down) * unit[free]
        if not np.abs(step / unit).max(initial=0.0) < POLISH:
            break
        moved = profile.evaluate(best.theta + step)
        if profile.target(moved) > profile.target(best) + ROUNDING:
            break
        best = moved
        if np.abs(step).max(initial=0.0) <= NEAR:
            break
        hessian, slopes = profile.differentiate(best)
    effects, relative = profile.find_coefficients(best)
    values, vectors = np.linalg.eigh(hessian)
    kept = values > FLAT
    parameters = 2 * (vectors[:, kept] / values[kept]) @ vectors[:, kept].T
    covariance = relative * profile.find_sigma(best) ** 2
    return best, Uncertainty(effects, covariance, slopes, parameters, most_df)


class Solved(NamedTuple):
    """A design's deviance at its minimum, and what is known of the fixed effects there."""

    profile: optimum.Profile
    best: optimum.State
    uncertainty: Uncertainty

    def estimate(self, weights: Mapping[str, float]) -> Statistic:
        """Estimate a weighted sum of fixed effects, by name; all others count 0."""
        values = [weights.get(name, 0.0) for name in self.profile.design.names]
        return self.uncertainty.estimate(np.array(values))

    def list_spreads(self) -> Iterator[tuple[str, tuple[str, ...], Samples]]:
        """List group, effects and covariance of what varies together, in the order of the formula."""
        variance = self.profile.find_sigma(self.best) ** 2
        covariances = self.profile.find_spreads(self.best)
        for block, covariance in zip(self.profile.blocks, covariances, strict=True):
            start = 0
            for term in block.factor.terms:
                place = slice(start, start := start + len(term.names))
                yield block.factor.name, term.names, covariance[place, place] * variance

    def note_zeros(self) -> tuple[str, ...]:
        """Say what makes a fit singular; nothing for a regular one."""
        zero, tied, notes = [], [], []
        for group, names, covariance in self.list_spreads():
            sd = np.sqrt(np.diag(covariance))
            zero += [f"{name} over {group}" for name in np.array(names)[sd == 0]]
            size = np.outer(sd, sd)
            bound = (np.abs(covariance) > BOUND * size) & (size > 0)
            pairs = np.argwhere(np.tril(bound, -1))
            tied += [f"{names[i]} and {names[j]} over {group}" for j, i in pairs]
        if zero:
            notes.append(f"the spread of {'; '.join(zero)} is estimated as zero, and kept")
        if tied:
            notes.append(f"the effects {'; '.join(tied)} are estimated as perfectly correlated")
        if (self.best.theta[self.profile.diagonal] == 0).any() and not notes:
            notes.append("some random effects are estimated as weighted sums of others")
        return tuple(f"Singular fit: {note}." for note in notes)


def solve_design(
    design: MixedDesign,
    *, reml: bool = True, penalty: Sequence[str] = (), most_df: float = np.inf, near: Samples | None = None,
) -> Solved:  # fmt: skip
    """Minimise a design's deviance; near: theta of the same terms on much the same data."""
    profile = optimum.Profile(design, reml=reml, penalty=penalty)
    with optimum.hold_threads(profile.n_random):
        best = optimum.find_optimum(profile, near)
        return Solved(profile, *find_uncertainty(profile, best, most_df=most_df))


class MixedFit(Statistic):
    """A linear mixed model, fitted, as `fit_mixed` returns it."""

    __slots__ = ()


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
        Restricted maximum likelihood; False to compare models with different fixed parts.
    penalty : sequence of str
        Grouping factors whose spreads are kept away from zero, such as those with few levels.

    Returns
    -------
    MixedFit
        ``fixed``, indexed by ``term``: estimate, se, df (Satterthwaite), t, p, low and high (95 %); ``variances``, the
        random effects' spreads: group, term, sd; ``correlations`` within ``(1 + x | group)``; ``residual_sd``;
        ``criterion``, -2 log (restricted) likelihood at its maximum, without the penalty; ``singular``, whether a
        spread is zero or effects are perfectly tied; ``marginal_r2 conditional_r2``; ``fitted residuals``, (n_rows,),
        with the random effects; ``formula reml n_rows n_levels notes``.

    Notes
    -----
    Model: y = X b + Z u + e, with u ~ N(0, G) independent between groups and levels, e ~ N(0, s² I). Do not use it for
    grouping factors of two or three levels if their spread is the question, nor for ratings piled up at the ends of the
    scale. The deviance is profiled and minimised over relative spreads (Bates et al. 2015); degrees of freedom are
    Satterthwaite's, as in lmerTest; R² is Nakagawa's and Schielzeth's with Johnson's extension to slopes.

    With few levels a spread is often estimated as zero when it is only unknown; for the factors named in `penalty`,
    -2 log of the spread is added to the deviance (Chung et al. 2013). A spread of zero (a singular fit) is normal in
    small studies: it stays in the model as zero, and the notes say so.

    References
    ----------
    Bates, Mächler, Bolker & Walker (2015), doi 10.18637/jss.v067.i01; Kuznetsova et al. (2017), doi
    10.18637/jss.v082.i13; Chung, Rabe-Hesketh, Dorie, Gelman & Liu (2013), doi 10.1007/s11336-013-9328-2; Nakagawa &
    Schielzeth (2013), doi 10.1111/j.2041-210x.2012.00261.x; Johnson (2014), doi 10.1111/2041-210X.12225.

    Examples
    --------
    >>> import pandas as pd
    >>> from feel321 import analysis
    >>> data = pd.DataFrame({"who": list("aaabbbcccddd"), "x": [0, 1, 2] * 4,
    ...     "y": [1.0, 2, 3, 3, 5, 6, 2, 2, 4, 5, 7, 8]})
    >>> fit = analysis.fit_mixed("y ~ x + (1 | who)", data)
    >>> fit.fixed.round(2)
                 estimate    se    df     t     p   low  high
    term
    (Intercept)      2.75  1.07  3.15  2.58  0.08 -0.56  6.06
    x                1.25  0.16  7.00  7.64  0.00  0.86  1.64
    >>> round(fit.residual_sd, 2), round(fit.criterion, 2), fit.singular
    (0.46, 29.93, False)
    """
    design = build_design(formula, data)
    return report_fit(formula, solve_design(design, reml=reml, penalty=penalty))


def report_fit(formula: str, solved: Solved) -> MixedFit:
    """Compute everything about a fit that is for people."""
    profile, best, design = solved.profile, solved.best, solved.profile.design
    residual_sd, notes = profile.find_sigma(best), solved.note_zeros()
    spreads, ties = [], []
    for group, names, covariance in solved.list_spreads():
        sd = np.sqrt(np.diag(covariance))
        spreads += [(group, name, value) for name, value in zip(names, sd, strict=True)]
        for j, i in zip(*np.tril_indices(len(names), -1), strict=True):
            size = float(sd[i] * sd[j])
            tie = float(np.clip(covariance[i, j] / size, -1, 1)) if size > 0 else float("nan")
            ties.append((group, names[i], names[j], tie))
    columns = ["group", "first", "second", "correlation"]
    predicted = design.fixed @ solved.uncertainty.effects
    fitted, random = predicted, 0.0
    effects = profile.blocks, profile.find_modes(best), profile.find_spreads(best)
    for block, modes, covariance in zip(*effects, strict=True):
        own = block.factor.columns
        fitted = fitted + np.sum(own * modes[block.factor.index], axis=1)
        random += float(np.einsum("ni,ij,nj->", own, covariance, own))
    # Nakagawa's R², of the variances of fixed effects, random effects and residual.
    random *= residual_sd**2 / profile.n_rows
    parts = np.array([np.var(predicted, ddof=1), random, residual_sd**2])
    rows = [solved.estimate({name: 1.0}) for name in design.names]
    return MixedFit(
        "MixedFit", formula=formula, reml=profile.reml,
        fixed=pd.DataFrame(rows, index=pd.Index(design.names, name="term")),
        variances=pd.DataFrame(spreads, columns=["group", "term", "sd"]),
        correlations=pd.DataFrame(ties, columns=columns).astype({"correlation": float}),
        residual_sd=residual_sd, criterion=profile.deviance(best), singular=bool(notes),
        marginal_r2=float(parts[0] / parts.sum()), conditional_r2=float(parts[:2].sum() / parts.sum()),
        fitted=fitted, residuals=design.response - fitted, uncertainty=solved.uncertainty, n_rows=profile.n_rows,
        n_levels={factor.name: factor.n_levels for factor in design.factors}, notes=notes,
    )  # fmt: skip


def contrast(fit: MixedFit, weights: Mapping[str, float]) -> Statistic:
    """Estimate a weighted sum of fixed effects, such as the difference of two slopes.

    Parameters
    ----------
    fit : MixedFit
        The model.
    weights : Mapping of str to float
        Term -> weight; terms left out count 0.

    Returns
    -------
    Statistic
        ``estimate se df t p``, the value with its t test against 0 on Satterthwaite's degrees of freedom, and ``low
        high``, the 95 % interval.

    Notes
    -----
    The same as lmerTest's ``contest1D``: the degrees of freedom are those of the contrast, not of either effect.
    """
    if not isinstance(weights, Mapping):
        raise TypeError(f"weights must be a mapping of terms to numbers, got {describe(weights)}")
    terms = list(fit.fixed.index)
    values = np.array([float(weights.get(name, 0)) for name in terms])
    if not set(weights) <= set(terms) or not np.isfinite(values).all() or not values.any():
        rule = f"finite numbers of terms of the model ({', '.join(terms)}), one of them not 0"
        raise ValueError(f"weights must be {rule}, got {dict(weights)}")
    estimate: Statistic = fit.uncertainty.estimate(values)
    return estimate
