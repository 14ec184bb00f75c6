"""The best cubic that never turns back: how a metric is mapped onto a rating scale before errors are counted.

Monotone means on the whole interval, not on a grid of it: a 0..1 metric tested in steps of 0.1 hides a turn
between two steps.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.polynomial import Polynomial

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    Values = NDArray[np.float64]

UNIT = (0.0, 1.0)


def fit_monotone_cubic(x: Values, y: Values, *, span: tuple[float, float]) -> Polynomial:
    """Least-squares cubic that rises, or falls, over all of an interval.

    Parameters
    ----------
    x : ndarray, shape (n,)
        At least four different values, all within the span.
    y : ndarray, shape (n,)
        What to fit.
    span : tuple of float
        Ends of the interval on which the cubic must be monotone.

    Returns
    -------
    Polynomial
        Of degree 3; call it with x. The direction is the one that fits better.

    Notes
    -----
    With u = (x - low) / (high - low), the cubics that rise on the interval are those whose slope is q(u) =
    (α + β u)² + γ² u (1 - u), Lukács' form of a quadratic that is nowhere negative on [0, 1]. They form a
    convex cone, so the fit is unique. Where the unconstrained cubic is not monotone, the answer lies on the
    cone's border: q(0) = 0, q(1) = 0, or q(u) = k (u - t)² touching 0 inside. The first two are least squares
    with two non-negative weights; for the third, the share of variance explained is a ratio of polynomials in
    t, whose stationary points are the roots of a quintic. All are solved exactly, without a grid and without
    an iteration that could stop early.

    References
    ----------
    ITU-T P.1401 (2020), Methods, metrics and procedures for statistical evaluation of objective quality
    prediction models. Szegő (1975), Orthogonal Polynomials, theorem 1.21.1, for the form of q.

    Examples
    --------
    >>> x = np.array([0.0, 0.25, 0.5, 0.75, 1.0])
    >>> turning = np.array([0.0, 3.0, 2.0, 1.0, 4.0])
    >>> mapping = fit_monotone_cubic(x, turning, span=(0, 1))
    >>> bool((np.diff(mapping(np.linspace(0, 1, 1001))) >= 0).all())
    True
    >>> mapping(x).round(2)
    array([0.15, 1.77, 2.  , 2.23, 3.85])
    """
    u = (x - span[0]) / (span[1] - span[0])
    free = Polynomial.fit(u, y, 3, domain=UNIT, window=UNIT)
    if _is_monotone(free):
        return _stretch(free, span)
    rising = _fit_border(u, y)
    falling = -_fit_border(u, -y)
    return _stretch(min((rising, falling), key=lambda cubic: _misfit(cubic, u, y)), span)


def _is_monotone(cubic: Polynomial) -> bool:
    slope = cubic.deriv()
    turn = slope.deriv()
    inner = -turn.coef[0] / turn.coef[1] if turn.coef[1] else 0.0
    extremes = slope(np.array([*UNIT, inner if 0 < inner < 1 else 0.0]))
    return bool((extremes >= 0).all() or (extremes <= 0).all())


def _fit_border(u: Values, y: Values) -> Polynomial:
    """Fit the best rising cubic among those whose slope is 0 somewhere."""
    return min(_candidates(u, y), key=lambda cubic: _misfit(cubic, u, y))


def _candidates(u: Values, y: Values) -> Iterator[Polynomial]:
    from scipy.optimize import nnls

    bow = Polynomial([0, 0, 1 / 2, -1 / 3])  # slope u (1 - u)
    for corner in (Polynomial([0, 0, 0, 1 / 3]), Polynomial([0, 1, -1, 1 / 3])):  # slopes u² and (1 - u)²
        columns = np.stack([bow(u), corner(u)], axis=1)
        weights, _ = nnls(columns - columns.mean(axis=0), y - y.mean())
        yield _centre(weights[0] * bow + weights[1] * corner, u, y)
    for touch in _touching_points(u, y):
        shape = Polynomial([0, touch**2, -touch, 1 / 3])  # slope (u - touch)²
        column = shape(u) - shape(u).mean()
        yield _centre(max(0.0, column @ y / (column @ column)) * shape, u, y)


def _touching_points(u: Values, y: Values) -> Values:
    """Where inside [0, 1] a slope k (u - t)² may best touch 0: stationary points of the variance explained."""
    powers = np.stack([u**3 / 3, -(u**2), u])
    powers -= powers.mean(axis=1, keepdims=True)
    moments = powers @ powers.T
    with_y = Polynomial(powers @ y)
    with_itself = Polynomial([np.fliplr(moments).trace(offset) for offset in range(2, -3, -1)])
    stationary = 2 * with_y.deriv() * with_itself - with_y * with_itself.deriv()
    # A root that rounding has made complex, or pushed out, is still a candidate: each is judged by its fit.
    return np.clip(stationary.trim().roots().real, *UNIT)


def _centre(cubic: Polynomial, u: Values, y: Values) -> Polynomial:
    return cubic + float(y.mean() - cubic(u).mean())


def _misfit(cubic: Polynomial, u: Values, y: Values) -> float:
    return float(((y - cubic(u)) ** 2).sum())


def _stretch(cubic: Polynomial, span: tuple[float, float]) -> Polynomial:
    return Polynomial(cubic.coef, domain=span, window=UNIT)
