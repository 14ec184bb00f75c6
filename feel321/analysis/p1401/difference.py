"""Does one metric predict mean votes better than another? The four significance tests of ITU-T P.1401."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from feel321.analysis.arrays import PERFECT, find_p
from feel321.analysis.p1401.mapping import P1401, PARAMETERS
from feel321.records import Result

SIGNIFICANCE = 0.05


@dataclass(frozen=True, slots=True, repr=False, eq=False)
class P1401Difference(Result):
    """Two metrics compared on the same votes by ITU-T P.1401.

    Parameters
    ----------
    plcc_z, plcc_p : float
        Difference of Fisher's z of the two PLCC over its standard error, and two-sided p.
    outlier_z, outlier_p : float
        Difference of the outlier ratios over the pooled standard error, and two-sided p.
    rmse_f, rmse_limit, rmse_p : float
        Squared ratio of the larger rmse to the smaller, the standard's limit F(.95; N - d, N - d), and
        two-sided p.
    rmse_star_f, rmse_star_limit, rmse_star_p : float
        The same of rmse*, with F(.95; N, N).
    n_items : int
        Number of items.
    notes : tuple of str
        Why anything is NaN, one sentence each.
    """

    plcc_z: float
    plcc_p: float
    outlier_z: float
    outlier_p: float
    rmse_f: float
    rmse_limit: float
    rmse_p: float
    rmse_star_f: float
    rmse_star_limit: float
    rmse_star_p: float
    n_items: int
    notes: tuple[str, ...] = ()


def compare_p1401(first: P1401, second: P1401) -> P1401Difference:
    """Test the differences between two metrics as ITU-T P.1401 does.

    Parameters
    ----------
    first, second : P1401
        Results of `p1401` for two metrics on the same votes, with the same order; positive z means that the
        first has the larger value.

    Returns
    -------
    P1401Difference
        The four tests.

    Notes
    -----
    With N items: Z = (z1 - z2) / √(2 / (N - 3)); for the outlier ratios Z = (p1 - p2) / √(2 p (1 - p) / N)
    with p their mean; for the errors the larger square over the smaller, against F(.95; N - d, N - d) for rmse
    and F(.95; N, N) for rmse*. Putting the larger on top makes the standard's limit a test at 10 %, not 5 %;
    the p given here are two-sided.

    **Not for conclusions.** All four take items for independent and the two metrics' errors for unrelated,
    although both are errors about the same votes. When stimuli cluster in recordings they find a difference
    in 13 to 27 % of studies where there is none; use `compare_metrics`.

    References
    ----------
    ITU-T Recommendation P.1401 (2020), Methods, metrics and procedures for statistical evaluation,
    qualification and comparison of objective quality prediction models.

    Examples
    --------
    >>> from feel321 import analysis
    >>> votes = [[10, 20, 15], [30, 25, 20], [50, 40, 45], [55, 60, 50], [80, 75, 70], [85, 95, 90]]
    >>> good = analysis.p1401(votes, [0.1, 0.2, 0.45, 0.5, 0.8, 0.9], order=1)
    >>> poor = analysis.p1401(votes, [0.3, 0.1, 0.2, 0.9, 0.4, 0.8], order=1)
    >>> result = analysis.compare_p1401(good, poor)
    >>> round(result.plcc_z, 2), round(result.plcc_p, 3), round(result.rmse_f, 1), round(result.rmse_p, 3)
    (2.83, 0.005, 68.5, 0.001)
    """
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
    rmse = _compare_errors((first.rmse, second.rmse), freedom, name="rmse", notes=notes)
    star = _compare_errors((first.rmse_star, second.rmse_star), n, name="rmse*", notes=notes)
    return P1401Difference(
        plcc_z, find_p(plcc_z), outlier_z, find_p(outlier_z), *rmse, *star, n, tuple(notes)
    )


def _compare_errors(
    errors: tuple[float, float], freedom: int, *, name: str, notes: list[str]
) -> tuple[float, float, float]:
    from scipy.stats import f

    limit = float(f.ppf(1 - SIGNIFICANCE, freedom, freedom))
    if min(errors) == 0:
        notes.append(f"No test of {name}: it is 0 for at least one metric.")
        return float("nan"), limit, float("nan")
    ratio = float((max(errors) / min(errors)) ** 2)
    return ratio, limit, float(min(1.0, 2 * f.sf(ratio, freedom, freedom)))
