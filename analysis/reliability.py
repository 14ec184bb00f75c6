"""How reliable are mean ratings? Intraclass correlations and the noise ceiling they set.

Conventions: a table has shape (targets, raters); targets are stimuli, raters are participants; no cell is
missing.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from analysis.bootstrap import FLAT

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

SMALLEST = 2
"""Targets and raters that a variance needs at least."""


@dataclass(frozen=True, slots=True)
class Intraclass:
    """The six intraclass correlations, in McGraw and Wong's names.

    Parameters
    ----------
    icc_1_1, icc_a_1, icc_c_1 : float
        Of one rater's rating: one-way; two-way, absolute agreement; two-way, consistency.
    icc_1_k, icc_a_k, icc_c_k : float
        The same of the mean over all raters. NaN where every rating is the same.
    """

    icc_1_1: float
    icc_a_1: float
    icc_c_1: float
    icc_1_k: float
    icc_a_k: float
    icc_c_k: float


@dataclass(frozen=True, slots=True)
class _MeanSquares:
    targets: float
    raters: float
    error: float
    within: float


def intraclass(table: ArrayLike) -> Intraclass:
    """Intraclass correlations of a complete table.

    Parameters
    ----------
    table : array_like, shape (targets, raters)
        Ratings, no cell missing, at least 2 by 2.

    Returns
    -------
    Intraclass
        All six forms.

    Raises
    ------
    ValueError
        If the table is too small or has a cell that is not finite.

    Notes
    -----
    Two-way analysis of variance with n targets and k raters: mean squares of targets R, raters C, residual E,
    and of ratings within targets W. Consistency of the mean rating is (R - E) / R; a negative value means
    that targets do not differ beyond noise.

    References
    ----------
    Shrout & Fleiss (1979), Psychological Bulletin 86, 420-428, doi 10.1037/0033-2909.86.2.420.
    McGraw & Wong (1996), Psychological Methods 1, 30-46, doi 10.1037/1082-989X.1.1.30.

    Examples
    --------
    >>> shrout_fleiss = [[9, 2, 5, 8], [6, 1, 3, 2], [8, 4, 6, 8], [7, 1, 2, 6], [10, 5, 6, 9], [6, 2, 4, 7]]
    >>> icc = intraclass(shrout_fleiss)
    >>> round(icc.icc_a_1, 2), round(icc.icc_c_k, 2)
    (0.29, 0.91)
    """
    ratings = _check_table(table)
    n, k = ratings.shape
    ms = _mean_squares(ratings)
    bias = (ms.raters - ms.error) / n
    return Intraclass(
        icc_1_1=_ratio(ms.targets - ms.within, ms.targets + (k - 1) * ms.within),
        icc_a_1=_ratio(ms.targets - ms.error, ms.targets + (k - 1) * ms.error + k * bias),
        icc_c_1=_ratio(ms.targets - ms.error, ms.targets + (k - 1) * ms.error),
        icc_1_k=_ratio(ms.targets - ms.within, ms.targets),
        icc_a_k=_ratio(ms.targets - ms.error, ms.targets + bias),
        icc_c_k=_ratio(ms.targets - ms.error, ms.targets),
    )


def noise_ceiling(table: ArrayLike) -> float:
    """Correlation that a perfect predictor would reach with mean ratings as noisy as these.

    Parameters
    ----------
    table : array_like, shape (targets, raters)
        Ratings, no cell missing, at least 2 by 2.

    Returns
    -------
    float
        sqrt(ICC(C,k)), 0 to 1; NaN where targets do not differ beyond noise: there is nothing to predict
        then.

    Raises
    ------
    ValueError
        If the table is too small or has a cell that is not finite.

    Notes
    -----
    The square root of the mean's reliability bounds its correlation with anything (Spearman 1904, doi
    10.2307/1412159). Consistency is the right form because a correlation ignores how high a rater's ratings
    are.

    Examples
    --------
    >>> round(noise_ceiling([[1, 2], [3, 5], [6, 6]]), 3)
    0.975
    """
    reliability = intraclass(table).icc_c_k
    return float(np.sqrt(reliability)) if reliability > 0 else float("nan")


def _check_table(table: ArrayLike) -> NDArray[np.float64]:
    ratings = np.asarray(table, dtype=np.float64)
    if ratings.ndim != 2 or min(ratings.shape) < SMALLEST:  # noqa: PLR2004 - targets x raters
        raise ValueError(f"table: got shape {ratings.shape}, allowed is (targets, raters), at least 2 by 2")
    if not np.isfinite(ratings).all():
        holes = int((~np.isfinite(ratings)).sum())
        raise ValueError(f"table: got {holes} cells that are not finite; leave their targets or raters out")
    return ratings


def _mean_squares(ratings: NDArray[np.float64]) -> _MeanSquares:
    n, k = ratings.shape
    of_targets = ratings.mean(axis=1, keepdims=True)
    of_raters = ratings.mean(axis=0, keepdims=True)
    grand = ratings.mean()
    residual = ratings - of_targets - of_raters + grand
    rounding = FLAT * float((ratings**2).sum())

    def square(deviations: NDArray[np.float64]) -> float:
        total = float((deviations**2).sum())
        return total if total > rounding else 0.0

    return _MeanSquares(
        targets=k * square(of_targets - grand) / (n - 1),
        raters=n * square(of_raters - grand) / (k - 1),
        error=square(residual) / ((n - 1) * (k - 1)),
        within=square(ratings - of_targets) / (n * (k - 1)),
    )


def _ratio(part: float, whole: float) -> float:
    return part / whole if whole else float("nan")
