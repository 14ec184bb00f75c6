"""How well a combination of fixed effects is known: Satterthwaite's degrees of freedom."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from analysis.mixed.slope import find_slope
from analysis.mixed.solution import find_coefficients, find_sigma

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from analysis.mixed.profile import Profile, State

STEP = 1e-4
"""Share of a relative spread, or of 1 if that is more, by which it is moved: beside 10 000, 0.0001 is rounding."""

FLAT = 1e-8
"""Curvature below this carries no information: a spread at its boundary."""

CONFIDENCE = 0.95


@dataclass(frozen=True, slots=True)
class Uncertainty:
    """What the variance of any combination of fixed effects follows from.

    Parameters
    ----------
    covariance : ndarray, shape (n_fixed, n_fixed)
        Of the fixed effects.
    slopes : ndarray, shape (n_theta + 1, n_fixed, n_fixed)
        Its derivatives with respect to the relative spreads, each in units of itself where it is above 1, and the
        logarithm of the residual's.
    parameters : ndarray, shape (n_theta + 1, n_theta + 1)
        Covariance of those.
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

    Parameters
    ----------
    profile : Profile
        The deviance.
    best : State
        Its minimum.

    Returns
    -------
    Uncertainty
        Covariance, its derivatives, and the covariance of the spreads.

    Notes
    -----
    With f(theta, log s) the deviance before s is profiled out, the spreads' covariance is 2 H⁻¹, H the matrix of
    second derivatives, none of which hangs on units; directions in which H is not positive carry no information
    and are left out, as lmerTest does. Derivatives along theta are central differences of the exact slope. A penalty
    of -2 log theta adds 2 / theta².
    """
    sigma, size, unit = find_sigma(profile, best), profile.n_theta, np.maximum(np.abs(best.theta), 1)
    covariance = find_coefficients(profile, best)[1] * sigma**2
    hessian = np.zeros((size + 1, size + 1))
    slopes = np.empty((size + 1, *covariance.shape))
    for place, shift in enumerate(np.diag(STEP * unit)):
        above, below = profile.evaluate(best.theta + shift), profile.evaluate(best.theta - shift)
        rise = find_slope(profile, above, above.rss / sigma**2) - find_slope(profile, below, below.rss / sigma**2)
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


def estimate_sum(effects: NDArray[np.float64], weights: NDArray[np.float64], uncertainty: Uncertainty) -> Estimate:
    """Estimate a weighted sum of fixed effects.

    Parameters
    ----------
    effects : ndarray, shape (n_fixed,)
        Fixed effects.
    weights : ndarray, shape (n_fixed,)
        How often each counts; not all 0.
    uncertainty : Uncertainty
        Of the effects.

    Returns
    -------
    Estimate
        Its t test and interval.

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
