"""How the time of one call grows with the length of the signal: a fixed overhead and a power of n.

Conventions: n in samples per axis, times in s. A plain line through log t against log n would take the overhead of
short calls for slow growth; here it is a parameter of its own.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from analysis.tradeoff.chart.records import Growth

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    Values = NDArray[np.float64]

PARAMETERS = 3
STEEPEST = 4.0


def fit_growth(n_samples: ArrayLike, seconds: ArrayLike, *, reducer: str) -> Growth:
    r"""Fit :math:`t = c + b\, n^p` to measured times.

    Parameters
    ----------
    n_samples : array_like, shape (k,)
        Lengths, at least three different ones.
    seconds : array_like, shape (k,)
        Time of one call at each, above 0.
    reducer : str
        What was timed.

    Returns
    -------
    Growth
        Overhead, exponent and its interval.

    Raises
    ------
    ValueError
        If there are too few lengths, or a time is not above 0.

    Notes
    -----
    Least squares of :math:`\log t`, so that every length counts alike. The interval is Student's, from the deviations
    of the k medians from the fit with k - 3 degrees of freedom: it holds what the model does not know, such as caches
    that are full at some length, and not only the clock's noise.

    Examples
    --------
    >>> n = np.array([1e3, 1e4, 1e5, 1e6])
    >>> round(fit_growth(n, 1e-5 + 2e-9 * n**1.1, reducer="made up").exponent, 6)
    1.1
    """
    from scipy.optimize import least_squares

    n, t = np.asarray(n_samples, dtype=np.float64), np.asarray(seconds, dtype=np.float64)
    if len(set(n.tolist())) < PARAMETERS or n.shape != t.shape:
        raise ValueError(f"n_samples: got {len(n)} lengths, allowed is {PARAMETERS} or more, each with its time")
    if not (np.all(t > 0) and np.all(np.isfinite(t))):
        raise ValueError(f"seconds: got {t.min():g}, allowed is above 0; take a finer clock, or repeat the call")
    middle = float(np.exp(np.log(n).mean()))

    def deviations(parameters: Values) -> Values:
        overhead, scale, exponent = parameters
        predicted = np.exp(overhead) + np.exp(scale + exponent * np.log(n / middle))
        return np.asarray(np.log(predicted) - np.log(t))

    highest = float(np.log(t.min()))
    begin = [highest - 1, float(np.log(t).mean()), 1.0]
    # An overhead of e^-10 of the shortest call is none; without that bound its logarithm would run away.
    bounds = ([highest - 10, -np.inf, 0.0], [highest + 1e-9, np.inf, STEEPEST])
    fit = least_squares(deviations, begin, bounds=bounds, xtol=1e-12, ftol=1e-12, gtol=1e-12)
    low, high = _bound_exponent(float(fit.x[2]), np.asarray(fit.jac), fit.fun)
    return Growth(
        reducer, 1e6 * math.exp(fit.x[0]), float(fit.x[2]), low, high, int(n.min()), int(n.max()),
        float(np.sqrt(np.mean(fit.fun**2))),
    )  # fmt: skip


def _bound_exponent(exponent: float, jacobian: Values, deviations: Values) -> tuple[float, float] | tuple[None, None]:
    from scipy.stats import t

    spare = len(deviations) - PARAMETERS
    if spare < 1:
        return None, None
    variance = float(deviations @ deviations) / spare
    spread = math.sqrt(variance * np.linalg.pinv(jacobian.T @ jacobian)[2, 2])
    margin = float(t.ppf(0.975, spare)) * spread
    return exponent - margin, exponent + margin
