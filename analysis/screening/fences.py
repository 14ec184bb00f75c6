"""Rules about a participant among the others, and two descriptions of how ratings of one item are spread.

References
----------
.. [1] J. W. Tukey, Exploratory Data Analysis, 1977: hinges and fences.
.. [2] R. Pfister et al., Good things peak in pairs: a note on the bimodality coefficient, Frontiers in Psychology 4,
   2013, 700. doi:10.3389/fpsyg.2013.00700
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from analysis.arrays import read_numbers
from analysis.resampling.bootstrap import FEWEST_ITEMS, FLAT
from analysis.screening.findings import tell_values
from analysis.screening.judgements import FEWEST_JUDGEMENTS

if TYPE_CHECKING:
    from numpy.typing import ArrayLike
    from pandas import DataFrame

    from analysis.screening.judgements import Judgements

REACH = 1.5
"""Fences stand this many hinge spreads outside the hinges."""

FEWEST_RATERS = 5
"""With fewer values no fence can leave one out, or a shape be told."""

UNIMODAL = 5 / 9
"""Multimodality coefficient of evenly spread values; above it, ratings may have more than one peak."""


def tukey_hinges(values: ArrayLike) -> tuple[float, float]:
    """Medians of the lower and the upper half; for odd n the median belongs to both.

    Parameters
    ----------
    values : array_like, shape (n,)
        Finite numbers, at least one.

    Returns
    -------
    tuple of float
        The lower and the upper hinge; not the same as quartiles by interpolation.

    Raises
    ------
    ValueError
        If there is no value, or one that is not finite.

    Examples
    --------
    >>> tukey_hinges([1, 2, 3, 4, 5])
    (2.0, 4.0)
    >>> tukey_hinges([1, 2, 3, 4, 5, 6])
    (2.0, 5.0)
    """
    ordered = np.sort(read_numbers(values, what="values").ravel())
    if not len(ordered) or not np.isfinite(ordered).all():
        raise ValueError(f"values: got {len(ordered)}, not all finite; allowed is one or more finite numbers")
    half = (len(ordered) + 1) // 2
    return float(np.median(ordered[:half])), float(np.median(ordered[-half:]))


def tukey_fences(values: ArrayLike, *, step: float = 0.0) -> tuple[float, float]:
    """Find where outlying begins: 1.5 hinge spreads outside the hinges.

    Parameters
    ----------
    values : array_like, shape (n,)
        Finite numbers, at least one.
    step : float
        Points between neighbouring values of a scale of few steps: the hinge spread counts as one step at least, for
        where most raters choose one step, their neighbours on the next are no outliers.

    Returns
    -------
    tuple of float
        A value below the first or above the second is an outlier.

    Examples
    --------
    >>> tukey_fences([1, 2, 3, 4, 5])
    (-1.0, 7.0)
    """
    low, high = tukey_hinges(values)
    reach = REACH * max(high - low, step)
    return low - reach, high + reach


def multimodality(values: ArrayLike) -> float:
    """Tell from skewness and kurtosis whether values may have more than one peak.

    Parameters
    ----------
    values : array_like, shape (n,)
        Finite numbers.

    Returns
    -------
    float
        (g² + 1) / (k + 3 (n - 1)² / ((n - 2)(n - 3))), g the skewness and k the excess kurtosis, both corrected for
        sample size. Above 5/9 more than one peak is possible, as is strong skewness; NaN for fewer than 4 values and
        for values that are all the same.

    Raises
    ------
    ValueError
        If a value is not finite.

    Notes
    -----
    Use it to find items whose mean rating hides two camps of raters; look at their histogram before concluding. With
    fewer than some 20 raters it scatters widely.

    Examples
    --------
    >>> two_camps, one = [10, 11, 12, 13, 90, 91, 92, 93] * 4, [1, 3, 3, 4, 4, 4, 4, 5, 5, 7] * 3
    >>> round(multimodality(two_camps), 2), round(multimodality(one), 2)
    (0.85, 0.25)
    """
    from scipy.stats import kurtosis, skew

    given = read_numbers(values, what="values").ravel()
    n = len(given)
    if not np.isfinite(given).all():
        raise ValueError(f"values: got {int((~np.isfinite(given)).sum())} of {n} that are not finite; leave them out")
    flat = n < 4 or ((given - given.mean()) ** 2).sum() <= FLAT * (given**2).sum()  # noqa: PLR2004 - divides by n - 3
    if flat:
        return float("nan")
    g, k = skew(given, bias=False), kurtosis(given, bias=False)
    return float((g**2 + 1) / (k + 3 * (n - 1) ** 2 / ((n - 2) * (n - 3))))


def judge_outliers(judgements: Judgements, limit: float) -> DataFrame:
    """Find raters whose ratings lie outside the fences of too many items.

    Parameters
    ----------
    judgements : Judgements
        All of them; repeats of test stimuli are averaged.
    limit : float
        Largest share of items, of those that five or more raters rated. On a scale of few steps a hinge spread counts
        as one step at least.

    Returns
    -------
    DataFrame
        As `tell_values`.
    """
    means = judgements.means()
    means = means.loc[:, means.notna().sum() >= FEWEST_RATERS]
    steps = judgements.rows.groupby("item")["step"].max().reindex(means.columns)
    fences = np.array(
        [tukey_fences(means[item].dropna(), step=step) for item, step in zip(means, steps, strict=True)]
    ).reshape(-1, 2)
    outside = means.lt(fences[:, 0], axis=1) | means.gt(fences[:, 1], axis=1)
    count, n = outside.sum(axis=1), means.notna().sum(axis=1)
    return tell_values(count, n, count / n.where(n > 0), limit=limit)


def judge_reversed_scale(judgements: Judgements, limit: float) -> DataFrame:
    """Find raters who rate high what the others rate low.

    Parameters
    ----------
    judgements : Judgements
        All of them; repeats of test stimuli are averaged.
    limit : float
        Smallest correlation with the mean of the others.

    Returns
    -------
    DataFrame
        As `tell_values`: count and n are the items shared with others, share is Pearson's r; NaN for fewer than 8
        items and for constant ratings.
    """
    import pandas as pd

    means = judgements.means()
    others = (means.sum() - means.fillna(0.0)) / (means.notna().sum() - means.notna()).replace(0, np.nan)
    others = others.where(means.notna())
    n = others.notna().sum(axis=1)
    r = pd.Series([_correlate(means.loc[name], others.loc[name]) for name in means.index], index=means.index)
    return tell_values(n, n, r.where(n >= FEWEST_JUDGEMENTS), limit=limit, below=True)


def _correlate(own: object, other: object) -> float:
    one, two = np.asarray(own, dtype=np.float64), np.asarray(other, dtype=np.float64)
    both = np.isfinite(one) & np.isfinite(two)
    if both.sum() < FEWEST_ITEMS or np.ptp(one[both]) == 0 or np.ptp(two[both]) == 0:
        return float("nan")
    return float(np.corrcoef(one[both], two[both])[0, 1])
